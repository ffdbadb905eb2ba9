//! The rule `fused`, first step: which bricks does a scan change, and are they free all over?
//!
//! Cubes around the sensor are split only where the bounds of the image's windows cannot tell what
//! their cells get.

use crate::integrate::fused::footprint::Footprints;
use crate::integrate::fused::octants::Cube;
use crate::integrate::octants::Octants;
use crate::integrate::parallel::for_each;
use crate::key::BrickFilter;
use crate::key::{BRICK_EDGE, BrickKey};
use crate::storage::{SHARDS, hash, shard_of};

/// A brick to be updated: its packed key, and what its cells get.
pub(crate) type Task = (u64, Update);

/// What the cells of a brick get.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Update {
    /// All the same free update.
    Free,
    /// Free updates or nothing.
    Clear,
    Any,
}

/// Bricks along the edge of the cubes at which the search begins, as a power of two.
const ROOT_LEVEL: u32 = 4;

/// The search for the bricks that a scan changes.
pub(crate) struct Search<'a> {
    pub footprints: &'a Footprints,
    pub resolution: f64,
}

impl Search<'_> {
    /// Bricks to be updated, by shard.
    pub(crate) fn tasks(&self, threads: usize, only: BrickFilter) -> Vec<Vec<Task>> {
        let mut roots: Vec<(BrickKey, Vec<Task>)> = match only {
            Some(keys) => roots_of(keys),
            None => self.roots(),
        }
        .into_iter()
        .map(|root| (root, Vec::new()))
        .collect();
        for_each(&mut roots, threads, |_, (root, tasks)| {
            self.visit(*root, ROOT_LEVEL, only, tasks);
        });
        let mut by_shard = vec![Vec::new(); SHARDS];
        for task in roots.iter().flat_map(|(_, tasks)| tasks) {
            by_shard[shard_of(hash(task.0))].push(*task);
        }
        by_shard
    }

    /// Cubes of the root level that the scan can change.
    fn roots(&self) -> Vec<BrickKey> {
        let reach = f64::from(self.footprints.farthest_change());
        if reach <= 0.0 {
            return Vec::new();
        }
        // At most two cubes of this level along each axis hold everything.
        let bricks = 2.0 * reach / (self.resolution * f64::from(BRICK_EDGE));
        let level = (bricks.log2().ceil() as u32).clamp(ROOT_LEVEL + 1, 24);
        let edge = self.resolution * f64::from(BRICK_EDGE) * f64::from(1 << level);
        let origin = self.footprints.images.origin;
        let first = origin.map(|c| ((c - reach) / edge).floor() as i32);
        let last = origin.map(|c| ((c + reach) / edge).floor() as i32);
        let mut roots = Vec::new();
        for x in first[0]..=last[0] {
            for y in first[1]..=last[1] {
                for z in first[2]..=last[2] {
                    let first = BrickKey::new(x << level, y << level, z << level);
                    self.split_to_roots(first, level, &mut roots);
                }
            }
        }
        roots
    }

    fn split_to_roots(&self, first: BrickKey, level: u32, roots: &mut Vec<BrickKey>) {
        let octants = self.judge(first, level);
        for child in children(first, level, octants.touched) {
            if level - 1 == ROOT_LEVEL {
                roots.push(child.1);
            } else {
                self.split_to_roots(child.1, level - 1, roots);
            }
        }
    }

    /// Judges the octants of a cube of `2^level` bricks.
    fn judge(&self, first: BrickKey, level: u32) -> Octants {
        let half_cells = f64::from(1 << level) * f64::from(BRICK_EDGE / 2);
        let origin = self.footprints.images.origin;
        self.footprints.judge(Cube {
            center: relative_center(first, half_cells, self.resolution, origin),
            half: (half_cells * self.resolution) as f32,
        })
    }

    fn visit(&self, first: BrickKey, level: u32, only: BrickFilter, tasks: &mut Vec<Task>) {
        let octants = self.judge(first, level);
        for (bit, child) in children(first, level, octants.touched) {
            let only = match only.map(|keys| keys_in_cube(keys, child, level - 1)) {
                Some([]) => continue,
                only => only,
            };
            if octants.free & bit != 0 {
                push_cube(child, level - 1, only, tasks);
            } else if level > 1 {
                self.visit(child, level - 1, only, tasks);
            } else {
                let update = if octants.clear & bit != 0 {
                    Update::Clear
                } else {
                    Update::Any
                };
                tasks.push((child.pack(), update));
            }
        }
    }
}

/// Those octants of a cube of `2^level` bricks that are in `wanted`, with their bits.
fn children(first: BrickKey, level: u32, wanted: u8) -> impl Iterator<Item = (u8, BrickKey)> {
    let half = 1 << (level - 1);
    (0..8)
        .map(|octant| (1_u8 << octant, octant))
        .filter_map(move |(bit, octant)| {
            let child = BrickKey::new(
                first.x + (octant & 1) * half,
                first.y + (octant >> 1 & 1) * half,
                first.z + (octant >> 2) * half,
            );
            (wanted & bit != 0).then_some((bit, child))
        })
}

/// All bricks of a free cube of `2^level` bricks.
fn push_cube(first: BrickKey, level: u32, only: BrickFilter, tasks: &mut Vec<Task>) {
    let edge = 1 << level;
    for x in 0..edge {
        for y in 0..edge {
            for z in 0..edge {
                let key = BrickKey::new(first.x + x, first.y + y, first.z + z).pack();
                if only.is_none_or(|only| only.binary_search(&key).is_ok()) {
                    tasks.push((key, Update::Free));
                }
            }
        }
    }
}

/// The part of sorted keys that can lie in a cube of `2^level` bricks: those of its x layers.
fn keys_in_cube(keys: &[u64], first: BrickKey, level: u32) -> &[u64] {
    let low = BrickKey::new(first.x, first.y, first.z).pack();
    let edge = 1 << level;
    let high = BrickKey::new(first.x + edge - 1, first.y + edge - 1, first.z + edge - 1).pack();
    let start = keys.partition_point(|k| *k < low);
    let end = keys.partition_point(|k| *k <= high);
    &keys[start..end]
}

/// Root cubes that hold the given bricks.
fn roots_of(keys: &[u64]) -> Vec<BrickKey> {
    let mut roots: Vec<u64> = keys
        .iter()
        .map(|&key| {
            let key = BrickKey::unpack(key);
            let down = |c: i32| c >> ROOT_LEVEL << ROOT_LEVEL;
            BrickKey::new(down(key.x), down(key.y), down(key.z)).pack()
        })
        .collect();
    roots.sort_unstable();
    roots.dedup();
    roots.into_iter().map(BrickKey::unpack).collect()
}

/// Centre of a block that begins at a brick, relative to the sensor.
#[inline]
pub(crate) fn relative_center(
    first: BrickKey,
    half_cells: f64,
    resolution: f64,
    origin: [f64; 3],
) -> [f32; 3] {
    let cell = first.first_cell().to_array();
    std::array::from_fn(|i| ((f64::from(cell[i]) + half_cells) * resolution - origin[i]) as f32)
}
