//! A place that was recognised in another fragment of the map.

use crate::KeyframeId;
use monogrid_alignment::SimilarityConstraint;
use monogrid_geometry::Sim3;

/// A keyframe that was recognised in another fragment.
#[derive(Clone, Debug)]
pub(super) struct Sighting {
    /// The keyframe of the other fragment, older.
    pub other: KeyframeId,
    pub own: KeyframeId,
    /// As direct alignment found it, else as the recognised points have it.
    pub other_from_own: Sim3,
    pub constraint: Option<SimilarityConstraint>,
}

impl Sighting {
    /// A keyframe as recognised points have it, and as direct alignment has it unless that failed.
    pub(super) fn new(
        other: KeyframeId,
        own: KeyframeId,
        other_from_own: Sim3,
        constraint: Option<SimilarityConstraint>,
    ) -> Self {
        Self {
            other,
            own,
            other_from_own: constraint.as_ref().map_or(other_from_own, |c| c.b_from_a),
            constraint,
        }
    }

    /// Whether direct alignment confirmed it.
    pub(super) fn is_aligned(&self) -> bool {
        self.constraint.is_some()
    }
}
