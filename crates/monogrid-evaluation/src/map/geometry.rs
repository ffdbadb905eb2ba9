//! Distances between predicted and true surfaces.

use super::in_view::InView;
use super::nearest::CellTree;
use crate::statistics::median;
use crate::truth::TruthGrid;
use monogrid_occupancy::Occupancy;
use serde::Serialize;

/// Distances between centres of cells, in map units (metres in a metric map).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct SurfaceDistances {
    /// Mean distance from a predicted occupied cell to the nearest truly occupied one; `None` when
    /// there are no such cells.
    pub accuracy_m: Option<f64>,
    /// Median of these distances.
    pub accuracy_median_m: Option<f64>,
    /// 90 % of these distances are at most this.
    pub accuracy_p90_m: Option<f64>,
    /// 95 % of these distances are at most this.
    pub accuracy_p95_m: Option<f64>,
    /// Share of them beyond three cells: single cells far away make the mean say little.
    pub accuracy_beyond_3_cells: f64,
    /// Share of predicted occupied cells within the tolerance of a truly occupied one.
    pub accuracy_within_tolerance: f64,
    /// Share of truly occupied cells (those in view, when the view is given) that have a predicted
    /// one within the tolerance.
    pub completeness: f64,
    /// Mean distance from a truly occupied cell to the nearest predicted one.
    pub completeness_m: Option<f64>,
    /// Predicted occupied cells per truly occupied one.
    pub occupied_ratio: Option<f64>,
    /// The tolerance, map units.
    pub tolerance_m: f64,
}

/// The true surface, ready to be asked for its nearest cells.
#[derive(Debug)]
pub(crate) struct TrueSurface {
    tree: CellTree,
    /// Cells that should be found in the estimate, a sample.
    to_find: Vec<[i32; 3]>,
    resolution: f64,
    tolerance: f64,
    max_queries: usize,
}

impl TrueSurface {
    /// Of the truly occupied cells, those in view are to be found. At most `max_queries` cells of
    /// each set, evenly spread over their order, ask for their nearest neighbour.
    pub fn new(truth: &TruthGrid, view: &InView, tolerance: f64, max_queries: usize) -> Self {
        let cells: Vec<[i32; 3]> = truth.keys_in(Occupancy::Occupied).collect();
        let in_view: Vec<[i32; 3]> = cells
            .iter()
            .copied()
            .filter(|k| view.contains(*k))
            .collect();
        Self {
            to_find: sample(&in_view, max_queries),
            tree: CellTree::new(cells),
            resolution: truth.resolution(),
            tolerance,
            max_queries,
        }
    }

    /// Truly occupied cells in view that should be found, a sample.
    pub fn cells_to_find(&self) -> &[[i32; 3]] {
        &self.to_find
    }

    /// How many of the cells are farther than `distance` (map units) from this surface.
    pub fn num_beyond(&self, cells: &[[i32; 3]], distance: f64) -> u64 {
        let distances = distances(cells, &self.tree, self.resolution);
        let reach = at_least(distance);
        distances.iter().filter(|d| **d > reach).count() as u64
    }

    /// Distances between `predicted` cells and this surface; the ratio of their numbers is left
    /// out.
    pub fn distances(&self, predicted: Vec<[i32; 3]>) -> SurfaceDistances {
        let from_predicted = sample(&predicted, self.max_queries);
        let to_truth = distances(&from_predicted, &self.tree, self.resolution);
        let to_predicted = distances(&self.to_find, &CellTree::new(predicted), self.resolution);
        let (near, far) = (at_least(self.tolerance), at_least(3.0 * self.resolution));
        SurfaceDistances {
            accuracy_m: mean(&to_truth),
            accuracy_median_m: median(&to_truth),
            accuracy_p90_m: quantile(&to_truth, 0.9),
            accuracy_p95_m: quantile(&to_truth, 0.95),
            accuracy_beyond_3_cells: share(&to_truth, from_predicted.len(), |d| d > far),
            accuracy_within_tolerance: share(&to_truth, from_predicted.len(), |d| d <= near),
            completeness: share(&to_predicted, self.to_find.len(), |d| d <= near),
            completeness_m: mean(&to_predicted),
            occupied_ratio: None,
            tolerance_m: self.tolerance,
        }
    }
}

/// Distances are multiples of the resolution but for rounding.
fn at_least(distance: f64) -> f64 {
    distance * (1.0 + 1e-9)
}

fn sample(keys: &[[i32; 3]], max: usize) -> Vec<[i32; 3]> {
    let stride = keys.len().div_ceil(max.max(1)).max(1);
    keys.iter().step_by(stride).copied().collect()
}

fn distances(keys: &[[i32; 3]], tree: &CellTree, resolution: f64) -> Vec<f64> {
    let squares = keys.iter().filter_map(|key| tree.distance_sq(*key));
    let distances = squares.map(|distance_sq| (distance_sq as f64).sqrt() * resolution);
    distances.collect()
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

fn quantile(values: &[f64], share: f64) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let rank = (share * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.saturating_sub(1)).copied()
}

fn share(distances: &[f64], asked: usize, counts: impl Fn(f64) -> bool) -> f64 {
    distances.iter().filter(|d| counts(**d)).count() as f64 / asked.max(1) as f64
}
