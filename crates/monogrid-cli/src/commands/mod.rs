//! The commands.

pub mod batch;
pub mod calibrate;
pub mod cameras;
pub mod check;
pub mod demo;
pub mod distances;
pub mod evaluate;
pub mod evaluate_map;
pub mod info;
pub mod map;
pub mod merge_runs;
pub mod posed_depth;
pub mod report;
pub mod rescale;
pub mod run;
pub mod shell;
pub mod slice;
pub mod synth;
pub mod tools;
pub mod truth;
pub mod view;

use monogrid_app::process::{bytes, use_threads, warn};
use monogrid_worlds::MeshModel;
use std::path::Path;

/// What is said of a mesh or a cloud of which something was left out.
pub fn left_out(model: &MeshModel, source: &Path) -> Option<String> {
    let count = model.left_out;
    (count > 0).then(|| {
        format!(
            "{}: {count} points whose coordinates are not finite are left out",
            source.display()
        )
    })
}
