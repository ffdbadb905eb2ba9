//! Depth of a finished keyframe from all keyframes around it, at the poses that are known in the end.
//!
//! The filter observes a keyframe while its pose and those of the frames are still estimates; what is
//! wrong with them stays in the depth. When the poses are optimised, the images of the other keyframes say
//! more. A pixel `x` of inverse depth `rho` is seen in a source at
//!
//! ```text
//! x'(rho) = pi(K R K^-1 (x, y, 1) + rho K t / s)          (s R, t: source from keyframe)
//! ```
//!
//! Flow per pixel: the sources that see it with enough disparity along its gradient ([`sight`]) → the best
//! normalised correlation of a patch over a short range of inverse depths ([`search`]) → Gauss-Newton on
//! ln(rho) over all these sources, with gain and bias of each patch free, which also gives the variance.
//! A pixel that its sources do not agree about has no new depth. Half of the pixels take the mean of their
//! neighbours where these agree.

mod misfit;
mod search;
mod sight;

pub use misfit::epipolar_misfits;

use crate::PixelDepth;
use crate::config::{ConfigError, Limit, first_outside};
use monogrid_geometry::{Pinhole, Sim3};
use monogrid_image::Image;
use serde::{Deserialize, Serialize};
use sight::Projected;

/// Another keyframe.
#[derive(Clone, Copy, Debug)]
pub struct SourceView<'a> {
    /// Its image, of the same camera.
    pub image: &'a Image<u8>,
    /// From the coordinates of the refined keyframe (in its units) to those of the other.
    pub source_from_keyframe: Sim3,
}

/// Settings of [`refine_depth`].
///
/// A disparity is the way of the match in px along the gradient if the inverse depth changed by all of
/// itself: at 50 px, 2 % are one pixel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MultiViewConfig {
    /// Whether every second pixel, as on a chess board, takes the mean of the refined ones around it where these
    /// agree; half the work. Default true.
    pub interpolate: bool,
    /// Sources per pixel, those of the largest disparity. Default 5. Range [2, 100].
    pub max_sources: usize,
    /// Of these, so many of the smallest disparity search. Default 2. Range [1, 100].
    pub search_sources: usize,
    /// Smallest disparity of a source, px. Default 15. Range [0.1, 1000].
    pub min_disparity_px: f64,
    /// Largest disparity, px, at least `min_disparity_px`. Default 80: far more, and views differ too much. Range
    /// [15, 10000].
    pub max_disparity_px: f64,
    /// The search reaches so many standard deviations, ... Default 3. Range [0.01, 100].
    pub search_sigmas: f64,
    /// ... but at least this share of the inverse depth, ... Default 0.04. Range [0.0001, 0.499].
    pub min_search: f64,
    /// ... and at most this, at least `min_search`. Default 0.15. Range [0.04, 0.499].
    pub max_search: f64,
    /// Step of the search, px. Default 1. Range [0.05, 100].
    pub step_px: f64,
    /// Iterations after the search. Default 2. Range [1, 100].
    pub iterations: usize,
    /// Two sources must correlate by this at least. Default 0.7. Range [0.01, 0.999].
    pub min_correlation: f64,
    /// Smallest deviation of the residuals of a source, grey levels. Default 2. Range [0.01, 100].
    pub grey_sigma: f64,
    /// Residuals of a patch that count as one, since neighbours share their errors. Default 10. Range [1,
    /// 1000000].
    pub correlated_residuals: f64,
    /// Relative standard deviation added for what all pixels share (poses). Default 0.008. Range [0, 1].
    pub relative_sigma: f64,
}

impl Default for MultiViewConfig {
    fn default() -> Self {
        Self {
            interpolate: true,
            max_sources: 5,
            search_sources: 2,
            min_disparity_px: 15.0,
            max_disparity_px: 80.0,
            search_sigmas: 3.0,
            min_search: 0.04,
            max_search: 0.15,
            step_px: 1.0,
            iterations: 2,
            min_correlation: 0.7,
            grey_sigma: 2.0,
            correlated_residuals: 10.0,
            relative_sigma: 0.008,
        }
    }
}

impl MultiViewConfig {
    /// Checks all settings.
    ///
    /// # Errors
    /// The first value outside its range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let (min_px, max_px) = (self.min_disparity_px, self.max_disparity_px);
        first_outside([
            Limit("max_sources", self.max_sources as f64, 2.0, 100.0),
            Limit("search_sources", self.search_sources as f64, 1.0, 100.0),
            Limit("min_disparity_px", min_px, 0.1, 1000.0),
            Limit("max_disparity_px", max_px, min_px, 10_000.0),
            Limit("search_sigmas", self.search_sigmas, 0.01, 100.0),
            Limit("min_search", self.min_search, 0.0001, 0.499),
            Limit("max_search", self.max_search, self.min_search, 0.499),
            Limit("step_px", self.step_px, 0.05, 100.0),
            Limit("iterations", self.iterations as f64, 1.0, 100.0),
            Limit("min_correlation", self.min_correlation, 0.01, 0.999),
            Limit("grey_sigma", self.grey_sigma, 0.01, 100.0),
            Limit("correlated_residuals", self.correlated_residuals, 1.0, 1e6),
            Limit("relative_sigma", self.relative_sigma, 0.0, 1.0),
        ])
    }
}

/// The depths of a keyframe, better where the sources agree; the others as they were.
///
/// `pixels` in any order, in units of the keyframe; the result has the same order. Returns how many
/// became better, too.
#[must_use]
pub fn refine_depth(
    image: &Image<u8>,
    camera: &Pinhole,
    pixels: &[PixelDepth],
    sources: &[SourceView],
    config: &MultiViewConfig,
) -> (Vec<PixelDepth>, usize) {
    let projections = Projected::of_sources(image, camera, sources);
    let mut search = search::Search::new(image, &projections, config);
    let is_first = |p: &PixelDepth| !config.interpolate || (p.x ^ p.y).is_multiple_of(2);
    let mut refine_first = |p| if is_first(p) { search.refine(p) } else { None };
    let mut refined: Vec<Option<PixelDepth>> = pixels.iter().map(&mut refine_first).collect();
    let first = Raster::new(image, &refined);
    for (pixel, refined) in pixels.iter().zip(&mut refined) {
        if !is_first(pixel) {
            *refined = first.mean_around(pixel).or_else(|| search.refine(pixel));
        }
    }
    let num_refined = refined.iter().flatten().count();
    let depths = pixels.iter().zip(refined);
    let depths = depths.map(|(pixel, refined)| refined.unwrap_or(*pixel));
    (depths.collect(), num_refined)
}

/// Refined depths by pixel: inverse depth and variance; 0 where there is none.
struct Raster {
    width: usize,
    depths: Vec<[f32; 2]>,
}

impl Raster {
    fn new(image: &Image<u8>, refined: &[Option<PixelDepth>]) -> Self {
        let width = image.width();
        let mut depths = vec![[0.0; 2]; width * image.height()];
        for pixel in refined.iter().flatten() {
            let index = usize::from(pixel.y) * width + usize::from(pixel.x);
            if let Some(depth) = depths.get_mut(index) {
                *depth = [pixel.idepth, pixel.idepth_var];
            }
        }
        Self { width, depths }
    }

    /// The mean of two or more of the four neighbours, if all of them and the pixel itself agree within two
    /// standard deviations. Neighbours share their errors: its variance is theirs.
    fn mean_around(&self, pixel: &PixelDepth) -> Option<PixelDepth> {
        let index = usize::from(pixel.y) * self.width + usize::from(pixel.x);
        let around = [
            index.checked_sub(self.width),
            index.checked_sub(1),
            Some(index + 1),
            Some(index + self.width),
        ];
        let (mut count, mut idepth, mut variance) = (0.0, 0.0, 0.0);
        let (mut lowest, mut highest) = (f32::INFINITY, f32::NEG_INFINITY);
        let indices = around.into_iter().flatten();
        let depths = indices.filter_map(|i| self.depths.get(i));
        for [d, v] in depths.filter(|[d, _]| *d > 0.0) {
            count += 1.0;
            idepth += d;
            variance += v;
            lowest = lowest.min(*d);
            highest = highest.max(*d);
        }
        (idepth, variance) = (idepth / count, variance / count);
        let agree = (highest - lowest).powi(2) <= 4.0 * 2.0 * variance
            && (idepth - pixel.idepth).powi(2) <= 4.0 * (variance + pixel.idepth_var);
        (count >= 2.0 && agree).then_some(PixelDepth {
            idepth,
            idepth_var: variance,
            ..*pixel
        })
    }
}

#[cfg(test)]
mod tests;
