//! The maximum-likelihood form of a map: every known cell is either free or occupied, without
//! degrees.

use crate::evidence::{Limits, Occupancy, UNKNOWN};
use crate::map::OccupancyMap;
use crate::storage::{BrickRef, Shard, pool::Payload};

/// Evidence of free cells in the maximum-likelihood form.
pub(crate) const FREE: i16 = -1;
/// Evidence of occupied cells in the maximum-likelihood form.
pub(crate) const OCCUPIED: i16 = 1;

pub(crate) fn classified(limits: Limits, value: i16) -> i16 {
    match limits.occupancy(value) {
        Occupancy::Unknown => UNKNOWN,
        Occupancy::Free => FREE,
        Occupancy::Occupied => OCCUPIED,
    }
}

impl OccupancyMap {
    /// Bytes that the bricks of this map would need if every known cell were only free or occupied:
    /// more bricks are uniform then. The spare memory of [`OccupancyMap::bytes_in_memory`] is not
    /// counted. Visits every cell of the bricks that are not uniform.
    #[must_use]
    pub fn maximum_likelihood_bytes(&self) -> usize {
        let directories: usize = self.shards.iter().map(Shard::directory_bytes).sum();
        let stays_mixed = |shard: &Shard, contents: BrickRef| {
            let class = |value| classified(self.limits, value);
            let values = shard.values(contents);
            values.iter().any(|value| class(*value) != class(values[0]))
        };
        let num_mixed = |shard: &Shard| {
            let bricks = shard.bricks().map(|(_, _, contents)| contents);
            let mixed = bricks.filter(|contents| !matches!(contents, BrickRef::Uniform(_)));
            mixed.filter(|mixed| stays_mixed(shard, *mixed)).count()
        };
        directories + self.shards.iter().map(num_mixed).sum::<usize>() * size_of::<Payload>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{MapConfig, MapError, VoxelKey};

    impl OccupancyMap {
        /// The map with every known cell replaced by one of two values: what the figures are
        /// compared with.
        fn maximum_likelihood(&self) -> Result<OccupancyMap, MapError> {
            let mut likely = OccupancyMap::new(self.config().clone())?;
            for key in self.bricks() {
                match self.brick(key) {
                    BrickRef::Uniform(value) => {
                        likely.set_brick_uniform(key, classified(self.limits, value));
                    }
                    BrickRef::Mixed(_) | BrickRef::Packed(_) => {
                        let values = self.brick_values(key);
                        likely.set_brick(key, &values.map(|v| classified(self.limits, v)));
                    }
                }
            }
            Ok(likely)
        }
    }

    #[test]
    fn degrees_cost_memory_and_classes_do_not() {
        let mut map = OccupancyMap::new(MapConfig::default()).unwrap();
        let mut set = |x: i32, log_odds: f32| {
            for y in 0..8 {
                for z in 0..8 {
                    map.set_log_odds(VoxelKey::new(x, y, z), Some(log_odds))
                        .unwrap();
                }
            }
        };
        // one brick of free cells of different certainty, one with a wall
        (0..8).for_each(|x| set(x, -0.1 - 0.1 * x as f32));
        (8..16).for_each(|x| set(x, if x == 12 { 2.0 } else { -1.0 }));
        assert_eq!(map.brick_counts().0, 2);
        let likely = map.maximum_likelihood().unwrap();
        assert_eq!(likely.brick_counts().0, 1);
        let payloads = |map: &OccupancyMap| map.brick_counts().0 * size_of::<Payload>();
        let directories = map.maximum_likelihood_bytes() - payloads(&likely);
        assert_eq!(
            directories,
            likely.maximum_likelihood_bytes() - payloads(&likely)
        );
        assert!(map.maximum_likelihood_bytes() < map.bytes_in_memory());
    }
}
