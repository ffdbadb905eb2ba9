//! What a run reads: cameras, calibrations, a look at a source, rendered data sets.

pub mod calibrate;
pub mod cameras;
pub mod check;
pub mod synth;
