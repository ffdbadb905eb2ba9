//! What became of each frame of the source.

use monogrid_slam::{FrameReport, TrackingState};
use serde::{Deserialize, Serialize};

/// What became of a frame.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub enum FrameFate {
    /// It was given to tracking.
    Processed(Box<FrameReport>),
    /// It could not be used.
    Skipped(String),
    /// It repeats the image before.
    Repeated,
    /// It came while the program was behind.
    Dropped,
}

/// One frame of the source and what became of it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct FrameRow {
    /// Index in the source.
    pub index: usize,
    /// Time, nanoseconds.
    pub timestamp_ns: i64,
    /// What became of it.
    pub fate: FrameFate,
    /// Where frames come at their own pace: from when the camera had it until that was known, ms.
    pub latency_ms: Option<f32>,
}

impl FrameRow {
    /// The report of a processed frame.
    pub fn report(&self) -> Option<&FrameReport> {
        match &self.fate {
            FrameFate::Processed(report) => Some(report),
            _ => None,
        }
    }

    /// Whether there was a map and the frame has no pose in it.
    pub fn has_no_place(&self) -> bool {
        let placeless = [TrackingState::Lost, TrackingState::Fragment];
        self.report()
            .is_some_and(|report| placeless.contains(&report.state))
    }
}
