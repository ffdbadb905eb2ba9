//! Poses of all frames from those of the keyframes.

use super::{Record, Slam};
use crate::node::world_from_camera;
use crate::{FragmentId, KeyframeId, MAIN_MAP, TrajectoryPose};
use monogrid_alignment::Motion;
use monogrid_geometry::{Se3, Vec6};

/// A stretch of time in which frames were tracked on one keyframe.
#[derive(Clone, Copy, Debug)]
pub(super) struct Visit {
    pub keyframe: KeyframeId,
    begin_ns: i64,
    end: Option<VisitEnd>,
}

/// The frame with which tracking went on with another keyframe.
#[derive(Clone, Copy, Debug)]
struct VisitEnd {
    timestamp_ns: i64,
    /// As it was tracked on the keyframe that was left.
    frame_from_keyframe: Se3,
    next: KeyframeId,
    frame_from_next: Se3,
}

impl Visit {
    pub(super) fn new(keyframe: KeyframeId, begin_ns: i64) -> Self {
        Self {
            keyframe,
            begin_ns,
            end: None,
        }
    }

    /// The next keyframe and the pose relative to it of the frame of this time, if that ended the visit.
    pub(super) fn handed_over_at(&self, timestamp_ns: i64) -> Option<(KeyframeId, Se3)> {
        let end = self.end.as_ref()?;
        (end.timestamp_ns == timestamp_ns).then_some((end.next, end.frame_from_next))
    }
}

/// What is known now about the end of a visit: the pose of its last frame relative to the next keyframe
/// differs from the tracked one.
struct Correction {
    begin_ns: i64,
    end_ns: i64,
    /// Logarithm of `tracked_from_adjusted` of the last frame's camera.
    twist: Vec6,
}

impl Correction {
    /// The share of the correction that has built up at a time, taken as growing evenly.
    fn at(&self, timestamp_ns: i64) -> Se3 {
        let length = (self.end_ns - self.begin_ns).max(1) as f64;
        let share = (timestamp_ns - self.begin_ns) as f64 / length;
        Se3::exp(&(self.twist * share.clamp(0.0, 1.0)))
    }
}

impl Slam {
    /// Ends the visit of the current keyframe with a frame that both keyframes know.
    pub(super) fn hand_over(
        &mut self,
        timestamp_ns: i64,
        motion: &Motion,
        next: KeyframeId,
        frame_from_next: Se3,
    ) {
        if let Some(visit) = self.visits.last_mut() {
            visit.end = Some(VisitEnd {
                timestamp_ns,
                frame_from_keyframe: motion.frame_from_keyframe,
                next,
                frame_from_next,
            });
        }
        self.visits.push(Visit::new(next, timestamp_ns));
    }

    /// All frames with a believed pose in the main map, with everything known now, in the order of time.
    ///
    /// Frames are known relative to their keyframe. Where the keyframe after it says something else about
    /// the last of them, the difference is spread over the frames of the visit.
    #[must_use]
    pub fn trajectory(&self) -> Vec<TrajectoryPose> {
        self.trajectory_in(MAIN_MAP)
    }

    /// The same of a fragment, in its own world; empty once it is joined to another.
    #[must_use]
    pub fn trajectory_in(&self, fragment: FragmentId) -> Vec<TrajectoryPose> {
        let mut poses: Vec<TrajectoryPose> = self
            .corrected_poses()
            .filter(|(record, _)| self.fragment_of(record) == fragment)
            .map(|(record, world_from_camera)| TrajectoryPose {
                frame_index: record.frame_index,
                timestamp_ns: record.timestamp_ns,
                world_from_camera,
            })
            .collect();
        poses.sort_by_key(|pose| (pose.timestamp_ns, pose.frame_index));
        poses
    }

    /// All records with `world_from_camera`, each in the world of its fragment.
    pub(super) fn corrected_poses(&self) -> impl Iterator<Item = (&Record, Se3)> {
        let corrections: Vec<Option<Correction>> =
            self.visits.iter().map(|v| self.correction(v)).collect();
        self.records.iter().map(move |record| {
            let tracked = self.tracked_pose(record);
            let correction = corrections.get(record.visit);
            let pose = match correction.and_then(Option::as_ref) {
                Some(correction) => tracked * correction.at(record.timestamp_ns),
                None => tracked,
            };
            (record, pose)
        })
    }

    /// The fragment of the keyframe that a frame was tracked on.
    pub(super) fn fragment_of(&self, record: &Record) -> FragmentId {
        let keyframe = self.visits[record.visit].keyframe;
        self.nodes[keyframe as usize].fragment
    }

    fn tracked_pose(&self, record: &Record) -> Se3 {
        let keyframe = &self.nodes[self.visits[record.visit].keyframe as usize];
        world_from_camera(&keyframe.world_from_keyframe, &record.frame_from_keyframe)
    }

    /// The correction over the time of a visit; none for the last one, or where tracking was lost.
    fn correction(&self, visit: &Visit) -> Option<Correction> {
        let end = visit.end.as_ref()?;
        let pose = |keyframe: KeyframeId, frame_from_keyframe: &Se3| {
            let node = self.nodes.get(keyframe as usize)?;
            Some(world_from_camera(
                &node.world_from_keyframe,
                frame_from_keyframe,
            ))
        };
        let tracked = pose(visit.keyframe, &end.frame_from_keyframe)?;
        let adjusted = pose(end.next, &end.frame_from_next)?;
        Some(Correction {
            begin_ns: visit.begin_ns,
            end_ns: end.timestamp_ns,
            twist: (tracked.inverse() * adjusted).log(),
        })
    }
}
