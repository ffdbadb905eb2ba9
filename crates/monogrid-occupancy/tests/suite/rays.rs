//! The rule `rays` against a brute-force dense grid, and against itself on more threads.
#![allow(clippy::unwrap_used, reason = "a test fails where it unwraps")]

use std::collections::BTreeMap;

use crate::common::{OwnedScan, Random, room_scan};
use monogrid_occupancy::*;

fn configs() -> Vec<IntegrationConfig> {
    let rays = IntegrationConfig {
        rule: IntegrationRule::Rays,
        ..IntegrationConfig::default()
    };
    let thesis = IntegrationConfig {
        update_min: -13.8,
        update_max: 13.8,
        model: SensorModel::Thrun {
            buffer: Buffer::Fixed(0.3),
            form: ThrunForm::Thesis,
        },
        ..rays.clone()
    };
    let with = |model| IntegrationConfig {
        model,
        ..rays.clone()
    };
    vec![
        rays.clone(),
        thesis,
        with(SensorModel::IDEAL),
        with(SensorModel::OCTOMAP),
        with(SensorModel::ANDERT),
        with(SensorModel::Thrun {
            buffer: Buffer::AUTO,
            form: ThrunForm::InverseDepth,
        }),
        IntegrationConfig {
            max_range: 1.7,
            ..rays
        },
    ]
}

/// Cells that a segment crosses, by clipping it against every cell of its bounding box.
fn cells_crossed(origin: [f64; 3], unit: [f64; 3], length: f64, resolution: f64) -> Vec<VoxelKey> {
    let at = |t: f64, a: usize| (origin[a] + t * unit[a]) / resolution;
    let span = |a: usize| {
        let (s, t) = (at(0.0, a), at(length, a));
        (s.min(t).floor() as i32, s.max(t).floor() as i32)
    };
    let mut cells = Vec::new();
    for x in span(0).0..=span(0).1 {
        for y in span(1).0..=span(1).1 {
            for z in span(2).0..=span(2).1 {
                let key = VoxelKey::new(x, y, z);
                let (mut enter, mut leave) = (0.0_f64, length);
                for (a, c) in key.to_array().into_iter().enumerate() {
                    let low = (f64::from(c) * resolution - origin[a]) / unit[a];
                    let high = (f64::from(c + 1) * resolution - origin[a]) / unit[a];
                    enter = enter.max(low.min(high));
                    leave = leave.min(low.max(high));
                }
                if enter < leave {
                    cells.push(key);
                }
            }
        }
    }
    cells
}

/// The thesis' rule, written as it reads: every measurement, every cell, the exact model, in
/// `f64`, clamped at each write.
fn brute_force(
    scans: &[OwnedScan],
    config: &IntegrationConfig,
    resolution: f64,
) -> BTreeMap<VoxelKey, f64> {
    let model = config.model.at_resolution(resolution);
    let mut grid = BTreeMap::new();
    for scan in scans {
        for (point, sigma) in scan.points.iter().zip(&scan.sigmas) {
            let point = point.map(f64::from);
            let z = point.iter().map(|c| c * c).sum::<f64>().sqrt();
            if z.is_nan() {
                continue;
            }
            let pose_sigma = scan.borrow().pose_sigma;
            let sigma = (f64::from(*sigma).powi(2)
                + pose_sigma.translation.powi(2)
                + (z * pose_sigma.rotation_rad).powi(2))
            .sqrt();
            let unit = scan.pose.rotate(point.map(|c| c / z));
            let origin = scan.pose.translation;
            // Well behind everything that any model changes.
            let length = (2.0 * z + 6.0 * sigma).min(config.max_range);
            for key in cells_crossed(origin, unit, length, resolution) {
                let center = key.center(resolution);
                let range: f64 = (0..3).map(|a| (center[a] - origin[a]) * unit[a]).sum();
                let limits = (f64::from(config.update_min), f64::from(config.update_max));
                let update = model.log_odds(range.max(1e-12), z, sigma, limits);
                if range > z && update.abs() < f64::from(config.cutoff_log_odds) {
                    continue;
                }
                let value: &mut f64 = grid.entry(key).or_insert(0.0);
                *value = (*value + update).clamp(-2.0, 3.5);
            }
        }
    }
    grid
}

#[test]
fn rays_equal_the_brute_force_grid_to_the_accuracy_of_the_tables() {
    for (case, config) in configs().into_iter().enumerate() {
        for resolution in [0.05, 0.13] {
            let mut random = Random(case as u64 + 1);
            // Few rays: table errors of many visits would add up and hide a wrong cell. One by one,
            // as clamped values depend on the order and the points of a scan have none.
            let scans: Vec<_> = (0..2)
                .flat_map(|pose| {
                    let room = room_scan(&mut random, pose, 40, 1.6);
                    let measured = room.points.iter().zip(&room.sigmas).enumerate();
                    let single = |(index, (point, sigma)): (usize, (&[f32; 3], &f32))| OwnedScan {
                        id: 40 * pose + index as u32,
                        pose: room.pose,
                        points: vec![*point],
                        sigmas: vec![*sigma],
                    };
                    measured.map(single).collect::<Vec<_>>()
                })
                .collect();
            let mut map = OccupancyMap::new(MapConfig::with_resolution(resolution)).unwrap();
            for scan in &scans {
                integrate(&mut map, &scan.borrow(), &config, 1).unwrap();
            }
            let expected = brute_force(&scans, &config, resolution);
            let (mut wrong, mut extra) = (Vec::new(), 0);
            for (key, value) in &expected {
                let found = map.log_odds_of(*key).map(f64::from);
                if found.is_none_or(|found| (found - value).abs() > 0.35) {
                    wrong.push((*key, *value, found));
                }
            }
            for cell in map.cells() {
                extra += usize::from(!expected.contains_key(&cell.key));
            }
            // Cells at the very end of a ray, where the cut decides, may differ in a few cases.
            let allowed = expected.len() / 200;
            assert!(
                wrong.len() <= allowed && extra <= allowed && expected.len() > 400,
                "case {case} at {resolution}: {} wrong, {extra} extra of {}: {:?}",
                wrong.len(),
                expected.len(),
                &wrong[..wrong.len().min(5)]
            );
        }
    }
}

#[test]
fn the_number_of_threads_does_not_change_a_byte() {
    for config in configs() {
        let mut files = Vec::new();
        for threads in [1, 2, 5] {
            let mut random = Random(9);
            let mut map = OccupancyMap::new(MapConfig::with_resolution(0.04)).unwrap();
            for id in 0..3 {
                let scan = room_scan(&mut random, id, 3000, 2.0);
                integrate(&mut map, &scan.borrow(), &config, threads).unwrap();
            }
            let mut bytes = Vec::new();
            write_ot(&map, &mut bytes).unwrap();
            files.push(bytes);
        }
        assert!(files[0].len() > 10_000);
        assert!(files[0] == files[1] && files[0] == files[2], "{config:?}");
    }
}

#[test]
fn the_order_of_updates_is_that_of_the_measurements() {
    // OctoMap's dynamics: 500 grazing free updates and then 100 hits end at the upper clamp.
    let mut points = vec![[0.0, 0.0, 4.0]; 500];
    points.extend([[0.0, 0.0, 2.02]; 100]);
    let scan = OwnedScan {
        id: 0,
        pose: Similarity {
            translation: [0.05, 0.05, 0.0],
            ..Similarity::IDENTITY
        },
        points,
        sigmas: vec![0.02; 600],
    };
    let config = IntegrationConfig {
        rule: IntegrationRule::Rays,
        ..IntegrationConfig::default()
    };
    let mut map = OccupancyMap::new(MapConfig::with_resolution(0.1)).unwrap();
    integrate(&mut map, &scan.borrow(), &config, 2).unwrap();
    assert_eq!(map.log_odds([0.05, 0.05, 2.05]), Some(3.5));
    assert_eq!(map.log_odds([0.05, 0.05, 1.05]), Some(-2.0));
    assert_eq!(map.state([0.05, 0.05, 3.0]), Occupancy::Free);
}

#[test]
fn end_points_only_gives_no_free_space() {
    let mut random = Random(4);
    let scan = room_scan(&mut random, 0, 500, 2.0);
    let config = IntegrationConfig {
        rule: IntegrationRule::Rays,
        model: SensorModel::None,
        ..IntegrationConfig::default()
    };
    let mut map = OccupancyMap::new(MapConfig::with_resolution(0.05)).unwrap();
    let report = integrate(&mut map, &scan.borrow(), &config, 1).unwrap();
    assert_eq!(report.points + report.skipped, scan.points.len());
    assert!(report.skipped > 0);
    assert!(map.cells().count() > 100);
    assert!(map.cells().all(|c| c.state == Occupancy::Occupied));
    for point in scan.points.iter().filter(|p| p[0].is_finite()) {
        let end = scan.pose.transform(point.map(f64::from));
        assert_eq!(map.state(end), Occupancy::Occupied);
    }
}

#[test]
fn a_small_memory_budget_is_an_error_and_leaves_the_map_as_it_was() {
    let mut random = Random(4);
    let scan = room_scan(&mut random, 0, 2000, 4.0);
    for rule in [IntegrationRule::Rays, IntegrationRule::Fused] {
        let config = IntegrationConfig {
            rule,
            ..IntegrationConfig::default()
        };
        let mut map = OccupancyMap::new(MapConfig {
            resolution: 0.02,
            memory_budget_bytes: 1 << 20,
            ..MapConfig::default()
        })
        .unwrap();
        map.add_log_odds(VoxelKey::new(1, 2, 3), 1.0).unwrap();
        let before = map.clone();
        let error = integrate(&mut map, &scan.borrow(), &config, 2).unwrap_err();
        let is_memory = matches!(
            error,
            MapError::MemoryBudget { .. } | MapError::TooFine { .. }
        );
        assert!(is_memory, "{error}");
        assert!(map == before);
    }
}

/// A curve of the user's is integrated as a model that is built in, by every rule.
#[test]
fn an_own_curve_is_a_model_like_any_other() {
    let own = SensorModel::Curve(SensorCurve {
        probability: |behind, _| match behind {
            ..-0.1 => 0.4,
            -0.1..=0.1 => 0.7,
            _ => f64::NAN,
        },
        reach: |_| 0.1,
    });
    let built_in = SensorModel::HitMiss {
        hit: 0.7,
        miss: 0.4,
        buffer: Buffer::Fixed(0.2),
    };
    for rule in [IntegrationRule::Rays, IntegrationRule::Fused] {
        let maps = [own, built_in].map(|model| {
            let mut map = OccupancyMap::new(MapConfig::with_resolution(0.05)).unwrap();
            let config = IntegrationConfig {
                model,
                rule,
                ..IntegrationConfig::default()
            };
            let scan = room_scan(&mut Random(3), 0, 2000, 1.6);
            integrate(&mut map, &scan.borrow(), &config, 1).unwrap();
            assert!(map.cell_counts().occupied > 100);
            let mut bytes = Vec::new();
            write_mgo(&map, &mut bytes).unwrap();
            bytes
        });
        assert!(maps[0] == maps[1]);
    }
}

#[test]
fn a_hit_and_a_miss_are_those_of_octomap() {
    let mut map = OccupancyMap::new(MapConfig::with_resolution(0.1)).unwrap();
    let config = IntegrationConfig {
        model: SensorModel::OCTOMAP,
        rule: IntegrationRule::Rays,
        update_min: -2.0,
        ..IntegrationConfig::default()
    };
    let scan = Scan::of_points(0, Similarity::IDENTITY, &[[0.05, 0.05, 2.05]], &[0.5]);
    integrate(&mut map, &scan, &config, 1).unwrap();
    let probability = |z: f64| {
        let log_odds = map.log_odds([0.05, 0.05, z]);
        log_odds.map(|log_odds| probability_from_log_odds(f64::from(log_odds)))
    };
    let near = |p: Option<f64>, expected: f64| (p.unwrap() - expected).abs() < 0.002;
    assert!(near(probability(1.0), 0.4) && near(probability(2.05), 0.7));
    assert_eq!(probability(2.45), None, "behind it nothing is known");
}
