//! Frames as they come in and as the tracker needs them.

use monogrid_alignment::Target;
use monogrid_geometry::Pinhole;
use monogrid_image::{GrayImage, Image, Pyramid, to_gray8};
use std::sync::Arc;

/// One working image.
#[derive(Clone, Debug)]
pub struct FrameInput {
    /// Index in the source.
    pub index: usize,
    /// Time.
    pub timestamp_ns: i64,
    /// Undistorted grey image of the working size, values in [0, 255].
    pub image: GrayImage,
    /// Depth (z, metres, NaN where unknown) in the working camera, to start with a metric scale.
    pub seed_depth: Option<GrayImage>,
}

/// A frame with its pyramid.
#[derive(Clone, Debug)]
pub(crate) struct Frame {
    pub index: usize,
    pub timestamp_ns: i64,
    pub pyramid: Arc<Pyramid>,
    pub target: Target,
}

impl Frame {
    pub(crate) fn new(
        input: FrameInput,
        pinhole: &Pinhole,
        finest_level: usize,
        num_levels: usize,
    ) -> Self {
        let pyramid = Arc::new(Pyramid::new(input.image, num_levels));
        let when = (input.index, input.timestamp_ns);
        Self::of_pyramid(when, pyramid, pinhole, finest_level)
    }

    /// A frame whose pyramid was kept.
    pub(crate) fn of_pyramid(
        (index, timestamp_ns): (usize, i64),
        pyramid: Arc<Pyramid>,
        pinhole: &Pinhole,
        finest_level: usize,
    ) -> Self {
        let target = Target::new(&pyramid, pinhole, finest_level, pyramid.num_levels());
        Self {
            index,
            timestamp_ns,
            pyramid,
            target,
        }
    }

    pub(crate) fn image(&self) -> &GrayImage {
        self.pyramid.level(0)
    }
}

/// A frame that waits for the first keyframe, in eight bits.
#[derive(Clone, Debug)]
pub(crate) struct BufferedFrame {
    pub index: usize,
    pub timestamp_ns: i64,
    image: Image<u8>,
}

impl BufferedFrame {
    pub(crate) fn new(frame: &Frame) -> Self {
        Self {
            index: frame.index,
            timestamp_ns: frame.timestamp_ns,
            image: frame.image().map(to_gray8),
        }
    }

    pub(crate) fn image(&self) -> GrayImage {
        self.image.map(f32::from)
    }

    /// The frame with its pyramid again.
    pub(crate) fn restore(
        &self,
        pinhole: &Pinhole,
        finest_level: usize,
        num_levels: usize,
    ) -> Frame {
        let input = FrameInput {
            index: self.index,
            timestamp_ns: self.timestamp_ns,
            image: self.image(),
            seed_depth: None,
        };
        Frame::new(input, pinhole, finest_level, num_levels)
    }
}
