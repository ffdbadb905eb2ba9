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
use monogrid_datasets::DatasetError;

/// A file of a run that cannot be read.
fn unreadable(error: &DatasetError) -> Failure {
    Failure::input(format!(
        "{error}; expected the output folder of a finished run"
    ))
}
