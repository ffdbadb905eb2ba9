//! The normal equations of one level over similarity, gain and bias.

use super::DepthLevel;
use crate::damping::MIN_DEPTH_RATIO;
use crate::kernel::{Eight, by_idepth, huber, position_times_idepth, residual_row, taken};
use crate::{ReferenceLevel, Robust, TargetLevel};
use monogrid_geometry::{Mat7, Sim3, Vec7};
use monogrid_image::for_lanes;
use monogrid_image::lanes::{F32x8, LANES, Lanes};
use nalgebra::{SMatrix, SVector};
use std::ops::Range;

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
#[derive(Clone, Debug, PartialEq)]
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

    /// Logarithm of the gain and bias that give the visible points of a the mean and contrast that
    /// b has there.
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

/// Residuals of one kind of [`LANES`] points, with weights and derivatives by `N` unknowns; without
/// weight where there is none.
struct Weighted<V, const N: usize> {
    residual: V,
    weight: V,
    jacobian: [V; N],
}

/// Sums of `w J^T J` and `w J^T r` of one kind; lanes stay apart, so that the order of the sums is
/// the same on every machine.
struct Equations<V, const N: usize> {
    hessian: [[V; N]; N],
    gradient: [V; N],
}

impl<V: F32x8, const N: usize> Equations<V, N> {
    #[inline(always)]
    fn zero<L: Lanes<F32 = V>>(lanes: L) -> Self {
        let zero = lanes.splat(0.0);
        Self {
            hessian: [[zero; N]; N],
            gradient: [zero; N],
        }
    }

    #[inline(always)]
    fn add(&mut self, points: &Weighted<V, N>) {
        for row in 0..N {
            let weighted = points.weight * points.jacobian[row];
            self.gradient[row] += weighted * points.residual;
            for column in row..N {
                self.hessian[row][column] += weighted * points.jacobian[column];
            }
        }
    }

    #[inline(always)]
    fn by_lane(&self) -> Equations<Eight, N> {
        let mut out = Equations {
            hessian: [[[0.0; LANES]; N]; N],
            gradient: [[0.0; LANES]; N],
        };
        for row in 0..N {
            out.gradient[row] = self.gradient[row].to_array();
            for column in row..N {
                out.hessian[row][column] = self.hessian[row][column].to_array();
            }
        }
        out
    }
}

impl<const N: usize> Equations<Eight, N> {
    /// Adds the sums to the equations of all unknowns.
    fn add_to(&self, unknowns: [usize; N], out: &mut SimilarityLinearization) {
        let total = |lanes: &Eight| lanes.iter().copied().map(f64::from).sum::<f64>();
        for (row, &i) in unknowns.iter().enumerate() {
            out.gradient[i] += total(&self.gradient[row]);
            for (column, &j) in unknowns.iter().enumerate().skip(row) {
                out.hessian[(i, j)] += total(&self.hessian[row][column]);
            }
        }
    }
}

/// Both residuals of [`LANES`] points with their derivatives.
struct Residuals<V> {
    visible: V,
    photometric: V,
    photometric_var: V,
    photometric_row: [V; 8],
    /// Visible points that meet a depth.
    has_depth: V,
    depth: V,
    depth_var: V,
    depth_row: [V; 4],
    intensities: [V; 2],
}

/// Builds the normal equations of `points` (of a) against image and depth of b. `stride` uses every
/// n-th point only.
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
    let keyframes = (points, image, depth);
    for start in (0..count).step_by(BLOCK) {
        let range = start..(start + BLOCK).min(count);
        add_block(&projection, keyframes, weighting, (range, stride), &mut out);
    }
    for row in 0..UNKNOWNS {
        for column in 0..row {
            out.hessian[(row, column)] = out.hessian[(column, row)];
        }
    }
    out
}

for_lanes! {
    /// Adds some of the points of a, every n-th, as image and depth of b show them.
    fn add_block = add_block_with, (
        projection: &Projection,
        keyframes: (&ReferenceLevel, &TargetLevel, &DepthLevel),
        weighting: &SimilarityWeighting,
        range: (Range<usize>, usize),
        out: &mut SimilarityLinearization,
    );
}

#[inline(always)]
fn add_block_with<L: Lanes>(
    lanes: L,
    projection: &Projection,
    keyframes: (&ReferenceLevel, &TargetLevel, &DepthLevel),
    weighting: &SimilarityWeighting,
    (range, stride): (Range<usize>, usize),
    out: &mut SimilarityLinearization,
) {
    let mut photometric = Equations::<_, 8>::zero(lanes);
    let mut geometric = Equations::<_, 4>::zero(lanes);
    for start in range.step_by(LANES) {
        let chunk = (start * stride, stride);
        let residuals = projection.residuals(lanes, chunk, keyframes, weighting);
        let (p, d) = weigh(lanes, &residuals, weighting, out);
        photometric.add(&p);
        geometric.add(&d);
    }
    photometric.by_lane().add_to(PHOTOMETRIC, out);
    geometric.by_lane().add_to(DEPTH, out);
}

/// Gives points the joint weight of their residuals (`[LSD14]` equation 18).
#[inline(always)]
fn weigh<L: Lanes>(
    lanes: L,
    points: &Residuals<L::F32>,
    weighting: &SimilarityWeighting,
    out: &mut SimilarityLinearization,
) -> (Weighted<L::F32, 8>, Weighted<L::F32, 4>) {
    let [scale_p, scale_d] = weighting.scale.map(|s| s * s);
    let photometric_sq = points.photometric * points.photometric / points.photometric_var;
    let depth_sq = points.has_depth & (points.depth * points.depth / points.depth_var);
    let joint_sq = photometric_sq / scale_p + depth_sq / scale_d;
    let (weight, cost) = robust_weight(lanes, weighting.robust, joint_sq, points.has_depth);
    let (visible, has_depth) = (points.visible.bits(), points.has_depth.bits());
    let good = points.visible & photometric_sq.lt(lanes.splat(9.0));
    out.num_visible += visible.count_ones() as usize;
    out.num_depth += has_depth.count_ones() as usize;
    out.num_good += good.bits().count_ones() as usize;
    let [own, other] = points.intensities;
    let by_scale = [
        (weight * photometric_sq).to_array(),
        (weight * depth_sq).to_array(),
    ];
    let grey = [own.to_array(), other.to_array()];
    let cost = cost.to_array();
    let mut chunk_cost = ChunkCost::default();
    for l in (0..LANES).filter(|l| visible >> l & 1 == 1) {
        let has_depth = has_depth >> l & 1 == 1;
        chunk_cost.add(weighting.robust, cost[l], has_depth);
        // 0 without depth
        let by_scale = [by_scale[0][l], by_scale[1][l]].map(f64::from);
        let [a, b] = [grey[0][l], grey[1][l]].map(f64::from);
        for (sum, value) in out.scale_sums.iter_mut().zip(by_scale) {
            *sum += value;
        }
        for (sum, value) in out.moments.iter_mut().zip([a, b, a * a, b * b, a * b]) {
            *sum += value;
        }
    }
    out.cost += chunk_cost.total(weighting.robust);
    let photometric = Weighted {
        residual: points.photometric,
        weight: points.visible & (weight / (points.photometric_var * scale_p)),
        jacobian: points.photometric_row,
    };
    let depth = Weighted {
        residual: points.depth,
        weight: points.has_depth & (weight / (points.depth_var * scale_d)),
        jacobian: points.depth_row,
    };
    (photometric, depth)
}

/// Weights for squared normalised residuals, and their costs: summands (Huber) or factors under the
/// logarithm (Student t).
#[inline(always)]
fn robust_weight<L: Lanes>(
    lanes: L,
    robust: Robust,
    squared: L::F32,
    has_depth: L::F32,
) -> (L::F32, L::F32) {
    match robust {
        Robust::Huber { k } => huber(lanes, k, squared),
        Robust::StudentT { nu } => {
            let one = lanes.splat(1.0);
            let dimension = one + (has_depth & one);
            ((dimension + nu) / (squared + nu), squared / nu + 1.0)
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

    /// With `m` the viewing direction and `d` the inverse depth, `q = s R m + t d` is the position
    /// in b times `d`.
    #[inline(always)]
    fn residuals<L: Lanes>(
        &self,
        lanes: L,
        chunk: (usize, usize),
        (points, image, depth): (&ReferenceLevel, &TargetLevel, &DepthLevel),
        weighting: &SimilarityWeighting,
    ) -> Residuals<L::F32> {
        let (t, one, zero) = (&self.t, lanes.splat(1.0), lanes.splat(0.0));
        let of = |values: &[f32]| taken(lanes, values, chunk);
        let (mx, my, d) = (of(&points.x), of(&points.y), of(&points.idepth));
        let [qx, qy, qz] = position_times_idepth((&self.r, t), [mx, my], d);
        let [fx, fy, cx, cy] = image.intrinsics;
        let inv_qz = one / qz;
        let (x, y) = (qx * inv_qz, qy * inv_qz);
        let (u, v) = (x * fx + cx, y * fy + cy);
        let in_front = qz.gt(lanes.splat(MIN_DEPTH_RATIO)) & d.gt(zero);
        let visible = in_front & image.contains_lanes(lanes, u, v);
        let (x, y, d) = (visible & x, visible & y, visible & d);
        let (qz, inv_qz) = (visible & qz, visible & inv_qz);
        let [intensity, gu, gv] = image.sample_lanes(lanes, u, v, visible);
        let own = visible & of(&points.intensity);
        let scaled = own * self.gain;
        let (gx, gy) = (gu * fx, gv * fy);
        let inv_z = d * inv_qz;
        let by_idepth = by_idepth(lanes, t, [x, y], [gx, gy], inv_qz);
        let var_a = visible & of(&points.idepth_var);
        let [idepth_b, var_b] = depth.nearest_lanes(lanes, u, v, visible);
        let transfer = (qz - d * t[2]) * inv_qz * inv_qz;
        let shared = inv_z * weighting.shared_depth_var * inv_z;
        Residuals {
            visible,
            photometric: intensity - scaled - self.bias,
            photometric_var: by_idepth * by_idepth * var_a + weighting.intensity_var,
            // no scale: its change moves the point along its viewing ray
            photometric_row: residual_row([x, y], [gx, gy], inv_z, scaled, one),
            has_depth: var_b.gt(zero),
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::KeyframeView;
    use crate::test_points::textured;
    use monogrid_geometry::{Rotation, Vec3};
    use monogrid_image::lanes::Baseline;

    #[test]
    fn all_vectors_give_the_same_bits() {
        let (pyramid, camera, samples) = textured();
        let view = KeyframeView::new(&pyramid, &camera, &samples, 0, 0);
        let turned = Rotation::from_euler_angles(0.01, 0.02, -0.03);
        let state = SimilarityState::new(Sim3::new(1.05, turned, Vec3::new(0.03, -0.02, 0.05)));
        let projection = Projection::new(&state);
        let keyframes = (
            &view.reference.levels[0],
            &view.target.levels[0],
            &view.depth[0],
        );
        for robust in [Robust::Huber { k: 1.3 }, Robust::StudentT { nu: 5.0 }] {
            let weighting = SimilarityWeighting {
                intensity_var: 16.0,
                shared_depth_var: 1e-4,
                robust,
                scale: [1.7, 1.2],
            };
            for stride in [1, 3] {
                let range = (0..keyframes.0.len().div_ceil(stride), stride);
                let (mut widest, mut plain) = (
                    SimilarityLinearization::zero(),
                    SimilarityLinearization::zero(),
                );
                add_block(
                    &projection,
                    keyframes,
                    &weighting,
                    range.clone(),
                    &mut widest,
                );
                add_block_with(
                    Baseline,
                    &projection,
                    keyframes,
                    &weighting,
                    range,
                    &mut plain,
                );
                assert!(plain.num_visible > 200 && plain.num_depth > 50, "{plain:?}");
                assert_eq!(widest, plain);
            }
        }
    }
}
