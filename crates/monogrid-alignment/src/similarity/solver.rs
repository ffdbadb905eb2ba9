//! Levenberg-Marquardt over the levels, coarse to fine.

use super::kernel::{UNKNOWNS, apply};
use super::{
    KeyframeView, SimilarityConfig, SimilarityLinearization, SimilarityState, SimilarityWeighting,
    linearize_similarity,
};
use crate::Robust;
use crate::damping::{DIAGONAL_FLOOR, FIRST_LAMBDA, MIN_SCALE_CHANGE, SCALES, less};
use monogrid_geometry::{Mat7, Sim3};
use nalgebra::SVector;

/// Standard deviation of the image noise, grey levels.
const SIGMA_INTENSITY: f32 = 4.0;
/// Largest number of iterations on each level.
const MAX_ITERATIONS: usize = 8;
/// A level has converged when the cost falls by less than this share.
const MIN_COST_DECREASE: f64 = 1e-3;
/// Pixels that count as one independent measurement in the information: neighbours share their
/// noise, their depth's smoothing and the errors of the model.
const PIXELS_PER_MEASUREMENT: f64 = 8.0;

/// Result of an alignment in one direction. Whether it is to be believed is the caller's decision.
#[derive(Clone, Debug)]
pub struct SimilarityAlignment {
    /// The best state found.
    pub state: SimilarityState,
    /// Information of a left update `[v, w, s]` of `b_from_a`, in the units of b, for the
    /// configured number of pixels per independent measurement; `None` when the system is singular.
    pub information: Option<Mat7>,
    /// Points that project into b, of all points of the finest level.
    pub visible_share: f32,
    /// Visible points with a good photometric residual.
    pub good_of_visible: f32,
    /// Visible points that meet a depth in b.
    pub depth_share: f32,
    /// Correlation of the grey values of the visible points.
    pub correlation: Option<f64>,
    /// Iterations over all levels.
    pub iterations: usize,
}

/// Largest step (norm of the tangent) that is believed.
const MAX_STEP: f64 = 1.0;
/// Largest damping after which a level is given up.
const MAX_LAMBDA: f64 = 1e6;

/// Aligns keyframe `a` to keyframe `b` from `initial`, over the levels between `coarsest` and
/// `finest`.
#[must_use]
pub fn align_similarity(
    a: &KeyframeView,
    b: &KeyframeView,
    initial: &SimilarityState,
    (coarsest, finest): (usize, usize),
    config: &SimilarityConfig,
) -> SimilarityAlignment {
    let coarsest = coarsest
        .min(a.reference.coarsest_level())
        .min(b.target.coarsest_level());
    let finest = finest.min(coarsest);
    let mut state = with_plausible_brightness(a, b, coarsest, initial, config);
    let mut scale = None;
    let mut iterations = 0;
    let mut level = coarsest;
    loop {
        let solved = align_level(a, b, level, &state, scale, config);
        state = solved.state;
        scale = Some(solved.scale);
        iterations += solved.iterations;
        if level <= finest {
            return summarise(&solved, iterations);
        }
        level -= 1;
    }
}

/// The given gain and bias, or those that give the visible points of `a` the mean and contrast of
/// what they meet in `b`, whichever cost less: brightness that was handed on over many keyframes
/// drifts as poses do.
fn with_plausible_brightness(
    a: &KeyframeView,
    b: &KeyframeView,
    level: usize,
    initial: &SimilarityState,
    config: &SimilarityConfig,
) -> SimilarityState {
    let weighting = SimilarityWeighting::initial(config);
    let evaluate = |state: &SimilarityState| {
        let (image, depth) = (&b.target.levels[level], &b.depth[level]);
        linearize_similarity(
            &a.reference.levels[level],
            image,
            depth,
            state,
            &weighting,
            1,
        )
    };
    let given = evaluate(initial);
    let Some((log_gain, bias)) = given.matching_brightness() else {
        return *initial;
    };
    let matched = SimilarityState {
        log_gain,
        bias,
        ..*initial
    };
    if evaluate(&matched).mean_cost() < given.mean_cost() {
        matched
    } else {
        *initial
    }
}

struct LevelResult {
    state: SimilarityState,
    linear: SimilarityLinearization,
    num_points: usize,
    iterations: usize,
    scale: [f32; 2],
}

fn align_level(
    a: &KeyframeView,
    b: &KeyframeView,
    level: usize,
    initial: &SimilarityState,
    initial_scale: Option<[f32; 2]>,
    config: &SimilarityConfig,
) -> LevelResult {
    let points = &a.reference.levels[level];
    let stride = match config.max_points {
        0 => 1,
        max => points.len().div_ceil(max).max(1),
    };
    let mut weighting = SimilarityWeighting::initial(config);
    weighting.scale = initial_scale.unwrap_or(weighting.scale);
    let evaluate = |state: &SimilarityState, weighting: &SimilarityWeighting| {
        let (image, depth) = (&b.target.levels[level], &b.depth[level]);
        linearize_similarity(points, image, depth, state, weighting, stride)
    };
    let mut state = *initial;
    let mut linear = evaluate(&state, &weighting);
    for _ in 0..if initial_scale.is_some() { 1 } else { 3 } {
        if update_scale(&mut weighting, &linear) {
            linear = evaluate(&state, &weighting);
        }
    }
    let mut iterations = 0;
    let mut lambda = 0.0;
    while iterations < MAX_ITERATIONS && lambda <= MAX_LAMBDA {
        iterations += 1;
        let step = solve(&linear, lambda).filter(|step| step.rows(0, 7).norm() < MAX_STEP);
        let Some(step) = step else {
            lambda = f64::max(4.0 * lambda, 1e-2);
            continue;
        };
        let candidate = apply(&state, &step);
        let trial = evaluate(&candidate, &weighting);
        let (cost, trial_cost) = (linear.mean_cost(), trial.mean_cost());
        if trial_cost < cost {
            (state, linear) = (candidate, trial);
            lambda = less(lambda);
            if 1.0 - trial_cost / cost < MIN_COST_DECREASE {
                break;
            }
        } else if step.norm_squared() < 1e-10 {
            break;
        } else {
            lambda = f64::max(4.0 * lambda, FIRST_LAMBDA);
        }
    }
    LevelResult {
        state,
        num_points: points.len().div_ceil(stride),
        linear,
        iterations,
        scale: weighting.scale,
    }
}

impl SimilarityWeighting {
    fn initial(config: &SimilarityConfig) -> Self {
        Self {
            intensity_var: SIGMA_INTENSITY.powi(2),
            shared_depth_var: config.shared_depth_sigma.powi(2),
            robust: config.robust,
            scale: [1.0; 2],
        }
    }
}

/// One fixed-point step of the scales of the t distribution; true when one changed noticeably.
fn update_scale(weighting: &mut SimilarityWeighting, linear: &SimilarityLinearization) -> bool {
    if matches!(weighting.robust, Robust::Huber { .. }) {
        return false;
    }
    let counts = [linear.num_visible, linear.num_depth];
    let mut changed = false;
    for ((scale, sum), count) in weighting
        .scale
        .iter_mut()
        .zip(linear.scale_sums)
        .zip(counts)
    {
        if count < 8 {
            continue;
        }
        let new = ((sum / count as f64).sqrt() as f32).clamp(SCALES[0], SCALES[1]);
        changed |= (new / *scale - 1.0).abs() > MIN_SCALE_CHANGE;
        *scale = new;
    }
    changed
}

fn solve(linear: &SimilarityLinearization, lambda: f64) -> Option<SVector<f64, UNKNOWNS>> {
    let mut h = linear.hessian;
    for i in 0..UNKNOWNS {
        h[(i, i)] += lambda * h[(i, i)] + DIAGONAL_FLOOR;
    }
    let step = h.cholesky()?.solve(&-linear.gradient);
    step.iter().all(|x| x.is_finite()).then_some(step)
}

fn summarise(last: &LevelResult, iterations: usize) -> SimilarityAlignment {
    let linear = &last.linear;
    let visible = linear.num_visible.max(1) as f32;
    let information = linear
        .similarity_information()
        .map(|h| h / PIXELS_PER_MEASUREMENT)
        .filter(|h| h.iter().all(|x| x.is_finite()) && h.cholesky().is_some());
    SimilarityAlignment {
        state: last.state,
        information,
        visible_share: linear.num_visible as f32 / last.num_points.max(1) as f32,
        good_of_visible: linear.num_good as f32 / visible,
        depth_share: linear.num_depth as f32 / visible,
        correlation: linear.correlation(),
        iterations,
    }
}

impl SimilarityState {
    /// A similarity without change of brightness.
    #[must_use]
    pub fn new(b_from_a: Sim3) -> Self {
        Self {
            b_from_a,
            log_gain: 0.0,
            bias: 0.0,
        }
    }

    /// The state of the opposite direction.
    #[must_use]
    pub fn inverse(&self) -> Self {
        Self {
            b_from_a: self.b_from_a.inverse(),
            log_gain: -self.log_gain,
            bias: -self.bias * (-self.log_gain).exp(),
        }
    }
}
