//! The normal equations of one level over similarity, gain and bias.

use super::DepthLevel;
use crate::kernel::residual_row;
use crate::{ReferenceLevel, Robust, TargetLevel};
use monogrid_geometry::{Mat7, Sim3, Vec7};
use nalgebra::{SMatrix, SVector};

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

/// Points that are worked on side by side.
const LANES: usize = 8;
/// Points summed in `f32` before the sums move to `f64`.
const BLOCK: usize = 1024;
/// Unknowns on which the photometric residual depends: all but the scale.
const PHOTOMETRIC: [usize; 8] = [0, 1, 2, 3, 4, 5, 7, 8];
/// Unknowns on which the depth residual depends: v along the axis, w across it, scale.
const DEPTH: [usize; 4] = [2, 3, 4, 6];

/// Residuals of one kind of a chunk of points, with weights and derivatives by `N` unknowns.
struct Lanes<const N: usize> {
    residual: [f32; LANES],
    weight: [f32; LANES],
    jacobian: [[f32; LANES]; N],
}

impl<const N: usize> Lanes<N> {
    const EMPTY: Self = Self {
        residual: [0.0; LANES],
        weight: [0.0; LANES],
        jacobian: [[0.0; LANES]; N],
    };

    fn set(&mut self, lane: usize, residual: f32, weight: f32, row: [f32; N]) {
        self.residual[lane] = residual;
        self.weight[lane] = weight;
        for (values, value) in self.jacobian.iter_mut().zip(row) {
            values[lane] = value;
        }
    }
}

/// Sums of `w J^T J` and `w J^T r` of one kind; lanes stay apart, so that the loops vectorise and the
/// order of the sums is the same on every machine.
struct BlockSums<const N: usize> {
    hessian: [[[f32; LANES]; N]; N],
    gradient: [[f32; LANES]; N],
}

impl<const N: usize> BlockSums<N> {
    const ZERO: Self = Self {
        hessian: [[[0.0; LANES]; N]; N],
        gradient: [[0.0; LANES]; N],
    };

    #[inline]
    fn add(&mut self, lanes: &Lanes<N>) {
        for row in 0..N {
            let derivative = &lanes.jacobian[row];
            let weighted: [f32; LANES] = std::array::from_fn(|l| lanes.weight[l] * derivative[l]);
            add_products(&mut self.gradient[row], &weighted, &lanes.residual);
            for column in row..N {
                let sums = &mut self.hessian[row][column];
                add_products(sums, &weighted, &lanes.jacobian[column]);
            }
        }
    }

    /// Moves the sums to the equations of all unknowns.
    fn flush(&mut self, unknowns: [usize; N], out: &mut SimilarityLinearization) {
        let total = |lanes: &[f32; LANES]| lanes.iter().map(|x| f64::from(*x)).sum::<f64>();
        for (row, &i) in unknowns.iter().enumerate() {
            out.gradient[i] += total(&self.gradient[row]);
            for (column, &j) in unknowns.iter().enumerate().skip(row) {
                out.hessian[(i, j)] += total(&self.hessian[row][column]);
            }
        }
        *self = Self::ZERO;
    }
}

#[inline]
fn add_products(sums: &mut [f32; LANES], a: &[f32; LANES], b: &[f32; LANES]) {
    for ((sum, a), b) in sums.iter_mut().zip(a).zip(b) {
        *sum += a * b;
    }
}

/// Both residuals of a point with their derivatives.
struct PointResiduals {
    photometric: f32,
    photometric_var: f32,
    photometric_row: [f32; 8],
    /// Residual, variance, row.
    depth: Option<(f32, f32, [f32; 4])>,
    intensities: [f32; 2],
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
            let (mut p, mut d) = (Lanes::EMPTY, Lanes::EMPTY);
            let mut cost = ChunkCost::default();
            for (lane, i) in (start..(start + LANES).min(block_end)).enumerate() {
                let found = projection.residuals(points, i * stride, image, depth, weighting);
                if let Some(residuals) = found {
                    let lanes = (&mut p, &mut d, lane);
                    weigh_point(&residuals, weighting, lanes, &mut cost, &mut out);
                }
            }
            out.cost += cost.total(weighting.robust);
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

/// Gives a point the joint weight of its residuals (`[ECCV14]` equation 18).
#[inline]
fn weigh_point(
    point: &PointResiduals,
    weighting: &SimilarityWeighting,
    (photometric, geometric, lane): (&mut Lanes<8>, &mut Lanes<4>, usize),
    cost: &mut ChunkCost,
    out: &mut SimilarityLinearization,
) {
    let [scale_p, scale_d] = weighting.scale.map(|s| s * s);
    let photometric_sq = point.photometric * point.photometric / point.photometric_var;
    let depth_sq = point
        .depth
        .map_or(0.0, |(residual, var, _)| residual * residual / var);
    let joint_sq = photometric_sq / scale_p + depth_sq / scale_d;
    let weight = cost.add(weighting.robust, joint_sq, point.depth.is_some());
    out.num_visible += 1;
    out.num_good += usize::from(photometric_sq < 9.0);
    out.scale_sums[0] += f64::from(weight * photometric_sq);
    photometric.set(
        lane,
        point.photometric,
        weight / (point.photometric_var * scale_p),
        point.photometric_row,
    );
    if let Some((residual, var, row)) = point.depth {
        out.num_depth += 1;
        out.scale_sums[1] += f64::from(weight * depth_sq);
        geometric.set(lane, residual, weight / (var * scale_d), row);
    }
    let [a, b] = point.intensities.map(f64::from);
    for (sum, value) in out.moments.iter_mut().zip([a, b, a * a, b * b, a * b]) {
        *sum += value;
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
    /// Adds a squared normalised residual; returns its weight.
    #[inline]
    fn add(&mut self, robust: Robust, squared: f32, has_depth: bool) -> f32 {
        match robust {
            Robust::Huber { k } => {
                let magnitude = squared.sqrt();
                if magnitude <= k {
                    self.sum += f64::from(squared);
                    1.0
                } else {
                    self.sum += f64::from(k * (2.0 * magnitude - k));
                    k / magnitude
                }
            }
            Robust::StudentT { nu } => {
                self.products[usize::from(has_depth)] *= f64::from(1.0 + squared / nu);
                let dimension = if has_depth { 2.0 } else { 1.0 };
                (nu + dimension) / (nu + squared)
            }
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
        i: usize,
        image: &TargetLevel,
        depth: &DepthLevel,
        weighting: &SimilarityWeighting,
    ) -> Option<PointResiduals> {
        let (r, t) = (&self.r, &self.t);
        let (mx, my, d) = (points.x[i], points.y[i], points.idepth[i]);
        let q: [f32; 3] = std::array::from_fn(|k| r[k][0] * mx + r[k][1] * my + r[k][2] + t[k] * d);
        if q[2] <= 0.01 || d <= 0.0 {
            return None;
        }
        let [fx, fy, cx, cy] = image.intrinsics;
        let inv_qz = 1.0 / q[2];
        let (x, y) = (q[0] * inv_qz, q[1] * inv_qz);
        let (u, v) = (fx * x + cx, fy * y + cy);
        if !image.contains(u, v) {
            return None;
        }
        let [intensity, gu, gv] = image.sample(u, v);
        let scaled = self.gain * points.intensity[i];
        let (gx, gy) = (fx * gu, fy * gv);
        let inv_z = d * inv_qz;
        let by_idepth = (gx * (t[0] - x * t[2]) + gy * (t[1] - y * t[2])) * inv_qz;
        let var_a = points.idepth_var[i];
        Some(PointResiduals {
            photometric: intensity - scaled - self.bias,
            photometric_var: weighting.intensity_var + by_idepth * by_idepth * var_a,
            // no scale: its change moves the point along its viewing ray
            photometric_row: residual_row([x, y], [gx, gy], inv_z, scaled),
            depth: depth.nearest(u, v).map(|(idepth_b, var_b)| {
                let transfer = (q[2] - d * t[2]) * inv_qz * inv_qz;
                let shared = weighting.shared_depth_var * inv_z * inv_z;
                let row = [-inv_z * inv_z, -inv_z * y, inv_z * x, -inv_z];
                let var = var_b + transfer * transfer * var_a + shared;
                (inv_z - idepth_b, var, row)
            }),
            intensities: [points.intensity[i], intensity],
        })
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
