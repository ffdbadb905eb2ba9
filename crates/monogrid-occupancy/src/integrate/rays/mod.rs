//! The rule `rays`: every measurement updates every cell that its ray crosses (`[AW87]`).
//!
//! Flow: measurements -> rays in cell units (`beam`) -> in batches (`batches`), the rays' updates
//! are handed to the shards of their bricks, and each shard takes them ray by ray in the order in
//! which `beam` has them (`visits`). Rays begin where the first cell lies that they could change
//! (`saturated`).

mod batches;
pub(crate) mod beam;
pub(crate) mod pyramid;
pub(crate) mod ray;
pub(crate) mod saturated;
mod visits;

use crate::error::MapError;
use crate::integrate::parallel::for_each;
use crate::integrate::rays::batches::Walk;
use crate::integrate::rays::beam::{Beams, Beginnings};
use crate::integrate::rays::saturated::BeamTiles;
use crate::integrate::{IntegrationConfig, IntegrationReport};
use crate::key::{BRICK_EDGE, BrickFilter, BrickKey};
use crate::map::OccupancyMap;
use crate::scan::Scan;

/// The beams of a scan and their directions; does not depend on what the map holds.
pub(crate) struct Prepared {
    beams: Beams,
    /// Where it is worth a search.
    tiles: Option<BeamTiles>,
    skipped: usize,
}

impl Prepared {
    /// Prepares a valid scan.
    fn new(map: &OccupancyMap, scan: &Scan, config: &IntegrationConfig) -> Result<Self, MapError> {
        let beams = Beams::new(map, scan, config)?;
        Ok(Self {
            tiles: BeamTiles::new(scan, &beams),
            skipped: scan.len() - beams.measured.len(),
            beams,
        })
    }
}

/// Adds valid scans one after the other by the rule `rays`; on an error, those before it.
pub(crate) fn integrate_scans(
    map: &mut OccupancyMap,
    scans: &[Scan],
    config: &IntegrationConfig,
    threads: usize,
) -> Result<IntegrationReport, MapError> {
    let mut report = IntegrationReport::default();
    for scans in scans.chunks(threads) {
        let mut prepared: Vec<_> = scans.iter().map(|scan| (scan, None)).collect();
        for_each(&mut prepared, threads, |_, (scan, prepared)| {
            *prepared = Some(Prepared::new(map, scan, config));
        });
        for prepared in prepared.into_iter().filter_map(|(_, prepared)| prepared) {
            let prepared = prepared?;
            if let Err(error) = check_budget(map, &prepared.beams) {
                map.pack_for_budget(error, threads)?;
                check_budget(map, &prepared.beams)?;
            }
            report.add(&integrate_prepared(map, &prepared, threads, None));
        }
    }
    Ok(report)
}

/// Adds a valid scan by the rule `rays`.
pub(crate) fn integrate_rays(
    map: &mut OccupancyMap,
    scan: &Scan,
    config: &IntegrationConfig,
    threads: usize,
    only: BrickFilter,
) -> Result<IntegrationReport, MapError> {
    let prepared = Prepared::new(map, scan, config)?;
    check_budget(map, &prepared.beams)?;
    Ok(integrate_prepared(map, &prepared, threads, only))
}

fn integrate_prepared(
    map: &mut OccupancyMap,
    prepared: &Prepared,
    threads: usize,
    only: BrickFilter,
) -> IntegrationReport {
    map.revision += 1;
    let Prepared { beams, tiles, .. } = prepared;
    let all = &beams.measured[..];
    let mut report = IntegrationReport {
        points: all.len(),
        skipped: prepared.skipped,
        brick_visits: 0,
    };
    let mut spare = Vec::new();
    let mut first = 0;
    while first < all.len() {
        let beginnings = tiles
            .as_ref()
            .map(|tiles| Beginnings::find(map, tiles, threads));
        let last = match beginnings {
            Some(_) if first == 0 && beams.first_share > 0 => beams.first_share,
            _ => all.len(),
        };
        let walk = Walk {
            beams,
            beginnings: beginnings.as_ref(),
            only,
            threads,
        };
        report.brick_visits += walk.integrate(map, &all[first..last], &mut spare);
        first = last;
    }
    map.collapse_touched(threads);
    report
}

/// Upper bound of the bricks that the rays can meet, each counted for itself.
fn most_bricks(beams: &Beams) -> usize {
    // Crossings on three axes: at most sqrt(3) per brick's edge of length, one more each.
    let per_cell = 3_f64.sqrt() / f64::from(BRICK_EDGE);
    (per_cell * beams.extent.length) as usize + 4 * beams.measured.len()
}

/// Fails before anything is changed if the scan could exceed the memory budget: tries ever
/// tighter and dearer upper bounds.
fn check_budget(map: &OccupancyMap, beams: &Beams) -> Result<(), MapError> {
    let loose = most_bricks(beams);
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
    Ok(bricks_crossed(&Beams::new(map, scan, config)?))
}

fn bricks_crossed(beams: &Beams) -> Vec<u64> {
    let mut keys = Vec::new();
    let mut distinct = 0;
    for measured in &beams.measured {
        let beam = beams.beam(measured);
        beam.ray.for_each_brick(|key, _| keys.push(key));
        if keys.len() > 2 * distinct + (1 << 18) {
            keys.sort_unstable();
            keys.dedup();
            distinct = keys.len();
        }
    }
    keys.sort_unstable();
    keys.dedup();
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
    use crate::integrate::rays::beam::Measured;
    use crate::map::MapConfig;
    use crate::scan::{PointScan, PoseSigma, ScanData, Similarity};
    use crate::storage::{hash, shard_of};
    use crate::test_random::Random;

    /// Every beam from the sensor to its end, one after the other.
    fn walk_everything(map: &mut OccupancyMap, scan: &Scan, config: &IntegrationConfig) {
        let beams = Beams::new(map, scan, config).unwrap();
        map.revision += 1;
        let (rule, revision) = (beams.tables.rule(map.limits), map.revision);
        for measured in &beams.measured {
            let beam = beams.beam(measured);
            beam.ray.for_each_brick(|key, _| {
                let shard = &mut map.shards[shard_of(hash(key))];
                let slot = shard.find_or_insert(key, hash(key));
                let cells = &mut shard.payload_mut(slot).0;
                let entry = beam.ray.enter(BrickKey::unpack(key));
                beam.ray.walk(entry, |index, range| {
                    let delta = beam.evidence_at(range, beams.tables.table(beam.table));
                    if delta != 0 {
                        cells[index] = rule.updated(cells[index], delta);
                    }
                });
                shard.touch(slot, revision);
            });
        }
    }

    #[test]
    fn leaving_out_saturated_space_changes_nothing() {
        let mut random = Random(1);
        let mut unit = move || random.unit();
        // The first sensor of the second case is where eight cells meet.
        let cases = [
            (0.08, 1, 0.21, [0, 0]),
            (0.05, 3, 0.0, [0, 0]),
            (0.05, 2, 0.21, [15, 3]),
        ];
        for (resolution, threads, y, updates_to_belief) in cases {
            let config = IntegrationConfig {
                rule: IntegrationRule::Rays,
                update_min: -2.0,
                updates_to_belief,
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
                        translation: [0.03 * f64::from(id), y, 0.0],
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
                let beams = Beams::new(&map, &scan, &config).unwrap();
                let tiles = BeamTiles::new(&scan, &beams).unwrap();
                let found = Beginnings::find(&map, &tiles, threads);
                let is_short = |b: &&Measured| found.saturated.until(tiles.tile_of(b.slopes)) > 8.0;
                let short = beams.measured.iter().filter(is_short).count();
                assert!(id < 3 || short > 1000, "{short} beams begin later");
            }
        }
    }
}
