//! Maps from maps: crop, merge, transform; and how two maps differ. All work brick by brick.

use std::collections::BTreeSet;

use crate::error::MapError;
use crate::evidence::{Occupancy, UNKNOWN, log_odds_from_evidence};
use crate::key::{BRICK_CELLS, BRICK_EDGE, BrickKey, VoxelKey};
use crate::map::{MapConfig, OccupancyMap};
use crate::scan::Similarity;
use crate::storage::BrickRef;

/// Cell sizes closer than this are the same: files round them.
const SAME_RESOLUTION: f64 = 1e-6;

/// Cells by their state in two maps.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MapDifference {
    /// In the same known state in both.
    pub same: u64,
    /// Free before, occupied after.
    pub free_to_occupied: u64,
    /// Occupied before, free after.
    pub occupied_to_free: u64,
    /// Known only before.
    pub only_before: u64,
    /// Known only after.
    pub only_after: u64,
    /// Mean of `|after - before|` over the cells that both know.
    pub mean_log_odds_difference: f64,
}

/// Known cells of a map.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CellCounts {
    /// Cells at least as likely occupied as the threshold.
    pub occupied: u64,
    /// Other known cells.
    pub free: u64,
}

impl OccupancyMap {
    /// Numbers of occupied and free cells.
    #[must_use]
    pub fn cell_counts(&self) -> CellCounts {
        let mut counts = CellCounts::default();
        let mut add = |value: i16, cells: u64| match self.limits.occupancy(value) {
            Occupancy::Unknown => {}
            Occupancy::Free => counts.free += cells,
            Occupancy::Occupied => counts.occupied += cells,
        };
        for key in self.bricks() {
            match self.brick(key) {
                BrickRef::Uniform(value) => add(value, BRICK_CELLS as u64),
                _ => self.brick_values(key).iter().for_each(|v| add(*v, 1)),
            }
        }
        counts
    }

    /// Replaces all cells of a brick, if the budget allows it.
    pub(crate) fn put_brick(
        &mut self,
        key: BrickKey,
        cells: &[i16; BRICK_CELLS],
    ) -> Result<(), MapError> {
        let is_uniform = cells.iter().all(|c| *c == cells[0]);
        if !is_uniform {
            self.check_budget(1, 1)?;
            self.set_brick(key, cells);
        } else if self.brick(key) != BrickRef::Uniform(cells[0]) {
            self.check_budget(1, 0)?;
            self.set_brick_uniform(key, cells[0]);
        }
        Ok(())
    }

    /// The cells that touch the box between two corners in map coordinates, with the settings of
    /// this map.
    ///
    /// # Errors
    /// The memory budget is exhausted.
    pub fn cropped(&self, low: [f64; 3], high: [f64; 3]) -> Result<Self, MapError> {
        let (first, last) = (self.clamped_key(low), self.clamped_key(high));
        self.filtered(first, last, |key| key.is_within(first, last))
    }

    /// The cells whose centres are at most `radius` from a point, with the settings of this map.
    ///
    /// # Errors
    /// The memory budget is exhausted.
    pub fn within(&self, center: [f64; 3], radius: f64) -> Result<Self, MapError> {
        let first = self.clamped_key(center.map(|c| c - radius));
        let last = self.clamped_key(center.map(|c| c + radius));
        self.filtered(first, last, |key| {
            let cell = key.center(self.resolution());
            let offset = (0..3).map(|axis| cell[axis] - center[axis]);
            offset.map(|c| c * c).sum::<f64>() <= radius * radius
        })
    }

    /// The cells of a box that satisfy a convex condition.
    fn filtered(
        &self,
        first: VoxelKey,
        last: VoxelKey,
        keep: impl Fn(VoxelKey) -> bool,
    ) -> Result<Self, MapError> {
        let mut kept = Self::new(self.config().clone())?;
        kept.revision = 1;
        for brick in self.bricks_in_key_box(first, last) {
            let mut cells = self.brick_values(brick);
            // The condition is convex: a brick with all its corners inside is inside.
            let corners = [0, 7, 56, 63, 448, 455, 504, 511];
            if !corners.into_iter().all(|corner| keep(brick.cell(corner))) {
                for (index, cell) in cells.iter_mut().enumerate() {
                    if !keep(brick.cell(index)) {
                        *cell = UNKNOWN;
                    }
                }
            }
            kept.put_brick(brick, &cells)?;
        }
        Ok(kept)
    }

    /// The same cells with edges `factor` times as long: the map in another unit of length.
    ///
    /// # Errors
    /// Edges that are no length.
    pub fn rescaled(&self, factor: f64) -> Result<Self, MapError> {
        let mut rescaled = Self::new(MapConfig {
            resolution: factor * self.resolution(),
            ..self.config().clone()
        })?;
        rescaled.shards.clone_from(&self.shards);
        rescaled.revision = self.revision;
        Ok(rescaled)
    }

    /// Adds the log-odds of another map, as if both had been measured into this one: every known
    /// cell of `other` is one update here, clamped as all updates.
    ///
    /// # Errors
    /// Cells of different size, or the memory budget could be exceeded; this map is then as
    /// before.
    pub fn merge(&mut self, other: &Self) -> Result<(), MapError> {
        self.check_same_resolution(other)?;
        let (payloads, bricks) = other.brick_counts();
        let limits = self.limits;
        // A uniform brick of the other map may break up one of this map, or the other way round.
        let (own_payloads, own_bricks) = self.brick_counts();
        let packed: usize = self.shards.iter().map(|shard| shard.packed_len).sum();
        let new_payloads = (own_bricks - own_payloads).min(payloads) + payloads + packed;
        self.check_budget(bricks, new_payloads)?;
        self.revision += 1;
        for key in other.bricks() {
            let bricks = (self.brick(key), other.brick(key));
            if let (BrickRef::Uniform(own), BrickRef::Uniform(added)) = bricks {
                self.set_brick_uniform(key, limits.updated(own, added));
                continue;
            }
            let mut cells = self.brick_values(key);
            for (cell, added) in cells.iter_mut().zip(other.brick_values(key)) {
                if added != UNKNOWN {
                    *cell = limits.updated(*cell, added);
                }
            }
            self.set_brick(key, &cells);
        }
        Ok(())
    }

    /// The map moved, turned and scaled into cells of edge `resolution`: every cell takes the
    /// evidence of the cell of this map that holds its centre, so there are no holes.
    ///
    /// Sensors moved before mapping give a better map than one that was resampled.
    ///
    /// # Errors
    /// A transform that is not a similarity, a resolution that is not positive, or the memory
    /// budget is exhausted.
    pub fn transformed(
        &self,
        target_from_source: &Similarity,
        resolution: f64,
    ) -> Result<Self, MapError> {
        MapError::unless(
            target_from_source.is_valid(),
            "target_from_source.scale (or its rotation)",
            target_from_source.scale,
            "a positive scale and an orthonormal rotation",
        )?;
        let mut target = Self::new(MapConfig {
            resolution,
            ..self.config().clone()
        })?;
        target.revision = 1;
        let source_from_target = target_from_source.inverse();
        for brick in self.bricks_reached(target_from_source, &target)? {
            let cells = std::array::from_fn(|index| {
                let center = brick.cell(index).center(resolution);
                let key = self.key(source_from_target.transform(center));
                key.map_or(UNKNOWN, |key| self.evidence(key))
            });
            target.put_brick(brick, &cells)?;
        }
        Ok(target)
    }

    /// Bricks of `target` that the transformed bricks of this map can touch, in order; no more than
    /// its budget allows.
    fn bricks_reached(
        &self,
        target_from_source: &Similarity,
        target: &Self,
    ) -> Result<BTreeSet<BrickKey>, MapError> {
        let edge = f64::from(BRICK_EDGE) * self.resolution();
        let rows = target_from_source.rotation;
        // Half the edge of the box around a turned cube.
        let reach: [f64; 3] = rows.map(|row| {
            0.5 * edge * target_from_source.scale * row.iter().map(|c| c.abs()).sum::<f64>()
        });
        let mut reached = BTreeSet::new();
        for brick in self.bricks() {
            let low = brick.first_cell().to_array();
            let center = low.map(|c| f64::from(c) * self.resolution() + 0.5 * edge);
            let center = target_from_source.transform(center);
            let corner = |sign: f64| {
                let corner = std::array::from_fn(|axis| center[axis] + sign * reach[axis]);
                target.key(corner).map(VoxelKey::brick)
            };
            if let (Some(first), Some(last)) = (corner(-1.0), corner(1.0)) {
                // before they are taken: one brick may become billions
                let more = usize::try_from(first.num_to(last)).unwrap_or(usize::MAX);
                let most = more.max(reached.len());
                target.check_budget(most, most)?;
                reached.extend(first.to(last));
            }
        }
        Ok(reached)
    }

    /// Cells whose state differs between this map and a later one of the same cell size.
    ///
    /// # Errors
    /// Cells of different size.
    pub fn difference(&self, after: &Self) -> Result<MapDifference, MapError> {
        self.check_same_resolution(after)?;
        let mut result = MapDifference::default();
        let (mut sum, mut both) = (0.0, 0_u64);
        let mut bricks = self.bricks();
        bricks.extend(after.bricks());
        bricks.sort_unstable();
        bricks.dedup();
        for key in bricks {
            let values = self.brick_values(key).into_iter();
            for (old, new) in values.zip(after.brick_values(key)) {
                match (self.limits.occupancy(old), after.limits.occupancy(new)) {
                    (Occupancy::Unknown, Occupancy::Unknown) => {}
                    (Occupancy::Unknown, _) => result.only_after += 1,
                    (_, Occupancy::Unknown) => result.only_before += 1,
                    (Occupancy::Free, Occupancy::Occupied) => result.free_to_occupied += 1,
                    (Occupancy::Occupied, Occupancy::Free) => result.occupied_to_free += 1,
                    _ => result.same += 1,
                }
                if old != UNKNOWN && new != UNKNOWN {
                    both += 1;
                    let change = log_odds_from_evidence(new) - log_odds_from_evidence(old);
                    sum += f64::from(change.abs());
                }
            }
        }
        result.mean_log_odds_difference = sum / both.max(1) as f64;
        Ok(result)
    }

    fn check_same_resolution(&self, other: &Self) -> Result<(), MapError> {
        let (left, right) = (self.resolution(), other.resolution());
        if (left / right - 1.0).abs() < SAME_RESOLUTION {
            return Ok(());
        }
        Err(MapError::ResolutionMismatch { left, right })
    }
}
