//! Up and the floor, from the scene.
//!
//! One camera measures no gravity. But floors and tables are level, walls and doors stand upright,
//! people hold cameras so that the horizon is roughly level, carry them over the ground, and turn
//! about the vertical. From all keyframes: **planes** of their depth and **straight edges** of
//! their images ([`evidence`]) vote for directions that are normal to planes, or lie in planes and
//! along edges; three directions of a room get many votes, and how the camera was held and moved,
//! over all frames and not only in the first, says which of them is up ([`vote`]). The **floor** is
//! the lowest level plane below the cameras that much is seen of, if (almost) nothing lies below
//! it ([`floor`]).

mod evidence;
mod floor;
mod segments;
mod vote;

pub use evidence::UprightView;
pub use floor::Floor;

use evidence::Evidence;
use monogrid_geometry::median::median;
use monogrid_geometry::nalgebra::{Matrix3, Rotation3};
use monogrid_geometry::{Rotation, Se3, Sim3, Vec3};

/// Least confidence at which the scene, and not the first camera, says what is up: it is more
/// probable than not.
pub const MIN_UP_CONFIDENCE: f64 = 0.5;

/// Directions within this angle are one up, degrees.
const SAME_UP_DEG: f64 = 8.0;

/// What is up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Upright {
    /// Up, of length 1, in the world of the keyframes.
    pub up_in_world: Vec3,
    /// Probability that it is within ten degrees of up.
    pub confidence: f64,
    /// The floor, or the level surface that looks most like one, where one is seen.
    pub floor: Option<Floor>,
}

/// Finds up and the floor, from keyframes and the poses of the camera in all frames; `None` where
/// nothing votes.
///
/// The result does not depend on the frame of the world: turning it turns the result.
#[must_use]
pub fn upright(views: &[UprightView], path: &[Se3]) -> Option<Upright> {
    let evidence = Evidence::of(views, path);
    let mut upright = vote::vote(&evidence)?;
    upright.floor = floor::floor(views, &evidence, &upright.up_in_world);
    Some(upright)
}

/// The floor for an up that is known otherwise. Where the scene votes for nearly the same up, level
/// planes are told by that: an up that is off by degrees takes the far end of a floor for another.
#[must_use]
pub fn floor_below(views: &[UprightView], path: &[Se3], up_in_world: &Vec3) -> Option<Floor> {
    let evidence = Evidence::of(views, path);
    let up = up_in_world.normalize();
    let is_same = |voted: &Vec3| voted.dot(&up) > SAME_UP_DEG.to_radians().cos();
    let voted = vote::vote(&evidence).map(|upright| upright.up_in_world);
    let level_up = voted.filter(is_same).unwrap_or(up);
    let found = floor::floor(views, &evidence, &level_up)?;
    let heights = evidence.poses.iter().map(|pose| pose.translation.dot(&up));
    let camera = median(&mut heights.collect::<Vec<f64>>())?;
    Some(Floor {
        height: camera - found.camera_height,
        ..found
    })
}

/// The frame with z along `up_in_world`, x ahead of the first camera (which the world is the frame
/// of) and z = 0 at the floor; without a floor at the first camera.
#[must_use]
pub fn level_from_world(up_in_world: &Vec3, floor: Option<&Floor>) -> Sim3 {
    let up = up_in_world.normalize();
    let ahead = Vec3::z();
    let level = ahead - up * ahead.dot(&up);
    // who looks straight down has the upper edge of the image ahead, who looks up the lower one
    let x = if level.norm() > 0.05 {
        level.normalize()
    } else {
        let edge = Vec3::y() * ahead.dot(&up).signum();
        (edge - up * edge.dot(&up)).normalize()
    };
    let y = up.cross(&x);
    let rows = Matrix3::from_rows(&[x.transpose(), y.transpose(), up.transpose()]);
    let rotation = Rotation::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rows));
    let height = floor.map_or(0.0, |floor| -floor.height);
    Sim3::new(1.0, rotation, Vec3::new(0.0, 0.0, height))
}

#[cfg(test)]
mod tests;
