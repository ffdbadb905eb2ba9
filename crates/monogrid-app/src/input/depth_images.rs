//! What says how far the pixels of frames are: depth images, or the images of a second camera.

use crate::input::frame_masks::FrameMasks;
use crate::input::{Images, Input};
use crate::process::failure::{Classify, Failure};
use monogrid_datasets::{
    Dataset, DepthCalibration, DepthRegistration, FrameEntry, read_depth, read_gray,
};
use monogrid_geometry::{Camera, Se3};
use monogrid_image::{GrayImage, Undistorter};
use monogrid_pipeline::{Preparation, SourceFrame, Unusable};
use monogrid_slam::DepthInput;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Depth images or second images of frames: those of all that have one, or of the first alone.
#[derive(Clone, Debug)]
pub struct FrameDepths {
    /// Numbers of the frames, ascending, and the images.
    files: Vec<(usize, PathBuf)>,
    reader: Reader,
    /// What must not be seen of each frame.
    masks: Option<Arc<FrameMasks>>,
    preparation: Preparation,
}

/// How an image is brought into the camera of the working images.
#[derive(Clone, Debug)]
enum Reader {
    Depth {
        calibration: DepthCalibration,
        registration: DepthRegistration,
    },
    Stereo {
        undistorter: Undistorter,
        second_from_first: Se3,
    },
}

impl Reader {
    fn depth(input: &Input, calibration: DepthCalibration) -> Self {
        let (width, height) = input.size();
        Self::Depth {
            registration: DepthRegistration::new(&calibration, input.pinhole(), width, height),
            calibration,
        }
    }

    fn read(&self, path: &Path) -> Result<DepthInput, Failure> {
        match self {
            Self::Depth {
                calibration,
                registration,
            } => registered_depth(path, calibration, registration).map(DepthInput::Measured),
            Self::Stereo {
                undistorter,
                second_from_first,
            } => {
                let image = read_gray(path).bad_input()?;
                let undistorted = undistorter.apply(&image).ok_or_else(|| {
                    let expected = undistorter.input();
                    Failure::input(format!(
                        "{} is {}x{} pixels, the calibration of the second camera is for {}x{}",
                        path.display(),
                        image.width(),
                        image.height(),
                        expected.width,
                        expected.height
                    ))
                });
                Ok(DepthInput::SecondImage {
                    image: undistorted?,
                    second_from_first: *second_from_first,
                })
            }
        }
    }
}

impl FrameDepths {
    /// Of these images; an error if the first cannot be used, `None` if there is none.
    fn new(
        input: &Input,
        files: Vec<(usize, PathBuf)>,
        reader: Reader,
    ) -> Result<Option<Self>, Failure> {
        let Some((_, path)) = files.first() else {
            return Ok(None);
        };
        reader.read(path)?;
        Ok(Some(Self {
            files,
            reader,
            masks: input.reading.masks.clone(),
            preparation: input.preparation.clone(),
        }))
    }

    /// The image of a file, for the first frame to use.
    pub fn of_file(
        input: &Input,
        path: &Path,
        calibration: DepthCalibration,
    ) -> Result<Option<Self>, Failure> {
        let first = input.frames.first().map_or(0, |frame| frame.index);
        let reader = Reader::depth(input, calibration);
        Self::new(input, vec![(first, path.to_owned())], reader)
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
        Self::new(input, files, Reader::depth(input, calibration))
    }

    /// The images of the second camera of a stereo pair that a data set has for frames to use, with
    /// the calibration of the pair, if that does not lie there.
    pub fn of_stereo(input: &Input, calibration: Option<&Path>) -> Result<Option<Self>, Failure> {
        let Images::Files(dataset) = &input.images else {
            return Ok(None);
        };
        let first = input.camera();
        let size = (first.width, first.height);
        let Some(second) = dataset.second_camera(calibration, size).bad_input()? else {
            return Ok(None);
        };
        let file = |frame: &FrameEntry| Some((frame.index, dataset.second_image(frame)?));
        let files: Vec<(usize, PathBuf)> = input.frames.iter().filter_map(file).collect();
        // those of the first camera are read beside them
        let rows = second.camera.height * 2 * files.len();
        let mut budget = dataset.pixel_budget();
        budget.spend(second.camera.width, rows).bad_input()?;
        let reader = Reader::Stereo {
            undistorter: Undistorter::onto(&second.camera, *input.pinhole(), input.size()),
            second_from_first: second.second_from_first,
        };
        Self::new(input, files, reader)
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
            let depth = self.reader.read(&self.files[at].1);
            let depth = depth.map(|depth| self.without_masked(frame.index, depth));
            depth.map_err(|failure| Unusable::Unreadable(failure.into_error().to_string()))
        });
        SourceFrame { depth, ..frame }
    }

    /// What was measured where the mask of the frame allows it; what is compared with a second
    /// image has no texture elsewhere.
    fn without_masked(&self, frame: usize, depth: DepthInput) -> DepthInput {
        let camera = self.preparation.camera();
        let size = (camera.width, camera.height);
        let mask = self
            .masks
            .as_ref()
            .and_then(|masks| masks.of_size(frame, size));
        let used = mask.and_then(|mask| self.preparation.apply_mask(&mask));
        match (depth, used) {
            (DepthInput::Measured(mut depth), Some(used)) if used.same_size(&depth) => {
                for (depth, used) in depth.as_mut_slice().iter_mut().zip(used.as_slice()) {
                    if *used == 0 {
                        *depth = f32::NAN;
                    }
                }
                DepthInput::Measured(depth)
            }
            (depth, _) => depth,
        }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::args::SourceArgs;
    use monogrid_datasets::{encode_png, encode_png_16};
    use monogrid_image::{Image, Mask, WorkingSize};
    use std::fs;

    #[test]
    fn what_a_mask_names_has_no_depth() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let write = |name: &str, bytes: &[u8]| fs::write(at(name), bytes).unwrap();
        for name in ["rgb", "depth"] {
            fs::create_dir(at(name)).unwrap();
        }
        let image = Image::from_fn(80, 60, |x, y| (3 * x + y) as u8);
        write("rgb/0.png", &encode_png(&image));
        write("depth/0.png", &encode_png_16(&Image::filled(80, 60, 2000)));
        write("rgb.txt", b"0 rgb/0.png\n");
        write("depth.txt", b"0 depth/0.png\n");
        write("calibration.txt", b"60 60 39.5 29.5 80 60\n");
        let mask = Mask::from_fn(40, 30, |x, _| if x < 10 { 0 } else { 255 });
        write("mask.png", &encode_png(&mask));
        let depth = |mask: Option<PathBuf>| {
            let args = SourceArgs {
                mask,
                ..SourceArgs::default()
            };
            let input = Input::open(folder.path(), &args, WorkingSize::AUTOMATIC).unwrap();
            let depths = FrameDepths::of_dataset(&input, None, 1).unwrap().unwrap();
            let frame = input.source(None).next().unwrap();
            match depths.with_depth(frame).depth.unwrap().unwrap() {
                DepthInput::Measured(depth) => depth,
                DepthInput::SecondImage { .. } => panic!("one camera"),
            }
        };
        let free = depth(None);
        let masked = depth(Some(at("mask.png")));
        assert!((free.at(5, 30) - free.at(60, 30)).abs() < 1e-6);
        for (x, y) in (0..80).flat_map(|x| (0..60).map(move |y| (x, y))) {
            let (found, expected) = (masked.at(x, y), free.at(x, y));
            assert!(
                if x < 20 {
                    found.is_nan()
                } else {
                    found == expected
                },
                "{x} {y}"
            );
        }
    }
}
