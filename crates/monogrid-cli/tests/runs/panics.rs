//! A panic in any part of a run ends it with exit code 1 and a sentence, and what was mapped until
//! then is saved.

use crate::common::{WITHOUT_DENSE_DEPTH, code, get_below, program, small_sequence, stderr};
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Output, Stdio};

/// A run in which the given part panics at its N-th passage; `options` are added.
fn run(panic_in: &str, out: &Path, options: &[&str]) -> Output {
    let mut command = program();
    command.arg("run").arg(small_sequence());
    command.args([
        "--seed-depth",
        "dataset",
        "--max-frames",
        "90",
        "--threads",
        "2",
        "--out",
    ]);
    command
        .arg(out)
        .args(options)
        .env("MONOGRID_PANIC_IN", panic_in);
    command.output().expect("the program starts")
}

/// The number of poses in the trajectory.
fn num_poses(out: &Path) -> usize {
    let text = std::fs::read_to_string(out.join("trajectory.txt")).unwrap_or_default();
    text.lines().filter(|line| !line.starts_with('#')).count()
}

#[test]
fn a_panic_in_any_part_ends_the_run_with_what_was_mapped() {
    let folder = tempfile::tempdir().unwrap();
    // each at a passage at which there are keyframes
    let parts = [
        ("graph:3", &WITHOUT_DENSE_DEPTH[..]),
        ("pool:350", &WITHOUT_DENSE_DEPTH),
        ("tracking:70", &WITHOUT_DENSE_DEPTH),
        ("reader:70", &WITHOUT_DENSE_DEPTH),
        ("mapper:3", &WITHOUT_DENSE_DEPTH),
        ("depth:2", &[]),
    ];
    for (panic_in, options) in parts {
        let out = folder.path().join(panic_in.replace(':', "-"));
        let output = run(panic_in, &out, options);
        let text = stderr(&output);
        assert_eq!(code(&output), 1, "{panic_in}: {text}");
        let (part, _) = panic_in.split_once(':').unwrap();
        let said = format!("a panic on purpose in {part}; what was mapped until then is saved");
        assert!(text.contains(&said), "{panic_in}: {text}");
        assert!(
            num_poses(&out) > 20,
            "{panic_in}: {} poses",
            num_poses(&out)
        );
        for file in ["recording.mgk", "global.ot", "report.html", "summary.json"] {
            assert!(out.join(file).is_file(), "{panic_in}: no {file}");
        }
        let summary = std::fs::read_to_string(out.join("summary.json")).unwrap();
        assert!(
            summary.contains("\"status\": \"failed\""),
            "{panic_in}: {summary}"
        );
    }
}

#[test]
fn without_its_recorder_a_run_ends_with_poses_and_maps() {
    let folder = tempfile::tempdir().unwrap();
    let output = run("recorder:2", folder.path(), &WITHOUT_DENSE_DEPTH);
    let text = stderr(&output);
    assert_eq!(code(&output), 1, "{text}");
    assert!(text.contains("a panic on purpose in recorder"), "{text}");
    assert!(num_poses(folder.path()) > 20);
    assert!(folder.path().join("global.ot").is_file());
}

#[test]
fn a_viewer_that_panics_fails_the_run_with_everything_written() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = program();
    command.arg("run").arg(small_sequence());
    command
        .args([
            "--seed-depth",
            "dataset",
            "--max-frames",
            "90",
            "--view",
            "--out",
        ])
        .arg(folder.path().join("out"))
        .args(WITHOUT_DENSE_DEPTH)
        .env("MONOGRID_PANIC_IN", "viewer:1");
    command.stdout(Stdio::null()).stderr(Stdio::piped());
    let mut child = command.spawn().unwrap();
    let mut said = BufReader::new(child.stderr.take().unwrap()).lines();
    let mut lines = Vec::new();
    for line in said.by_ref().map(Result::unwrap) {
        let url = line
            .split_whitespace()
            .find(|w| w.starts_with("http://127.0.0.1:"));
        if let Some(url) = url {
            get_below(url, "live/0/0/0");
        }
        lines.push(line);
    }
    let text = lines.join("\n");
    assert_eq!(child.wait().unwrap().code(), Some(1), "{text}");
    assert!(text.contains("a panic on purpose in viewer"), "{text}");
    assert!(text.contains("answers browsers has panicked"), "{text}");
    assert!(num_poses(&folder.path().join("out")) > 20);
    for file in ["recording.mgk", "global.ot", "report.html", "summary.json"] {
        assert!(folder.path().join("out").join(file).is_file(), "no {file}");
    }
}

#[test]
fn a_command_that_panics_says_so_and_fails() {
    // in the first pass over a video without a calibration there is nothing to save yet
    let folder = tempfile::tempdir().unwrap();
    let images = folder.path().join("images");
    std::fs::create_dir(&images).unwrap();
    for entry in std::fs::read_dir(small_sequence().join("rgb")).unwrap() {
        let path = entry.unwrap().path();
        std::fs::copy(&path, images.join(path.file_name().unwrap())).unwrap();
    }
    let mut command = program();
    command
        .arg("run")
        .arg(&images)
        .arg("--out")
        .arg(folder.path().join("out"));
    command.env("MONOGRID_PANIC_IN", "pool:1");
    let output = command.output().expect("the program starts");
    let text = stderr(&output);
    assert_eq!(code(&output), 1, "{text}");
    assert!(
        text.contains("error: ") && text.contains("a panic on purpose in pool"),
        "{text}"
    );
}
