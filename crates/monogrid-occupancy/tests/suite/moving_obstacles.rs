//! A box moves through a room before a depth camera: what stays in the map where it was?
#![allow(clippy::unwrap_used, reason = "a test fails where it unwraps")]

use std::collections::BTreeSet;
use std::sync::Arc;

use crate::common::{Random, room_scan};
use monogrid_occupancy::*;

const CELL: f64 = 0.05;
/// The room reaches from -ROOM to ROOM on each axis.
const ROOM: f64 = 2.0;
const HALF_BOX: f64 = 0.3;
const SIGMA: f64 = 0.01;

type Bounds = ([f64; 3], [f64; 3]);

fn moving_box(center: [f64; 3]) -> Bounds {
    (center.map(|c| c - HALF_BOX), center.map(|c| c + HALF_BOX))
}

/// Range of the first surface on a ray from inside the room.
fn range_to_surface(origin: [f64; 3], unit: [f64; 3], obstacle: Option<Bounds>) -> f64 {
    let to_wall = (0..3)
        .map(|a| (ROOM.copysign(unit[a]) - origin[a]) / unit[a])
        .fold(f64::MAX, f64::min);
    let Some((low, high)) = obstacle else {
        return to_wall;
    };
    let (mut enter, mut leave) = (0.0_f64, f64::MAX);
    for a in 0..3 {
        let (s, t) = (
            (low[a] - origin[a]) / unit[a],
            (high[a] - origin[a]) / unit[a],
        );
        enter = enter.max(s.min(t));
        leave = leave.min(s.max(t));
    }
    if enter < leave {
        enter.min(to_wall)
    } else {
        to_wall
    }
}

/// A depth image (80 degrees, every fourth pixel a hole) of a camera at `origin` that looks along
/// +x.
fn camera_scan(
    random: &mut Random,
    id: u32,
    origin: [f64; 3],
    obstacle: Option<Bounds>,
) -> crate::common::OwnedScan {
    let pose = Similarity {
        scale: 1.0,
        // Columns: right = -y, down = -z, forward = x.
        rotation: [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]],
        translation: origin,
    };
    let (mut points, mut sigmas) = (Vec::new(), Vec::new());
    for v in -60..=60 {
        for u in -80..=80 {
            if random.unit() < 0.25 {
                continue;
            }
            let slopes = [f64::from(u) / 95.0, f64::from(v) / 95.0, 1.0];
            let norm = slopes.iter().map(|c| c * c).sum::<f64>().sqrt();
            let unit = slopes.map(|c| c / norm);
            let noise = SIGMA * random.between(-1.7, 1.7);
            let range = range_to_surface(origin, pose.rotate(unit), obstacle) + noise;
            points.push(unit.map(|c| (c * range) as f32));
            sigmas.push(SIGMA as f32);
        }
    }
    crate::common::OwnedScan {
        id,
        pose,
        points,
        sigmas,
    }
}

fn holds(bounds: &Bounds, point: [f64; 3], margin: f64) -> bool {
    (0..3).all(|a| point[a] > bounds.0[a] - margin && point[a] < bounds.1[a] + margin)
}

/// Cells well inside the room that are occupied.
fn occupied_inside(map: &OccupancyMap) -> BTreeSet<VoxelKey> {
    map.cells()
        .filter(|cell| map.state_of(cell.key) == Occupancy::Occupied)
        .map(|cell| cell.key)
        .filter(|key| key.center(CELL).iter().all(|c| c.abs() < ROOM - 0.3))
        .collect()
}

fn config(rule: IntegrationRule) -> IntegrationConfig {
    IntegrationConfig {
        rule,
        ..IntegrationConfig::default()
    }
}

/// Where the box is at each scan: it crosses the view sideways in steps of 6 cm, stands still for
/// the last ten scans.
fn path() -> Vec<[f64; 3]> {
    (0..40)
        .map(|step: i32| [0.6, -1.2 + 0.06 * f64::from(step.min(30)), 0.1])
        .collect()
}

#[test]
fn a_box_that_moved_on_leaves_less_than_a_twentieth_of_its_cells() {
    for rule in [IntegrationRule::Rays, IntegrationRule::Fused] {
        let mut random = Random(11);
        let mut map = OccupancyMap::new(MapConfig::with_resolution(CELL)).unwrap();
        let mut ever = BTreeSet::new();
        for (id, center) in path().into_iter().enumerate() {
            let origin = [-1.6, 0.0, 0.0];
            let scan = camera_scan(&mut random, id as u32, origin, Some(moving_box(center)));
            integrate(&mut map, &scan.borrow(), &config(rule), 1).unwrap();
            ever.extend(occupied_inside(&map));
        }
        let last = moving_box(path()[39]);
        let margin = 3.0 * CELL;
        let was: Vec<_> = ever
            .into_iter()
            .filter(|key| !holds(&last, key.center(CELL), margin))
            .collect();
        let ghosts = was
            .iter()
            .filter(|key| map.state_of(**key) == Occupancy::Occupied)
            .count();
        assert!(was.len() > 200, "{rule:?}: {} cells", was.len());
        println!("{rule:?}: {ghosts} of {} cells", was.len());
        assert!(
            ghosts * 20 < was.len(),
            "{rule:?}: {ghosts} of {}",
            was.len()
        );
        // The box itself is there.
        let [x, y, z] = path()[39];
        assert_eq!(
            map.state([x - HALF_BOX + 0.5 * CELL, y, z]),
            Occupancy::Occupied
        );
    }
}

/// Adds a scan with the default settings.
fn add(map: &mut OccupancyMap, scan: &Scan, threads: usize) {
    integrate(map, scan, &IntegrationConfig::default(), threads).unwrap();
}

#[test]
fn what_nobody_looks_at_again_decays_and_a_loaded_map_comes_back() {
    let mut random = Random(12);
    let mut loaded = OccupancyMap::new(MapConfig::with_resolution(CELL)).unwrap();
    for id in 0..4 {
        let scan = camera_scan(&mut random, id, [-1.6, 0.0, 0.0], None);
        add(&mut loaded, &scan.borrow(), 1);
    }
    loaded.pack(1);
    let loaded = Arc::new(loaded);
    let settings = DecayConfig {
        half_life_scans: 20.0,
        period_scans: 5,
        ..DecayConfig::default()
    };
    let run = |threads: usize| {
        let mut random = Random(13);
        let mut map = OccupancyMap::clone(&loaded);
        let mut decay = Decay::new(settings.clone(), Some(loaded.clone())).unwrap();
        // A box stands there for a while; then the camera has gone elsewhere.
        for id in 0..10 {
            let obstacle = Some(moving_box([0.6, 0.2, 0.1]));
            let scan = camera_scan(&mut random, id, [-1.6, 0.0, 0.0], obstacle);
            add(&mut map, &scan.borrow(), threads);
            decay.scan_integrated(&mut map, threads).unwrap();
        }
        let with_box = occupied_inside(&map).len();
        assert!(with_box > 50, "{with_box}");
        let mut changed = 0;
        for id in 10..110 {
            let mut scan = room_scan(&mut random, id, 100, 1.0);
            scan.pose.translation[0] += 100.0;
            add(&mut map, &scan.borrow(), threads);
            changed = decay.scan_integrated(&mut map, threads).unwrap();
        }
        assert!(changed > 0, "the latest scans still fade");
        for _ in 0..200 {
            decay.scan_integrated(&mut map, threads).unwrap();
        }
        map
    };
    let map = run(1);
    assert!(map == run(3));
    // Evidence relaxes to the loaded map and stops there: every cell of it is as it was.
    let near = |map: &OccupancyMap| map.cropped([-3.0; 3], [3.0; 3]).unwrap();
    assert!(near(&map) == near(&loaded));
    // And what no loaded map holds is forgotten.
    let mut decay = Decay::new(settings, None).unwrap();
    let mut map = map;
    for _ in 0..400 {
        decay.scan_integrated(&mut map, 2).unwrap();
    }
    assert!(map.is_empty());
    assert!(!loaded.is_empty());
}

#[test]
fn one_half_life_halves_what_is_known() {
    let mut map = OccupancyMap::new(MapConfig::default()).unwrap();
    let (wall, air) = (VoxelKey::new(3, 4, 5), VoxelKey::new(-9, 0, 2));
    map.add_log_odds(wall, 2.0).unwrap();
    map.add_log_odds(air, -0.3).unwrap();
    let settings = DecayConfig {
        half_life_scans: 4.0,
        period_scans: 2,
        forget_log_odds: 0.2,
    };
    let mut decay = Decay::new(settings, None).unwrap();
    let before = map.revision();
    assert_eq!(decay.scan_integrated(&mut map, 1).unwrap(), 0);
    assert_eq!(map.revision(), before);
    assert_eq!(decay.scan_integrated(&mut map, 1).unwrap(), 2);
    assert_eq!(map.bricks_changed_since(before).len(), 2);
    for _ in 0..2 {
        decay.scan_integrated(&mut map, 1).unwrap();
    }
    assert!((map.log_odds_of(wall).unwrap() - 1.0).abs() < 1e-3);
    assert_eq!(map.log_odds_of(air), None);
    for bad in [
        DecayConfig {
            half_life_scans: f64::NAN,
            ..DecayConfig::default()
        },
        DecayConfig {
            period_scans: 0,
            ..DecayConfig::default()
        },
        DecayConfig {
            forget_log_odds: -1.0,
            ..DecayConfig::default()
        },
    ] {
        assert!(Decay::new(bad, None).is_err());
    }
}
