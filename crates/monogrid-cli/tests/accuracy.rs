//! The accuracy that we promise (`accuracy.toml`), on the built-in world and on recorded sequences.
//!
//! Slow: `cargo test --test accuracy -- --ignored --nocapture`. Recorded sequences lie in the
//! folder that MONOGRID_DATA names; without it their tests fail, and `--skip real_data` leaves them
//! out.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "a test may panic and talk"
)]

mod common;

use common::{WITHOUT_DENSE_DEPTH, code, data, json, monogrid, stderr};
use rayon::prelude::*;
use serde::Deserialize;
use std::path::Path;

/// What `accuracy.toml` promises of a sequence; what it says beside is for the table of README.md.
#[derive(Debug, Deserialize)]
struct Promise {
    name: String,
    /// None where there is to be no map.
    ate_m: Option<f64>,
    #[serde(default = "no_drift")]
    scale_drift: f64,
    #[serde(default = "all_frames")]
    frames_percent: f64,
}

fn no_drift() -> f64 {
    1.05
}

fn all_frames() -> f64 {
    100.0
}

impl Promise {
    fn all() -> Vec<Self> {
        #[derive(Deserialize)]
        struct File {
            sequence: Vec<Promise>,
        }
        toml::from_str::<File>(include_str!("accuracy.toml"))
            .unwrap()
            .sequence
    }

    fn of(name: &str) -> Self {
        let mut all = Self::all().into_iter();
        let found = all.find(|promise| promise.name == name);
        found.unwrap_or_else(|| panic!("accuracy.toml promises nothing for {name}"))
    }
}

/// The results of README.md, which scripts/results.py prints from them: the last cell of each row.
fn measured() -> Vec<(String, String)> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../benchmarks/results.json");
    let results = std::fs::read_to_string(path).unwrap();
    let results: serde_json::Value = serde_json::from_str(&results).unwrap();
    let rows = results["tables"]["readme"]["rows"].as_array().unwrap();
    let cell = |cell: &serde_json::Value| cell.as_str().unwrap().to_owned();
    let of_row = |row: &serde_json::Value| {
        let row = row.as_array().unwrap();
        (cell(row.first().unwrap()), cell(row.last().unwrap()))
    };
    rows.iter().map(of_row).collect()
}

#[test]
fn the_results_of_the_readme_keep_what_is_promised() {
    let measured = measured();
    for promise in Promise::all() {
        let Promise { name, ate_m, .. } = promise;
        let row = measured
            .iter()
            .find(|(what, _)| what.split(',').next() == Some(name.as_str()));
        let (_, result) = row.unwrap_or_else(|| panic!("README.md has no row of {name}"));
        let ate = result
            .split_once(" m")
            .and_then(|(ate, _)| ate.parse::<f64>().ok());
        match (ate_m, ate) {
            (Some(promised), Some(ate)) => assert!(ate <= SPREAD * promised, "{name}: {result}"),
            (None, None) => {}
            _ => panic!("{name}: {result}"),
        }
    }
}

fn run(source: &Path, out: &Path, more: &[&str]) -> std::process::Output {
    let mut args = vec!["run".to_owned(), source.display().to_string()];
    args.extend([
        "--out".to_owned(),
        out.display().to_string(),
        "--json".to_owned(),
    ]);
    // poses are the same whatever the maps, but for what is up
    args.extend(WITHOUT_DENSE_DEPTH.map(str::to_owned));
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
    let promise = Promise::of("demo");
    let promised = promise.ate_m.expect("the demo has a map");
    assert!(ate <= SPREAD * promised, "ATE {ate} m over {path} m");
    let drift = trajectory["scale_drift"].as_f64().unwrap();
    assert!(drift <= promise.scale_drift, "scale drift {drift}");
}

/// Other starts end a little worse than the one in the README.
const SPREAD: f64 = 1.15;

#[test]
fn something_is_promised_for_every_sequence() {
    for promise in Promise::all() {
        let Promise {
            ate_m,
            scale_drift,
            frames_percent,
            ..
        } = promise;
        assert!(ate_m.is_none_or(|ate_m| ate_m > 0.0 && ate_m < 5.0));
        assert!((1.0..2.0).contains(&scale_drift), "{scale_drift}");
        assert!((50.0..=100.0).contains(&frames_percent));
    }
}

/// On recorded sequences.
mod real_data {
    use super::*;

    #[test]
    #[ignore = "minutes, and needs the sequences below MONOGRID_DATA"]
    fn sequences_keep_what_is_promised() {
        // a run does not keep all cores busy
        let promises = Promise::all().into_par_iter().with_max_len(1);
        promises.for_each(|promise| match promise.ate_m {
            _ if promise.name == "demo" => {}
            Some(ate_m) => is_kept(&promise, ate_m),
            None => no_map_is_made(&data(&promise.name)),
        });
    }

    fn is_kept(promise: &Promise, promised_m: f64) {
        let name = &promise.name;
        let source = data(name);
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("out");
        let output = run(&source, &out, &[]);
        assert_eq!(code(&output), 0, "{name}: {}", stderr(&output));
        let summary = json(&output);
        let share = |key: &str| summary[key].as_f64().unwrap();
        let frames_percent = 100.0 * share("tracked") / share("frames");
        let report = evaluate(&out, &source);
        let (ate_m, drift) = (&report["ate_rmse"], &report["scale_drift"]);
        println!("{name}: ATE {ate_m} m, scale drift {drift}, {frames_percent:.1} %; {promise:?}");
        assert!(
            ate_m.as_f64().unwrap() <= SPREAD * promised_m,
            "{name}: {report}"
        );
        let drift_allowed = 1.0 + SPREAD * (promise.scale_drift - 1.0);
        assert!(drift.as_f64().unwrap() <= drift_allowed, "{name}: {report}");
        assert!(
            frames_percent >= promise.frames_percent - 2.0,
            "{name}: {summary}"
        );
    }

    /// Of a camera that does not move.
    fn no_map_is_made(source: &Path) {
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("out");
        let output = run(source, &out, &[]);
        assert_eq!(code(&output), 3, "{}", stderr(&output));
        assert_eq!(json(&output)["keyframes"], 0);
        assert!(!out.join("global.ot").exists());
    }
}
