//! Wheels that measure how a robot moves, and are wrong.

use monogrid_geometry::{Rotation, Se3, Vec3};

/// Between the wheels, m.
const TRACK_M: f64 = 0.4;
/// Steps in which the error of a wheel stays the same: a third of a second.
const HELD: usize = 10;

/// What a step of the base (`last_from_this`) looks like to somebody who measures it.
pub type Wheels = fn(usize, &Se3) -> Se3;

/// Alternately too much and too little by 2 %, and half a second in which they spin.
pub fn alternating(step: usize, moved: &Se3) -> Se3 {
    moved.stretched(match step {
        60..75 => 2.0,
        k if (k / HELD).is_multiple_of(2) => 1.02,
        _ => 0.98,
    })
}

/// Two wheels, each wrong by 2 % (standard deviation) for a third of a second, the right one larger
/// than it should be by a half percent. Both spin for half a second, one of them spins, and both
/// are held while the robot slides.
pub fn two_wheels(step: usize, moved: &Se3) -> Se3 {
    let (ahead, turn) = (moved.translation.x, moved.rotation.euler_angles().2);
    let slip = match step {
        200..215 => [2.0, 2.0],
        450..458 => [2.0, 1.0],
        600..606 => [0.0, 0.0],
        _ => [1.0, 1.0],
    };
    let wheel = |side: usize| {
        let sign = [-1.0, 1.0][side];
        let size = [0.9975, 1.0025][side];
        let rolled = ahead + sign * turn * TRACK_M / 2.0;
        rolled * slip[side] * (size + error(2 * (step / HELD) + side))
    };
    let [left, right] = [wheel(0), wheel(1)];
    let turn = Rotation::from_euler_angles(0.0, 0.0, (right - left) / TRACK_M);
    Se3::new(turn, Vec3::new((left + right) / 2.0, 0.0, 0.0))
}

/// Evenly distributed, with a standard deviation of 2 %.
fn error(number: usize) -> f64 {
    let unit = (number * 37 + 11) % 101;
    (unit as f64 / 50.0 - 1.0) * 0.02 * 3.0_f64.sqrt()
}
