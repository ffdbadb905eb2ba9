//! Where the camera was, as the map has it now.

use monogrid_geometry::{Se3, Sim3};
use monogrid_messages::builtin_interfaces::Time;
use monogrid_slam::{KeyframeId, PoseSnapshot};

/// Poses closer in time are left out, ns.
const MIN_INTERVAL_NS: i64 = 100_000_000;

/// Poses relative to keyframes, which move with them.
#[derive(Clone, Debug, Default)]
pub struct Trail {
    poses: Vec<TrailPose>,
    interval_ns: i64,
}

#[derive(Clone, Copy, Debug)]
struct TrailPose {
    stamp: Time,
    keyframe: KeyframeId,
    keyframe_from_camera: Sim3,
}

impl Trail {
    /// Adds a pose that was tracked on a keyframe, unless the last one is too near in time. Of more
    /// than `most` poses, every second one goes.
    pub fn add(
        &mut self,
        stamp: Time,
        world_from_camera: &Se3,
        keyframe: KeyframeId,
        poses: &PoseSnapshot,
        most: usize,
    ) {
        let last = self.poses.last();
        let since = last.map(|last| stamp.nanoseconds() - last.stamp.nanoseconds());
        if since.is_some_and(|since| since < self.interval_ns.max(MIN_INTERVAL_NS)) {
            return;
        }
        let Some(world_from_keyframe) = poses.in_main_map(keyframe) else {
            return;
        };
        if self.poses.len() >= most {
            let mut is_kept = false;
            self.poses.retain(|_| {
                is_kept = !is_kept;
                is_kept
            });
            self.interval_ns = 2 * self.interval_ns.max(MIN_INTERVAL_NS);
        }
        self.poses.push(TrailPose {
            stamp,
            keyframe,
            keyframe_from_camera: world_from_keyframe.inverse() * world_from_camera.with_scale(1.0),
        });
    }

    /// All poses where the keyframes are now: world_from_camera.
    #[must_use]
    pub fn now(&self, poses: &PoseSnapshot) -> Vec<(Time, Se3)> {
        let known = self.poses.iter().filter_map(|pose| {
            let world_from_keyframe = *poses.in_main_map(pose.keyframe)?;
            let world_from_camera = world_from_keyframe * pose.keyframe_from_camera;
            Some((pose.stamp, world_from_camera.to_se3()))
        });
        known.collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::{Rotation, Vec3};

    fn at(x: f64) -> Se3 {
        Se3::new(Rotation::identity(), Vec3::new(x, 0.0, 0.0))
    }

    fn keyframe_at(x: f64, scale: f64) -> PoseSnapshot {
        PoseSnapshot {
            world_from_keyframe: vec![at(x).with_scale(scale)],
            ..PoseSnapshot::default()
        }
    }

    fn stamp(tenths: i64) -> Time {
        Time::from_nanoseconds(tenths * MIN_INTERVAL_NS)
    }

    #[test]
    fn poses_move_and_grow_with_their_keyframe() {
        let mut trail = Trail::default();
        let before = keyframe_at(1.0, 1.0);
        trail.add(stamp(0), &at(3.0), 0, &before, 10);
        // a keyframe that is not there
        trail.add(stamp(5), &at(3.0), 7, &before, 10);
        let now = trail.now(&keyframe_at(5.0, 0.5));
        assert_eq!(now.len(), 1);
        assert!((now[0].1.translation.x - 6.0).abs() < 1e-12);
    }

    #[test]
    fn a_long_trail_becomes_coarser() {
        let mut trail = Trail::default();
        let poses = keyframe_at(0.0, 1.0);
        for tenth in 0..100 {
            trail.add(stamp(tenth), &at(tenth as f64), 0, &poses, 8);
            trail.add(stamp(tenth), &at(tenth as f64), 0, &poses, 8);
        }
        let now = trail.now(&poses);
        assert!((5..=8).contains(&now.len()), "{}", now.len());
        assert_eq!(now[0].0, stamp(0));
        assert!(now.windows(2).all(|pair| pair[0].0 < pair[1].0));
        // what is left reaches to the end
        assert!(now[now.len() - 1].1.translation.x > 80.0);
    }
}
