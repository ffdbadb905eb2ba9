//! The Levenberg-Marquardt loop of the bundle adjustment.

use super::linear::{State, Window};
use super::prepare::{Layout, NO_PAIR};
use super::schur::{Step, pose_covariance, solve_step};
use super::{
    Appearance, BundleConfig, BundleCovariance, BundleOutcome, BundleProblem, BundleSolution,
    CovarianceOf, ObservationOutcome, PoseFreedom,
};
use crate::damping::Damping;
use monogrid_geometry::{Mat6, Se3, Vec6};

/// Solves a problem that has been validated.
pub(super) fn solve(
    problem: &BundleProblem,
    appearance: Option<&dyn Appearance>,
    config: &BundleConfig,
) -> BundleSolution {
    let layout = Layout::new(problem);
    let mut window = Window::new(problem, &layout, appearance, config);
    let (low, high) = config.inverse_depth_range;
    let clamped = |p: &super::AnchoredPoint| p.inverse_depth.clamp(low, high);
    let poses = problem.keyframes.iter().map(|k| k.camera_from_world);
    let mut state = State {
        camera_from_world: poses.collect(),
        inverse_depths: problem.points.iter().map(clamped).collect(),
    };
    let everything = window.active.clone();
    let initial_cost = window.cost(&state, &everything);
    let mut iterations = 0;
    let mut outcome = BundleOutcome::NothingToDo;
    if everything.iter().any(|&a| a) {
        for round in 0..=config.rejection_rounds {
            let mut changed = true;
            if round > 0 {
                changed = select_inliers(&mut window, &state, config);
            }
            if changed {
                outcome = descend(&window, &mut state, config, &mut iterations);
            }
        }
    }
    let covariance = match config.covariance {
        CovarianceOf::Nothing => None,
        of => covariance(&window, &state, of == CovarianceOf::PosesAndPoints),
    };
    BundleSolution {
        observations: classify(&window, &state, config),
        initial_cost,
        final_cost: window.cost(&state, &everything),
        camera_from_world: state.camera_from_world,
        inverse_depths: state.inverse_depths,
        iterations,
        outcome,
        covariance,
    }
}

/// Steps until the cost of the active observations no longer falls.
fn descend(
    window: &Window,
    state: &mut State,
    config: &BundleConfig,
    iterations: &mut usize,
) -> BundleOutcome {
    let mut damping = Damping::new(config.initial_damping);
    let mut cost = window.cost(state, &window.active);
    for _ in 0..config.max_iterations {
        let normal = window.linearise(state);
        let decrease = loop {
            let step = solve_step(window, &normal, state, damping.lambda);
            if let Some(step) = step {
                let candidate = apply(window, state, &step, config);
                let new_cost = window.cost(&candidate, &window.active);
                // The true cost decides, never the linear model.
                if new_cost < cost {
                    damping.accept((cost - new_cost) / step.predicted.max(f64::MIN_POSITIVE));
                    *state = candidate;
                    break cost - new_cost;
                }
                if step.predicted <= 1e-9 * cost {
                    return BundleOutcome::Converged;
                }
            }
            if !damping.reject() {
                return BundleOutcome::Converged;
            }
        };
        *iterations += 1;
        cost -= decrease;
        if decrease <= config.min_relative_decrease * cost {
            return BundleOutcome::Converged;
        }
    }
    BundleOutcome::IterationLimit
}

/// The state after a step: left updates of the poses, inverse depths kept in their range.
fn apply(window: &Window, state: &State, step: &Step, config: &BundleConfig) -> State {
    let mut next = state.clone();
    for (slot, &keyframe) in window.layout.free_keyframes.iter().enumerate() {
        let delta: Vec6 = step.poses.fixed_rows::<6>(6 * slot).into_owned();
        let moved = Se3::exp(&delta) * state.camera_from_world[keyframe];
        next.camera_from_world[keyframe] = match window.problem.keyframes[keyframe].freedom {
            PoseFreedom::FixedDistance { to } => {
                let reference = &window.problem.keyframes[to].camera_from_world;
                let given = &window.problem.keyframes[keyframe].camera_from_world;
                with_distance(&moved, reference, given)
            }
            _ => moved,
        };
    }
    let (low, high) = config.inverse_depth_range;
    for (d, delta) in next.inverse_depths.iter_mut().zip(&step.inverse_depths) {
        *d = (*d + delta).clamp(low, high);
    }
    next
}

/// `moved`, with its centre pushed along the line to `reference` to the distance that `given` has.
fn with_distance(moved: &Se3, reference: &Se3, given: &Se3) -> Se3 {
    let origin = reference.inverse().translation;
    let length = (given.inverse().translation - origin).norm();
    let offset = moved.inverse().translation - origin;
    let centre = origin + offset * (length / offset.norm());
    Se3::new(moved.rotation, -(moved.rotation * centre))
}

/// Lets exactly the inliers take part. Returns whether that changed anything.
fn select_inliers(window: &mut Window, state: &State, config: &BundleConfig) -> bool {
    let relatives = window.relatives(state);
    let mut changed = false;
    for i in 0..window.active.len() {
        let chi2 = window.chi2(i, &relatives, state);
        let is_inlier = chi2.is_some_and(|chi2| chi2 <= config.inlier_chi2);
        changed |= is_inlier != window.active[i];
        window.active[i] = is_inlier;
    }
    changed
}

fn classify(window: &Window, state: &State, config: &BundleConfig) -> Vec<ObservationOutcome> {
    let relatives = window.relatives(state);
    let classify_one = |i: usize| {
        if window.layout.pair_of_observation[i] == NO_PAIR {
            return ObservationOutcome::Anchor;
        }
        match window.chi2(i, &relatives, state) {
            None => ObservationOutcome::Behind,
            Some(chi2) if chi2 <= config.inlier_chi2 => ObservationOutcome::Inlier { chi2 },
            Some(chi2) => ObservationOutcome::Outlier { chi2 },
        }
    };
    (0..window.active.len()).map(classify_one).collect()
}

/// Inverse of the undamped Hessian, for poses by the Schur complement and for each point
/// `1/h + (w/h)' S^-1 (w/h)`.
fn covariance(window: &Window, state: &State, of_points: bool) -> Option<BundleCovariance> {
    let normal = window.linearise(state);
    let all = pose_covariance(window, &normal, state)?;
    let variance = |point: usize| {
        let h = normal.h_points[point];
        if h <= 0.0 {
            return None;
        }
        let mut from_poses = 0.0;
        for (a, w_a) in window.fan(&normal, point) {
            for (b, w_b) in window.fan(&normal, point) {
                let block = all.fixed_view::<6, 6>(6 * a, 6 * b);
                from_poses += w_a.dot(&(block * w_b));
            }
        }
        Some(1.0 / h + from_poses / (h * h))
    };
    let pose = |slot: &Option<usize>| {
        slot.map_or(Mat6::zeros(), |k| {
            all.fixed_view::<6, 6>(6 * k, 6 * k).into_owned()
        })
    };
    let num_points = if of_points { normal.h_points.len() } else { 0 };
    Some(BundleCovariance {
        inverse_depth_variances: (0..num_points).map(variance).collect(),
        poses: window.layout.slot_of_keyframe.iter().map(pose).collect(),
    })
}
