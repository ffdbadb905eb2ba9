//! `.scans` files.
#![no_main]

use libfuzzer_sys::fuzz_target;
use std::path::Path;

fuzz_target!(|bytes: &[u8]| {
    let length = bytes.len() as u64;
    if let Ok(reader) = monogrid_datasets::ScansReader::new(bytes, length, Path::new("fuzz")) {
        for scan in reader.flatten() {
            assert!(scan.points.len() * 16 <= bytes.len());
        }
    }
});
