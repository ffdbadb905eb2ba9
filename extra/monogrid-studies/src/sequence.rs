//! A sequence with its true poses and depth, as the examples read it.

use monogrid_datasets::{
    Dataset, DepthRegistration, SourceOptions, TimedPose, read_depth, read_gray, read_trajectory,
};
use monogrid_geometry::{Pinhole, Se3};
use monogrid_image::{GrayImage, Undistorter, WorkingSize};
use monogrid_slam::{Slam, SlamConfig};
use std::path::Path;

/// A folder with images, and what is known to be true about them.
pub struct Sequence {
    /// The folder.
    pub dataset: Dataset,
    /// Makes working images of its images.
    pub undistorter: Undistorter,
    /// Empty where the folder has no poses.
    pub truth: Vec<TimedPose>,
    /// Units per metre of the depth images, and their way into the working images.
    depth: Option<(f64, DepthRegistration)>,
}

impl Sequence {
    /// Opens a folder, with working images of the usual size.
    pub fn open(folder: impl AsRef<Path>) -> Self {
        Self::open_with_size(folder, WorkingSize::AUTOMATIC)
    }

    /// Opens a folder, with working images of a size.
    pub fn open_with_size(folder: impl AsRef<Path>, size: WorkingSize) -> Self {
        let dataset = Dataset::open(folder.as_ref(), SourceOptions::default()).unwrap();
        let camera = dataset.calibration(None).unwrap().unwrap().camera;
        let undistorter = Undistorter::new(&camera, size, None);
        let (width, height) = undistorter.size();
        let calibration = dataset.depth_calibration().unwrap();
        let depth = calibration.map(|c| {
            let registration = DepthRegistration::new(&c, undistorter.pinhole(), width, height);
            (c.units_per_metre, registration)
        });
        let poses = dataset.ground_truth.as_ref();
        Self {
            truth: poses.map_or_else(Vec::new, |path| read_trajectory(path).unwrap()),
            undistorter,
            depth,
            dataset,
        }
    }

    /// The camera of the working images.
    pub fn pinhole(&self) -> &Pinhole {
        self.undistorter.pinhole()
    }

    /// A system for the working images.
    pub fn system(&self, config: SlamConfig, seed: u64) -> Slam {
        let mask = self.undistorter.mask().clone();
        Slam::new(config, *self.pinhole(), mask, seed).unwrap()
    }

    /// The working image of a frame.
    pub fn image(&self, frame: usize) -> GrayImage {
        let raw = read_gray(&self.dataset.frames[frame].path).unwrap();
        self.undistorter.apply(&raw).unwrap()
    }

    /// The true pose nearest in time.
    pub fn true_pose(&self, frame: usize) -> Se3 {
        let time = self.dataset.frames[frame].timestamp_ns;
        let distance = |p: &&TimedPose| (p.timestamp_ns - time).abs();
        let nearest = self.truth.iter().min_by_key(distance);
        nearest.unwrap().world_from_camera
    }

    /// True depth in the working camera, metres, of the frame of a time.
    pub fn true_depth(&self, timestamp_ns: i64) -> Option<GrayImage> {
        let (units, registration) = self.depth.as_ref()?;
        let entry = self.dataset.depth_of_frame(timestamp_ns)?;
        registration.register(&read_depth(&entry.path, *units).unwrap())
    }

    /// The true poses as the evaluation takes them.
    pub fn stamped_truth(&self) -> Vec<(i64, Se3)> {
        let truth = self.truth.iter();
        truth
            .map(|p| (p.timestamp_ns, p.world_from_camera))
            .collect()
    }
}
