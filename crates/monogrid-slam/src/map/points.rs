//! Points of the sparse layer, and what a keyframe knows about them.

use crate::KeyframeId;
use crate::certainty::PoseSigma;
use monogrid_geometry::{Se3, Vec2};
use monogrid_graph::bundle::BundleError;
use std::ops::Range;

/// Where a keyframe sees a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Observation {
    pub keyframe: KeyframeId,
    /// Level-0 px.
    pub pixel: Vec2,
}

/// A point anchored in a keyframe.
#[derive(Clone, Debug)]
pub(crate) struct SparsePoint {
    /// Keyframe in which it was detected.
    pub host: KeyframeId,
    /// Its pixel there, exact by definition.
    pub pixel: Vec2,
    /// Inverse depth along the host's optical axis, 1 / world units.
    pub idepth: f64,
    /// Inverse depth it was created with, and its standard deviation.
    pub prior_idepth: f64,
    /// See [`Self::prior_idepth`].
    pub prior_sigma: f64,
    /// Whether a depth camera measured that inverse depth, in 1/m.
    pub is_measured: bool,
    /// Keyframes other than the host that see it.
    pub observations: Vec<Observation>,
    /// Pixel of the finest level on which its patch stands out of the noise, level-0 px: how
    /// exactly it is found, in multiples of what is usual.
    pub pixel_size: f64,
    /// Whether it is still used.
    pub alive: bool,
}

/// Inverse depth that is known worse than this, relative to itself, is a guess.
const MAX_RELATIVE_SIGMA: f64 = 0.29;

impl SparsePoint {
    /// Memory, bytes.
    pub(super) fn bytes(&self) -> usize {
        size_of_val(self) + self.observations.capacity() * size_of::<Observation>()
    }

    /// Where a keyframe sees it.
    pub(crate) fn pixel_in(&self, keyframe: KeyframeId) -> Option<Vec2> {
        if self.host == keyframe {
            return Some(self.pixel);
        }
        let seen = self.observations.iter().find(|o| o.keyframe == keyframe);
        seen.map(|o| o.pixel)
    }

    /// Lengths in its host grow by a factor.
    pub(super) fn grow(&mut self, factor: f64) {
        self.idepth /= factor;
        // metres stay metres
        if !self.is_measured {
            self.prior_idepth /= factor;
            self.prior_sigma /= factor;
        }
    }

    /// A depth camera measured its inverse depth, 1/m.
    pub(super) fn measure(&mut self, idepth: f64, sigma: f64) {
        if self.observations.is_empty() {
            self.idepth = idepth;
        }
        self.prior_idepth = idepth;
        self.prior_sigma = sigma;
        self.is_measured = true;
    }

    /// Whether its depth is more than a guess: known when it was anchored, or seen from elsewhere.
    pub(crate) fn has_depth(&self) -> bool {
        self.prior_sigma < MAX_RELATIVE_SIGMA * self.prior_idepth || !self.observations.is_empty()
    }

    /// Whether it is used and another keyframe sees it.
    pub(crate) fn is_shared(&self) -> bool {
        self.alive && !self.observations.is_empty()
    }
}

/// Dense inverse depth (keyframe units) where a keyframe sees a point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DenseLink {
    pub point: usize,
    pub idepth: f64,
    /// Relative standard deviation.
    pub relative_sigma: f64,
}

/// The points that a keyframe sees, as indices.
#[derive(Clone, Debug, Default)]
pub(crate) struct SeenPoints {
    /// Those anchored in it.
    pub anchored: Range<usize>,
    /// Those anchored in others, ascending.
    pub others: Vec<usize>,
    /// Its dense depth at these points.
    pub links: Vec<DenseLink>,
}

impl SeenPoints {
    /// Memory beyond the keyframe's own, bytes.
    pub(super) fn bytes(&self) -> usize {
        self.others.capacity() * size_of::<usize>() + self.links.capacity() * size_of::<DenseLink>()
    }

    /// All of them, ascending.
    pub(crate) fn all(&self) -> impl Iterator<Item = usize> {
        let cut = self.others.partition_point(|p| *p < self.anchored.start);
        let (older, newer) = self.others.split_at(cut);
        let older = older.iter().copied();
        older
            .chain(self.anchored.clone())
            .chain(newer.iter().copied())
    }
}

/// The newest keyframe as the points place it.
#[derive(Clone, Debug, Default)]
pub(crate) struct Registration {
    /// Its pose, if enough of the found points agree.
    pub camera_from_world: Option<Se3>,
    /// The points that agree with it, those whose depth is a guess, and where they are.
    pub inliers: Vec<(usize, Vec2)>,
}

/// What a bundle adjustment says.
#[derive(Clone, Debug, Default)]
pub(crate) struct Adjustment {
    /// How well the pose of the last of these keyframes is known, if it was asked.
    pub last: Option<(KeyframeId, PoseSigma)>,
    pub camera_from_world: Vec<(KeyframeId, Se3)>,
    pub idepths: Vec<(usize, f64)>,
    /// Points, and keyframes that do not see them after all.
    pub refuted: Vec<(usize, KeyframeId)>,
    /// Why nothing was adjusted.
    pub failure: Option<BundleError>,
}
