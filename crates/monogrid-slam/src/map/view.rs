//! What alignment needs of a keyframe.

use super::exposure::Exposure;
use crate::KeyframeId;
use crate::mapping::KeyframeCamera;
use monogrid_alignment::DepthSample;
use monogrid_image::Pyramid;
use std::sync::Arc;

/// A keyframe as it was when tracking left it: image, points and brightness. Shared with the graph.
#[derive(Clone, Debug)]
pub(crate) struct View {
    pub id: KeyframeId,
    /// Camera of its image.
    pub camera: KeyframeCamera,
    pub pyramid: Arc<Pyramid>,
    /// Depth in the keyframe's units.
    pub samples: Vec<DepthSample>,
    pub exposure: Exposure,
    /// Whether its shape and scale can be relied on: not so the first keyframes of a random start.
    pub is_settled: bool,
}

impl View {
    /// Memory of its own, bytes: the image is the keyframe's.
    pub(super) fn bytes(&self) -> usize {
        self.samples.capacity() * size_of::<DepthSample>()
    }
}
