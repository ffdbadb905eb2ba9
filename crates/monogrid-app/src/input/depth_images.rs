//! Depth images beside a source: their calibration, and depth in the camera of the working images.

use crate::input::{Images, Input};
use crate::process::failure::{Classify, Failure};
use monogrid_datasets::{Dataset, DepthCalibration, DepthRegistration, FrameEntry, read_depth};
use monogrid_geometry::Camera;
use monogrid_image::GrayImage;
use std::path::Path;

impl Input {
    /// Depth in the working camera (metres, NaN where unknown) of a depth image file.
    pub fn read_depth(
        &self,
        path: &Path,
        calibration: &DepthCalibration,
    ) -> Result<GrayImage, Failure> {
        let (width, height) = self.size();
        let registration = DepthRegistration::new(calibration, self.pinhole(), width, height);
        registered_depth(path, calibration, &registration)
    }
}

/// A depth image file as depth (metres, NaN where unknown) in the camera of `registration`.
pub fn registered_depth(
    path: &Path,
    calibration: &DepthCalibration,
    registration: &DepthRegistration,
) -> Result<GrayImage, Failure> {
    let depth = read_depth(path, calibration.units_per_metre).bad_input()?;
    registration.register(&depth).ok_or_else(|| {
        Failure::input(format!(
            "depth image {} is {}x{} pixels, its calibration is for {}x{}; \
             give the right one with --depth-calibration",
            path.display(),
            depth.width(),
            depth.height(),
            calibration.camera.width,
            calibration.camera.height
        ))
    })
}

/// The depth calibration: from a file, else the source's own, else the colour camera's with the
/// units of TUM RGB-D.
pub fn depth_calibration(
    dataset: &Dataset,
    file: Option<&Path>,
    colour: &Camera,
) -> Result<DepthCalibration, Failure> {
    match file {
        Some(path) => DepthCalibration::read(path).bad_input(),
        None => {
            let own = dataset.depth_calibration().bad_input()?;
            Ok(own.unwrap_or_else(|| dataset.registered_depth(*colour)))
        }
    }
}

/// The first depth image of the source that belongs to a frame to use, and that frame's index.
pub fn dataset_seed_depth(
    input: &Input,
    calibration: Option<&Path>,
) -> Result<Option<(usize, GrayImage)>, Failure> {
    let Images::Files(dataset) = &input.images else {
        return Ok(None);
    };
    let seed =
        |frame: &FrameEntry| Some((frame.index, dataset.depth_of_frame(frame.timestamp_ns)?));
    let Some((index, entry)) = input.frames.iter().find_map(seed) else {
        return Ok(None);
    };
    let calibration = depth_calibration(dataset, calibration, input.camera())?;
    let depth = input.read_depth(&entry.path, &calibration)?;
    Ok(Some((index, depth)))
}
