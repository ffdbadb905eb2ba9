//! Forgetting: evidence that no scan renews relaxes towards unknown.
//!
//! Free rays clear what is gone where something behind it is seen. What is never looked at again, or
//! only against the open, stays for ever, unless it decays. A map that was loaded is never forgotten:
//! evidence relaxes towards the loaded map, so its cells change by scans and come back when those
//! fade.
//!
//! This is for maps that are fed by [`integrate`](crate::integrate). A
//! [`KeyframeMap`](crate::KeyframeMap) always equals a map from scratch of the keyframes it has and
//! therefore does not decay: take old keyframes out of it instead.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use crate::error::MapError;
use crate::evidence::{UNKNOWN, evidence_from_log_odds};
use crate::integrate::parallel::for_each;
use crate::key::BRICK_CELLS;
use crate::map::OccupancyMap;
use crate::storage::{BrickRef, Shard, hash};

/// Settings of [`Decay`].
#[derive(Clone, Debug, PartialEq)]
pub struct DecayConfig {
    /// After this many scans, evidence that is not renewed is worth half; positive. Default 100.
    pub half_life_scans: f64,
    /// Evidence decays once per so many scans, by as much; at least 1. A pass reads the whole map.
    /// Default 10.
    pub period_scans: u32,
    /// A cell with less evidence than this (log-odds, 0 to 7.99) becomes unknown, unless the loaded
    /// map knows it. Default 0.2.
    pub forget_log_odds: f32,
}

impl Default for DecayConfig {
    fn default() -> Self {
        Self {
            half_life_scans: 100.0,
            period_scans: 10,
            forget_log_odds: 0.2,
        }
    }
}

/// Lets the evidence of a map decay with the number of scans; deterministic for any number of
/// threads.
///
/// ```
/// # use monogrid_occupancy::*;
/// # use std::sync::Arc;
/// # fn main() -> Result<(), MapError> {
/// let loaded = Arc::new(OccupancyMap::new(MapConfig::default())?); // or `read_ot`, ...
/// let mut map = OccupancyMap::clone(&loaded);
/// let mut decay = Decay::new(DecayConfig::default(), Some(loaded))?;
/// // after every scan that was integrated into `map`:
/// decay.scan_integrated(&mut map, 1)?;
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug)]
pub struct Decay {
    config: DecayConfig,
    loaded: Option<Arc<OccupancyMap>>,
    /// Scans since the last pass.
    pending: u32,
}

impl Decay {
    /// Decay towards unknown, or towards the evidence of the map that one started from.
    ///
    /// # Errors
    /// A setting outside its documented range.
    pub fn new(config: DecayConfig, loaded: Option<Arc<OccupancyMap>>) -> Result<Self, MapError> {
        let fail = |field, value, allowed| {
            Err(MapError::Config {
                field,
                value,
                allowed,
            })
        };
        // Written so that NaN fails.
        if config.half_life_scans.is_nan() || config.half_life_scans <= 0.0 {
            return fail("half_life_scans", config.half_life_scans, "positive");
        }
        if config.period_scans == 0 {
            return fail("period_scans", 0.0, "at least 1");
        }
        if !(0.0..=7.99).contains(&config.forget_log_odds) {
            let value = f64::from(config.forget_log_odds);
            return fail("forget_log_odds", value, "0 to 7.99");
        }
        Ok(Self {
            config,
            loaded,
            pending: 0,
        })
    }

    /// To be called after each scan; returns how many bricks changed, 0 between the passes.
    ///
    /// # Errors
    /// The cells of the map are not those of the loaded one, or the memory budget could be exceeded
    /// (where packed bricks change or single cells come back); the map is then as before.
    pub fn scan_integrated(
        &mut self,
        map: &mut OccupancyMap,
        threads: usize,
    ) -> Result<usize, MapError> {
        if let Some(loaded) = &self.loaded
            && loaded.resolution().to_bits() != map.resolution().to_bits()
        {
            return Err(MapError::ResolutionMismatch {
                left: map.resolution(),
                right: loaded.resolution(),
            });
        }
        if self.pending + 1 < self.config.period_scans {
            self.pending += 1;
            return Ok(0);
        }
        let changed = self.pass(map, threads)?;
        self.pending = 0;
        Ok(changed)
    }

    /// All evidence decays by one period.
    fn pass(&self, map: &mut OccupancyMap, threads: usize) -> Result<usize, MapError> {
        let periods = f64::from(self.config.period_scans) / self.config.half_life_scans;
        let relaxation = Relaxation {
            kept: (0.5_f64.powf(periods) * f64::from(1 << KEPT_BITS)) as i32,
            forget: i32::from(evidence_from_log_odds(f64::from(
                self.config.forget_log_odds,
            ))),
        };
        let loaded = |index: usize| self.loaded.as_ref().map(|map| &map.shards[index]);
        let new_payloads = (map.shards.iter().enumerate())
            .map(|(index, shard)| most_new_payloads(shard, loaded(index)))
            .sum();
        map.check_budget(0, new_payloads)?;
        map.revision += 1;
        let revision = map.revision;
        let changed = AtomicUsize::new(0);
        for_each(&mut map.shards, threads, |index, shard| {
            let bricks: Vec<(u64, u32, BrickRef)> = shard.bricks().collect();
            for (key, _, contents) in bricks {
                if relaxation.relax(shard, key, contents, loaded(index)) {
                    changed.fetch_add(1, Ordering::Relaxed);
                    if let Some(slot) = shard.find(key, hash(key)) {
                        shard.touch(slot, revision);
                    }
                }
            }
        });
        Ok(changed.into_inner())
    }
}

/// Contents of a brick in a shard of the loaded map.
fn contents_in(loaded: Option<&Shard>, key: u64) -> BrickRef {
    loaded
        .and_then(|shard| Some(shard.contents(shard.find(key, hash(key))?)))
        .unwrap_or(BrickRef::Uniform(UNKNOWN))
}

/// Upper bound of the payloads that a pass can need.
fn most_new_payloads(shard: &Shard, loaded: Option<&Shard>) -> usize {
    let needs_payload = |key: u64, contents: BrickRef| match contents {
        BrickRef::Mixed(_) => false,
        BrickRef::Packed(_) => true,
        BrickRef::Uniform(_) => !matches!(contents_in(loaded, key), BrickRef::Uniform(_)),
    };
    let bricks = shard.bricks();
    bricks.filter(|b| needs_payload(b.0, b.2)).count()
}

/// Binary places of the share of the evidence that is kept.
const KEPT_BITS: u32 = 15;

struct Relaxation {
    kept: i32,
    forget: i32,
}

impl Relaxation {
    /// `rest + kept (value - rest)`, rounded towards rest; unknown where rest is and little is left.
    fn value(&self, value: i16, rest: i16) -> i16 {
        if value == UNKNOWN {
            return UNKNOWN;
        }
        let base = if rest == UNKNOWN { 0 } else { i32::from(rest) };
        let left = (i32::from(value) - base) * self.kept / (1 << KEPT_BITS);
        if rest == UNKNOWN && left.abs() < self.forget.max(1) {
            UNKNOWN
        } else {
            // Between value and rest: it fits.
            (base + left) as i16
        }
    }

    /// Relaxes a brick; whether anything changed.
    fn relax(
        &self,
        shard: &mut Shard,
        key: u64,
        contents: BrickRef,
        loaded: Option<&Shard>,
    ) -> bool {
        let Some(slot) = shard.find(key, hash(key)) else {
            return false;
        };
        let rest = contents_in(loaded, key);
        if let (BrickRef::Uniform(value), BrickRef::Uniform(rest)) = (contents, rest) {
            let relaxed = self.value(value, rest);
            if relaxed != value {
                shard.set_uniform(slot, relaxed);
            }
            return relaxed != value;
        }
        let before = shard.values(contents);
        let rest = loaded.map_or([UNKNOWN; BRICK_CELLS], |shard| shard.values(rest));
        let after = std::array::from_fn(|i| self.value(before[i], rest[i]));
        if after == before {
            return false;
        }
        shard.payload_mut(slot).0 = after;
        shard.collapse(slot);
        true
    }
}
