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
    match sorted.len() {
        0 => None,
        n if n % 2 == 1 => Some(sorted[n / 2]),
        n => Some(0.5 * (sorted[n / 2 - 1] + sorted[n / 2])),
    }
}

/// As [`median`], of values too many to be kept: they are made anew whenever they are looked at,
/// seven times in all, always the same in the same order.
pub(crate) fn median_of_many<I: Iterator<Item = f64>>(values: impl Fn() -> I) -> Option<f64> {
    let n = values().count();
    if n == 0 {
        return None;
    }
    let low = ranked(&values, (n - 1) / 2);
    if n % 2 == 1 {
        return Some(low);
    }
    let num_up_to_low = values().filter(|v| v.total_cmp(&low).is_le()).count();
    let above = values().filter(|v| v.total_cmp(&low).is_gt());
    let next = above.min_by(f64::total_cmp);
    let high = next.filter(|_| num_up_to_low <= n / 2);
    Some(0.5 * (low + high.unwrap_or(low)))
}

/// As [`robust_deviation`], of values that are made anew as in [`median_of_many`], which gave
/// `centre`.
pub(crate) fn robust_deviation_of_many<I: Iterator<Item = f64>>(
    values: impl Fn() -> I,
    centre: f64,
) -> Option<f64> {
    let deviations = || values().map(|v| (v - centre).abs());
    median_of_many(deviations).map(|mad| SIGMA_BY_MAD * mad)
}

/// The value that so many others come before: its bits are found sixteen at a time, by counting.
fn ranked<I: Iterator<Item = f64>>(values: impl Fn() -> I, mut rank: usize) -> f64 {
    let mut prefix = 0;
    for shift in [48, 32, 16, 0] {
        let mut counts = vec![0_usize; 1 << 16];
        for place in values().map(place) {
            if (place >> shift) >> 16 == prefix {
                counts[(place >> shift) as usize & 0xffff] += 1;
            }
        }
        let mut digit = 0;
        while digit < 0xffff && rank >= counts[digit] {
            rank -= counts[digit];
            digit += 1;
        }
        prefix = prefix << 16 | digit as u64;
    }
    value_at(prefix)
}

const SIGN: u64 = 1 << 63;

/// A number that grows with the value.
fn place(value: f64) -> u64 {
    let bits = value.to_bits();
    if bits & SIGN == 0 { bits | SIGN } else { !bits }
}

fn value_at(place: u64) -> f64 {
    let is_negative = place & SIGN == 0;
    f64::from_bits(if is_negative { !place } else { place & !SIGN })
}

/// Standard deviation of a normal distribution by its median absolute deviation.
const SIGMA_BY_MAD: f64 = 1.482_602_218_505_602;

/// 1.4826 times the median absolute deviation from the median: the standard deviation of a normal
/// distribution, blind to outliers. `None` when there are no values.
#[must_use]
pub fn robust_deviation(values: &[f64]) -> Option<f64> {
    let centre = median(values)?;
    let deviations: Vec<f64> = values.iter().map(|v| (v - centre).abs()).collect();
    median(&deviations).map(|mad| SIGMA_BY_MAD * mad)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn median_of_many_is_that_of_the_sorted_values() {
        let mut seed = 7_u64;
        let mut random = || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (seed >> 40) as f64 / f64::from(1 << 20) - 8.0
        };
        for n in [1, 2, 3, 4, 9, 100, 1001] {
            for levels in [1.0, 1e9] {
                // few levels: the middle values are alike, or negative and positive
                let values: Vec<f64> = (0..n)
                    .map(|_| (random() * levels).round() / levels)
                    .collect();
                let many = || values.iter().copied();
                let of_many = median_of_many(many).expect("not empty");
                assert_eq!(Some(of_many), median(&values), "{values:?}");
                assert_eq!(
                    robust_deviation_of_many(many, of_many),
                    robust_deviation(&values)
                );
            }
        }
        let special = [-0.0, 0.0, f64::NEG_INFINITY, f64::MAX, -1e-310, 1e-310];
        assert_eq!(
            median_of_many(|| special.into_iter()).map(f64::to_bits),
            median(&special).map(f64::to_bits)
        );
        assert_eq!(median_of_many(std::iter::empty), None);
    }

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
