//! An estimated map against a ground-truth map, cell by cell.
//!
//! Flow: one pass over the known cells of the estimate → counts per score and true state, sums per
//! slice → the four policies, ROC curves, calibration; beside them distances between surfaces.
//! The box of the truth is the whole that is compared; predicted cells outside it only enter the
//! distances.

mod calibration;
mod classify;
mod error;
mod geometry;
mod in_view;
mod nearest;
mod report;
mod scores;
mod thickness;

pub use calibration::{Calibration, ReliabilityBin};
pub use classify::{Contingency, RocPoint};
pub use error::MapEvaluationError;
pub use geometry::SurfaceDistances;
use geometry::TrueSurface;
pub use report::{MapReport, Policies, PolicyReport};
pub use thickness::Thickness;

use crate::truth::{CellCounts, TruthGrid};
use in_view::InView;
use monogrid_occupancy::{Occupancy, OccupancyMap, probability_from_log_odds};
use scores::{ScoreCounter, ScoreGroup};

/// Predicted surfaces farther beyond the known truth than this are false, map units.
const MAX_BEYOND: f64 = 0.1;
/// Bins of the distribution of probabilities.
const HISTOGRAM_BINS: usize = 100;

/// Settings of [`evaluate_map`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapEvaluationConfig<'a> {
    /// Predicted and true surfaces within this distance agree, map units. Default: the larger of
    /// 0.05 and the resolution.
    pub tolerance_m: Option<f64>,
    /// Cells that some keyframe looks at, as [`crate::cells_in_view`] makes it; free or occupied
    /// there means "in view". Its cells may be a whole number of times as large as those of the
    /// truth. Completeness then only asks for surfaces in view. Default: none.
    pub in_view: Option<&'a TruthGrid>,
    /// At most so many cells of each surface ask for their nearest neighbour; with 0 the distances
    /// are absent and the shares within the tolerance 0. Default 1,000,000.
    pub max_distance_queries: usize,
}

impl Default for MapEvaluationConfig<'_> {
    fn default() -> Self {
        Self {
            tolerance_m: None,
            in_view: None,
            max_distance_queries: 1_000_000,
        }
    }
}

/// What one pass over the estimate collects.
#[derive(Default)]
struct Pass {
    scores: ScoreCounter,
    /// Those of the cells in view; empty without a view.
    scores_in_view: ScoreCounter,
    slices: Vec<Slice>,
    /// Predicted occupied cells; empty when nobody asks for distances.
    predicted: Vec<[i32; 3]>,
    num_predicted: u64,
    outside: u64,
    occupied_outside: u64,
    /// Predicted occupied cells where the truth knows nothing, outside its box or inside.
    occupied_unknown: Vec<[i32; 3]>,
    seen_in_view: CellCounts,
}

/// Observed cells of a slice by true state, and their squared differences.
#[derive(Clone, Copy, Default)]
struct Slice {
    squares: f64,
    observed: CellCounts,
}

/// Compares a map with the truth. Slices are layers of constant z, which is up in exported maps.
///
/// # Errors
/// Cells of different size, or a truth without free or without occupied cells.
pub fn evaluate_map(
    estimate: &OccupancyMap,
    truth: &TruthGrid,
    config: &MapEvaluationConfig,
) -> Result<MapReport, MapEvaluationError> {
    check_resolution(estimate, truth)?;
    MapEvaluator::new(truth, config)?.evaluate(estimate)
}

fn check_resolution(estimate: &OccupancyMap, truth: &TruthGrid) -> Result<(), MapEvaluationError> {
    if (estimate.resolution() / truth.resolution() - 1.0).abs() > 1e-6 {
        return Err(MapEvaluationError::Resolution {
            estimate: estimate.resolution(),
            truth: truth.resolution(),
        });
    }
    Ok(())
}

/// A truth prepared for the comparison of many maps with it: what depends on the truth alone
/// (counts, the view, the tree of its surface) is found once.
#[derive(Debug)]
pub struct MapEvaluator<'a> {
    truth: &'a TruthGrid,
    view: InView<'a>,
    counts: CellCounts,
    counts_per_layer: Vec<CellCounts>,
    counts_in_view: Option<CellCounts>,
    surface: Option<TrueSurface>,
}

impl<'a> MapEvaluator<'a> {
    /// Prepares a truth.
    ///
    /// # Errors
    /// A view that does not fit the truth, or a truth without free or without occupied cells.
    pub fn new(
        truth: &'a TruthGrid,
        config: &MapEvaluationConfig<'a>,
    ) -> Result<Self, MapEvaluationError> {
        let resolution = truth.resolution();
        let view = InView::new(config.in_view, resolution)?;
        let layers = (0..truth.size()[2]).map(|z| truth.layer_counts(z));
        let counts_per_layer: Vec<CellCounts> = layers.collect();
        let counts = CellCounts::sum(&counts_per_layer);
        if counts.free == 0 || counts.occupied == 0 {
            return Err(MapEvaluationError::OneClass {
                free: counts.free,
                occupied: counts.occupied,
            });
        }
        let tolerance = config.tolerance_m.unwrap_or_else(|| resolution.max(0.05));
        let queries = config.max_distance_queries;
        let surface = (queries > 0).then(|| TrueSurface::new(truth, &view, tolerance, queries));
        Ok(Self {
            truth,
            counts,
            counts_per_layer,
            counts_in_view: view.counts(truth),
            surface,
            view,
        })
    }

    /// Compares a map with the truth.
    ///
    /// # Errors
    /// Cells of different size.
    pub fn evaluate(&self, estimate: &OccupancyMap) -> Result<MapReport, MapEvaluationError> {
        check_resolution(estimate, self.truth)?;
        let pass = self.pass_over(estimate);
        let observed = CellCounts::sum(pass.slices.iter().map(|slice| &slice.observed));
        let ssd_per_slice = sums_of_squares(&pass.slices, &self.counts_per_layer);
        let ssd_total: f64 = ssd_per_slice.iter().sum();
        let scores = pass.scores.into_sorted();
        let groups = policy_groups(&scores, &self.counts, &observed);
        let surface = self.surface.as_ref();
        let beyond = surface.map_or(0, |s| s.num_beyond(&pass.occupied_unknown, MAX_BEYOND));
        let distances = surface.map(|s| s.distances(pass.predicted));
        let thickness = surface.map(|s| Thickness::at(s.cells_to_find(), estimate, self.truth));
        let mut with_beyond = Contingency::at(&groups.observed, 0.5);
        with_beyond.fp += beyond;
        let (seen, in_view) = (pass.seen_in_view, self.counts_in_view);
        let share = |part: u64, whole: u64| part as f64 / whole.max(1) as f64;
        Ok(MapReport {
            policies: groups.map(|g| policy_report(g)),
            known_in_view: in_view.map(|view| {
                let scores = pass.scores_in_view.into_sorted();
                policy_report(&policy_groups(&scores, &view, &seen).known)
            }),
            roc: groups.map(|g| classify::roc_26(g)),
            coverage_free: share(observed.free, self.counts.free),
            coverage_occupied: share(observed.occupied, self.counts.occupied),
            coverage_free_in_view: in_view.map(|v| share(seen.free, v.free)),
            coverage_occupied_in_view: in_view.map(|v| share(seen.occupied, v.occupied)),
            calibration: calibration::calibration(&groups.observed),
            surface: SurfaceDistances {
                occupied_ratio: Some(share(pass.num_predicted, self.counts.occupied)),
                ..distances.unwrap_or_default()
            },
            thickness: thickness.unwrap_or_default(),
            ssd: ssd_total / ssd_per_slice.len().max(1) as f64,
            ssd_normalised: ssd_total / self.counts.total().max(1) as f64,
            ssd_per_slice,
            probability_histogram: histogram(&scores),
            truth: self.counts,
            observed: observed.total(),
            observed_outside: pass.outside,
            predicted: pass.num_predicted,
            predicted_outside: pass.occupied_outside,
            predicted_beyond: beyond,
            mcc_with_beyond: with_beyond.mcc(),
        })
    }

    fn pass_over(&self, estimate: &OccupancyMap) -> Pass {
        let truth = self.truth;
        let mut pass = Pass {
            slices: vec![Slice::default(); truth.size()[2]],
            ..Pass::default()
        };
        for cell in estimate.cells() {
            let key = cell.key.to_array();
            let is_predicted = cell.log_odds > 0.0;
            pass.num_predicted += u64::from(is_predicted);
            if is_predicted && self.surface.is_some() {
                pass.predicted.push(key);
            }
            let local = truth.local(key);
            let state = local.map_or(Occupancy::Unknown, |local| truth.state_at(local));
            if is_predicted && state == Occupancy::Unknown {
                pass.occupied_unknown.push(key);
            }
            let Some(local) = local else {
                pass.outside += 1;
                pass.occupied_outside += u64::from(is_predicted);
                continue;
            };
            pass.scores.at(cell.log_odds).add(state);
            let slice = &mut pass.slices[local[2]];
            let value = match state {
                Occupancy::Occupied => 1.0,
                Occupancy::Free => 0.0,
                Occupancy::Unknown => 0.5,
            };
            slice.squares += (probability(cell.log_odds) - value).powi(2);
            slice.observed.add(state);
            if self.counts_in_view.is_some() && self.view.contains(key) {
                pass.seen_in_view.add(state);
                pass.scores_in_view.at(cell.log_odds).add(state);
            }
        }
        pass
    }
}

fn probability(log_odds: f32) -> f64 {
    probability_from_log_odds(f64::from(log_odds))
}

/// Adds to every slice what the cells that were not observed differ by: half where the truth is
/// known.
fn sums_of_squares(slices: &[Slice], layers: &[CellCounts]) -> Vec<f64> {
    let sum = |(slice, all): (&Slice, &CellCounts)| {
        let known = all.free + all.occupied;
        let seen = slice.observed.free + slice.observed.occupied;
        slice.squares + 0.25 * (known - seen) as f64
    };
    slices.iter().zip(layers).map(sum).collect()
}

/// The scores that each policy ranks.
fn policy_groups(
    scores: &[(f32, CellCounts)],
    truth: &CellCounts,
    observed: &CellCounts,
) -> Policies<Vec<ScoreGroup>> {
    let groups = |negatives: fn(&CellCounts) -> u64| -> Vec<ScoreGroup> {
        let group = |(log_odds, counts): &(f32, CellCounts)| ScoreGroup {
            probability: probability(*log_odds),
            positives: counts.occupied,
            negatives: negatives(counts),
        };
        scores.iter().map(group).collect()
    };
    let of_known = groups(|counts| counts.free);
    let of_all = groups(|counts| counts.free + counts.unknown);
    let unobserved = |probability: f64, negatives: u64| ScoreGroup {
        probability,
        positives: truth.occupied - observed.occupied,
        negatives,
    };
    let unobserved_free = truth.free - observed.free;
    let unobserved_all = unobserved_free + truth.unknown - observed.unknown;
    let with = |mut groups: Vec<ScoreGroup>, more: Option<ScoreGroup>| {
        groups.extend(more);
        scores::joined(groups)
    };
    Policies {
        observed: with(of_known.clone(), None),
        known: with(of_known.clone(), Some(unobserved(0.5, unobserved_free))),
        everything: with(of_all, Some(unobserved(0.5, unobserved_all))),
        safety: with(of_known, Some(unobserved(1.0, unobserved_free))),
    }
}

fn policy_report(groups: &[ScoreGroup]) -> PolicyReport {
    let counts = Contingency::at(groups, 0.5);
    let (best_f1_threshold, best_f1) = classify::best_f1(groups);
    PolicyReport {
        auc: classify::rank_auc(groups),
        auc_26: classify::trapezoid(&classify::roc_26(groups), groups),
        mcc: counts.mcc(),
        precision: counts.precision(),
        recall: counts.recall(),
        specificity: counts.specificity(),
        f1: counts.f1(),
        iou: counts.iou(),
        counts,
        best_f1,
        best_f1_threshold,
    }
}

fn histogram(scores: &[(f32, CellCounts)]) -> Vec<u64> {
    let mut bins = vec![0; HISTOGRAM_BINS];
    for (log_odds, counts) in scores {
        let bin = (probability(*log_odds) * HISTOGRAM_BINS as f64) as usize;
        bins[bin.min(HISTOGRAM_BINS - 1)] += counts.total();
    }
    bins
}
