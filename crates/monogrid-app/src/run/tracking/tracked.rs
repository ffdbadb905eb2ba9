//! What a run found.

use super::frames::FrameRow;
use super::moments::Moment;
use monogrid_calibration::CameraMotion;
use monogrid_pipeline::Finished;
use monogrid_slam::PoseSource;
use std::time::Duration;

/// Why a run ended before its last frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum EarlyEnd {
    /// The user interrupted it.
    Interrupted,
    /// So many frames in a row were unreadable, too many or all that there are; the reason of the
    /// last.
    Unreadable(usize, String),
    /// The source could not be read any further, and why.
    BrokeOff(String),
    /// A part of the program failed, and why.
    Failed(String),
}

/// CPU time by what it was used for.
#[derive(Clone, Copy, Debug, Default)]
pub struct CpuTimes {
    /// Tracking, depth and graph together.
    pub slam: Duration,
    /// Occupancy maps.
    pub mapping: Duration,
    /// Decoding and undistortion.
    pub reading: Duration,
    /// Recording and pictures of keyframes.
    pub recording: Duration,
}

/// Everything that a run found, but for its final maps.
#[derive(Debug)]
pub struct Tracked {
    /// Every frame.
    pub rows: Vec<FrameRow>,
    /// Pictures of where it went wrong.
    pub moments: Vec<Moment>,
    /// The system, the final trajectory and poses of keyframes, and the maps as they grew.
    pub run: Finished,
    /// CPU time.
    pub cpu: CpuTimes,
    /// Why it ended early.
    pub early_end: Option<EarlyEnd>,
    /// What was found against the calibration, in sentences.
    pub warnings: Vec<String>,
    /// Time from the first row of an image to the last, given or found, ms.
    pub readout_ms: f64,
    /// How the camera moves, where that is why there is no map.
    pub no_map: Option<CameraMotion>,
}

impl Tracked {
    /// Frames with a pose in the map that comes from this.
    pub fn num_from(&self, source: PoseSource) -> usize {
        let poses = self.run.trajectory.iter();
        poses.filter(|pose| pose.source == source).count()
    }
}
