//! A finished map as it is kept between sessions.

use crate::{EdgeKind, FragmentId, Keyframe, KeyframeId, Scale};
use monogrid_geometry::Sim3;
use monogrid_graph::pose_graph::GraphEdge;

/// Everything that a system needs to go on with a map: see [`crate::Slam::stored_map`] and
/// [`crate::Slam::continue_from`].
#[derive(Clone, Debug)]
pub struct StoredMap {
    /// Whether the unit of the world is the metre.
    pub scale: Scale,
    /// Revision of the poses.
    pub pose_revision: u64,
    /// Keyframes by identity: 0, 1, 2 and so on.
    pub keyframes: Vec<StoredKeyframe>,
    /// Constraints between them; without any, keyframes are held together by their poses.
    pub edges: Vec<StoredEdge>,
    /// Points that several keyframes see; may be empty.
    pub points: Vec<StoredPoint>,
}

/// A keyframe with all that is known about it.
#[derive(Clone, Debug)]
pub struct StoredKeyframe {
    /// Image and depth.
    pub keyframe: Keyframe,
    /// Fragment that it belongs to: not 0 where that was never joined to the main map.
    pub fragment: FragmentId,
    /// Pose and unit in the world of its fragment.
    pub world_from_keyframe: Sim3,
    /// Older keyframe that it was tracked on; none for the first of a fragment.
    pub parent: Option<KeyframeId>,
    /// Brightness relative to the first keyframe: `I_keyframe = gain * I_first + bias`.
    pub gain: f64,
    /// See [`Self::gain`].
    pub bias: f64,
}

/// A constraint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StoredEdge {
    /// Where it comes from.
    pub kind: EdgeKind,
    /// The constraint.
    pub edge: GraphEdge,
}

/// A point of the sparse layer.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredPoint {
    /// Keyframe in which it is anchored.
    pub host: KeyframeId,
    /// Its pixel there.
    pub pixel: [f64; 2],
    /// Inverse depth there, 1 / world units.
    pub idepth: f64,
    /// Inverse depth that it was created with, and its standard deviation.
    pub prior: [f64; 2],
    /// Other keyframes that see it, and where, px.
    pub observations: Vec<(KeyframeId, [f64; 2])>,
}

impl StoredPoint {
    /// Whether the keyframes that it names are among the first `num_keyframes`, its pixels inside images of `size`
    /// (width, height), and its inverse depths those of a point.
    pub(crate) fn is_usable(&self, num_keyframes: usize, size: (usize, usize)) -> bool {
        let exists = |id: KeyframeId| (id as usize) < num_keyframes;
        let is_inside = |[x, y]: [f64; 2]| {
            (0.0..size.0 as f64).contains(&x) && (0.0..size.1 as f64).contains(&y)
        };
        let is_positive = |v: f64| v.is_finite() && v > 0.0;
        let mut observations = self.observations.iter();
        exists(self.host)
            && is_inside(self.pixel)
            && is_positive(self.idepth)
            && is_positive(self.prior[1])
            && observations.all(|(id, pixel)| exists(*id) && is_inside(*pixel))
    }
}

/// What a later session does with a map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// New keyframes are added, old ones refined and moved.
    Extend,
    /// The camera is localised; the map stays as it is.
    LocaliseOnly,
}

/// Why a system cannot go on with a map.
#[derive(Debug, thiserror::Error, Clone, PartialEq)]
#[non_exhaustive]
pub enum ContinueError {
    /// No keyframes.
    #[error("the map has no keyframes: there is nothing to go on with")]
    Empty,
    /// Identities have gaps.
    #[error("keyframe {missing} is missing: the map is damaged and cannot be continued")]
    Missing {
        /// The first missing identity.
        missing: KeyframeId,
    },
    /// An image of another size.
    #[error(
        "keyframe {id} has {found:?} pixels, the images to be tracked {expected:?}: use the working size of the map"
    )]
    Size {
        /// The keyframe.
        id: KeyframeId,
        /// Its width and height.
        found: (usize, usize),
        /// The width and height of the new images.
        expected: (usize, usize),
    },
    /// A pose or parent that cannot be.
    #[error("keyframe {id}: {what}; the map is damaged and cannot be continued")]
    Keyframe {
        /// The keyframe.
        id: KeyframeId,
        /// What is wrong.
        what: &'static str,
    },
    /// Settings without which a camera is never recognised.
    #[error("to go on with a map, graph.enabled and graph.places.enabled must be true")]
    NoPlaces,
}

impl StoredMap {
    /// Checks that a system for images of the given size can go on with this map.
    ///
    /// # Errors
    /// The first thing that is wrong.
    pub fn check(&self, expected: (usize, usize)) -> Result<(), ContinueError> {
        if self.keyframes.is_empty() {
            return Err(ContinueError::Empty);
        }
        for (id, stored) in (0..).zip(&self.keyframes) {
            if stored.keyframe.id != id {
                return Err(ContinueError::Missing { missing: id });
            }
            let image = &stored.keyframe.image;
            let found = (image.width(), image.height());
            if found != expected {
                return Err(ContinueError::Size {
                    id,
                    found,
                    expected,
                });
            }
            let what = if !stored.world_from_keyframe.is_finite() {
                "its pose is not finite"
            } else if stored.parent.is_some_and(|parent| parent >= id) {
                "its parent is not older"
            } else if !(stored.gain.is_finite() && stored.gain > 0.0 && stored.bias.is_finite()) {
                "its brightness is not positive"
            } else {
                continue;
            };
            return Err(ContinueError::Keyframe { id, what });
        }
        Ok(())
    }
}
