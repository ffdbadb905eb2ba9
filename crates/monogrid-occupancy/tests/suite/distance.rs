//! Distances against a search over all obstacles.
#![allow(clippy::unwrap_used, reason = "a test fails where it unwraps")]

use crate::common::Random;
use monogrid_occupancy::*;

const RESOLUTION: f64 = 0.5;
const HALF: i32 = 14;

fn random_key(random: &mut Random) -> VoxelKey {
    let half = f64::from(HALF);
    VoxelKey::from_array([0; 3].map(|_| random.between(-half, half).floor() as i32))
}

/// Free space with holes and some obstacles, denser on one side.
fn map(random: &mut Random, obstacles: usize) -> OccupancyMap {
    let mut map = OccupancyMap::new(MapConfig::with_resolution(RESOLUTION)).unwrap();
    for z in -HALF..HALF {
        for y in -HALF..HALF {
            for x in -HALF..HALF {
                if (x * 7 + y * 3 + z).rem_euclid(61) != 0 {
                    map.set_log_odds(VoxelKey::new(x, y, z), Some(-1.0))
                        .unwrap();
                }
            }
        }
    }
    for _ in 0..obstacles {
        map.set_log_odds(random_key(random), Some(1.0)).unwrap();
    }
    map
}

/// Distance of every cell around the map by a search over all obstacles, and how many there are.
fn assert_distances(map: &OccupancyMap, field: &DistanceField, config: DistanceConfig) {
    let margin = (config.max_distance / RESOLUTION) as i32 + 3;
    let edge = HALF + margin;
    let cells = |edge: i32| {
        map.states_in_key_box(
            VoxelKey::new(-edge, -edge, -edge),
            VoxelKey::new(edge - 1, edge - 1, edge - 1),
        )
    };
    let is_obstacle = |state| match state {
        Occupancy::Occupied => true,
        Occupancy::Unknown => config.unknown == UnknownCells::Stop,
        Occupancy::Free => false,
    };
    let obstacles: Vec<[i32; 3]> = cells(edge)
        .filter(|(_, state)| is_obstacle(*state))
        .map(|(key, _)| key.to_array())
        .collect();
    for (key, state) in cells(edge).step_by(5) {
        let [x, y, z] = key.to_array();
        let nearest = if is_obstacle(state) {
            Some(0)
        } else {
            obstacles
                .iter()
                .map(|[a, b, c]| (a - x).pow(2) + (b - y).pow(2) + (c - z).pow(2))
                .min()
        };
        let reach = (config.max_distance / RESOLUTION) as i32;
        let expected = nearest
            .filter(|square| *square <= reach * reach)
            .map(|square| f64::from(square).sqrt() * RESOLUTION);
        assert_eq!(field.distance_of(key), expected, "{key:?}");
    }
}

fn same_everywhere(a: &DistanceField, b: &DistanceField) -> bool {
    let edge = HALF + 24;
    let range = || -edge..edge;
    range().all(|z| {
        range().all(|y| {
            range().all(|x| {
                let key = VoxelKey::new(x, y, z);
                a.distance_of(key) == b.distance_of(key)
            })
        })
    })
}

#[test]
fn distances_are_those_of_a_search_over_all_obstacles() {
    for (seed, max_distance, unknown, obstacles) in [
        (1, 3.0, UnknownCells::PassThrough, 12),
        (2, 9.3, UnknownCells::PassThrough, 3),
        (3, 0.5, UnknownCells::PassThrough, 60),
        (4, 3.0, UnknownCells::Stop, 12),
    ] {
        let config = DistanceConfig {
            max_distance,
            unknown,
        };
        let map = map(&mut Random(seed), obstacles);
        let field = DistanceField::new(&map, config, 2).unwrap();
        assert_distances(&map, &field, config);
    }
}

#[test]
fn a_field_that_follows_its_map_equals_one_made_anew() {
    for unknown in [UnknownCells::PassThrough, UnknownCells::Stop] {
        let config = DistanceConfig {
            max_distance: 4.1,
            unknown,
        };
        let mut random = Random(5);
        let mut map = map(&mut random, 10);
        let mut field = DistanceField::new(&map, config, 1).unwrap();
        for round in 0..8 {
            for _ in 0..6 {
                let value = [None, Some(-1.0), Some(1.0)][(random.unit() * 3.0) as usize];
                map.set_log_odds(random_key(&mut random), value).unwrap();
            }
            // Cells far outside, and a brick that becomes wholly unknown again.
            let outside = VoxelKey::new(HALF + 6, round, 0);
            map.set_log_odds(outside, Some(if round % 2 == 0 { 1.0 } else { -1.0 }))
                .unwrap();
            if round == 5 {
                for (index, _) in (0..512).enumerate() {
                    map.set_log_odds(BrickKey::new(0, 0, 0).cell(index), None)
                        .unwrap();
                }
            }
            field.update(&map, 2);
            let anew = DistanceField::new(&map, config, 3).unwrap();
            assert!(same_everywhere(&field, &anew), "round {round}, {unknown:?}");
            assert_eq!(
                field.bytes_in_memory(),
                anew.bytes_in_memory(),
                "nothing is left over"
            );
        }
        assert_eq!(field.update(&map, 1), 0);
    }
}

#[test]
fn evidence_that_changes_no_state_changes_no_brick_of_the_field() {
    let mut map = map(&mut Random(6), 10);
    let mut field = DistanceField::new(&map, DistanceConfig::default(), 1).unwrap();
    let free = VoxelKey::new(1, 0, 0);
    map.add_log_odds(free, -0.25).unwrap();
    assert_eq!(map.bricks_changed_since(field.revision()), [free.brick()]);
    assert_eq!(field.update(&map, 1), 0);
    map.set_log_odds(free, Some(2.0)).unwrap();
    assert!(
        (1..=8).contains(&field.update(&map, 1)),
        "two cells reach no farther"
    );
    assert_eq!(field.distance_of(free), Some(0.0));
}

#[test]
fn the_gradient_points_away_from_a_wall() {
    let mut map = OccupancyMap::new(MapConfig::with_resolution(0.1)).unwrap();
    for y in -12..12 {
        for z in -12..12 {
            map.set_log_odds(VoxelKey::new(0, y, z), Some(1.0)).unwrap();
        }
    }
    let field = DistanceField::new(&map, DistanceConfig::default(), 1).unwrap();
    let gradient = field.gradient([0.55, 0.0, 0.0]).unwrap();
    assert!(
        (gradient[0] - 1.0).abs() < 1e-9 && gradient[1].abs() < 1e-9,
        "{gradient:?}"
    );
    assert!(field.gradient([-0.45, 0.0, 0.0]).unwrap()[0] < -0.9);
    assert_eq!(field.distance([0.55, 0.0, 0.0]), Some(0.5));
    assert_eq!(field.distance([1.5, 0.0, 0.0]), None);
    assert_eq!(field.gradient([1.05, 0.0, 0.0]), None);
    assert_eq!(field.distance([f64::NAN; 3]), None);
}

#[test]
fn a_reach_that_cannot_be_stored_is_refused() {
    let map = OccupancyMap::new(MapConfig::with_resolution(0.01)).unwrap();
    for max_distance in [0.0, 0.005, 1.9, f64::NAN, f64::INFINITY, -1.0] {
        let config = DistanceConfig {
            max_distance,
            ..DistanceConfig::default()
        };
        assert!(
            DistanceField::new(&map, config, 1).is_err(),
            "{max_distance}"
        );
    }
}

#[test]
fn a_field_far_larger_than_its_map_is_refused() {
    let config = MapConfig {
        memory_budget_bytes: 4 << 20,
        ..MapConfig::default()
    };
    let mut map = OccupancyMap::new(config).unwrap();
    // 27 bricks, each of which is felt in some thousand others
    for cell in 0..27 {
        let [x, y, z] = [cell % 3, cell / 3 % 3, cell / 9].map(|n| n * 400);
        map.set_log_odds(VoxelKey::new(x, y, z), Some(1.0)).unwrap();
    }
    let config = |cells: f64| DistanceConfig {
        max_distance: cells * map.resolution(),
        ..DistanceConfig::default()
    };
    assert!(DistanceField::new(&map, config(8.0), 2).is_ok());
    let error = DistanceField::new(&map, config(60.0), 2).unwrap_err();
    assert!(matches!(error, MapError::MemoryBudget { .. }), "{error}");
}
