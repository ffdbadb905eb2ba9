//! The normal equations of one level: residuals, weights and Jacobians of all points.

use crate::target::by_point;
use crate::{ReferenceLevel, Robust, TargetLevel};
use monogrid_geometry::Se3;
use nalgebra::{SMatrix, SVector};
use rayon::prelude::*;
use std::ops::{Add, Mul, Neg, Sub};
use wide::{f32x4, f32x8};

/// Unknowns: twist `[v, w]` of the frame, logarithm of the gain, bias.
pub(crate) const UNKNOWNS: usize = 8;
/// Points that are worked on side by side.
pub(crate) const LANES: usize = 8;
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
    /// Sums over visible points of `[I_keyframe, I_frame, I_keyframe^2, I_frame^2, I_keyframe I_frame]`.
    pub moments: [f64; 5],
}

/// Residuals of [`LANES`] points with their weights and derivatives; those that are not visible have no weight.
struct Lanes {
    residual: f32x8,
    weight: f32x8,
    jacobian: [f32x8; UNKNOWNS],
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
    let block = |start: usize| {
        let mut block = Block::default();
        let block_end = (start + BLOCK).min(count);
        for start in (start..block_end).step_by(LANES) {
            let chunk = (start * stride, stride);
            let lanes = projection.chunk(reference, target, weighting, chunk, &mut block.sums);
            accumulate(&lanes, &mut block.triangle, &mut block.gradient);
        }
        block
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

/// Sums of a block of points.
struct Block {
    triangle: [f32x8; TRIANGLE],
    gradient: [f32x8; UNKNOWNS],
    sums: Sums,
}

impl Default for Block {
    fn default() -> Self {
        Self {
            triangle: [f32x8::ZERO; TRIANGLE],
            gradient: [f32x8::ZERO; UNKNOWNS],
            sums: Sums::default(),
        }
    }
}

/// Scalar sums of a block.
#[derive(Default)]
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
        let total = |lanes: &f32x8| lanes.to_array().into_iter().map(f64::from).sum::<f64>();
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

    /// Correlation of the grey values of keyframe and frame over the visible points, in [-1, 1]; `None`
    /// with too few points or an image without contrast there.
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

/// Adds `w J^T J` and `w J^T r` of a chunk; lanes stay apart, so that the order of the sums is the same on every machine.
#[inline]
fn accumulate(lanes: &Lanes, triangle: &mut [f32x8; TRIANGLE], gradient: &mut [f32x8; UNKNOWNS]) {
    let mut k = 0;
    for (row, sum) in gradient.iter_mut().enumerate() {
        let weighted = lanes.weight * lanes.jacobian[row];
        *sum += weighted * lanes.residual;
        for derivative in &lanes.jacobian[row..] {
            triangle[k] += weighted * *derivative;
            k += 1;
        }
    }
}

/// Derivative of `I_frame - gain * I_keyframe - bias` by the left twist of the pose, the logarithm of the
/// gain, and the bias; at the normalised image position `[x, y]` with the gradient `[gx, gy]` there, for a
/// point at the inverse depth `inv_z` in the frame. Of one point, or of several side by side; `one` is 1.
#[inline]
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

    /// Residual, weight and Jacobian of up to [`LANES`] points: from the first one on, every `stride`-th.
    ///
    /// `[ECCV14]` equations 11 to 14; with the direction `m` (z = 1) and inverse depth `d` of a
    /// point, `q = R m + t d` is its position in the frame times `d`.
    #[inline]
    fn chunk(
        &self,
        reference: &ReferenceLevel,
        target: &TargetLevel,
        weighting: &Weighting,
        chunk: (usize, usize),
        sums: &mut Sums,
    ) -> Lanes {
        let [fx, fy, cx, cy] = target.intrinsics;
        let (r, t) = (&self.r, &self.t);
        let (mx, my) = (taken(&reference.x, chunk), taken(&reference.y, chunk));
        let d = taken(&reference.idepth, chunk);
        // one by one: vectors that a closure gives back go through memory
        let q = |i: usize| r[i][0] * mx + r[i][1] * my + r[i][2] + t[i] * d;
        let (qx, qy, qz) = (q(0), q(1), q(2));
        let inv_qz = 1.0 / qz;
        let (x, y) = (qx * inv_qz, qy * inv_qz);
        let (u, v) = (fx * x + cx, fy * y + cy);
        let visible = qz.simd_gt(f32x8::splat(0.01)) & target.contains_lanes(u, v);
        let (x, y, d, inv_qz) = (visible & x, visible & y, visible & d, visible & inv_qz);
        let [intensity, gu, gv] = target.sample_lanes(u, v, visible);
        let keyframe = visible & taken(&reference.intensity, chunk);
        let scaled_reference = self.gain * keyframe;
        let residual = intensity - scaled_reference - self.bias;
        let (gx, gy) = (fx * gu, fy * gv);
        // derivative by the inverse depth, for the variance of the residual
        let by_idepth = (gx * (t[0] - x * t[2]) + gy * (t[1] - y * t[2])) * inv_qz;
        let idepth_var = visible & taken(&reference.idepth_var, chunk);
        let variance = weighting.intensity_var + by_idepth * by_idepth * idepth_var;
        let normalised_sq = residual * residual / variance;
        let (robust_weight, cost) = weighting.robust_weight(normalised_sq);
        let good_sq = weighting.good_sq + weighting.good_gradient_sq * (gu * gu + gv * gv);
        let residual_sq = residual * residual;
        let is_good = visible & residual_sq.simd_lt(good_sq);
        sums.num_visible += visible.to_bitmask().count_ones() as usize;
        sums.num_good += is_good.to_bitmask().count_ones() as usize;
        sums.cost += weighting.chunk_cost(visible, cost);
        sums.add(
            [keyframe, intensity],
            // depth ratio keyframe / frame is 1 / qz
            inv_qz.fast_min(f32x8::ONE),
            is_good & residual_sq,
            visible & weighting.scale_term(normalised_sq),
        );
        let inv_z = d * inv_qz;
        Lanes {
            residual,
            weight: visible & (robust_weight / variance),
            jacobian: residual_row([x, y], [gx, gy], inv_z, scaled_reference, f32x8::ONE),
        }
    }
}

/// Values of [`LANES`] points from the first one on, every `stride`-th; where there are no more, no numbers, so that they are nowhere.
#[inline]
pub(crate) fn taken(values: &[f32], (first, stride): (usize, usize)) -> f32x8 {
    let values = &values[first..];
    match values.first_chunk() {
        Some(all) if stride == 1 => f32x8::new(*all),
        _ => {
            let mut lanes = [f32::NAN; LANES];
            for (lane, value) in lanes.iter_mut().zip(values.iter().step_by(stride)) {
                *lane = *value;
            }
            f32x8::new(lanes)
        }
    }
}

impl Sums {
    /// Adds point after point, in their order, but all sums side by side; what does not count is 0.
    #[inline(always)]
    fn add(&mut self, grey: [f32x8; 2], usage: f32x8, good_sq: f32x8, scale: f32x8) {
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
    /// Weights for squared normalised residuals, and their costs: a summand (Huber) or a factor under the
    /// logarithm (Student t), see [`Self::chunk_cost`].
    #[inline]
    fn robust_weight(&self, normalised_sq: f32x8) -> (f32x8, f32x8) {
        match self.robust {
            Robust::Huber { k } => {
                let magnitude = normalised_sq.sqrt();
                let is_small = magnitude.simd_le(f32x8::splat(k));
                (
                    is_small.bitselect(f32x8::ONE, k / magnitude),
                    is_small.bitselect(normalised_sq, k * (2.0 * magnitude - k)),
                )
            }
            Robust::StudentT { nu } => {
                let inv_scale_sq = 1.0 / (self.scale * self.scale);
                let ratio = normalised_sq * inv_scale_sq / nu;
                // weight (nu + 1) / (nu + (r/s)^2) / s^2; its integral is (nu + 1) ln(1 + (r/s)^2/nu)
                ((nu + 1.0) / nu * inv_scale_sq / (1.0 + ratio), 1.0 + ratio)
            }
        }
    }

    /// Cost of the visible points of a chunk: one logarithm of the product instead of one for each of them.
    #[inline]
    fn chunk_cost(&self, visible: f32x8, cost: f32x8) -> f64 {
        let costs = |neutral| visible.bitselect(cost, neutral).to_array().map(f64::from);
        match self.robust {
            Robust::Huber { .. } => costs(f32x8::ZERO).into_iter().sum(),
            Robust::StudentT { nu } => {
                let product: f64 = costs(f32x8::ONE).into_iter().product();
                f64::from(nu + 1.0) * product.ln()
            }
        }
    }

    /// Summand of the fixed-point iteration for the scale of the t distribution (`[DVO13]`).
    #[inline]
    fn scale_term(&self, normalised_sq: f32x8) -> f32x8 {
        match self.robust {
            Robust::Huber { .. } => f32x8::ZERO,
            Robust::StudentT { nu } => {
                normalised_sq * (nu + 1.0) / (nu + normalised_sq / (self.scale * self.scale))
            }
        }
    }
}
