//! What passes between the threads of the node.

use crate::wheels::Scale;
use futures::channel::mpsc::UnboundedSender;
use futures::channel::oneshot;
use monogrid_app::run::tracking::recorder::MapNow;
use monogrid_geometry::{Camera, Pinhole, Se3, Sim3};
use monogrid_inertial::ImuSample;
use monogrid_mapping::MapReader;
use monogrid_messages::builtin_interfaces::Time;
use monogrid_messages::sensor_msgs::{CompressedImage, Image};
use monogrid_messages::std_srvs::TriggerResponse;
use monogrid_occupancy::MapError;
use monogrid_slam::{FrameReport, KeptKeyframe, PoseSnapshot, TrajectoryPose};
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, OnceLock};

/// Images that may wait for tracking: enough to bridge the making of a keyframe, few enough to stay
/// near the present.
pub const IMAGES_AHEAD: usize = 4;

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
    /// The next reading of an inertial sensor.
    Reading(ImuSample),
    /// Where the robot's own odometry says that it is: time, ns, and odom_from_base, m.
    Odometry(i64, Se3),
    /// A unit of the world is so many metres, as somebody tells; or nobody tells it any more.
    Scale(Option<f64>),
    /// Everything begins again, and why.
    BeginAgain(String),
    /// Images are taken, as at the beginning.
    Start(Answer),
    /// Images are not taken any more; the map stays.
    Stop(Answer),
    /// Everything begins again, as somebody asks.
    Reset(Answer),
    /// The same in a map that was saved.
    Load(PathBuf, Answer),
    /// The map is written to files.
    Save(Answer),
}

/// A way to the tracking thread, on which only so many images wait; everything else always finds
/// room, in the order in which it came.
#[must_use]
pub fn way_to_work() -> (WorkSender, WorkReceiver) {
    let (sender, receiver) = channel();
    let images = Arc::new(AtomicUsize::new(0));
    let waiting = Arc::clone(&images);
    (
        WorkSender { sender, waiting },
        WorkReceiver { receiver, images },
    )
}

/// The end at which work comes in.
#[derive(Clone, Debug)]
pub struct WorkSender {
    sender: Sender<Work>,
    waiting: Arc<AtomicUsize>,
}

impl WorkSender {
    /// Hands on an image; `false` where as many wait as may.
    #[must_use]
    pub fn offer(&self, picture: Picture) -> bool {
        if self.waiting.fetch_add(1, Ordering::Relaxed) >= IMAGES_AHEAD {
            self.waiting.fetch_sub(1, Ordering::Relaxed);
            return false;
        }
        // a node that is ending takes nothing
        let _ = self.sender.send(Work::Picture(picture));
        true
    }

    /// Hands on anything else.
    ///
    /// # Errors
    /// When nobody works any more.
    pub fn send(&self, work: Work) -> Result<(), String> {
        let sent = self.sender.send(work);
        sent.map_err(|_| "the node is ending".to_owned())
    }
}

/// The end at which it is done.
#[derive(Debug)]
pub struct WorkReceiver {
    receiver: Receiver<Work>,
    images: Arc<AtomicUsize>,
}

impl WorkReceiver {
    /// The next work; `None` when nobody can ask for any more.
    #[must_use]
    pub fn next(&self) -> Option<Work> {
        let work = self.receiver.recv().ok()?;
        if matches!(work, Work::Picture(_)) {
            self.images.fetch_sub(1, Ordering::Relaxed);
        }
        Some(work)
    }
}

/// Ends the node with a thread of it: they end after the node, unless they panic.
#[derive(Debug)]
pub struct AtEnd(UnboundedSender<()>);

impl AtEnd {
    /// Tells this when the thread ends.
    #[must_use]
    pub fn new(stop: &UnboundedSender<()>) -> Self {
        Self(stop.clone())
    }

    /// Does the work of the thread.
    pub fn after(self, work: impl FnOnce()) {
        work();
    }
}

impl Drop for AtEnd {
    fn drop(&mut self) {
        // whoever ends the node needs not be told
        let _ = self.0.unbounded_send(());
    }
}

/// What the thread of the maps is told.
pub enum News {
    /// A world begins.
    Begun(Box<Begun>),
    /// What became of an image.
    Tracked(Box<Tracked>),
    /// Why an image was of no use.
    Unusable(String),
    /// Nothing can be tracked yet, and why.
    Waiting(String),
    /// A keyframe of a world was finished.
    Keyframe(u32, KeptKeyframe, Arc<PoseSnapshot>),
    /// How long a unit of the world is, where somebody tells it or wheels have shown it.
    Scale(Option<Scale>),
    /// The world is given up.
    Ended,
    /// The map is written to files, with what is known now, if anything is.
    Save(Answer, Option<Box<Known>>),
}

/// A world that begins.
pub struct Begun {
    /// Its number.
    pub number: u32,
    /// Where its maps will arrive: those of a large map that was loaded take a while.
    pub coming: Receiver<Result<MapReader, MapError>>,
    /// Where they are put then.
    pub maps: Arc<OnceLock<MapReader>>,
    /// The frame of its maps, before an inertial sensor has a say.
    pub map_from_world: Sim3,
    /// The pinhole of its keyframes.
    pub pinhole: Pinhole,
    /// Of each keyframe that it has already, the time of the first image since.
    pub finished: Vec<Time>,
}

/// What is known of a world.
pub struct Known {
    /// Where the camera was.
    pub trajectory: Vec<TrajectoryPose>,
    /// What a later run goes on with.
    pub map: MapNow,
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

/// What happened to the images, for diagnostics: one thread counts, others read.
#[derive(Debug, Default)]
pub struct Counts {
    /// Received.
    pub received: AtomicU64,
    /// Lost between the camera and here: gaps in the numbers of their sender.
    pub lost: AtomicU64,
    /// Dropped since as many as may wait were waiting.
    pub dropped: AtomicU64,
    /// Readings of the inertial sensor.
    pub readings: AtomicU64,
    /// Readings of the robot's own odometry.
    pub odometry: AtomicU64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_that_dies_ends_the_node() {
        let (stop, mut stopped) = futures::channel::mpsc::unbounded();
        let ends = AtEnd::new(&stop);
        let thread = std::thread::spawn(|| ends.after(|| panic!("a panic that a test wants")));
        assert!(thread.join().is_err());
        assert!(stopped.try_recv().is_ok(), "nobody was told");
    }

    #[test]
    fn images_find_room_for_a_few_and_everything_else_always() {
        let (sender, receiver) = way_to_work();
        let offer = || sender.offer(Picture::Plain(Image::default()));
        assert!((0..IMAGES_AHEAD).all(|_| offer()));
        assert!(!offer() && !offer());
        for _ in 0..100 {
            sender.send(Work::Scale(None)).unwrap();
        }
        assert!(matches!(receiver.next(), Some(Work::Picture(_))));
        assert!(offer() && !offer(), "there is room for one again");
        drop(sender);
        let rest: Vec<Work> = std::iter::from_fn(|| receiver.next()).collect();
        assert_eq!(rest.len(), IMAGES_AHEAD + 100);
        assert!(matches!(rest.last(), Some(Work::Picture(_))), "in order");
    }
}
