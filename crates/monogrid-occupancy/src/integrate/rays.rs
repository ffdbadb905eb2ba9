//! The rule `rays`: every measurement updates every cell that its ray crosses.
//!
//! Flow: measurements -> rays in cell units -> (1) each ray is walked brick by brick, and the
//! bricks are handed to their shards -> (2) each shard walks the cells of its bricks, ray by ray
//! in the order of the measurements. Free rays through bricks that are saturated free end at (2)
//! with a look into the directory.

use super::parallel::for_each;
use super::ray::{MAX_CELLS, RANGE_BITS, Ray, TIME_BITS, fixed};
use super::{IntegrationConfig, IntegrationReport};
use crate::error::MapError;
use crate::evidence::Limits;
use crate::key::{BRICK_LIMIT, BrickKey};
use crate::map::OccupancyMap;
use crate::scan::Scan;
use crate::sensor::table::TableSet;
use crate::storage::{BrickRef, SHARDS, Shard, SlotIndex, hash, shard_of};

/// A measurement as a ray with its evidence.
struct Beam {
    ray: Ray,
    table: u16,
    /// Range in fixed point at which the first entry of the table begins.
    table_start: i64,
    /// Entries per unit of fixed-point range.
    entries_per_range: f64,
    /// Bricks that the ray leaves before this time lie wholly in free space.
    free_until: i64,
}

/// One brick on the way of one beam: packed key and `beam << 1 | free`.
type Visit = (u64, u32);

/// Visits found by one worker, by shard.
type VisitLists = Vec<Vec<Visit>>;

/// Beams walked before their visits are applied: keeps beams and visits in cache.
const VISITS_PER_BATCH: f64 = 400_000.0;
const MIN_BEAMS_PER_BATCH: usize = 2048;

/// Bricks to which an integration is restricted, sorted by packed key.
pub(crate) type BrickFilter<'a> = Option<&'a [u64]>;

/// Adds a scan by the rule `rays`.
pub(crate) fn integrate_rays(
    map: &mut OccupancyMap,
    scan: &Scan,
    config: &IntegrationConfig,
    threads: usize,
    only: BrickFilter,
) -> Result<IntegrationReport, MapError> {
    let (beams, tables) = prepare_beams(map, scan, config)?;
    check_budget(map, &beams)?;
    map.revision += 1;
    let mut report = IntegrationReport {
        points: beams.len(),
        skipped: scan.len() - beams.len(),
        brick_visits: 0,
    };
    let batch = beams_per_batch(&beams);
    let mut lists: Vec<VisitLists> = vec![vec![Vec::new(); SHARDS]; threads];
    for first in (0..beams.len()).step_by(batch) {
        let beams = &beams[first..(first + batch).min(beams.len())];
        collect_visits(beams, &mut lists, only);
        report.brick_visits += lists.iter().flatten().map(Vec::len).sum::<usize>();
        let (limits, revision) = (map.limits, map.revision);
        for_each(&mut map.shards, threads, |index, shard| {
            let mut writer = ShardWriter {
                beams,
                tables: &tables,
                limits,
                revision,
                free_visits: 0,
            };
            for list in &lists {
                writer.apply(shard, &list[index]);
            }
        });
    }
    map.collapse_touched(threads);
    Ok(report)
}

/// Rays in cell units with their tables.
fn prepare_beams(
    map: &OccupancyMap,
    scan: &Scan,
    config: &IntegrationConfig,
) -> Result<(Vec<Beam>, TableSet), MapError> {
    let resolution = map.resolution();
    let mut tables = TableSet::new(
        config.model.at_resolution(resolution),
        config.update_limits(),
    )?;
    let pose = &scan.world_from_sensor;
    let origin = origin_in_cells(map, scan)?;
    let beams = (0..scan.len())
        .filter_map(|index| {
            let measured = scan.measurement(index, config.sigma_mode)?;
            let direction = pose.rotate(measured.point.map(|c| c / measured.range));
            let range = measured.range * pose.scale;
            let sigma = total_sigma(measured.sigma * pose.scale, range, scan, resolution);
            let table = tables.prepare(range as f32, sigma as f32);
            let evidence = tables.table(table);
            let start = range + evidence.start;
            let length = (range + evidence.end()).min(config.max_range);
            // A centre is projected at most half a diagonal beyond the end of its cell's piece.
            let half_diagonal = 0.87;
            Some(Beam {
                ray: Ray::new(origin, direction, length / resolution),
                table,
                table_start: fixed(start / resolution, RANGE_BITS),
                entries_per_range: evidence.inv_step * resolution / (1_u64 << RANGE_BITS) as f64,
                free_until: fixed(
                    (start / resolution - half_diagonal).clamp(0.0, MAX_CELLS),
                    TIME_BITS,
                ),
            })
        })
        .collect();
    Ok((beams, tables))
}

/// The sensor's place in cells; rays from it stay within the map's range of addresses.
pub(crate) fn origin_in_cells(map: &OccupancyMap, scan: &Scan) -> Result<[f64; 3], MapError> {
    let limit = f64::from(BRICK_LIMIT) * 8.0 - 2.0 * MAX_CELLS;
    let origin = scan
        .world_from_sensor
        .translation
        .map(|c| c * map.inv_resolution);
    if origin.iter().any(|c| c.abs() > limit) {
        return Err(MapError::Scan {
            id: scan.id,
            reason: format!("its origin lies more than {limit} cells from the map's origin"),
        });
    }
    Ok(origin)
}

/// Range and pose uncertainty together; at least a hundredth of a cell, to which the tables of
/// an all too certain sensor are limited.
pub(crate) fn total_sigma(sigma: f64, range: f64, scan: &Scan, resolution: f64) -> f64 {
    let pose = scan.pose_sigma;
    let rotation = range * pose.rotation_rad;
    (sigma * sigma + pose.translation * pose.translation + rotation * rotation)
        .sqrt()
        .max(0.01 * resolution)
}

/// Upper bound of the bricks that a ray can meet.
fn most_bricks(beam: &Beam) -> f64 {
    let cells = beam.ray.end as f64 / (1_u64 << TIME_BITS) as f64;
    // Crossings on three axes: at most sqrt(3) per brick's edge of length, one more each.
    3_f64.sqrt() * cells / 8.0 + 4.0
}

fn beams_per_batch(beams: &[Beam]) -> usize {
    let mean = beams.iter().map(most_bricks).sum::<f64>() / beams.len().max(1) as f64;
    ((VISITS_PER_BATCH / mean) as usize).max(MIN_BEAMS_PER_BATCH)
}

/// Fails before anything is changed if the scan could exceed the memory budget: tries ever
/// tighter and dearer upper bounds.
fn check_budget(map: &OccupancyMap, beams: &[Beam]) -> Result<(), MapError> {
    let loose = beams.iter().map(most_bricks).sum::<f64>() as usize;
    if map.check_budget(loose, loose).is_ok() {
        return Ok(());
    }
    let mut keys = Vec::new();
    for beams in beams.chunks(4096) {
        for beam in beams {
            beam.ray.for_each_brick(|key, _| keys.push(key));
        }
        keys.sort_unstable();
        keys.dedup();
    }
    let without_payload = keys
        .iter()
        .filter(|&&key| matches!(map.brick(BrickKey::unpack(key)), BrickRef::Uniform(_)))
        .count();
    map.check_budget(without_payload, without_payload)
}

/// Step 1: the bricks on the way of each beam, in the order of the beams.
fn collect_visits(beams: &[Beam], lists: &mut [VisitLists], only: BrickFilter) {
    let workers = lists.len();
    let share = beams.len().div_ceil(workers).max(1);
    for_each(lists, workers, |worker, lists| {
        lists.iter_mut().for_each(Vec::clear);
        let first = (worker * share).min(beams.len());
        let last = (first + share).min(beams.len());
        for (index, beam) in beams[first..last].iter().enumerate() {
            let word = ((first + index) as u32) << 1;
            beam.ray.for_each_brick(|key, leaves| {
                if only.is_none_or(|only| only.binary_search(&key).is_ok()) {
                    let free = u32::from(leaves < beam.free_until);
                    lists[shard_of(hash(key))].push((key, word | free));
                }
            });
        }
    });
}

/// Step 2 for one shard.
struct ShardWriter<'a> {
    beams: &'a [Beam],
    tables: &'a TableSet,
    limits: Limits,
    revision: u32,
    free_visits: u32,
}

impl ShardWriter<'_> {
    fn apply(&mut self, shard: &mut Shard, visits: &[Visit]) {
        for &(key, word) in visits {
            let beam = &self.beams[(word >> 1) as usize];
            let slot = shard.find_or_insert(key, hash(key));
            if word & 1 == 1 {
                self.clear(shard, slot, key, beam);
            } else {
                self.mark(shard, slot, key, beam);
            }
        }
    }

    /// A brick that the beam crosses wholly in free space.
    fn clear(&mut self, shard: &mut Shard, slot: SlotIndex, key: u64, beam: &Beam) {
        let free = self.tables.table(beam.table).free;
        if free == 0 {
            return;
        }
        if shard.contents(slot) == BrickRef::Uniform(self.limits.min) && free < 0 {
            return;
        }
        let limits = self.limits;
        let cells = &mut shard.payload_mut(slot).0;
        let entry = beam.ray.enter(BrickKey::unpack(key));
        beam.ray.walk(entry, |index, _| {
            cells[index] = limits.updated(cells[index], free);
        });
        shard.touch(slot, self.revision);
        // Saturated bricks spare all later free rays: look for them now and then.
        self.free_visits += 1;
        if self.free_visits.is_multiple_of(32) {
            shard.collapse(slot);
        }
    }

    /// A brick in which the beam meets more than free space.
    fn mark(&mut self, shard: &mut Shard, slot: SlotIndex, key: u64, beam: &Beam) {
        let limits = self.limits;
        let cells = &mut shard.payload_mut(slot).0;
        let entry = beam.ray.enter(BrickKey::unpack(key));
        let table = self.tables.table(beam.table);
        let (free, entries) = (table.free, &table.entries[..]);
        beam.ray.walk(entry, |index, range| {
            let behind_start = range - beam.table_start;
            let delta = if behind_start < 0 {
                free
            } else {
                let at = (behind_start as f64 * beam.entries_per_range) as usize;
                match entries.get(at) {
                    Some(&delta) => delta,
                    None => return,
                }
            };
            if delta != 0 {
                cells[index] = limits.updated(cells[index], delta);
            }
        });
        shard.touch(slot, self.revision);
    }
}

/// Model `none`, the same for both rules: the cell of each end point gets the largest update.
pub(crate) fn integrate_end_points(
    map: &mut OccupancyMap,
    scan: &Scan,
    config: &IntegrationConfig,
    only: BrickFilter,
) -> Result<IntegrationReport, MapError> {
    map.check_budget(scan.len(), scan.len())?;
    let mut report = IntegrationReport::default();
    for index in 0..scan.len() {
        let key = scan
            .measurement(index, config.sigma_mode)
            .map(|m| (m.range * scan.world_from_sensor.scale, m.point))
            .and_then(|(range, point)| {
                Some((range, map.key(scan.world_from_sensor.transform(point))?))
            });
        let Some((range, key)) = key else {
            report.skipped += 1;
            continue;
        };
        report.points += 1;
        let wanted = only.is_none_or(|only| only.binary_search(&key.brick().pack()).is_ok());
        if range <= config.max_range && wanted {
            report.brick_visits += 1;
            map.add_log_odds(key, config.update_max)?;
        }
    }
    Ok(report)
}

impl OccupancyMap {
    /// Gives back the payloads of bricks of the current revision that became uniform.
    pub(crate) fn collapse_touched(&mut self, threads: usize) {
        let revision = self.revision;
        for_each(&mut self.shards, threads, |_, shard| {
            shard.collapse_revision(revision);
        });
    }
}
