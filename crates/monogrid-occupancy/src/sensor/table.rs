//! Tables of evidence over `range - measured_range`, one per bin of sigma.
//!
//! A bin is a value of the exponent and the five highest mantissa bits of sigma as `f32`, so the
//! sigma of a table is within 1.6 % of the measurement's. An entry holds the limited update by the
//! model's log-odds at its centre; entries are sigma/64 wide. Models that also depend on how
//! uncertain the range is relative to itself get one table per bin of sigma and of `range / sigma`.
//! The tests bound the difference to the exact model.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use super::{SensorModel, ThrunForm};
use crate::error::MapError;
use crate::evidence::{Limits, UpdateRule, evidence_from_log_odds};
use crate::integrate::IntegrationConfig;

/// Bits of an `f32` dropped by its bin.
const BIN_SHIFT: u32 = 18;
/// Entries per sigma.
const ENTRIES_PER_SIGMA: f64 = 64.0;
/// Entries of the longest table; bands that are very thick against sigma get coarser ones.
const MAX_ENTRIES: f64 = 16384.0;
/// Thesis' form differs from the exact one by less than 1e-9 for ranges beyond this many sigmas.
const THESIS_TAIL_SIGMAS: f32 = 6.0;
/// Ranges beyond this many sigmas are far enough for every model to be a function of
/// `range - measured_range`: the skew of inverse depth and the growth of a stereo camera's sigma
/// are then below 1 % within 4 sigma.
const FAR_SIGMAS: f32 = 400.0;
/// Tables that are remembered for the next scans: more than the uncertainties of a sensor need.
const MAX_KNOWN: usize = 1024;

/// Limits and cut of the evidence of one measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct UpdateLimits {
    pub min: f64,
    pub max: f64,
    /// Behind the obstacle, log-odds smaller than this end the ray.
    pub cutoff: f64,
    /// So many updates bring a cell to the log-odds that a measurement states, for free and for
    /// occupied; 0: one does.
    pub to_belief: [u8; 2],
}

impl UpdateLimits {
    /// The update by a measurement of these log-odds.
    fn update(&self, stated: f64) -> f64 {
        let [free, occupied] = self.updates();
        let updates = if stated > 0.0 { occupied } else { free };
        (stated / updates).clamp(self.min, self.max)
    }

    /// Stated log-odds beyond which updates are the same.
    fn stated(&self) -> (f64, f64) {
        let [free, occupied] = self.updates();
        (free * self.min, occupied * self.max)
    }

    /// How many updates say what is stated, for free and for occupied.
    fn updates(&self) -> [f64; 2] {
        self.to_belief.map(|updates| f64::from(updates.max(1)))
    }
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
    /// Tabulates `model` for a measurement of `sigma` at the range `z`.
    fn new(model: &SensorModel, sigma: f64, z: f64, limits: UpdateLimits) -> Self {
        let reach = if model.is_shift_invariant() {
            model.reach_behind(sigma)
        } else {
            // A Gaussian in inverse range reaches 1/(1/z - reach/z^2), at most to infinity:
            // twice the range is the limit there.
            let share = (model.reach_behind(sigma) / z).min(0.5);
            z * share / (1.0 - share)
        };
        // In front, the models are constant to within the limits beyond the same distance, plus
        // the half band that Thrun's reach already holds.
        let front = -(reach + 3.0 * sigma).min(z);
        let step = (sigma / ENTRIES_PER_SIGMA).max((reach - front) / MAX_ENTRIES);
        let count = ((reach - front) / step).ceil().max(1.0) as usize;
        let stated = |x: f64| {
            let range = (z + x).max(1e-6 * z);
            match model {
                SensorModel::None => 0.0,
                _ => model.log_odds(range, z, sigma, limits.stated()),
            }
        };
        let update = |stated: f64| evidence_from_log_odds(limits.update(stated));
        let all = (0..count).map(|i| stated(front + (i as f64 + 0.5) * step));
        let all: Vec<f64> = all.collect();
        let counts = |&stated: &f64| stated.abs() >= limits.cutoff && update(stated) != 0;
        let kept = all.iter().rposition(counts).map_or(0, |last| last + 1);
        let mut entries: Vec<i16> = all[..kept].iter().map(|stated| update(*stated)).collect();
        let free = update(stated(front - sigma));
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
}

/// What a table is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Bins {
    sigma: u32,
    /// Of `range / sigma`, where it matters; else 0.
    ratio: u32,
    /// Of the least length of the band; 0 for that of the model.
    band: u32,
}

/// Tables that earlier scans needed: the next ones need the same, and to make one takes as long as
/// to integrate a thousand measurements. Copies know the same; what is known changes no result.
#[derive(Clone, Debug, Default)]
pub(crate) struct KnownTables(Arc<Mutex<Known>>);

#[derive(Debug, Default)]
struct Known {
    made_for: Option<(SensorModel, UpdateLimits)>,
    tables: BTreeMap<Bins, EvidenceTable>,
}

impl KnownTables {
    /// An empty set for the measurements of a scan in a map with cells of edge `resolution`.
    ///
    /// # Errors
    /// The model's fields are outside their ranges.
    pub(crate) fn set(
        &self,
        config: &IntegrationConfig,
        resolution: f64,
    ) -> Result<TableSet, MapError> {
        let model = config.model.at_resolution(resolution);
        let known = self.clone();
        TableSet::new(model, config.update_limits()).map(|set| TableSet { known, ..set })
    }

    fn table(&self, bins: Bins, model: SensorModel, limits: UpdateLimits) -> EvidenceTable {
        let mut known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if known.made_for != Some((model, limits)) || known.tables.len() > MAX_KNOWN {
            known.made_for = Some((model, limits));
            known.tables.clear();
        }
        let make = || {
            let sigma = bin_center(bins.sigma, BIN_SHIFT);
            let model = match bins.band {
                0 => model,
                band => model.with_least_band(bin_center(band, BAND_SHIFT)),
            };
            let ratio = if bins.ratio == 0 {
                1e3 + model.reach_behind(sigma) / sigma
            } else {
                bin_center(bins.ratio, BIN_SHIFT)
            };
            EvidenceTable::new(&model, sigma, ratio * sigma, limits)
        };
        known.tables.entry(bins).or_insert_with(make).clone()
    }
}

/// The tables that a set of measurements needs, made on demand.
#[derive(Clone, Debug)]
pub(crate) struct TableSet {
    known: KnownTables,
    model: SensorModel,
    limits: UpdateLimits,
    tables: Vec<EvidenceTable>,
    bins_of_tables: Vec<Bins>,
    index_of_bins: BTreeMap<Bins, u16>,
    last: Option<(Bins, u16)>,
}

fn bin(value: f32, shift: u32) -> u32 {
    value.to_bits() >> shift
}

fn bin_center(bin: u32, shift: u32) -> f64 {
    f64::from(f32::from_bits(bin << shift | 1 << (shift - 1)))
}

/// Bins of sigma that share one table where there is one for each band too: 13 % of it.
const COARSER: u32 = 4;
/// Bits of an `f32` dropped by the bin of a band, which is a quarter of an octave wide.
const BAND_SHIFT: u32 = 21;

impl TableSet {
    /// An empty set for a model that is already at its resolution.
    ///
    /// # Errors
    /// The model's fields are outside their ranges.
    fn new(model: SensorModel, limits: UpdateLimits) -> Result<Self, MapError> {
        model.validate()?;
        Ok(Self {
            known: KnownTables::default(),
            model,
            limits,
            tables: Vec::new(),
            bins_of_tables: Vec::new(),
            index_of_bins: BTreeMap::new(),
            last: None,
        })
    }

    /// Index of the table for a measurement, made if it is the first of its bins.
    ///
    /// `range` and `sigma` are positive and finite, in map units.
    #[inline]
    pub(crate) fn prepare(&mut self, range: f32, sigma: f32) -> u16 {
        let needs_range = range < self.far_sigmas() * sigma;
        let ratio = || bin(range / sigma, BIN_SHIFT);
        let bins = Bins {
            sigma: bin(sigma, BIN_SHIFT),
            ratio: if needs_range { ratio() } else { 0 },
            band: 0,
        };
        match self.last {
            Some((last, index)) if last == bins => index,
            _ => self.prepare_bins(bins),
        }
    }

    /// Index of the table for measurements at any range, if they have one.
    #[inline]
    pub(crate) fn prepare_for_all(&mut self, sigma: f32) -> Option<u16> {
        (self.far_sigmas() == 0.0).then(|| self.prepare(f32::MAX, sigma))
    }

    /// Ranges of so many sigmas are far enough not to matter.
    #[inline]
    fn far_sigmas(&self) -> f32 {
        match self.model {
            SensorModel::Thrun {
                form: ThrunForm::Thesis,
                ..
            } => THESIS_TAIL_SIGMAS,
            _ if self.model.is_shift_invariant() => 0.0,
            _ => FAR_SIGMAS,
        }
    }

    fn prepare_bins(&mut self, bins: Bins) -> u16 {
        let index = self.index_of_bins.get(&bins).copied().unwrap_or_else(|| {
            let table = self.known.table(bins, self.model, self.limits);
            self.tables.push(table);
            self.bins_of_tables.push(bins);
            // 8 octaves of both bins at once would be needed to run out of indices.
            let index = u16::try_from(self.tables.len() - 1).unwrap_or(u16::MAX);
            self.index_of_bins.insert(bins, index);
            index
        });
        self.last = Some((bins, index));
        index
    }

    /// Whether bands are as long as measurements are uncertain, at least so long.
    pub(crate) fn has_automatic_band(&self) -> bool {
        self.model.automatic_band().is_some() && self.model.is_shift_invariant()
    }

    /// Index of a table for the measurements of another one, with a band at least as long as given
    /// instead of the model's own.
    pub(crate) fn with_band(&mut self, index: u16, length: f32) -> u16 {
        let bins = self.bins_of_tables[usize::from(index)];
        let sigma = bin_center(bins.sigma, BIN_SHIFT);
        match self.model.automatic_band() {
            // long enough by the uncertainty alone
            Some((sigmas, min)) if sigmas * sigma < min.max(length.into()) => {
                self.prepare_bins(Bins {
                    sigma: bins.sigma / COARSER * COARSER + COARSER / 2,
                    band: bin(length, BAND_SHIFT),
                    ..bins
                })
            }
            _ => index,
        }
    }

    /// How its updates change cells within the limits of a map.
    pub(crate) fn rule(&self, limits: Limits) -> UpdateRule {
        limits.rule(self.limits.to_belief)
    }

    #[inline]
    pub(crate) fn table(&self, index: u16) -> &EvidenceTable {
        &self.tables[usize::from(index)]
    }

    /// All tables, by index.
    pub(crate) fn tables(&self) -> &[EvidenceTable] {
        &self.tables
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::log_odds_from_evidence;
    use crate::sensor::{Buffer, Significance};

    impl EvidenceTable {
        /// Evidence at `range - measured_range = x`; 0 behind the band.
        fn lookup(&self, x: f64) -> i16 {
            let offset = (x - self.start) * self.inv_step;
            if offset < 0.0 {
                self.free
            } else {
                self.entries.get(offset as usize).copied().unwrap_or(0)
            }
        }
    }

    fn worst_difference(model: SensorModel, limits: UpdateLimits, sigmas: &[f64]) -> f64 {
        let mut set = TableSet::new(model, limits).unwrap();
        let z = 40.0;
        let mut worst: f64 = 0.0;
        for &sigma in sigmas {
            // Compared at the bin's own sigma: the error of the table alone.
            let sigma = bin_center(bin(sigma as f32, BIN_SHIFT), BIN_SHIFT);
            let index = set.prepare(z as f32, sigma as f32);
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
        to_belief: [0, 0],
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
                ..DEFAULT
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
            ..DEFAULT
        };
        let worst = worst_difference(model, limits, &[0.02, 0.11, 0.4]);
        assert!(worst < 0.04, "{worst}");
    }

    #[test]
    fn a_share_of_what_is_stated_is_written_where_that_is_not_cut_off() {
        let limits = UpdateLimits {
            min: -0.4,
            max: 1.2,
            cutoff: 0.9,
            to_belief: [15, 3],
        };
        let model = SensorModel::Thrun {
            buffer: Buffer::Fixed(0.1),
            form: ThrunForm::Exact,
        };
        let mut set = TableSet::new(model, limits).unwrap();
        let sigma = bin_center(bin(0.02, BIN_SHIFT), BIN_SHIFT);
        let index = set.prepare(2.0, sigma as f32);
        let table = set.table(index);
        let stated = |x: f64| model.log_odds(2.0 + x, 2.0, sigma, (-20.0, 20.0));
        for (x, share) in [(-0.09, 15.0), (-0.06, 15.0), (0.0, 3.0), (0.04, 3.0)] {
            let written = f64::from(log_odds_from_evidence(table.lookup(x)));
            let expected = (stated(x) / share).clamp(-0.4, 1.2);
            assert!((written - expected).abs() < 0.01, "{x}: {written}");
        }
        assert_eq!(table.lookup(-1.0), evidence_from_log_odds(-0.4));
        let last = table.end();
        assert!((stated(last) - 0.9).abs() < 0.03 && table.lookup(last + 1e-4) == 0);
    }

    #[test]
    fn a_bin_is_within_two_percent_of_every_sigma_in_it() {
        for i in 0..2000 {
            let sigma = 1e-4 * 1.005_f64.powi(i);
            let ratio = bin_center(bin(sigma as f32, BIN_SHIFT), BIN_SHIFT) / sigma;
            assert!((0.984..1.016).contains(&ratio), "{sigma} {ratio}");
        }
    }

    #[test]
    fn tables_of_skewed_models_follow_the_exact_model_at_every_relative_uncertainty() {
        for model in [
            SensorModel::Thrun {
                buffer: Buffer::AUTO,
                form: ThrunForm::InverseDepth,
            },
            SensorModel::Thrun {
                buffer: Buffer::AUTO,
                form: ThrunForm::Thesis,
            },
            SensorModel::Andert {
                significance: Significance::Fixed(0.02),
                p_min: 0.3,
                form: super::super::AndertForm::Stereo,
            },
        ] {
            let mut set = TableSet::new(model, DEFAULT).unwrap();
            for ratio in [3.0, 5.0, 10.0, 30.0, 200.0] {
                let sigma = bin_center(bin(0.05, BIN_SHIFT), BIN_SHIFT);
                let ratio = bin_center(bin(ratio, BIN_SHIFT), BIN_SHIFT);
                let z = ratio * sigma;
                let index = set.prepare(z as f32, sigma as f32);
                let table = set.table(index);
                for i in -300..600 {
                    let x = f64::from(i) * 0.01 * sigma;
                    if z + x <= 0.0 || x >= table.end() {
                        continue;
                    }
                    let exact = model.log_odds(z + x, z, sigma, (DEFAULT.min, DEFAULT.max));
                    let stored = f64::from(log_odds_from_evidence(table.lookup(x)));
                    assert!((exact - stored).abs() < 0.05, "{model:?} {ratio} {i}");
                }
            }
        }
    }

    #[test]
    fn known_tables_are_those_of_the_settings_that_are_asked_for() {
        let known = KnownTables::default();
        let configs = [0.9_f32, 1.2].map(|update_max| IntegrationConfig {
            update_max,
            ..IntegrationConfig::default()
        });
        for config in [&configs[0], &configs[1], &configs[0], &configs[0]] {
            let [mut again, mut anew] =
                [&known, &KnownTables::default()].map(|known| known.set(config, 0.05).unwrap());
            for sigma in [0.01, 0.05, 0.02, 0.01] {
                let [a, b] = [&mut again, &mut anew].map(|set| set.prepare(2.0, sigma));
                assert_eq!((a, again.table(a).end()), (b, anew.table(b).end()));
                assert_eq!(again.table(a).entries, anew.table(b).entries);
            }
        }
        let kept = known.0.lock().unwrap();
        assert_eq!(kept.tables.len(), 3);
    }

    #[test]
    fn free_space_and_the_space_behind_are_constant() {
        let mut set = TableSet::new(SensorModel::THRUN.at_resolution(0.05), DEFAULT).unwrap();
        let index = set.prepare(3.0, 0.02);
        let table = set.table(index);
        assert_eq!(table.lookup(-2.5), evidence_from_log_odds(-0.6));
        assert_eq!(table.lookup(10.0), 0);
        assert!(table.entries.len() < 2000);
    }
}
