//! The normal equations of one level: residuals, weights and Jacobians of all points.

use crate::damping::MIN_DEPTH_RATIO;
use crate::target::by_point;
use crate::{ReferenceLevel, Robust, TargetLevel};
use monogrid_geometry::Se3;
use monogrid_image::for_lanes;
use monogrid_image::lanes::{F32x8, LANES, Lanes};
use nalgebra::{SMatrix, SVector};
use rayon::prelude::*;
use std::ops::{Add, Mul, Neg, Range, Sub};
use wide::f32x4;

/// Unknowns: twist `[v, w]` of the frame, logarithm of the gain, bias.
pub(crate) const UNKNOWNS: usize = 8;
/// Of all these points, a number each.
pub(crate) type Eight = [f32; LANES];
/// Entries of the upper triangle of the normal equations.
const TRIANGLE: usize = UNKNOWNS * (UNKNOWNS + 1) / 2;
/// Points summed in `f32` before the sum moves to `f64`.
const BLOCK: usize = 2048;
/// Below this many points threads cost more than they bring.
const MIN_PARALLEL: usize = 2 * BLOCK;

/// The state that is estimated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Pose of the frame, translation in keyframe units.
    pub frame_from_keyframe: Se3,
    /// Logarithm of the gain in `I_frame = gain * I_keyframe + bias`.
    pub log_gain: f64,
    /// Bias, grey levels.
    pub bias: f64,
}

impl Motion {
    /// A pose without change of brightness.
    #[must_use]
    pub fn from_pose(frame_from_keyframe: Se3) -> Self {
        Self {
            frame_from_keyframe,
            log_gain: 0.0,
            bias: 0.0,
        }
    }
}

/// How residuals are normalised and weighted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weighting {
    /// Variance of the image noise, grey levels squared.
    pub intensity_var: f32,
    /// Robust function.
    pub robust: Robust,
    /// Scale of the normalised residuals (Student t only; 1 for Huber).
    pub scale: f32,
    /// A residual is good when `r^2 < good_sq + good_gradient_sq * |gradient|^2`.
    pub good_sq: f32,
    /// See [`Self::good_sq`].
    pub good_gradient_sq: f32,
}

/// Sums over all points of a level at one state.
#[derive(Clone, Debug)]
pub struct Linearization {
    /// Sum of `w J^T J`; unknowns `[v, w, log gain, bias]`.
    pub hessian: SMatrix<f64, UNKNOWNS, UNKNOWNS>,
    /// Sum of `w J^T r`.
    pub gradient: SVector<f64, UNKNOWNS>,
    /// Sum of the robust cost over visible points.
    pub cost: f64,
    /// Points that project into the frame.
    pub num_visible: usize,
    /// Visible points with a good residual.
    pub num_good: usize,
    /// Sum over all visible points of `min(depth in keyframe / depth in frame, 1)`.
    pub usage_sum: f64,
    /// Sum of squared raw residuals of good points, grey levels squared.
    pub good_residual_sq: f64,
    /// Sum of `(nu + 1) r_n^2 / (nu + (r_n / scale)^2)`, for the next estimate of the scale.
    pub scale_sum: f64,
    /// Sums over visible points of
    /// `[I_keyframe, I_frame, I_keyframe^2, I_frame^2, I_keyframe I_frame]`.
    pub moments: [f64; 5],
}

/// Residuals of [`LANES`] points with their weights and derivatives; those that are not visible
/// have no weight.
struct Points<V> {
    residual: V,
    weight: V,
    jacobian: [V; UNKNOWNS],
}

/// Builds the normal equations of `reference` against `target` at `motion`.
///
/// `stride` uses every n-th point only (1 for all).
#[must_use]
pub fn linearize(
    reference: &ReferenceLevel,
    target: &TargetLevel,
    motion: &Motion,
    weighting: &Weighting,
    stride: usize,
) -> Linearization {
    let projection = Projection::new(motion);
    let mut out = Linearization {
        hessian: SMatrix::zeros(),
        gradient: SVector::zeros(),
        cost: 0.0,
        num_visible: 0,
        num_good: 0,
        usage_sum: 0.0,
        good_residual_sq: 0.0,
        scale_sum: 0.0,
        moments: [0.0; 5],
    };
    let stride = stride.max(1);
    let count = reference.len().div_ceil(stride);
    let images = (reference, target);
    let block = |start: usize| {
        let end = (start + BLOCK).min(count);
        block_of(&projection, images, weighting, start..end, stride)
    };
    if count > MIN_PARALLEL {
        // blocks are fixed and added in their order: the same bits for any number of threads
        let blocks: Vec<Block> = (0..count.div_ceil(BLOCK))
            .into_par_iter()
            .map(|index| block(index * BLOCK))
            .collect();
        for block in &blocks {
            out.add_block(block);
        }
    } else {
        for start in (0..count).step_by(BLOCK) {
            out.add_block(&block(start));
        }
    }
    for row in 0..UNKNOWNS {
        for column in 0..row {
            out.hessian[(row, column)] = out.hessian[(column, row)];
        }
    }
    out
}

/// Sums of a block of points; of the equations by lane, so that the order of the sums is the same
/// on every machine.
struct Block {
    triangle: [Eight; TRIANGLE],
    gradient: [Eight; UNKNOWNS],
    sums: Sums,
}

for_lanes! {
    /// Sums over some of the points of an image, every `stride`-th, in another.
    fn block_of = block_with, (
        projection: &Projection,
        images: (&ReferenceLevel, &TargetLevel),
        weighting: &Weighting,
        range: Range<usize>,
        stride: usize,
    ) -> Block;
}

#[inline(always)]
fn block_with<L: Lanes>(
    lanes: L,
    projection: &Projection,
    images: (&ReferenceLevel, &TargetLevel),
    weighting: &Weighting,
    range: Range<usize>,
    stride: usize,
) -> Block {
    let zero = lanes.splat(0.0);
    let (mut triangle, mut gradient) = ([zero; TRIANGLE], [zero; UNKNOWNS]);
    let mut sums = Sums::default();
    for start in range.step_by(LANES) {
        let chunk = (start * stride, stride);
        let points = projection.chunk(lanes, images, weighting, chunk, &mut sums);
        accumulate(&points, &mut triangle, &mut gradient);
    }
    Block {
        triangle: triangle.map(F32x8::to_array),
        gradient: gradient.map(F32x8::to_array),
        sums,
    }
}

/// Scalar sums of a block.
#[derive(Debug, Default, PartialEq)]
struct Sums {
    cost: f64,
    num_visible: usize,
    num_good: usize,
    /// The first four of [`Linearization::moments`].
    moments: f32x4,
    /// The last of them, usage, squared residuals of good points, and the scale.
    others: f32x4,
}

impl Linearization {
    fn add_block(&mut self, block: &Block) {
        let Block {
            triangle,
            gradient,
            sums,
        } = block;
        let total = |lanes: &Eight| lanes.iter().copied().map(f64::from).sum::<f64>();
        let mut k = 0;
        for (row, sums) in gradient.iter().enumerate() {
            self.gradient[row] += total(sums);
            for column in row..UNKNOWNS {
                self.hessian[(row, column)] += total(&triangle[k]);
                k += 1;
            }
        }
        self.cost += sums.cost;
        self.num_visible += sums.num_visible;
        self.num_good += sums.num_good;
        let [product, usage, good_residual_sq, scale] = sums.others.to_array().map(f64::from);
        self.usage_sum += usage;
        self.good_residual_sq += good_residual_sq;
        self.scale_sum += scale;
        let moments = sums.moments.to_array().map(f64::from).into_iter();
        for (total, part) in self.moments.iter_mut().zip(moments.chain([product])) {
            *total += part;
        }
    }

    /// Logarithm of the ratio of the contrasts of frame and keyframe over the visible points.
    ///
    /// Unlike the gain of a regression it does not shrink when the images are not aligned yet.
    #[must_use]
    pub fn log_contrast_ratio(&self) -> Option<f64> {
        let (keyframe_var, frame_var, _) = self.second_moments()?;
        Some(0.5 * (frame_var / keyframe_var).ln())
    }

    /// Correlation of the grey values of keyframe and frame over the visible points, in [-1, 1];
    /// `None` with too few points or an image without contrast there.
    #[must_use]
    pub fn correlation(&self) -> Option<f64> {
        let (keyframe_var, frame_var, covariance) = self.second_moments()?;
        Some(covariance / (keyframe_var * frame_var).sqrt())
    }

    /// Variances in keyframe and frame and their covariance, grey levels squared.
    fn second_moments(&self) -> Option<(f64, f64, f64)> {
        let n = self.num_visible as f64;
        let [keyframe, frame, keyframe_sq, frame_sq, product] = self.moments.map(|sum| sum / n);
        let (a, b) = (keyframe_sq - keyframe * keyframe, frame_sq - frame * frame);
        (n > 8.0 && a > 1.0 && b > 1.0).then_some((a, b, product - keyframe * frame))
    }

    /// Mean robust cost of a visible point; infinite when nothing is visible.
    #[must_use]
    pub fn mean_cost(&self) -> f64 {
        if self.num_visible == 0 {
            f64::INFINITY
        } else {
            self.cost / self.num_visible as f64
        }
    }
}

/// Adds `w J^T J` and `w J^T r` of a chunk.
#[inline(always)]
fn accumulate<V: F32x8>(
    points: &Points<V>,
    triangle: &mut [V; TRIANGLE],
    gradient: &mut [V; UNKNOWNS],
) {
    let mut k = 0;
    for (row, sum) in gradient.iter_mut().enumerate() {
        let weighted = points.weight * points.jacobian[row];
        *sum += weighted * points.residual;
        for derivative in &points.jacobian[row..] {
            triangle[k] += weighted * *derivative;
            k += 1;
        }
    }
}

/// Derivative of `I_frame - gain * I_keyframe - bias` by the left twist of the pose, the logarithm
/// of the gain, and the bias; at the normalised image position `[x, y]` with the gradient
/// `[gx, gy]` there, for a point at the inverse depth `inv_z` in the frame. Of one point, or of
/// several side by side; `one` is 1.
#[inline(always)]
pub(crate) fn residual_row<T>(
    [x, y]: [T; 2],
    [gx, gy]: [T; 2],
    inv_z: T,
    scaled_reference: T,
    one: T,
) -> [T; UNKNOWNS]
where
    T: Copy + Add<Output = T> + Sub<Output = T> + Mul<Output = T> + Neg<Output = T>,
{
    [
        gx * inv_z,
        gy * inv_z,
        -(x * gx + y * gy) * inv_z,
        -(gx * x * y + gy * (one + y * y)),
        gx * (one + x * x) + gy * x * y,
        gy * x - gx * y,
        -scaled_reference,
        -one,
    ]
}

/// The state in single precision, ready for the points.
struct Projection {
    r: [[f32; 3]; 3],
    t: [f32; 3],
    gain: f32,
    bias: f32,
}

impl Projection {
    fn new(motion: &Motion) -> Self {
        let m = motion.frame_from_keyframe.rotation_matrix();
        let t = motion.frame_from_keyframe.translation;
        Self {
            r: std::array::from_fn(|i| std::array::from_fn(|j| m[(i, j)] as f32)),
            t: [t.x as f32, t.y as f32, t.z as f32],
            gain: motion.log_gain.exp() as f32,
            bias: motion.bias as f32,
        }
    }

    /// Residual, weight and Jacobian of up to [`LANES`] points: from the first one on, every
    /// `stride`-th.
    ///
    /// `[LSD14]` equations 11 to 14; with the direction `m` (z = 1) and inverse depth `d` of a
    /// point, `q = R m + t d` is its position in the frame times `d`.
    #[inline(always)]
    fn chunk<L: Lanes>(
        &self,
        lanes: L,
        (reference, target): (&ReferenceLevel, &TargetLevel),
        weighting: &Weighting,
        chunk: (usize, usize),
        sums: &mut Sums,
    ) -> Points<L::F32> {
        let (t, one) = (&self.t, lanes.splat(1.0));
        let [fx, fy, cx, cy] = target.intrinsics;
        let of = |values: &[f32]| taken(lanes, values, chunk);
        let (mx, my, d) = (of(&reference.x), of(&reference.y), of(&reference.idepth));
        let [qx, qy, qz] = position_times_idepth((&self.r, t), [mx, my], d);
        let inv_qz = one / qz;
        let (x, y) = (qx * inv_qz, qy * inv_qz);
        let (u, v) = (x * fx + cx, y * fy + cy);
        let visible = qz.gt(lanes.splat(MIN_DEPTH_RATIO)) & target.contains_lanes(lanes, u, v);
        let (x, y, d, inv_qz) = (visible & x, visible & y, visible & d, visible & inv_qz);
        let [intensity, gu, gv] = target.sample_lanes(lanes, u, v, visible);
        let keyframe = visible & of(&reference.intensity);
        let scaled_reference = keyframe * self.gain;
        let residual = intensity - scaled_reference - self.bias;
        let (gx, gy) = (gu * fx, gv * fy);
        // for the variance of the residual
        let by_idepth = by_idepth(lanes, t, [x, y], [gx, gy], inv_qz);
        let idepth_var = visible & of(&reference.idepth_var);
        let variance = by_idepth * by_idepth * idepth_var + weighting.intensity_var;
        let residual_sq = residual * residual;
        let normalised_sq = residual_sq / variance;
        let (robust_weight, cost) = weighting.robust_weight(lanes, normalised_sq);
        let good_sq = (gu * gu + gv * gv) * weighting.good_gradient_sq + weighting.good_sq;
        let is_good = visible & residual_sq.lt(good_sq);
        sums.num_visible += visible.bits().count_ones() as usize;
        sums.num_good += is_good.bits().count_ones() as usize;
        sums.cost += weighting.chunk_cost(lanes, visible, cost);
        sums.add(
            [keyframe, intensity],
            // depth ratio keyframe / frame is 1 / qz
            inv_qz.min(one),
            is_good & residual_sq,
            visible & weighting.scale_term(lanes, normalised_sq),
        );
        let inv_z = d * inv_qz;
        Points {
            residual,
            weight: visible & (robust_weight / variance),
            jacobian: residual_row([x, y], [gx, gy], inv_z, scaled_reference, one),
        }
    }
}

/// `q = R m + t d` for directions `m = (x, y, 1)` and inverse depths `d`.
#[inline(always)]
pub(crate) fn position_times_idepth<V: F32x8>(
    (r, t): (&[[f32; 3]; 3], &[f32; 3]),
    [x, y]: [V; 2],
    d: V,
) -> [V; 3] {
    // one by one: vectors that a closure gives back go through memory
    [
        x * r[0][0] + y * r[0][1] + r[0][2] + d * t[0],
        x * r[1][0] + y * r[1][1] + r[1][2] + d * t[1],
        x * r[2][0] + y * r[2][1] + r[2][2] + d * t[2],
    ]
}

/// Derivative of grey values by the inverse depth, at normalised image positions with those
/// gradients, of points whose depth in the frame times inverse depth is `1 / inv_qz`.
#[inline(always)]
pub(crate) fn by_idepth<L: Lanes>(
    lanes: L,
    t: &[f32; 3],
    [x, y]: [L::F32; 2],
    [gx, gy]: [L::F32; 2],
    inv_qz: L::F32,
) -> L::F32 {
    (gx * (lanes.splat(t[0]) - x * t[2]) + gy * (lanes.splat(t[1]) - y * t[2])) * inv_qz
}

/// Values of [`LANES`] points from the first one on, every `stride`-th; where there are no more, no
/// numbers, so that they are nowhere.
#[inline(always)]
pub(crate) fn taken<L: Lanes>(lanes: L, values: &[f32], (first, stride): (usize, usize)) -> L::F32 {
    let values = &values[first..];
    match values.first_chunk() {
        Some(all) if stride == 1 => lanes.f32s(all),
        _ => {
            let mut some = [f32::NAN; LANES];
            for (lane, value) in some.iter_mut().zip(values.iter().step_by(stride)) {
                *lane = *value;
            }
            lanes.f32s(&some)
        }
    }
}

impl Sums {
    /// Adds point after point, in their order, but all sums side by side; what does not count is 0.
    #[inline(always)]
    fn add<V: F32x8>(&mut self, grey: [V; 2], usage: V, good_sq: V, scale: V) {
        let [a, b] = grey;
        let moments = by_point([a, b, a * a, b * b]);
        let others = by_point([a * b, usage, good_sq, scale]);
        for (moments, others) in moments.into_iter().zip(others) {
            self.moments += moments;
            self.others += others;
        }
    }
}

impl Weighting {
    /// Weights for squared normalised residuals, and their costs: a summand (Huber) or a factor
    /// under the logarithm (Student t), see [`Self::chunk_cost`].
    #[inline(always)]
    fn robust_weight<L: Lanes>(&self, lanes: L, normalised_sq: L::F32) -> (L::F32, L::F32) {
        match self.robust {
            Robust::Huber { k } => huber(lanes, k, normalised_sq),
            Robust::StudentT { nu } => {
                let inv_scale_sq = 1.0 / (self.scale * self.scale);
                let factor = normalised_sq * inv_scale_sq / nu + 1.0;
                // weight (nu + 1) / (nu + (r/s)^2) / s^2; its integral is (nu + 1) ln(1 +
                // (r/s)^2/nu)
                (lanes.splat((nu + 1.0) / nu * inv_scale_sq) / factor, factor)
            }
        }
    }

    /// Cost of the visible points of a chunk: one logarithm of the product instead of one for each
    /// of them.
    #[inline(always)]
    fn chunk_cost<L: Lanes>(&self, lanes: L, visible: L::F32, cost: L::F32) -> f64 {
        match self.robust {
            Robust::Huber { .. } => {
                let costs = (visible & cost).to_array();
                costs.into_iter().map(f64::from).sum()
            }
            Robust::StudentT { nu } => {
                let factors = visible.select(cost, lanes.splat(1.0)).to_array();
                let product: f64 = factors.into_iter().map(f64::from).product();
                f64::from(nu + 1.0) * product.ln()
            }
        }
    }

    /// Summand of the fixed-point iteration for the scale of the t distribution (`[KERL13]`).
    #[inline(always)]
    fn scale_term<L: Lanes>(&self, lanes: L, normalised_sq: L::F32) -> L::F32 {
        match self.robust {
            Robust::Huber { .. } => lanes.splat(0.0),
            Robust::StudentT { nu } => {
                let scale_sq = self.scale * self.scale;
                normalised_sq * (nu + 1.0) / (normalised_sq / scale_sq + nu)
            }
        }
    }
}

/// Huber's weights for squared normalised residuals, and their costs.
#[inline(always)]
pub(crate) fn huber<L: Lanes>(lanes: L, k: f32, squared: L::F32) -> (L::F32, L::F32) {
    let magnitude = squared.sqrt();
    let is_small = magnitude.le(lanes.splat(k));
    (
        is_small.select(lanes.splat(1.0), lanes.splat(k) / magnitude),
        is_small.select(squared, (magnitude * 2.0 - k) * k),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_points::textured;
    use crate::{Reference, Target};
    use monogrid_geometry::Vec6;
    use monogrid_image::lanes::Baseline;

    #[test]
    fn all_vectors_give_the_same_bits() {
        let (pyramid, camera, samples) = textured();
        let reference = Reference::new(&pyramid, &camera, &samples, 0, 0);
        let target = Target::new(&pyramid, &camera, 0, 0);
        let images = (&reference.levels[0], &target.levels[0]);
        let twist = Vec6::new(0.03, -0.02, 0.05, 0.01, 0.02, -0.03);
        let projection = Projection::new(&Motion::from_pose(Se3::exp(&twist)));
        for robust in [Robust::Huber { k: 1.3 }, Robust::StudentT { nu: 5.0 }] {
            let weighting = Weighting {
                intensity_var: 16.0,
                robust,
                scale: 1.7,
                good_sq: 400.0,
                good_gradient_sq: 0.25,
            };
            for stride in [1, 3] {
                let range = 0..images.0.len().div_ceil(stride);
                let widest = block_of(&projection, images, &weighting, range.clone(), stride);
                let plain = block_with(Baseline, &projection, images, &weighting, range, stride);
                assert!(plain.sums.num_visible > 200, "{}", plain.sums.num_visible);
                let bits = |sums: &[Eight]| {
                    sums.as_flattened()
                        .iter()
                        .map(|v| v.to_bits())
                        .collect::<Vec<_>>()
                };
                assert_eq!(bits(&widest.triangle), bits(&plain.triangle));
                assert_eq!(bits(&widest.gradient), bits(&plain.gradient));
                assert_eq!(widest.sums, plain.sums);
            }
        }
    }
}
