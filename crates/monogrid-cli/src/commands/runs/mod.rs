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
use std::path::Path;

/// A file of a run that cannot be read.
fn unreadable(path: &Path, error: &std::io::Error) -> Failure {
    Failure::input(format!(
        "{} cannot be read: {error}; expected the output folder of a finished run",
        path.display()
    ))
}
