//! Levenberg-Marquardt over the levels, coarse to fine.

use crate::damping::{DIAGONAL_FLOOR, FIRST_LAMBDA, MIN_LAMBDA, MIN_SCALE_CHANGE, SCALES, less};
use crate::kernel::UNKNOWNS;
use crate::{AlignmentConfig, Brightness, Linearization, Motion, Reference, Robust, Target};
use crate::{Weighting, linearize};
use monogrid_geometry::{Mat6, Se3, Vec6};
use nalgebra::{SMatrix, SVector};

/// Weight of the ratio of the contrasts of both images in the estimate of the gain, relative to
/// all residuals. Regression alone shrinks the gain of images that are not aligned yet, down to
/// wrong minima in which a flat image explains everything.
const CONTRAST_WEIGHT: f64 = 1.0;
/// A level has converged when the cost falls by less than this share.
const MIN_COST_DECREASE: f64 = 1e-4;
/// A level has converged when the squared norm of the twist falls below this.
const MIN_STEP_SQ: f64 = 1e-10;
/// A residual is good when `r^2 < max_residual^2 + (this * |gradient|)^2`.
const MAX_RESIDUAL_PER_GRADIENT: f32 = 0.5;

/// Which part of the motion may change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Freedom {
    /// Rotation and translation.
    Rigid,
    /// Rotation alone; the translation stays as given.
    Rotation,
}

/// Result of an alignment. Whether it is to be believed is the caller's decision.
#[derive(Clone, Debug)]
pub struct Alignment {
    /// The best motion found.
    pub motion: Motion,
    /// Robust standard deviation of the raw residual of good points, grey levels.
    pub residual_rms: f32,
    /// Mean robust cost of a visible point on the finest level.
    pub mean_cost: f64,
    /// Good points over all points of the finest level.
    pub good_share: f32,
    /// Good points over visible points.
    pub good_of_visible: f32,
    /// Visible points over all points of the finest level.
    pub visible_share: f32,
    /// Mean over *all* points of `min(depth in keyframe / depth in frame, 1)` (invisible: 0): how
    /// much of the keyframe's area the frame still resolves.
    pub usage: f32,
    /// Correlation of the grey values over the visible points of the finest level; `None` where
    /// there is no contrast.
    pub correlation: Option<f64>,
    /// Points of the finest level.
    pub num_points: usize,
    /// Covariance of the twist `[v, w]` (left, in the frame), assuming the configured number of
    /// pixels per independent measurement; `None` when the system is singular.
    pub covariance: Option<Mat6>,
    /// Iterations over all levels.
    pub iterations: usize,
}

impl Alignment {
    /// Gain in `I_frame = gain * I_keyframe + bias`.
    #[must_use]
    pub fn gain(&self) -> f32 {
        self.motion.log_gain.exp() as f32
    }

    /// Bias in `I_frame = gain * I_keyframe + bias`.
    #[must_use]
    pub fn bias(&self) -> f32 {
        self.motion.bias as f32
    }
}

/// Largest damping after which a level is given up.
const MAX_LAMBDA: f64 = 1e6;

/// Aligns `target` to `reference` from `initial`, over the levels between the configured ones.
#[must_use]
pub fn align(
    reference: &Reference,
    target: &Target,
    initial: &Motion,
    freedom: Freedom,
    config: &AlignmentConfig,
) -> Alignment {
    let coarsest = config
        .coarsest_level
        .min(reference.coarsest_level())
        .min(target.coarsest_level());
    let finest = config.finest_level.min(coarsest);
    let mut motion = *initial;
    let mut iterations = 0;
    let mut last = None;
    let mut scale = None;
    for level in (finest..=coarsest).rev() {
        let solved = align_level(reference, target, level, &motion, scale, freedom, config);
        motion = solved.motion;
        scale = Some(solved.scale);
        iterations += solved.iterations;
        last = Some(solved);
    }
    let last = last
        .unwrap_or_else(|| align_level(reference, target, finest, &motion, None, freedom, config));
    summarise(&last, iterations, freedom, config)
}

/// Expected gain of a level: the ratio of the contrasts, with a weight.
#[derive(Clone, Copy, Debug, Default)]
struct GainPrior {
    log_gain: f64,
    /// Added to the normal equations.
    information: f64,
}

impl GainPrior {
    fn new(linear: &Linearization, config: &AlignmentConfig) -> Self {
        match (config.brightness, linear.log_contrast_ratio()) {
            (Brightness::Affine, Some(log_gain)) => Self {
                log_gain,
                information: CONTRAST_WEIGHT * linear.hessian[(6, 6)],
            },
            _ => Self::default(),
        }
    }

    /// Robust cost of a visible point with the share of the prior.
    fn mean_cost(&self, linear: &Linearization, motion: &Motion) -> f64 {
        let deviation = motion.log_gain - self.log_gain;
        linear.mean_cost()
            + self.information * deviation * deviation / linear.num_visible.max(1) as f64
    }
}

/// The state of one level after its last accepted step.
struct LevelResult {
    motion: Motion,
    linear: Linearization,
    num_points: usize,
    iterations: usize,
    scale: f32,
}

/// Levenberg-Marquardt on one level; a step is accepted on the true cost.
///
/// The scale of the t distribution is estimated before the first step (from that of the coarser
/// level) and then stays, so that costs remain comparable.
fn align_level(
    reference: &Reference,
    target: &Target,
    level: usize,
    initial: &Motion,
    initial_scale: Option<f32>,
    freedom: Freedom,
    config: &AlignmentConfig,
) -> LevelResult {
    let (points, image) = (&reference.levels[level], &target.levels[level]);
    let stride = if config.max_points == 0 {
        1
    } else {
        points.len().div_ceil(config.max_points).max(1)
    };
    let mut weighting = Weighting {
        intensity_var: config.sigma_intensity * config.sigma_intensity,
        robust: config.robust,
        scale: initial_scale.unwrap_or(1.0),
        good_sq: config.max_residual * config.max_residual,
        good_gradient_sq: MAX_RESIDUAL_PER_GRADIENT * MAX_RESIDUAL_PER_GRADIENT,
    };
    let evaluate = |motion: &Motion, weighting: &Weighting| {
        linearize(points, image, motion, weighting, stride)
    };
    let mut linear = evaluate(initial, &weighting);
    let scale_steps = if initial_scale.is_some() { 1 } else { 3 };
    for _ in 0..scale_steps {
        if update_scale(&mut weighting, &linear) {
            linear = evaluate(initial, &weighting);
        }
    }
    let max_iterations = config.max_iterations.get(level).copied().unwrap_or(20);
    let evaluate = |motion: &Motion| evaluate(motion, &weighting);
    let start = (*initial, linear);
    let (motion, linear, iterations) = descend(start, evaluate, max_iterations, freedom, config);
    LevelResult {
        motion,
        num_points: points.len().div_ceil(stride),
        linear,
        iterations,
        scale: weighting.scale,
    }
}

/// The last accepted state with its sums, and the number of steps that were tried.
fn descend(
    (mut motion, mut linear): (Motion, Linearization),
    evaluate: impl Fn(&Motion) -> Linearization,
    max_iterations: usize,
    freedom: Freedom,
    config: &AlignmentConfig,
) -> (Motion, Linearization, usize) {
    let mut iterations = 0;
    let mut lambda = 0.0;
    let prior = GainPrior::new(&linear, config);
    while iterations < max_iterations {
        iterations += 1;
        let Some(step) = solve(&linear, &motion, &prior, lambda, freedom, config.brightness) else {
            lambda = f64::max(2.0 * lambda, MIN_LAMBDA);
            if lambda > MAX_LAMBDA {
                break;
            }
            continue;
        };
        let candidate = apply(&motion, &step);
        let trial = evaluate(&candidate);
        let step_sq = step.fixed_rows::<6>(0).norm_squared();
        let cost = prior.mean_cost(&linear, &motion);
        let trial_cost = prior.mean_cost(&trial, &candidate);
        if trial_cost < cost {
            let decrease = 1.0 - trial_cost / cost;
            motion = candidate;
            linear = trial;
            lambda = less(lambda);
            if decrease < MIN_COST_DECREASE {
                break;
            }
        } else {
            if step_sq < MIN_STEP_SQ {
                break;
            }
            lambda = if lambda == 0.0 {
                FIRST_LAMBDA
            } else {
                lambda * 4.0
            };
            if lambda > MAX_LAMBDA {
                break;
            }
        }
    }
    (motion, linear, iterations)
}

/// One fixed-point step of the scale of the t distribution; true when it changed noticeably.
fn update_scale(weighting: &mut Weighting, linear: &Linearization) -> bool {
    if matches!(weighting.robust, Robust::Huber { .. }) || linear.num_visible == 0 {
        return false;
    }
    let scale = (linear.scale_sum / linear.num_visible as f64).sqrt() as f32;
    let scale = scale.clamp(SCALES[0], SCALES[1]);
    let changed = (scale / weighting.scale - 1.0).abs() > MIN_SCALE_CHANGE;
    weighting.scale = scale;
    changed
}

/// Solves the damped normal equations for the free unknowns.
fn solve(
    linear: &Linearization,
    motion: &Motion,
    prior: &GainPrior,
    lambda: f64,
    freedom: Freedom,
    brightness: Brightness,
) -> Option<SVector<f64, UNKNOWNS>> {
    let mut h = linear.hessian;
    let mut b = -linear.gradient;
    h[(6, 6)] += prior.information;
    b[6] -= prior.information * (motion.log_gain - prior.log_gain);
    for i in 0..UNKNOWNS {
        let fixed = (i < 3 && freedom == Freedom::Rotation)
            || (i >= 6 && brightness == Brightness::Constant);
        if fixed {
            h.fill_row(i, 0.0);
            h.fill_column(i, 0.0);
            h[(i, i)] = 1.0;
            b[i] = 0.0;
        } else {
            h[(i, i)] += lambda * h[(i, i)] + DIAGONAL_FLOOR;
        }
    }
    let step = h.cholesky()?.solve(&b);
    step.iter().all(|x| x.is_finite()).then_some(step)
}

/// Left update of the pose, additive update of the brightness.
fn apply(motion: &Motion, step: &SVector<f64, UNKNOWNS>) -> Motion {
    let twist = Vec6::from_iterator(step.iter().take(6).copied());
    Motion {
        frame_from_keyframe: Se3::exp(&twist) * motion.frame_from_keyframe,
        log_gain: (motion.log_gain + step[6]).clamp(-2.0, 2.0),
        bias: motion.bias + step[7],
    }
}

/// Quality measures and covariance from the last state.
fn summarise(
    last: &LevelResult,
    iterations: usize,
    freedom: Freedom,
    config: &AlignmentConfig,
) -> Alignment {
    let linear = &last.linear;
    let total = last.num_points.max(1) as f32;
    let visible = linear.num_visible.max(1) as f32;
    let good = linear.num_good as f32;
    let covariance = (freedom == Freedom::Rigid)
        .then(|| covariance(&linear.hessian, config))
        .flatten();
    Alignment {
        motion: last.motion,
        residual_rms: (linear.good_residual_sq / linear.num_good.max(1) as f64).sqrt() as f32,
        mean_cost: linear.mean_cost(),
        good_share: good / total,
        good_of_visible: good / visible,
        visible_share: linear.num_visible as f32 / total,
        usage: linear.usage_sum as f32 / total,
        correlation: linear.correlation(),
        num_points: last.num_points,
        covariance,
        iterations,
    }
}

/// Covariance of the pose with the brightness marginalised out.
fn covariance(
    hessian: &SMatrix<f64, UNKNOWNS, UNKNOWNS>,
    config: &AlignmentConfig,
) -> Option<Mat6> {
    let mut h = *hessian;
    if config.brightness == Brightness::Constant {
        for i in 6..UNKNOWNS {
            h.fill_row(i, 0.0);
            h.fill_column(i, 0.0);
            h[(i, i)] = 1.0;
        }
    }
    let inverse = h.cholesky()?.inverse();
    let pose = inverse.fixed_view::<6, 6>(0, 0).into_owned();
    let pose = pose * config.pixels_per_measurement;
    pose.iter().all(|x| x.is_finite()).then_some(pose)
}
