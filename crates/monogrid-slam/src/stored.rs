//! A finished map as it is kept between sessions.

use crate::graph::EdgeKey;
use crate::{EdgeKind, FragmentId, Keyframe, KeyframeId, MAIN_MAP, Scale};
use monogrid_geometry::{Pinhole, Sim3};
use monogrid_graph::pose_graph::GraphEdge;

/// Everything that a system needs to go on with a map: see [`crate::Slam::stored_map`] and
/// [`crate::Slam::continue_from`].
#[derive(Clone, Debug, Default)]
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
    /// Intrinsics of its image.
    pub pinhole: Pinhole,
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

/// What a later session is told of a keyframe beside its image and depth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StoredLink {
    /// The keyframe.
    pub id: KeyframeId,
    /// See [`StoredKeyframe::fragment`].
    pub fragment: FragmentId,
    /// See [`StoredKeyframe::world_from_keyframe`].
    pub world_from_keyframe: Sim3,
    /// See [`StoredKeyframe::parent`].
    pub parent: Option<KeyframeId>,
    /// See [`StoredKeyframe::gain`].
    pub gain: f64,
    /// See [`StoredKeyframe::gain`].
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

impl StoredEdge {
    /// By what it is told from others.
    pub(crate) fn key(&self) -> EdgeKey {
        let (i, j) = (self.edge.i as KeyframeId, self.edge.j as KeyframeId);
        (i, j, self.kind)
    }
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

impl StoredKeyframe {
    /// It without image and depth.
    #[must_use]
    pub fn link(&self) -> StoredLink {
        StoredLink {
            id: self.keyframe.id,
            fragment: self.fragment,
            world_from_keyframe: self.world_from_keyframe,
            parent: self.parent,
            gain: self.gain,
            bias: self.bias,
        }
    }

    /// The same with other identities.
    fn renamed(mut self, name: impl Fn(KeyframeId) -> KeyframeId) -> Self {
        self.keyframe.id = name(self.keyframe.id);
        self.parent = self.parent.map(name);
        self
    }
}

impl StoredEdge {
    /// The same between keyframes with other identities.
    fn renamed(&self, name: impl Fn(KeyframeId) -> KeyframeId) -> Self {
        let mut edge = *self;
        edge.edge.i = name(edge.edge.i as KeyframeId).into();
        edge.edge.j = name(edge.edge.j as KeyframeId).into();
        edge
    }
}

impl StoredPoint {
    /// The same with other identities of the keyframes.
    fn renamed(mut self, name: impl Fn(KeyframeId) -> KeyframeId) -> Self {
        self.host = name(self.host);
        for (keyframe, _) in &mut self.observations {
            *keyframe = name(*keyframe);
        }
        self
    }

    /// Whether the keyframes that it names exist, its pixels are inside their images, and its
    /// inverse depths those of a point.
    pub(crate) fn is_usable(&self, keyframes: &[StoredKeyframe]) -> bool {
        let is_inside = |id: KeyframeId, [x, y]: [f64; 2]| {
            keyframes.get(id as usize).is_some_and(|stored| {
                let (width, height) = stored.keyframe.size();
                (0.0..width as f64).contains(&x) && (0.0..height as f64).contains(&y)
            })
        };
        let is_positive = |v: f64| v.is_finite() && v > 0.0;
        let mut observations = self.observations.iter();
        is_inside(self.host, self.pixel)
            && is_positive(self.idepth)
            && is_positive(self.prior[1])
            && observations.all(|(id, pixel)| is_inside(*id, *pixel))
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
        "keyframe {id} has {found:?} pixels, the images to be tracked {expected:?}: use the \
         working size of the map"
    )]
    Size {
        /// The keyframe.
        id: KeyframeId,
        /// Its width and height.
        found: (usize, usize),
        /// The width and height of the new images.
        expected: (usize, usize),
    },
    /// Keyframes of several cameras, as merged maps have.
    #[error(
        "keyframe {id} was not made by the camera of keyframe 0: a map of several cameras cannot \
         be continued; continue one of those that it was made of, and merge them again"
    )]
    SeveralCameras {
        /// The first one of another camera.
        id: KeyframeId,
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
    /// Several maps in one, apart from each other: the keyframes of each behind those of the map
    /// before. The main map of each becomes the fragment with its number, their other fragments
    /// follow. The scale is that of the first.
    #[must_use]
    pub fn side_by_side(maps: Vec<Self>) -> Self {
        let mut next_fragment = maps.len() as FragmentId;
        let mut all = Self {
            scale: maps.first().map(|map| map.scale).unwrap_or_default(),
            ..Self::default()
        };
        for (number, map) in (0..).zip(maps) {
            let first = all.keyframes.len() as KeyframeId;
            let moved = |id: KeyframeId| id + first;
            let before_first = next_fragment - 1;
            for stored in map.keyframes {
                let fragment = match stored.fragment {
                    MAIN_MAP => number,
                    other => before_first + other,
                };
                next_fragment = next_fragment.max(fragment + 1);
                all.keyframes.push(StoredKeyframe {
                    fragment,
                    ..stored.renamed(moved)
                });
            }
            let edges = map.edges.iter();
            all.edges.extend(edges.map(|edge| edge.renamed(moved)));
            let points = map.points.into_iter();
            all.points.extend(points.map(|point| point.renamed(moved)));
            all.pose_revision = all.pose_revision.max(map.pose_revision);
        }
        all
    }

    /// The keyframes of one fragment as a map of its own, in the world of the fragment, and the
    /// identities that they had.
    #[must_use]
    pub fn fragment(&self, fragment: FragmentId) -> (Self, Vec<KeyframeId>) {
        let all = self.keyframes.iter();
        let of_fragment = all.filter(|stored| stored.fragment == fragment);
        let ids: Vec<KeyframeId> = of_fragment.clone().map(|s| s.keyframe.id).collect();
        let is_inside = |id: KeyframeId| ids.binary_search(&id).is_ok();
        let renamed = |id: KeyframeId| ids.partition_point(|other| *other < id) as KeyframeId;
        let edges = self.edges.iter();
        let points = self.points.iter();
        let map = Self {
            scale: if fragment == MAIN_MAP {
                self.scale
            } else {
                Scale::Arbitrary
            },
            pose_revision: self.pose_revision,
            keyframes: of_fragment
                .map(|stored| StoredKeyframe {
                    fragment: MAIN_MAP,
                    parent: stored.parent.filter(|id| is_inside(*id)),
                    ..stored.clone()
                })
                .map(|stored| stored.renamed(renamed))
                .collect(),
            edges: edges
                .filter(|e| is_inside(e.edge.i as KeyframeId) && is_inside(e.edge.j as KeyframeId))
                .map(|edge| edge.renamed(renamed))
                .collect(),
            points: points
                .filter(|point| is_inside(point.host))
                .map(|point| {
                    let mut point = point.clone();
                    point.observations.retain(|(id, _)| is_inside(*id));
                    point.renamed(renamed)
                })
                .collect(),
        };
        (map, ids)
    }

    /// Checks that a system for images of the given size can go on with this map.
    ///
    /// # Errors
    /// The first thing that is wrong.
    pub fn check(&self, expected: (usize, usize)) -> Result<(), ContinueError> {
        self.check_keyframes()?;
        for stored in &self.keyframes {
            let (id, found) = (stored.keyframe.id, stored.keyframe.size());
            if stored.pinhole != self.keyframes[0].pinhole {
                return Err(ContinueError::SeveralCameras { id });
            }
            if found != expected {
                return Err(ContinueError::Size {
                    id,
                    found,
                    expected,
                });
            }
        }
        Ok(())
    }

    /// Checks that there are keyframes, all of them, with poses that can be.
    ///
    /// # Errors
    /// The first thing that is wrong.
    pub fn check_keyframes(&self) -> Result<(), ContinueError> {
        if self.keyframes.is_empty() {
            return Err(ContinueError::Empty);
        }
        for (id, stored) in (0..).zip(&self.keyframes) {
            if stored.keyframe.id != id {
                return Err(ContinueError::Missing { missing: id });
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

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::Mat7;
    use monogrid_graph::RobustKernel;
    use monogrid_image::Image;

    /// Keyframes in these fragments, each tracked on the one before, with an edge between them and
    /// a point that both see.
    fn map(fragments: &[FragmentId], focal: f64) -> StoredMap {
        let keyframe = |(id, fragment): (KeyframeId, &FragmentId)| StoredKeyframe {
            keyframe: Keyframe {
                id,
                frame_index: 0,
                timestamp_ns: 0,
                revision: 0,
                image: Image::filled(4, 3, 0),
                pixels: Vec::new(),
            },
            pinhole: Pinhole::new(focal, focal, 1.5, 1.0),
            fragment: *fragment,
            world_from_keyframe: Sim3::identity(),
            parent: id.checked_sub(1),
            gain: 1.0,
            bias: 0.0,
        };
        let pairs = || (1..fragments.len() as KeyframeId).map(|id| (id - 1, id));
        let edge = |(i, j): (KeyframeId, KeyframeId)| StoredEdge {
            kind: EdgeKind::Direct,
            edge: GraphEdge {
                i: i.into(),
                j: j.into(),
                i_from_j: Sim3::identity(),
                information: Mat7::identity(),
                kernel: RobustKernel::None,
            },
        };
        let point = |(host, other): (KeyframeId, KeyframeId)| StoredPoint {
            host,
            pixel: [1.0, 1.0],
            idepth: focal,
            prior: [1.0, 1.0],
            observations: vec![(other, [2.0, 2.0])],
        };
        StoredMap {
            scale: Scale::Arbitrary,
            pose_revision: 1,
            keyframes: (0..).zip(fragments).map(keyframe).collect(),
            edges: pairs().map(edge).collect(),
            points: pairs().map(point).collect(),
        }
    }

    #[test]
    fn maps_side_by_side_come_apart_again() {
        let first = StoredMap {
            scale: Scale::Metric,
            ..map(&[0, 0, 3], 1.0)
        };
        let all = StoredMap::side_by_side(vec![first, map(&[0, 0], 2.0), map(&[0, 1], 3.0)]);
        let fragments: Vec<FragmentId> = all.keyframes.iter().map(|k| k.fragment).collect();
        // main maps are numbered as the maps, the others have numbers of their own
        assert_eq!(fragments, [0, 0, 5, 1, 1, 2, 6]);
        let parents: Vec<_> = all.keyframes.iter().map(|k| k.parent).collect();
        assert_eq!(
            parents,
            [None, Some(0), Some(1), None, Some(3), None, Some(5)]
        );
        assert!(all.check_keyframes().is_ok());
        let cameras = ContinueError::SeveralCameras { id: 3 };
        assert_eq!(all.check((4, 3)), Err(cameras));

        let (second, ids) = all.fragment(1);
        assert_eq!(ids, [3, 4]);
        assert_eq!(second.points, map(&[0, 0], 2.0).points);
        assert_eq!(second.edges, map(&[0, 0], 2.0).edges);
        assert_eq!(second.scale, Scale::Arbitrary);
        assert_eq!(second.check((4, 3)), Ok(()));
        // what leads out of a fragment is left out with what it leads to
        let (main, ids) = all.fragment(0);
        assert_eq!((ids, main.scale), (vec![0, 1], Scale::Metric));
        assert_eq!((main.edges.len(), main.points.len()), (1, 2));
        assert_eq!(main.points[1].observations, []);
    }
}
