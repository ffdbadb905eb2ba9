//! What the map evaluation reports.

use super::{Calibration, Contingency, RocPoint, SurfaceDistances, Thickness};
use crate::truth::CellCounts;
use serde::Serialize;

/// Results under one policy for unknown cells.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PolicyReport {
    /// Exact area under the ROC curve, ties counted half; 0.5 when a class is missing.
    pub auc: f64,
    /// Area from the thesis' 26 thresholds.
    pub auc_26: f64,
    /// Matthews correlation coefficient at p > 0.5; 0 when undefined.
    pub mcc: f64,
    /// Share of predicted cells that are occupied, at p > 0.5.
    pub precision: f64,
    /// Share of occupied cells found, at p > 0.5.
    pub recall: f64,
    /// Share of free cells found, at p > 0.5.
    pub specificity: f64,
    /// F-measure at p > 0.5.
    pub f1: f64,
    /// Intersection over union of occupied cells at p > 0.5.
    pub iou: f64,
    /// The four counts at p > 0.5.
    #[serde(flatten)]
    pub counts: Contingency,
    /// Largest F-measure over all thresholds.
    pub best_f1: f64,
    /// The threshold that gives it.
    pub best_f1_threshold: f64,
}

/// One value per policy.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Policies<T> {
    /// Cells whose truth is known and that the estimate observed. The honest figure of merit of a
    /// sensor model; says nothing about how much was observed.
    pub observed: T,
    /// Cells whose truth is known; unobserved ones score 0.5. Probably the thesis' way.
    pub known: T,
    /// The whole box: unknown truth is negative, unobserved cells score 0.5.
    pub everything: T,
    /// Cells whose truth is known; unobserved ones score 1: a robot keeps out of them.
    pub safety: T,
}

impl<T> Policies<T> {
    pub(crate) fn map<U>(&self, mut change: impl FnMut(&T) -> U) -> Policies<U> {
        Policies {
            observed: change(&self.observed),
            known: change(&self.known),
            everything: change(&self.everything),
            safety: change(&self.safety),
        }
    }
}

/// Everything known about the error of a map.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MapReport {
    /// Classification under the four policies.
    pub policies: Policies<PolicyReport>,
    /// The policy `known` over the cells in view alone: a map is not blamed for what nobody saw.
    /// `None` when the view was not given.
    pub known_in_view: Option<PolicyReport>,
    /// ROC curves at the thesis' 26 thresholds.
    pub roc: Policies<Vec<RocPoint>>,
    /// Share of truly free cells that were observed.
    pub coverage_free: f64,
    /// Share of truly occupied cells that were observed.
    pub coverage_occupied: f64,
    /// As `coverage_free`, of the cells in view; `None` when the view was not given.
    pub coverage_free_in_view: Option<f64>,
    /// As `coverage_occupied`, of the cells in view; `None` when the view was not given.
    pub coverage_occupied_in_view: Option<f64>,
    /// Brier score, likelihood and reliability diagram.
    #[serde(flatten)]
    pub calibration: Calibration,
    /// Accuracy and completeness of the surface.
    #[serde(flatten)]
    pub surface: SurfaceDistances,
    /// Thickness of walls; absent where distances are not asked for.
    #[serde(flatten)]
    pub thickness: Thickness,
    /// Mean over the horizontal slices of the sum of squared differences of probability, unknown
    /// being 0.5 (the thesis' equation 6.1.2, with probabilities instead of grey levels).
    pub ssd: f64,
    /// Sum over all slices by the number of cells of the box.
    pub ssd_normalised: f64,
    /// The sum of each slice (equation 6.1.1), upwards.
    pub ssd_per_slice: Vec<f64>,
    /// Observed cells of the box by probability, 100 bins from 0 to 1.
    pub probability_histogram: Vec<u64>,
    /// States of the cells of the truth.
    pub truth: CellCounts,
    /// Observed cells inside the box.
    pub observed: u64,
    /// Observed cells outside the box, where nothing is known.
    pub observed_outside: u64,
    /// Predicted occupied cells, wherever they are.
    pub predicted: u64,
    /// Those outside the box: they enter the distances and nothing else.
    pub predicted_outside: u64,
    /// Predicted occupied cells where the truth knows nothing (outside the room), farther than 0.1
    /// map units from any true surface: false walls. 0 where distances are not asked for.
    pub predicted_beyond: u64,
    /// Matthews correlation over the observed cells and these, which count as false.
    pub mcc_with_beyond: f64,
}
