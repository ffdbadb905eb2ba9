//! What does not change while a system runs.

use crate::KeyframeCamera;
use crate::SlamConfig;
use crate::frame::{BufferedFrame, DepthInput, Frame, FrameInput, LaterMeasured};
use crate::view::NUM_LEVELS;
use monogrid_alignment::Target;
use monogrid_depth::{HostFrame, MeasuredDepth};
use monogrid_geometry::{Pinhole, Rotation, Vec3};
use monogrid_image::{GrayImage, Mask, Pyramid};
use monogrid_inertial::Imu;
use std::sync::Arc;

/// Settings and camera, read by all stages.
#[derive(Debug)]
pub(crate) struct Setup {
    pub config: SlamConfig,
    pub pinhole: Pinhole,
    pub mask: Mask,
    pub seed: u64,
    /// Whether the map must stay as it is.
    pub is_frozen: bool,
    /// Readings of an inertial sensor beside the camera.
    pub imu: Option<Arc<Imu>>,
    /// Radial distortion that the calibration has left, 0 for none.
    pub left_radial: f64,
}

impl Setup {
    /// Of a map that may change, without an inertial sensor.
    pub(crate) fn new(config: SlamConfig, pinhole: Pinhole, mask: Mask, seed: u64) -> Self {
        Self {
            config,
            pinhole,
            mask,
            seed,
            is_frozen: false,
            imu: None,
            left_radial: 0.0,
        }
    }

    /// The camera of keyframes.
    pub(crate) fn camera(&self) -> KeyframeCamera {
        KeyframeCamera::new(self.pinhole, (self.mask.width(), self.mask.height()))
    }

    /// A frame as tracking needs it.
    pub(crate) fn frame(&self, input: FrameInput) -> Frame {
        let size = (input.image.width(), input.image.height());
        let depth = input.depth.filter(|depth| depth.size() == size);
        let frame = self.frame_of((input.index, input.timestamp_ns), input.image);
        Frame {
            measured: depth.map(|depth| self.measured(depth, &frame)),
            ..frame
        }
    }

    /// What says how far the pixels of a frame are, as it is looked at when it is needed.
    fn measured(&self, depth: DepthInput, frame: &Frame) -> Arc<LaterMeasured> {
        let (pinhole, sigma) = (self.pinhole, self.config.depth_camera.sigma);
        let look: Box<dyn FnOnce() -> MeasuredDepth + Send> = match depth {
            DepthInput::Measured(depth) => Box::new(move || MeasuredDepth::new(&depth, sigma)),
            DepthInput::SecondImage {
                image,
                second_from_first,
            } => {
                let pyramid = Arc::clone(&frame.pyramid);
                Box::new(move || {
                    let pair = [pyramid.level(0), &image];
                    MeasuredDepth::of_pair(pair, &pinhole, &second_from_first)
                })
            }
        };
        Arc::new(LaterMeasured::new(look))
    }

    /// A frame that waited for the first keyframe.
    pub(crate) fn restored(&self, buffered: &BufferedFrame) -> Frame {
        Frame {
            measured: buffered.measured.clone(),
            ..self.frame_of((buffered.index, buffered.timestamp_ns), buffered.image())
        }
    }

    fn frame_of(&self, when: (usize, i64), image: GrayImage) -> Frame {
        self.of_pyramid(when, Arc::new(Pyramid::new(image, NUM_LEVELS)))
    }

    /// A frame of which the pyramid was kept.
    pub(crate) fn of_pyramid(
        &self,
        (index, timestamp_ns): (usize, i64),
        pyramid: Arc<Pyramid>,
    ) -> Frame {
        let finest = self.config.tracking.alignment.finest_level;
        let target = Target::new(&pyramid, &self.pinhole, finest, pyramid.num_levels());
        Frame {
            index,
            timestamp_ns,
            pyramid,
            target,
            measured: None,
        }
    }

    /// An image as depth needs it; `None` for sizes the depth filter cannot work with.
    pub(crate) fn host(&self, image: GrayImage) -> Option<Arc<HostFrame>> {
        self.host_without_moving(image, None)
    }

    /// As [`Self::host`], without the pixels in which something moves by what was measured.
    pub(crate) fn host_without_moving(
        &self,
        image: GrayImage,
        measured: Option<&MeasuredDepth>,
    ) -> Option<Arc<HostFrame>> {
        let mask = measured.map_or_else(|| self.mask.clone(), |depth| depth.still(&self.mask));
        HostFrame::new(image, mask, self.pinhole).map(Arc::new)
    }

    /// How the camera turned from one frame to another by the gyroscope, whose bias does not matter
    /// over so short a time; `other_from_frame`.
    pub(crate) fn turn(&self, frame_ns: i64, other_ns: i64) -> Option<Rotation> {
        let imu = self.imu.as_ref()?;
        imu.camera_turn(frame_ns, other_ns, &Vec3::zeros())
    }
}
