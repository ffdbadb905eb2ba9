//! What passes between the threads of the node.

use futures::channel::oneshot;
use monogrid_geometry::{Camera, Pinhole};
use monogrid_messages::builtin_interfaces::Time;
use monogrid_messages::sensor_msgs::{CompressedImage, Image};
use monogrid_messages::std_srvs::TriggerResponse;
use monogrid_slam::mapping::MapReader;
use monogrid_slam::{FrameReport, KeptKeyframe, PoseSnapshot, TrajectoryPose};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Work that may wait for tracking: enough images to bridge the making of a keyframe, few enough to stay near the present.
pub const WORK_AHEAD: usize = 4;

/// Whom to answer when it is done.
pub type Answer = oneshot::Sender<TriggerResponse>;

/// What a service says that did its work, or could not.
#[must_use]
pub fn response(result: Result<String, String>) -> TriggerResponse {
    TriggerResponse {
        success: result.is_ok(),
        message: result.unwrap_or_else(|why| why),
    }
}

/// An image as it came.
#[derive(Debug)]
pub enum Picture {
    /// Pixels.
    Plain(Image),
    /// A file.
    Compressed(CompressedImage),
}

/// What the tracking thread is asked for.
#[derive(Debug)]
pub enum Work {
    /// The calibration for the next world that begins, or why there is none.
    Camera(Result<Camera, String>),
    /// The next image.
    Picture(Picture),
    /// A unit of the world is so many metres.
    Scale(f64),
    /// Everything begins again.
    Reset(Answer),
    /// The map is written to files.
    Save(Answer),
}

/// What the thread of the maps is told.
pub enum News {
    /// A world begins: its number, its maps, and the pinhole of its keyframes.
    Begun(u32, MapReader, Pinhole),
    /// What became of an image.
    Tracked(Box<Tracked>),
    /// Why an image was of no use.
    Unusable(String),
    /// Nothing can be tracked yet, and why.
    Waiting(String),
    /// A keyframe of a world was finished.
    Keyframe(u32, KeptKeyframe, Arc<PoseSnapshot>),
    /// A unit of the world is so many metres.
    Scale(f64),
    /// The world is given up.
    Ended,
    /// The map is written to files, with the trajectory as it is known now.
    Save(Answer, Vec<TrajectoryPose>),
}

/// An image that was tracked.
pub struct Tracked {
    /// Its time.
    pub stamp: Time,
    /// What became of it.
    pub report: FrameReport,
    /// All keyframes as they are now.
    pub poses: Arc<PoseSnapshot>,
    /// Messages of it that could not be sent.
    pub unsent: usize,
}

/// What happened to the images, for diagnostics.
#[derive(Debug, Default)]
pub struct Counts {
    /// Received.
    pub received: Count,
    /// Lost between the camera and here: gaps in the numbers of their sender.
    pub lost: Count,
    /// Dropped since as many as may wait were waiting.
    pub dropped: Count,
}

/// A number that one thread counts and others read.
#[derive(Debug, Default)]
pub struct Count(AtomicU64);

impl Count {
    /// Counts some more.
    pub fn add(&self, more: u64) {
        self.0.fetch_add(more, Ordering::Relaxed);
    }

    /// How many there are.
    #[must_use]
    pub fn get(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}
