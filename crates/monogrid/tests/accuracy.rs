//! The accuracy that we promise, on the built-in world and, where it exists, on recorded data.
//!
//! Slow: run with `cargo test --release -p monogrid --test accuracy -- --ignored --nocapture`.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "a test may panic and talk"
)]

mod common;

use common::{code, json, monogrid, stderr};
use std::path::{Path, PathBuf};

/// The folder with recorded sequences; `None`, said loudly, when it is absent.
fn sequence(name: &str) -> Option<PathBuf> {
    let path = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data")).join(name);
    if path.is_dir() {
        Some(path)
    } else {
        eprintln!("SKIPPED: {} is absent", path.display());
        None
    }
}

fn run(source: &Path, out: &Path, more: &[&str]) -> std::process::Output {
    let mut args = vec!["run".to_owned(), source.display().to_string()];
    args.extend([
        "--out".to_owned(),
        out.display().to_string(),
        "--json".to_owned(),
    ]);
    args.extend(more.iter().map(|s| (*s).to_owned()));
    monogrid(args)
}

fn evaluate(run: &Path, source: &Path) -> serde_json::Value {
    let output = monogrid([
        Path::new("evaluate"),
        Path::new("trajectory"),
        &run.join("trajectory.txt"),
        &source.join("groundtruth.txt"),
        Path::new("--json"),
    ]);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    json(&output)
}

#[test]
#[ignore = "a minute in release builds"]
fn the_beginning_of_the_demo_is_tracked_and_measured_well() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("demo");
    let output = monogrid([
        "demo",
        "--out",
        &out.display().to_string(),
        "--max-frames",
        "400",
        "--json",
    ]);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let summary = json(&output);
    let trajectory = &summary["trajectory"];
    let ate = trajectory["ate_rmse"].as_f64().unwrap();
    let path = trajectory["path_length"].as_f64().unwrap();
    let coverage = trajectory["coverage"].as_f64().unwrap();
    println!("demo, 400 frames: ATE {ate:.4} m of {path:.2} m, coverage {coverage:.3}");
    println!("depth: {}", summary["depth"]["within_3_percent"]);
    assert!(coverage >= 0.99, "coverage {coverage}");
    assert!(ate <= 0.01 * path, "ATE {ate} m over {path} m");
}

#[test]
#[ignore = "a minute in release builds"]
fn red_kitchen_is_tracked_to_the_end() {
    let Some(source) = sequence("red-kitchen") else {
        return;
    };
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    let output = run(&source, &out, &[]);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let report = evaluate(&out, &source);
    println!(
        "red-kitchen: ATE {} m, scale drift {}, coverage {}",
        report["ate_rmse"], report["scale_drift"], report["coverage"]
    );
    assert!(report["coverage"].as_f64().unwrap() >= 0.95, "{report}");
    assert!(report["ate_rmse"].as_f64().unwrap() <= 0.15, "{report}");
}

#[test]
#[ignore = "seconds in release builds"]
fn a_camera_that_does_not_move_makes_no_map() {
    let Some(source) = sequence("euroc-static") else {
        return;
    };
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    let output = run(&source, &out, &[]);
    assert_eq!(code(&output), 3, "{}", stderr(&output));
    assert_eq!(json(&output)["keyframes"], 0);
    assert!(!out.join("global.ot").exists());
}
