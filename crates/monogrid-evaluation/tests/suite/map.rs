//! The map evaluation on maps whose score is known, and against scikit-learn.

use monogrid_evaluation::{
    MapEvaluationConfig, MapEvaluationError, MapReport, TruthGrid, evaluate_map,
};
use monogrid_occupancy::{MapConfig, Occupancy, OccupancyMap, VoxelKey};

/// `tests/sklearn/regenerate.py` makes it.
const SKLEARN: &str = include_str!("../sklearn/sklearn.json");

fn empty_map(resolution: f64) -> OccupancyMap {
    OccupancyMap::new(MapConfig::with_resolution(resolution)).expect("good settings")
}

/// A room of 20 x 16 x 12 cells with a pillar, its inside free, around it unknown.
fn room() -> TruthGrid {
    let mut grid = TruthGrid::new(0.05, [-3, -2, -1], [20, 17, 12], 1 << 20).expect("small");
    for (x, y, z) in
        (0..12).flat_map(|z| (0..16).flat_map(move |y| (0..20).map(move |x| (x, y, z))))
    {
        let is_wall = x == 0 || y == 0 || z == 0 || x == 19 || y == 15 || z == 11;
        let is_pillar = (8..11).contains(&x) && (6..9).contains(&y);
        let is_core = x == 9 && y == 7;
        let state = match (is_wall || is_pillar, is_core && !is_wall) {
            (_, true) => Occupancy::Unknown,
            (true, false) => Occupancy::Occupied,
            (false, false) => Occupancy::Free,
        };
        grid.set([x, y, z], state);
    }
    grid
}

/// The truth as an estimate, every cell moved along x and its log-odds multiplied.
fn moved(truth: &TruthGrid, cells: i32, sign: f32) -> OccupancyMap {
    let mut map = empty_map(truth.resolution());
    for (state, log_odds) in [(Occupancy::Free, -2.0), (Occupancy::Occupied, 3.5)] {
        for [x, y, z] in truth.keys_in(state) {
            map.set_log_odds(VoxelKey::new(x + cells, y, z), Some(sign * log_odds))
                .expect("fits");
        }
    }
    map
}

fn evaluate(estimate: &OccupancyMap, truth: &TruthGrid) -> MapReport {
    evaluate_map(estimate, truth, &MapEvaluationConfig::default()).expect("comparable")
}

#[test]
fn truth_against_truth_is_perfect() {
    let truth = room();
    let report = evaluate(&moved(&truth, 0, 1.0), &truth);
    for policy in [
        &report.policies.observed,
        &report.policies.known,
        &report.policies.safety,
    ] {
        assert_eq!((policy.auc, policy.auc_26, policy.mcc), (1.0, 1.0, 1.0));
        assert_eq!(
            (policy.precision, policy.recall, policy.f1),
            (1.0, 1.0, 1.0)
        );
    }
    assert_eq!(report.policies.everything.auc, 1.0);
    assert_eq!((report.coverage_free, report.coverage_occupied), (1.0, 1.0));
    assert_eq!(
        (report.surface.accuracy_m, report.surface.completeness),
        (Some(0.0), 1.0)
    );
    assert_eq!(report.surface.occupied_ratio, Some(1.0));
    assert!(report.calibration.brier.expect("cells") < 0.02);
}

#[test]
fn the_inverted_truth_scores_zero() {
    let truth = room();
    let report = evaluate(&moved(&truth, 0, -1.0), &truth);
    for policy in [
        &report.policies.observed,
        &report.policies.known,
        &report.policies.safety,
    ] {
        assert_eq!((policy.auc, policy.auc_26, policy.mcc), (0.0, 0.0, -1.0));
    }
}

#[test]
fn a_map_that_knows_nothing_scores_a_half() {
    let truth = room();
    let report = evaluate(&empty_map(0.05), &truth);
    for policy in [
        &report.policies.observed,
        &report.policies.known,
        &report.policies.everything,
        &report.policies.safety,
    ] {
        assert_eq!((policy.auc, policy.auc_26, policy.mcc), (0.5, 0.5, 0.0));
    }
    assert_eq!(report.coverage_free, 0.0);
    assert_eq!(
        (report.surface.accuracy_m, report.surface.completeness),
        (None, 0.0)
    );
    // Every known cell differs by a half.
    let known = (report.truth.free + report.truth.occupied) as f64;
    assert_eq!(report.ssd_per_slice.iter().sum::<f64>(), 0.25 * known);
}

#[test]
fn a_shift_by_one_cell_lies_strictly_between() {
    let truth = room();
    let report = evaluate(&moved(&truth, 1, 1.0), &truth);
    for policy in [
        &report.policies.observed,
        &report.policies.known,
        &report.policies.everything,
        &report.policies.safety,
    ] {
        assert!(policy.auc > 0.5 && policy.auc < 1.0, "{policy:?}");
        assert!(policy.mcc > 0.0 && policy.mcc < 1.0, "{policy:?}");
    }
    let accuracy = report.surface.accuracy_m.expect("surfaces");
    assert!(accuracy > 0.0 && accuracy < 0.05, "{accuracy}");
    assert_eq!(
        report.surface.completeness, 1.0,
        "one cell is within the tolerance"
    );
}

#[test]
fn surfaces_outside_the_box_count_as_inaccurate() {
    let truth = room();
    let mut map = moved(&truth, 0, 1.0);
    map.set_log_odds(VoxelKey::new(119, 5, 5), Some(3.5))
        .expect("fits");
    let report = evaluate(&map, &truth);
    assert_eq!(report.observed_outside, 1);
    let occupied = report.truth.occupied as f64;
    assert_eq!(report.predicted_beyond, 1);
    assert!(report.mcc_with_beyond < 1.0 && report.mcc_with_beyond > 0.99);
    let expected = 100.0 * 0.05 / (occupied + 1.0);
    assert!((report.surface.accuracy_m.expect("surfaces") - expected).abs() < 1e-9);
    assert_eq!(report.policies.observed.auc, 1.0);
}

#[test]
fn what_is_close_to_a_surface_or_free_is_no_false_wall_outside_the_room() {
    let truth = room();
    // walls three cells thicker than they are: the third is 15 cm behind
    for (cells, expected) in [(1, 0), (2, 0), (3, 1)] {
        let mut map = moved(&truth, 0, 1.0);
        map.set_log_odds(VoxelKey::new(19 + cells, 5, 5), Some(3.5))
            .expect("fits");
        // beyond the box, but free
        map.set_log_odds(VoxelKey::new(119, 5, 5), Some(-2.0))
            .expect("fits");
        assert_eq!(evaluate(&map, &truth).predicted_beyond, expected, "{cells}");
    }
    // a false wall within the room is counted by the policies
    let mut map = moved(&truth, 0, 1.0);
    map.set_log_odds(VoxelKey::new(4, 4, 5), Some(3.5))
        .expect("fits");
    let report = evaluate(&map, &truth);
    assert_eq!(report.predicted_beyond, 0);
    assert!((report.mcc_with_beyond - report.policies.observed.mcc).abs() < 1e-12);
}

/// The room of [`room`] as an estimate whose wall at x = 0 takes all cells of `wall` on that axis.
fn with_wall(truth: &TruthGrid, wall: std::ops::RangeInclusive<i32>) -> OccupancyMap {
    let mut map = moved(truth, 0, 1.0);
    for (y, z) in (1..15).flat_map(|y| (1..11).map(move |z| (y, z))) {
        for x in -8..=8 {
            let log_odds = if wall.contains(&x) { 3.5 } else { -2.0 };
            map.set_log_odds(VoxelKey::new(x, y, z), Some(log_odds))
                .expect("fits");
        }
    }
    map
}

#[test]
fn walls_are_as_thick_as_the_cells_in_a_row_across_them() {
    let mut truth = room();
    // only the wall at x = 0
    let others: Vec<[i32; 3]> = truth.keys_in(Occupancy::Occupied).collect();
    for key in others {
        let is_wall = key[0] == 0 && (1..15).contains(&key[1]) && (1..11).contains(&key[2]);
        if !is_wall {
            truth.set(key, Occupancy::Unknown);
        }
    }
    let thickness = |map: &OccupancyMap| evaluate(map, &truth).thickness;
    // as it is, thicker on either side, beside its place, and too far from it
    for (wall, expected) in [
        (0..=0, Some(1.0)),
        (0..=2, Some(3.0)),
        (-3..=1, Some(5.0)),
        (2..=3, Some(2.0)),
        (-2..=-1, Some(2.0)),
        (3..=5, None),
    ] {
        let found = thickness(&with_wall(&truth, wall.clone()));
        assert_eq!(found.thickness_cells, expected, "{wall:?}");
        let truth = expected.map(|_| 1.0);
        assert_eq!(found.true_thickness_cells, truth, "{wall:?}");
    }
}

#[test]
fn the_view_limits_what_is_asked_for() {
    let truth = room();
    let mut half = empty_map(0.05);
    let mut view = TruthGrid::new(0.05, truth.first_key(), [20, 17, 12], 1 << 20).expect("small");
    for (state, log_odds) in [(Occupancy::Free, -2.0), (Occupancy::Occupied, 3.5)] {
        for key in truth.keys_in(state).filter(|k| k[0] < 10) {
            view.set(key, state);
            if key[0] < 9 {
                half.set_log_odds(VoxelKey::from_array(key), Some(log_odds))
                    .expect("fits");
            }
        }
    }
    let config = MapEvaluationConfig {
        in_view: Some(&view),
        ..MapEvaluationConfig::default()
    };
    let report = evaluate_map(&half, &truth, &config).expect("comparable");
    let (free, in_view) = (
        report.coverage_free,
        report.coverage_free_in_view.expect("a view"),
    );
    assert!(
        free < 0.5 && in_view > 0.85 && in_view < 1.0,
        "{free} {in_view}"
    );
    assert_eq!(report.surface.completeness, 1.0);
    // every cell that was observed is right: what is missed is the column in view that was not
    let known = report.known_in_view.as_ref().expect("a view");
    let in_column = |state| view.keys_in(state).filter(|k| k[0] == 9).count() as u64;
    let (missed, unobserved) = (in_column(Occupancy::Occupied), in_column(Occupancy::Free));
    assert!(missed > 0 && unobserved > 0);
    assert_eq!((known.counts.fp, known.counts.fn_), (0, missed));
    let counted = known.counts.tp + known.counts.tn + missed;
    assert_eq!(counted, view.counts().free + view.counts().occupied);
    assert!(known.recall > report.policies.known.recall && known.auc > 0.9);
    let blind = evaluate(&half, &truth);
    assert_eq!(blind.known_in_view, None);

    // A view of larger cells covers the same and a rim.
    let coarse = view.coarsened(2).expect("a factor");
    let config = MapEvaluationConfig {
        in_view: Some(&coarse),
        ..MapEvaluationConfig::default()
    };
    let report = evaluate_map(&half, &truth, &config).expect("comparable");
    assert!((report.coverage_free_in_view.expect("a view") - in_view).abs() < 1e-9);
    let odd = TruthGrid::new(0.12, [0; 3], [5; 3], 1000).expect("small");
    let config = MapEvaluationConfig {
        in_view: Some(&odd),
        ..config
    };
    assert!(matches!(
        evaluate_map(&half, &truth, &config),
        Err(MapEvaluationError::View { .. })
    ));
}

#[test]
fn maps_that_cannot_be_compared_are_refused() {
    let truth = room();
    let config = MapEvaluationConfig::default();
    assert!(matches!(
        evaluate_map(&empty_map(0.1), &truth, &config),
        Err(MapEvaluationError::Resolution { .. })
    ));
    let nothing = TruthGrid::new(0.05, [0; 3], [5; 3], 1000).expect("small");
    assert_eq!(
        evaluate_map(&empty_map(0.05), &nothing, &config),
        Err(MapEvaluationError::OneClass {
            free: 0,
            occupied: 0
        })
    );
}

#[test]
fn agrees_with_scikit_learn() {
    let json: serde_json::Value = serde_json::from_str(SKLEARN).expect("valid JSON");
    for (name, example) in json["examples"].as_object().expect("examples") {
        let size: Vec<i32> = serde_json::from_value(example["size"].clone()).expect("a size");
        let mut truth = TruthGrid::new(
            0.1,
            [-4, -5, -6],
            [size[0] - 5, size[1] - 6, size[2] - 7],
            10_000,
        )
        .expect("small");
        let mut map = empty_map(0.1);
        let letters = example["truth"].as_str().expect("letters");
        let evidence = example["evidence"].as_array().expect("numbers");
        for (i, (letter, steps)) in letters.chars().zip(evidence).enumerate() {
            let i = i as i32;
            let key = [
                i % size[0] - 4,
                i / size[0] % size[1] - 5,
                i / size[0] / size[1] - 6,
            ];
            let state = match letter {
                'o' => Occupancy::Occupied,
                'f' => Occupancy::Free,
                _ => Occupancy::Unknown,
            };
            truth.set(key, state);
            let log_odds = steps.as_f64().map(|s| (s / 4096.0) as f32);
            map.set_log_odds(VoxelKey::from_array(key), log_odds)
                .expect("fits");
        }
        let report = serde_json::to_value(evaluate(&map, &truth)).expect("serialisable");
        let mut compared = 0;
        let mut compare = |ours: &serde_json::Value, theirs: &serde_json::Value, what: &str| {
            let (ours, theirs) = (ours.as_f64(), theirs.as_f64());
            let gap = ours.zip(theirs).map_or(f64::NAN, |(a, b)| (a - b).abs());
            assert!(
                gap < 1e-9,
                "{name} {what}: {ours:?}, scikit-learn says {theirs:?}"
            );
            compared += 1;
        };
        for (policy, numbers) in example["policies"].as_object().expect("policies") {
            for (key, theirs) in numbers.as_object().expect("numbers") {
                let ours = &report["policies"][policy][key];
                compare(ours, theirs, &format!("{policy} {key}"));
            }
        }
        for (key, theirs) in example["scalars"].as_object().expect("numbers") {
            compare(&report[key], theirs, key);
        }
        assert_eq!(compared, 4 * 12 + 4);
    }
}
