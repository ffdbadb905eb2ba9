//! How much the answer depends on which stretch of the path is looked at.
//!
//! Errors of a path that was tracked are not white: it bends, and its scale changes by a percent
//! from one keyframe to another. What the normal equations say of the uncertainty is then too
//! little. A delete-a-group jackknife (`[EFRON93]` chapter 11) leaves out one stretch after the
//! other and looks at what that changes.

use super::problem::{Problem, States};
use super::types::Observation;

/// Stretches that the path is divided into.
const STRETCHES: usize = 6;
/// Steps from the answer of the whole path to that without a stretch.
const STEPS: usize = 4;

/// Variances by the jackknife.
pub(super) struct Scatter {
    /// Of the logarithms of the scales of the parts.
    pub scales: Vec<f64>,
    /// Of the direction of gravity, rad².
    pub gravity: f64,
}

pub(super) fn scatter(problem: &mut Problem, states: &States) -> Scatter {
    let mut answers: Vec<States> = Vec::with_capacity(STRETCHES);
    let observations = problem.observations.clone();
    for stretch in 0..STRETCHES {
        problem.observations = without(&observations, stretch);
        let mut states = states.clone();
        if problem.minimise(&mut states, STEPS).is_ok() {
            answers.push(states);
        }
    }
    problem.observations = observations;
    let num = answers.len().max(1) as f64;
    let variance = |square: &dyn Fn(&States) -> f64| {
        (num - 1.0) / num * answers.iter().map(square).sum::<f64>()
    };
    let scale = |part: usize| {
        let logarithm = |states: &States| states.parts[part].scale.ln();
        let mean = answers.iter().map(logarithm).sum::<f64>() / num;
        variance(&|states: &States| (logarithm(states) - mean).powi(2))
    };
    Scatter {
        scales: (0..problem.num_parts).map(scale).collect(),
        gravity: variance(&|found: &States| found.down.angle(&states.down).powi(2)),
    }
}

/// The same frames, those of a stretch of each part as if nothing had been seen.
fn without(observations: &[Observation], stretch: usize) -> Vec<Observation> {
    let part_of = |o: &Observation| o.seen.map(|seen| seen.0);
    let last = observations.iter().filter_map(part_of).max();
    let num_parts = last.map_or(0, |last| last + 1);
    let mut sizes = vec![0; num_parts];
    for part in observations.iter().filter_map(part_of) {
        sizes[part] += 1;
    }
    let mut counts = vec![0; num_parts];
    let mut blinded = observations.to_vec();
    for observation in &mut blinded {
        if let Some(part) = part_of(observation) {
            if counts[part] * STRETCHES / sizes[part] == stretch {
                observation.seen = None;
            }
            counts[part] += 1;
        }
    }
    blinded
}
