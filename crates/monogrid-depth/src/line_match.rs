//! Matching of a short patch along an epipolar line.
//!
//! The patch is five samples of the keyframe along the line, spaced so that they are 1 px apart in
//! the frame. `search` compares it at every pixel of an interval (sum of squared differences, SSD),
//! `refine` finds the sub-pixel position.
//!
//! The refinement is inverse-compositional: it solves `sum g r = 0` with the gradient `g` of the
//! keyframe's samples as central differences. Noise of the frame is then independent of `g`, and
//! the keyframe's own noise cancels in `sum g n` up to the ends, so the match is not drawn to any
//! fraction of a pixel as the minimum of an interpolated SSD is.

use crate::stats::PixelOutcome;
use monogrid_image::GrayImage;
use monogrid_image::lanes::{Baseline, bilinear};
use wide::f32x8;

/// Samples compared.
pub(crate) const PATCH: usize = 5;
/// Samples on either side of the centre.
const RADIUS: usize = PATCH / 2;
/// Samples of the descriptor: one more at each end for the gradient.
const SAMPLES: usize = PATCH + 2;
/// Longest interval, px.
pub(crate) const MAX_STEPS: usize = 250;
/// Positions of a short search.
const SHORT: usize = 28;
/// Iterations of the refinement.
const MAX_ITERATIONS: usize = 6;
/// The refinement stops when it moves less, px.
const CONVERGED_PX: f32 = 0.005;

/// 0, 1, ... 7.
const LANE: f32x8 = f32x8::new([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);

/// What is looked for: the keyframe along its epipolar line.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Patch {
    /// Grey values at -2..=2.
    pub(crate) values: [f32; PATCH],
    /// Derivative along the line, grey levels per px of the frame.
    pub(crate) slopes: [f32; PATCH],
    /// Sum of the squared slopes.
    pub(crate) information: f32,
    /// Centroid of the squared slopes, px of the frame from the centre.
    pub(crate) centroid: f32,
}

impl Patch {
    /// Samples the keyframe at `(x, y)` along the unit vector `direction`, `step` px apart.
    #[inline]
    pub(crate) fn new(image: &GrayImage, pixel: [f32; 2], direction: [f32; 2], step: f32) -> Self {
        let offset = (LANE - (RADIUS + 1) as f32) * step;
        let [x, y] = [0, 1].map(|axis| pixel[axis] + offset * direction[axis]);
        let samples: [f32; SAMPLES] = bilinear(Baseline, image, x, y);
        let values = std::array::from_fn(|k| samples[k + 1]);
        let slopes: [f32; PATCH] = std::array::from_fn(|k| 0.5 * (samples[k + 2] - samples[k]));
        let (mut information, mut moment) = (0.0, 0.0);
        for (k, slope) in slopes.iter().enumerate() {
            information += slope * slope;
            moment += slope * slope * (k as f32 - RADIUS as f32);
        }
        Self {
            values,
            slopes,
            information,
            centroid: moment / information.max(1e-6),
        }
    }
}

/// A straight walk in the frame: position 0 is the point at infinity.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Walk<'a> {
    pub(crate) image: &'a GrayImage,
    pub(crate) origin: [f32; 2],
    pub(crate) direction: [f32; 2],
    /// Turns grey values of the frame into the keyframe's: `(value - bias) * inv_gain`.
    pub(crate) inv_gain: f32,
    pub(crate) bias: f32,
}

impl Walk<'_> {
    /// The samples of a patch around `position`.
    #[inline]
    fn window(&self, position: f32) -> [f32; PATCH] {
        let position = position + LANE - RADIUS as f32;
        let [x, y] = [0, 1].map(|axis| self.origin[axis] + position * self.direction[axis]);
        // a patch has five samples, and a function for wider vectors costs more than they bring
        bilinear(Baseline, self.image, x, y).map(|raw| (raw - self.bias) * self.inv_gain)
    }

    /// Samples every px from `from`, in fixed point: steps are exact to 1e-3 px over any search,
    /// and no number is converted to an integer on the way.
    fn fill(&self, from: f32, values: &mut [f32]) {
        const ONE: f32 = 65536.0;
        let start = |axis| ((self.origin[axis] + from * self.direction[axis]) * ONE) as i32;
        let step = |axis: usize| (self.direction[axis] * ONE).round() as i32;
        let (mut u, mut v) = (start(0), start(1));
        let (step_u, step_v) = (step(0), step(1));
        let w = self.image.width();
        let data = self.image.as_slice();
        for value in values.iter_mut() {
            let i = (v >> 16) as usize * w + (u >> 16) as usize;
            let fx = (u & 0xFFFF) as f32 * (1.0 / ONE);
            let fy = (v & 0xFFFF) as f32 * (1.0 / ONE);
            let cell = &data[i..i + w + 2];
            let a = cell[0] + fx * (cell[1] - cell[0]);
            let b = cell[w] + fx * (cell[w + 1] - cell[w]);
            *value = a + fy * (b - a);
            u += step_u;
            v += step_v;
        }
        for value in values {
            *value = (*value - self.bias) * self.inv_gain;
        }
    }
}

/// A minimum of the SSD.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct LineMatch {
    /// Position along the line, px from the point at infinity.
    pub(crate) position: f32,
    /// Sum of squared differences, grey levels².
    pub(crate) ssd: f32,
}

/// Best position in `[from, from + num_steps]` in steps of 1 px.
///
/// `noise_ssd` is the SSD that noise alone would cause: a better best does not make the second best
/// a clear loser.
pub(crate) fn search(
    patch: &Patch,
    walk: &Walk<'_>,
    from: f32,
    num_steps: usize,
    ambiguity: (f32, f32),
) -> Result<LineMatch, PixelOutcome> {
    let num = num_steps.min(MAX_STEPS) + 1;
    // most searches are short, and clearing the long buffers would take longer than they do
    if num <= SHORT {
        let (mut values, mut costs) = ([0.0; SHORT + 2 * RADIUS], [0.0; SHORT]);
        let buffers = (&mut values[..num + 2 * RADIUS], &mut costs[..num]);
        search_in(patch, walk, from, buffers, ambiguity)
    } else {
        let (mut values, mut costs) = ([0.0; MAX_STEPS + 1 + 2 * RADIUS], [0.0; MAX_STEPS + 1]);
        let buffers = (&mut values[..num + 2 * RADIUS], &mut costs[..num]);
        search_in(patch, walk, from, buffers, ambiguity)
    }
}

/// [`search`] at `costs.len()` positions; `values` holds a patch more.
#[inline]
fn search_in(
    patch: &Patch,
    walk: &Walk<'_>,
    from: f32,
    (values, costs): (&mut [f32], &mut [f32]),
    ambiguity: (f32, f32),
) -> Result<LineMatch, PixelOutcome> {
    walk.fill(from - RADIUS as f32, values);
    fill_costs(patch, values, costs);
    let (mut best, mut best_cost) = (0, f32::INFINITY);
    for (i, &cost) in costs.iter().enumerate() {
        if cost < best_cost {
            (best, best_cost) = (i, cost);
        }
    }
    if best == 0 || best + 1 == costs.len() {
        return Err(PixelOutcome::AtIntervalEnd);
    }
    let (ratio, noise_ssd) = ambiguity;
    let limit = ratio * best_cost.max(noise_ssd);
    if has_rival(costs, best, limit) {
        return Err(PixelOutcome::Ambiguous);
    }
    Ok(LineMatch {
        position: from + best as f32,
        ssd: best_cost,
    })
}

/// SSD at each position; one sample of the patch at a time, so that positions are computed in
/// lanes.
fn fill_costs(patch: &Patch, values: &[f32], costs: &mut [f32]) {
    let num = costs.len();
    costs.fill(0.0);
    for (k, reference) in patch.values.iter().enumerate() {
        for (cost, value) in costs.iter_mut().zip(&values[k..k + num]) {
            let r = value - reference;
            *cost += r * r;
        }
    }
}

/// Whether a local minimum at least three steps from `best` costs less than `limit`.
///
/// The flanks of the best minimum are not local minima, hence never rivals, however flat.
fn has_rival(costs: &[f32], best: usize, limit: f32) -> bool {
    let is_minimum = |i: usize| {
        let left = i.checked_sub(1).map_or(f32::INFINITY, |j| costs[j]);
        let right = costs.get(i + 1).copied().unwrap_or(f32::INFINITY);
        costs[i] <= left && costs[i] <= right
    };
    let mut cheap = costs.iter().enumerate().filter(|(_, cost)| **cost < limit);
    cheap.any(|(i, _)| i.abs_diff(best) > RADIUS && is_minimum(i))
}

#[inline]
fn ssd_of(patch: &Patch, window: &[f32]) -> f32 {
    let mut sum_sq = 0.0;
    for (value, reference) in window.iter().zip(&patch.values) {
        let r = value - reference;
        sum_sq += r * r;
    }
    sum_sq
}

/// Moves a match to sub-pixel precision, at most `max_move` px away.
#[inline]
pub(crate) fn refine(
    patch: &Patch,
    walk: &Walk<'_>,
    start: f32,
    max_move: f32,
) -> Result<LineMatch, PixelOutcome> {
    let inv_information = 1.0 / patch.information.max(1e-6);
    let mut position = start;
    for _ in 0..MAX_ITERATIONS {
        let (step, ssd) = newton_step(patch, walk, position, inv_information);
        if step.abs() < CONVERGED_PX {
            return Ok(LineMatch { position, ssd });
        }
        // a step beyond a pixel leaves the range where the patch is linear
        position += step.clamp(-1.0, 1.0);
        if (position - start).abs() > max_move {
            return Err(PixelOutcome::NotConverged);
        }
    }
    let (step, ssd) = newton_step(patch, walk, position, inv_information);
    if step.abs() < 10.0 * CONVERGED_PX {
        Ok(LineMatch { position, ssd })
    } else {
        Err(PixelOutcome::NotConverged)
    }
}

/// The inverse-compositional step at `position`, and the SSD there.
#[inline]
fn newton_step(patch: &Patch, walk: &Walk<'_>, position: f32, inv_information: f32) -> (f32, f32) {
    let window = walk.window(position);
    let mut slope_sum = 0.0;
    for ((slope, value), reference) in patch.slopes.iter().zip(&window).zip(&patch.values) {
        slope_sum += slope * (value - reference);
    }
    (-slope_sum * inv_information, ssd_of(patch, &window))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A band-limited texture, as a camera with a good lens sees it.
    fn texture(x: f32, y: f32) -> f32 {
        120.0
            + 35.0 * (0.55 * x + 0.2 * y).sin()
            + 25.0 * (0.93 * x - 0.31 * y + 1.0).sin()
            + 15.0 * (1.37 * x + 0.5 * y + 2.0).sin()
    }

    fn shifted(shift: f32) -> GrayImage {
        GrayImage::from_fn(200, 60, |x, y| texture(x as f32 - shift, y as f32))
    }

    fn walk(image: &GrayImage, y: f32) -> Walk<'_> {
        Walk {
            image,
            origin: [0.0, y],
            direction: [1.0, 0.0],
            inv_gain: 1.0,
            bias: 0.0,
        }
    }

    fn noisy(image: &GrayImage, sigma: f32, seed: u64) -> GrayImage {
        let mut state = seed;
        image.map(|v| {
            // sum of twelve uniform numbers
            let mut sum = -6.0f32;
            for _ in 0..12 {
                state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1);
                sum += (state >> 40) as f32 / (1u64 << 24) as f32;
            }
            v + sigma * sum
        })
    }

    #[test]
    fn refinement_is_not_drawn_to_any_fraction_of_a_pixel() {
        for sigma in [0.0f32, 3.0] {
            for tenth in 0..10 {
                let shift = 7.0 + 0.1 * tenth as f32;
                let keyframe = noisy(&shifted(0.0), sigma, 1 + tenth);
                let frame = noisy(&shifted(shift), sigma, 1000 + tenth);
                let (mut sum, mut num) = (0.0, 0);
                for y in 3..57 {
                    for x in (20..160).step_by(2) {
                        let place = [x as f32, y as f32];
                        let patch = Patch::new(&keyframe, place, [1.0, 0.0], 1.0);
                        let start = x as f32 + shift.round();
                        let walk = walk(&frame, y as f32);
                        if let Ok(found) = refine(&patch, &walk, start, 1.25) {
                            sum += found.position - x as f32 - shift;
                            num += 1;
                        }
                    }
                }
                let bias = sum / num as f32;
                assert!(num > 3000, "only {num} converged");
                assert!(
                    bias.abs() < 0.03,
                    "shift {shift} noise {sigma}: bias {bias} px"
                );
            }
        }
    }

    #[test]
    fn search_finds_the_shift_under_gain_and_bias() {
        let keyframe = shifted(0.0);
        let frame = shifted(12.3).map(|v| 0.8 * v + 20.0);
        let mut found = 0;
        for x in (20..120).step_by(5) {
            let patch = Patch::new(&keyframe, [x as f32, 30.0], [1.0, 0.0], 1.0);
            let mut walk = walk(&frame, 30.0);
            (walk.inv_gain, walk.bias) = (1.0 / 0.8, 20.0);
            let from = x as f32;
            let Ok(coarse) = search(&patch, &walk, from, 30, (1.5, 1.0)) else {
                continue;
            };
            let fine = refine(&patch, &walk, coarse.position, 1.25).expect("converges");
            // bilinear interpolation of texture this fine moves single matches by 0.1 px
            assert!((fine.position - from - 12.3).abs() < 0.2, "{fine:?}");
            assert!(fine.ssd < 150.0, "{fine:?}");
            found += 1;
        }
        assert!(found >= 15, "{found} of 20");
    }

    #[test]
    fn repeated_texture_is_ambiguous_and_an_end_is_no_match() {
        let stripes = GrayImage::from_fn(200, 60, |x, _| {
            100.0 + 50.0 * (x as f32 * std::f32::consts::TAU / 9.0).sin()
        });
        let patch = Patch::new(&stripes, [60.0, 30.0], [1.0, 0.0], 1.0);
        let ambiguous = search(&patch, &walk(&stripes, 30.0), 50.0, 40, (1.5, 1.0));
        assert_eq!(ambiguous, Err(PixelOutcome::Ambiguous));
        // the truth lies two pixels before the interval
        let image = shifted(0.0);
        let patch = Patch::new(&image, [60.0, 30.0], [1.0, 0.0], 1.0);
        let outside = search(&patch, &walk(&image, 30.0), 62.0, 2, (1.5, 1.0));
        assert_eq!(outside, Err(PixelOutcome::AtIntervalEnd));
    }

    #[test]
    fn costs_in_lanes_equal_the_plain_sum() {
        let image = noisy(&shifted(0.0), 4.0, 3);
        let patch = Patch::new(&image, [50.0, 20.0], [0.6, 0.8], 1.1);
        let mut values = [0.0; 44];
        walk(&image, 20.0).fill(30.0, &mut values);
        for (i, value) in values.iter().enumerate() {
            let place = [30.0 + i as f32, 20.0].map(f32x8::splat);
            let [exact] = bilinear(Baseline, &image, place[0], place[1]);
            assert!((value - exact).abs() < 0.01);
        }
        let mut costs = [0.0; 40];
        fill_costs(&patch, &values, &mut costs);
        for (cost, window) in costs.iter().zip(values.windows(PATCH)) {
            let plain = ssd_of(&patch, window);
            assert!(
                (cost - plain).abs() < 1e-3 * plain.max(1.0),
                "{cost} {plain}"
            );
        }
    }
}
