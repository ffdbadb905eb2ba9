//! Pose graphs (`.g2o`).
#![no_main]

use libfuzzer_sys::fuzz_target;
use monogrid_graph::{RobustKernel, g2o};

fuzz_target!(|text: &str| {
    let _ = g2o::read(text, RobustKernel::None);
});
