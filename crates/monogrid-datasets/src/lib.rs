//! Image sources, calibration and trajectory files, recordings and synthetic worlds.
#![deny(missing_docs)]

pub mod synth;
