//! Paths through maps whose faults are known.

use monogrid_evaluation::{PathConfig, PathError, TruthGrid, evaluate_paths};
use monogrid_occupancy::{Occupancy, OccupancyMap, VoxelKey};

/// Two rooms of 2.5 m with a door 0.9 m wide between them; cells of 5 cm.
fn rooms() -> TruthGrid {
    let mut grid = TruthGrid::new(0.05, [-1, -1, -1], [104, 52, 42], 1 << 24).expect("small");
    for (x, y, z) in
        (0..42).flat_map(|z| (0..52).flat_map(move |y| (0..104).map(move |x| (x, y, z))))
    {
        let is_shell = x == 0 || y == 0 || z == 0 || x == 103 || y == 51 || z == 41;
        let is_divider = x == 52 && !(17..35).contains(&y);
        let state = if is_shell || is_divider {
            Occupancy::Occupied
        } else {
            Occupancy::Free
        };
        grid.set([x, y, z], state);
    }
    grid
}

fn config() -> PathConfig {
    PathConfig {
        pairs: 60,
        planning_cell: 0.05,
        ..PathConfig::default()
    }
}

fn set(map: &mut OccupancyMap, cells: impl Iterator<Item = [i32; 3]>, log_odds: Option<f32>) {
    for key in cells {
        map.set_log_odds(VoxelKey::from_array(key), log_odds)
            .expect("fits");
    }
}

/// A wall of one cell at x = 52, all of it or the part where the door is.
fn wall(is_door_only: bool) -> impl Iterator<Item = [i32; 3]> {
    (1..41).flat_map(move |z| {
        (1..51)
            .filter(move |y| !is_door_only || (17..35).contains(y))
            .map(move |y| [52, y, z])
    })
}

#[test]
fn in_the_true_map_every_path_is_found_and_safe() {
    let truth = rooms();
    let map = truth.to_map().expect("fits");
    let report = evaluate_paths(&map, &truth, &config()).expect("a report");
    for stats in [
        report.unknown_blocked.all,
        report.unknown_blocked.observed,
        report.unknown_blocked.path_observed,
        report.unknown_free.all,
    ] {
        assert_eq!(stats.pairs, 60);
        assert_eq!(stats.planned, 60);
        assert_eq!(
            (
                stats.false_positive,
                stats.false_negative,
                stats.unreachable
            ),
            (0.0, 0.0, 0.0)
        );
        assert_eq!(stats.length_ratio, Some(1.0));
        assert!(stats.clearance_min.expect("paths") >= 0.15);
    }
    assert_eq!(
        report,
        evaluate_paths(&map, &truth, &config()).expect("the same report")
    );
}

#[test]
fn a_closed_door_blocks_the_pairs_on_both_sides_of_it() {
    let truth = rooms();
    let mut map = truth.to_map().expect("fits");
    set(&mut map, wall(true), Some(2.0));
    let stats = evaluate_paths(&map, &truth, &config())
        .expect("a report")
        .unknown_free
        .all;
    // About half of the pairs lie in different rooms.
    assert!((0.35..0.65).contains(&stats.unreachable), "{stats:?}");
    assert_eq!(stats.false_positive, stats.unreachable);
    assert_eq!(stats.false_negative, 0.0);
}

#[test]
fn a_missing_wall_lets_paths_collide() {
    let truth = rooms();
    let mut map = truth.to_map().expect("fits");
    set(&mut map, wall(false), Some(-2.0));
    let stats = evaluate_paths(&map, &truth, &config())
        .expect("a report")
        .unknown_blocked
        .all;
    assert!(stats.false_negative > 0.1, "{stats:?}");
    assert!(stats.clearance_min.expect("paths") < 0.0);
    assert!(stats.length_ratio.expect("paths") <= 1.0);
    assert_eq!(stats.unreachable, 0.0);
}

#[test]
fn what_was_not_observed_is_a_matter_of_the_rule() {
    let truth = rooms();
    let mut map = truth.to_map().expect("fits");
    let right = (0..42).flat_map(|z| (0..52).flat_map(move |y| (60..104).map(move |x| [x, y, z])));
    set(&mut map, right, None);
    let report = evaluate_paths(&map, &truth, &config()).expect("a report");
    let (blocked, free) = (report.unknown_blocked, report.unknown_free);
    assert!(blocked.all.unreachable > 0.6, "{blocked:?}");
    assert_eq!(blocked.observed.unreachable, 0.0);
    assert!((4..30).contains(&blocked.observed.pairs));
    assert_eq!(blocked.path_observed.pairs, blocked.observed.pairs);
    assert_eq!(free.all.unreachable, 0.0);
}

#[test]
fn a_path_through_the_unknown_is_not_one_through_the_observed_space() {
    let truth = rooms();
    let mut map = truth.to_map().expect("fits");
    // the wall with its door is not observed: both rooms are
    let between = (0..42).flat_map(|z| (0..52).flat_map(move |y| (48..58).map(move |x| [x, y, z])));
    set(&mut map, between, None);
    let blocked = evaluate_paths(&map, &truth, &config())
        .expect("a report")
        .unknown_blocked;
    let (ends, paths) = (blocked.observed, blocked.path_observed);
    assert!(ends.false_positive > 0.3, "{blocked:?}");
    assert!(paths.pairs > 10 && paths.pairs < ends.pairs, "{blocked:?}");
    assert_eq!(paths.false_positive, 0.0, "nothing observed is in the way");
    // a false obstacle in the observed space is
    set(
        &mut map,
        wall(false).map(|[x, y, z]| [x - 25, y, z]),
        Some(2.0),
    );
    let blocked = evaluate_paths(&map, &truth, &config())
        .expect("a report")
        .unknown_blocked;
    assert_eq!(blocked.path_observed.pairs, paths.pairs);
    assert!(blocked.path_observed.false_positive > 0.1, "{blocked:?}");
}

#[test]
fn planning_on_larger_cells_agrees_on_an_easy_map() {
    let truth = rooms();
    let map = truth.to_map().expect("fits");
    let coarse = PathConfig {
        planning_cell: 0.1,
        ..config()
    };
    let report = evaluate_paths(&map, &truth, &coarse).expect("a report");
    assert!((report.planning_cell - 0.1).abs() < 1e-12);
    assert_eq!(report.unknown_blocked.all.unreachable, 0.0);
    assert_eq!(report.unknown_blocked.all.false_negative, 0.0);
}

#[test]
fn bad_input_is_named() {
    let truth = rooms();
    let map = truth.to_map().expect("fits");
    let nobody = PathConfig {
        robot_radius: 5.0,
        ..config()
    };
    let error = evaluate_paths(&map, &truth, &nobody).expect_err("no room");
    assert!(
        matches!(error, PathError::NoPairs { free: 0, .. }),
        "{error}"
    );
    let few_cells = PathConfig {
        max_cells: 1000,
        ..config()
    };
    let error = evaluate_paths(&map, &truth, &few_cells).expect_err("too large");
    assert!(
        matches!(error, PathError::TooManyCells { max: 1000, .. }),
        "{error}"
    );
    // in the truth, and in the map
    for max_visits in [100, 20_000] {
        let few_visits = PathConfig {
            max_visits,
            ..config()
        };
        let error = evaluate_paths(&map, &truth, &few_visits).expect_err("too long");
        assert_eq!(error, PathError::TooManyVisits { max: max_visits });
    }
    let nan = PathConfig {
        robot_radius: f64::NAN,
        ..config()
    };
    assert!(matches!(
        evaluate_paths(&map, &truth, &nan),
        Err(PathError::Config {
            field: "robot_radius",
            ..
        })
    ));
}
