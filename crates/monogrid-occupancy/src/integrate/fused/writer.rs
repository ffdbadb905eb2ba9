//! The rule `fused`, second step: the updates of a brick, and the brick with them.

use crate::evidence::UpdateRule;
use crate::integrate::fused::footprint::Footprints;
use crate::integrate::fused::octants::Cube;
use crate::integrate::fused::search::{Update, relative_center};
use crate::integrate::kernel::scalar::Weights;
use crate::key::{BRICK_CELLS, BrickKey};
use crate::storage::{BrickRef, Shard, hash};

/// Updates of the bricks of one scan.
pub(crate) struct Writer<'a> {
    pub footprints: &'a Footprints,
    pub resolution: f64,
    pub rule: UpdateRule,
    pub revision: u32,
}

impl Writer<'_> {
    pub(crate) fn update_brick(&self, shard: &mut Shard, key: u64, update: Update) {
        if update != Update::Any && self.is_saturated(shard, key) {
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
                if shard.update_all(slot, free, self.rule) {
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
        if shard.update_each(slot, &updates, self.rule) {
            shard.touch(slot, self.revision);
        }
    }

    /// Whether all cells of a brick hold the lowest value, so that nothing free changes them.
    fn is_saturated(&self, shard: &Shard, key: u64) -> bool {
        shard
            .find(key, hash(key))
            .is_some_and(|slot| shard.contents(slot) == BrickRef::Uniform(self.rule.limits.min))
    }

    /// Updates of the 512 cells of a brick with centre `center` relative to the sensor; whether
    /// there are any. All are 0 before.
    fn cell_updates(
        &self,
        center: [f32; 3],
        weights: &Weights,
        updates: &mut [i16; BRICK_CELLS],
    ) -> bool {
        let half = 4.0 * self.footprints.resolution;
        let octants = self.footprints.judge(Cube { center, half });
        self.footprints.evidence(center, weights, octants, updates);
        updates.iter().fold(0, |any, update| any | update) != 0
    }
}
