//! Runs that close submaps: they are the same map as the recording, whoever reads them.

use crate::common::{assert_fails, code, files, json, monogrid, program, small_sequence, stderr};
use monogrid_datasets::{ReadOptions, RecordedKeyframe, Recording, SubmapTable};
use std::fs;
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

/// Runs a command that must succeed; its JSON.
fn said(args: &[&str]) -> serde_json::Value {
    let output = monogrid(args.iter().chain(&["--json"]));
    assert_eq!(code(&output), 0, "{args:?}: {}", stderr(&output));
    json(&output)
}

#[test]
fn the_map_of_submaps_is_that_of_the_recording() {
    let run = first_run();
    let dir = tempfile::tempdir().unwrap();
    // without anything of the run beside them but what says where up is
    let alone = dir.path().join("alone");
    fs::create_dir(&alone).unwrap();
    for (name, bytes) in files(&run.join("submaps")) {
        fs::write(alone.join(name), bytes).unwrap();
    }
    for name in ["map_from_world.txt", "summary.json"] {
        fs::copy(run.join(name), alone.join(name)).unwrap();
    }
    let sources = [
        run.join("recording.mgk"),
        run.to_owned(),
        run.join("submaps"),
        table(run),
        alone,
    ];
    for (index, source) in sources.iter().enumerate() {
        let out = dir.path().join(format!("{index}.ot"));
        said(&["map", text(source), "--out", text(&out)]);
        assert!(
            fs::read(&out).unwrap() == fs::read(run.join("global.ot")).unwrap(),
            "{source:?}"
        );
    }
}

#[test]
fn submaps_are_looked_at_and_gone_on_with_as_a_recording_is() {
    let run = first_run();
    let dir = tempfile::tempdir().unwrap();
    let submaps = run.join("submaps");
    let pages = [run.join("recording.mgk"), table(run)].map(|source| {
        let page = dir.path().join("page.html");
        said(&["view", text(&source), "--html", text(&page), "--force"]);
        let name = text(&source).to_owned();
        fs::read_to_string(&page)
            .unwrap()
            .replace(&name, "SOURCE")
            .len()
    });
    assert!(pages[0].abs_diff(pages[1]) < 200, "{pages:?}");
    let on = [run.join("recording.mgk"), submaps.clone()].map(|source| {
        let out = dir.path().join("on");
        let args = [
            "run",
            text(small_sequence()),
            "--out",
            text(&out),
            "--force",
        ];
        let more = ["--continue", text(&source), "--max-frames", "40", "--json"];
        let output = monogrid(args.iter().chain(&more));
        assert_eq!(code(&output), 0, "{}", stderr(&output));
        fs::read(out.join("recording.mgk")).unwrap()
    });
    assert!(on[0] == on[1]);
    // a run does not write over what it goes on with
    let before = files(run);
    let args = ["run", text(small_sequence()), "--continue", text(&submaps)];
    let output = monogrid(args.iter().chain(&["--out", text(run), "--force"]));
    assert_fails(&output, 2, &["the run to continue"]);
    assert!(files(run) == before);
}

#[test]
fn submaps_are_merged_as_recordings_are() {
    let run = first_run();
    let dir = tempfile::tempdir().unwrap();
    let later = dir.path().join("later");
    let output = monogrid(
        run_args(&later, "--submaps")
            .into_iter()
            .chain(["--seed", "5"].map(str::to_owned)),
    );
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let merged = ["recording.mgk", "submaps"].map(|kind| {
        let out = dir.path().join(format!("of {kind}"));
        let (a, b) = (run.join(kind), later.join(kind));
        let output = monogrid(["merge-runs", text(&a), text(&b), "--out", text(&out)]);
        assert!([0, 4].contains(&code(&output)), "{}", stderr(&output));
        fs::read(out.join("global.ot")).unwrap()
    });
    assert!(merged[0] == merged[1]);
}

#[test]
fn what_is_in_submaps_is_told() {
    let run = first_run();
    let info = said(&["info", text(&run.join("submaps"))]);
    assert_eq!(info["submaps"][0]["keyframes"], 2);
    assert_eq!(info["submaps"][0]["width"], 320);
    assert_eq!(info["submaps"][0]["is_placed"], true);
    let file = run
        .join("submaps")
        .join(info["submaps"][0]["file"].as_str().unwrap());
    let of_one = said(&["info", text(&file)]);
    assert_eq!(
        of_one["submaps"][0]["bounds_max"],
        info["submaps"][0]["bounds_max"]
    );
    let output = monogrid(["info", text(&file)]);
    assert!(String::from_utf8_lossy(&output.stdout).contains("2 keyframes of 320x240 pixels"));
    // alone it is a map in its own frame
    let out = run.parent().unwrap().join("one.ot");
    let map = said(&["map", text(&file), "--out", text(&out)]);
    assert_eq!(map["scans"], 2);
    assert_eq!(map["warnings"], serde_json::json!([]));
    // a damaged one is named by whoever needs it
    let dir = tempfile::tempdir().unwrap();
    for (name, bytes) in files(&run.join("submaps")) {
        fs::write(dir.path().join(name), bytes).unwrap();
    }
    let name = file.file_name().unwrap();
    let mut bytes = fs::read(&file).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(dir.path().join(name), bytes).unwrap();
    let map = dir.path().join("m.ot");
    let output = monogrid(["map", text(dir.path()), "--out", text(&map)]);
    assert_fails(&output, 2, &[name.to_str().unwrap(), "damaged"]);
}
