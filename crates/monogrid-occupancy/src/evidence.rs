//! Evidence: log-odds as 16-bit integers of 1/4096, with an explicit "unknown".

use crate::error::MapError;

/// Steps of evidence per unit of log-odds.
pub const STEPS_PER_LOG_ODDS: f32 = 4096.0;
/// The stored value of a cell that was never observed.
pub const UNKNOWN: i16 = i16::MIN;

/// Log-odds of a probability: `ln(p / (1 - p))`.
#[must_use]
pub fn log_odds_from_probability(probability: f64) -> f64 {
    (probability / (1.0 - probability)).ln()
}

/// Probability of a log-odds value.
#[must_use]
pub fn probability_from_log_odds(log_odds: f64) -> f64 {
    1.0 / (1.0 + (-log_odds).exp())
}

/// Nearest evidence, saturating at the ends of the range and never [`UNKNOWN`].
#[must_use]
pub fn evidence_from_log_odds(log_odds: f64) -> i16 {
    let steps = (log_odds * f64::from(STEPS_PER_LOG_ODDS)).round();
    // `as` saturates and maps NaN to 0.
    (steps as i16).max(UNKNOWN + 1)
}

/// Log-odds of stored evidence; the caller has excluded [`UNKNOWN`].
#[must_use]
#[inline]
pub fn log_odds_from_evidence(evidence: i16) -> f32 {
    f32::from(evidence) / STEPS_PER_LOG_ODDS
}

/// What is known about a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Occupancy {
    /// Never observed.
    Unknown,
    /// Observed, and less likely occupied than the threshold.
    Free,
    /// Observed, and at least as likely occupied as the threshold.
    Occupied,
}

/// The stored limits of a map, in evidence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Limits {
    pub min: i16,
    pub max: i16,
    pub threshold: i16,
}

impl Limits {
    pub(crate) fn new(
        clamp_min: f32,
        clamp_max: f32,
        threshold_probability: f64,
    ) -> Result<Self, MapError> {
        let storable = |v: f32| (-7.99..=7.99).contains(&v);
        if !(storable(clamp_min) && storable(clamp_max) && clamp_min < 0.0 && clamp_max > 0.0) {
            return Err(MapError::Clamp {
                min: clamp_min,
                max: clamp_max,
            });
        }
        if !(threshold_probability > 0.0 && threshold_probability < 1.0) {
            return Err(MapError::Threshold {
                value: threshold_probability,
            });
        }
        Ok(Self {
            min: evidence_from_log_odds(f64::from(clamp_min)),
            max: evidence_from_log_odds(f64::from(clamp_max)),
            threshold: evidence_from_log_odds(log_odds_from_probability(threshold_probability)),
        })
    }

    /// `value` after one update, clamped when written as OctoMap does.
    ///
    /// A value outside the limits (from a file with wider ones) is pulled inside by its next
    /// update.
    #[inline]
    pub(crate) fn updated(self, value: i16, delta: i16) -> i16 {
        self.rule([0, 0]).updated(value, delta)
    }

    /// How measurements change cells within these limits.
    pub(crate) fn rule(self, updates_to_belief: [u8; 2]) -> UpdateRule {
        let bound = |updates: u8| match updates {
            // farther than any limit
            0 => i32::from(i16::MAX),
            updates => i32::from(updates),
        };
        UpdateRule {
            limits: self,
            bounds: updates_to_belief.map(bound),
        }
    }

    /// As OctoMap: exactly at the threshold counts as occupied.
    #[inline]
    pub(crate) fn occupancy(self, value: i16) -> Occupancy {
        if value == UNKNOWN {
            Occupancy::Unknown
        } else if value >= self.threshold {
            Occupancy::Occupied
        } else {
            Occupancy::Free
        }
    }
}

/// How a measurement changes a cell: within the limits of the map, and no farther than so many
/// times the update.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct UpdateRule {
    pub limits: Limits,
    /// Multiples of an update that a cell is brought to at most, by updates for free and for
    /// occupied.
    bounds: [i32; 2],
}

impl UpdateRule {
    /// `value` after one measurement, which cannot take back what others said in its own sense.
    #[inline(always)]
    pub(crate) fn updated(self, value: i16, delta: i16) -> i16 {
        let Limits { min, max, .. } = self.limits;
        let prior = if value == UNKNOWN {
            0
        } else {
            i32::from(value)
        };
        let delta = i32::from(delta);
        let [least, most] = self.bounds.map(|bound| delta * bound);
        let after = if delta < 0 {
            prior.min((prior + delta).max(least))
        } else {
            prior.max((prior + delta).min(most))
        };
        after.clamp(min.into(), max.into()) as i16
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn evidence_saturates_and_never_means_unknown() {
        assert_eq!(evidence_from_log_odds(-1e9), UNKNOWN + 1);
        assert_eq!(evidence_from_log_odds(f64::NEG_INFINITY), UNKNOWN + 1);
        assert_eq!(evidence_from_log_odds(1e9), i16::MAX);
        assert_eq!(evidence_from_log_odds(f64::NAN), 0);
        assert_eq!(evidence_from_log_odds(-2.0), -8192);
    }

    #[test]
    fn probability_and_log_odds_invert_each_other() {
        for p in [1e-6, 0.1192, 0.3, 0.5, 0.971, 1.0 - 1e-6] {
            let back = probability_from_log_odds(log_odds_from_probability(p));
            assert!((back - p).abs() < 1e-12, "{p} {back}");
        }
    }

    #[test]
    fn equal_measurements_bring_a_cell_to_what_they_say_and_no_farther() {
        let rule = Limits::new(-2.0, 3.5, 0.5).unwrap().rule([10, 3]);
        let after = |times: usize, delta: i16, from: i16| {
            (0..times).fold(from, |value, _| rule.updated(value, delta))
        };
        assert_eq!(
            [1, 2, 3, 9].map(|n| after(n, 1000, UNKNOWN)),
            [1000, 2000, 3000, 3000]
        );
        assert_eq!(
            [1, 10, 11].map(|n| after(n, -50, UNKNOWN)),
            [-50, -500, -500]
        );
        // what others said stays where a measurement says less in the same sense
        assert_eq!(after(5, 100, 2000), 2000);
        assert_eq!(after(5, -50, -4000), -4000);
        // against it, it counts as ever, up to its own belief
        assert_eq!(after(2, -500, 2000), 1000);
        assert_eq!(after(99, -500, 2000), -5000);
        // the limits of the map are above all
        assert_eq!(after(99, 12_000, 0), rule.limits.max);
        assert_eq!(rule.updated(20_000, -1), rule.limits.max);
    }

    #[test]
    fn one_update_starts_an_unknown_cell_at_zero_and_clamps() {
        let limits = Limits::new(-2.0, 3.5, 0.5).unwrap();
        assert_eq!(limits.updated(UNKNOWN, 100), 100);
        assert_eq!(limits.updated(UNKNOWN, i16::MAX), limits.max);
        assert_eq!(limits.updated(limits.max, i16::MIN + 1), limits.min);
        let rule = limits.rule([0, 0]);
        assert_eq!(rule.updated(UNKNOWN, 100), 100);
        assert_eq!(rule.updated(UNKNOWN, i16::MAX), limits.max);
        assert_eq!(rule.updated(3000, -500), 2500);
        assert_eq!(rule.updated(limits.max, i16::MIN + 1), limits.min);
        assert_eq!(limits.occupancy(UNKNOWN), Occupancy::Unknown);
        assert_eq!(limits.occupancy(0), Occupancy::Occupied);
        assert_eq!(limits.occupancy(-1), Occupancy::Free);
    }
}
