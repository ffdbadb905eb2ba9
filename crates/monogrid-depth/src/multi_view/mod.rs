//! Depth of a finished keyframe from all keyframes around it, at the poses that are known in the
//! end.
//!
//! The filter observes a keyframe while its pose and those of the frames are still estimates; what
//! is wrong with them stays in the depth. When the poses are optimised, the images of the other
//! keyframes say more. A pixel `x` of inverse depth `rho` is seen in a source at
//!
//! ```text
//! x'(rho) = pi(K R K^-1 (x, y, 1) + rho K t / s)          (s R, t: source from keyframe)
//! ```
//!
//! Flow per pixel: the sources that see it with enough disparity along its gradient
//! ([`pixel_projection`]) → the best normalised correlation of a patch over a short range of
//! inverse depths ([`search`]) → Gauss-Newton on ln(rho) over all these sources, with gain and bias
//! of each patch free, which also gives the variance. A pixel that its sources do not agree about
//! has no new depth. Half of the pixels take the mean of their neighbours where these agree.

mod pixel_projection;
mod search;

use crate::DepthPixel;
use monogrid_geometry::{Pinhole, Sim3};
use monogrid_image::Image;
use pixel_projection::Projected;

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
/// A disparity is the way of the match in px along the gradient if the inverse depth changed by all
/// of itself: at 50 px, 2 % are one pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct MultiViewConfig {
    /// Whether every second pixel, as on a chess board, takes the mean of the refined ones around
    /// it where these agree; half the work.
    pub interpolate: bool,
    /// Sources per pixel, those of the largest disparity.
    pub max_sources: usize,
    /// Smallest disparity of a source, px.
    pub(crate) min_disparity_px: f64,
}

impl Default for MultiViewConfig {
    fn default() -> Self {
        Self {
            interpolate: true,
            max_sources: 5,
            min_disparity_px: 15.0,
        }
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
    pixels: &[DepthPixel],
    sources: &[SourceView],
    config: &MultiViewConfig,
) -> (Vec<DepthPixel>, usize) {
    let projected = Projected::of_sources(image, camera, sources);
    let mut search = search::Search::new(image, &projected, config);
    let is_first = |p: &DepthPixel| !config.interpolate || (p.x ^ p.y).is_multiple_of(2);
    let mut refine_first = |p| if is_first(p) { search.refine(p) } else { None };
    let mut refined: Vec<Option<DepthPixel>> = pixels.iter().map(&mut refine_first).collect();
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
    fn new(image: &Image<u8>, refined: &[Option<DepthPixel>]) -> Self {
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

    /// The mean of two or more of the four neighbours, if all of them and the pixel itself agree
    /// within two standard deviations. Neighbours share their errors: its variance is theirs.
    fn mean_around(&self, pixel: &DepthPixel) -> Option<DepthPixel> {
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
        (count >= 2.0 && agree).then_some(DepthPixel {
            idepth,
            idepth_var: variance,
            ..*pixel
        })
    }
}

#[cfg(test)]
mod tests;
