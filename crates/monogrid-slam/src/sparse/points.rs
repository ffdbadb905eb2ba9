//! The points and the steps for a new keyframe.

use super::adjust::{Gauge, adjust_window};
use super::matching::{NewPoint, anchor_points, find_in_new_keyframe, find_in_older_keyframes};
use super::{SparseConfig, adjust};
use crate::KeyframeId;
use crate::graph::{SparseEdge, SparseEdgeConfig};
use crate::node::{Node, steps_between};

use monogrid_depth::DepthMap;
use monogrid_geometry::{Pinhole, Se3, Vec2, Vec3};
use monogrid_image::Mask;
use std::collections::BTreeMap;

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
    /// Keyframes other than the host that see it.
    pub observations: Vec<Observation>,
    /// Whether it is still used.
    pub alive: bool,
}

/// What the sparse layer did for one keyframe.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SparseStats {
    /// Old points that were looked for.
    pub searched: usize,
    /// Old points whose patch was found.
    pub found: usize,
    /// Found points that agree with the pose.
    pub inliers: usize,
    /// New points.
    pub anchored: usize,
    /// Keyframes whose poses were adjusted.
    pub adjusted_keyframes: usize,
    /// Points in the adjustment.
    pub adjusted_points: usize,
    /// Observations that the adjustment refuted.
    pub removed_observations: usize,
}

/// Points and rigid poses of all keyframes.
#[derive(Clone, Debug, Default)]
pub(crate) struct SparseLayer {
    pub points: Vec<SparsePoint>,
    /// Pose of each keyframe, by identity, translation in world units.
    pub camera_from_world: Vec<Se3>,
    /// Whether the inverse depths of the first keyframe's points are metric measurements.
    pub has_seed: bool,
}

impl SparsePoint {
    /// Position in the world.
    pub(crate) fn position(&self, camera_from_world: &[Se3], pinhole: &Pinhole) -> Vec3 {
        let direction = pinhole.unproject(&self.pixel);
        camera_from_world[self.host as usize].inverse() * (direction / self.idepth)
    }
}

impl SparseLayer {
    /// Adds the newest of `nodes` and adjusts. `depth` is its dense depth (its own units), `recent` are
    /// the keyframes of its fragment in the order in which they were last used, the newest at the end.
    pub(crate) fn add_keyframe(
        &mut self,
        nodes: &[Node],
        recent: &[KeyframeId],
        depth: &DepthMap,
        pinhole: &Pinhole,
        mask: &Mask,
        config: &SparseConfig,
    ) -> SparseStats {
        let mut stats = SparseStats::default();
        let Some(node) = nodes.last() else {
            return stats;
        };
        self.camera_from_world
            .push(node.world_from_keyframe.to_se3().inverse());
        let search = find_in_new_keyframe(self, nodes, pinhole, config);
        stats.searched = search.num_searched;
        stats.found = search.found.len();
        let inliers = self.refine_pose(node.id, &search.found, pinhole, config);
        stats.inliers = inliers.len();
        for &(point, pixel) in &inliers {
            self.points[point].observations.push(Observation {
                keyframe: node.id,
                pixel,
            });
        }
        let seen: Vec<Vec2> = inliers.iter().map(|(_, pixel)| *pixel).collect();
        let anchored = anchor_points(node, depth, &seen, mask, config);
        stats.anchored = anchored.len();
        self.add_points(nodes, recent, anchored, pinhole, config);
        let gauge = Gauge::of(self, nodes, node.fragment);
        let adjusted = adjust_window(self, recent, gauge, pinhole, config);
        stats.adjusted_keyframes = adjusted.num_keyframes;
        stats.adjusted_points = adjusted.num_points;
        stats.removed_observations = adjusted.removed_observations;
        self.drop_unconfirmed(node, nodes, config);
        stats
    }

    /// Moves a keyframe with the points anchored in it; lengths there grow by the given factor.
    pub(crate) fn move_keyframe(
        &mut self,
        keyframe: KeyframeId,
        world_from_camera: &Se3,
        growth: f64,
    ) {
        let Some(pose) = self.camera_from_world.get_mut(keyframe as usize) else {
            return;
        };
        *pose = world_from_camera.inverse();
        for point in self.points.iter_mut().filter(|p| p.host == keyframe) {
            point.idepth /= growth;
            point.prior_idepth /= growth;
            point.prior_sigma /= growth;
        }
    }

    /// Pairs of keyframes with enough common points and not too far apart, of which one is among `window`,
    /// older keyframe first: of each keyframe the older ones with the most common points, those first.
    pub(crate) fn shared_points(
        &self,
        nodes: &[Node],
        window: &[KeyframeId],
        config: &SparseEdgeConfig,
    ) -> Vec<SparseEdge> {
        let mut shared: BTreeMap<(KeyframeId, KeyframeId), usize> = BTreeMap::new();
        let mut seen_by = Vec::new();
        for point in self.points.iter().filter(|p| p.alive) {
            seen_by.clear();
            seen_by.push(point.host);
            seen_by.extend(point.observations.iter().map(|o| o.keyframe));
            seen_by.sort_unstable();
            for (at, &j) in seen_by.iter().enumerate() {
                let is_recent = window.contains(&j);
                for &i in &seen_by[..at] {
                    if is_recent || window.contains(&i) {
                        *shared.entry((i, j)).or_default() += 1;
                    }
                }
            }
        }
        let mut edges: Vec<SparseEdge> = shared
            .into_iter()
            .filter(|((i, j), count)| {
                *count >= config.min_shared_points && steps_between(nodes, *i, *j) <= config.max_gap
            })
            .map(|((i, j), shared_points)| SparseEdge {
                i,
                j,
                shared_points,
            })
            .collect();
        // the strongest of each newer keyframe
        edges.sort_by_key(|e| (e.j, std::cmp::Reverse(e.shared_points), e.i));
        let mut taken = (KeyframeId::MAX, 0);
        edges.retain(|edge| {
            taken = (edge.j, if taken.0 == edge.j { taken.1 + 1 } else { 1 });
            taken.1 <= config.max_edges
        });
        edges
    }

    /// Pose of the new keyframe from the found points; returns those that agree with it.
    fn refine_pose(
        &mut self,
        keyframe: KeyframeId,
        found: &[(usize, Vec2)],
        pinhole: &Pinhole,
        config: &SparseConfig,
    ) -> Vec<(usize, Vec2)> {
        if found.len() < config.min_pose_points {
            return Vec::new();
        }
        let matches: Vec<(Vec3, Vec2)> = found
            .iter()
            .map(|(point, pixel)| {
                let position = self.points[*point].position(&self.camera_from_world, pinhole);
                (position, *pixel)
            })
            .collect();
        let initial = self.camera_from_world[keyframe as usize];
        let refined = adjust::refine_pose(&initial, &matches, pinhole, config);
        let inliers: Vec<(usize, Vec2)> = found
            .iter()
            .zip(&refined.inlier)
            .filter_map(|(f, ok)| ok.then_some(*f))
            .collect();
        if inliers.len() < config.min_pose_points || inliers.len() * 3 < found.len() {
            return Vec::new();
        }
        self.camera_from_world[keyframe as usize] = refined.camera_from_world;
        inliers
    }

    /// Adds new points and looks for them in older keyframes.
    fn add_points(
        &mut self,
        nodes: &[Node],
        recent: &[KeyframeId],
        anchored: Vec<NewPoint>,
        pinhole: &Pinhole,
        config: &SparseConfig,
    ) {
        let Some(node) = nodes.last() else {
            return;
        };
        let observations = find_in_older_keyframes(self, nodes, recent, &anchored, pinhole, config);
        for (new, observations) in anchored.into_iter().zip(observations) {
            self.points.push(SparsePoint {
                host: node.id,
                pixel: new.pixel,
                idepth: new.idepth,
                prior_idepth: new.idepth,
                prior_sigma: new.sigma,
                observations,
                alive: true,
            });
        }
    }

    /// Drops points that were not found again soon after they were anchored.
    fn drop_unconfirmed(&mut self, newest: &Node, nodes: &[Node], config: &SparseConfig) {
        for point in &mut self.points {
            let is_near = nodes[point.host as usize].fragment == newest.fragment;
            let age = newest.id.saturating_sub(point.host);
            let old = is_near && age >= config.drop_after_keyframes;
            if old && point.observations.len() < 2 {
                point.alive = false;
            }
        }
    }
}
