//! The rule `fused`: one update per cell and scan.
//!
//! Flow: measurements, or a depth image as it is (`depth_image`) -> range images with bounds over
//! windows of pixels -> cubes are split, down to 4 x 4 x 4 cells, only where the bounds cannot tell
//! what their cells get (`search`) -> free bricks get one addition, mixed ones an update per cell
//! from the measurements in the cell's footprint, shard by shard (`writer`). A brick that is
//! saturated free and can only become freer costs a look into the directory.
//!
//! All but the last step depends on the scan alone, so the next scans are prepared beside the
//! writing of the present ones, and each shard is written scan by scan: the map is that of one scan
//! after the other.

pub(crate) mod footprint;
pub(crate) mod octants;
#[cfg(target_arch = "x86_64")]
mod octants_avx2;
pub(crate) mod search;
mod writer;

use crate::error::MapError;
use crate::evidence::Limits;
use crate::integrate::fused::footprint::Footprints;
use crate::integrate::fused::search::{Search, Task, Update};
use crate::integrate::fused::writer::Writer;
use crate::integrate::image::RangeImages;
use crate::integrate::parallel::for_each;
use crate::integrate::rays::beam::origin_in_cells;
use crate::integrate::{IntegrationConfig, IntegrationReport};
use crate::key::BrickFilter;
use crate::key::BrickKey;
use crate::map::OccupancyMap;
use crate::scan::Scan;
use crate::sensor::table::KnownTables;
use crate::storage::Shard;

/// A scan ready to be written: what its measurements say, and the bricks that it changes. Does not
/// depend on what the map holds.
pub(crate) struct Prepared {
    footprints: Footprints,
    resolution: f64,
    /// By shard.
    tasks: Vec<Vec<Task>>,
    /// Bricks that can need a payload.
    mixed: usize,
    report: IntegrationReport,
}

impl Prepared {
    /// Prepares a valid scan for a map with cells of that edge.
    fn new(
        (resolution, known_tables): (f64, &KnownTables),
        scan: &Scan,
        config: &IntegrationConfig,
        threads: usize,
        only: BrickFilter,
    ) -> Result<Self, MapError> {
        let images = RangeImages::new(scan, config, resolution, threads, known_tables)?;
        let points = images.points;
        let footprints = Footprints::new(images, config.max_range, resolution);
        let search = Search {
            footprints: &footprints,
            resolution,
        };
        let tasks = search.tasks(threads, only);
        let is_mixed = |task: &&Task| task.1 != Update::Free;
        Ok(Self {
            resolution,
            mixed: tasks.iter().flatten().filter(is_mixed).count(),
            report: IntegrationReport {
                points,
                skipped: scan.len() - points,
                brick_visits: tasks.iter().map(Vec::len).sum(),
            },
            footprints,
            tasks,
        })
    }

    /// Writes the bricks of one shard.
    fn write(&self, index: usize, shard: &mut Shard, limits: Limits, revision: u32) {
        let writer = Writer {
            footprints: &self.footprints,
            resolution: self.resolution,
            rule: self.footprints.images.tables.rule(limits),
            revision,
        };
        for &(key, update) in &self.tasks[index] {
            writer.update_brick(shard, key, update);
        }
    }

    /// Fails before anything is changed if the scan could exceed the memory budget.
    fn check_budget(&self, map: &OccupancyMap) -> Result<(), MapError> {
        if map
            .check_budget(self.report.brick_visits, self.mixed)
            .is_ok()
        {
            return Ok(());
        }
        let is_new = |task: &&Task| !map.has_payload(BrickKey::unpack(task.0));
        let new: Vec<&Task> = self.tasks.iter().flatten().filter(is_new).collect();
        map.check_budget(
            new.len(),
            new.iter().filter(|t| t.1 != Update::Free).count(),
        )
    }
}

/// Scans that are prepared and written together, per thread.
const SCANS_PER_THREAD: usize = 2;

/// Adds a valid scan by the rule `fused`.
pub(crate) fn integrate_fused(
    map: &mut OccupancyMap,
    scan: &Scan,
    config: &IntegrationConfig,
    threads: usize,
    only: BrickFilter,
) -> Result<IntegrationReport, MapError> {
    origin_in_cells(map, scan)?;
    let prepared = Prepared::new(
        (map.resolution(), &map.known_tables),
        scan,
        config,
        threads,
        only,
    )?;
    prepared.check_budget(map)?;
    advance(map, &[&prepared], &[], config, threads);
    Ok(prepared.report)
}

/// Adds valid scans one after the other by the rule `fused`, each of which needs at most
/// `bytes_per_scan` when it is prepared; on an error, those before it.
pub(crate) fn integrate_scans(
    map: &mut OccupancyMap,
    scans: &[Scan],
    config: &IntegrationConfig,
    threads: usize,
    bytes_per_scan: f64,
) -> Result<IntegrationReport, MapError> {
    // A quarter of the memory for the scans that are prepared and those that are written meanwhile.
    let room = map.config().memory_budget_bytes as f64 / 8.0;
    let scans_at_once = ((room / bytes_per_scan) as usize).clamp(1, SCANS_PER_THREAD * threads);
    // All that could go wrong with a scan before the map is asked for memory.
    let far = scans.iter().position(|s| origin_in_cells(map, s).is_err());
    let mut groups = scans[..far.unwrap_or(scans.len())].chunks(scans_at_once);
    let mut report = IntegrationReport::default();
    let mut present: Vec<Prepared> = Vec::new();
    let mut failed = None;
    loop {
        let next = groups.next().unwrap_or(&[]);
        let all: Vec<&Prepared> = present.iter().collect();
        let bricks = all.iter().map(|p| p.report.brick_visits).sum();
        let fit = map.check_budget(bricks, all.iter().map(|p| p.mixed).sum());
        let prepared = if fit.is_ok() {
            advance(map, &all, next, config, threads)
        } else {
            for one in &all {
                one.check_budget(map).or_else(|error| {
                    map.pack_for_budget(error, threads)?;
                    one.check_budget(map)
                })?;
                advance(map, &[*one], &[], config, threads);
            }
            advance(map, &[], next, config, threads)
        };
        all.iter().for_each(|p| report.add(&p.report));
        present.clear();
        for prepared in prepared {
            match prepared {
                Ok(prepared) => present.push(prepared),
                Err(error) => {
                    failed = Some(error);
                    groups = [].chunks(1);
                    break;
                }
            }
        }
        if present.is_empty() {
            break;
        }
    }
    if let Some(error) = failed {
        return Err(error);
    }
    match far {
        Some(far) => origin_in_cells(map, &scans[far]).map(|_| report),
        None => Ok(report),
    }
}

/// Something to be done that depends on nothing else that is done at the same time.
enum Job<'a> {
    Prepare(&'a Scan<'a>, &'a mut Option<Result<Prepared, MapError>>),
    Write(usize, &'a mut Shard),
}

/// Writes `present` into the map and prepares `next` meanwhile.
fn advance(
    map: &mut OccupancyMap,
    present: &[&Prepared],
    next: &[Scan],
    config: &IntegrationConfig,
    threads: usize,
) -> Vec<Result<Prepared, MapError>> {
    let (limits, before) = (map.limits, map.revision);
    let cells = (map.resolution(), &map.known_tables);
    map.revision += present.len() as u32;
    // The largest first, so that no thread is left with one at the end.
    let cost = |index: usize| -> usize { present.iter().map(|p| p.tasks[index].len()).sum() };
    let mut shards: Vec<(usize, &mut Shard)> = map.shards.iter_mut().enumerate().collect();
    shards.sort_by_key(|(index, _)| std::cmp::Reverse(cost(*index)));
    let mut prepared: Vec<_> = next.iter().map(|_| None).collect();
    let places = next.iter().zip(&mut prepared);
    let mut jobs: Vec<Job> = places
        .map(|(scan, place)| Job::Prepare(scan, place))
        .collect();
    jobs.extend(shards.into_iter().map(|(i, shard)| Job::Write(i, shard)));
    for_each(&mut jobs, threads, |_, job| match job {
        Job::Prepare(scan, place) => {
            **place = Some(Prepared::new(cells, scan, config, 1, None));
        }
        Job::Write(index, shard) => {
            for (scan, revision) in present.iter().zip(before + 1..) {
                scan.write(*index, shard, limits, revision);
            }
        }
    });
    prepared.into_iter().flatten().collect()
}

/// Packed keys of the bricks that a scan can change, in no order.
pub(crate) fn bricks_seen(
    map: &OccupancyMap,
    scan: &Scan,
    config: &IntegrationConfig,
    threads: usize,
) -> Result<Vec<u64>, MapError> {
    origin_in_cells(map, scan)?;
    let prepared = Prepared::new(
        (map.resolution(), &map.known_tables),
        scan,
        config,
        threads,
        None,
    )?;
    let tasks = prepared.tasks.into_iter().flatten();
    Ok(tasks.map(|task| task.0).collect())
}
#[cfg(test)]
mod tests {
    use super::*;
    use crate::integrate::fused::search::relative_center;
    use crate::integrate::kernel::scalar::cells_of;
    use crate::map::MapConfig;
    use crate::scan::{PointScan, PoseSigma, ScanData, Similarity};
    use crate::test_random::Random;

    /// A rough room around the sensor, in all directions or within 75 degrees of forward.
    fn scan_points(everywhere: bool, seed: u64, count: usize) -> Vec<[f32; 3]> {
        let mut random = Random(seed);
        let mut unit = move || random.unit();
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
        let images = RangeImages::new(scan, config, resolution, 1, &map.known_tables).unwrap();
        let footprints = Footprints::new(images, config.max_range, resolution);
        let reach = (3.0 / resolution / 8.0).ceil() as i32;
        for x in -reach..reach {
            for y in -reach..reach {
                for z in -reach..reach {
                    let brick = BrickKey::new(x, y, z);
                    let center = relative_center(brick, 4.0, resolution, footprints.images.origin);
                    let weights = footprints.weights(center);
                    for cell in (0..8).flat_map(cells_of) {
                        let [x, y, z] = cell;
                        let update = footprints.cell_evidence(center, cell, &weights);
                        if update != 0 {
                            let key = brick.cell(x + 8 * y + 64 * z);
                            let rule = map.limits.rule(config.updates_to_belief);
                            let value = rule.updated(map.evidence(key), update);
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
            for (max_range, updates_to_belief) in [(100.0, [0, 0]), (0.8, [0, 0]), (100.0, [15, 3])]
            {
                let config = IntegrationConfig {
                    max_range,
                    updates_to_belief,
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
