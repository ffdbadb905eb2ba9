//! Finding patches again: pyramidal Lucas-Kanade tracking and search for warped patches.

mod patch;
mod photometric_cost;
mod points;
mod template;
#[cfg(test)]
mod tests;

pub use patch::{PatchSearchConfig, ReferencePatch, find_patch, patch_level, patch_warp};
pub use photometric_cost::{PhotometricCost, PhotometricCostConfig, PhotometricSlope};
pub use points::{TrackConfig, TrackOutcome, track_points};
pub use template::PatchFit;

use monogrid_geometry::Vec2;

/// The pixel of level `level` at the level-0 pixel `pixel`.
#[must_use]
pub fn level_pixel(pixel: &Vec2, level: usize) -> Vec2 {
    let scale = 1.0 / (1u64 << level) as f64;
    pixel.map(|v| (v + 0.5) * scale - 0.5)
}

/// Variance of the noise on a level as a share of that on level 0: each averages four pixels of
/// the finer one.
pub(crate) fn noise_share(level: usize) -> f32 {
    1.0 / (1u64 << (2 * level)) as f32
}

/// The level-0 pixel at the pixel `pixel` of level `level`.
#[must_use]
pub fn finest_pixel(pixel: &Vec2, level: usize) -> Vec2 {
    let scale = (1u64 << level) as f64;
    pixel.map(|v| (v + 0.5) * scale - 0.5)
}
