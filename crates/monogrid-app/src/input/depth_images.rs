//! Depth images beside a source: their calibration, and depth in the camera of the working images.

use crate::input::{Images, Input};
use crate::process::failure::{Classify, Failure};
use monogrid_datasets::{Dataset, DepthCalibration, DepthRegistration, FrameEntry, read_depth};
use monogrid_geometry::Camera;
use monogrid_image::GrayImage;
use monogrid_pipeline::{SourceFrame, Unusable};
use std::path::{Path, PathBuf};

/// Depth images of frames: those of all that have one, or of the first alone.
#[derive(Clone, Debug)]
pub struct FrameDepths {
    /// Numbers of the frames, ascending, and the images.
    files: Vec<(usize, PathBuf)>,
    calibration: DepthCalibration,
    registration: DepthRegistration,
}

impl FrameDepths {
    /// Of these images; an error if the first cannot be used, `None` if there is none.
    fn new(
        input: &Input,
        files: Vec<(usize, PathBuf)>,
        calibration: DepthCalibration,
    ) -> Result<Option<Self>, Failure> {
        let (width, height) = input.size();
        let depths = Self {
            files,
            calibration,
            registration: DepthRegistration::new(&calibration, input.pinhole(), width, height),
        };
        match depths.files.first() {
            Some((_, path)) => {
                depths.depth(path)?;
                Ok(Some(depths))
            }
            None => Ok(None),
        }
    }

    /// The image of a file, for the first frame to use.
    pub fn of_file(
        input: &Input,
        path: &Path,
        calibration: DepthCalibration,
    ) -> Result<Option<Self>, Failure> {
        let first = input.frames.first().map_or(0, |frame| frame.index);
        Self::new(input, vec![(first, path.to_owned())], calibration)
    }

    /// Those that a data set has for frames to use: at most so many.
    pub fn of_dataset(
        input: &Input,
        calibration: Option<&Path>,
        at_most: usize,
    ) -> Result<Option<Self>, Failure> {
        let Images::Files(dataset) = &input.images else {
            return Ok(None);
        };
        let file = |frame: &FrameEntry| {
            let depth = dataset.depth_of_frame(frame.timestamp_ns)?;
            Some((frame.index, depth.path.clone()))
        };
        let files = input.frames.iter().filter_map(file).take(at_most).collect();
        let calibration = depth_calibration(dataset, calibration, input.camera())?;
        Self::new(input, files, calibration)
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.files.len()
    }

    /// The number of the first frame that has one: the run begins with it.
    pub fn first_frame(&self) -> usize {
        self.files.first().map_or(0, |(index, _)| *index)
    }

    /// A frame with its depth, where there is some.
    pub fn with_depth(&self, frame: SourceFrame) -> SourceFrame {
        let found = self
            .files
            .binary_search_by_key(&frame.index, |(index, _)| *index);
        let depth = found.ok().map(|at| {
            let depth = self.depth(&self.files[at].1);
            depth.map_err(|failure| Unusable::Unreadable(failure.into_error().to_string()))
        });
        SourceFrame { depth, ..frame }
    }

    fn depth(&self, path: &Path) -> Result<GrayImage, Failure> {
        registered_depth(path, &self.calibration, &self.registration)
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
