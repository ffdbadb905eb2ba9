//! Frames as they come in and as the tracker needs them.

use crate::FragmentId;
use crate::map::Map;
use crate::store::Kept;
use monogrid_alignment::Target;
use monogrid_depth::MeasuredDepth;
use monogrid_geometry::Se3;
use monogrid_image::{GrayImage, Image, Pyramid, to_gray8};
use std::sync::{Arc, LazyLock};

/// One working image.
#[derive(Clone, Debug)]
pub struct FrameInput {
    /// Index in the source.
    pub index: usize,
    /// Time.
    pub timestamp_ns: i64,
    /// Undistorted grey image of the working size, values in [0, 255].
    pub image: GrayImage,
    /// What says how far its pixels are, in metres; one of another size is not used.
    pub depth: Option<DepthInput>,
}

/// What says how far the pixels of a frame are.
#[derive(Clone, Debug)]
pub enum DepthInput {
    /// Depth (z, metres, NaN where unknown) in the working camera, as a depth camera measured it.
    Measured(GrayImage),
    /// What the second camera of a stereo pair saw at the same time.
    SecondImage {
        /// As a camera with the intrinsics of the first sees it.
        image: GrayImage,
        /// With the translation in metres.
        second_from_first: Se3,
    },
}

impl From<GrayImage> for DepthInput {
    fn from(depth: GrayImage) -> Self {
        Self::Measured(depth)
    }
}

impl DepthInput {
    /// Width and height, px.
    pub(crate) fn size(&self) -> (usize, usize) {
        let (Self::Measured(image) | Self::SecondImage { image, .. }) = self;
        (image.width(), image.height())
    }
}

/// What was measured with a frame, looked at when it is needed: of most frames nobody asks for it.
pub(crate) type LaterMeasured = LazyLock<MeasuredDepth, Box<dyn FnOnce() -> MeasuredDepth + Send>>;

/// A frame with its pyramid.
#[derive(Clone, Debug)]
pub(crate) struct Frame {
    pub index: usize,
    pub timestamp_ns: i64,
    pub pyramid: Arc<Pyramid>,
    pub target: Target,
    /// What a depth camera measured with it.
    pub measured: Option<Arc<LaterMeasured>>,
}

impl Frame {
    pub(crate) fn image(&self) -> &GrayImage {
        self.pyramid.level(0)
    }

    /// What a depth camera measured with it, for a keyframe of a fragment that is in metres.
    pub(crate) fn measured_for(
        &self,
        map: &Map,
        fragment: FragmentId,
    ) -> Option<Kept<MeasuredDepth>> {
        let measured = self.measured.as_ref().filter(|_| map.is_metric(fragment))?;
        Some(map.store().keep(MeasuredDepth::clone(measured)))
    }
}

/// A frame that waits for the first keyframe, in eight bits.
#[derive(Clone, Debug)]
pub(crate) struct BufferedFrame {
    pub index: usize,
    pub timestamp_ns: i64,
    image: Image<u8>,
    pub measured: Option<Arc<LaterMeasured>>,
}

impl BufferedFrame {
    pub(crate) fn new(frame: &Frame) -> Self {
        Self {
            index: frame.index,
            timestamp_ns: frame.timestamp_ns,
            image: frame.image().map(to_gray8),
            measured: frame.measured.clone(),
        }
    }

    pub(crate) fn image(&self) -> GrayImage {
        self.image.map(f32::from)
    }
}
