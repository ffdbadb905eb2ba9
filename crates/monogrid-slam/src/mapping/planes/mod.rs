//! Large planes: walls, floor, ceiling, table tops.
//!
//! Those that a keyframe shares with others around it are found in the depth of all of them
//! together ([`shared`]), and where each was measured ([`extent`]). Two things follow: regions
//! without depth between what lies on them are on them too ([`continued`]), and depth that lies on
//! one is put on it ([`straight`]). In a room of plain walls that is a tenth of its surfaces, and
//! walls become thin; where no plane holds much of the depth, nothing happens.

mod continued;
mod extent;
mod shared;
mod straight;
#[cfg(test)]
mod tests;

use super::posed::Scene;
use super::scan::Depths;
use continued::continued;
pub(super) use shared::Cloud;
use shared::Surroundings;
use straight::straightened;

/// Depth on large planes, and these planes beyond what was measured of them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanesConfig {
    /// Large planes around each keyframe in final maps, at most; 0: none.
    pub max_count: usize,
    /// Relative standard deviation of the inverse depth of a large plane, with which depth that
    /// agrees with it is averaged; 0: depth stays as it is.
    pub(crate) relative_sigma: f64,
}

impl Default for PlanesConfig {
    fn default() -> Self {
        Self {
            max_count: 12,
            relative_sigma: 0.006,
        }
    }
}

/// The depths of a keyframe on the large planes that it shares with others, and these planes beyond
/// what was measured of them; `cloud` is what each keyframe sees.
pub(super) fn on_planes<'a>(
    scene: &Scene,
    index: usize,
    depths: Depths,
    cloud: impl Fn(usize) -> Option<&'a Cloud>,
) -> Depths {
    let Some(surroundings) = Surroundings::of(scene, index, cloud) else {
        return depths;
    };
    let depths = depths.with_filled(continued(scene, index, &surroundings));
    straightened(scene, index, depths, &surroundings)
}
