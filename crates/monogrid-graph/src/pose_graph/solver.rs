//! Levenberg-Marquardt with graduated kernels on a pose graph.

use super::linear::Terms;
use super::{GraphOutcome, PoseGraph, PoseGraphConfig, PoseGraphError, PoseGraphReport};
use crate::blocks::BlockPattern;
use crate::damping::Damping;
use monogrid_geometry::{Sim3, Vec7};

/// Largest change of a log-scale in one step: a factor of two.
const MAX_LOG_SCALE_STEP: f64 = std::f64::consts::LN_2;

/// Keeps a factorisation possible for parts without any information.
const DIAGONAL_FLOOR: f64 = 1e-12;

pub(super) fn optimise(
    graph: &mut PoseGraph,
    config: &PoseGraphConfig,
) -> Result<PoseGraphReport, PoseGraphError> {
    validate(config)?;
    let slot = free_slots(graph);
    let before = graph.poses();
    let terms = Terms::new(graph);
    let initial_cost = terms.cost(&before, 1.0);
    let mut poses = before.clone();
    let mut iterations = 0;
    let mut outcome = GraphOutcome::NothingToDo;
    if slot.iter().any(Option::is_some) {
        let pattern = pattern(&terms, &slot);
        let problem = Problem {
            terms: &terms,
            slot: &slot,
            pattern: &pattern,
            config,
        };
        (poses, outcome) = problem.search(&before, &mut iterations)?;
    }
    let report = PoseGraphReport {
        initial_cost,
        final_cost: terms.cost(&poses, 1.0),
        iterations,
        outcome,
        edges: terms.edge_fits(&poses),
        moved: before.iter().zip(&poses).map(|(a, b)| a != b).collect(),
    };
    graph.is_judged.fill(true);
    for (node, pose) in graph.nodes.iter_mut().zip(poses) {
        node.world_from_keyframe = pose;
    }
    Ok(report)
}

fn validate(config: &PoseGraphConfig) -> Result<(), PoseGraphError> {
    let invalid = |what, value, expected| {
        Err(PoseGraphError::Value {
            what,
            value,
            expected,
        })
    };
    let damping = config.initial_damping;
    if !damping.is_finite() || damping <= 0.0 {
        return invalid("initial_damping", damping, "a positive number");
    }
    if let Some(factor) = config.graduation
        && (!factor.is_finite() || factor <= 1.0)
    {
        return invalid("graduation", factor, "a number above 1");
    }
    Ok(())
}

/// Per node its place among those that may move. In every part that edges connect and that has no
/// fixed node, the first node is held.
pub(super) fn free_slots(graph: &PoseGraph) -> Vec<Option<usize>> {
    let mut part: Vec<usize> = (0..graph.nodes.len()).collect();
    let terms = Terms::new(graph);
    for &(i, j) in &terms.ends {
        let (a, b) = (root(&mut part, i), root(&mut part, j));
        part[a.max(b)] = a.min(b); // the first node is always the root
    }
    let mut has_fixed = vec![false; part.len()];
    for (k, node) in graph.nodes.iter().enumerate() {
        let r = root(&mut part, k);
        has_fixed[r] |= node.is_fixed;
    }
    let mut next = 0;
    let mut slot = vec![None; part.len()];
    for (k, node) in graph.nodes.iter().enumerate() {
        let r = root(&mut part, k);
        let is_held = node.is_fixed || (r == k && !has_fixed[r]);
        if !is_held {
            slot[k] = Some(next);
            next += 1;
        }
    }
    slot
}

/// Root of a node's part, with paths halved on the way.
fn root(part: &mut [usize], mut k: usize) -> usize {
    while part[k] != k {
        part[k] = part[part[k]];
        k = part[k];
    }
    k
}

/// Pattern of the normal equations of the free nodes.
pub(super) fn pattern(terms: &Terms, slot: &[Option<usize>]) -> BlockPattern {
    let ends = terms.ends.iter();
    let pairs = ends.filter_map(|(i, j)| Some((slot[*i]?, slot[*j]?)));
    let pairs: Vec<_> = pairs.collect();
    BlockPattern::new(slot.iter().flatten().count(), &pairs)
}

struct Problem<'a> {
    terms: &'a Terms<'a>,
    slot: &'a [Option<usize>],
    pattern: &'a BlockPattern,
    config: &'a PoseGraphConfig,
}

impl Problem<'_> {
    /// The best of a few descents. One is enough unless it switched off edges of a
    /// graph that is largely new; a graph at rest is in the right valley.
    fn search(
        &self,
        start: &[Sim3],
        iterations: &mut usize,
    ) -> Result<(Vec<Sim3>, GraphOutcome), PoseGraphError> {
        let Some(factor) = self.config.graduation else {
            return self.graduate(start, f64::INFINITY, iterations);
        };
        let (mut best, mut outcome) = self.graduate(start, factor, iterations)?;
        let mut least = self.terms.cost(&best, 1.0);
        for attempt in 0..self.config.second_opinions {
            let is_doubtful = self.terms.is_mostly_new() && self.terms.has_new_edge_off(&best);
            if !is_doubtful && least <= self.terms.cost(start, 1.0) {
                break;
            }
            // In turn: more slowly from the start, again from the best, as it is from the start.
            let slower = factor.powf(0.3);
            let (other, other_outcome) = match attempt % 3 {
                0 => self.graduate(start, slower, iterations)?,
                1 => self.graduate(&best, slower, iterations)?,
                _ => self.graduate(start, f64::INFINITY, iterations)?,
            };
            let cost = self.terms.cost(&other, 1.0);
            if cost < least {
                (best, outcome, least) = (other, other_outcome, cost);
            }
        }
        if least > self.terms.cost(start, 1.0) {
            return self.graduate(start, f64::INFINITY, iterations);
        }
        Ok((best, outcome))
    }

    /// Descends with ever narrower kernels (Graduated Non-Convexity), then with their own; an
    /// infinite factor begins with those.
    fn graduate(
        &self,
        start: &[Sim3],
        factor: f64,
        iterations: &mut usize,
    ) -> Result<(Vec<Sim3>, GraphOutcome), PoseGraphError> {
        let mut poses = start.to_vec();
        if factor.is_finite() {
            let mut width = self.terms.quadratic_width(&poses);
            while width > 1.0 {
                self.descend(
                    &mut poses,
                    width,
                    self.config.iterations_per_stage,
                    iterations,
                )?;
                // What the first stages gained need not be walked down again.
                width = width.min(self.terms.quadratic_width(&poses)) / factor;
            }
        }
        let outcome = self.descend(&mut poses, 1.0, self.config.max_iterations, iterations)?;
        Ok((poses, outcome))
    }

    /// Steps until the true cost no longer falls.
    fn descend(
        &self,
        poses: &mut Vec<Sim3>,
        width: f64,
        max_iterations: usize,
        iterations: &mut usize,
    ) -> Result<GraphOutcome, PoseGraphError> {
        let (terms, pattern) = (self.terms, self.pattern);
        let mut damping = Damping::new(self.config.initial_damping);
        let (mut residuals, mut new_residuals) = (Vec::new(), Vec::new());
        let mut cost = terms.evaluate(poses, width, &mut residuals);
        let (mut h, mut damped) = (pattern.zeros(), pattern.zeros());
        let mut factor = pattern.factor();
        for _ in 0..max_iterations {
            let b = terms.linearise(poses, &residuals, width, self.slot, pattern, &mut h);
            let diagonal = pattern.diagonal(&h);
            let decrease = loop {
                damped.copy_from(&h);
                pattern.add_to_diagonal(&mut damped, |c| {
                    damping.lambda * diagonal[c] + DIAGONAL_FLOOR
                });
                let is_definite = pattern.factorise(&damped, &mut factor);
                let step = is_definite.map(|()| pattern.solve(&factor, &b));
                if let Some(step) = step.filter(|s| is_small(s)) {
                    let predicted = predicted_decrease(&step, &b, &diagonal, damping.lambda);
                    let candidate = self.apply(poses, &step);
                    let new_cost = terms.evaluate(&candidate, width, &mut new_residuals);
                    if new_cost < cost {
                        damping.accept((cost - new_cost) / predicted.max(f64::MIN_POSITIVE));
                        *poses = candidate;
                        std::mem::swap(&mut residuals, &mut new_residuals);
                        break cost - new_cost;
                    }
                    if predicted <= 1e-9 * cost.max(1e-12) {
                        return Ok(GraphOutcome::Converged);
                    }
                }
                if !damping.reject() {
                    return if diagonal.iter().all(|d| d.is_finite()) {
                        Ok(GraphOutcome::Converged)
                    } else {
                        Err(PoseGraphError::Singular)
                    };
                }
            };
            *iterations += 1;
            cost -= decrease;
            if decrease <= self.config.min_relative_decrease * cost {
                return Ok(GraphOutcome::Converged);
            }
        }
        Ok(GraphOutcome::IterationLimit)
    }

    fn apply(&self, poses: &[Sim3], step: &[Vec7]) -> Vec<Sim3> {
        let moved = |(pose, slot): (&Sim3, &Option<usize>)| {
            slot.map_or(*pose, |k| Sim3::exp(&step[k]) * *pose)
        };
        poses.iter().zip(self.slot).map(moved).collect()
    }
}

/// Whether a step is finite and changes no scale by more than a factor of two.
fn is_small(step: &[Vec7]) -> bool {
    let is_ok = |d: &Vec7| d.iter().all(|x| x.is_finite()) && d[6].abs() <= MAX_LOG_SCALE_STEP;
    step.iter().all(is_ok)
}

/// `b'x - x'H x / 2` with `(H + lambda D) x = b`.
fn predicted_decrease(step: &[Vec7], b: &[Vec7], diagonal: &[f64], lambda: f64) -> f64 {
    let mut sum = 0.0;
    for (k, (x, g)) in step.iter().zip(b).enumerate() {
        for i in 0..7 {
            sum += 0.5 * x[i] * (g[i] + lambda * diagonal[7 * k + i] * x[i]);
        }
    }
    sum
}
