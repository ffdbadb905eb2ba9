//! What can go wrong, in words that say what to do.

use std::path::PathBuf;

/// Errors of maps, configurations and map files.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MapError {
    /// The cell size is not a positive finite number.
    #[error("map resolution is {value}, expected a positive finite cell size in map units")]
    Resolution {
        /// The rejected value.
        value: f64,
    },
    /// The clamps are not storable or not on both sides of zero.
    #[error("log-odds clamps are {min} and {max}, expected -7.99 <= min < 0 < max <= 7.99")]
    Clamp {
        /// Lower clamp found.
        min: f32,
        /// Upper clamp found.
        max: f32,
    },
    /// The occupancy threshold is not a probability.
    #[error("occupancy threshold is {value}, expected a probability between 0 and 1")]
    Threshold {
        /// The rejected value.
        value: f64,
    },
    /// A field of the integration or sensor configuration is outside its range.
    #[error("{field} is {value}, allowed {allowed}")]
    Config {
        /// Name of the field.
        field: &'static str,
        /// The rejected value.
        value: f64,
        /// The documented range.
        allowed: &'static str,
    },
    /// A scan cannot be used at all.
    #[error("scan {id}: {reason}")]
    Scan {
        /// Id of the scan.
        id: u32,
        /// What is wrong and what was expected.
        reason: String,
    },
    /// The change would take more memory than allowed; the map is as before.
    #[error(
        "the map needs up to {needed_bytes} bytes but its budget is {budget_bytes}: raise the \
         budget, coarsen the resolution or crop the map"
    )]
    MemoryBudget {
        /// Upper bound of the memory after the change.
        needed_bytes: usize,
        /// The configured budget.
        budget_bytes: usize,
    },
    /// The cells are so small that a single scan would fill the memory; nothing was done.
    #[error(
        "cells of {cell} are too fine: a single scan would need {needed_gb:.1} GB, the map may \
         have {budget_gb:.1} GB; cells of {fitting_cell} would fit, or allow more memory, or \
         shorten the range"
    )]
    TooFine {
        /// Memory that the scan would need, 10^9 bytes.
        needed_gb: f64,
        /// The configured budget, 10^9 bytes.
        budget_gb: f64,
        /// Edge of a cell, map units.
        cell: f64,
        /// Edge with which maps of such scans are likely to fit.
        fitting_cell: f64,
    },
    /// The map is too large to be seen from above as a whole.
    #[error(
        "the map is {width} x {height} cells seen from above, expected at most {most} in all: take \
         a part of it (`monogrid crop`), or other heights"
    )]
    GridSize {
        /// Cells along x.
        width: i64,
        /// Cells along y.
        height: i64,
        /// Most cells.
        most: i64,
    },
    /// Maps of different cell size cannot be combined cell by cell.
    #[error("the maps have cells of {left} and {right}: resample one of them first")]
    ResolutionMismatch {
        /// Cell size of the first map.
        left: f64,
        /// Cell size of the second map.
        right: f64,
    },
    /// OctoMap's 16-bit keys cannot address a cell.
    #[error(
        "cell {cell:?} is beyond OctoMap's range of 32768 cells from the origin: crop or coarsen \
         the map"
    )]
    OutOfOctomapRange {
        /// A cell out of range.
        cell: [i32; 3],
    },
    /// A file is not what it should be.
    #[error("not a readable {format} file: {reason}")]
    Format {
        /// The expected format.
        format: &'static str,
        /// What was found instead.
        reason: String,
    },
    /// A file that is no map at all.
    #[error("not a map: it begins neither as an OctoMap .ot or .bt file nor as a .mgo file")]
    NotAMap,
    /// A file name that asks for no format of a map.
    #[error(
        "cannot tell the map format from {}: expected a name that ends in {expected}",
        path.display()
    )]
    Name {
        /// The name.
        path: PathBuf,
        /// The endings that are understood.
        expected: String,
    },
    /// Reading or writing failed.
    #[error("{action} failed: {source}")]
    Io {
        /// What was being done.
        action: &'static str,
        /// The cause.
        source: std::io::Error,
    },
    /// Reading or writing a named file failed.
    #[error("{action} {path:?} failed: {source}")]
    File {
        /// What was being done.
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
}

impl MapError {
    pub(crate) fn format(format: &'static str, reason: impl Into<String>) -> Self {
        Self::Format {
            format,
            reason: reason.into(),
        }
    }

    /// What became of reading or writing, of which `action` says what was being done.
    pub(crate) fn io(action: &'static str) -> impl FnOnce(std::io::Error) -> Self {
        move |source| Self::Io { action, source }
    }

    /// Fails unless a setting is in its documented range.
    pub(crate) fn unless(
        is_allowed: bool,
        field: &'static str,
        value: impl Into<f64>,
        allowed: &'static str,
    ) -> Result<(), Self> {
        if is_allowed {
            return Ok(());
        }
        let value = value.into();
        Err(Self::Config {
            field,
            value,
            allowed,
        })
    }
}
