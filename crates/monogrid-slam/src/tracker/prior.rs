//! Where a frame should be before it is looked at, and how far from there it can be.
//!
//! The camera goes on as it moved between the last two frames. What a pose differs from that is its
//! innovation; over the time that a frame takes it is an acceleration, and a camera accelerates
//! about as much in this second as in the last. A pose beyond the gate that follows from it
//! `[BARSHALOM88]` (section 2.3) may be of another thing than the room: of somebody who walks by,
//! whose points agree with each other as well.

use crate::median::median;
use monogrid_alignment::Motion;
use monogrid_geometry::{Se3, Vec6};
use std::collections::VecDeque;

/// What is known before the frame is looked at.
#[derive(Clone, Debug)]
pub(crate) struct MotionPrior {
    /// Pose of the last frame.
    pub last_from_keyframe: Motion,
    /// Motion expected between the last frame and this one.
    pub frame_from_last: Se3,
    /// Largest innovation of a pose that is believed.
    pub gate: f64,
}

impl MotionPrior {
    /// A pose that is expected for another reason than the motion of the last frames.
    pub(crate) fn at(expected: Motion) -> Self {
        Self {
            last_from_keyframe: expected,
            frame_from_last: Se3::identity(),
            gate: FIRST_GATE,
        }
    }

    /// Where the motion of the last frames leads.
    pub(super) fn motion(&self) -> Motion {
        let last = &self.last_from_keyframe;
        Motion {
            frame_from_keyframe: self.frame_from_last * last.frame_from_keyframe,
            ..*last
        }
    }

    /// Whether a pose is farther from there than the camera can be.
    pub(super) fn is_beyond_gate(&self, motion: &Motion) -> bool {
        let expected = self.motion().frame_from_keyframe;
        let off = innovation(&motion.frame_from_keyframe, &expected);
        off > self.gate || off.is_nan()
    }
}

/// How far a pose is from another: norm of the twist, median depths and rad.
fn innovation(found: &Se3, expected: &Se3) -> f64 {
    (*found * expected.inverse()).log().norm()
}

/// Intervals that a motion is continued over at most: beyond them nothing is known about a hand.
const MOST_INTERVALS: f64 = 3.0;

/// The motion per nanosecond continued over another interval.
pub(crate) fn extrapolate(frame_from_last: &Se3, interval_ns: i64, next_interval_ns: i64) -> Se3 {
    if interval_ns <= 0 {
        return Se3::identity();
    }
    let factor = (next_interval_ns as f64 / interval_ns as f64).clamp(0.0, MOST_INTERVALS);
    let twist: Vec6 = frame_from_last.log() * factor;
    Se3::exp(&twist)
}

/// The gate while nothing is known of how the camera accelerates, median depths and rad.
pub(crate) const FIRST_GATE: f64 = 0.2;
/// The gate of a camera that hardly accelerates.
const MIN_GATE: f64 = 0.05;
/// Frames that say how the camera accelerates: about three seconds, since half of them may show
/// somebody who walks by.
const REMEMBERED: usize = 100;
/// Fewest of them that say anything.
const MIN_REMEMBERED: usize = 5;
/// How much the camera accelerates at most, in medians of what is remembered: for as long as a
/// frame,
const MOST_AT_ONCE: f64 = 10.0;
/// and for longer.
const MOST_ON_AVERAGE: f64 = 3.0;

/// Accelerations of the camera by the innovations of its last poses, median depths and rad per
/// square second.
#[derive(Clone, Debug, Default)]
pub(crate) struct Accelerations(VecDeque<f64>);

impl Accelerations {
    /// A step of this time, after one of another time, turned out to be this instead of that.
    pub(crate) fn add(
        &mut self,
        (found, expected): (&Se3, &Se3),
        (before_ns, interval_ns): (i64, i64),
    ) {
        let time = half_square(before_ns, interval_ns);
        if before_ns <= 0 || time <= 0.0 {
            return;
        }
        self.0.push_back(innovation(found, expected) / time);
        if self.0.len() > REMEMBERED {
            self.0.pop_front();
        }
    }

    /// The gate of a frame after these times.
    pub(crate) fn gate(&self, before_ns: i64, interval_ns: i64) -> f64 {
        if self.0.len() < MIN_REMEMBERED {
            return FIRST_GATE;
        }
        let mut remembered: Vec<f64> = self.0.iter().copied().collect();
        let median = median(&mut remembered).unwrap_or_default();
        let at_once = MOST_AT_ONCE * half_square(before_ns, interval_ns.min(before_ns));
        let on_average = MOST_ON_AVERAGE * half_square(before_ns, interval_ns);
        (median * at_once.max(on_average)).max(MIN_GATE)
    }
}

/// What a constant acceleration adds to the step of an interval, known by that of the one before:
/// half the product of the interval and both together, square seconds.
fn half_square(before_ns: i64, interval_ns: i64) -> f64 {
    let secs = |ns: i64| ns as f64 * 1e-9;
    0.5 * secs(interval_ns) * secs(interval_ns + before_ns)
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::Vec3;

    const FRAME_NS: i64 = 33_333_333;

    fn along(x: f64) -> Se3 {
        Se3::new(Se3::identity().rotation, Vec3::new(x, 0.0, 0.0))
    }

    /// Of a camera that is this far from where it was expected in each of so many frames.
    fn after(num_frames: usize, off: f64) -> Accelerations {
        let mut accelerations = Accelerations::default();
        for _ in 0..num_frames {
            let step = (&along(off), &Se3::identity());
            accelerations.add(step, (FRAME_NS, FRAME_NS));
        }
        accelerations
    }

    #[test]
    fn what_a_constant_acceleration_adds_is_met_exactly() {
        // x = a t^2 / 2 at 0, 1/30 s and 1/30 s + an interval
        let acceleration = 0.7;
        let x = |ns: i64| 0.5 * acceleration * (ns as f64 * 1e-9).powi(2);
        for interval_ns in [FRAME_NS, 2 * FRAME_NS, 3 * FRAME_NS] {
            let step = along(x(FRAME_NS + interval_ns) - x(FRAME_NS));
            let expected = extrapolate(&along(x(FRAME_NS)), FRAME_NS, interval_ns);
            let found = innovation(&step, &expected) / half_square(FRAME_NS, interval_ns);
            assert!(
                (found - acceleration).abs() < 1e-9,
                "{interval_ns}: {found}"
            );
        }
    }

    #[test]
    fn the_gate_follows_how_the_camera_accelerates() {
        let gate = |accelerations: &Accelerations| accelerations.gate(FRAME_NS, FRAME_NS);
        assert_eq!(gate(&after(MIN_REMEMBERED - 1, 0.01)), FIRST_GATE);
        assert!((gate(&after(MIN_REMEMBERED, 0.01)) - MOST_AT_ONCE * 0.01).abs() < 1e-9);
        assert_eq!(gate(&after(50, 0.001)), MIN_GATE);
        // a minority of surprises changes nothing, what is long ago is forgotten
        let mut mixed = after(REMEMBERED, 0.01);
        for _ in 0..REMEMBERED / 2 - 1 {
            mixed.add((&along(0.5), &Se3::identity()), (FRAME_NS, FRAME_NS));
        }
        assert!((gate(&mixed) - MOST_AT_ONCE * 0.01).abs() < 1e-9);
        for _ in 0..REMEMBERED {
            mixed.add((&along(0.02), &Se3::identity()), (FRAME_NS, FRAME_NS));
        }
        assert!((gate(&mixed) - MOST_AT_ONCE * 0.02).abs() < 1e-9);
        assert_eq!(mixed.0.len(), REMEMBERED);
    }

    #[test]
    fn the_gate_grows_while_the_camera_is_lost_by_less_than_one_jump_after_another() {
        let accelerations = after(50, 0.01);
        let gate = |frames: i64| accelerations.gate(FRAME_NS, frames * FRAME_NS);
        // a frame that is missing is no reason to expect more
        assert!(
            (gate(2) / gate(1) - 1.0).abs() < 1e-6,
            "{} {}",
            gate(1),
            gate(2)
        );
        assert!((gate(9) / gate(1) - MOST_ON_AVERAGE * 45.0 / MOST_AT_ONCE).abs() < 1e-6);
        // nothing follows from a step without time
        let mut none = Accelerations::default();
        for times in [(0, FRAME_NS), (FRAME_NS, 0)] {
            none.add((&along(0.1), &Se3::identity()), times);
        }
        assert!(none.0.is_empty());
    }

    #[test]
    fn a_pose_is_beyond_the_gate_by_its_distance_from_where_the_motion_leads() {
        let prior = MotionPrior {
            last_from_keyframe: Motion::from_pose(along(0.1)),
            frame_from_last: along(0.1),
            gate: 0.05,
        };
        let is_beyond = |x: f64| prior.is_beyond_gate(&Motion::from_pose(along(x)));
        assert!(!is_beyond(0.2) && !is_beyond(0.249) && !is_beyond(0.151));
        assert!(is_beyond(0.251) && is_beyond(0.149) && is_beyond(f64::NAN));
    }
}
