//! A patch prepared for inverse-compositional alignment with gain and bias.
//!
//! The image around `x` is modelled as `I(x + u) = g T(u + delta) + b`, linear in
//! `(g delta, g, b)`. Gradients of the template are projected once onto the complement of
//! `{1, T}`, which eliminates gain and bias; one step is then a 2x2 solve with a constant matrix
//! (Baker and Matthews, *Lucas-Kanade 20 years on*, 2004, sections 3.2 and part 3).

use monogrid_geometry::Vec2;
use monogrid_image::lanes::Lanes;
use monogrid_image::{GrayImage, Image, for_lanes};

/// Side of a patch, px.
pub(super) const SIDE: usize = 8;
/// Side of a patch with the border that its gradients need, px.
pub(super) const WIDE: usize = SIDE + 2;
/// Distance from the first sample to the centre of the patch, px.
const HALF: f32 = (SIDE as f32 - 1.0) / 2.0;
const NUM: f32 = (SIDE * SIDE) as f32;

/// Grey values of a patch.
pub(super) type Values = [[f32; SIDE]; SIDE];

/// How a patch was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PatchFit {
    /// Centre of the patch in the current image, level-0 px.
    pub pixel: Vec2,
    /// Zero-mean normalised cross-correlation of patch and image, at most 1.
    pub correlation: f32,
    /// Root mean square of the residual after gain and bias, grey levels of the current image.
    pub residual_rms: f32,
    /// Contrast of the current image relative to the reference.
    pub gain: f32,
    /// Second derivatives (Gauss-Newton) of half the squared residual with respect to the pixel:
    /// `xx, xy, yy`, (grey levels / level-0 px)². Times `1 / residual_rms²` it is the information
    /// of the pixel.
    pub hessian: [f32; 3],
}

/// A template ready to be aligned.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Template {
    /// Grey values less their mean.
    values: Values,
    /// Sum of the squared `values`.
    energy: f32,
    /// Gradients without their components along 1 and `values`.
    gx: Values,
    gy: Values,
    /// `xx, xy, yy` of the projected gradients and the inverse.
    hessian: [f32; 3],
    inverse: [f32; 3],
}

/// Where an alignment ended, in pixels of the level.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LevelFit {
    pub centre: [f32; 2],
    pub correlation: f32,
    pub residual_rms: f32,
    pub gain: f32,
    pub hessian: [f32; 3],
}

/// Why an alignment on one level gave nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum LevelFailure {
    /// The patch left the image.
    OutOfImage,
    /// It went further than the allowed distance.
    Diverged,
}

impl Template {
    /// A template from a patch with its border; `None` when its weakest direction has a mean
    /// squared gradient below `min_score` (after projection).
    pub fn new(wide: &[[f32; WIDE]; WIDE], min_score: f32) -> Option<Self> {
        template_of(wide, min_score)
    }

    #[inline(always)]
    fn of_patch<L: Lanes>(_: L, wide: &[[f32; WIDE]; WIDE], min_score: f32) -> Option<Self> {
        let (mut values, mut gx, mut gy) = with_gradients(wide);
        remove_mean(&mut values);
        let energy = dot(&values, &values);
        if energy < NUM {
            return None; // contrast below one grey level
        }
        for g in [&mut gx, &mut gy] {
            remove_mean(g);
            let along = dot(g, &values) / energy;
            for (row, reference) in g.iter_mut().zip(&values) {
                for (v, t) in row.iter_mut().zip(reference) {
                    *v -= along * t;
                }
            }
        }
        let hessian = [dot(&gx, &gx), dot(&gx, &gy), dot(&gy, &gy)];
        let [a, b, c] = hessian;
        let det = a * c - b * b;
        let weakest = 0.5 * (a + c) - (0.25 * (a - c) * (a - c) + b * b).sqrt();
        if weakest < min_score * NUM || det <= 0.0 {
            return None;
        }
        Some(Self {
            values,
            energy,
            gx,
            gy,
            hessian,
            inverse: [c / det, -b / det, a / det],
        })
    }

    /// The template around `centre` of an image; `None` at the border or without texture.
    pub fn sampled(image: &GrayImage, centre: [f32; 2], min_score: f32) -> Option<Self> {
        Self::new(&sample::<WIDE, _>(image, centre)?, min_score)
    }

    /// Zero-mean normalised cross-correlation with the patch around an integer `corner`.
    #[inline]
    pub fn correlation_at(&self, image: &GrayImage, left: usize, top: usize) -> f32 {
        let (mut sum, mut sum_sq, mut cross) = ([0.0f32; SIDE], [0.0f32; SIDE], [0.0f32; SIDE]);
        for (y, reference) in self.values.iter().enumerate() {
            let row = &image.row(top + y)[left..left + SIDE];
            for x in 0..SIDE {
                sum[x] += row[x];
                sum_sq[x] += row[x] * row[x];
                cross[x] += row[x] * reference[x];
            }
        }
        let (sum, sum_sq, cross) = (lane_sum(&sum), lane_sum(&sum_sq), lane_sum(&cross));
        let variance = (sum_sq - sum * sum / NUM).max(1.0);
        cross / (self.energy * variance).sqrt()
    }

    /// Aligns the template with `image` from `start`.
    ///
    /// Stops when a step is shorter than `min_step`, after `max_iterations`, or when the centre
    /// moved further than `max_distance` from the start.
    pub fn align(
        &self,
        image: &GrayImage,
        start: [f32; 2],
        limits: &AlignLimits,
    ) -> Result<LevelFit, LevelFailure> {
        align(self, image, start, limits)
    }

    #[inline(always)]
    fn aligned<L: Lanes>(
        _: L,
        template: &Self,
        image: &GrayImage,
        start: [f32; 2],
        limits: &AlignLimits,
    ) -> Result<LevelFit, LevelFailure> {
        let mut centre = start;
        for _ in 0..limits.max_iterations {
            let patch = sample::<SIDE, _>(image, centre).ok_or(LevelFailure::OutOfImage)?;
            let (bx, by) = (dot(&template.gx, &patch), dot(&template.gy, &patch));
            // a contrast that vanishes or flips must not make the step explode
            let gain = (dot(&template.values, &patch) / template.energy).max(0.3);
            let [i_xx, i_xy, i_yy] = template.inverse;
            let step = [
                (i_xx * bx + i_xy * by) / gain,
                (i_xy * bx + i_yy * by) / gain,
            ];
            let norm = (step[0] * step[0] + step[1] * step[1]).sqrt();
            let shorten = if norm > MAX_STEP {
                MAX_STEP / norm
            } else {
                1.0
            };
            centre = [centre[0] - shorten * step[0], centre[1] - shorten * step[1]];
            let (dx, dy) = (centre[0] - start[0], centre[1] - start[1]);
            // NaN passes here, and the next sample refuses it
            if dx * dx + dy * dy > limits.max_distance * limits.max_distance {
                return Err(LevelFailure::Diverged);
            }
            if norm < limits.min_step {
                break;
            }
        }
        template
            .fit_at(image, centre)
            .ok_or(LevelFailure::OutOfImage)
    }

    /// Similarity of template and image at a centre.
    #[inline(always)]
    pub fn fit_at(&self, image: &GrayImage, centre: [f32; 2]) -> Option<LevelFit> {
        let mut patch = sample::<SIDE, _>(image, centre)?;
        remove_mean(&mut patch);
        let variance = dot(&patch, &patch);
        let cross = dot(&self.values, &patch);
        let gain = cross / self.energy;
        let residual = (variance - cross * gain).max(0.0);
        Some(LevelFit {
            centre,
            correlation: cross / (self.energy * variance).max(1e-6).sqrt(),
            residual_rms: (residual / NUM).sqrt(),
            gain,
            hessian: self.hessian.map(|h| h * gain * gain),
        })
    }
}

// in vectors that the compiler makes: rows are as long as they
for_lanes! {
    fn template_of = Template::of_patch, (
        patch: &[[f32; WIDE]; WIDE],
        min_score: f32,
    ) -> Option<Template>;
    fn align = Template::aligned, (
        template: &Template,
        image: &GrayImage,
        start: [f32; 2],
        limits: &AlignLimits,
    ) -> Result<LevelFit, LevelFailure>;
}

/// The inner patch, and its derivatives along x and y.
#[inline(always)]
pub(super) fn with_gradients(wide: &[[f32; WIDE]; WIDE]) -> (Values, Values, Values) {
    let mut seen = [[0.0f32; SIDE]; SIDE];
    let (mut gx, mut gy) = (seen, seen);
    for y in 0..SIDE {
        for x in 0..SIDE {
            seen[y][x] = wide[y + 1][x + 1];
            gx[y][x] = 0.5 * (wide[y + 1][x + 2] - wide[y + 1][x]);
            gy[y][x] = 0.5 * (wide[y + 2][x + 1] - wide[y][x + 1]);
        }
    }
    (seen, gx, gy)
}

/// Longest step of one iteration, px of the level: beyond it the linearisation means nothing.
const MAX_STEP: f32 = 2.0;

/// When an alignment stops.
#[derive(Clone, Copy, Debug)]
pub(super) struct AlignLimits {
    pub max_iterations: usize,
    pub min_step: f32,
    pub max_distance: f32,
}

/// An `N`x`N` patch around `centre`, bilinear; `None` when a sample lies outside the image.
#[inline(always)]
pub(super) fn sample<const N: usize, P: Copy + Into<f32>>(
    image: &Image<P>,
    centre: [f32; 2],
) -> Option<[[f32; N]; N]> {
    let half = (N as f32 - 1.0) / 2.0;
    let (left, top) = (centre[0] - half, centre[1] - half);
    let inside = left >= 0.0
        && top >= 0.0
        && left < image.width() as f32 - N as f32
        && top < image.height() as f32 - N as f32;
    if !inside {
        return None; // also for NaN
    }
    let (ix, iy) = (left as usize, top as usize);
    let (fx, fy) = (left - ix as f32, top - iy as f32);
    let (w00, w10) = ((1.0 - fx) * (1.0 - fy), fx * (1.0 - fy));
    let (w01, w11) = ((1.0 - fx) * fy, fx * fy);
    let mut out = [[0.0f32; N]; N];
    for (y, row) in out.iter_mut().enumerate() {
        let upper = &image.row(iy + y)[ix..ix + N + 1];
        let lower = &image.row(iy + y + 1)[ix..ix + N + 1];
        for x in 0..N {
            let [a, b] = [upper[x].into(), upper[x + 1].into()];
            let [c, d] = [lower[x].into(), lower[x + 1].into()];
            row[x] = w00 * a + w10 * b + (w01 * c + w11 * d);
        }
    }
    Some(out)
}

/// Top-left sample of the patch around an integer-grid candidate centred at `centre`.
pub(super) fn integer_corner(centre: [f32; 2]) -> [f32; 2] {
    [(centre[0] - HALF).round(), (centre[1] - HALF).round()]
}

/// Centre of the patch whose first sample is at an integer `corner`.
pub(super) fn centre_of_corner(left: usize, top: usize) -> [f32; 2] {
    [left as f32 + HALF, top as f32 + HALF]
}

#[inline(always)]
pub(super) fn dot(a: &Values, b: &Values) -> f32 {
    let mut lanes = [0.0f32; SIDE];
    for (row_a, row_b) in a.iter().zip(b) {
        for x in 0..SIDE {
            lanes[x] += row_a[x] * row_b[x];
        }
    }
    lane_sum(&lanes)
}

#[inline(always)]
pub(super) fn remove_mean(values: &mut Values) {
    let mut lanes = [0.0f32; SIDE];
    for row in values.iter() {
        for x in 0..SIDE {
            lanes[x] += row[x];
        }
    }
    let mean = lane_sum(&lanes) / NUM;
    for value in values.iter_mut().flatten() {
        *value -= mean;
    }
}

/// Sum in a fixed order that vectorises.
#[inline(always)]
fn lane_sum(lanes: &[f32; SIDE]) -> f32 {
    let [a, b, c, d, e, f, g, h] = *lanes;
    ((a + e) + (c + g)) + ((b + f) + (d + h))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_images::Texture;
    use monogrid_image::lanes::Baseline;

    #[test]
    fn all_vectors_give_the_same_bits() {
        let image = Texture::new(5).render(160, 120, |x, y| (x, y));
        let limits = AlignLimits {
            max_iterations: 8,
            min_step: 0.01,
            max_distance: 4.0,
        };
        let mut aligned = 0;
        for k in 0..200 {
            let (x, y) = ((k % 20) as f32 * 6.3 + 15.2, (k / 20) as f32 * 9.1 + 15.7);
            let wide = sample::<WIDE, _>(&image, [x, y]).expect("inside");
            let template = template_of(&wide, 1.0);
            assert_eq!(template, Template::of_patch(Baseline, &wide, 1.0));
            if let Some(template) = template {
                let start = [x + 0.8, y - 0.6];
                let found = template.align(&image, start, &limits);
                assert_eq!(
                    found,
                    Template::aligned(Baseline, &template, &image, start, &limits)
                );
                aligned += usize::from(found.is_ok());
            }
        }
        assert!(aligned > 100, "{aligned}");
    }
}
