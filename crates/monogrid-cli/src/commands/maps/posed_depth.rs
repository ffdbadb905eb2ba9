//! A folder with depth images and a pose for each of them.

use monogrid_app::input::depth_images::registered_depth;
use monogrid_app::process::failure::{Classify, Failure};
use monogrid_datasets::{
    Dataset, DepthCalibration, DepthEntry, DepthRegistration, PixelBudget, SourceOptions,
    TimedPose, read_gray, read_trajectory,
};
use monogrid_geometry::{Pinhole, Se3};
use monogrid_image::{GrayImage, Undistorter, WorkingSize};
use std::path::Path;
use std::sync::{Mutex, PoisonError};

/// Times farther apart than this do not belong together.
const MAX_POSE_DISTANCE_NS: u64 = 20_000_000;

/// Mapping a depth image takes so many times as long as reading an image.
const DEPTH_COST: usize = 8;

/// Depth images, their calibration and the trajectory of the camera.
pub struct PosedDepthFolder {
    /// The folder; what to tell the user about it, and its depth images with or without pose.
    pub dataset: Dataset,
    calibration: DepthCalibration,
    registration: DepthRegistration,
    poses: Vec<TimedPose>,
    budget: Mutex<PixelBudget>,
    /// Intrinsics of the depth that [`Self::read`] returns.
    pub pinhole: Pinhole,
}

impl PosedDepthFolder {
    /// Opens a folder in TUM layout. Depth is brought into the colour camera where there is one,
    /// since poses are those of the colour camera.
    pub fn open(
        folder: &Path,
        depth_calibration_file: Option<&Path>,
        trajectory: Option<&Path>,
    ) -> Result<Self, Failure> {
        let dataset = Dataset::open(folder, SourceOptions::default()).bad_input()?;
        if dataset.depths.is_empty() {
            return Err(Failure::input(format!(
                "{} has no depth images: expected depth.txt and depth/",
                folder.display()
            )));
        }
        let colour = dataset.calibration(None).or_else(|_| {
            // not every calibration says the size of its images
            let first = dataset.frames.first().map(|frame| read_gray(&frame.path));
            let size = first.transpose()?;
            dataset.calibration(size.map(|image| (image.width(), image.height())))
        });
        let colour = colour.bad_input()?.map(|calibration| calibration.camera);
        let own = match depth_calibration_file {
            Some(path) => DepthCalibration::read(path).map(Some),
            None => dataset.depth_calibration(),
        };
        let registered = || colour.map(|colour| dataset.registered_depth(colour));
        let Some(calibration) = own.bad_input()?.or_else(registered) else {
            return Err(Failure::input(format!(
                "no calibration in {}: expected calibration_depth.txt or calibration.txt, or \
                 --depth-calibration",
                dataset.root.display()
            )));
        };
        let camera = colour.unwrap_or(calibration.camera);
        let poses = match trajectory {
            Some(path) => read_trajectory(path).bad_input()?,
            None => dataset.reference_trajectory().bad_input()?.ok_or_else(|| {
                Failure::input(format!(
                    "no poses for the depth images of {}: expected groundtruth.txt, or \
                     --trajectory FILE",
                    folder.display()
                ))
            })?,
        };
        let undistorter = Undistorter::new(&camera, WorkingSize::AUTOMATIC, None);
        let ((width, height), pinhole) = (undistorter.size(), *undistorter.pinhole());
        Ok(Self {
            registration: DepthRegistration::new(&calibration, &pinhole, width, height),
            budget: Mutex::new(dataset.pixel_budget()),
            dataset,
            calibration,
            poses,
            pinhole,
        })
    }

    /// Depth images that have a pose of their time, in the order of time; at least one.
    pub fn posed(&self) -> Result<Vec<(&DepthEntry, Se3)>, Failure> {
        let pose = |entry: &DepthEntry| nearest_pose(&self.poses, entry.timestamp_ns);
        let depths = self.dataset.depths.iter();
        let posed = depths.filter_map(|entry| Some((entry, pose(entry)?)));
        let posed: Vec<_> = posed.collect();
        if posed.is_empty() {
            return Err(Failure::input(format!(
                "none of the {} depth images of {} has a pose of its time; give poses with \
                 --trajectory",
                self.dataset.depths.len(),
                self.dataset.root.display()
            )));
        }
        Ok(posed)
    }

    /// Depth along the optical axis, metres, NaN where unknown.
    pub fn read(&self, entry: &DepthEntry) -> Result<GrayImage, Failure> {
        let camera = &self.calibration.camera;
        let mut budget = self.budget.lock().unwrap_or_else(PoisonError::into_inner);
        let spent = budget.spend(DEPTH_COST * camera.width, camera.height);
        spent.bad_input()?;
        drop(budget);
        registered_depth(&entry.path, &self.calibration, &self.registration)
    }
}

/// The pose nearest in time, if it is near enough.
fn nearest_pose(poses: &[TimedPose], timestamp_ns: i64) -> Option<Se3> {
    let after = poses.partition_point(|pose| pose.timestamp_ns < timestamp_ns);
    let candidates = &poses[after.saturating_sub(1)..(after + 1).min(poses.len())];
    let nearest = candidates
        .iter()
        .min_by_key(|pose| pose.timestamp_ns.abs_diff(timestamp_ns))?;
    (nearest.timestamp_ns.abs_diff(timestamp_ns) <= MAX_POSE_DISTANCE_NS)
        .then_some(nearest.world_from_camera)
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::{Rotation, Vec3};

    #[test]
    fn poses_are_taken_from_the_nearest_time_or_not_at_all() {
        let pose = |timestamp_ns, x| TimedPose {
            timestamp_ns,
            world_from_camera: Se3::new(Rotation::identity(), Vec3::new(x, 0.0, 0.0)),
        };
        let poses = [pose(0, 0.0), pose(30_000_000, 1.0), pose(90_000_000, 2.0)];
        let x_at = |t| nearest_pose(&poses, t).map(|p| p.translation.x as i32);
        assert_eq!(x_at(-5_000_000), Some(0));
        assert_eq!(x_at(14_000_000), Some(0));
        assert_eq!(x_at(16_000_000), Some(1));
        assert_eq!(x_at(60_000_000), None);
        assert_eq!(x_at(100_000_000), Some(2));
        assert_eq!(x_at(120_000_000), None);
        assert_eq!(nearest_pose(&[], 0), None);
    }
}
