//! Summaries of lists of numbers, as NumPy computes them.

use serde::Serialize;

/// Summary of a list of errors, in the unit of the errors.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ErrorSummary {
    /// Root of the mean square.
    pub rmse: f64,
    /// Arithmetic mean.
    pub mean: f64,
    /// Median; the mean of the two middle values of an even number.
    pub median: f64,
    /// Standard deviation over all values (divisor n, as `numpy.std`).
    pub std: f64,
    /// Largest value.
    pub max: f64,
    /// Smallest value.
    pub min: f64,
}

impl ErrorSummary {
    /// Summary of `errors`; `None` when there are none.
    #[must_use]
    pub fn of(errors: &[f64]) -> Option<Self> {
        let median = median(errors)?;
        let n = errors.len() as f64;
        let mean = errors.iter().sum::<f64>() / n;
        let mean_sq = errors.iter().map(|e| e * e).sum::<f64>() / n;
        let variance = errors.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / n;
        Some(Self {
            rmse: mean_sq.sqrt(),
            mean,
            median,
            std: variance.sqrt(),
            max: errors.iter().copied().fold(f64::NEG_INFINITY, f64::max),
            min: errors.iter().copied().fold(f64::INFINITY, f64::min),
        })
    }
}

/// Median of `values` in any order; the mean of the two middle ones of an even number. `None` when
/// there are none.
#[must_use]
pub fn median(values: &[f64]) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let n = sorted.len();
    match n {
        0 => None,
        _ if n % 2 == 1 => Some(sorted[n / 2]),
        _ => Some(0.5 * (sorted[n / 2 - 1] + sorted[n / 2])),
    }
}

/// 1.4826 times the median absolute deviation from the median: the standard deviation of a normal
/// distribution, blind to outliers. `None` when there are no values.
#[must_use]
pub fn robust_deviation(values: &[f64]) -> Option<f64> {
    let centre = median(values)?;
    let deviations: Vec<f64> = values.iter().map(|v| (v - centre).abs()).collect();
    median(&deviations).map(|mad| 1.482_602_218_505_602 * mad)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn summary_of_known_numbers() {
        let summary = ErrorSummary::of(&[4.0, 1.0, 2.0, 3.0]).expect("not empty");
        assert_eq!(summary.median, 2.5);
        assert_eq!(summary.mean, 2.5);
        assert_eq!((summary.min, summary.max), (1.0, 4.0));
        assert!((summary.rmse - 7.5_f64.sqrt()).abs() < 1e-15);
        assert!((summary.std - 1.25_f64.sqrt()).abs() < 1e-15);
        assert!(ErrorSummary::of(&[]).is_none());
    }

    #[test]
    fn robust_deviation_ignores_an_outlier_that_ruins_the_plain_one() {
        let mut values: Vec<f64> = (-50..=50).map(f64::from).collect();
        let clean = robust_deviation(&values).expect("not empty");
        values.push(1e9);
        let dirty = robust_deviation(&values).expect("not empty");
        assert!((clean - 25.0 * 1.482_602_218_505_602).abs() < 1e-9);
        assert!((dirty - clean).abs() < 1.0);
    }
}
