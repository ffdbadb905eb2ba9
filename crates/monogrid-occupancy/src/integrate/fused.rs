//! The rule `fused`: one update per cell and scan.
//!
//! Flow: measurements -> range images with bounds over windows of pixels -> cubes are split, down to
//! 2 x 2 x 2 cells, only where the bounds cannot tell what their cells get -> free bricks get one
//! addition, mixed ones an update per cell from the measurements in the cell's footprint, shard by
//! shard. A brick that is saturated free and can only become freer costs a look into the directory.

use super::beam::origin_in_cells;
use super::footprint::Footprints;
use super::image::RangeImages;
use super::kernel::{BLOCK_CELLS, Weights, cell_of};
use super::octants::{Cube, Octants};
use super::parallel::for_each;
use super::rays::BrickFilter;
use super::{IntegrationConfig, IntegrationReport};
use crate::error::MapError;
use crate::evidence::Limits;
use crate::key::{BRICK_CELLS, BRICK_EDGE, BrickKey};
use crate::map::OccupancyMap;
use crate::scan::Scan;
use crate::storage::{BrickRef, SHARDS, Shard, hash, shard_of};

/// A brick to be updated: its packed key, and what its cells get.
type Task = (u64, Update);

/// What the cells of a brick get.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Update {
    /// All the same free update.
    Free,
    /// Free updates or nothing.
    Clear,
    Any,
}

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
    let mixed = tasks
        .iter()
        .flatten()
        .filter(|t| t.1 != Update::Free)
        .count();
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
        for &(key, update) in &tasks[index] {
            writer.update_brick(shard, key, update);
        }
    });
    Ok(IntegrationReport {
        points: images.points,
        skipped: scan.len() - images.points,
        brick_visits: bricks,
    })
}

/// Packed keys of the bricks that a scan can change, in no order.
pub(crate) fn bricks_seen(
    map: &OccupancyMap,
    scan: &Scan,
    config: &IntegrationConfig,
    threads: usize,
) -> Result<Vec<u64>, MapError> {
    origin_in_cells(map, scan)?;
    let images = RangeImages::new(scan, config, map.resolution())?;
    let footprints = Footprints::new(&images, config.max_range, map.resolution());
    let search = Search {
        footprints: &footprints,
        resolution: map.resolution(),
    };
    let tasks = search.tasks(threads, None);
    Ok(tasks.into_iter().flatten().map(|task| task.0).collect())
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
    let is_new = |task: &&Task| !map.has_payload(BrickKey::unpack(task.0));
    let new: Vec<&Task> = tasks.iter().flatten().filter(is_new).collect();
    map.check_budget(
        new.len(),
        new.iter().filter(|t| t.1 != Update::Free).count(),
    )
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
    fn update_brick(&self, shard: &mut Shard, key: u64, update: Update) {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::map::MapConfig;
    use crate::scan::{PointScan, PoseSigma, ScanData, Similarity};

    /// A rough room around the sensor, in all directions or within 75 degrees of forward.
    fn scan_points(everywhere: bool, seed: u64, count: usize) -> Vec<[f32; 3]> {
        let mut state = seed;
        let mut unit = move || {
            state = state
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            (state >> 40) as f32 / (1 << 24) as f32
        };
        (0..count)
            .map(|_| {
                let (u, v) = (unit() * 1.6 - 0.8, unit() * 1.2 - 0.6);
                let direction = if everywhere {
                    [unit() - 0.5, unit() - 0.5, unit() - 0.5]
                } else {
                    [u, v, 1.0]
                };
                let norm = direction.iter().map(|c| c * c).sum::<f32>().sqrt();
                let side = direction.iter().fold(0.0_f32, |m, c| m.max(c.abs())) / norm;
                let range = (if u > 0.1 { 1.4 } else { 0.9 }) / side + 0.02 * unit();
                direction.map(|c| c / norm * range)
            })
            .collect()
    }

    /// Every cell around the sensor on its own: no search, no free bricks, no vectors.
    fn cell_by_cell(map: &mut OccupancyMap, scan: &Scan, config: &IntegrationConfig) {
        let resolution = map.resolution();
        let images = RangeImages::new(scan, config, resolution).unwrap();
        let footprints = Footprints::new(&images, config.max_range, resolution);
        let reach = (3.0 / resolution / 8.0).ceil() as i32;
        for x in -reach..reach {
            for y in -reach..reach {
                for z in -reach..reach {
                    let brick = BrickKey::new(x, y, z);
                    let center = relative_center(brick, 4.0, resolution, images.origin);
                    let weights = footprints.weights(center);
                    for octant in 0..8_usize {
                        let side = [octant & 1, octant >> 1 & 1, octant >> 2];
                        let cell = footprints.resolution;
                        let middle = std::array::from_fn(|i| {
                            center[i] + (side[i] as f32 * 4.0 - 2.0) * cell
                        });
                        let block = footprints.block_evidence_scalar(middle, &weights);
                        for (i, update) in block.into_iter().enumerate().filter(|b| b.1 != 0) {
                            let at = cell_of(i);
                            let index: usize =
                                (0..3).map(|a| (side[a] * 4 + at[a]) << (3 * a)).sum();
                            let key = brick.cell(index);
                            let value = map.limits.updated(map.evidence(key), update);
                            let log_odds = crate::evidence::log_odds_from_evidence(value);
                            map.set_log_odds(key, Some(log_odds)).unwrap();
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn the_search_the_free_bricks_and_the_threads_change_nothing() {
        for (everywhere, resolution) in [(false, 0.05), (false, 0.13), (true, 0.07), (true, 0.2)] {
            for max_range in [100.0, 0.8] {
                let config = IntegrationConfig {
                    max_range,
                    ..IntegrationConfig::default()
                };
                let maps = [0, 1, 2, 3].map(|threads| {
                    let mut map =
                        OccupancyMap::new(MapConfig::with_resolution(resolution)).unwrap();
                    for id in 0..2 {
                        let points = scan_points(everywhere, u64::from(id) + 5, 4000);
                        let (sin, cos) = (0.4 * f64::from(id + 1)).sin_cos();
                        let scan = Scan {
                            id,
                            world_from_sensor: Similarity {
                                scale: 1.0,
                                rotation: [[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]],
                                translation: [0.11, -0.2, 0.3 * f64::from(id)],
                            },
                            pose_sigma: PoseSigma::default(),
                            data: ScanData::Points(PointScan {
                                points: &points,
                                sigmas: &[0.02],
                            }),
                        };
                        if threads == 0 {
                            cell_by_cell(&mut map, &scan, &config);
                        } else {
                            integrate_fused(&mut map, &scan, &config, threads, None).unwrap();
                        }
                    }
                    map
                });
                assert!(maps[0].cells().count() > 100);
                for map in &maps[1..] {
                    assert!(*map == maps[0], "{everywhere} {resolution} {max_range}");
                }
            }
        }
    }

    #[test]
    fn a_wall_is_free_in_front_occupied_at_it_and_unknown_behind() {
        let mut points = Vec::new();
        for i in -60..=60_i16 {
            for j in -60..=60_i16 {
                points.push([f32::from(i) / 60.0, f32::from(j) / 60.0, 1.0].map(|c| c * 2.0));
            }
        }
        let scan = Scan {
            id: 0,
            world_from_sensor: Similarity::IDENTITY,
            pose_sigma: PoseSigma::default(),
            data: ScanData::Points(PointScan {
                points: &points,
                sigmas: &[0.01],
            }),
        };
        let config = IntegrationConfig::default();
        let mut map = OccupancyMap::new(MapConfig::with_resolution(0.04)).unwrap();
        integrate_fused(&mut map, &scan, &config, 1, None).unwrap();
        for cell in map.cells() {
            let [x, y, z] = cell.key.center(0.04);
            assert!(z < 2.2 && x.abs() < 1.2 * z + 0.1 && y.abs() < 1.2 * z + 0.1);
            if z < 1.9 {
                // One update: between once and twice the limit of one measurement.
                assert!((-0.81..=-0.39).contains(&cell.log_odds), "{cell:?}");
            }
            if (1.98..2.02).contains(&z) && x.abs().max(y.abs()) < 0.5 {
                assert!(cell.log_odds > 0.0, "{cell:?}");
            }
        }
        assert!(map.cells().count() > 20_000);
    }
}
