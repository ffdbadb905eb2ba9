//! Poses of all frames from those of the keyframes.

use super::{Record, Slam};
use crate::TrajectoryPose;
use crate::node::world_from_camera;
use monogrid_geometry::{Se3, Vec6};

/// What adjustment found about the end of a keyframe's time: the pose of the next keyframe differs from
/// the tracked one.
struct Correction {
    begin_ns: i64,
    end_ns: i64,
    /// Logarithm of `tracked_from_adjusted` of the next keyframe's camera.
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
    /// All frames with a believed pose, with everything known now, in the order of time.
    ///
    /// Frames are known relative to their keyframe. Where the next keyframe was adjusted, the difference
    /// to its tracked pose is spread over the frames between the two.
    #[must_use]
    pub fn trajectory(&self) -> Vec<TrajectoryPose> {
        let corrections = self.corrections();
        let mut poses: Vec<TrajectoryPose> = self
            .records
            .iter()
            .map(|record| {
                let tracked = self.tracked_pose(record);
                let correction = corrections.get(record.keyframe as usize);
                TrajectoryPose {
                    frame_index: record.frame_index,
                    timestamp_ns: record.timestamp_ns,
                    world_from_camera: match correction.and_then(Option::as_ref) {
                        Some(correction) => tracked * correction.at(record.timestamp_ns),
                        None => tracked,
                    },
                }
            })
            .collect();
        poses.sort_by_key(|pose| (pose.timestamp_ns, pose.frame_index));
        poses
    }

    fn tracked_pose(&self, record: &Record) -> Se3 {
        let keyframe = &self.nodes[record.keyframe as usize];
        world_from_camera(&keyframe.world_from_keyframe, &record.frame_from_keyframe)
    }

    /// Per keyframe the correction over its time; none for the last one.
    fn corrections(&self) -> Vec<Option<Correction>> {
        let mut corrections: Vec<Option<Correction>> = self.nodes.iter().map(|_| None).collect();
        for record in &self.records {
            let Some(next) = self.nodes.get(record.keyframe as usize + 1) else {
                continue;
            };
            if record.frame_index == next.frame_index {
                let tracked_from_adjusted =
                    self.tracked_pose(record).inverse() * next.world_from_keyframe.to_se3();
                corrections[record.keyframe as usize] = Some(Correction {
                    begin_ns: self.nodes[record.keyframe as usize].timestamp_ns,
                    end_ns: next.timestamp_ns,
                    twist: tracked_from_adjusted.log(),
                });
            }
        }
        corrections
    }
}
