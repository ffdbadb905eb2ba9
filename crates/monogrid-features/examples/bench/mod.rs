//! What the examples that measure share: arguments, a sequence with its truth, time of work.
#![allow(dead_code, reason = "each example uses a part")]

use monogrid_datasets::{
    Dataset, DepthRegistration, SourceOptions, TimedPose, read_depth, read_gray, read_trajectory,
};
use monogrid_geometry::Se3;
use monogrid_image::{GrayImage, Pyramid, Undistorter, WorkingSize};
use std::collections::BTreeMap;
use std::fmt::Debug;
use std::path::Path;
use std::str::FromStr;
use std::time::Instant;

/// `name=value` arguments.
pub struct Options(pub BTreeMap<String, String>);

impl Options {
    pub fn read(args: impl Iterator<Item = String>) -> Self {
        let pairs =
            args.filter_map(|a| a.split_once('=').map(|(k, v)| (k.to_owned(), v.to_owned())));
        Self(pairs.collect())
    }

    /// A number, or its usual value.
    pub fn number<T: FromStr<Err: Debug>>(&self, name: &str, usual: T) -> T {
        self.0.get(name).map_or(usual, |v| v.parse().unwrap())
    }
}

/// A folder with images and true poses, and depth images where it has them.
pub struct Sequence {
    pub dataset: Dataset,
    pub undistorter: Undistorter,
    truth: Vec<TimedPose>,
    /// Units per metre of the depth images, and their way into the working images.
    depth: Option<(f64, DepthRegistration)>,
}

impl Sequence {
    pub fn open(folder: impl AsRef<Path>) -> Self {
        let dataset = Dataset::open(folder.as_ref(), SourceOptions::default()).unwrap();
        let camera = dataset.calibration(None).unwrap().unwrap().camera;
        let undistorter = Undistorter::new(&camera, WorkingSize::Automatic, None);
        let (width, height) = undistorter.size();
        let calibration = dataset.depth_calibration().unwrap();
        let depth = calibration.map(|c| {
            let registration = DepthRegistration::new(&c, undistorter.pinhole(), width, height);
            (c.units_per_metre, registration)
        });
        Self {
            truth: read_trajectory(dataset.ground_truth.as_ref().unwrap()).unwrap(),
            undistorter,
            depth,
            dataset,
        }
    }

    /// The working image of a frame.
    pub fn pyramid(&self, frame: usize) -> Pyramid {
        let image = read_gray(&self.dataset.frames[frame].path).unwrap();
        Pyramid::new(self.undistorter.apply(&image).unwrap(), 4)
    }

    /// The true pose of a frame, if one of about its time is known.
    pub fn true_pose(&self, frame: usize) -> Option<Se3> {
        let time = self.dataset.frames[frame].timestamp_ns;
        let distance = |p: &&TimedPose| p.timestamp_ns.abs_diff(time);
        let nearest = self.truth.iter().min_by_key(distance)?;
        (distance(&nearest) <= 15_000_000).then_some(nearest.world_from_camera)
    }

    /// True depth of a frame in the working camera, if it has a depth image.
    pub fn true_depth(&self, frame: usize) -> Option<GrayImage> {
        let time = self.dataset.frames[frame].timestamp_ns;
        let entry = self.dataset.depth_of_frame(time)?;
        let (units, registration) = self.depth.as_ref().unwrap();
        let raw = read_depth(&entry.path, *units).unwrap();
        Some(registration.register(&raw).unwrap())
    }
}

/// Time that this thread has worked, where the system tells; else wall time.
pub fn seconds_of_work() -> f64 {
    static START: std::sync::OnceLock<Instant> = std::sync::OnceLock::new();
    let wall = START.get_or_init(Instant::now).elapsed().as_secs_f64();
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    let first = text.split_whitespace().next();
    first
        .and_then(|ns| ns.parse::<f64>().ok())
        .map_or(wall, |ns| 1e-9 * ns)
}
