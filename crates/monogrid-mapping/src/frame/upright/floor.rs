//! The floor: the lowest level plane below the cameras that much is seen of, where (almost) nothing
//! lies below it.
//!
//! Over a desk the lowest level plane that much is seen of is the desk. Beside and under it things
//! are seen that lie lower, and through a floor nothing is.

use super::evidence::{Evidence, UprightView};
use monogrid_geometry::median::median;
use monogrid_geometry::{Vec2, Vec3};
use std::collections::BTreeMap;

/// Largest angle between up and the normal of a level plane, degrees.
const LEVEL_DEG: f64 = 8.0;
/// Planes that a floor consists of: one alone may be a mistake of one keyframe.
const MIN_PLANES: usize = 2;
/// Heights within this share of the height of the cameras over the floor are one plane.
const SAME_HEIGHT: f64 = 0.08;

/// How far below a level surface something lies that is not the surface itself, in heights of the
/// cameras over it.
const BELOW: f64 = 0.3;
/// Range up to which depth says so, in the same unit: farther away it is too uncertain.
const MAX_RANGE: f64 = 6.0;
/// Cells of that unit in which is counted what is seen, and the pixels that make one count: single
/// ones are mistakes.
const CELLS: f64 = 10.0;
const MIN_PIXELS: u32 = 3;
/// Most share of the cells that lie below a floor. Of rooms and streets it is 0 to 0.1 %, of desks
/// 0.5 % and more.
const MAX_BELOW: f64 = 0.003;
/// Most keyframes that are asked, and every how many-th pixel of a row and column.
const MAX_VIEWS: usize = 80;
const PIXEL_STEP: u16 = 4;

/// A level surface below the cameras: the floor, or something that stands on it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Floor {
    /// Its height along up, in the world.
    pub height: f64,
    /// Median height of the cameras over it, in units of the world.
    pub camera_height: f64,
    /// Its share of all level planes that face up.
    pub share: f64,
    /// Share of all that was seen near the cameras which lies clearly below it.
    pub below: f64,
}

impl Floor {
    /// Whether (almost) nothing lies below it; else it is a table, or what else things lie on.
    #[must_use]
    pub fn is_floor(&self) -> bool {
        self.below <= MAX_BELOW
    }
}

/// Least share of the floor among all level planes seen from above: other things than the floor are
/// seen more.
const MIN_SHARE: f64 = 0.05;

/// A level plane of one keyframe.
struct Level {
    height: f64,
    weight: f64,
}

/// Looks for it among the planes that face up.
pub(super) fn floor(views: &[UprightView], evidence: &Evidence, up: &Vec3) -> Option<Floor> {
    let heights = evidence.poses.iter().map(|p| p.translation.dot(up));
    let camera = median(&mut heights.collect::<Vec<f64>>())?;
    let mut levels: Vec<Level> = evidence
        .patches
        .iter()
        .filter(|patch| patch.normal_in_world.dot(up) > LEVEL_DEG.to_radians().cos())
        .map(|patch| Level {
            height: patch.middle_in_world.dot(up),
            weight: patch.weight,
        })
        .filter(|level| level.height < camera)
        .collect();
    levels.sort_by(|a, b| a.height.total_cmp(&b.height));
    let all: f64 = levels.iter().map(|level| level.weight).sum();
    for (first, lowest) in levels.iter().enumerate() {
        let top = lowest.height + SAME_HEIGHT * (camera - lowest.height);
        let same = &levels[first..first + levels[first..].partition_point(|l| l.height <= top)];
        let weight: f64 = same.iter().map(|level| level.weight).sum();
        let is_enough = same.len() >= MIN_PLANES.min(evidence.poses.len());
        if is_enough && weight >= MIN_SHARE * all {
            let height = weighted_median(same, 0.5 * weight);
            let camera_height = camera - height;
            return Some(Floor {
                height,
                camera_height,
                share: weight / all,
                below: share_below(views, up, (height, camera_height)),
            });
        }
    }
    None
}

/// Share of the cells with something in them near the cameras that lie clearly below a height.
fn share_below(views: &[UprightView], up: &Vec3, (height, unit): (f64, f64)) -> f64 {
    let edge = unit / CELLS;
    let step = views.len().div_ceil(MAX_VIEWS).max(1);
    let mut cells: BTreeMap<[i64; 3], u32> = BTreeMap::new();
    for view in views.iter().step_by(step) {
        let pinhole = &view.scan.camera.pinhole;
        let at = view.world_from_keyframe.translation;
        let pixels = view.scan.pixels();
        let asked = |x: u16, y: u16| x.is_multiple_of(PIXEL_STEP) && y.is_multiple_of(PIXEL_STEP);
        for pixel in pixels.iter().filter(|pixel| asked(pixel.x, pixel.y)) {
            let ray = pinhole.unproject(&Vec2::new(pixel.x.into(), pixel.y.into()));
            let point = view.world_from_keyframe * (ray / f64::from(pixel.idepth));
            if (point - at).norm() <= MAX_RANGE * unit {
                let cell = (point / edge).map(|c| c.floor() as i64).into();
                *cells.entry(cell).or_default() += 1;
            }
        }
    }
    let seen = cells.iter().filter(|(_, pixels)| **pixels >= MIN_PIXELS);
    let (mut all, mut below) = (0_usize, 0_usize);
    for (cell, _) in seen {
        let middle = Vec3::from(cell.map(|c| (c as f64 + 0.5) * edge));
        all += 1;
        below += usize::from(middle.dot(up) < height - BELOW * unit);
    }
    below as f64 / all.max(1) as f64
}

fn weighted_median(sorted: &[Level], half: f64) -> f64 {
    let mut sum = 0.0;
    let reaches_half = |level: &&Level| {
        sum += level.weight;
        sum >= half
    };
    let middle = sorted.iter().find(reaches_half).or(sorted.last());
    middle.map_or(f64::NAN, |level| level.height)
}
