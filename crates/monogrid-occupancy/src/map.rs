//! The occupancy map: configuration, single cells, facts about the whole.

use crate::error::MapError;
use crate::evidence::{Limits, Occupancy, UNKNOWN, evidence_from_log_odds, log_odds_from_evidence};
use crate::integrate::parallel::for_each;
use crate::key::{BRICK_CELLS, BrickKey, VoxelKey};
use crate::sensor::table::KnownTables;
use crate::storage::{BrickRef, SHARDS, Shard, SlotIndex, hash, shard_of};

/// Settings of a map.
#[derive(Clone, Debug, PartialEq)]
pub struct MapConfig {
    /// Edge of a cell in map units, positive. Default 0.05.
    pub resolution: f64,
    /// Lowest stored log-odds, in [-7.99, 0). Default -2, as OctoMap (p = 0.1192).
    pub clamp_min: f32,
    /// Highest stored log-odds, in (0, 7.99]. Default 3.5 (p = 0.971).
    pub clamp_max: f32,
    /// Cells at least this likely are occupied, in (0, 1). Default 0.5.
    pub occupancy_threshold: f64,
    /// Most bytes that the map may allocate; changes that could need more fail before they touch
    /// the map (where it helps, [`integrate`](crate::integrate) packs the map first). Default 8
    /// GiB.
    pub memory_budget_bytes: usize,
}

impl Default for MapConfig {
    fn default() -> Self {
        Self {
            resolution: 0.05,
            clamp_min: -2.0,
            clamp_max: 3.5,
            occupancy_threshold: 0.5,
            memory_budget_bytes: 8 << 30,
        }
    }
}

impl MapConfig {
    /// The defaults with cells of edge `resolution`.
    #[must_use]
    pub fn with_resolution(resolution: f64) -> Self {
        Self {
            resolution,
            ..Self::default()
        }
    }
}

/// A sparse probabilistic voxel map.
///
/// Cells are addressed by map coordinates (any unit) or by [`VoxelKey`]. A cell is unknown until
/// its first update; after that it holds log-odds in steps of 1/4096, clamped when written.
#[derive(Clone, Debug)]
pub struct OccupancyMap {
    config: MapConfig,
    pub(crate) inv_resolution: f64,
    pub(crate) limits: Limits,
    pub(crate) shards: Vec<Shard>,
    pub(crate) revision: u32,
    pub(crate) known_tables: KnownTables,
    /// Cubes of free space of a file that are unknown here, since no map has room for them.
    pub(crate) endless_free: usize,
}

impl OccupancyMap {
    /// An empty map.
    ///
    /// # Errors
    /// A field of `config` outside its documented range.
    pub fn new(config: MapConfig) -> Result<Self, MapError> {
        let resolution = config.resolution;
        if !(resolution.is_finite() && resolution > 1e-9 && resolution < 1e9) {
            return Err(MapError::Resolution { value: resolution });
        }
        let (low, high) = (config.clamp_min, config.clamp_max);
        let limits = Limits::new(low, high, config.occupancy_threshold)?;
        Ok(Self {
            inv_resolution: 1.0 / resolution,
            limits,
            shards: vec![Shard::default(); SHARDS],
            revision: 0,
            known_tables: KnownTables::default(),
            endless_free: 0,
            config,
        })
    }

    /// Cubes of free space, of 2048 cells and more along an edge, that the file had from which this
    /// map was read. They are unknown in it: OctoMap prunes free space to eighths of all there is,
    /// which no map of cells has room for.
    #[must_use]
    pub fn endless_free(&self) -> usize {
        self.endless_free
    }

    /// The settings that the map was made with.
    #[must_use]
    pub fn config(&self) -> &MapConfig {
        &self.config
    }

    /// Edge of a cell in map units.
    #[must_use]
    pub fn resolution(&self) -> f64 {
        self.config.resolution
    }

    /// The cell that holds a point; `None` if the point is not finite or out of range.
    #[must_use]
    pub fn key(&self, point_in_map: [f64; 3]) -> Option<VoxelKey> {
        VoxelKey::from_point(point_in_map, self.inv_resolution)
    }

    /// What is known about the cell that holds a point.
    #[must_use]
    #[inline]
    pub fn state(&self, point_in_map: [f64; 3]) -> Occupancy {
        let key = VoxelKey::from_point(point_in_map, self.inv_resolution);
        key.map_or(Occupancy::Unknown, |key| self.state_of(key))
    }

    /// What is known about a cell.
    #[must_use]
    #[inline]
    pub fn state_of(&self, key: VoxelKey) -> Occupancy {
        self.limits.occupancy(self.evidence(key))
    }

    /// Log-odds of the cell that holds a point; `None` if unknown.
    #[must_use]
    pub fn log_odds(&self, point_in_map: [f64; 3]) -> Option<f32> {
        self.log_odds_of(self.key(point_in_map)?)
    }

    /// Log-odds of a cell; `None` if unknown.
    #[must_use]
    pub fn log_odds_of(&self, key: VoxelKey) -> Option<f32> {
        let value = self.evidence(key);
        (value != UNKNOWN).then(|| log_odds_from_evidence(value))
    }

    /// Where a brick is, if it was ever touched.
    #[inline]
    pub(crate) fn slot(&self, packed: u64) -> Option<(&Shard, SlotIndex)> {
        let hash = hash(packed);
        let shard = &self.shards[shard_of(hash)];
        Some((shard, shard.find(packed, hash)?))
    }

    /// Changes a brick, which is inserted if it was absent.
    fn change_brick(&mut self, key: BrickKey, change: impl FnOnce(&mut Shard, SlotIndex)) {
        let packed = key.pack();
        let hash = hash(packed);
        let shard = &mut self.shards[shard_of(hash)];
        let slot = shard.find_or_insert(packed, hash);
        change(shard, slot);
        shard.touch(slot, self.revision);
    }

    /// Stored evidence of a cell, or [`UNKNOWN`].
    #[inline]
    pub(crate) fn evidence(&self, key: VoxelKey) -> i16 {
        let slot = self.slot(key.brick().pack());
        slot.map_or(UNKNOWN, |(shard, slot)| {
            shard.value(slot, key.index_in_brick())
        })
    }

    /// Contents of a brick; uniform unknown if it was never touched.
    #[inline]
    pub(crate) fn brick(&self, key: BrickKey) -> BrickRef {
        let slot = self.slot(key.pack());
        slot.map_or(BrickRef::UNKNOWN, |(shard, slot)| shard.contents(slot))
    }

    /// The payload of a brick that has one.
    #[inline]
    pub(crate) fn payload(&self, key: BrickKey) -> Option<&[i16; BRICK_CELLS]> {
        let (shard, slot) = self.slot(key.pack())?;
        match shard.contents(slot) {
            BrickRef::Uniform(_) | BrickRef::Packed(_) => None,
            BrickRef::Mixed(payload) => Some(shard.payload(payload)),
        }
    }

    /// Whether a brick can be written to without another payload.
    #[inline]
    pub(crate) fn has_payload(&self, key: BrickKey) -> bool {
        matches!(self.brick(key), BrickRef::Mixed(_))
    }

    /// Evidence of the 512 cells of a brick.
    pub(crate) fn brick_values(&self, key: BrickKey) -> [i16; BRICK_CELLS] {
        let slot = self.slot(key.pack());
        slot.map_or([UNKNOWN; BRICK_CELLS], |(shard, slot)| {
            shard.values(shard.contents(slot))
        })
    }

    /// Sets the log-odds of a cell (`None`: unknown), saturating only at the storable range of
    /// about +-8, not at the clamps.
    ///
    /// # Errors
    /// The memory budget is exhausted.
    pub fn set_log_odds(&mut self, key: VoxelKey, log_odds: Option<f32>) -> Result<(), MapError> {
        let value = evidence_or_unknown(log_odds);
        self.modify(key, |_| value)
    }

    /// As [`OccupancyMap::set_log_odds`], for the 512 cells of a brick at once: what `log_odds`
    /// says of each.
    ///
    /// # Errors
    /// The memory budget is exhausted.
    pub fn set_brick_log_odds(
        &mut self,
        brick: BrickKey,
        log_odds: impl Fn(VoxelKey) -> Option<f32>,
    ) -> Result<(), MapError> {
        if !brick.is_addressable() {
            return Ok(());
        }
        let values = std::array::from_fn(|i| evidence_or_unknown(log_odds(brick.cell(i))));
        if values == [UNKNOWN; BRICK_CELLS] && self.brick(brick) == BrickRef::UNKNOWN {
            return Ok(());
        }
        if !self.has_payload(brick) {
            self.check_budget(1, 1)?;
        }
        self.revision += 1;
        self.set_brick(brick, &values);
        Ok(())
    }

    /// Adds log-odds to a cell and clamps, as OctoMap's `updateNode`.
    ///
    /// # Errors
    /// The memory budget is exhausted.
    pub fn add_log_odds(&mut self, key: VoxelKey, log_odds: f32) -> Result<(), MapError> {
        let limits = self.limits;
        let delta = evidence_from_log_odds(f64::from(log_odds));
        self.modify(key, |value| limits.updated(value, delta))
    }

    fn modify(&mut self, key: VoxelKey, change: impl Fn(i16) -> i16) -> Result<(), MapError> {
        if !key.brick().is_addressable() {
            return Ok(());
        }
        let old = self.evidence(key);
        let new = change(old);
        if new == old {
            return Ok(());
        }
        // adding up the shards is dear: only where the map can grow
        if !self.has_payload(key.brick()) {
            self.check_budget(1, 1)?;
        }
        self.revision += 1;
        self.change_brick(key.brick(), |shard, slot| {
            let cells = &mut shard.payload_mut(slot).0;
            cells[key.index_in_brick()] = new;
            // A brick can only have become uniform if its other corner agrees: spares the scan.
            if cells[0] == new && cells[BRICK_CELLS - 1] == new {
                shard.collapse(slot);
            }
        });
        Ok(())
    }

    /// Replaces all cells of a brick.
    pub(crate) fn set_brick(&mut self, key: BrickKey, values: &[i16; BRICK_CELLS]) {
        self.change_brick(key, |shard, slot| {
            shard.payload_mut(slot).0 = *values;
            shard.collapse(slot);
        });
    }

    /// Makes a cube of `edge` cells (1, 2 or 4, aligned to its edge) equal.
    pub(crate) fn fill_cells(
        &mut self,
        first: VoxelKey,
        edge: i32,
        value: i16,
    ) -> Result<(), MapError> {
        if !self.has_payload(first.brick()) {
            self.check_budget(1, 1)?;
        }
        let last = first.moved([edge - 1; 3]);
        self.change_brick(first.brick(), |shard, slot| {
            let cells = &mut shard.payload_mut(slot).0;
            for cell in first.to(last) {
                cells[cell.index_in_brick()] = value;
            }
            if cells[0] == value && cells[BRICK_CELLS - 1] == value {
                shard.collapse(slot);
            }
        });
        Ok(())
    }

    /// Makes all cells of a brick equal.
    pub(crate) fn set_brick_uniform(&mut self, key: BrickKey, value: i16) {
        self.change_brick(key, |shard, slot| shard.set_uniform(slot, value));
    }

    /// Fails if the map could exceed its budget after gaining bricks and payloads.
    pub(crate) fn check_budget(
        &self,
        new_bricks: usize,
        new_payloads: usize,
    ) -> Result<(), MapError> {
        // A directory can double when it grows, and the old half is alive while it does.
        let bricks = new_bricks.saturating_mul(Shard::SLOT_BYTES * 4);
        let payloads = new_payloads.saturating_mul(BRICK_CELLS * size_of::<i16>());
        let growth = bricks.saturating_add(payloads);
        self.check_bytes(self.bytes_in_memory().saturating_add(growth))
    }

    /// Fails if what needs so many bytes exceeds the budget.
    pub(crate) fn check_bytes(&self, needed_bytes: usize) -> Result<(), MapError> {
        let budget_bytes = self.config.memory_budget_bytes;
        if needed_bytes <= budget_bytes {
            return Ok(());
        }
        Err(MapError::MemoryBudget {
            needed_bytes,
            budget_bytes,
        })
    }

    /// Changes with every modification; see [`OccupancyMap::bricks_changed_since`].
    #[must_use]
    pub fn revision(&self) -> u32 {
        self.revision
    }

    /// Bricks that hold at least one known cell, in the order of their keys.
    #[must_use]
    pub fn bricks(&self) -> Vec<BrickKey> {
        self.sorted_bricks(|_, contents| contents != BrickRef::UNKNOWN)
    }

    /// Bricks changed after `revision`, in the order of their keys, those that became unknown
    /// included: what has to be published again.
    #[must_use]
    pub fn bricks_changed_since(&self, revision: u32) -> Vec<BrickKey> {
        self.sorted_bricks(|changed, _| changed > revision)
    }

    fn sorted_bricks(&self, keep: impl Fn(u32, BrickRef) -> bool) -> Vec<BrickKey> {
        let bricks = self.shards.iter().flat_map(Shard::bricks);
        let kept = bricks.filter(|(_, revision, contents)| keep(*revision, *contents));
        let mut packed: Vec<u64> = kept.map(|(key, _, _)| key).collect();
        packed.sort_unstable();
        packed.into_iter().map(BrickKey::unpack).collect()
    }

    /// Bytes allocated for bricks and directories.
    #[must_use]
    pub fn bytes_in_memory(&self) -> usize {
        size_of::<Self>()
            + self.shards.len() * size_of::<Shard>()
            + self.shards.iter().map(Shard::bytes).sum::<usize>()
    }

    /// Number of bricks whose values differ, packed or not, and of all bricks.
    #[must_use]
    pub fn brick_counts(&self) -> (usize, usize) {
        let mixed = |shard: &Shard| shard.payloads() + shard.packed_len;
        let shards = self.shards.iter();
        (
            shards.clone().map(mixed).sum(),
            shards.map(|shard| shard.len).sum(),
        )
    }

    /// Packs the bricks whose values differ into a palette and an index per cell, on `threads`
    /// threads: a finished map then needs about a third of the memory. No cell changes, and
    /// everything can still be asked and done; a brick that changes afterwards is unpacked first.
    /// Meanwhile each thread needs memory for 1/64 of the packed map.
    pub fn pack(&mut self, threads: usize) {
        for_each(&mut self.shards, threads, |_, shard| shard.pack());
    }

    /// Packs the map after it refused to grow, if an eighth of the memory budget or more is in
    /// bricks that are not packed. Otherwise gives back the error.
    pub(crate) fn pack_for_budget(
        &mut self,
        error: MapError,
        threads: usize,
    ) -> Result<(), MapError> {
        let unpacked = self.shards.iter().map(Shard::payloads).sum::<usize>();
        let bytes = unpacked * BRICK_CELLS * size_of::<i16>();
        let is_full = matches!(error, MapError::MemoryBudget { .. });
        if !is_full || bytes < self.config.memory_budget_bytes / 8 {
            return Err(error);
        }
        self.pack(threads);
        Ok(())
    }

    /// Smallest box of cells, first and last inclusive, that holds every known cell.
    #[must_use]
    pub fn key_bounds(&self) -> Option<(VoxelKey, VoxelKey)> {
        let bricks = self.bricks();
        let first = bricks.first()?;
        let mut low = first.first_cell().to_array().map(|_| i32::MAX);
        let mut high = low.map(|_| i32::MIN);
        let mut extend = |cell: VoxelKey| {
            for (axis, c) in cell.to_array().into_iter().enumerate() {
                low[axis] = low[axis].min(c);
                high[axis] = high[axis].max(c);
            }
        };
        for key in bricks {
            match self.brick(key) {
                BrickRef::Uniform(_) => {
                    extend(key.first_cell());
                    extend(key.cell(BRICK_CELLS - 1));
                }
                BrickRef::Mixed(_) | BrickRef::Packed(_) => {
                    let values = self.brick_values(key);
                    let known = (0..BRICK_CELLS).filter(|&i| values[i] != UNKNOWN);
                    known.for_each(|i| extend(key.cell(i)));
                }
            }
        }
        Some((VoxelKey::from_array(low), VoxelKey::from_array(high)))
    }

    /// Smallest box in map coordinates that holds every known cell; `None` for an empty map.
    #[must_use]
    pub fn bounds(&self) -> Option<([f64; 3], [f64; 3])> {
        let (low, high) = self.key_bounds()?;
        let corner = |key: VoxelKey| key.to_array().map(|c| f64::from(c) * self.resolution());
        Some((corner(low), corner(high.moved([1; 3]))))
    }

    /// Whether no cell is known.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        let mut bricks = self.shards.iter().flat_map(Shard::bricks);
        bricks.all(|(_, _, contents)| contents == BrickRef::UNKNOWN)
    }
}

fn evidence_or_unknown(log_odds: Option<f32>) -> i16 {
    log_odds.map_or(UNKNOWN, |l| evidence_from_log_odds(f64::from(l)))
}

/// Maps are equal when every cell has the same evidence and cells have the same size; history,
/// revisions and spare memory do not count.
impl PartialEq for OccupancyMap {
    fn eq(&self, other: &Self) -> bool {
        self.resolution().to_bits() == other.resolution().to_bits()
            && self.bricks() == other.bricks()
            && (self.bricks().into_iter())
                .all(|key| self.brick_values(key) == other.brick_values(key))
    }
}
