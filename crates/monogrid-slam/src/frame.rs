//! Frames as they come in and as the tracker needs them.

use monogrid_alignment::Target;
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
}
