//! Occupied or free as a classification: counts at a threshold, ROC curve, area under it.

use super::scores::ScoreGroup;
use serde::Serialize;

/// Thresholds of the thesis: 0, 0.04, ..., 1.
pub(crate) const NUM_THRESHOLDS: usize = 26;

/// Cells by prediction and truth; occupied is positive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Contingency {
    /// Predicted and truly occupied.
    pub tp: u64,
    /// Predicted occupied, truly free.
    pub fp: u64,
    /// Predicted and truly free.
    pub tn: u64,
    /// Predicted free, truly occupied.
    #[serde(rename = "fn")]
    pub fn_: u64,
}

impl Contingency {
    /// Counts when everything above `threshold` is predicted occupied.
    pub(crate) fn at(groups: &[ScoreGroup], threshold: f64) -> Self {
        let mut counts = Self::default();
        for group in groups {
            if group.probability > threshold {
                counts.tp += group.positives;
                counts.fp += group.negatives;
            } else {
                counts.fn_ += group.positives;
                counts.tn += group.negatives;
            }
        }
        counts
    }

    /// tp/(tp + fn), the share of occupied cells that were found; 0 when there are none.
    #[must_use]
    pub fn recall(&self) -> f64 {
        ratio(self.tp, self.tp + self.fn_)
    }

    /// tp/(tp + fp), the share of predicted cells that are occupied; 0 when none is predicted.
    #[must_use]
    pub fn precision(&self) -> f64 {
        ratio(self.tp, self.tp + self.fp)
    }

    /// tn/(tn + fp), the share of free cells that were found; 0 when there are none.
    #[must_use]
    pub fn specificity(&self) -> f64 {
        ratio(self.tn, self.tn + self.fp)
    }

    /// Harmonic mean of precision and recall; 0 when both are.
    #[must_use]
    pub fn f1(&self) -> f64 {
        ratio(2 * self.tp, 2 * self.tp + self.fp + self.fn_)
    }

    /// Intersection over union of predicted and truly occupied cells; 0 when there are none.
    #[must_use]
    pub fn iou(&self) -> f64 {
        ratio(self.tp, self.tp + self.fp + self.fn_)
    }

    /// Matthews correlation coefficient; 0 when a row or column of the table is empty.
    #[must_use]
    pub fn mcc(&self) -> f64 {
        let [tp, fp, tn, fn_] = [self.tp, self.fp, self.tn, self.fn_].map(|n| n as f64);
        // One root over both products, so that a perfect map scores exactly 1.
        let norm = (((tp + fp) * (tn + fn_)) * ((tp + fn_) * (tn + fp))).sqrt();
        let is_defined = norm > 0.0;
        if is_defined {
            (tp * tn - fp * fn_) / norm
        } else {
            0.0
        }
    }
}

/// 0 of nothing.
fn ratio(part: u64, whole: u64) -> f64 {
    part as f64 / whole.max(1) as f64
}

/// One point of a ROC curve.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RocPoint {
    /// Cells above this probability are predicted occupied.
    pub threshold: f64,
    /// True positive rate (recall).
    pub tpr: f64,
    /// False positive rate (1 - specificity).
    pub fpr: f64,
}

/// The curve at the thesis' 26 thresholds, in their order.
pub(crate) fn roc_26(groups: &[ScoreGroup]) -> Vec<RocPoint> {
    let point = |i| {
        let threshold = i as f64 / (NUM_THRESHOLDS - 1) as f64;
        let counts = Contingency::at(groups, threshold);
        RocPoint {
            threshold,
            tpr: counts.recall(),
            fpr: ratio(counts.fp, counts.fp + counts.tn),
        }
    };
    (0..NUM_THRESHOLDS).map(point).collect()
}

/// Area under the straight lines between the points of a curve, completed with (0, 0) and (1, 1);
/// 0.5 when positives or negatives are missing.
pub(crate) fn trapezoid(roc: &[RocPoint], groups: &[ScoreGroup]) -> f64 {
    let (positives, negatives) = totals(groups);
    if positives == 0 || negatives == 0 {
        return 0.5;
    }
    // Thresholds ascend, so the curve runs from (1, 1) to (0, 0).
    let mut area = 0.0;
    let mut last = (1.0, 1.0);
    for (fpr, tpr) in roc.iter().map(|p| (p.fpr, p.tpr)).chain([(0.0, 0.0)]) {
        area += (last.0 - fpr) * (last.1 + tpr) / 2.0;
        last = (fpr, tpr);
    }
    area
}

/// Exact area under the ROC curve, the probability that an occupied cell scores higher than a free
/// one, ties counted half (Mann and Whitney); 0.5 when positives or negatives are missing.
pub(crate) fn rank_auc(groups: &[ScoreGroup]) -> f64 {
    let (positives, negatives) = totals(groups);
    if positives == 0 || negatives == 0 {
        return 0.5;
    }
    let mut negatives_below = 0_u64;
    let mut twice_wins = 0_u128;
    for group in groups {
        let beaten = 2 * u128::from(negatives_below) + u128::from(group.negatives);
        twice_wins += u128::from(group.positives) * beaten;
        negatives_below += group.negatives;
    }
    twice_wins as f64 / (2.0 * positives as f64 * negatives as f64)
}

/// The threshold, among the scores themselves, with the largest F1, and that F1.
pub(crate) fn best_f1(groups: &[ScoreGroup]) -> (f64, f64) {
    let (positives, _) = totals(groups);
    let (mut tp, mut fp) = (0, 0);
    let mut best = (1.0, 0.0);
    for (index, group) in groups.iter().enumerate().rev() {
        tp += group.positives;
        fp += group.negatives;
        let f1 = ratio(2 * tp, tp + fp + positives);
        if f1 > best.1 {
            let below = index.checked_sub(1).map_or(0.0, |i| groups[i].probability);
            best = (0.5 * (below + group.probability), f1);
        }
    }
    best
}

fn totals(groups: &[ScoreGroup]) -> (u64, u64) {
    groups
        .iter()
        .fold((0, 0), |(p, n), g| (p + g.positives, n + g.negatives))
}
