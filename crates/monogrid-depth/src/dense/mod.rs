//! Depth of all pixels of a finished keyframe, textured or not, from the keyframes around it at the
//! final poses.
//!
//! A plane parallel to the image is swept through the scene at half the resolution; where it
//! touches a surface, the sources look alike when they are projected onto it ([`warp`], [`sweep`]).
//! Surfaces are smooth, so that the costs of a pixel and those along eight directions are added
//! ([`aggregate`]). The best plane of a pixel and the costs of its neighbours give the inverse
//! depth, how sharp they are its variance ([`winner`]). What is left is believed where the depth of
//! other keyframes confirms it ([`DenseDepth::agreed`]).

mod aggregate;
mod agree;
mod pair;
mod sweep;
mod warp;
mod winner;

use crate::DepthPixel;
use crate::multi_view::SourceView;
pub use agree::SupportingView;
use monogrid_geometry::Pinhole;
use monogrid_image::{GrayImage, Image, half_size};
use sweep::CostVolume;
use warp::Source;

/// Depths by which the range of the planes is found, at least.
const MIN_SEEDS: usize = 100;
/// The planes reach beyond the depths that are known, by these factors on the inverse depth.
const BEYOND_SEEDS: [f64; 2] = [0.7, 1.4];
/// Fewest planes.
const MIN_PLANES: usize = 24;
/// Smallest image that is swept, px of the half image.
const MIN_EDGE_PX: usize = 16;
/// Depths of the half image that differ by less than this share are interpolated.
const ONE_SURFACE: f32 = 0.03;

/// Settings of [`dense_depth`] and [`DenseDepth::agreed`].
#[derive(Clone, Debug, PartialEq)]
pub struct DenseConfig {
    /// Most planes.
    pub max_planes: usize,
    /// From plane to plane a match moves by this in the middle of the source that it moves most in,
    /// px of the half image.
    pub step_px: f64,
    /// Cost of a step to the next plane between two pixels; windows that do not correlate at all
    /// cost 60.
    pub(crate) small_step_cost: u16,
    /// Cost of any larger step, less where the image has an edge.
    pub(crate) jump_cost: u16,
    /// Other keyframes that must have the same depth; one less is enough where none sees through
    /// the point and the depths differ by less than half the tolerance.
    pub(crate) min_agreeing: usize,
}

impl Default for DenseConfig {
    fn default() -> Self {
        Self {
            max_planes: 80,
            step_px: 1.0,
            small_step_cost: 6,
            jump_cost: 40,
            min_agreeing: 2,
        }
    }
}

/// Depth of an image at half its size.
#[derive(Clone, Debug, PartialEq)]
pub struct DenseDepth {
    /// Inverse depths in units of the keyframe; 0 where unknown.
    pub idepth: Image<f32>,
    /// Standard deviations of the inverse depths; without meaning where these are unknown.
    pub sigma: Image<f32>,
}

impl DenseDepth {
    /// Nothing known.
    fn unknown(width: usize, height: usize) -> Self {
        Self {
            idepth: Image::filled(width, height, 0.0),
            sigma: Image::filled(width, height, 0.0),
        }
    }

    /// Inverse depth of a pixel of the full image: between the four nearest of the half image where
    /// these are of one surface, else that of the nearest; `None` where that is unknown.
    #[must_use]
    pub fn at_full_size(&self, x: usize, y: usize) -> Option<f32> {
        let half = &self.idepth;
        // the middle of a pixel of the half image lies between four of the full one
        let beside = |at: usize, size: usize| match at % 2 {
            0 => (at / 2).saturating_sub(1),
            _ => (at / 2 + 1).min(size - 1),
        };
        let nearest = half.at(x / 2, y / 2);
        let (column, row) = (beside(x, half.width()), beside(y, half.height()));
        let others = [
            half.at(column, y / 2),
            half.at(x / 2, row),
            half.at(column, row),
        ];
        let is_one = |d: &f32| (d / nearest - 1.0).abs() < ONE_SURFACE;
        if nearest <= 0.0 {
            None
        } else if others.iter().all(is_one) {
            Some(0.5625 * nearest + 0.1875 * (others[0] + others[1]) + 0.0625 * others[2])
        } else {
            Some(nearest)
        }
    }
}

/// Depth of all pixels where the sources say which; `None` without a source, or where fewer than a
/// hundred depths are known that the planes are placed around.
///
/// `seeds` are known depths in units of the keyframe; they say where planes are, and nothing else.
#[must_use]
pub fn dense_depth(
    image: &Image<u8>,
    camera: &Pinhole,
    seeds: &[DepthPixel],
    sources: &[SourceView],
    config: &DenseConfig,
) -> Option<DenseDepth> {
    let half = half_size(&image.map(f32::from));
    let sources = sources.iter().filter(|s| s.image.same_size(image));
    let sources: Vec<Source> = sources.map(|s| Source::new(s, &camera.half())).collect();
    if half.width().min(half.height()) < MIN_EDGE_PX {
        return None;
    }
    let idepths = planes(&half, seeds, &sources, config)?;
    let volume = CostVolume::new(image, &sources, idepths);
    Some(winner::winners(&volume, &half, config))
}

/// The range of inverse depths that the seeds have, with room on both sides.
fn range(seeds: &[DepthPixel]) -> Option<[f64; 2]> {
    let is_known = |d: &f32| *d > 0.0 && d.is_finite();
    let mut idepths: Vec<f32> = seeds.iter().map(|p| p.idepth).filter(is_known).collect();
    if idepths.len() < MIN_SEEDS {
        return None;
    }
    idepths.sort_unstable_by(f32::total_cmp);
    let at = |share: f64| f64::from(idepths[(share * (idepths.len() - 1) as f64) as usize]);
    Some([BEYOND_SEEDS[0] * at(0.01), BEYOND_SEEDS[1] * at(0.99)])
}

/// Inverse depths of the planes; `None` without a source that sees the middle of the image.
fn planes(
    image: &GrayImage,
    seeds: &[DepthPixel],
    sources: &[Source],
    config: &DenseConfig,
) -> Option<Vec<f32>> {
    let [low, high] = range(seeds)?;
    let middle = [image.width() as f64 / 2.0, image.height() as f64 / 2.0];
    let lengths = sources.iter().filter_map(|source| {
        let (near, far) = (source.project(middle, high)?, source.project(middle, low)?);
        Some((near[0] - far[0]).hypot(near[1] - far[1]))
    });
    let longest = lengths.max_by(f64::total_cmp)?;
    let count = (longest / config.step_px) as usize + 1;
    let count = count.clamp(MIN_PLANES, config.max_planes);
    let step = (high - low) / (count - 1) as f64;
    Some((0..count).map(|k| (low + step * k as f64) as f32).collect())
}

#[cfg(test)]
mod tests;
