//! The figures of a sweep.

mod curves;
mod roc;

pub use curves::{distributions, growth, score_over_parameter};
pub use roc::{RocPolicy, roc_of_best, roc_of_equal_area, roc_over_parameter};

use super::result::RecordingResult;
use super::thesis::{ANDERT, THRUN};
use monogrid_report::svg::Plot;

/// A named group of plots that belong together.
#[derive(Debug)]
pub struct Figure {
    /// Start of the names of its files.
    pub file: String,
    /// Title.
    pub title: String,
    /// What the reader must know.
    pub note: String,
    /// The plots.
    pub plots: Vec<Plot>,
}

/// All figures of a recording that were compared with a truth.
pub fn compared(result: &RecordingResult) -> Vec<Figure> {
    let mut figures = vec![
        score_over_parameter(result, &THRUN),
        score_over_parameter(result, &ANDERT),
    ];
    for policy in [RocPolicy::Known, RocPolicy::Observed] {
        figures.push(roc_over_parameter(result, &THRUN, policy));
        figures.push(roc_over_parameter(result, &ANDERT, policy));
        figures.push(roc_of_best(result, policy));
    }
    figures.extend(roc_of_equal_area(result));
    figures.extend(distributions(result));
    figures
}
