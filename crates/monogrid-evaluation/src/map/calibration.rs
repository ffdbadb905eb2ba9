//! Do probabilities mean what they say?

use super::scores::ScoreGroup;
use serde::Serialize;

/// Bins of the reliability diagram.
const BINS: usize = 10;

/// One bin of the reliability diagram.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ReliabilityBin {
    /// Least probability of the bin.
    pub from: f64,
    /// Greatest probability of the bin.
    pub to: f64,
    /// Cells in it.
    pub cells: u64,
    /// Their mean predicted probability; `None` when there are none.
    pub predicted: Option<f64>,
    /// The share of them that is occupied; `None` when there are none.
    pub occupied: Option<f64>,
}

/// Calibration over the observed cells whose truth is known.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Calibration {
    /// Mean of (p - truth)²; `None` when there are no such cells.
    pub brier: Option<f64>,
    /// Mean of -ln(probability of the truth); `None` when there are no such cells.
    pub negative_log_likelihood: Option<f64>,
    /// Mean distance between predicted and true share over the bins, weighted by their cells.
    pub expected_error: Option<f64>,
    /// Ten bins of equal width.
    pub reliability: Vec<ReliabilityBin>,
}

#[derive(Clone, Copy, Default)]
struct Bin {
    cells: u64,
    positives: u64,
    sum_probability: f64,
}

/// Calibration of scores in which no probability is exactly 0 or 1.
pub(crate) fn calibration(groups: &[ScoreGroup]) -> Calibration {
    let mut bins = [Bin::default(); BINS];
    let (mut cells, mut square, mut log) = (0_u64, 0.0, 0.0);
    for group in groups {
        let p = group.probability;
        let (positives, negatives) = (group.positives as f64, group.negatives as f64);
        cells += group.positives + group.negatives;
        square += positives * (1.0 - p).powi(2) + negatives * p.powi(2);
        if group.positives > 0 {
            log -= positives * p.ln();
        }
        if group.negatives > 0 {
            log -= negatives * (1.0 - p).ln();
        }
        let bin = &mut bins[((p * BINS as f64) as usize).min(BINS - 1)];
        bin.cells += group.positives + group.negatives;
        bin.positives += group.positives;
        bin.sum_probability += p * (positives + negatives);
    }
    let mean = |sum: f64| (cells > 0).then(|| sum / cells as f64);
    let gap = |bin: &Bin| (bin.sum_probability - bin.positives as f64).abs();
    let gap: f64 = bins.iter().map(gap).sum();
    Calibration {
        brier: mean(square),
        negative_log_likelihood: mean(log),
        expected_error: mean(gap),
        reliability: bins.iter().enumerate().map(|(i, b)| bin(i, b)).collect(),
    }
}

fn bin(index: usize, bin: &Bin) -> ReliabilityBin {
    let share = |sum: f64| (bin.cells > 0).then(|| sum / bin.cells as f64);
    ReliabilityBin {
        from: index as f64 / BINS as f64,
        to: (index + 1) as f64 / BINS as f64,
        cells: bin.cells,
        predicted: share(bin.sum_probability),
        occupied: share(bin.positives as f64),
    }
}
