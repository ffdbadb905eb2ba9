//! What a run is asked for, besides its input.

use super::live::View;
use super::sessions::{Continued, Earlier};
use super::tracking::memory_limit::MemoryLimit;
use super::tracking::submaps::SubmapPolicy;
use crate::config::RunConfig;
use crate::input::depth_images::FrameDepths;
use crate::output::OutputFile;
use monogrid_pipeline::Pace;
use monogrid_slam::Purpose;

/// What a run is asked for, besides its input.
#[derive(Debug)]
pub struct RunSettings {
    /// All settings.
    pub config: RunConfig,
    /// Depth images of frames; the run begins with the first that has one.
    pub depth: Option<FrameDepths>,
    /// The map to go on with.
    pub continued: Option<Continued>,
    /// How fast frames are read.
    pub pace: Pace,
    /// Threads for the final maps.
    pub threads: usize,
    /// Whether to show a progress bar.
    pub show_progress: bool,
    /// The live view of the run, where one is asked for.
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
            depth: None,
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

    pub(super) fn earlier(&self) -> Option<&Earlier> {
        self.continued.as_ref().map(|continued| &continued.earlier)
    }
}
