//! What is known about one map of a sweep, and the file that keeps it for a resumed sweep.

use super::plan::Entry;
use monogrid_app::output::OutputFolder;
use monogrid_app::process::failure::Failure;
use monogrid_evaluation::{MapReport, PolicyReport, RocPoint};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// One map.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct MapRecord {
    /// Everything that the result depends on; a record with another one is not reused.
    pub fingerprint: String,
    /// Which map.
    pub entry: Entry,
    /// What became of it.
    pub result: MapResult,
}

/// What became of a map.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MapResult {
    /// It was built.
    Built(Box<Built>),
    /// It does not fit the memory limit of the sweep.
    BeyondMemory {
        /// The limit, bytes.
        limit_bytes: usize,
    },
}

/// Facts about a map.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Built {
    /// Keyframes mapped.
    pub keyframes: usize,
    /// Measurements mapped.
    pub points: usize,
    /// CPU seconds of the integration alone.
    pub seconds: f64,
    /// Bytes of the map in memory.
    pub bytes: usize,
    /// Bytes that its maximum-likelihood form would need.
    pub bytes_likelihood: usize,
    /// Nodes of the pruned octree.
    pub nodes: Option<usize>,
    /// Leaves of the pruned octree.
    pub leaves: usize,
    /// Edges of the box of known cells, metres.
    pub extent: [f64; 3],
    /// Bytes of the `.ot` file; `None` where the format cannot hold the map.
    pub ot_bytes: Option<u64>,
    /// Bytes of the `.bt` file; `None` where the format cannot hold the map.
    pub bt_bytes: Option<u64>,
    /// The map while it grew.
    pub growth: Vec<Growth>,
    /// Against the truth, where there is one fine enough.
    pub scores: Option<Scores>,
    /// Pictures beside this record: names of files.
    pub pictures: Vec<PictureFile>,
}

/// A map after some keyframes.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Growth {
    /// Keyframes mapped until then.
    pub keyframes: usize,
    /// Bytes in memory.
    pub bytes: usize,
    /// Bytes of the maximum-likelihood form; only found for some keyframes.
    pub bytes_likelihood: Option<usize>,
}

/// What a picture shows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PictureFile {
    /// `slice` or `view`.
    pub kind: PictureKind,
    /// Name inside the folder of the recording.
    pub file: String,
}

/// What a picture shows.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PictureKind {
    /// A horizontal slice at this height.
    Slice(f64),
    /// Occupied cells in space.
    View,
}

/// The map against the truth.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Scores {
    /// Cells with known truth that the map observed.
    pub observed: PolicyScores,
    /// Cells with known truth, unobserved ones at 0.5.
    pub known: PolicyScores,
    /// The whole box, unobserved cells at 0.5, unknown truth negative.
    pub everything: PolicyScores,
    /// Cells with known truth, unobserved ones at 1.
    pub safety: PolicyScores,
    /// Share of truly free cells observed.
    pub coverage_free: f64,
    /// Share of truly occupied cells observed.
    pub coverage_occupied: f64,
    /// As above, of the cells that a keyframe looks at.
    pub coverage_free_in_view: Option<f64>,
    /// As above, of the cells that a keyframe looks at.
    pub coverage_occupied_in_view: Option<f64>,
    /// Mean of (p - truth)².
    pub brier: Option<f64>,
    /// Mean sum of squared differences per slice.
    pub ssd: f64,
    /// Predicted occupied cells per truly occupied one.
    pub occupied_ratio: Option<f64>,
    /// Observed cells by probability, 100 bins.
    pub histogram: Vec<u64>,
    /// Cells with known truth that the map did not observe.
    pub unobserved: u64,
}

/// Scores under one policy for unknown cells.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PolicyScores {
    /// Exact area under the ROC curve.
    pub auc: f64,
    /// Area from the thesis' 26 thresholds.
    pub auc_26: f64,
    /// At p > 0.5.
    pub mcc: f64,
    /// At p > 0.5.
    pub precision: f64,
    /// At p > 0.5.
    pub recall: f64,
    /// At p > 0.5.
    pub f1: f64,
    /// (false positive rate, true positive rate) at the 26 thresholds, ascending.
    pub roc: Vec<[f64; 2]>,
}

impl Scores {
    /// The part of a report that the sweep shows.
    pub fn from_report(report: &MapReport) -> Self {
        let truth = &report.truth;
        let known = (truth.free + truth.occupied) as f64;
        let seen = report.coverage_free * truth.free as f64
            + report.coverage_occupied * truth.occupied as f64;
        let policies = &report.policies;
        Self {
            observed: policy(&policies.observed, &report.roc.observed),
            known: policy(&policies.known, &report.roc.known),
            everything: policy(&policies.everything, &report.roc.everything),
            safety: policy(&policies.safety, &report.roc.safety),
            coverage_free: report.coverage_free,
            coverage_occupied: report.coverage_occupied,
            coverage_free_in_view: report.coverage_free_in_view,
            coverage_occupied_in_view: report.coverage_occupied_in_view,
            brier: report.calibration.brier,
            ssd: report.ssd,
            occupied_ratio: report.surface.occupied_ratio,
            histogram: report.probability_histogram.clone(),
            unobserved: (known - seen).round().max(0.0) as u64,
        }
    }
}

fn policy(report: &PolicyReport, roc: &[RocPoint]) -> PolicyScores {
    PolicyScores {
        auc: report.auc,
        auc_26: report.auc_26,
        mcc: report.mcc,
        precision: report.precision,
        recall: report.recall,
        f1: report.f1,
        roc: roc.iter().map(|point| [point.fpr, point.tpr]).collect(),
    }
}

impl MapRecord {
    /// The facts, if the map was built.
    pub fn built(&self) -> Option<&Built> {
        match &self.result {
            MapResult::Built(built) => Some(built),
            MapResult::BeyondMemory { .. } => None,
        }
    }

    /// The scores, if the map was built and compared.
    pub fn scores(&self) -> Option<&Scores> {
        self.built()?.scores.as_ref()
    }

    /// Keeps the record in a file.
    pub fn save(&self, out: &OutputFolder, name: &str) -> Result<(), Failure> {
        let text = serde_json::to_string(self).map_err(Failure::running)?;
        out.write(name, text)
    }

    /// The record of an earlier sweep, if it is whole and of the same work.
    pub fn load(path: &Path, fingerprint: &str) -> Option<Self> {
        let text = std::fs::read_to_string(path).ok()?;
        let record: Self = serde_json::from_str(&text).ok()?;
        (record.fingerprint == fingerprint).then_some(record)
    }
}
