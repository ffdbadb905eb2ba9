//! How much an image looks like a patch at a place, as a cost that can be minimised together with
//! other costs.
//!
//! At a pixel `u` the patch `T` and the image `I` differ by `r(u) = I(u + o) - g T(o) - b` over the
//! offsets `o`, where gain and bias are those of least squares: what is left of the image when its
//! mean and its part along `T` are taken out, a linear function of the image with the derivative `P
//! grad I`. How well a patch can fit (slant, reflections, something nearer in a corner of it) is
//! different for each and not known, so its noise is an unknown of its own: the negative logarithm
//! of the likelihood, noise eliminated, of `n` independent values is `n/2 ln(s^2 + mean rho(r))`,
//! with a Huber kernel `rho` and the noise `s^2` that every image has. A patch that fits badly
//! everywhere has little to say, one that fits well at one place much.
//!
//! Reference: Baker and Matthews, *Lucas-Kanade 20 years on*, 2004, part 3, for linear appearance
//! variation.

use super::patch::warped;
use super::points::to_f32;
use super::template::{SIDE, Values, WIDE, dot, remove_mean, sample, with_gradients};
use monogrid_geometry::Vec2;
use monogrid_geometry::nalgebra::Matrix2;
use monogrid_image::{Image, Pyramid};

const NUM: f32 = (SIDE * SIDE) as f32;

/// Smallest contrast of the image relative to the patch that counts as the same texture: a plain
/// wall differs little from anything times zero.
const MIN_GAIN: f32 = 0.3;

/// What a difference between patch and image costs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhotometricCostConfig {
    /// Noise of every image, grey levels. Default 0.5.
    pub noise: f32,
    /// Difference of a pixel from which on it grows no more than in proportion (Huber), grey
    /// levels. Default 3.
    pub kernel: f32,
    /// Pixels of a patch whose differences are independent: neighbours share their errors. Default
    /// 3.
    pub independent_pixels: f32,
}

impl Default for PhotometricCostConfig {
    fn default() -> Self {
        Self {
            noise: 0.5,
            kernel: 3.0,
            independent_pixels: 3.0,
        }
    }
}

impl PhotometricCostConfig {
    /// What costs at least as much as anything that an image can show.
    #[must_use]
    pub fn largest_cost(&self) -> f64 {
        self.cost_of(255.0 * 255.0)
    }

    /// The cost of a mean error, (grey levels)^2.
    fn cost_of(&self, mean_error: f32) -> f64 {
        let noise = f64::from(self.noise) * f64::from(self.noise);
        0.5 * f64::from(self.independent_pixels) * (1.0 + f64::from(mean_error) / noise).ln()
    }
}

/// A patch that images are compared with.
#[derive(Clone, Debug)]
pub struct PhotometricCost {
    /// Grey values without their mean, of length one.
    values: Values,
    /// Their length before.
    contrast: f32,
}

/// Derivatives of the cost by the pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhotometricSlope {
    /// First.
    pub gradient: Vec2,
    /// Second, as Gauss and Newton have it.
    pub information: Matrix2<f64>,
}

/// What is left of an image at a place.
struct Rest {
    values: Values,
    /// Whether it has so much of the patch that its share was taken out as it is.
    has_free_gain: bool,
}

impl PhotometricCost {
    /// The patch around a pixel (level-0 px of `reference`) as an image sees it that is mapped
    /// there by `reference_from_current` ([`super::patch_warp`]); `None` at the border, and without
    /// contrast.
    #[must_use]
    pub fn new(
        reference: &Pyramid,
        pixel: &Vec2,
        reference_from_current: &Matrix2<f64>,
    ) -> Option<Self> {
        let wide = warped(reference, pixel, reference_from_current, 0)?;
        let (mut values, _, _) = with_gradients(&wide);
        remove_mean(&mut values);
        let contrast = dot(&values, &values).sqrt();
        if contrast < NUM.sqrt() {
            return None; // below one grey level
        }
        values.iter_mut().flatten().for_each(|v| *v /= contrast);
        Some(Self { values, contrast })
    }

    /// Correlation with an image at a pixel; `None` at the border.
    #[must_use]
    pub fn correlation<P: Copy + Into<f32>>(&self, image: &Image<P>, pixel: &Vec2) -> Option<f32> {
        let mut seen = sample::<SIDE, _>(image, to_f32(pixel))?;
        remove_mean(&mut seen);
        Some(dot(&self.values, &seen) / dot(&seen, &seen).max(1e-6).sqrt())
    }

    /// What it costs that the patch is at a pixel of an image; `None` at the border.
    #[must_use]
    pub fn cost<P: Copy + Into<f32>>(
        &self,
        image: &Image<P>,
        pixel: &Vec2,
        config: &PhotometricCostConfig,
    ) -> Option<f64> {
        let seen = sample::<SIDE, _>(image, to_f32(pixel))?;
        let rest = self.rest(seen);
        Some(config.cost_of(mean_error(&rest.values, config)))
    }

    /// Derivatives of [`Self::cost`]; `None` at the border.
    #[must_use]
    pub fn slope<P: Copy + Into<f32>>(
        &self,
        image: &Image<P>,
        pixel: &Vec2,
        config: &PhotometricCostConfig,
    ) -> Option<PhotometricSlope> {
        let wide = sample::<WIDE, _>(image, to_f32(pixel))?;
        let (seen, mut gx, mut gy) = with_gradients(&wide);
        let rest = self.rest(seen);
        for gradient in [&mut gx, &mut gy] {
            self.take_out(gradient, rest.has_free_gain);
        }
        let noise = f64::from(config.noise) * f64::from(config.noise);
        let scale = f64::from(config.independent_pixels)
            / (noise + f64::from(mean_error(&rest.values, config)))
            / f64::from(NUM);
        let mut weighted = [gx, gy];
        for (y, row) in rest.values.iter().enumerate() {
            for (x, r) in row.iter().enumerate() {
                let weight = config.kernel / r.abs().max(config.kernel);
                weighted[0][y][x] *= weight;
                weighted[1][y][x] *= weight;
            }
        }
        let [wx, wy] = &weighted;
        let sum = |a: &Values, b: &Values| scale * f64::from(dot(a, b));
        let across = sum(wx, &gy);
        Some(PhotometricSlope {
            gradient: Vec2::new(sum(wx, &rest.values), sum(wy, &rest.values)),
            information: Matrix2::new(sum(wx, &gx), across, across, sum(wy, &gy)),
        })
    }

    /// What is left of grey values without mean and patch.
    fn rest(&self, mut seen: Values) -> Rest {
        remove_mean(&mut seen);
        let along = dot(&self.values, &seen);
        let least = MIN_GAIN * self.contrast;
        subtract(&mut seen, &self.values, along.max(least));
        Rest {
            values: seen,
            has_free_gain: along > least,
        }
    }

    /// The same of a derivative of the grey values.
    fn take_out(&self, derivative: &mut Values, has_free_gain: bool) {
        remove_mean(derivative);
        if has_free_gain {
            let along = dot(&self.values, derivative);
            subtract(derivative, &self.values, along);
        }
    }
}

fn subtract(from: &mut Values, values: &Values, times: f32) {
    for (row, values) in from.iter_mut().zip(values) {
        for (v, value) in row.iter_mut().zip(values) {
            *v -= times * value;
        }
    }
}

/// Mean of the kernel over the differences, (grey levels)^2.
fn mean_error(rest: &Values, config: &PhotometricCostConfig) -> f32 {
    let mut sums = [0.0f32; SIDE];
    for row in rest {
        for (sum, r) in sums.iter_mut().zip(row) {
            let e = r.abs();
            let inside = e.min(config.kernel);
            // r^2 inside, 2 k |r| - k^2 outside
            *sum += inside * (2.0 * e - inside);
        }
    }
    sums.iter().sum::<f32>() / NUM
}

#[cfg(test)]
mod tests;
