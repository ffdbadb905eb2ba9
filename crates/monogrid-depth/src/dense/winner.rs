//! From costs to depth.

use super::aggregate::aggregate;
use super::sweep::{CostVolume, RADIUS};
use super::{DenseConfig, DenseDepth};
use monogrid_image::{GrayImage, Image};

/// The mean of the costs of all planes must be higher than that of the best one by this: plain
/// windows look the same in all of them.
const MIN_CONTRAST: f64 = 5.0;
/// All other planes must cost more than the best one by this share.
const MIN_UNIQUENESS: f64 = 0.03;

/// Planes beside the best one that are of the same minimum.
const SAME_MINIMUM: usize = 2;
/// A sum of costs that is this much higher is one standard deviation away: eight directions carry
/// each cost.
const SIGMA_COST: f32 = 8.0;
/// Limits of the standard deviation by the shape of the costs, in planes.
const SIGMA_PLANES: [f32; 2] = [0.2, 2.0];
/// Pixels whose neighbours differ by less than this have no edge of their own, grey levels.
const PLAIN_GREY: f32 = 6.0;
/// Depths that differ by more than this share are of two surfaces.
const ONE_SURFACE: f32 = 0.04;

/// The best plane of each pixel, between its neighbours; unknown where another plane is nearly as
/// good, where the sources look alike in all of them, and beside the edges of objects.
pub(super) fn winners(volume: &CostVolume, image: &GrayImage, config: &DenseConfig) -> DenseDepth {
    let mut depth = DenseDepth::unknown(volume.width, volume.height);
    aggregate(volume, image, config, |pixel, sums| {
        if let Some((idepth, sigma)) = winner(volume, pixel, sums) {
            depth.idepth.as_mut_slice()[pixel] = idepth;
            depth.sigma.as_mut_slice()[pixel] = sigma;
        }
    });
    without_occlusion_boundaries(depth, image)
}

/// Inverse depth and standard deviation of one pixel.
fn winner(volume: &CostVolume, pixel: usize, sums: &[i16]) -> Option<(f32, f32)> {
    let planes = sums.len();
    let best = (0..planes).min_by_key(|k| sums[*k])?;
    if best == 0 || best + 1 == planes {
        return None;
    }
    let costs = volume.at(pixel);
    let mean = costs.iter().map(|c| f32::from(*c)).sum::<f32>() / planes as f32;
    if mean - f32::from(costs[best]) < MIN_CONTRAST as f32 {
        return None;
    }
    let [before, least, after] = [sums[best - 1], sums[best], sums[best + 1]].map(f32::from);
    let lower = sums[..best.saturating_sub(SAME_MINIMUM)].iter();
    let others = lower.chain(&sums[(best + SAME_MINIMUM + 1).min(planes)..]);
    let rival = others.min().map_or(f32::INFINITY, |s| f32::from(*s));
    if rival < least * (1.0 + MIN_UNIQUENESS as f32) {
        return None;
    }
    let curvature = (before + after - 2.0 * least).max(1.0);
    let offset = (0.5 * (before - after) / curvature).clamp(-0.5, 0.5);
    let step = volume.idepths[1] - volume.idepths[0];
    let sigma = (SIGMA_COST / curvature).sqrt();
    let sigma = sigma.clamp(SIGMA_PLANES[0], SIGMA_PLANES[1]);
    Some((volume.idepths[best] + offset * step, sigma * step))
}

/// Without plain pixels near others of another depth or of none: a window that holds the edge of an
/// object has its depth, though the middle of the window shows what is behind.
fn without_occlusion_boundaries(depth: DenseDepth, image: &GrayImage) -> DenseDepth {
    let (width, height) = (depth.idepth.width(), depth.idepth.height());
    let reach = RADIUS + 1;
    let is_rim = |x: usize, y: usize| {
        let own = depth.idepth.at(x, y);
        let mut rows = y.saturating_sub(reach)..(y + reach + 1).min(height);
        let columns = x.saturating_sub(reach)..(x + reach + 1).min(width);
        let other = |d: &f32| *d <= 0.0 || (d / own - 1.0).abs() > ONE_SURFACE;
        let has_other = |y| depth.idepth.row(y)[columns.clone()].iter().any(other);
        is_plain(image, x, y) && rows.any(has_other)
    };
    let mut kept = depth.clone();
    for y in 0..height {
        for x in 0..width {
            if depth.idepth.at(x, y) > 0.0 && is_rim(x, y) {
                kept.idepth.set(x, y, 0.0);
            }
        }
    }
    kept
}

/// Whether the 3x3 pixels around one are about equal.
fn is_plain(image: &Image<f32>, x: usize, y: usize) -> bool {
    let (mut low, mut high) = (f32::INFINITY, f32::NEG_INFINITY);
    for row in y.saturating_sub(1)..(y + 2).min(image.height()) {
        for value in &image.row(row)[x.saturating_sub(1)..(x + 2).min(image.width())] {
            low = low.min(*value);
            high = high.max(*value);
        }
    }
    high - low < PLAIN_GREY
}
