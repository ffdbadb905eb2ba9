//! The normal equations of one level over similarity, gain and bias.

use super::DepthLevel;
use crate::kernel::{LANES, residual_row, taken};
use crate::{ReferenceLevel, Robust, TargetLevel};
use monogrid_geometry::{Mat7, Sim3, Vec7};
use nalgebra::{SMatrix, SVector};
use wide::f32x8;

/// Unknowns: tangent `[v, w, s]` of `b_from_a`, logarithm of the gain, bias.
pub(crate) const UNKNOWNS: usize = 9;

/// The state that is estimated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimilarityState {
    /// Maps points of keyframe a (its units) to keyframe b (its units).
    pub b_from_a: Sim3,
    /// Logarithm of the gain in `I_b = gain * I_a + bias`.
    pub log_gain: f64,
    /// Bias, grey levels.
    pub bias: f64,
}

/// How the residuals are normalised and weighted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimilarityWeighting {
    /// Variance of the image noise, grey levels squared.
    pub intensity_var: f32,
    /// Squared relative error of inverse depth that neighbours share.
    pub shared_depth_var: f32,
    /// Robust function of both residuals of a point.
    pub robust: Robust,
    /// Scales of the normalised photometric and depth residuals (Student t only; 1 for Huber).
    pub scale: [f32; 2],
}

/// Sums over all points of a level at one state.
#[derive(Clone, Debug)]
pub struct SimilarityLinearization {
    /// Sum of `w J^T J`.
    pub hessian: SMatrix<f64, UNKNOWNS, UNKNOWNS>,
    /// Sum of `w J^T r`.
    pub gradient: SVector<f64, UNKNOWNS>,
    /// Sum of the robust cost.
    pub cost: f64,
    /// Points that project into the other keyframe.
    pub num_visible: usize,
    /// Visible points that meet a depth there.
    pub num_depth: usize,
    /// Visible points with a photometric residual within three standard deviations.
    pub num_good: usize,
    /// Sums for the next estimate of both scales.
    pub scale_sums: [f64; 2],
    /// Sums over visible points of `[I_a, I_b, I_a^2, I_b^2, I_a I_b]`.
    pub moments: [f64; 5],
}

impl SimilarityLinearization {
    fn zero() -> Self {
        Self {
            hessian: SMatrix::zeros(),
            gradient: SVector::zeros(),
            cost: 0.0,
            num_visible: 0,
            num_depth: 0,
            num_good: 0,
            scale_sums: [0.0; 2],
            moments: [0.0; 5],
        }
    }

    /// Mean robust cost of a residual; infinite when nothing is visible.
    #[must_use]
    pub fn mean_cost(&self) -> f64 {
        if self.num_visible == 0 {
            return f64::INFINITY;
        }
        self.cost / (self.num_visible + self.num_depth) as f64
    }

    /// Correlation of the grey values of the visible points.
    #[must_use]
    pub fn correlation(&self) -> Option<f64> {
        let (_, [var_a, var_b], covariance) = self.second_moments()?;
        Some(covariance / (var_a * var_b).sqrt())
    }

    /// Logarithm of the gain and bias that give the visible points of a the mean and contrast that b has
    /// there.
    #[must_use]
    pub fn matching_brightness(&self) -> Option<(f64, f64)> {
        let ([mean_a, mean_b], [var_a, var_b], _) = self.second_moments()?;
        let gain = (var_b / var_a).sqrt();
        Some((gain.ln(), mean_b - gain * mean_a))
    }

    /// Means, variances and covariance of the grey values of the visible points in a and b.
    fn second_moments(&self) -> Option<([f64; 2], [f64; 2], f64)> {
        let n = self.num_visible as f64;
        let [a, b, aa, bb, ab] = self.moments.map(|sum| sum / n);
        let (var_a, var_b) = (aa - a * a, bb - b * b);
        (n > 8.0 && var_a > 1.0 && var_b > 1.0).then_some(([a, b], [var_a, var_b], ab - a * b))
    }

    /// Information of the similarity alone, with gain and bias marginalised out.
    #[must_use]
    pub fn similarity_information(&self) -> Option<Mat7> {
        let h = &self.hessian;
        let brightness = h.fixed_view::<2, 2>(7, 7).into_owned();
        let cross = h.fixed_view::<7, 2>(0, 7).into_owned();
        let inverse = (brightness + nalgebra::Matrix2::identity() * 1e-9).try_inverse()?;
        let own = h.fixed_view::<7, 7>(0, 0).into_owned();
        Some(own - cross * inverse * cross.transpose())
    }
}

/// Points summed in `f32` before the sums move to `f64`.
const BLOCK: usize = 1024;
/// Unknowns on which the photometric residual depends: all but the scale.
const PHOTOMETRIC: [usize; 8] = [0, 1, 2, 3, 4, 5, 7, 8];
/// Unknowns on which the depth residual depends: v along the axis, w across it, scale.
const DEPTH: [usize; 4] = [2, 3, 4, 6];

/// Residuals of one kind of [`LANES`] points, with weights and derivatives by `N` unknowns; without weight where there is none.
struct Lanes<const N: usize> {
    residual: f32x8,
    weight: f32x8,
    jacobian: [f32x8; N],
}

/// Sums of `w J^T J` and `w J^T r` of one kind; lanes stay apart, so that the order of the sums is the same on every machine.
struct BlockSums<const N: usize> {
    hessian: [[f32x8; N]; N],
    gradient: [f32x8; N],
}

impl<const N: usize> BlockSums<N> {
    const ZERO: Self = Self {
        hessian: [[f32x8::ZERO; N]; N],
        gradient: [f32x8::ZERO; N],
    };

    #[inline]
    fn add(&mut self, lanes: &Lanes<N>) {
        for row in 0..N {
            let weighted = lanes.weight * lanes.jacobian[row];
            self.gradient[row] += weighted * lanes.residual;
            for column in row..N {
                self.hessian[row][column] += weighted * lanes.jacobian[column];
            }
        }
    }

    /// Moves the sums to the equations of all unknowns.
    fn flush(&mut self, unknowns: [usize; N], out: &mut SimilarityLinearization) {
        let total = |lanes: &f32x8| lanes.to_array().into_iter().map(f64::from).sum::<f64>();
        for (row, &i) in unknowns.iter().enumerate() {
            out.gradient[i] += total(&self.gradient[row]);
            for (column, &j) in unknowns.iter().enumerate().skip(row) {
                out.hessian[(i, j)] += total(&self.hessian[row][column]);
            }
        }
        *self = Self::ZERO;
    }
}

/// Both residuals of [`LANES`] points with their derivatives.
struct Residuals {
    visible: f32x8,
    photometric: f32x8,
    photometric_var: f32x8,
    photometric_row: [f32x8; 8],
    /// Visible points that meet a depth.
    has_depth: f32x8,
    depth: f32x8,
    depth_var: f32x8,
    depth_row: [f32x8; 4],
    intensities: [f32x8; 2],
}

/// Builds the normal equations of `points` (of a) against image and depth of b. `stride` uses every n-th
/// point only.
#[must_use]
pub fn linearize_similarity(
    points: &ReferenceLevel,
    image: &TargetLevel,
    depth: &DepthLevel,
    state: &SimilarityState,
    weighting: &SimilarityWeighting,
    stride: usize,
) -> SimilarityLinearization {
    let projection = Projection::new(state);
    let mut out = SimilarityLinearization::zero();
    let stride = stride.max(1);
    let count = points.len().div_ceil(stride);
    let (mut photometric, mut geometric) = (BlockSums::<8>::ZERO, BlockSums::<4>::ZERO);
    for block in (0..count).step_by(BLOCK) {
        let block_end = (block + BLOCK).min(count);
        for start in (block..block_end).step_by(LANES) {
            let chunk = (start * stride, stride);
            let residuals = projection.residuals(points, chunk, image, depth, weighting);
            let (p, d) = weigh(&residuals, weighting, &mut out);
            photometric.add(&p);
            geometric.add(&d);
        }
        photometric.flush(PHOTOMETRIC, &mut out);
        geometric.flush(DEPTH, &mut out);
    }
    for row in 0..UNKNOWNS {
        for column in 0..row {
            out.hessian[(row, column)] = out.hessian[(column, row)];
        }
    }
    out
}

/// Gives points the joint weight of their residuals (`[ECCV14]` equation 18).
#[inline]
fn weigh(
    points: &Residuals,
    weighting: &SimilarityWeighting,
    out: &mut SimilarityLinearization,
) -> (Lanes<8>, Lanes<4>) {
    let [scale_p, scale_d] = weighting.scale.map(|s| s * s);
    let photometric_sq = points.photometric * points.photometric / points.photometric_var;
    let depth_sq = points.has_depth & (points.depth * points.depth / points.depth_var);
    let joint_sq = photometric_sq / scale_p + depth_sq / scale_d;
    let (weight, cost) = robust_weight(weighting.robust, joint_sq, points.has_depth);
    let (visible, has_depth) = (points.visible.to_bitmask(), points.has_depth.to_bitmask());
    let good = points.visible & photometric_sq.simd_lt(f32x8::splat(9.0));
    out.num_visible += visible.count_ones() as usize;
    out.num_depth += has_depth.count_ones() as usize;
    out.num_good += good.to_bitmask().count_ones() as usize;
    let by_scale = [photometric_sq, depth_sq].map(|squared| (weight * squared).to_array());
    let [a, b] = points.intensities.map(f32x8::to_array);
    let cost = cost.to_array();
    let mut chunk_cost = ChunkCost::default();
    for l in (0..LANES).filter(|l| visible >> l & 1 == 1) {
        let has_depth = has_depth >> l & 1 == 1;
        chunk_cost.add(weighting.robust, cost[l], has_depth);
        // 0 without depth
        let by_scale = [by_scale[0][l], by_scale[1][l]].map(f64::from);
        let [a, b] = [a[l], b[l]].map(f64::from);
        for (sum, value) in out.scale_sums.iter_mut().zip(by_scale) {
            *sum += value;
        }
        for (sum, value) in out.moments.iter_mut().zip([a, b, a * a, b * b, a * b]) {
            *sum += value;
        }
    }
    out.cost += chunk_cost.total(weighting.robust);
    let photometric = Lanes {
        residual: points.photometric,
        weight: points.visible & (weight / (points.photometric_var * scale_p)),
        jacobian: points.photometric_row,
    };
    let depth = Lanes {
        residual: points.depth,
        weight: points.has_depth & (weight / (points.depth_var * scale_d)),
        jacobian: points.depth_row,
    };
    (photometric, depth)
}

/// Weights for squared normalised residuals, and their costs: summands (Huber) or factors under the logarithm (Student t).
#[inline]
fn robust_weight(robust: Robust, squared: f32x8, has_depth: f32x8) -> (f32x8, f32x8) {
    match robust {
        Robust::Huber { k } => {
            let magnitude = squared.sqrt();
            let is_small = magnitude.simd_le(f32x8::splat(k));
            (
                is_small.bitselect(f32x8::ONE, k / magnitude),
                is_small.bitselect(squared, k * (2.0 * magnitude - k)),
            )
        }
        Robust::StudentT { nu } => {
            let dimension = f32x8::ONE + (has_depth & f32x8::ONE);
            ((nu + dimension) / (nu + squared), 1.0 + squared / nu)
        }
    }
}

/// Cost of a chunk of points: one logarithm of a product instead of one for each point.
struct ChunkCost {
    sum: f64,
    /// Products of `1 + s / nu` of the points with one and with two residuals.
    products: [f64; 2],
}

impl Default for ChunkCost {
    fn default() -> Self {
        Self {
            sum: 0.0,
            products: [1.0; 2],
        }
    }
}

impl ChunkCost {
    /// Adds the cost of a point as [`robust_weight`] gives it.
    #[inline]
    fn add(&mut self, robust: Robust, cost: f32, has_depth: bool) {
        match robust {
            Robust::Huber { .. } => self.sum += f64::from(cost),
            Robust::StudentT { .. } => self.products[usize::from(has_depth)] *= f64::from(cost),
        }
    }

    fn total(&self, robust: Robust) -> f64 {
        match robust {
            Robust::Huber { .. } => self.sum,
            Robust::StudentT { nu } => {
                let nu = f64::from(nu);
                (nu + 1.0) * self.products[0].ln() + (nu + 2.0) * self.products[1].ln()
            }
        }
    }
}

/// The state in single precision.
struct Projection {
    /// Scale times rotation.
    r: [[f32; 3]; 3],
    t: [f32; 3],
    gain: f32,
    bias: f32,
}

impl Projection {
    fn new(state: &SimilarityState) -> Self {
        let r = state.b_from_a.rotation.to_rotation_matrix().into_inner() * state.b_from_a.scale;
        let t = &state.b_from_a.translation;
        Self {
            r: std::array::from_fn(|i| std::array::from_fn(|j| r[(i, j)] as f32)),
            t: [t.x as f32, t.y as f32, t.z as f32],
            gain: state.log_gain.exp() as f32,
            bias: state.bias as f32,
        }
    }

    /// With `m` the viewing direction and `d` the inverse depth, `q = s R m + t d` is the position in b
    /// times `d`.
    #[inline]
    fn residuals(
        &self,
        points: &ReferenceLevel,
        chunk: (usize, usize),
        image: &TargetLevel,
        depth: &DepthLevel,
        weighting: &SimilarityWeighting,
    ) -> Residuals {
        let (r, t) = (&self.r, &self.t);
        let (mx, my) = (taken(&points.x, chunk), taken(&points.y, chunk));
        let d = taken(&points.idepth, chunk);
        // one by one: vectors that a closure gives back go through memory
        let q = |k: usize| r[k][0] * mx + r[k][1] * my + r[k][2] + t[k] * d;
        let q = [q(0), q(1), q(2)];
        let [fx, fy, cx, cy] = image.intrinsics;
        let inv_qz = 1.0 / q[2];
        let (x, y) = (q[0] * inv_qz, q[1] * inv_qz);
        let (u, v) = (fx * x + cx, fy * y + cy);
        let in_front = q[2].simd_gt(f32x8::splat(0.01)) & d.simd_gt(f32x8::ZERO);
        let visible = in_front & image.contains_lanes(u, v);
        let (x, y, d) = (visible & x, visible & y, visible & d);
        let (qz, inv_qz) = (visible & q[2], visible & inv_qz);
        let [intensity, gu, gv] = image.sample_lanes(u, v, visible);
        let own = visible & taken(&points.intensity, chunk);
        let scaled = self.gain * own;
        let (gx, gy) = (fx * gu, fy * gv);
        let inv_z = d * inv_qz;
        let by_idepth = (gx * (t[0] - x * t[2]) + gy * (t[1] - y * t[2])) * inv_qz;
        let var_a = visible & taken(&points.idepth_var, chunk);
        let [idepth_b, var_b] = depth.nearest_lanes(u, v, visible);
        let transfer = (qz - d * t[2]) * inv_qz * inv_qz;
        let shared = weighting.shared_depth_var * inv_z * inv_z;
        Residuals {
            visible,
            photometric: intensity - scaled - self.bias,
            photometric_var: weighting.intensity_var + by_idepth * by_idepth * var_a,
            // no scale: its change moves the point along its viewing ray
            photometric_row: residual_row([x, y], [gx, gy], inv_z, scaled, f32x8::ONE),
            has_depth: var_b.simd_gt(f32x8::ZERO),
            depth: inv_z - idepth_b,
            depth_var: var_b + transfer * transfer * var_a + shared,
            depth_row: [-inv_z * inv_z, -inv_z * y, inv_z * x, -inv_z],
            intensities: [own, intensity],
        }
    }
}

/// Left update of the similarity, additive update of the brightness.
pub(crate) fn apply(state: &SimilarityState, step: &SVector<f64, UNKNOWNS>) -> SimilarityState {
    let tangent = Vec7::from_iterator(step.iter().take(7).copied());
    SimilarityState {
        b_from_a: Sim3::exp(&tangent) * state.b_from_a,
        log_gain: (state.log_gain + step[7]).clamp(-2.0, 2.0),
        bias: state.bias + step[8],
    }
}
