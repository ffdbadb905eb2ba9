//! The rule `rays`: every measurement updates every cell that its ray crosses.
//!
//! Flow: measurements -> rays in cell units -> (1) each ray is walked brick by brick, and the
//! bricks are handed to their shards -> (2) each shard walks the cells of its bricks, ray by ray
//! in the order of the measurements. Free rays through bricks that are saturated free end at (2)
//! with a look into the directory; rays begin where the first cell lies that they could change
//! (see `settled`).

use super::parallel::for_each;
use super::ray::{Entry, MAX_CELLS, RANGE_BITS, Ray, TIME_BITS, fixed};
use super::settled::{BeamTiles, NEAR_CELLS, Settled};
use super::{IntegrationConfig, IntegrationReport};
use crate::error::MapError;
use crate::evidence::Limits;
use crate::key::{BRICK_LIMIT, BrickKey};
use crate::map::OccupancyMap;
use crate::scan::Scan;
use crate::sensor::table::TableSet;
use crate::storage::{BrickRef, SHARDS, Shard, SlotIndex, hash, shard_of};

/// A measurement as a ray with its evidence.
pub(crate) struct Beam {
    ray: Ray,
    /// Slopes of its direction in the sensor frame, along x and y over z.
    pub slopes: [f32; 2],
    /// Whether it looks along the sensor's z axis rather than against it.
    pub looks_forward: bool,
    /// Time up to which no cell can change any more.
    settled_until: i64,
    table: u16,
    /// Range in fixed point at which the first entry of the table begins.
    table_start: i64,
    /// Entries per unit of fixed-point range.
    entries_per_range: f64,
    /// Bricks that the ray leaves before this time lie wholly in free space.
    free_until: i64,
}

/// One brick on the way of one beam: packed key and `beam << 2 | near << 1 | free`.
type Visit = (u64, u32);
const FREE: u32 = 1;
/// The piece before the settled one.
const NEAR: u32 = 2;

/// Visits found by one worker, by shard.
type VisitLists = Vec<Vec<Visit>>;

/// Beams walked before their visits are applied: few enough to stay in a core's own cache, where
/// every brick on their way looks them up.
const BEAMS_PER_BATCH: usize = 4096;
/// Beams are always walked up to this time: around the sensor, cells that few beams cross would
/// keep all of them from being settled.
const NEAR_END: i64 = (NEAR_CELLS as i64) << TIME_BITS;
/// No cell is left out twice or visited twice if the settled piece is longer than a cell.
const CELL_DIAGONAL: i64 = 2 << TIME_BITS;
/// Share of the beams after which settled space is looked for again, and how much later then.
const FIRST_SHARE: usize = 8;
const NEXT_SHARE: usize = 3;

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
    let (mut beams, tables) = prepare_beams(map, scan, config)?;
    check_budget(map, &beams)?;
    map.revision += 1;
    let mut report = IntegrationReport {
        points: beams.len(),
        skipped: scan.len() - beams.len(),
        brick_visits: 0,
    };
    let tiles = BeamTiles::new(map, scan, &beams);
    let mut lists: Vec<VisitLists> = vec![vec![Vec::new(); SHARDS]; threads];
    let mut next_search = 0;
    let mut first = 0;
    while first < beams.len() {
        if first >= next_search
            && let Some(tiles) = &tiles
        {
            let settled = Settled::search(map, tiles, threads);
            settle(&mut beams[first..], tiles, &settled, threads);
            next_search = (first * NEXT_SHARE).max(beams.len() / FIRST_SHARE).max(1);
        }
        let mut last = (first + BEAMS_PER_BATCH).min(beams.len());
        if first < next_search {
            last = last.min(next_search);
        }
        let beams = &beams[first..last];
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
        first = last;
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
                slopes: [0, 1].map(|i| (measured.point[i] / measured.point[2]) as f32),
                looks_forward: measured.point[2] > 0.0,
                settled_until: 0,
                ray: Ray::new(origin, direction, length / resolution),
                table,
                table_start: fixed(start / resolution, RANGE_BITS),
                entries_per_range: evidence.inv_step * resolution / (1_u64 << RANGE_BITS) as f64,
                // Certain free space is what takes cells down.
                free_until: if evidence.free < 0 {
                    fixed(
                        (start / resolution - half_diagonal).clamp(0.0, MAX_CELLS),
                        TIME_BITS,
                    )
                } else {
                    0
                },
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

impl Beam {
    /// Range, in cells, up to which the beam sees nothing but free space.
    pub(crate) fn free_cells(&self) -> f64 {
        self.free_until.min(self.ray.end) as f64 / (1_u64 << TIME_BITS) as f64
    }

    #[inline]
    fn enter(&self, key: u64) -> Entry {
        self.ray
            .enter_from(BrickKey::unpack(key), self.settled_until)
    }
}

/// Lets beams begin where the first cell lies that they could change.
fn settle(beams: &mut [Beam], tiles: &BeamTiles, settled: &Settled, threads: usize) {
    let share = beams.len().div_ceil(threads).max(1);
    let mut shares: Vec<&mut [Beam]> = beams.chunks_mut(share).collect();
    for_each(&mut shares, threads, |_, beams| {
        for beam in beams.iter_mut() {
            let cells = settled.until(tiles.tile_of(beam.slopes));
            let until = fixed(cells.min(MAX_CELLS), TIME_BITS).min(beam.free_until);
            beam.settled_until = if until > NEAR_END + CELL_DIAGONAL {
                until.min(beam.ray.end)
            } else {
                0
            };
        }
    });
}

/// Upper bound of the bricks that a ray can meet.
fn most_bricks(beam: &Beam) -> f64 {
    let cells = beam.ray.end as f64 / (1_u64 << TIME_BITS) as f64;
    // Crossings on three axes: at most sqrt(3) per brick's edge of length, one more each.
    3_f64.sqrt() * cells / 8.0 + 4.0
}

/// Fails before anything is changed if the scan could exceed the memory budget: tries ever
/// tighter and dearer upper bounds.
fn check_budget(map: &OccupancyMap, beams: &[Beam]) -> Result<(), MapError> {
    let loose = beams.iter().map(most_bricks).sum::<f64>() as usize;
    if map.check_budget(loose, loose).is_ok() {
        return Ok(());
    }
    let keys = bricks_crossed(beams);
    let without_payload = keys
        .iter()
        .filter(|&&key| !map.has_payload(BrickKey::unpack(key)))
        .count();
    map.check_budget(without_payload, without_payload)
}

/// Packed keys of the bricks that the rays of a scan cross, in no order.
pub(crate) fn bricks_seen(
    map: &OccupancyMap,
    scan: &Scan,
    config: &IntegrationConfig,
) -> Result<Vec<u64>, MapError> {
    Ok(bricks_crossed(&prepare_beams(map, scan, config)?.0))
}

fn bricks_crossed(beams: &[Beam]) -> Vec<u64> {
    let mut keys = Vec::new();
    for beams in beams.chunks(4096) {
        for beam in beams {
            beam.ray.for_each_brick(|key, _| keys.push(key));
        }
        keys.sort_unstable();
        keys.dedup();
    }
    keys
}

/// Packed keys of the bricks that hold the end points of a scan, in no order.
pub(crate) fn end_point_bricks(
    map: &OccupancyMap,
    scan: &Scan,
    config: &IntegrationConfig,
) -> Vec<u64> {
    (0..scan.len())
        .filter_map(|index| {
            let measured = scan.measurement(index, config.sigma_mode)?;
            let key = map.key(scan.world_from_sensor.transform(measured.point))?;
            Some(key.brick().pack())
        })
        .collect()
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
            let word = ((first + index) as u32) << 2;
            let mut push = |key: u64, flags: u32| {
                if only.is_none_or(|only| only.binary_search(&key).is_ok()) {
                    lists[shard_of(hash(key))].push((key, word | flags));
                }
            };
            if beam.settled_until > 0 {
                beam.ray.any_brick_leaving(|key, leaves| {
                    push(key, NEAR | FREE);
                    leaves >= NEAR_END
                });
            }
            beam.ray
                .for_each_brick_from(beam.settled_until, |key, leaves| {
                    push(key, u32::from(leaves < beam.free_until));
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
            let beam = &self.beams[(word >> 2) as usize];
            let slot = shard.find_or_insert(key, hash(key));
            if word & FREE == 0 {
                self.mark(shard, slot, key, beam);
            } else {
                self.clear(shard, slot, key, beam, word & NEAR != 0);
            }
        }
    }

    /// A brick that the beam crosses wholly in free space, or its near piece in one.
    fn clear(&mut self, shard: &mut Shard, slot: SlotIndex, key: u64, beam: &Beam, is_near: bool) {
        let free = self.tables.table(beam.table).free;
        if free == 0 {
            return;
        }
        if shard.contents(slot) == BrickRef::Uniform(self.limits.min) && free < 0 {
            return;
        }
        let limits = self.limits;
        let cells = &mut shard.payload_mut(slot).0;
        let entry = if is_near {
            Ray::until(beam.ray.enter(BrickKey::unpack(key)), NEAR_END)
        } else {
            beam.enter(key)
        };
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
        let entry = beam.enter(key);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::integrate::IntegrationRule;
    use crate::map::MapConfig;
    use crate::scan::{PointScan, PoseSigma, ScanData, Similarity};

    /// Every beam from the sensor to its end, one after the other.
    fn walk_everything(map: &mut OccupancyMap, scan: &Scan, config: &IntegrationConfig) {
        let (beams, tables) = prepare_beams(map, scan, config).unwrap();
        map.revision += 1;
        let (limits, revision) = (map.limits, map.revision);
        for beam in &beams {
            beam.ray.for_each_brick(|key, _| {
                let mut writer = ShardWriter {
                    beams: &beams,
                    tables: &tables,
                    limits,
                    revision,
                    free_visits: 0,
                };
                let shard = &mut map.shards[shard_of(hash(key))];
                let slot = shard.find_or_insert(key, hash(key));
                writer.mark(shard, slot, key, beam);
            });
        }
    }

    #[test]
    fn leaving_out_settled_space_changes_nothing() {
        let mut state = 1_u64;
        let mut unit = move || {
            state = state
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            (state >> 40) as f32 / (1 << 24) as f32
        };
        for (resolution, threads) in [(0.08, 1), (0.05, 3)] {
            let config = IntegrationConfig {
                rule: IntegrationRule::Rays,
                update_min: -2.0,
                ..IntegrationConfig::default()
            };
            let new_map = || OccupancyMap::new(MapConfig::with_resolution(resolution)).unwrap();
            let (mut map, mut expected) = (new_map(), new_map());
            for id in 0..6 {
                // A wall with a box before it, seen from a place that moves on.
                let points: Vec<[f32; 3]> = (0..20_000)
                    .map(|i| {
                        let (u, v) = (1.2 * unit() - 0.6, unit() - 0.5);
                        let z = if u > 0.2 && v > 0.0 { 1.5 } else { 2.6 };
                        let z = z + 0.02 * unit() + if i % 500 == 3 { -0.6 } else { 0.0 };
                        [u * z, v * z, z]
                    })
                    .collect();
                let (sin, cos) = (0.05 * f64::from(id)).sin_cos();
                let scan = Scan {
                    id,
                    world_from_sensor: Similarity {
                        scale: 1.0,
                        rotation: [[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]],
                        translation: [0.03 * f64::from(id), 0.21, -0.4],
                    },
                    pose_sigma: PoseSigma::default(),
                    data: ScanData::Points(PointScan {
                        points: &points,
                        sigmas: &[0.02],
                    }),
                };
                integrate_rays(&mut map, &scan, &config, threads, None).unwrap();
                walk_everything(&mut expected, &scan, &config);
                expected.collapse_touched(1);
                assert!(map == expected, "scan {id} at {resolution}");
                let (beams, _) = prepare_beams(&map, &scan, &config).unwrap();
                let tiles = BeamTiles::new(&map, &scan, &beams).unwrap();
                let settled = Settled::search(&map, &tiles, threads);
                let is_short = |b: &&Beam| settled.until(tiles.tile_of(b.slopes)) > 8.0;
                let short = beams.iter().filter(is_short).count();
                assert!(id < 3 || short > 1000, "{short} beams begin later");
            }
        }
    }
}
