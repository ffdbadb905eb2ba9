//! What alignment needs of a keyframe.

use super::exposure::Exposure;
use super::keyframe::KeyframeImage;
use crate::KeyframeId;
use crate::mapping::KeyframeCamera;
use crate::store::Kept;
use monogrid_alignment::DepthSample;

/// A keyframe as it was when tracking left it: image, points and brightness. Shared with the graph.
#[derive(Clone, Debug)]
pub(crate) struct View {
    pub id: KeyframeId,
    /// Camera of its image.
    pub camera: KeyframeCamera,
    pub image: KeyframeImage,
    /// Depth in the keyframe's units.
    pub samples: Kept<Vec<DepthSample>>,
    pub exposure: Exposure,
    /// Whether its shape and scale can be relied on: not so the first keyframes of a random start.
    pub is_settled: bool,
}
