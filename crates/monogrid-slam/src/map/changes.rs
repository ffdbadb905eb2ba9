//! The ways in which the map changes, and what others hear of it.

use super::arena::Map;
use super::events::{Changes, Event};
use super::keyframe::MapKeyframe;
use super::points::{Adjustment, DenseLink, Observation, Registration, SeenPoints, SparsePoint};
use crate::graph::{EdgeChanges, GraphUpdate, Joined};
use crate::store::Kept;
use crate::stored::StoredEdge;
use crate::view::{Exposure, KeyframeImage, View};
use crate::{Bridge, Fragment, FragmentId, Join, KeptKeyframe, KeyframeId, MAIN_MAP, Scale};
use monogrid_depth::{MeasuredDepth, PackedDepth};
use monogrid_geometry::Sim3;
use std::sync::Arc;

/// A keyframe to be made.
#[derive(Debug)]
pub(crate) struct NewKeyframe {
    pub fragment: FragmentId,
    pub parent: Option<KeyframeId>,
    pub frame_index: usize,
    pub timestamp_ns: i64,
    pub image: KeyframeImage,
    pub exposure: Exposure,
    /// In the world of its fragment.
    pub world_from_keyframe: Sim3,
    /// What a depth camera measured with its frame; only in a fragment in metres.
    pub measured: Option<Kept<MeasuredDepth>>,
}

/// A keyframe as tracking has left it.
#[derive(Debug)]
pub(crate) struct FinishedKeyframe {
    pub id: KeyframeId,
    /// What everybody should use from now on, where that is worth it.
    pub published: Option<KeptKeyframe>,
    /// Its depth, to be used again.
    pub depth: Option<Kept<PackedDepth>>,
    /// Its dense depth at the points that it sees.
    pub links: Vec<DenseLink>,
    /// What the graph needs, where there is one.
    pub view: Option<Arc<View>>,
}

impl Map {
    /// Says whether the unit of the world is the metre.
    pub(crate) fn set_scale(&mut self, scale: Scale) {
        self.scale = scale;
    }

    /// These points are no longer used.
    pub(crate) fn drop_points(&mut self, points: Vec<usize>) {
        for point in points {
            self.points[point].alive = false;
        }
    }

    /// This is the dense depth of a keyframe at the points that it sees.
    pub(crate) fn link(&mut self, id: KeyframeId, links: Vec<DenseLink>) {
        self.keyframes[id as usize].points.links = links;
    }

    /// These are the constraints between keyframes.
    pub(crate) fn set_edges(&mut self, edges: Vec<StoredEdge>) {
        self.edges = edges;
    }

    /// The next keyframe goes on after a loss.
    pub(crate) fn bridge(&mut self, bridge: Bridge) {
        self.bridges.push(bridge);
    }

    /// A fragment begins.
    pub(crate) fn begin_fragment(&mut self, fragment: Fragment) {
        self.changes.others.push(Event::Started(fragment.id));
        self.fragments.push(fragment);
    }

    /// The camera is lost from this frame on.
    pub(crate) fn lose(&mut self, frame_index: usize) {
        self.counts.lost_episodes += 1;
        self.changes.others.push(Event::Lost { frame_index });
    }

    /// The camera has a pose again, on a keyframe: it was recognised, or tracking alone found it.
    pub(crate) fn find(&mut self, frame_index: usize, keyframe: KeyframeId, is_recognised: bool) {
        self.counts.relocalisations += usize::from(is_recognised);
        self.changes.others.push(Event::Found {
            frame_index,
            keyframe,
        });
    }

    /// What others should hear of since the last call, in the order of keyframes.
    pub(crate) fn take_events(&mut self) -> Vec<Event> {
        let first = self.keyframes.first();
        if self.changes.finished.is_empty() && first.is_none_or(|k| k.published.is_none()) {
            // poses of keyframes that nobody knows
            self.changes.has_moved = false;
        }
        let Changes {
            finished,
            revised,
            has_moved,
            others,
        } = std::mem::take(&mut self.changes);
        let mut events = Vec::new();
        for id in finished.union(&revised) {
            let Some(keyframe) = self[*id].published.clone() else {
                continue;
            };
            events.push(if finished.contains(id) {
                Event::Finished(keyframe, Arc::clone(&self.snapshot))
            } else {
                Event::Revised(keyframe)
            });
        }
        if has_moved && finished.is_empty() {
            events.push(Event::Moved(Arc::clone(&self.snapshot)));
        }
        events.extend(others);
        events
    }

    /// There is a new keyframe, the newest.
    pub(crate) fn create(&mut self, new: NewKeyframe) {
        let id = self.next_id();
        let rank = self.num_keyframes_in(new.fragment) as u32;
        self.recent.push(id);
        self.keyframes.push(MapKeyframe {
            id,
            fragment: new.fragment,
            rank,
            parent: new.parent,
            frame_index: new.frame_index,
            timestamp_ns: new.timestamp_ns,
            exposure: new.exposure,
            world_from_keyframe: new.world_from_keyframe,
            camera_from_world: new.world_from_keyframe.to_se3().inverse(),
            pose_sigma: None,
            covariance: None,
            measured: new.measured,
            depth: None,
            published: None,
            view: None,
            points: SeenPoints {
                anchored: self.points.len()..self.points.len(),
                ..SeenPoints::default()
            },
            image: new.image,
        });
        self.note_poses();
    }

    /// Tracking has left a keyframe.
    pub(crate) fn finish(&mut self, finished: FinishedKeyframe) {
        let id = finished.id;
        let keyframe = &mut self.keyframes[id as usize];
        if let Some(published) = finished.published {
            if keyframe.published.is_none() {
                self.changes.finished.insert(id);
            } else {
                self.changes.revised.insert(id);
            }
            keyframe.published = Some(published);
        }
        if finished.depth.is_some() {
            keyframe.depth = finished.depth;
        }
        keyframe.points.links = finished.links;
        keyframe.view = finished.view;
    }

    /// Tracking goes on with a keyframe that existed already.
    pub(crate) fn reactivate(&mut self, id: KeyframeId) {
        self.recent.retain(|other| *other != id);
        self.recent.push(id);
        self.counts.reactivations += 1;
    }

    /// The newest keyframe was found among the points.
    pub(crate) fn register(&mut self, found: Registration) {
        let Some(keyframe) = self.keyframes.last_mut() else {
            return;
        };
        if let Some(pose) = found.camera_from_world {
            keyframe.camera_from_world = pose;
        }
        for &(point, pixel) in &found.inliers {
            let keyframe = keyframe.id;
            let observation = Observation { keyframe, pixel };
            self.points[point].observations.push(observation);
        }
        keyframe.points.others = found.inliers.iter().map(|(point, _)| *point).collect();
        keyframe.points.others.sort_unstable();
    }

    /// There are new points in the newest keyframe.
    pub(crate) fn anchor(&mut self, points: Vec<SparsePoint>) {
        let first = self.points.len();
        for (index, point) in (first..).zip(&points) {
            for observation in &point.observations {
                let keyframe = &mut self.keyframes[observation.keyframe as usize];
                keyframe.points.others.push(index);
            }
        }
        self.points.extend(points);
        if let Some(keyframe) = self.keyframes.last_mut() {
            keyframe.points.anchored = first..self.points.len();
        }
    }

    /// A depth camera measured what a keyframe sees, and so the points that are anchored in it.
    pub(crate) fn measure(&mut self, id: KeyframeId, measured: &MeasuredDepth) {
        let kept = self.store().keep(measured.clone());
        let keyframe = &mut self.keyframes[id as usize];
        for point in &mut self.points[keyframe.points.anchored.clone()] {
            if let Some((idepth, sigma)) = measured.near(point.pixel.x, point.pixel.y) {
                point.measure(f64::from(idepth), f64::from(sigma));
            }
        }
        keyframe.measured = Some(kept);
    }

    /// Keyframes see these points, by index, too.
    pub(crate) fn observe(&mut self, seen: Vec<(usize, Observation)>) {
        for (point, observation) in seen {
            let others = &mut self.keyframes[observation.keyframe as usize].points.others;
            if let Err(at) = others.binary_search(&point) {
                others.insert(at, point);
                self.points[point].observations.push(observation);
            }
        }
    }

    /// The points and the poses of their keyframes were adjusted.
    pub(crate) fn adjust(&mut self, adjusted: Adjustment) {
        if let Some(failure) = adjusted.failure {
            self.counts.failed_adjustments += 1;
            self.changes.others.push(Event::NotAdjusted(failure));
        }
        for (id, pose) in adjusted.camera_from_world {
            self.keyframes[id as usize].camera_from_world = pose;
        }
        if let Some((id, sigma)) = adjusted.last {
            self.keyframes[id as usize].pose_sigma = Some(sigma);
        }
        for (point, idepth) in adjusted.idepths {
            self.points[point].idepth = idepth;
        }
        for (point, id) in adjusted.refuted {
            self.points[point].observations.retain(|o| o.keyframe != id);
            let others = &mut self.keyframes[id as usize].points.others;
            if let Ok(at) = others.binary_search(&point) {
                others.remove(at);
            }
        }
    }

    /// Poses and units follow the points.
    pub(crate) fn pose(&mut self, poses: &[(KeyframeId, Sim3)]) {
        for (id, world_from_keyframe) in poses {
            self.keyframes[*id as usize].world_from_keyframe = *world_from_keyframe;
        }
        self.note_poses();
    }

    /// The graph has moved keyframes, with what is anchored in them, after this frame.
    pub(crate) fn follow_graph(&mut self, update: GraphUpdate, frame_index: usize) {
        let poses = update.poses;
        for (index, pose) in poses.world_from_keyframe.iter().enumerate() {
            self.carry(index, pose);
        }
        for joined in &update.joined {
            self.join(joined, frame_index);
        }
        let covariances = poses.previous_from_keyframe_covariance;
        let known = poses.fragment.into_iter().zip(covariances);
        for (keyframe, (fragment, covariance)) in self.keyframes.iter_mut().zip(known) {
            keyframe.fragment = fragment;
            keyframe.covariance = covariance;
        }
        self.follow_edges(update.edges);
        let failure = update.failure.map(Event::NotOptimised);
        self.changes.others.extend(failure);
        self.note_poses();
    }

    /// Edges are in the order of their keys, and most that change are near the end.
    fn follow_edges(&mut self, changes: EdgeChanges) {
        for key in changes.removed {
            if let Ok(at) = self.edges.binary_search_by_key(&key, StoredEdge::key) {
                self.edges.remove(at);
            }
        }
        for edge in changes.set {
            match self
                .edges
                .binary_search_by_key(&edge.key(), StoredEdge::key)
            {
                Ok(at) => self.edges[at] = edge,
                Err(at) => self.edges.insert(at, edge),
            }
        }
    }

    /// Moves a keyframe, and with it the points that are anchored in it.
    fn carry(&mut self, index: usize, pose: &Sim3) {
        let is_metric = self.scale == Scale::Metric;
        let Some(keyframe) = self.keyframes.get_mut(index) else {
            return;
        };
        let before = keyframe.world_from_keyframe.scale;
        let mut pose = *pose;
        if is_metric && keyframe.measured.is_some() {
            // a depth camera measured it: constraints say where it is, and not how large
            pose.scale = before;
        }
        let growth = pose.scale / before;
        keyframe.camera_from_world = pose.to_se3().inverse();
        keyframe.world_from_keyframe = pose;
        if growth != 1.0 {
            for point in &mut self.points[keyframe.points.anchored.clone()] {
                point.grow(growth);
            }
        }
    }

    /// Moves the keyframes of a fragment to where it lies in another, of which they are a part from
    /// now on, after this frame.
    pub(crate) fn place(&mut self, placed: Joined, into_from_fragment: &Sim3, frame_index: usize) {
        self.join(&placed, frame_index);
        for index in 0..self.keyframes.len() {
            if self.keyframes[index].fragment == placed.from {
                let pose = *into_from_fragment * self.keyframes[index].world_from_keyframe;
                self.carry(index, &pose);
                self.keyframes[index].fragment = placed.into;
            }
        }
        self.note_poses();
    }

    /// Makes a fragment that is apart the main map, and the main map that fragment; each keeps its
    /// world.
    pub(crate) fn exchange(&mut self, fragment: FragmentId) {
        let exchanged = |id: FragmentId| match id {
            MAIN_MAP => fragment,
            id if id == fragment => MAIN_MAP,
            id => id,
        };
        for keyframe in &mut self.keyframes {
            keyframe.fragment = exchanged(keyframe.fragment);
        }
        let first = self.in_fragment(fragment).next();
        let first = first.map(|keyframe| (keyframe.id, keyframe.frame_index));
        for known in &mut self.fragments {
            if let Some(join) = &mut known.joined {
                join.into = exchanged(join.into);
            }
            if let (true, Some((id, frame_index))) = (known.id == fragment, first) {
                *known = Fragment::begun(fragment, id, frame_index);
            }
        }
        self.exchanged = Some(fragment);
        self.note_poses();
    }

    /// Notes that a fragment was joined, before its keyframes are told.
    fn join(&mut self, joined: &Joined, frame_index: usize) {
        let Some(at) = self.fragments.iter().position(|f| f.id == joined.from) else {
            return;
        };
        let fragment = Fragment {
            joined: Some(Join {
                into: joined.into,
                frame: frame_index,
            }),
            ..self.with_counts(&self.fragments[at])
        };
        self.fragments[at] = fragment;
        self.changes.others.push(Event::Joined(fragment));
    }

    fn note_poses(&mut self) {
        self.changes.has_moved = true;
        self.renew_snapshot(self.snapshot.revision + 1);
    }
}

#[cfg(test)]
mod tests;
