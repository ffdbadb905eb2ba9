//! Tables of evidence over `range - measured_range`, one per bin of sigma.
//!
//! Bins are 4 % wide on a logarithmic scale, so the sigma of a table is within 2 % of the
//! measurement's. An entry holds the model's limited log-odds at its centre; entries are sigma/64
//! wide. The tests bound the difference to the exact model.

use super::{SensorModel, ThrunForm};
use crate::error::MapError;
use crate::evidence::evidence_from_log_odds;

/// Ratio of neighbouring bins of sigma.
const BIN_RATIO: f64 = 1.04;
/// Sigmas outside these are counted as these, in map units. With the ratio: 763 bins.
const SIGMA_RANGE: (f64, f64) = (1e-9, 1e4);
/// Entries per sigma.
const ENTRIES_PER_SIGMA: f64 = 64.0;
/// Entries of the longest table; bands that are very thick against sigma get coarser ones.
const MAX_ENTRIES: f64 = 16384.0;
/// Thesis' form differs from the exact one by less than 1e-9 for ranges beyond this many sigmas.
const THESIS_TAIL_SIGMAS: f64 = 6.0;

/// Limits and cut of the evidence of one measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct UpdateLimits {
    pub min: f64,
    pub max: f64,
    /// Behind the obstacle, evidence smaller than this ends the ray.
    pub cutoff: f64,
}

/// Evidence of one measurement as a function of `range - measured_range`.
#[derive(Clone, Debug)]
pub(crate) struct EvidenceTable {
    /// Evidence before the first entry: free space.
    pub free: i16,
    /// Where the first entry begins, relative to the measured range, in map units.
    pub start: f64,
    /// Entries per map unit.
    pub inv_step: f64,
    /// Entries; beyond the last one nothing is known.
    pub entries: Vec<i16>,
}

impl EvidenceTable {
    fn new(model: &SensorModel, sigma: f64, limits: UpdateLimits) -> Self {
        let reach = model.reach_behind(sigma);
        // In front, the models are constant to within the limits beyond the same distance, plus
        // the half band that Thrun's reach already holds.
        let front = -(reach + 3.0 * sigma);
        let step = (sigma / ENTRIES_PER_SIGMA).max((reach - front) / MAX_ENTRIES);
        let count = ((reach - front) / step).ceil().max(1.0) as usize;
        // Far enough for the shift-invariant part of every model.
        let z = 1e3 * (reach + sigma) + 1.0;
        let at = |x: f64| {
            let log_odds = match model {
                SensorModel::None => 0.0,
                _ => model.log_odds(z + x, z, sigma, (limits.min, limits.max)),
            };
            evidence_from_log_odds(log_odds)
        };
        let mut entries: Vec<i16> = (0..count)
            .map(|i| at(front + (i as f64 + 0.5) * step))
            .collect();
        let cutoff = evidence_from_log_odds(limits.cutoff);
        let kept = entries
            .iter()
            .rposition(|&e| e.unsigned_abs() >= cutoff.unsigned_abs().max(1))
            .map_or(0, |last| last + 1);
        entries.truncate(kept);
        let free = at(front - sigma);
        let first = entries.iter().position(|&e| e != free).unwrap_or(kept);
        entries.drain(..first);
        Self {
            free,
            start: front + first as f64 * step,
            inv_step: 1.0 / step,
            entries,
        }
    }

    /// Distance behind the measured range at which the table ends.
    pub(crate) fn end(&self) -> f64 {
        self.start + self.entries.len() as f64 / self.inv_step
    }

    /// Evidence at `range - measured_range = x`; 0 behind the band.
    #[inline]
    pub(crate) fn lookup(&self, x: f64) -> i16 {
        let offset = (x - self.start) * self.inv_step;
        if offset < 0.0 {
            self.free
        } else {
            self.entries.get(offset as usize).copied().unwrap_or(0)
        }
    }
}

/// How the evidence of a measurement is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Lookup {
    /// In the table of this index.
    Table(u16),
    /// From the exact model, because it is no function of `range - measured_range` alone.
    Exact,
}

/// The tables that a set of measurements needs, made on demand.
#[derive(Clone, Debug)]
pub(crate) struct TableSet {
    model: SensorModel,
    limits: UpdateLimits,
    tables: Vec<EvidenceTable>,
    /// Table of each bin, by `bin - first bin`; `u16::MAX` where none was needed yet.
    index_of_bin: Vec<u16>,
}

fn bin_of_sigma(sigma: f64) -> usize {
    let clamped = sigma.clamp(SIGMA_RANGE.0, SIGMA_RANGE.1);
    ((clamped / SIGMA_RANGE.0).ln() / BIN_RATIO.ln()).round() as usize
}

fn sigma_of_bin(bin: usize) -> f64 {
    SIGMA_RANGE.0 * BIN_RATIO.powf(bin as f64)
}

impl TableSet {
    /// An empty set for a model that is already at its resolution.
    ///
    /// # Errors
    /// The model's fields are outside their ranges.
    pub(crate) fn new(model: SensorModel, limits: UpdateLimits) -> Result<Self, MapError> {
        model.validate()?;
        Ok(Self {
            model,
            limits,
            tables: Vec::new(),
            index_of_bin: vec![u16::MAX; bin_of_sigma(SIGMA_RANGE.1) + 1],
        })
    }

    /// The table for a measurement, made if it is the first of its bin.
    pub(crate) fn prepare(&mut self, measured_range: f64, sigma: f64) -> Lookup {
        let thesis_tail = matches!(
            self.model,
            SensorModel::Thrun {
                form: ThrunForm::Thesis,
                ..
            }
        ) && measured_range < THESIS_TAIL_SIGMAS * sigma;
        if thesis_tail || !self.model.is_shift_invariant() {
            return Lookup::Exact;
        }
        let bin = bin_of_sigma(sigma);
        if self.index_of_bin[bin] == u16::MAX {
            self.index_of_bin[bin] = self.tables.len() as u16;
            self.tables.push(EvidenceTable::new(
                &self.model,
                sigma_of_bin(bin),
                self.limits,
            ));
        }
        Lookup::Table(self.index_of_bin[bin])
    }

    #[inline]
    pub(crate) fn table(&self, index: u16) -> &EvidenceTable {
        &self.tables[usize::from(index)]
    }

    /// Exact evidence of a measurement whose lookup is [`Lookup::Exact`].
    pub(crate) fn exact(&self, range: f64, measured_range: f64, sigma: f64) -> i16 {
        let limits = (self.limits.min, self.limits.max);
        let log_odds = self.model.log_odds(range, measured_range, sigma, limits);
        if range > measured_range && log_odds.abs() < self.limits.cutoff {
            return 0;
        }
        evidence_from_log_odds(log_odds)
    }

    /// Distance behind the measured range that a measurement can change.
    pub(crate) fn reach_behind(&self, lookup: Lookup, measured_range: f64, sigma: f64) -> f64 {
        match lookup {
            Lookup::Table(index) => self.table(index).end(),
            // A Gaussian in inverse range reaches 1/(1/z - reach/z^2), at most to infinity:
            // twice the range is the limit there.
            Lookup::Exact => {
                let share = self.model.reach_behind(sigma) / measured_range;
                if share < 0.5 {
                    measured_range * share / (1.0 - share)
                } else {
                    measured_range
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::log_odds_from_evidence;
    use crate::sensor::{Buffer, Significance};

    fn worst_difference(model: SensorModel, limits: UpdateLimits, sigmas: &[f64]) -> f64 {
        let mut set = TableSet::new(model, limits).unwrap();
        let z = 40.0;
        let mut worst: f64 = 0.0;
        for &sigma in sigmas {
            // Compared at the bin's own sigma: the error of the table alone.
            let sigma = sigma_of_bin(bin_of_sigma(sigma));
            let Lookup::Table(index) = set.prepare(z, sigma) else {
                panic!("{model:?} should have a table");
            };
            let table = set.table(index);
            for i in -4000..4000 {
                let x = f64::from(i) * 0.0037 * sigma;
                let exact = model.log_odds(z + x, z, sigma, (limits.min, limits.max));
                let stored = f64::from(log_odds_from_evidence(table.lookup(x)));
                let cut = x > table.end() && exact.abs() <= limits.cutoff + 1e-3;
                if !cut {
                    worst = worst.max((exact - stored).abs());
                }
            }
        }
        worst
    }

    const DEFAULT: UpdateLimits = UpdateLimits {
        min: -0.6,
        max: 1.2,
        cutoff: 0.02,
    };

    #[test]
    fn tables_of_smooth_models_follow_the_exact_model() {
        let sigmas = [0.003, 0.02, 0.11, 0.4];
        for buffer in [Buffer::Fixed(0.08), Buffer::Fixed(0.45), Buffer::AUTO] {
            let model = SensorModel::Thrun {
                buffer,
                form: ThrunForm::Exact,
            };
            let worst = worst_difference(model, DEFAULT, &sigmas);
            assert!(worst < 0.04, "{model:?}: {worst}");
            let wide = UpdateLimits {
                min: -2.0,
                max: 3.5,
                cutoff: 0.02,
            };
            let worst = worst_difference(model, wide, &sigmas);
            assert!(worst < 0.08, "{model:?}: {worst}");
        }
    }

    #[test]
    fn tables_of_andert_follow_the_exact_model_but_at_its_jump() {
        // P jumps by up to (peak - base) only in slope at r = z: continuous, so the same bound.
        let model = SensorModel::Andert {
            significance: Significance::Fixed(0.02),
            p_min: 0.3,
            form: super::super::AndertForm::Monocular,
        };
        let limits = UpdateLimits {
            min: -0.9,
            max: 3.5,
            cutoff: 0.02,
        };
        let worst = worst_difference(model, limits, &[0.02, 0.11, 0.4]);
        assert!(worst < 0.04, "{worst}");
    }

    #[test]
    fn a_bin_is_within_two_percent_of_every_sigma_in_it() {
        for i in 0..2000 {
            let sigma = 1e-4 * 1.005_f64.powi(i);
            let ratio = sigma_of_bin(bin_of_sigma(sigma)) / sigma;
            assert!((0.98..1.0201).contains(&ratio), "{sigma} {ratio}");
        }
    }

    #[test]
    fn free_space_and_the_space_behind_are_constant() {
        let mut set = TableSet::new(SensorModel::THRUN.at_resolution(0.05), DEFAULT).unwrap();
        let Lookup::Table(index) = set.prepare(3.0, 0.02) else {
            panic!("a table");
        };
        let table = set.table(index);
        assert_eq!(table.lookup(-2.5), evidence_from_log_odds(-0.6));
        assert_eq!(table.lookup(10.0), 0);
        assert!(table.entries.len() < 2000);
    }
}
