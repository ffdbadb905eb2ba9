//! Crop, merge, transform and difference against the same done cell by cell.
#![allow(clippy::unwrap_used, reason = "a test fails where it unwraps")]

use crate::common::Random;
use monogrid_occupancy::*;

fn map(seed: u64, resolution: f64) -> OccupancyMap {
    let mut random = Random(seed);
    let mut map = OccupancyMap::new(MapConfig::with_resolution(resolution)).unwrap();
    for index in 0..4 * 512 {
        let brick = BrickKey::new(index / 512 - 2, 0, 0);
        let key = brick.cell((index % 512) as usize);
        map.set_log_odds(key, Some(-1.5)).unwrap();
    }
    for _ in 0..600 {
        let key = VoxelKey::from_array([0; 3].map(|_| random.between(-20.0, 20.0) as i32));
        let value = (random.unit() < 0.8).then(|| random.between(-2.0, 3.5) as f32);
        map.set_log_odds(key, value).unwrap();
    }
    map
}

fn empty_like(map: &OccupancyMap) -> OccupancyMap {
    OccupancyMap::new(map.config().clone()).unwrap()
}

#[test]
fn cropped_cells_are_those_of_the_box_and_of_the_ball() {
    let map = map(1, 0.1);
    let (low, high) = ([-0.93, -1.2, -0.4], [1.1, 0.4, 0.95]);
    let mut expected = empty_like(&map);
    for cell in map.cells_in_box(low, high) {
        expected
            .set_log_odds(cell.key, Some(cell.log_odds))
            .unwrap();
    }
    assert!(expected.cells().count() > 300);
    assert!(map.cropped(low, high).unwrap() == expected);

    let (center, radius) = ([0.2, 0.3, 0.1], 0.9);
    let mut expected = empty_like(&map);
    for cell in map.cells() {
        let c = cell.key.center(0.1);
        let distance = (0..3)
            .map(|a| (c[a] - center[a]).powi(2))
            .sum::<f64>()
            .sqrt();
        if distance <= radius {
            expected
                .set_log_odds(cell.key, Some(cell.log_odds))
                .unwrap();
        }
    }
    assert!(expected.cells().count() > 300);
    assert!(map.within(center, radius).unwrap() == expected);
    assert!(map.cropped([5.0; 3], [6.0; 3]).unwrap().is_empty());
}

#[test]
fn merging_adds_every_cell_as_one_update() {
    let (a, b) = (map(2, 0.1), map(3, 0.1));
    let mut expected = a.clone();
    for cell in b.cells() {
        expected.add_log_odds(cell.key, cell.log_odds).unwrap();
    }
    let mut merged = a.clone();
    let before = merged.revision();
    merged.merge(&b).unwrap();
    assert!(merged == expected);
    assert_eq!(merged.bricks_changed_since(before), b.bricks());
    assert!(matches!(
        merged.merge(&map(3, 0.2)),
        Err(MapError::ResolutionMismatch { .. })
    ));
}

#[test]
fn a_merge_that_could_exceed_the_budget_changes_nothing() {
    let small = MapConfig {
        memory_budget_bytes: 60_000,
        ..MapConfig::with_resolution(0.1)
    };
    let mut a = OccupancyMap::new(small).unwrap();
    a.set_log_odds(VoxelKey::new(0, 0, 0), Some(1.0)).unwrap();
    let before = a.clone();
    assert!(matches!(
        a.merge(&map(4, 0.1)),
        Err(MapError::MemoryBudget { .. })
    ));
    assert!(a == before && a.revision() == before.revision());
}

#[test]
fn a_transformed_map_has_at_every_cell_what_was_there() {
    let source = map(5, 0.1);
    let mut random = Random(6);
    for scale in [1.0, 0.37, 2.2] {
        let target_from_source = Similarity {
            scale,
            ..random.pose(3.0)
        };
        let resolution = 0.1 * scale * 0.9;
        let target = source.transformed(&target_from_source, resolution).unwrap();
        let back = target_from_source.inverse();
        let in_source = |key: VoxelKey| source.log_odds(back.transform(key.center(resolution)));
        for cell in target.cells() {
            assert_eq!(in_source(cell.key), Some(cell.log_odds));
        }
        // Every source cell is found in the target where its centre went.
        let (mut found, mut cells) = (0, 0);
        for cell in source.cells() {
            let key = target
                .key(target_from_source.transform(cell.key.center(0.1)))
                .unwrap();
            assert_eq!(target.log_odds_of(key), in_source(key));
            found += usize::from(target.log_odds_of(key).is_some());
            cells += 1;
        }
        assert!(found * 10 > cells * 9, "{found} of {cells}");
    }
    let moved = Similarity {
        translation: [0.8, -1.6, 2.4],
        ..Similarity::IDENTITY
    };
    let there = source.transformed(&moved, 0.1).unwrap();
    let back = there.transformed(&moved.inverse(), 0.1).unwrap();
    assert!(back == source, "whole cells there and back");
    let collapsed = Similarity {
        scale: 0.0,
        ..Similarity::IDENTITY
    };
    assert!(source.transformed(&collapsed, 0.1).is_err());
    assert!(source.transformed(&moved, 0.0).is_err());
}

#[test]
fn a_transform_that_makes_billions_of_cells_is_refused_before_they_are_made() {
    let source = map(5, 0.1);
    let begin = std::time::Instant::now();
    for (scale, resolution) in [(20.0, 0.001), (1e3, 0.001), (1e5, 0.05)] {
        let grown = Similarity {
            scale,
            ..Similarity::IDENTITY
        };
        let refused = source.transformed(&grown, resolution);
        assert!(
            matches!(refused, Err(MapError::MemoryBudget { .. })),
            "{scale}"
        );
        let cells = source.cells().count();
        let as_large = source.transformed(&grown, 0.1 * scale).unwrap();
        assert_eq!(as_large.cells().count(), cells);
    }
    assert!(begin.elapsed().as_secs() < 20);
}

#[test]
fn differences_are_counted_as_cell_by_cell() {
    let (a, b) = (map(7, 0.1), map(8, 0.1));
    let mut expected = MapDifference::default();
    let (mut sum, mut both) = (0.0, 0);
    let corner = 24;
    let all = a.states_in_key_box(
        VoxelKey::new(-corner, -corner, -corner),
        VoxelKey::new(corner, corner, corner),
    );
    for (key, before) in all {
        use Occupancy::{Free, Occupied, Unknown};
        match (before, b.state_of(key)) {
            (Unknown, Unknown) => {}
            (Unknown, _) => expected.only_after += 1,
            (_, Unknown) => expected.only_before += 1,
            (Free, Occupied) => expected.free_to_occupied += 1,
            (Occupied, Free) => expected.occupied_to_free += 1,
            _ => expected.same += 1,
        }
        if let (Some(x), Some(y)) = (a.log_odds_of(key), b.log_odds_of(key)) {
            sum += f64::from((x - y).abs());
            both += 1;
        }
    }
    let difference = a.difference(&b).unwrap();
    assert!((difference.mean_log_odds_difference - sum / f64::from(both)).abs() < 1e-9);
    expected.mean_log_odds_difference = difference.mean_log_odds_difference;
    assert_eq!(difference, expected);
    assert_eq!(a.difference(&a).unwrap().same, a.cells().count() as u64);
    let counts = a.cell_counts();
    let occupied = a.cells().filter(|c| c.state == Occupancy::Occupied).count();
    assert_eq!(counts.occupied, occupied as u64);
    assert_eq!(counts.free + counts.occupied, a.cells().count() as u64);
}

#[test]
fn a_map_in_another_unit_has_the_same_cells() {
    let map = map(5, 0.1);
    let rescaled = map.rescaled(2.5).unwrap();
    assert_eq!(rescaled.resolution(), 0.25);
    let cells = |map: &OccupancyMap| map.cells().map(|c| (c.key, c.log_odds)).collect::<Vec<_>>();
    assert_eq!(cells(&rescaled), cells(&map));
    for state in [Occupancy::Free, Occupancy::Occupied] {
        let cell = map.cells().find(|cell| cell.state == state).unwrap();
        let moved = cell.key.center(0.1).map(|c| 2.5 * c);
        assert_eq!(rescaled.state(moved), state);
    }
    assert!(map.rescaled(0.0).is_err() && map.rescaled(f64::NAN).is_err());
}
