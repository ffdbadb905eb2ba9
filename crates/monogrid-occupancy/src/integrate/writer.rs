//! The rule `fused`, second step: the updates of a brick, and the brick with them.

use super::footprint::Footprints;
use super::kernel::{BLOCK_CELLS, Weights, cell_of};
use super::octants::Cube;
use super::search::{Update, relative_center};
use crate::evidence::Limits;
use crate::key::{BRICK_CELLS, BrickKey};
use crate::storage::{BrickRef, Shard, hash};

/// Updates of the bricks of one scan.
pub(crate) struct Writer<'a> {
    pub footprints: &'a Footprints,
    pub resolution: f64,
    pub limits: Limits,
    pub revision: u32,
}

impl Writer<'_> {
    pub(crate) fn update_brick(&self, shard: &mut Shard, key: u64, update: Update) {
        if update != Update::Any && self.is_settled(shard, key) {
            return;
        }
        let origin = self.footprints.images.origin;
        let brick = BrickKey::unpack(key);
        let center = relative_center(brick, 4.0, self.resolution, origin);
        let weights = self.footprints.weights(center);
        if update == Update::Free {
            let free = self.footprints.free_evidence(&weights);
            if free != 0 {
                let slot = shard.find_or_insert(key, hash(key));
                if shard.update_all(slot, free, self.limits) {
                    shard.touch(slot, self.revision);
                }
            }
            return;
        }
        let mut updates = [0; BRICK_CELLS];
        if !self.cell_updates(center, &weights, &mut updates) {
            return;
        }
        let slot = shard.find_or_insert(key, hash(key));
        if shard.update_each(slot, &updates, self.limits) {
            shard.touch(slot, self.revision);
        }
    }

    /// Whether all cells of a brick hold the lowest value, so that nothing free changes them.
    fn is_settled(&self, shard: &Shard, key: u64) -> bool {
        shard
            .find(key, hash(key))
            .is_some_and(|slot| shard.contents(slot) == BrickRef::Uniform(self.limits.min))
    }

    /// Updates of the 512 cells of a brick with centre `center` relative to the sensor; whether
    /// there are any. All are 0 before.
    fn cell_updates(
        &self,
        center: [f32; 3],
        weights: &Weights,
        updates: &mut [i16; BRICK_CELLS],
    ) -> bool {
        let cell = self.footprints.resolution;
        let free = self.footprints.free_evidence(weights);
        let octants = self.footprints.judge(Cube {
            center,
            half: 4.0 * cell,
        });
        let mut any = 0;
        for octant in (0..8_usize).filter(|o| octants.touched >> o & 1 != 0) {
            let side = [octant & 1, octant >> 1 & 1, octant >> 2];
            let mut block = [0; BLOCK_CELLS];
            if octants.free >> octant & 1 != 0 {
                block = [free; BLOCK_CELLS];
            } else {
                let center =
                    std::array::from_fn(|i| center[i] + (side[i] as f32 * 4.0 - 2.0) * cell);
                self.block_updates(center, weights, free, &mut block);
            }
            for (index, &update) in block.iter().enumerate() {
                let at = cell_of(index);
                let [x, y, z] = std::array::from_fn(|i| side[i] * 4 + at[i]);
                updates[x + 8 * y + 64 * z] = update;
                any |= update;
            }
        }
        any != 0
    }

    /// Updates of 4 x 4 x 4 cells; all are 0 before.
    fn block_updates(
        &self,
        center: [f32; 3],
        weights: &Weights,
        free: i16,
        block: &mut [i16; BLOCK_CELLS],
    ) {
        let half = 2.0 * self.footprints.resolution;
        let octants = self.footprints.judge(Cube { center, half });
        for (octant, cells) in block.chunks_exact_mut(8).enumerate() {
            if octants.free >> octant & 1 != 0 {
                cells.fill(free);
            }
        }
        let wanted = octants.touched & !octants.free;
        if wanted != 0 {
            self.footprints
                .block_evidence(center, weights, wanted, block);
        }
    }
}
