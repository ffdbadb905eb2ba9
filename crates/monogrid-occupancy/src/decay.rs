//! Forgetting: evidence that no scan renews relaxes towards unknown.
//!
//! Free rays clear what is gone where something behind it is seen. What is never looked at again,
//! or only against the open, stays for ever, unless it decays. A map that was loaded is never
//! forgotten: evidence relaxes towards the loaded map, so its cells change by scans and come back
//! when those fade.
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
use crate::storage::{BrickRef, Shard, SlotIndex, hash};

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
        // Written so that NaN fails.
        let half_life = config.half_life_scans;
        MapError::unless(half_life > 0.0, "half_life_scans", half_life, "positive")?;
        MapError::unless(config.period_scans > 0, "period_scans", 0.0, "at least 1")?;
        let forget = config.forget_log_odds;
        let is_storable = (0.0..=7.99).contains(&forget);
        MapError::unless(is_storable, "forget_log_odds", forget, "0 to 7.99")?;
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
        if let Some(loaded) = &self.loaded {
            let (left, right) = (map.resolution(), loaded.resolution());
            if left.to_bits() != right.to_bits() {
                return Err(MapError::ResolutionMismatch { left, right });
            }
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
            forget: evidence_from_log_odds(self.config.forget_log_odds.into()).into(),
        };
        let loaded = |index: usize| self.loaded.as_ref().map(|map| &map.shards[index]);
        let shards = map.shards.iter().enumerate();
        let new_payloads = shards.map(|(index, shard)| most_new_payloads(shard, loaded(index)));
        map.check_budget(0, new_payloads.sum())?;
        map.revision += 1;
        let revision = map.revision;
        let changed = AtomicUsize::new(0);
        for_each(&mut map.shards, threads, |index, shard| {
            let keys: Vec<u64> = shard.bricks().map(|brick| brick.0).collect();
            for key in keys {
                let Some(slot) = shard.find(key, hash(key)) else {
                    continue;
                };
                if relaxation.relax(shard, slot, contents_in(loaded(index), key), loaded(index)) {
                    changed.fetch_add(1, Ordering::Relaxed);
                    shard.touch(slot, revision);
                }
            }
        });
        Ok(changed.into_inner())
    }
}

/// Contents of a brick in a shard of the loaded map.
fn contents_in(loaded: Option<&Shard>, key: u64) -> BrickRef {
    let known = loaded.and_then(|shard| Some(shard.contents(shard.find(key, hash(key))?)));
    known.unwrap_or(BrickRef::UNKNOWN)
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
    /// `rest + kept (value - rest)`, rounded towards rest; unknown where rest is and little is
    /// left.
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

    /// Relaxes a brick towards `rest`, of the shard that was loaded; whether anything changed.
    fn relax(
        &self,
        shard: &mut Shard,
        slot: SlotIndex,
        rest: BrickRef,
        loaded: Option<&Shard>,
    ) -> bool {
        let contents = shard.contents(slot);
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
