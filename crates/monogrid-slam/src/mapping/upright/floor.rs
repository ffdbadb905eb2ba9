//! The floor: the lowest level plane below the cameras that much is seen of.

use super::UprightConfig;
use super::evidence::Evidence;
use crate::median::median;
use monogrid_geometry::Vec3;

/// Largest angle between up and the normal of a level plane, degrees.
const LEVEL_DEG: f64 = 8.0;
/// Planes that a floor consists of: one alone may be a mistake of one keyframe.
const MIN_PLANES: usize = 2;
/// Heights within this share of the height of the cameras over the floor are one plane.
const SAME_HEIGHT: f64 = 0.08;

/// A floor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Floor {
    /// Its height along up, in the world.
    pub height: f64,
    /// Median height of the cameras over it, in units of the world.
    pub camera_height: f64,
    /// Its share of all level planes that face up.
    pub share: f64,
}

/// A level plane of one keyframe.
struct Level {
    height: f64,
    weight: f64,
}

/// Looks for it among the planes that face up.
pub(super) fn floor(evidence: &Evidence, up: &Vec3, config: &UprightConfig) -> Option<Floor> {
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
        if is_enough && weight >= config.min_floor_share * all {
            let height = weighted_median(same, 0.5 * weight);
            return Some(Floor {
                height,
                camera_height: camera - height,
                share: weight / all,
            });
        }
    }
    None
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
