//! A frame on its way from the reader to tracking.

use crate::shutter::Rectification;
use crate::unusable::Unusable;
use monogrid_image::GrayImage;
use monogrid_slam::DepthInput;
use std::time::Instant;

/// A frame that was read.
#[derive(Debug)]
pub struct ReadFrame {
    /// Number in the source.
    pub index: usize,
    /// Time, nanoseconds.
    pub timestamp_ns: i64,
    /// The working image; `None` for one that was dropped at [`Pace::Real`](crate::Pace::Real).
    pub image: Option<Result<GrayImage, Unusable>>,
    /// [`SourceFrame::depth`](crate::SourceFrame::depth).
    pub depth: Option<Result<DepthInput, Unusable>>,
    /// The rolling shutter that was taken out of it: time from the first row to the last, ms.
    pub readout_ms: f64,
    /// How that was done, where it was.
    pub rectification: Option<Rectification>,
    /// At [`Pace::Real`](crate::Pace::Real) when the camera had it: as long after the first frame
    /// was decoded as their times say.
    pub due: Option<Instant>,
}
