//! Images and depth images of every format.
#![no_main]

use libfuzzer_sys::fuzz_target;
use monogrid_datasets::{decode_depth, decode_gray};
use std::path::Path;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(image) = decode_gray(bytes, Path::new("fuzz")) {
        assert!(image.as_slice().iter().all(|v| (0.0..=255.001).contains(v)));
    }
    let _ = decode_depth(bytes, 1000.0, Path::new("fuzz"));
});
