//! Large planes: walls, floor, ceiling, table tops.
//!
//! Those that a keyframe shares with others around it are found in the depth of all of them
//! together ([`shared`]), and where each was measured ([`extent`]). Two things follow: regions
//! without depth between what lies on them are on them too ([`continued`]), and depth that lies on
//! one is put on it ([`straight`]). In a room of plain walls that is a tenth of its surfaces, and
//! walls become thin; where no plane holds much of the depth, nothing happens.

mod continued;
mod extent;
mod fill;
mod shared;
mod straight;
#[cfg(test)]
mod tests;

use crate::scene::{Depths, Scene};
use continued::continued;
pub use fill::fill_plain_regions;
pub(crate) use fill::planes_of_image;
pub(crate) use shared::Cloud;
use shared::Surroundings;
use straight::straightened;

/// The depths of a keyframe on the large planes that it shares with others, and these planes beyond
/// what was measured of them; `cloud` is what each keyframe sees.
pub(crate) fn on_planes<'a>(
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
