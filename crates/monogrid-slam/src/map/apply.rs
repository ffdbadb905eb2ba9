//! The one way in which the map changes.

use super::arena::Map;
use super::change::{Change, FinishedKeyframe, Found, NewKeyframe, Placed};
use super::event::{Changes, Event};
use super::keyframe::MapKeyframe;
use super::points::{Adjustment, Observation, Registration, SeenPoints, SparsePoint};
use crate::graph::{EdgeChanges, GraphUpdate, Joined};
use crate::stored::StoredEdge;
use crate::{Fragment, FragmentId, Join, KeyframeId, MAIN_MAP};
use monogrid_geometry::Sim3;
use std::sync::Arc;

impl Map {
    /// Takes over what a stage has found.
    pub(crate) fn apply(&mut self, change: Change) {
        match change {
            Change::Scaled(scale) => self.scale = scale,
            Change::Created(new) => self.create(new),
            Change::Finished(finished) => self.finish(finished),
            Change::Reactivated(id) => self.reactivate(id),
            Change::Registered(found) => self.register(found),
            Change::Anchored(points) => self.anchor(points),
            Change::Observed(seen) => self.observe(seen),
            Change::Adjusted(adjusted) => self.adjust(adjusted),
            Change::Unconfirmed(points) => {
                for point in points {
                    self.points[point].alive = false;
                }
            }
            Change::Linked(id, links) => self.keyframes[id as usize].points.links = links,
            Change::Posed(poses) => self.pose(&poses),
            Change::Optimised(update, frame_index) => self.follow_graph(*update, frame_index),
            Change::Constrained(edges) => self.edges = edges,
            Change::Tracked(record) => self.frames.add(record),
            Change::Visited(keyframe, begin_ns, end) => self.frames.visit(keyframe, begin_ns, end),
            Change::Bridged(bridge) => self.bridges.push(bridge),
            Change::Placed(placed) => self.place(&placed),
            Change::Started(fragment) => {
                self.changes.others.push(Event::Started(fragment.id));
                self.fragments.push(fragment);
            }
            Change::Exchanged(fragment) => self.exchange(fragment),
            Change::Lost(frame_index) => {
                self.counts.lost_episodes += 1;
                self.changes.others.push(Event::Lost { frame_index });
            }
            Change::Found(found) => self.find(&found),
        }
    }

    /// What others should hear of since the last call, in the order of keyframes.
    pub(crate) fn take_events(&mut self) -> Vec<Event> {
        let is_known = self
            .keyframes
            .first()
            .is_some_and(|k| k.published.is_some());
        if self.changes.finished.is_empty() && !is_known {
            // poses of keyframes that nobody knows
            self.changes.has_moved = false;
        }
        let changes = std::mem::take(&mut self.changes);
        let Changes {
            finished,
            revised,
            has_moved,
            others,
        } = changes;
        let mut events = Vec::new();
        for id in finished.union(&revised) {
            let Some(keyframe) = self[*id].as_published() else {
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

    fn create(&mut self, new: NewKeyframe) {
        let id = self.next_id();
        let rank = self.num_keyframes_in(new.fragment) as u32;
        let camera_from_world = new.camera_from_world();
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
            camera_from_world,
            covariance: None,
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

    fn finish(&mut self, finished: FinishedKeyframe) {
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

    fn reactivate(&mut self, id: KeyframeId) {
        self.recent.retain(|other| *other != id);
        self.recent.push(id);
        self.counts.reactivations += 1;
    }

    fn register(&mut self, found: Registration) {
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

    fn anchor(&mut self, points: Vec<SparsePoint>) {
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

    fn observe(&mut self, seen: Vec<(usize, Observation)>) {
        for (point, observation) in seen {
            let others = &mut self.keyframes[observation.keyframe as usize].points.others;
            if let Err(at) = others.binary_search(&point) {
                others.insert(at, point);
                self.points[point].observations.push(observation);
            }
        }
    }

    fn adjust(&mut self, adjusted: Adjustment) {
        if let Some(failure) = adjusted.failure {
            self.counts.failed_adjustments += 1;
            self.changes.others.push(Event::NotAdjusted(failure));
        }
        for (id, pose) in adjusted.camera_from_world {
            self.keyframes[id as usize].camera_from_world = pose;
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

    fn pose(&mut self, poses: &[(KeyframeId, Sim3)]) {
        for (id, world_from_keyframe) in poses {
            self.keyframes[*id as usize].world_from_keyframe = *world_from_keyframe;
        }
        self.note_poses();
    }

    /// Moves the keyframes, and with them what is anchored in them.
    fn follow_graph(&mut self, update: GraphUpdate, frame_index: usize) {
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
        let Some(keyframe) = self.keyframes.get_mut(index) else {
            return;
        };
        let growth = pose.scale / keyframe.world_from_keyframe.scale;
        keyframe.camera_from_world = pose.to_se3().inverse();
        keyframe.world_from_keyframe = *pose;
        if growth != 1.0 {
            for point in &mut self.points[keyframe.points.anchored.clone()] {
                point.grow(growth);
            }
        }
    }

    /// Moves the keyframes of a fragment to where it lies in another, of which they are a part from now on.
    fn place(&mut self, placed: &Placed) {
        let joined = Joined {
            from: placed.fragment,
            into: placed.into,
        };
        self.join(&joined, placed.frame_index);
        for index in 0..self.keyframes.len() {
            if self.keyframes[index].fragment == placed.fragment {
                let pose = placed.into_from_fragment * self.keyframes[index].world_from_keyframe;
                self.carry(index, &pose);
                self.keyframes[index].fragment = placed.into;
            }
        }
        self.note_poses();
    }

    /// Makes a fragment that is apart the main map, and the main map that fragment; each keeps its world.
    fn exchange(&mut self, fragment: FragmentId) {
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

    fn find(&mut self, found: &Found) {
        self.counts.relocalisations += usize::from(found.is_recognised);
        self.changes.others.push(Event::Found {
            frame_index: found.frame_index,
            keyframe: found.keyframe,
        });
    }

    fn note_poses(&mut self) {
        self.changes.has_moved = true;
        self.renew_snapshot(self.snapshot.revision + 1);
    }
}

#[cfg(test)]
mod tests;
