//! Submaps (`.mgs`): whole, or an error.
#![no_main]

use libfuzzer_sys::fuzz_target;
use monogrid_datasets::{ReadOptions, SubmapReader};
use std::io::Cursor;
use std::path::Path;

fuzz_target!(|bytes: &[u8]| {
    for with_images in [false, true] {
        let options = ReadOptions { with_images };
        if let Ok(mut reader) = SubmapReader::new(Cursor::new(bytes), Path::new("fuzz")) {
            let blocks = reader.blocks().len();
            assert!(reader.records(options).count() <= blocks);
        }
    }
});
