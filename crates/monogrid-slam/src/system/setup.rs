//! What does not change while a system runs.

use super::camera::Known;
use crate::SlamConfig;
use crate::frame::{BufferedFrame, Frame, FrameInput};
use crate::map::NUM_LEVELS;
use crate::mapping::KeyframeCamera;
use monogrid_geometry::{Pinhole, Rotation, Vec3};
use monogrid_image::Mask;
use monogrid_inertial::Imu;
use std::sync::Arc;

/// Settings and camera, read by all stages.
#[derive(Debug)]
pub(super) struct Setup {
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
    /// The camera of keyframes.
    pub(super) fn camera(&self) -> KeyframeCamera {
        KeyframeCamera::new(self.pinhole, (self.mask.width(), self.mask.height()))
    }

    /// A frame as tracking needs it.
    pub(super) fn frame(&self, input: FrameInput) -> Frame {
        let finest = self.config.tracking.alignment.finest_level;
        Frame::new(input, &self.pinhole, finest, NUM_LEVELS)
    }

    /// How the camera turned from one frame to another by the gyroscope, whose bias does not matter over so short a time;
    /// `other_from_frame`.
    pub(super) fn turn(&self, frame_ns: i64, other_ns: i64) -> Option<Rotation> {
        self.imu
            .as_ref()?
            .camera_turn(frame_ns, other_ns, &Vec3::zeros())
    }

    /// A frame of which the pyramid was kept.
    pub(super) fn of_pyramid(&self, known: &Known) -> Frame {
        let finest = self.config.tracking.alignment.finest_level;
        let when = (known.frame_index, known.timestamp_ns);
        Frame::of_pyramid(when, Arc::clone(&known.pyramid), &self.pinhole, finest)
    }

    /// A frame that waited for the first keyframe.
    pub(super) fn restored(&self, buffered: &BufferedFrame) -> Frame {
        let finest = self.config.tracking.alignment.finest_level;
        buffered.restore(&self.pinhole, finest, NUM_LEVELS)
    }
}
