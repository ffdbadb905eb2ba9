//! Cells in a box, in a fixed order; coarser levels.

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
        self.bricks_in_key_box(first, last)
            .into_iter()
            .flat_map(move |brick| {
                let values = self.brick_values(brick);
                (0..values.len())
                    .filter(move |&i| values[i] != UNKNOWN)
                    .map(move |i| Cell {
                        key: brick.cell(i),
                        log_odds: log_odds_from_evidence(values[i]),
                        state: self.limits.occupancy(values[i]),
                    })
            })
            .filter(move |cell| is_inside(cell.key, first, last))
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
        (first.z..=last.z).flat_map(move |z| {
            (first.y..=last.y).flat_map(move |y| {
                (first.x..=last.x).map(move |x| {
                    let key = VoxelKey::new(x, y, z);
                    (key, self.state_of(key))
                })
            })
        })
    }

    /// Cells of one state with keys from `first` to `last`, both inclusive, unknown ones too if
    /// asked for; the order of [`OccupancyMap::cells_in_key_box`].
    pub fn keys_in_key_box(
        &self,
        first: VoxelKey,
        last: VoxelKey,
        state: Occupancy,
    ) -> impl Iterator<Item = VoxelKey> + '_ {
        let (low, high) = (first.brick(), last.brick());
        // Unknown cells are mostly where there is no brick at all.
        let (known, all) = if state == Occupancy::Unknown {
            let column = move |x| (low.y..=high.y).map(move |y| (x, y));
            let all = (low.x..=high.x)
                .flat_map(column)
                .flat_map(move |(x, y)| (low.z..=high.z).map(move |z| BrickKey::new(x, y, z)));
            (None, Some(all))
        } else {
            (Some(self.bricks_in_key_box(first, last)), None)
        };
        known
            .into_iter()
            .flatten()
            .chain(all.into_iter().flatten())
            .flat_map(move |brick| {
                let values = self.brick_values(brick);
                (0..values.len())
                    .filter(move |&i| self.limits.occupancy(values[i]) == state)
                    .map(move |i| brick.cell(i))
            })
            .filter(move |key| is_inside(*key, first, last))
    }

    /// The cell of a point, moved to the nearest addressable one; NaN counts as 0.
    pub(crate) fn clamped_key(&self, point: [f64; 3]) -> VoxelKey {
        key_of_clamped(point, self.inv_resolution)
    }

    /// Bricks with a known cell that overlap a box of cells, in the order of their keys.
    pub(crate) fn bricks_in_key_box(&self, first: VoxelKey, last: VoxelKey) -> Vec<BrickKey> {
        let (low, high) = (first.brick(), last.brick());
        let span = |a: i32, b: i32| (i64::from(b) - i64::from(a) + 1).max(0) as u128;
        let volume = span(low.x, high.x) * span(low.y, high.y) * span(low.z, high.z);
        let known = |key: &BrickKey| self.brick(*key) != BrickRef::Uniform(UNKNOWN);
        // A small box is looked up brick by brick, a large one filters the directory.
        if volume <= self.brick_counts().1 as u128 {
            let mut bricks = Vec::new();
            for x in low.x..=high.x {
                for y in low.y..=high.y {
                    for z in low.z..=high.z {
                        bricks.push(BrickKey::new(x, y, z));
                    }
                }
            }
            bricks.retain(known);
            return bricks;
        }
        let mut bricks = self.bricks();
        bricks.retain(|b| {
            (low.x..=high.x).contains(&b.x)
                && (low.y..=high.y).contains(&b.y)
                && (low.z..=high.z).contains(&b.z)
        });
        bricks
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
        let edge = (1 << level) - 1;
        let last = VoxelKey::new(first.x + edge, first.y + edge, first.z + edge);
        let mut largest = UNKNOWN;
        for brick in self.bricks_in_key_box(first, last) {
            let in_brick = match self.brick(brick) {
                BrickRef::Uniform(value) => value,
                BrickRef::Mixed(_) | BrickRef::Packed(_) => {
                    let values = self.brick_values(brick);
                    (0..values.len())
                        .filter(|&i| is_inside(brick.cell(i), first, last))
                        .map(|i| values[i])
                        .max()
                        .unwrap_or(UNKNOWN)
                }
            };
            largest = largest.max(in_brick);
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

fn is_inside(key: VoxelKey, first: VoxelKey, last: VoxelKey) -> bool {
    (first.x..=last.x).contains(&key.x)
        && (first.y..=last.y).contains(&key.y)
        && (first.z..=last.z).contains(&key.z)
}
