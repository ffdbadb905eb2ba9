//! Runs, and what is done with the folder of one or of many.

pub mod batch;
pub mod demo;
pub mod export;
pub mod merge_runs;
pub mod report;
pub mod rescale;
pub mod run;
pub mod view;

use monogrid_app::process::failure::Failure;
use monogrid_datasets::{DatasetError, read_file};
use std::path::Path;

/// The semi-dense cloud of a run.
const CLOUD: &str = "cloud.ply";
/// Largest cloud that is read.
const MAX_CLOUD_BYTES: u64 = 1 << 32;

/// What the file of the semi-dense cloud holds; `None` where it is not there or cannot be read.
fn cloud_of(run: &Path) -> Option<Vec<u8>> {
    read_file(&run.join(CLOUD), MAX_CLOUD_BYTES).ok()
}

/// A file of a run that cannot be read.
fn unreadable(error: &DatasetError) -> Failure {
    Failure::input(format!(
        "{error}; expected the output folder of a finished run"
    ))
}
