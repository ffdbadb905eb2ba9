//! Many point queries at once.

use crate::evidence::{Occupancy, UNKNOWN};
use crate::key::VoxelKey;
use crate::map::OccupancyMap;
use crate::storage::{hash, shard_of};

/// Points whose directory look-ups are under way together.
const LANES: usize = 16;

impl OccupancyMap {
    /// States of many points, written to `states` (as long as `points`); faster than one by one
    /// because the memory accesses of 16 points overlap.
    ///
    /// If the lengths differ, the surplus of the longer slice is left alone.
    pub fn states(&self, points_in_map: &[[f64; 3]], states: &mut [Occupancy]) {
        for (points, states) in points_in_map.chunks(LANES).zip(states.chunks_mut(LANES)) {
            let mut keys = [(0_u64, 0_u64, 0_usize); LANES];
            for (lane, point) in points.iter().enumerate() {
                keys[lane] = VoxelKey::from_point(*point, self.inv_resolution).map_or(
                    (u64::MAX, 0, 0),
                    |key| {
                        let packed = key.brick().pack();
                        (packed, hash(packed), key.index_in_brick())
                    },
                );
            }
            let mut slots = [None; LANES];
            for (slot, (packed, hash, _)) in slots.iter_mut().zip(keys) {
                if packed != u64::MAX {
                    *slot = self.shards[shard_of(hash)].find(packed, hash);
                }
            }
            for (lane, state) in states.iter_mut().enumerate().take(points.len()) {
                let (_, hash, index) = keys[lane];
                let value = slots[lane].map_or(UNKNOWN, |slot| {
                    self.shards[shard_of(hash)].value(slot, index)
                });
                *state = self.limits.occupancy(value);
            }
        }
    }
}
