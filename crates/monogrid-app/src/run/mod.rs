//! A run: frames in, trajectory, keyframes and maps out.
//!
//! What calls what, in the order of time:
//!
//! ```text
//! the commands run and demo
//!   -> whole::run_all
//!        -> tracking          monogrid_pipeline:
//!                             reader -> tracking -> recorder  (recording, pictures of keyframes)
//!                                                -> mapper    (maps that grow)
//!                                                -> live      (`--view`)
//!        -> sensed, align     the frame of the results
//!        -> outputs           tables, final maps and their pictures
//!        -> summary, report   summary.json, report.html
//!   -> conclusion::conclude      what the user reads, the exit code
//! ```
//!
//! The threads are those of the pipeline; the recorder is its listener. No result depends on a
//! clock: they are the same for any number of threads (`--realtime`, which drops frames, excepted).

pub mod align;
pub mod conclusion;
mod live;
pub mod outputs;
pub mod report;
pub mod sensed;
pub mod sessions;
pub mod summary;
pub mod tracking;
mod trust;
pub mod whole;

pub use live::View;
pub use tracking::memory_limit::MemoryLimit;
pub use tracking::submaps::SubmapPolicy;

use crate::config::RunConfig;
use crate::output::OutputFile;
use monogrid_image::GrayImage;
use monogrid_pipeline::Pace;
use monogrid_slam::Purpose;
use sessions::{Continued, Earlier};

/// What a run is asked for, besides its input.
#[derive(Debug)]
pub struct RunSettings {
    /// All settings.
    pub config: RunConfig,
    /// Depth (metres) to start with, and the index of the frame it belongs to.
    pub seed_depth: Option<(usize, GrayImage)>,
    /// The map to go on with.
    pub continued: Option<Continued>,
    /// How fast frames are read.
    pub pace: Pace,
    /// Threads for the final maps.
    pub threads: usize,
    /// Whether to show a progress bar.
    pub show_progress: bool,
    /// Who looks at the run while it goes on.
    pub view: Option<View>,
    /// Memory that the process should stay within.
    pub memory_limit: Option<MemoryLimit>,
    /// When finished keyframes are closed into submaps, where they are wanted.
    pub submaps: Option<SubmapPolicy>,
    /// Where to write the run as messages.
    pub mcap: Option<OutputFile>,
}

impl RunSettings {
    /// A run that starts from nothing, takes its time and shows no progress.
    pub fn new(config: RunConfig, threads: usize) -> Self {
        Self {
            config,
            seed_depth: None,
            continued: None,
            pace: Pace::Taken,
            threads,
            show_progress: false,
            view: None,
            memory_limit: None,
            submaps: None,
            mcap: None,
        }
    }

    /// Whether the map of an earlier run is only used, not changed.
    pub fn is_localise_only(&self) -> bool {
        let purpose = self.continued.as_ref().map(|continued| continued.purpose);
        purpose == Some(Purpose::LocaliseOnly)
    }

    fn earlier(&self) -> Option<&Earlier> {
        self.continued.as_ref().map(|continued| &continued.earlier)
    }
}
