//! Whole runs on a short video of the built-in room: files, determinism, crashes.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "a test may panic and talk"
)]

mod common;

use common::{
    assert_fails, code, copy_of_small_sequence, files, json, monogrid, program, small_sequence,
    stderr,
};
use std::fs;
use std::path::Path;
use std::process::{Output, Stdio};
use std::time::{Duration, Instant};

fn run(source: &Path, out: &Path, more: &[&str]) -> Output {
    let mut args = vec!["run".to_owned(), source.display().to_string()];
    args.extend(["--out".to_owned(), out.display().to_string()]);
    args.extend(["--seed-depth".to_owned(), "dataset".to_owned()]);
    args.extend(more.iter().map(|s| (*s).to_owned()));
    monogrid(args)
}

/// Files whose content holds times of this very run.
fn holds_time(name: &str) -> bool {
    matches!(
        name,
        "summary.json" | "report.html" | "frames.csv" | "monogrid-manifest.txt"
    )
}

#[test]
fn a_run_writes_everything_and_the_same_bytes_for_any_number_of_threads() {
    let dir = tempfile::tempdir().unwrap();
    let first = dir.path().join("one");
    let output = run(small_sequence(), &first, &["--threads", "1", "--json"]);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let summary = json(&output);
    assert_eq!(summary["frames"], common::SMALL_FRAMES);
    assert!(summary["tracked"].as_u64().unwrap() as usize > common::SMALL_FRAMES * 9 / 10);
    assert!(summary["keyframes"].as_u64().unwrap() >= 2, "{summary}");
    assert!(summary["points"].as_u64().unwrap() > 1000);
    assert_eq!(summary["scale"], "metric");
    for name in [
        "trajectory.txt",
        "trajectory_live.txt",
        "trajectory_odometry.txt",
        "frames.csv",
        "keyframes.txt",
        "recording.mgk",
        "graph.g2o",
        "graph_rigid.g2o",
        "global.ot",
        "global.bt",
        "local.ot",
        "large.ot",
        "cloud.ply",
        "map.pgm",
        "map.yaml",
        "preview.png",
        "config.toml",
        "summary.json",
        "report.html",
        "keyframes/00000_image.png",
        "keyframes/00000_depth.png",
        "keyframes/00000_uncertainty.png",
    ] {
        let length = fs::metadata(first.join(name)).map(|m| m.len()).unwrap_or(0);
        assert!(length > 0, "{name}");
    }
    let second = dir.path().join("three");
    let output = run(small_sequence(), &second, &["--threads", "3"]);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let (a, b) = (files(&first), files(&second));
    let names = |files: &[(String, Vec<u8>)]| files.iter().map(|f| f.0.clone()).collect::<Vec<_>>();
    assert_eq!(names(&a), names(&b));
    for ((name, left), (_, right)) in a.iter().zip(&b) {
        assert!(holds_time(name) || left == right, "{name} differs");
    }
    the_map_command_reproduces_the_global_map(&first);
    the_results_can_be_evaluated(&first);
}

fn the_map_command_reproduces_the_global_map(run: &Path) {
    let map = run.join("again.ot");
    let recording = run.join("recording.mgk");
    let output = monogrid([
        Path::new("map"),
        &recording,
        Path::new("--out"),
        &map,
        Path::new("--json"),
    ]);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    assert_eq!(
        fs::read(&map).unwrap(),
        fs::read(run.join("global.ot")).unwrap()
    );
    let report = json(&output);
    for key in [
        "points",
        "seconds",
        "seconds_per_100k_points",
        "wall_seconds",
        "leaves",
        "bytes_in_memory",
        "peak_rss_bytes",
        "file_bytes",
    ] {
        assert!(report[key].is_number(), "{key}: {report}");
    }
    let ply = run.join("again.ply");
    let output = monogrid([Path::new("convert"), &map, &ply]);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    assert_eq!(
        fs::read(&ply).unwrap(),
        fs::read(run.join("cloud.ply")).unwrap()
    );
    let info = json(&monogrid([Path::new("info"), &map, Path::new("--json")]));
    assert_eq!(info["leaves"], report["leaves"]);
    assert!(info["cells_occupied"].as_u64().unwrap() > 0);
}

fn the_results_can_be_evaluated(run: &Path) {
    let source = small_sequence();
    let sim3 = run.join("sim3.txt");
    let output = monogrid([
        Path::new("evaluate"),
        Path::new("trajectory"),
        &run.join("trajectory.txt"),
        &source.join("groundtruth.txt"),
        Path::new("--write-sim3"),
        &sim3,
        Path::new("--json"),
    ]);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let report = json(&output);
    let ate = report["ate_rmse"].as_f64().unwrap();
    assert!(ate < 0.1, "ATE {ate} m");
    let scale = report["scale"].as_f64().unwrap();
    assert!(
        (scale - 1.0).abs() < 0.1,
        "a seed depth makes the scale metric: {scale}"
    );
    assert!(fs::read_to_string(sim3).unwrap().split_whitespace().count() >= 8);
    let output = monogrid([
        Path::new("evaluate"),
        Path::new("depth"),
        &run.join("recording.mgk"),
        source,
        Path::new("--json"),
    ]);
    // of the keyframes only the first has a depth image of its time, and that was given to it
    assert_fails(&output, 2, &["that was not given true depth"]);
}

#[test]
fn an_aligned_run_is_in_the_frame_of_the_reference() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    let truth = small_sequence().join("groundtruth.txt");
    let align = format!("gt:{}", truth.display());
    let output = run(small_sequence(), &out, &["--align", &align, "--json"]);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    assert_eq!(json(&output)["scale"], "metric");
    let report = json(&monogrid([
        Path::new("evaluate"),
        Path::new("trajectory"),
        &out.join("trajectory.txt"),
        &truth,
        Path::new("--align"),
        Path::new("none"),
        Path::new("--json"),
    ]));
    assert!(report["ate_rmse"].as_f64().unwrap() < 0.1, "{report}");
}

#[test]
fn damaged_frames_in_the_middle_are_survived() {
    let dir = tempfile::tempdir().unwrap();
    let source = dir.path().join("source");
    copy_of_small_sequence(&source);
    let mut images: Vec<_> = fs::read_dir(source.join("rgb"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    images.sort();
    fs::write(&images[40], "x").unwrap();
    let whole = fs::read(&images[60]).unwrap();
    fs::write(&images[60], &whole[..whole.len() / 2]).unwrap();
    let output = run(&source, &dir.path().join("out"), &["--json"]);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let summary = json(&output);
    assert_eq!(summary["skipped"], 2);
    assert!(summary["tracked"].as_u64().unwrap() as usize > common::SMALL_FRAMES * 8 / 10);
}

/// Starts a run and waits until its recording is a few keyframes long.
fn started(source: &Path, out: &Path) -> std::process::Child {
    let mut child = program()
        .arg("run")
        .arg(source)
        .arg("--out")
        .arg(out)
        .args(["--seed-depth", "dataset", "--realtime"])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let begin = Instant::now();
    while !out.join("keyframes/00001_uncertainty.png").exists() {
        assert!(child.try_wait().unwrap().is_none(), "the run ended early");
        assert!(
            begin.elapsed() < Duration::from_secs(60),
            "no second keyframe"
        );
        std::thread::sleep(Duration::from_millis(5));
    }
    child
}

#[test]
fn a_killed_run_leaves_a_recording_that_can_be_mapped_and_a_folder_that_can_be_used_again() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    let mut child = started(small_sequence(), &out);
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(!out.join("global.ot").exists());
    let map = dir.path().join("map.ot");
    let recording = out.join("recording.mgk");
    let output = monogrid([
        Path::new("map"),
        &recording,
        Path::new("--out"),
        &map,
        Path::new("--json"),
    ]);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    assert!(json(&output)["scans"].as_u64().unwrap() >= 2);
    assert!(stderr(&output).contains("did not end by itself"));
    let output = run(small_sequence(), &out, &["--max-frames", "20"]);
    assert_ne!(code(&output), 2, "{}", stderr(&output));
}

#[cfg(unix)]
#[test]
fn an_interrupt_saves_everything() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    let mut child = started(small_sequence(), &out);
    let killed = std::process::Command::new("kill")
        .args(["-INT", &child.id().to_string()])
        .status();
    assert!(killed.unwrap().success());
    let status = child.wait().unwrap();
    assert_eq!(status.code(), Some(4), "a state of its own");
    let text = fs::read_to_string(out.join("summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(summary["status"], "interrupted");
    assert!(summary["frames"].as_u64().unwrap() < common::SMALL_FRAMES as u64);
    assert!(out.join("global.ot").exists());
}
