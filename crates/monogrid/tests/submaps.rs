//! Runs that close submaps: they are the same map as the recording, whoever reads them.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod common;

use common::{code, files, monogrid, program, small_sequence, stderr};
use monogrid_datasets::{ReadOptions, RecordedKeyframe, Recording, SubmapTable};
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::OnceLock;
use std::time::Duration;

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Arguments of a run with submaps of two keyframes, or another option in place of that.
fn run_args(out: &Path, submaps: &str) -> Vec<String> {
    let args = ["run", text(small_sequence()), submaps, "--out", text(out)];
    args.map(str::to_owned).to_vec()
}

/// The small sequence, mapped once.
fn first_run() -> &'static Path {
    static FOLDER: OnceLock<(tempfile::TempDir, PathBuf)> = OnceLock::new();
    let (_, folder) = FOLDER.get_or_init(|| {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("first");
        let output = monogrid(run_args(&folder, "--submaps=2"));
        assert_eq!(code(&output), 0, "{}", stderr(&output));
        (dir, folder)
    });
    folder
}

fn table(run: &Path) -> PathBuf {
    run.join("submaps/submaps.json")
}

#[test]
fn submaps_of_a_run_are_its_recording() {
    let run = first_run();
    let recording = Recording::read(&run.join("recording.mgk"), ReadOptions::default()).unwrap();
    let of_submaps = Recording::read(&table(run), ReadOptions::default()).unwrap();
    assert!(of_submaps.end.is_some() && of_submaps.continuation.is_some());
    assert!(of_submaps == recording);
    let entries = SubmapTable::read(&table(run)).unwrap().submaps;
    let sizes: Vec<usize> = entries.iter().map(|entry| entry.keyframes).collect();
    assert_eq!(sizes.iter().sum::<usize>(), recording.keyframes.len());
    assert!(
        sizes.len() > 1 && sizes[..sizes.len() - 1].iter().all(|n| *n == 2),
        "{sizes:?}"
    );
}

#[test]
fn the_same_run_closes_the_same_submaps_and_leaves_no_others() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("again");
    for submaps in ["--submaps=3", "--submaps=2"] {
        let args = run_args(&out, submaps).into_iter();
        let output = monogrid(args.chain(["--threads", "1"].map(str::to_owned)));
        assert_eq!(code(&output), 0, "{}", stderr(&output));
    }
    assert!(files(&out.join("submaps")) == files(&first_run().join("submaps")));
}

#[test]
fn a_killed_run_leaves_the_submaps_that_it_closed() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("killed");
    let mut command = program();
    // slowly, so that it is not over before it is killed
    let slowly = ["--fps", "20", "--realtime"];
    command.args(run_args(&out, "--submaps=1")).args(slowly);
    command.stderr(Stdio::null()).stdout(Stdio::null());
    let mut run = command.spawn().unwrap();
    while !table(&out).exists() {
        assert!(run.try_wait().unwrap().is_none(), "the run ended early");
        std::thread::sleep(Duration::from_millis(2));
    }
    run.kill().unwrap();
    run.wait().unwrap();
    let closed = Recording::read(&table(&out), ReadOptions::default()).unwrap();
    assert!(closed.end.is_none());
    let is_whole = |k: &RecordedKeyframe| k.world_from_keyframe.is_some() && k.image.is_some();
    assert!(!closed.keyframes.is_empty() && closed.keyframes.iter().all(is_whole));
}
