//! Where the camera was in frames that were lost for a short time, from the frames on both sides.
//!
//! Somebody walks through the picture, or the lens is covered: nothing says where the camera is,
//! but it goes on as it moved. Between two poses its place follows the cubic Hermite curve, and so
//! does its orientation, in the tangent space of the first. The error of the curve grows with the
//! square of the time and with how much the camera accelerates, which the rest of the path shows.
//! Nothing is taken from such a pose: no depth, no keyframe.

use crate::keyframe::{PoseSource, TrajectoryPose};
use crate::median::median;
use monogrid_geometry::{Rotation, Se3, Vec3, rotation_exp, rotation_log};
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// A pose that images gave.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SeenPose {
    pub pose: TrajectoryPose,
    /// Median depth of what its keyframe sees, in units of the world.
    pub median_depth: f64,
}

/// A frame that was lost.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(crate) struct LostFrame {
    pub frame_index: usize,
    pub timestamp_ns: i64,
}

/// Error of the curve in its middle, as a share of acceleration times the square of its time. On
/// four recordings and 24 rooms with known paths half of the errors are below 0.03 to 0.05 of it,
/// for losses from half a second on.
const ERROR_SHARE: f64 = 0.06;
/// Largest error in place, median depths.
const MAX_PLACE: f64 = 0.02;
/// Largest error in orientation, degrees.
const MAX_TURN_DEG: f64 = 1.0;
/// The longest loss: a hand does something else in between, however calm it was.
const MAX_SECS: f64 = 1.5;
/// Time over which the motion at a pose is measured, if frames do not come less often: the noise of
/// single poses shows less over a longer one.
const MOTION_SECS: f64 = 0.15;
/// Beyond this time between two poses there is no motion at either.
const MAX_STEP_SECS: f64 = 0.3;

/// Poses of lost frames between poses of one map, which come in the order of time.
pub(crate) fn interpolated(seen: &[SeenPose], lost: &[LostFrame]) -> Vec<TrajectoryPose> {
    let Some(max_secs) = Acceleration::usual(seen).map(Acceleration::longest_secs) else {
        return Vec::new();
    };
    let mut poses = Vec::new();
    for (k, pair) in seen.windows(2).enumerate() {
        let times = pair[0].pose.timestamp_ns..pair[1].pose.timestamp_ns;
        if seconds(&times) > max_secs {
            continue;
        }
        let between = |frame: &&LostFrame| times.contains(&frame.timestamp_ns);
        let mut frames = lost.iter().filter(between).peekable();
        if frames.peek().is_some() {
            let curve = Curve::between(&seen[..=k], &seen[k + 1..]);
            poses.extend(frames.map(|frame| curve.at(frame)));
        }
    }
    poses
}

fn seconds(times: &Range<i64>) -> f64 {
    (times.end - times.start) as f64 * 1e-9
}

/// How much a camera accelerates, a median over its path.
#[derive(Clone, Copy, Debug)]
struct Acceleration {
    /// Median depths per square second.
    place: f64,
    /// rad per square second.
    turn: f64,
}

impl Acceleration {
    /// Over the whole path; `None` where no three poses are near each other.
    fn usual(seen: &[SeenPose]) -> Option<Self> {
        let at = |k: usize| Self::at(&seen[..=k], &seen[k..]);
        let (mut place, mut turn): (Vec<f64>, Vec<f64>) = (0..seen.len())
            .filter_map(at)
            .map(|a| (a.place, a.turn))
            .unzip();
        Some(Self {
            place: median(&mut place)?,
            turn: median(&mut turn)?,
        })
    }

    /// From the motion before a pose, the last of `before`, to that after it, the first of `after`.
    fn at(before: &[SeenPose], after: &[SeenPose]) -> Option<Self> {
        let (left, right) = (Motion::before(before)?, Motion::after(after)?);
        let secs = 0.5 * (left.secs + right.secs);
        Some(Self {
            place: (right.velocity - left.velocity).norm() / secs / after[0].median_depth,
            turn: (right.turn_rate - left.turn_rate).norm() / secs,
        })
    }

    /// The longest loss over which the error of the curve is small.
    fn longest_secs(self) -> f64 {
        let by_place = MAX_PLACE / (ERROR_SHARE * self.place);
        let by_turn = MAX_TURN_DEG.to_radians() / (ERROR_SHARE * self.turn);
        // NaN is no time
        by_place.sqrt().min(by_turn.sqrt()).min(MAX_SECS)
    }
}

/// How the camera moves at a pose.
#[derive(Clone, Copy, Debug)]
struct Motion {
    /// In the world, per second.
    velocity: Vec3,
    /// In the camera, rad per second.
    turn_rate: Vec3,
    /// Time over which it was measured.
    secs: f64,
}

impl Motion {
    /// Up to the last of these poses.
    fn before(seen: &[SeenPose]) -> Option<Self> {
        let (last, others) = seen.split_last()?;
        Self::over(others.iter().rev(), last)
    }

    /// From the first of these poses on.
    fn after(seen: &[SeenPose]) -> Option<Self> {
        let (first, others) = seen.split_first()?;
        Self::over(others.iter(), first)
    }

    /// Between a pose and one of those next to it, the nearest first.
    fn over<'a>(others: impl Iterator<Item = &'a SeenPose>, at: &SeenPose) -> Option<Self> {
        let at = &at.pose;
        let secs_to = |other: &SeenPose| (other.pose.timestamp_ns - at.timestamp_ns) as f64 * 1e-9;
        let mut near = None;
        for other in others {
            if secs_to(other).abs() > MAX_STEP_SECS {
                break;
            }
            near = Some(other);
            if secs_to(other).abs() >= MOTION_SECS {
                break;
            }
        }
        let (other, secs) = near.map(|other| (&other.pose, secs_to(other)))?;
        let (from, to) = (&at.world_from_camera, &other.world_from_camera);
        let turn = from.rotation.inverse() * to.rotation;
        (secs != 0.0).then(|| Self {
            velocity: (to.translation - from.translation) / secs,
            turn_rate: rotation_log(&turn) / secs,
            secs: secs.abs(),
        })
    }
}

/// The way of a camera between two poses.
struct Curve {
    times: Range<i64>,
    first: Se3,
    last_place: Vec3,
    /// Velocities at both ends times the time between them, in the world.
    place_steps: [Vec3; 2],
    /// The turn to the last pose, in the camera of the first.
    turn: Vec3,
    /// Turn rates at both ends times the time between them.
    turn_steps: [Vec3; 2],
}

impl Curve {
    /// Between the last of `before` and the first of `after`.
    fn between(before: &[SeenPose], after: &[SeenPose]) -> Self {
        let (first, last) = (&before[before.len() - 1].pose, &after[0].pose);
        let times = first.timestamp_ns..last.timestamp_ns;
        let secs = seconds(&times);
        let (from, to) = (first.world_from_camera, last.world_from_camera);
        let turn = rotation_log(&(from.rotation.inverse() * to.rotation));
        // where an end has no motion it is that from one end to the other
        let straight = Motion {
            velocity: (to.translation - from.translation) / secs,
            turn_rate: turn / secs,
            secs,
        };
        let ends = [Motion::before(before), Motion::after(after)];
        let ends = ends.map(|motion| motion.unwrap_or(straight));
        Self {
            times,
            first: from,
            last_place: to.translation,
            place_steps: ends.map(|end| end.velocity * secs),
            turn,
            turn_steps: ends.map(|end| end.turn_rate * secs),
        }
    }

    fn at(&self, frame: &LostFrame) -> TrajectoryPose {
        let s = seconds(&(self.times.start..frame.timestamp_ns)) / seconds(&self.times);
        let to_last = s * s * (3.0 - 2.0 * s);
        let leaving = s * (1.0 - s) * (1.0 - s);
        let arriving = -s * s * (1.0 - s);
        let [left, reached] = self.place_steps;
        let from = self.first.translation;
        let place = from + (self.last_place - from) * to_last + left * leaving + reached * arriving;
        let [left, reached] = self.turn_steps;
        let turn: Rotation =
            rotation_exp(&(self.turn * to_last + left * leaving + reached * arriving));
        TrajectoryPose {
            frame_index: frame.frame_index,
            timestamp_ns: frame.timestamp_ns,
            world_from_camera: Se3::new(self.first.rotation * turn, place),
            source: PoseSource::Interpolated,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME_NS: i64 = 33_333_333;

    /// A camera that swings, the faster the greater `rate`, without some of its frames.
    fn swinging(rate: f64, frames: Range<usize>, without: &Range<usize>) -> Vec<SeenPose> {
        let is_seen = |k: &usize| !without.contains(k);
        frames.filter(is_seen).map(|k| seen(rate, k)).collect()
    }

    fn seen(rate: f64, k: usize) -> SeenPose {
        let t = k as f64 / 30.0;
        let swing = |phase: f64| (rate * t + phase).sin();
        let turn = Vec3::new(0.1 * swing(0.3), 0.2 * swing(1.0), 0.05 * swing(2.0));
        let place = Vec3::new(swing(0.0), 0.5 * swing(0.7), 0.2 * swing(1.9));
        SeenPose {
            pose: TrajectoryPose {
                frame_index: k,
                timestamp_ns: k as i64 * FRAME_NS,
                world_from_camera: Se3::new(rotation_exp(&turn), place),
                source: PoseSource::Certain,
            },
            median_depth: 2.5,
        }
    }

    fn lost(frames: Range<usize>) -> Vec<LostFrame> {
        let frame = |k: usize| LostFrame {
            frame_index: k,
            timestamp_ns: k as i64 * FRAME_NS,
        };
        frames.map(frame).collect()
    }

    #[test]
    fn a_calm_camera_is_where_it_would_be_seen() {
        let gap = 60..80;
        let path = swinging(0.6, 0..140, &gap);
        let poses = interpolated(&path, &lost(gap.clone()));
        assert_eq!(poses.len(), gap.len());
        for pose in poses {
            let truth = seen(0.6, pose.frame_index).pose.world_from_camera;
            let off = truth.inverse() * pose.world_from_camera;
            assert!(off.translation.norm() < 0.02 * 2.5, "{pose:?}");
            assert!(
                rotation_log(&off.rotation).norm().to_degrees() < 1.0,
                "{pose:?}"
            );
            assert_eq!(pose.source, PoseSource::Interpolated);
        }
    }

    #[test]
    fn a_loss_is_too_long_where_the_camera_accelerates_much() {
        let count = |rate: f64, gap: Range<usize>| {
            interpolated(&swinging(rate, 0..200, &gap), &lost(gap.clone())).len()
        };
        assert_eq!(count(0.6, 60..80), 20);
        assert_eq!(count(6.0, 60..80), 0);
        assert_eq!(count(6.0, 60..63), 3);
        // however calm it is
        assert_eq!(count(0.01, 60..103), 43);
        assert_eq!(count(0.01, 60..106), 0);
    }

    #[test]
    fn before_the_first_pose_and_after_the_last_nothing_is_known() {
        let path = swinging(0.6, 20..60, &(0..0));
        assert!(interpolated(&path, &lost(0..20)).is_empty());
        assert!(interpolated(&path, &lost(60..70)).is_empty());
        assert!(interpolated(&path[..1], &lost(0..70)).is_empty());
    }

    #[test]
    fn photos_far_apart_say_nothing_of_how_the_camera_moves() {
        let path: Vec<SeenPose> = (0..20).map(|k| seen(0.6, 12 * k)).collect();
        assert!(interpolated(&path, &lost(13..20)).is_empty());
    }

    #[test]
    fn a_constant_motion_is_met_exactly() {
        let pose = |k: usize| SeenPose {
            pose: TrajectoryPose {
                frame_index: k,
                timestamp_ns: k as i64 * FRAME_NS,
                world_from_camera: Se3::new(
                    rotation_exp(&(Vec3::new(0.0, 0.01, 0.002) * k as f64)),
                    Vec3::new(0.02, -0.01, 0.03) * k as f64,
                ),
                source: PoseSource::Certain,
            },
            median_depth: 1.0,
        };
        let gap = 20..40;
        let path: Vec<SeenPose> = (0..60).filter(|k| !gap.contains(k)).map(pose).collect();
        let poses = interpolated(&path, &lost(gap));
        assert_eq!(poses.len(), 20);
        for found in poses {
            let truth = pose(found.frame_index).pose.world_from_camera;
            let off = (truth.inverse() * found.world_from_camera).log();
            assert!(off.norm() < 1e-9, "{found:?}");
        }
    }
}
