//! The rule `fused`: one update per cell and scan.
//!
//! Flow: measurements -> range images with pyramids -> cubes of bricks are split only where the
//! pyramids cannot tell what their cells get -> free bricks get one addition, mixed ones an
//! update per cell from the measurements in the cell's footprint, shard by shard.

use super::footprint::{BlockClass, Footprints};
use super::image::RangeImages;
use super::kernel::{BLOCK_CELLS, Weights};
use super::parallel::for_each;
use super::rays::{BrickFilter, origin_in_cells};
use super::{IntegrationConfig, IntegrationReport};
use crate::error::MapError;
use crate::evidence::Limits;
use crate::key::{BRICK_CELLS, BRICK_EDGE, BrickKey};
use crate::map::OccupancyMap;
use crate::scan::Scan;
use crate::storage::{BrickRef, SHARDS, Shard, hash, shard_of};

/// A brick to be updated: its packed key, and whether it is free as a whole.
type Task = (u64, bool);

/// Bricks along the edge of the cubes at which the search begins, as a power of two.
const ROOT_LEVEL: u32 = 4;

/// Adds a scan by the rule `fused`.
pub(crate) fn integrate_fused(
    map: &mut OccupancyMap,
    scan: &Scan,
    config: &IntegrationConfig,
    threads: usize,
    only: BrickFilter,
) -> Result<IntegrationReport, MapError> {
    origin_in_cells(map, scan)?;
    let images = RangeImages::new(scan, config, map.resolution())?;
    let footprints = Footprints::new(&images, config.max_range, map.resolution());
    let search = Search {
        footprints: &footprints,
        resolution: map.resolution(),
    };
    let tasks = search.tasks(threads, only);
    let mixed = tasks.iter().flatten().filter(|t| !t.1).count();
    let bricks = tasks.iter().map(Vec::len).sum();
    check_budget(map, &tasks, bricks, mixed)?;
    map.revision += 1;
    let writer = Writer {
        footprints: &footprints,
        resolution: map.resolution(),
        limits: map.limits,
        revision: map.revision,
    };
    for_each(&mut map.shards, threads, |index, shard| {
        for &(key, is_free) in &tasks[index] {
            writer.update_brick(shard, key, is_free);
        }
    });
    Ok(IntegrationReport {
        points: images.points,
        skipped: scan.len() - images.points,
        brick_visits: bricks,
    })
}

/// Fails before anything is changed if the scan could exceed the memory budget.
fn check_budget(
    map: &OccupancyMap,
    tasks: &[Vec<Task>],
    bricks: usize,
    mixed: usize,
) -> Result<(), MapError> {
    if map.check_budget(bricks, mixed).is_ok() {
        return Ok(());
    }
    let is_new = |task: &&Task| matches!(map.brick(BrickKey::unpack(task.0)), BrickRef::Uniform(_));
    let new: Vec<&Task> = tasks.iter().flatten().filter(is_new).collect();
    map.check_budget(new.len(), new.iter().filter(|t| !t.1).count())
}

/// The search for the bricks that a scan changes.
struct Search<'a> {
    footprints: &'a Footprints<'a>,
    resolution: f64,
}

impl Search<'_> {
    /// Bricks to be updated, by shard.
    fn tasks(&self, threads: usize, only: BrickFilter) -> Vec<Vec<Task>> {
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

    /// Cubes of the root level around everything that the scan can change.
    fn roots(&self) -> Vec<BrickKey> {
        let reach = f64::from(self.footprints.farthest_change());
        if reach <= 0.0 {
            return Vec::new();
        }
        let edge = self.resolution * f64::from(BRICK_EDGE << ROOT_LEVEL);
        let origin = self.footprints.images.origin;
        let first = origin.map(|c| ((c - reach) / edge).floor() as i32);
        let last = origin.map(|c| ((c + reach) / edge).floor() as i32);
        let mut roots = Vec::new();
        for x in first[0]..=last[0] {
            for y in first[1]..=last[1] {
                for z in first[2]..=last[2] {
                    let key = BrickKey::new(x << ROOT_LEVEL, y << ROOT_LEVEL, z << ROOT_LEVEL);
                    if self.class(key, ROOT_LEVEL) != BlockClass::Untouched {
                        roots.push(key);
                    }
                }
            }
        }
        roots
    }

    fn class(&self, first: BrickKey, level: u32) -> BlockClass {
        let half = self.resolution * f64::from(BRICK_EDGE << level) * 0.5;
        let center = relative_center(
            first,
            f64::from(BRICK_EDGE << level) * 0.5,
            self.resolution,
            self.footprints.images.origin,
        );
        self.footprints.classify(center, half as f32)
    }

    fn visit(&self, first: BrickKey, level: u32, only: BrickFilter, tasks: &mut Vec<Task>) {
        let only = match only.map(|keys| keys_in_cube(keys, first, level)) {
            Some([]) => return,
            only => only,
        };
        let class = self.class(first, level);
        match class {
            BlockClass::Untouched => {}
            BlockClass::Mixed if level > 0 => {
                let half = 1 << (level - 1);
                for octant in 0..8 {
                    let child = BrickKey::new(
                        first.x + (octant & 1) * half,
                        first.y + (octant >> 1 & 1) * half,
                        first.z + (octant >> 2) * half,
                    );
                    self.visit(child, level - 1, only, tasks);
                }
            }
            BlockClass::Mixed | BlockClass::Free => {
                let is_free = class == BlockClass::Free;
                let edge = 1 << level;
                for x in 0..edge {
                    for y in 0..edge {
                        for z in 0..edge {
                            let key = BrickKey::new(first.x + x, first.y + y, first.z + z).pack();
                            if only.is_none_or(|only| only.binary_search(&key).is_ok()) {
                                tasks.push((key, is_free));
                            }
                        }
                    }
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
fn relative_center(
    first: BrickKey,
    half_cells: f64,
    resolution: f64,
    origin: [f64; 3],
) -> [f32; 3] {
    let cell = first.first_cell().to_array();
    std::array::from_fn(|i| ((f64::from(cell[i]) + half_cells) * resolution - origin[i]) as f32)
}

/// Updates of the bricks of one scan.
struct Writer<'a> {
    footprints: &'a Footprints<'a>,
    resolution: f64,
    limits: Limits,
    revision: u32,
}

impl Writer<'_> {
    fn update_brick(&self, shard: &mut Shard, key: u64, is_free: bool) {
        let origin = self.footprints.images.origin;
        let brick = BrickKey::unpack(key);
        let center = relative_center(brick, 4.0, self.resolution, origin);
        let weights = self.footprints.weights(center);
        if is_free {
            let free = self.footprints.free_evidence(&weights);
            if free != 0 {
                let slot = shard.find_or_insert(key, hash(key));
                if shard.update_all(slot, free, self.limits) {
                    shard.touch(slot, self.revision);
                }
            }
            return;
        }
        let updates = self.cell_updates(center, &weights);
        if updates.iter().all(|&u| u == 0) {
            return;
        }
        let slot = shard.find_or_insert(key, hash(key));
        if shard.update_each(slot, &updates, self.limits) {
            shard.touch(slot, self.revision);
        }
    }

    /// Updates of the 512 cells of a brick with centre `center` relative to the sensor.
    fn cell_updates(&self, center: [f32; 3], weights: &Weights) -> [i16; BRICK_CELLS] {
        let mut updates = [0; BRICK_CELLS];
        let cell = self.footprints.resolution;
        // Octants of 4 x 4 x 4 cells: most of them are free or untouched as a whole.
        for octant in 0..8_usize {
            let side = [octant & 1, octant >> 1 & 1, octant >> 2];
            let middle = std::array::from_fn(|i| center[i] + (side[i] as f32 * 4.0 - 2.0) * cell);
            let uniform = match self.footprints.classify(middle, 2.0 * cell) {
                BlockClass::Untouched => continue,
                BlockClass::Free => Some(self.footprints.free_evidence(weights)),
                BlockClass::Mixed => None,
            };
            let block = match uniform {
                Some(free) => [free; BLOCK_CELLS],
                None => self.footprints.block_evidence(middle, weights),
            };
            for (row, cells) in block.chunks_exact(4).enumerate() {
                let (y, z) = (side[1] * 4 + (row & 3), side[2] * 4 + (row >> 2));
                let start = side[0] * 4 + 8 * y + 64 * z;
                updates[start..start + 4].copy_from_slice(cells);
            }
        }
        updates
    }
}
