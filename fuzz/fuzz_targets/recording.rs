//! Recordings (`.mgk`): whole records, and nothing but an end after them.
#![no_main]

use libfuzzer_sys::fuzz_target;
use monogrid_datasets::{ReadOptions, RecordingReader};
use std::io::Cursor;
use std::path::Path;

fuzz_target!(|bytes: &[u8]| {
    for with_images in [false, true] {
        let options = ReadOptions { with_images };
        if let Ok(reader) = RecordingReader::new(Cursor::new(bytes), Path::new("fuzz"), options) {
            assert!(reader.count() <= bytes.len());
        }
    }
});
