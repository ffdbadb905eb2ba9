//! Runs that go on with the map of an earlier one.

use crate::common::{
    WITHOUT_DENSE_DEPTH, assert_fails, code, files, json, monogrid, small_sequence, stderr,
};
use monogrid_datasets::{Dataset, SourceOptions, encode_png, read_gray, read_trajectory};
use monogrid_evaluation::{StampedPose, TrajectoryConfig, evaluate_trajectory};
use monogrid_image::Image;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;
use std::sync::OnceLock;

fn run(source: &Path, out: &Path, more: &[&str]) -> Output {
    let mut args = vec!["run".to_owned(), source.display().to_string()];
    args.extend([
        "--out".to_owned(),
        out.display().to_string(),
        "--json".to_owned(),
    ]);
    args.extend(WITHOUT_DENSE_DEPTH.map(str::to_owned));
    args.extend(more.iter().map(|s| (*s).to_owned()));
    monogrid(args)
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// The first 90 frames of the small sequence, mapped once.
pub(super) fn first_run() -> &'static Path {
    static FOLDER: OnceLock<(tempfile::TempDir, PathBuf)> = OnceLock::new();
    let (_, folder) = FOLDER.get_or_init(|| {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("first");
        let more = ["--seed-depth", "dataset", "--max-frames", "90"];
        let output = run(small_sequence(), &folder, &more);
        assert_eq!(code(&output), 0, "{}", stderr(&output));
        (dir, folder)
    });
    folder
}

/// Later frames of the same, mapped by themselves: of unknown scale, and by a camera that sees
/// less.
fn later_run() -> &'static Path {
    static FOLDER: OnceLock<(tempfile::TempDir, PathBuf)> = OnceLock::new();
    let (_, folder) = FOLDER.get_or_init(|| {
        let dir = tempfile::tempdir().unwrap();
        let source = dir.path().join("cut");
        cropped_sequence(&source);
        let folder = dir.path().join("later");
        let output = run(&source, &folder, &["--rolling-shutter", "0"]);
        assert_eq!(code(&output), 0, "{}", stderr(&output));
        (dir, folder)
    });
    folder
}

/// Frames 50 to 130 of the small sequence without what lies at the left and at the top.
fn cropped_sequence(folder: &Path) {
    let (left, top) = (24, 16);
    fs::create_dir_all(folder.join("rgb")).unwrap();
    let dataset = Dataset::open(small_sequence(), SourceOptions::default()).unwrap();
    let mut list = String::new();
    let mut size = (0, 0);
    for (index, frame) in dataset.frames[50..130].iter().enumerate() {
        let image = read_gray(&frame.path).unwrap();
        size = (image.width() - left, image.height() - top);
        let cut = Image::from_fn(size.0, size.1, |x, y| image.at(x + left, y + top) as u8);
        let name = format!("rgb/{index}.png");
        fs::write(folder.join(&name), encode_png(&cut)).unwrap();
        list += &format!("{:.6} {name}\n", frame.timestamp_ns as f64 * 1e-9);
    }
    fs::write(folder.join("rgb.txt"), list).unwrap();
    let camera = fs::read_to_string(small_sequence().join("calibration.txt")).unwrap();
    let line = camera.lines().find(|line| !line.starts_with('#')).unwrap();
    let mut numbers: Vec<f64> = line
        .split_whitespace()
        .map(|n| n.parse().unwrap())
        .collect();
    let last = numbers.len() - 2;
    numbers[2] -= left as f64;
    numbers[3] -= top as f64;
    (numbers[last], numbers[last + 1]) = (size.0 as f64, size.1 as f64);
    let words: Vec<String> = numbers.iter().map(f64::to_string).collect();
    fs::write(folder.join("calibration.txt"), words.join(" ") + "\n").unwrap();
}

#[test]
fn runs_of_two_cameras_become_one_map() {
    let dir = tempfile::tempdir().unwrap();
    let merge = |runs: [&Path; 2], name: &str, more: &[&str]| {
        let out = dir.path().join(name);
        let mut args = vec!["merge-runs", text(runs[0]), text(runs[1]), "--json"];
        args.extend(["--out", text(&out)]);
        args.extend(more);
        (monogrid(args), out)
    };
    let (first, later) = (first_run(), later_run());
    let before = (files(first), files(later));
    let (output, both) = merge([first, later], "both", &[]);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    assert!(before == (files(first), files(later)), "a run was changed");
    let summary = json(&output);
    assert_eq!(summary["scale"], "metric", "the first run is in metres");
    assert_eq!(summary["components"].as_array().unwrap().len(), 1);
    // both cameras lie in one frame, in metres
    let all = [1, 2].map(|number| poses(&both.join(format!("trajectory_{number}.txt"))));
    assert!(all[1].len() > 50, "{}", all[1].len());
    let truth = poses(&small_sequence().join("groundtruth.txt"));
    let report = evaluate_trajectory(&all.concat(), &truth, &TrajectoryConfig::default()).unwrap();
    assert!(
        report.ate_rmse < 0.015 * report.path_length,
        "{}",
        report.ate_rmse
    );
    assert!((report.scale - 1.0).abs() < 0.03, "{}", report.scale);
    // it is a recording as others are, with the camera of each keyframe
    let recording = both.join("recording.mgk");
    let again = dir.path().join("again.ot");
    let output = monogrid(["map", text(&recording), "--out", text(&again)]);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    assert!(fs::read(&again).unwrap() == fs::read(both.join("global.ot")).unwrap());
    let (output, _) = merge([&both, first], "twice", &["--resolution", "0.2"]);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    // two cameras cannot be gone on with
    let more = ["--continue", text(&both), "--max-frames", "20"];
    let refused = run(small_sequence(), &dir.path().join("on"), &more);
    assert_fails(&refused, 2, &["several cameras"]);
    // the order and the number of threads change nothing but the numbers
    let (output, swapped) = merge(
        [later, first],
        "swapped",
        &["--threads", "1", "--resolution", "0.2"],
    );
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    assert!(fs::read(swapped.join("recording.mgk")).unwrap() == fs::read(recording).unwrap());
    // where too little agrees both stay as they are
    let strict = [
        "--set",
        "slam.merge.min_agreeing=1000",
        "--resolution",
        "0.2",
    ];
    let (output, apart) = merge([first, later], "apart", &strict);
    assert_eq!(code(&output), 3, "{}", stderr(&output));
    assert_eq!(json(&output)["components"].as_array().unwrap().len(), 2);
    for place in ["", "apart_1/"] {
        let recording = apart.join(format!("{place}recording.mgk"));
        let info = monogrid(["map", text(&recording), "--out", text(&apart.join("a.ot"))]);
        assert_eq!(code(&info), 0, "{}", stderr(&info));
        fs::remove_file(apart.join("a.ot")).unwrap();
    }
    // a recording is not merged with itself
    let (output, _) = merge([first, first], "itself", &[]);
    assert_fails(&output, 2, &["same recording"]);
}

fn poses(file: &Path) -> Vec<StampedPose> {
    read_trajectory(file)
        .unwrap()
        .iter()
        .map(|pose| (pose.timestamp_ns, pose.world_from_camera))
        .collect()
}

#[test]
fn a_second_session_extends_the_map() {
    let dir = tempfile::tempdir().unwrap();
    let before = files(first_run());
    let second = dir.path().join("second");
    let more = ["--continue", text(first_run()), "--start", "60"];
    let output = run(small_sequence(), &second, &more);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let summary = json(&output);
    assert!(files(first_run()) == before, "the first run was changed");
    assert_eq!(summary["scale"], "metric");
    let sessions = summary["sessions"].as_array().unwrap();
    assert_eq!(sessions.len(), 2);
    let new_from = sessions[1]["first_keyframe"].as_u64().unwrap();
    assert!(
        summary["keyframes"].as_u64().unwrap() > new_from,
        "{summary}"
    );
    assert!(summary["relocalisations"].as_u64().unwrap() >= 1);
    // both sessions lie in one frame, at one scale
    let mut all = poses(&second.join("trajectory_earlier.txt"));
    let overlap = 60 * 1_000_000_000 / 30;
    all.retain(|pose| pose.0 < overlap);
    all.extend(poses(&second.join("trajectory.txt")));
    assert!(all.len() > 145, "{}", all.len());
    let truth = poses(&small_sequence().join("groundtruth.txt"));
    let report = evaluate_trajectory(&all, &truth, &TrajectoryConfig::default()).unwrap();
    assert!(
        report.ate_rmse < 0.01 * report.path_length,
        "{}",
        report.ate_rmse
    );
    assert!((report.scale - 1.0).abs() < 0.03, "{}", report.scale);
    // the recording of the second holds everything: its map is built from it alone
    let again = second.join("again.ot");
    let recording = second.join("recording.mgk");
    let output = monogrid(["map", text(&recording), "--out", text(&again)]);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let global = fs::read(second.join("global.ot")).unwrap();
    assert!(global == fs::read(again).unwrap());
    assert!(global.len() > fs::read(first_run().join("global.ot")).unwrap().len());
    // and a third goes on with the second
    let third = dir.path().join("third");
    let go_on = |out: &Path, threads: &str| {
        let more = ["--continue", text(&second), "--start", "120"];
        let more = [&more[..], &["--threads", threads]].concat();
        run(small_sequence(), out, &more)
    };
    let output = go_on(&third, "1");
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    assert_eq!(json(&output)["sessions"].as_array().unwrap().len(), 3);
    let earlier = fs::read_to_string(third.join("trajectory_earlier.txt")).unwrap();
    assert_eq!(
        earlier
            .lines()
            .filter(|l| l.starts_with("# session"))
            .count(),
        2
    );
    // the same bytes for another number of threads
    let fourth = dir.path().join("fourth");
    assert_eq!(code(&go_on(&fourth, "3")), 0);
    for name in ["trajectory.txt", "recording.mgk", "global.ot", "graph.g2o"] {
        let read = |folder: &Path| fs::read(folder.join(name)).unwrap();
        assert!(read(&third) == read(&fourth), "{name} differs");
    }
}

#[test]
fn localising_gives_poses_in_the_frame_of_the_map_and_no_map() {
    let dir = tempfile::tempdir().unwrap();
    let before = files(first_run());
    let out = dir.path().join("here");
    let more = [
        "--continue",
        text(first_run()),
        "--localise-only",
        "--start",
        "20",
        "--max-frames",
        "60",
    ];
    let output = run(small_sequence(), &out, &more);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    assert!(files(first_run()) == before, "the map was changed");
    let summary = json(&output);
    assert_eq!(summary["localise_only"], true);
    let said = stderr(&output);
    assert!(
        said.contains("stays as it is") && !said.contains("leaves"),
        "{said}"
    );
    for name in [
        "recording.mgk",
        "global.ot",
        "keyframes",
        "graph.g2o",
        "map.pgm",
    ] {
        assert!(!out.join(name).exists(), "{name}");
    }
    assert!(
        fs::read_to_string(out.join("frames.csv"))
            .unwrap()
            .contains("relocalised")
    );
    // the same frames were mapped: they have about the same poses, without any alignment
    let mapped = poses(&first_run().join("trajectory.txt"));
    let localised = poses(&out.join("trajectory.txt"));
    assert!(localised.len() > 55, "{}", localised.len());
    for (time, pose) in &localised {
        let (_, then) = mapped.iter().find(|(t, _)| t == time).unwrap();
        let difference = then.inverse() * *pose;
        assert!(
            difference.translation.norm() < 0.02,
            "{time}: {difference:?}"
        );
        assert!(difference.rotation.angle() < 0.01, "{time}: {difference:?}");
    }
}

#[test]
fn a_camera_elsewhere_is_said_to_be() {
    let dir = tempfile::tempdir().unwrap();
    let source = dir.path().join("noise");
    fs::create_dir_all(&source).unwrap();
    fs::copy(
        small_sequence().join("calibration.txt"),
        source.join("calibration.txt"),
    )
    .unwrap();
    for k in 0..12u32 {
        let image = Image::from_fn(320, 240, |x, y| {
            ((x as u32 / 3 * 7919 + y as u32 / 3 * 104_729 + k * 31) % 251) as u8
        });
        fs::write(source.join(format!("{k:03}.png")), encode_png(&image)).unwrap();
    }
    for more in [&["--localise-only"][..], &[]] {
        let out = dir.path().join("out");
        let mut args = vec!["--continue", text(first_run())];
        args.extend(more);
        let output = run(&source, &out, &args);
        assert_eq!(code(&output), 3, "{}", stderr(&output));
        assert!(
            stderr(&output).contains("never recognised"),
            "{}",
            stderr(&output)
        );
        assert_eq!(json(&output)["status"], "not_recognised");
        let trajectory = fs::read_to_string(out.join("trajectory.txt")).unwrap();
        assert!(trajectory.lines().all(|line| line.starts_with('#')));
        assert_eq!(out.join("global.ot").exists(), more.is_empty());
    }
}

/// A folder with the first images of the small sequence, and then what it looks like in a mirror:
/// another place.
fn cut_sequence(to: &Path, first: usize, mirrored: usize) {
    let dataset = Dataset::open(small_sequence(), SourceOptions::default()).unwrap();
    fs::create_dir_all(to).unwrap();
    let calibration = "calibration.txt";
    fs::copy(small_sequence().join(calibration), to.join(calibration)).unwrap();
    for k in 0..first + mirrored {
        let shown = if k < first { k } else { k - first + 20 };
        let image = read_gray(&dataset.frames[shown].path).unwrap();
        let width = image.width();
        let image = Image::from_fn(width, image.height(), |x, y| {
            image.at(if k < first { x } else { width - 1 - x }, y) as u8
        });
        fs::write(to.join(format!("{k:03}.png")), encode_png(&image)).unwrap();
    }
}

#[test]
fn a_fragment_is_kept_apart_and_goes_on_in_a_later_session() {
    let dir = tempfile::tempdir().unwrap();
    let (source, out) = (dir.path().join("cut"), dir.path().join("out"));
    cut_sequence(&source, 45, 95);
    // the first map stays the map, however large the fragment becomes
    let stays = ["--set", "slam.fragments.min_times_larger=inf"];
    let output = run(&source, &out, &stays);
    assert_eq!(code(&output), 3, "{}", stderr(&output));
    assert!(stderr(&output).contains("fragment"), "{}", stderr(&output));
    let summary = json(&output);
    assert_eq!(summary["status"], "fragment");
    let fragment = &summary["fragments"][0];
    assert_eq!(
        (&fragment["id"], &fragment["joined_into"]),
        (&1.into(), &serde_json::Value::Null)
    );
    // the map and its files hold the first part alone
    let main = poses(&out.join("trajectory.txt"));
    let apart = poses(&out.join("trajectory_fragment_1.txt"));
    assert_eq!(summary["tracked"], main.len());
    assert_eq!(fragment["frames"], apart.len());
    assert!((40..=45).contains(&main.len()) && apart.len() > 30);
    assert!(main.iter().all(|(time, _)| *time < apart[0].0));
    let rows = fs::read_to_string(out.join("frames.csv")).unwrap();
    assert!(rows.contains("fragment_started:1"));
    assert!(rows.lines().last().unwrap().ends_with(",1,"), "{rows}");
    let lines = |name: &str| fs::read_to_string(out.join(name)).unwrap().lines().count();
    let first_keyframe = fragment["first_keyframe"].as_u64().unwrap() as usize;
    assert_eq!(lines("keyframes.txt"), 1 + first_keyframe);
    // a map from the recording too
    let again = dir.path().join("again.ot");
    let recording = out.join("recording.mgk");
    let output = monogrid(["map", text(&recording), "--out", text(&again)]);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    assert!(fs::read(again).unwrap() == fs::read(out.join("global.ot")).unwrap());
    // a later session recognises the fragment, and still has no place in the map
    let (later, second) = (dir.path().join("later"), dir.path().join("second"));
    cut_sequence(&later, 0, 80);
    let output = run(&later, &second, &["--continue", text(&out)]);
    assert_eq!(code(&output), 3, "{}", stderr(&output));
    let summary = json(&output);
    assert_eq!(summary["status"], "not_recognised");
    assert_eq!(summary["fragments"].as_array().unwrap().len(), 1);
    assert!(
        fs::read(second.join("global.ot")).unwrap() == fs::read(out.join("global.ot")).unwrap()
    );
    assert!(poses(&second.join("trajectory_fragment_1.txt")).len() > 50);
    let earlier = fs::read_to_string(second.join("trajectory_earlier.txt")).unwrap();
    let earlier = earlier.lines().filter(|line| !line.starts_with('#'));
    assert_eq!(earlier.count(), main.len());
}

#[test]
fn the_larger_part_is_the_map_and_a_later_session_goes_on_in_it() {
    let dir = tempfile::tempdir().unwrap();
    let (source, out) = (dir.path().join("cut"), dir.path().join("out"));
    cut_sequence(&source, 45, 95);
    let output = run(&source, &out, &[]);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    assert!(
        stderr(&output).contains("trajectory_fragment_1.txt"),
        "{}",
        stderr(&output)
    );
    let summary = json(&output);
    assert_eq!(summary["status"], "done");
    assert_eq!(summary["map_was_fragment"], 1);
    let main = poses(&out.join("trajectory.txt"));
    let first = poses(&out.join("trajectory_fragment_1.txt"));
    assert_eq!(summary["tracked"], main.len());
    assert_eq!(summary["fragments"][0]["frames"], first.len());
    assert!(main.len() > first.len() && first.iter().all(|(time, _)| *time < main[0].0));
    // as known at the time: in the world of what is the map now
    let live = poses(&out.join("trajectory_live.txt"));
    assert!(!live.is_empty() && live.len() <= main.len());
    assert!(live.iter().all(|(time, _)| *time >= main[0].0));
    // the recording knows it
    let again = dir.path().join("again.ot");
    let recording = out.join("recording.mgk");
    let output = monogrid(["map", text(&recording), "--out", text(&again)]);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    assert!(fs::read(again).unwrap() == fs::read(out.join("global.ot")).unwrap());
    let (later, second) = (dir.path().join("later"), dir.path().join("second"));
    cut_sequence(&later, 0, 40);
    let output = run(&later, &second, &["--continue", text(&out)]);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    assert!(poses(&second.join("trajectory.txt")).len() > 30);
}

#[test]
fn wrong_arguments_and_broken_maps_are_explained() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    let source = small_sequence();
    let map = text(first_run());
    assert_fails(&run(source, &out, &["--localise-only"]), 2, &["--continue"]);
    let missing = dir.path().join("nowhere");
    let output = run(source, &out, &["--continue", text(&missing)]);
    assert_fails(&output, 2, &["nowhere", "recording.mgk"]);
    let output = run(
        source,
        &out,
        &["--continue", map, "--seed-depth", "dataset"],
    );
    assert_fails(&output, 2, &["--seed-depth"]);
    let output = run(source, first_run(), &["--continue", map]);
    assert_fails(&output, 2, &["the run to continue", "choose another"]);
    let output = run(source, &out, &["--continue", map, "--size", "160x120"]);
    assert_fails(&output, 2, &["320x240", "160x120"]);
    let more = [
        "--continue",
        map,
        "--set",
        "slam.graph.places.enabled=false",
    ];
    assert_fails(&run(source, &out, &more), 2, &["graph.places.enabled"]);
    assert!(first_run().join("recording.mgk").exists());
    // not a recording; one whose keyframes are gone; one that was cut off
    let broken = dir.path().join("broken");
    fs::create_dir_all(&broken).unwrap();
    let file = broken.join("recording.mgk");
    let whole = fs::read(first_run().join("recording.mgk")).unwrap();
    fs::write(&file, b"something else").unwrap();
    let output = run(source, &out, &["--continue", text(&broken)]);
    assert_fails(&output, 2, &["recording.mgk"]);
    let second = find_record(&whole, 1);
    fs::write(&file, &whole[..second]).unwrap();
    let output = run(source, &out, &["--continue", text(&broken)]);
    assert_fails(&output, 2, &["no keyframes"]);
    let mut damaged = whole.clone();
    damaged[second + 300] ^= 0xff;
    fs::write(&file, &damaged).unwrap();
    let output = run(source, &out, &["--continue", text(&broken)]);
    assert_fails(&output, 2, &["keyframe 0 is missing"]);
    fs::write(&file, &whole[..whole.len() * 3 / 5]).unwrap();
    let more = ["--continue", text(&broken), "--max-frames", "20"];
    let output = run(source, &out, &more);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    assert!(
        stderr(&output).contains("only keyframes and poses"),
        "{}",
        stderr(&output)
    );
}

/// Where the n-th record begins.
fn find_record(bytes: &[u8], n: usize) -> usize {
    let starts = bytes.windows(4).enumerate().filter(|(_, w)| w == b"RMGK");
    starts.map(|(at, _)| at).nth(n).unwrap()
}
