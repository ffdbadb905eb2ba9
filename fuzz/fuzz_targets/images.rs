//! Images and depth images of every format, and the same as masks of themselves.
#![no_main]

use libfuzzer_sys::fuzz_target;
use monogrid_datasets::{decode_depth, decode_gray};
use monogrid_image::{Resize, fill_masked, resize_mask};
use std::path::Path;

/// Pixels of images that are filled: more of them take long and show nothing new.
const MAX_FILLED: usize = 1 << 16;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(mut image) = decode_gray(bytes, Path::new("fuzz")) {
        let in_range = |v: &f32| (0.0..=255.001).contains(v);
        assert!(image.as_slice().iter().all(in_range));
        let (width, height) = (image.width(), image.height());
        if width * height <= MAX_FILLED {
            let mask = image.map(|v| if v < 128.0 { 0 } else { 255 });
            let other = Resize {
                width: height,
                height: width,
            };
            fill_masked(&mut image, &mask);
            let turned = resize_mask(&mask, other);
            fill_masked(&mut image, &resize_mask(&turned, Resize { width, height }));
            assert!(image.as_slice().iter().all(in_range));
        }
    }
    let _ = decode_depth(bytes, 1000.0, Path::new("fuzz"));
});
