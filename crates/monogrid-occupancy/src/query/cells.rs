//! Cells in a box, in a fixed order; many cells at once; coarser levels.

use crate::evidence::{Occupancy, UNKNOWN, log_odds_from_evidence};
use crate::key::{BRICK_EDGE, BRICK_LIMIT, BrickKey, VoxelKey};
use crate::map::OccupancyMap;
use crate::storage::BrickRef;

/// A known cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
    /// Its address.
    pub key: VoxelKey,
    /// Its log-odds.
    pub log_odds: f32,
    /// Free or occupied.
    pub state: Occupancy,
}

impl OccupancyMap {
    /// Known cells with keys from `first` to `last`, both inclusive: brick by brick in the order
    /// of brick keys, inside a brick x fastest. The order depends on the cells alone.
    pub fn cells_in_key_box(
        &self,
        first: VoxelKey,
        last: VoxelKey,
    ) -> impl Iterator<Item = Cell> + '_ {
        let bricks = self.bricks_in_key_box(first, last).into_iter();
        let cells = bricks.flat_map(move |brick| {
            let values = self.brick_values(brick);
            let known = (0..values.len()).filter(move |&i| values[i] != UNKNOWN);
            known.map(move |i| Cell {
                key: brick.cell(i),
                log_odds: log_odds_from_evidence(values[i]),
                state: self.limits.occupancy(values[i]),
            })
        });
        cells.filter(move |cell| cell.key.is_within(first, last))
    }

    /// Known cells that touch the box between two corners in map coordinates; the order of
    /// [`OccupancyMap::cells_in_key_box`].
    pub fn cells_in_box(&self, low: [f64; 3], high: [f64; 3]) -> impl Iterator<Item = Cell> + '_ {
        self.cells_in_key_box(self.clamped_key(low), self.clamped_key(high))
    }

    /// All known cells, in the order of [`OccupancyMap::cells_in_key_box`].
    pub fn cells(&self) -> impl Iterator<Item = Cell> + '_ {
        let limit = BRICK_LIMIT * BRICK_EDGE;
        self.cells_in_key_box(
            VoxelKey::new(-limit, -limit, -limit),
            VoxelKey::new(limit - 1, limit - 1, limit - 1),
        )
    }

    /// All cells of a box, unknown ones included, x fastest, then y, then z.
    pub fn states_in_key_box(
        &self,
        first: VoxelKey,
        last: VoxelKey,
    ) -> impl Iterator<Item = (VoxelKey, Occupancy)> + '_ {
        first.to(last).map(|key| (key, self.state_of(key)))
    }

    /// Cells of one state with keys from `first` to `last`, both inclusive, unknown ones too if
    /// asked for; the order of [`OccupancyMap::cells_in_key_box`].
    pub fn keys_in_key_box(
        &self,
        first: VoxelKey,
        last: VoxelKey,
        state: Occupancy,
    ) -> impl Iterator<Item = VoxelKey> + '_ {
        // Unknown cells are mostly where there is no brick at all.
        let (known, all) = match state {
            Occupancy::Unknown => (Vec::new(), Some(first.brick().to(last.brick()))),
            _ => (self.bricks_in_key_box(first, last), None),
        };
        let bricks = known.into_iter().chain(all.into_iter().flatten());
        let keys = bricks.flat_map(move |brick| {
            let values = self.brick_values(brick);
            let is_asked = move |i: &usize| self.limits.occupancy(values[*i]) == state;
            (0..values.len())
                .filter(is_asked)
                .map(move |i| brick.cell(i))
        });
        keys.filter(move |key| key.is_within(first, last))
    }

    /// The cell of a point, moved to the nearest addressable one; NaN counts as 0.
    pub(crate) fn clamped_key(&self, point: [f64; 3]) -> VoxelKey {
        key_of_clamped(point, self.inv_resolution)
    }

    /// Bricks with a known cell that overlap a box of cells, in the order of their keys.
    pub(crate) fn bricks_in_key_box(&self, first: VoxelKey, last: VoxelKey) -> Vec<BrickKey> {
        let (low, high) = (first.brick(), last.brick());
        // A small box is looked up brick by brick, a large one filters the directory.
        if low.num_to(high) <= self.brick_counts().1 as u128 {
            let is_known = |key: &BrickKey| self.brick(*key) != BrickRef::UNKNOWN;
            return low.to(high).filter(is_known).collect();
        }
        let mut bricks = self.bricks();
        bricks.retain(|brick| brick.is_within(low, high));
        bricks
    }

    /// States of many points, written to `states` (as long as `points`); faster than one by one
    /// because the memory accesses of 16 points overlap.
    ///
    /// If the lengths differ, the surplus of the longer slice is left alone.
    pub fn states(&self, points_in_map: &[[f64; 3]], states: &mut [Occupancy]) {
        /// Points whose directory look-ups are under way together.
        const LANES: usize = 16;
        for (points, states) in points_in_map.chunks(LANES).zip(states.chunks_mut(LANES)) {
            let mut keys = [None; LANES];
            for (lane, point) in keys.iter_mut().zip(points) {
                let key = VoxelKey::from_point(*point, self.inv_resolution);
                *lane = key.map(|key| (key.brick().pack(), key.index_in_brick()));
            }
            let mut slots = [None; LANES];
            for (slot, key) in slots.iter_mut().zip(keys) {
                *slot = key.and_then(|(packed, index)| Some((self.slot(packed)?, index)));
            }
            for (state, slot) in states.iter_mut().zip(slots).take(points.len()) {
                let value = slot.map_or(UNKNOWN, |((shard, slot), index)| shard.value(slot, index));
                *state = self.limits.occupancy(value);
            }
        }
    }

    /// State of the cube of `2^level` cells' edge (aligned to it, as an octree node) that holds a
    /// point: occupied if any cell in it is, else free if any is known, else unknown.
    ///
    /// Levels up to 3 look at one brick; higher ones at every brick of the cube.
    #[must_use]
    pub fn state_at_level(&self, point_in_map: [f64; 3], level: u32) -> Occupancy {
        let Some(key) = self.key(point_in_map) else {
            return Occupancy::Unknown;
        };
        let level = level.min(20);
        let first = VoxelKey::from_array(key.to_array().map(|c| c >> level << level));
        let last = first.moved([(1 << level) - 1; 3]);
        let mut largest = UNKNOWN;
        for brick in self.bricks_in_key_box(first, last) {
            if let BrickRef::Uniform(value) = self.brick(brick) {
                largest = largest.max(value);
                continue;
            }
            let values = self.brick_values(brick);
            let inside = (0..values.len()).filter(|&i| brick.cell(i).is_within(first, last));
            largest = inside.map(|i| values[i]).fold(largest, i16::max);
        }
        self.limits.occupancy(largest)
    }
}

/// The cell of a point, moved to the nearest addressable one; NaN counts as 0.
pub(crate) fn key_of_clamped(point: [f64; 3], inv_resolution: f64) -> VoxelKey {
    let limit = f64::from(BRICK_LIMIT * BRICK_EDGE);
    VoxelKey::from_array(point.map(|c| {
        let scaled = (c * inv_resolution).floor();
        scaled.clamp(-limit, limit - 1.0) as i32
    }))
}
