//! Calibrations in all their formats: those of a real camera, or an error.
#![no_main]

use libfuzzer_sys::fuzz_target;
use monogrid_datasets::Calibration;
use std::path::Path;

fuzz_target!(|text: &str| {
    for name in ["c.txt", "c.toml", "c.yaml"] {
        if let Ok(calibration) = Calibration::parse(text, Path::new(name), Some((640, 480))) {
            assert!(calibration.camera.pinhole.fx > 0.0);
        }
    }
});
