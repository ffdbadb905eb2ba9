//! Agreement with `evo` on the stored examples; `tests/evo/regenerate.py` makes both.

use monogrid_evaluation::{
    StampedPose, TrajectoryAlignment, TrajectoryConfig, TrajectoryReport, evaluate_trajectory,
};
use monogrid_geometry::{Rotation, Se3, Vec3, nalgebra::Quaternion, rotation_exp};

const EVO: &str = include_str!("../evo/evo.json");

fn stamp_ns(text: &str) -> i64 {
    let (whole, fraction) = text.split_once('.').expect("a decimal number");
    let digits = format!("{fraction:0<9}");
    let nanoseconds = whole.parse::<i64>().expect("seconds") * 1_000_000_000;
    let fraction: i64 = digits.parse().expect("nine digits");
    if text.starts_with('-') {
        nanoseconds - fraction
    } else {
        nanoseconds + fraction
    }
}

fn parse(text: &str) -> Vec<StampedPose> {
    text.lines()
        .map(|line| {
            let mut fields = line.split(' ');
            let stamp = stamp_ns(fields.next().expect("a time"));
            let v: Vec<f64> = fields.map(|f| f.parse().expect("a number")).collect();
            let rotation = Rotation::from_quaternion(Quaternion::new(v[6], v[3], v[4], v[5]));
            (stamp, Se3::new(rotation, Vec3::new(v[0], v[1], v[2])))
        })
        .collect()
}

/// Our numbers under evo's names.
fn ours(report: &TrajectoryReport) -> Vec<(&'static str, f64)> {
    let (trans, rot) = (&report.rpe_trans, &report.rpe_rot_deg);
    vec![
        ("matched", report.matched as f64),
        ("scale", report.scale),
        ("ate_rmse", report.ate_rmse),
        ("ate_mean", report.ate_mean),
        ("ate_median", report.ate_median),
        ("ate_std", report.ate_std),
        ("ate_max", report.ate_max),
        ("ate_min", report.ate_min),
        ("rpe_trans_rmse", report.rpe_trans_rmse),
        ("rpe_trans_mean", trans.mean),
        ("rpe_trans_median", trans.median),
        ("rpe_trans_std", trans.std),
        ("rpe_trans_max", trans.max),
        ("rpe_trans_min", trans.min),
        ("rpe_rot_deg_rmse", report.rpe_rot_rmse_deg),
        ("rpe_rot_deg_mean", rot.mean),
        ("rpe_rot_deg_median", rot.median),
        ("rpe_rot_deg_std", rot.std),
        ("rpe_rot_deg_max", rot.max),
        ("rpe_rot_deg_min", rot.min),
    ]
}

fn compare(name: &str, estimate: &str, truth: &str) {
    let evo: serde_json::Value = serde_json::from_str(EVO).expect("valid JSON");
    let (estimate, truth) = (parse(estimate), parse(truth));
    for (label, alignment) in [
        ("sim3", TrajectoryAlignment::Sim3),
        ("se3", TrajectoryAlignment::Se3),
        ("none", TrajectoryAlignment::None),
    ] {
        let config = TrajectoryConfig {
            alignment,
            ..TrajectoryConfig::default()
        };
        let report = evaluate_trajectory(&estimate, &truth, &config).expect("a report");
        let theirs = evo["examples"][name][label].as_object().expect("numbers");
        let ours = ours(&report);
        assert_eq!(ours.len(), theirs.len());
        for (key, value) in ours {
            let expected = theirs[key].as_f64().expect("a number");
            assert!(
                (value - expected).abs() < 1e-6,
                "{name} {label} {key}: {value}, evo says {expected}"
            );
        }
    }
}

#[test]
fn agrees_with_evo_when_the_truth_is_faster() {
    compare(
        "fast-truth",
        include_str!("../evo/fast-truth-estimate.txt"),
        include_str!("../evo/fast-truth-truth.txt"),
    );
}

#[test]
fn agrees_with_evo_when_the_truth_is_sparser_and_times_tie() {
    compare(
        "sparse-truth",
        include_str!("../evo/sparse-truth-estimate.txt"),
        include_str!("../evo/sparse-truth-truth.txt"),
    );
}

#[test]
fn agrees_with_evo_when_times_jitter() {
    compare(
        "jitter",
        include_str!("../evo/jitter-estimate.txt"),
        include_str!("../evo/jitter-truth.txt"),
    );
}

#[test]
fn order_of_the_input_does_not_matter_and_bad_input_is_named() {
    let truth = parse(include_str!("../evo/jitter-truth.txt"));
    let mut estimate = parse(include_str!("../evo/jitter-estimate.txt"));
    let config = TrajectoryConfig::default();
    let sorted = evaluate_trajectory(&estimate, &truth, &config).expect("a report");
    estimate.reverse();
    let reversed = evaluate_trajectory(&estimate, &truth, &config).expect("a report");
    assert_eq!(sorted, reversed);

    let late: Vec<_> = truth
        .iter()
        .map(|(t, p)| (t + 1_000_000_000_000, *p))
        .collect();
    let error = evaluate_trajectory(&estimate, &late, &config).expect_err("no overlap");
    assert!(error.to_string().contains("same clock"), "{error}");
    estimate[3].1.translation.x = f64::NAN;
    let error = evaluate_trajectory(&estimate, &truth, &config).expect_err("NaN");
    assert!(
        error.to_string().contains("pose 3 of the estimated"),
        "{error}"
    );
    let config = TrajectoryConfig {
        frame_interval_secs: Some(0.0),
        ..config
    };
    let error = evaluate_trajectory(&truth, &truth, &config).expect_err("no interval");
    assert!(error.to_string().contains("frame_interval_secs"), "{error}");
}

#[test]
fn the_report_has_the_names_of_the_contract() {
    let truth = parse(include_str!("../evo/jitter-truth.txt"));
    let report = evaluate_trajectory(&truth, &truth, &TrajectoryConfig::default()).expect("report");
    let json = serde_json::to_value(&report).expect("serialisable");
    for key in [
        "ate_rmse",
        "ate_mean",
        "ate_median",
        "ate_std",
        "ate_max",
        "rpe_trans_rmse",
        "rpe_rot_rmse_deg",
        "tilt_deg",
        "scale",
        "scale_drift",
        "matched",
        "coverage",
        "wrong_share",
    ] {
        assert!(json[key].is_number(), "{key} in {json}");
    }
    assert!(report.ate_rmse < 1e-12 && (report.scale - 1.0).abs() < 1e-12);
    assert_eq!(report.coverage, 1.0);
    assert_eq!(report.wrong_share, 0.0);
    assert!(report.tilt_deg < 1e-6);
}

#[test]
fn the_tilt_is_that_of_the_vertical_whatever_is_aligned() {
    let truth = parse(include_str!("../evo/jitter-truth.txt"));
    let turned = |turn: Vec3| -> Vec<StampedPose> {
        let turn = Se3::new(rotation_exp(&turn), Vec3::new(1.0, 2.0, 3.0));
        truth
            .iter()
            .map(|(time, pose)| (*time, turn * *pose))
            .collect()
    };
    let tilt = |turn| {
        let report = evaluate_trajectory(&turned(turn), &truth, &TrajectoryConfig::default());
        report.expect("report").tilt_deg
    };
    // a heading is no tilt
    assert!(tilt(Vec3::z() * 0.7) < 1e-6);
    assert!((tilt(Vec3::y() * 0.01) - 0.01f64.to_degrees()).abs() < 1e-6);
}

#[test]
fn positions_alone_tell_no_rotation_and_the_same_positions() {
    let known = "0.0 0 0 0 0 0 0 1\n0.1 1 0 0 0 0 0.6 0.8\n0.2 2 1 0 0 0.6 0 0.8\n0.3 2 2 1 \
                 0.6 0 0 0.8\n0.4 1 3 2 0 0 0 1";
    let moved = |(time, pose): &StampedPose| {
        let turn = rotation_exp(&Vec3::new(0.3, -0.2, 1.0));
        let wobble = rotation_exp(&Vec3::new(0.0, 0.1 * (*time % 7) as f64, 0.0));
        let position = turn * (pose.translation * 0.4) + Vec3::new(5.0, 1.0, 0.0);
        (*time, Se3::new(turn * pose.rotation * wobble, position))
    };
    let truth = parse(known);
    let estimate: Vec<StampedPose> = truth.iter().map(moved).collect();
    let positions = |poses: &[StampedPose]| -> Vec<StampedPose> {
        let alone = |pose: &Se3| Se3::new(Rotation::identity(), pose.translation);
        poses
            .iter()
            .map(|(time, pose)| (*time, alone(pose)))
            .collect()
    };
    let config = TrajectoryConfig::default();
    let compare =
        |a: &[StampedPose], b: &[StampedPose]| evaluate_trajectory(a, b, &config).unwrap();
    let both = compare(&estimate, &truth);
    assert!(both.has_orientations && both.wrong_share > 0.0);
    for (estimate, truth) in [
        (estimate.clone(), positions(&truth)),
        (positions(&estimate), truth.clone()),
        (positions(&estimate), positions(&truth)),
    ] {
        let found = compare(&estimate, &truth);
        assert!(!found.has_orientations);
        assert!((found.scale - both.scale).abs() < 1e-9 && found.ate_rmse < 1e-9);
        assert!(found.rpe_trans_rmse < 1e-6, "{}", found.rpe_trans_rmse);
        assert!(found.rpe_rot_rmse_deg < 1e-6 && found.wrong_share == 0.0);
    }
    // along a line they do not say how the estimate is turned around it
    let line: Vec<StampedPose> = (0..5)
        .map(|k| {
            (
                k * 100_000_000,
                Se3::new(Rotation::identity(), k as f64 * Vec3::x()),
            )
        })
        .collect();
    assert!(evaluate_trajectory(&estimate, &line, &config).is_err());
}
