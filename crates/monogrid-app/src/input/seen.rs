//! What a look at the images of a source says before anything is mapped. `check` and `run` ask
//! here, so that they say the same.

use crate::input::{Images, Input};
use crate::process::interrupt::is_interrupted;
use monogrid_calibration::{CameraMotion, MotionWatch};
use monogrid_datasets::{FixedPart, FixedPartFinder};
use monogrid_geometry::Camera;
use monogrid_image::GrayImage;

/// Images that are compared to find what is fixed to the camera, and how far apart they are in a
/// video.
const FIXED_SAMPLES: usize = 40;
const FRAMES_PER_SAMPLE: usize = 8;

/// Positions of the frames of a folder that are compared: evenly over all of them.
pub fn sampled(num_frames: usize) -> impl Iterator<Item = usize> {
    let num = FIXED_SAMPLES.min(num_frames);
    (0..num).map(move |k| k * num_frames / num.max(1))
}

/// What is fixed to the camera in the images of a folder that were [sampled].
pub fn fixed_in(
    size: (usize, usize),
    images: impl Iterator<Item = GrayImage>,
) -> Option<FixedPart> {
    let mut finder = FixedPartFinder::new(size);
    for image in images.take(FIXED_SAMPLES) {
        finder.add(&image);
    }
    finder.finish()
}

/// The same in the beginning of a video.
pub fn fixed_in_video(
    size: (usize, usize),
    images: impl Iterator<Item = GrayImage>,
) -> Option<FixedPart> {
    let beginning = images.take(FIXED_SAMPLES * FRAMES_PER_SAMPLE);
    fixed_in(size, beginning.step_by(FRAMES_PER_SAMPLE))
}

/// How the camera moved, as the images show it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Motion {
    /// What it did.
    pub did: CameraMotion,
    /// Frames that were looked at: all, unless fewer decide.
    pub num_frames: usize,
}

impl Motion {
    /// Looks at a source that can be read again, until it is decided.
    pub fn of(input: &Input) -> Option<Self> {
        if !input.is_repeatable() || matches!(input.images, Images::Rendered(_)) {
            return None;
        }
        let mut watch = watch(input);
        let mut num_frames = 0;
        for image in input.images_again() {
            if is_interrupted() {
                return None;
            }
            num_frames += 1;
            watch.add(&image);
            if watch.is_decided() {
                break;
            }
        }
        Some(Self {
            did: watch.conclusion(),
            num_frames,
        })
    }
}

/// For images of a source as they come from the camera.
pub fn watch(input: &Input) -> MotionWatch {
    let camera = *input.camera();
    let lens = input.own_calibration.is_none().then_some(camera);
    let size = (camera.width, camera.height);
    MotionWatch::new(size, lens.as_ref(), input.fixed_mask())
}

/// For working images, which have no distortion.
pub fn watch_of_working_images(input: &Input) -> MotionWatch {
    let (width, height) = input.size();
    let camera = Camera::try_new(
        width,
        height,
        *input.pinhole(),
        monogrid_geometry::Distortion::None,
    );
    let is_given = input.own_calibration.is_none();
    let lens = camera.ok().filter(|_| is_given);
    MotionWatch::new((width, height), lens.as_ref(), Some(input.mask()))
}

/// Why there is no map of what a camera sees that moves so, and what to film instead; `None` where
/// there may be one.
pub fn no_map(did: CameraMotion) -> Option<&'static str> {
    match did {
        CameraMotion::StandsStill => Some(
            "The camera stands still: one view shows no depth, and there is no map. Walk with the \
             camera while filming, sideways or around what is to be mapped.",
        ),
        CameraMotion::OnlyTurns => Some(
            "The camera only turns: one rotation after the other explains all motion in the \
             picture, which shows no depth, and there is no map. Move the camera sideways while \
             filming, by a tenth of the distance to what it sees or more.",
        ),
        CameraMotion::Moves | CameraMotion::Unclear => None,
    }
}

/// A word or two.
pub fn name(did: CameraMotion) -> &'static str {
    match did {
        CameraMotion::StandsStill => "stands still",
        CameraMotion::OnlyTurns => "only turns",
        CameraMotion::Moves => "moves",
        CameraMotion::Unclear => "unclear",
    }
}
