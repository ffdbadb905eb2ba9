//! Whole runs on a short video of the built-in room: files, determinism, crashes.
#![allow(clippy::too_many_lines, reason = "a test tells its story in one place")]

use crate::common::{
    WITHOUT_DENSE_DEPTH, assert_fails, code, copy_of_small_sequence, files, json, monogrid,
    program, room, small_sequence, stderr, write_images,
};
use monogrid_bags::Bag;
use monogrid_datasets::{
    Calibration, ReadOptions, Recording, TimedPose, decode_jpeg_rgb, encode_png_rgb, read_gray,
    read_sim3, read_trajectory,
};
use monogrid_geometry::Vec3;
use monogrid_image::Image;
use monogrid_occupancy::{Occupancy, read_ot};
use monogrid_worlds::{
    EffectsConfig, ImuConfig, SynthConfig, WriteConfig, write_sequence_imu, write_tum_layout,
};
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
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
fn a_run_writes_everything_and_the_same_bytes_for_any_number_of_threads_and_any_memory() {
    let dir = tempfile::tempdir().unwrap();
    let first = dir.path().join("one");
    let output = run(small_sequence(), &first, &["--threads", "1", "--json"]);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let summary = json(&output);
    assert_eq!(summary["frames"], crate::common::SMALL_FRAMES);
    assert!(summary["tracked"].as_u64().unwrap() as usize > crate::common::SMALL_FRAMES * 9 / 10);
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
        "cells.ply",
        "cloud.ply",
        "mesh.ply",
        "mesh.glb",
        "map.pgm",
        "map.yaml",
        "plan.png",
        "plan.dxf",
        "plan.svg",
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
    let little = ["--threads", "3", "--memory-limit", "20MB"];
    let output = run(small_sequence(), &second, &little);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    the_limit_is_too_small(&second);
    let (a, b) = (files(&first), files(&second));
    let names = |files: &[(String, Vec<u8>)]| files.iter().map(|f| f.0.clone()).collect::<Vec<_>>();
    assert_eq!(names(&a), names(&b));
    for ((name, left), (_, right)) in a.iter().zip(&b) {
        assert!(holds_time(name) || left == right, "{name} differs");
    }
    the_map_command_reproduces_the_global_map(&first);
    what_is_up_is_said_and_found_again(&first, &summary);
    the_results_can_be_evaluated(&first);
    the_report_can_be_explored_without_a_network(&first);
}

/// Keyframes lie in the file, and the run says that the rest takes more than the limit.
fn the_limit_is_too_small(run: &Path) {
    let summary = fs::read_to_string(run.join("summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&summary).unwrap();
    assert!(summary["memory_bytes"]["in_file"].as_u64() > Some(0));
    let warnings = summary["warnings"].as_array().unwrap();
    let is_said = |w: &serde_json::Value| w.as_str().unwrap().contains("more than the 20 MB");
    assert!(warnings.iter().any(is_said), "{warnings:?}");
}

/// Text between a mark and the next `</script>`.
fn block<'a>(html: &'a str, mark: &str) -> &'a str {
    let begin = html.find(mark).expect(mark) + mark.len();
    html[begin..].split("</script>").next().unwrap()
}

/// Bytes of a block in base64, by the number of its characters.
fn block_bytes(block: &serde_json::Value) -> usize {
    let text = block.as_str().unwrap();
    let is_base64 = |b: u8| b.is_ascii_alphanumeric() || b"+/=".contains(&b);
    assert!(text.bytes().all(is_base64));
    text.len() / 4 * 3 - text.bytes().filter(|b| *b == b'=').count()
}

fn the_report_can_be_explored_without_a_network(run: &Path) {
    let html = fs::read_to_string(run.join("report.html")).unwrap();
    assert!(html.len() < 20_000_000, "{} bytes", html.len());
    let licence = block(&html, "id=\"licence-of-three\">");
    assert!(licence.contains("three.js authors"));
    let others = html.replace(licence, "");
    assert!(!others.contains("http://") && !others.contains("https://"));
    assert!(
        html.contains("content=\"default-src 'none';"),
        "nothing may be loaded"
    );
    for attribute in html.split(" src=\"").skip(1) {
        assert!(attribute.starts_with("data:"), "{}", &attribute[..40]);
    }
    let modules: serde_json::Value =
        serde_json::from_str(block(&html, "<script type=\"importmap\">")).unwrap();
    let modules = modules["imports"].as_object().unwrap().values();
    assert!(modules.into_iter().all(|url| {
        let url = url.as_str().unwrap();
        url.starts_with("data:text/javascript;base64,")
    }));
    let scene: serde_json::Value = serde_json::from_str(block(&html, "id=\"scene\">")).unwrap();
    let count = |value: &serde_json::Value| value.as_u64().unwrap() as usize;
    for (name, cubes) in ["occupied", "free"]
        .iter()
        .zip(scene["cells"]["count"].as_array().unwrap())
    {
        assert!(count(cubes) > 100, "{name}");
        assert_eq!(block_bytes(&scene["cells"][name]), 8 * count(cubes));
    }
    let points = count(&scene["cloud"]["count"][0]);
    assert!(points > 1000 && points <= 500_000, "{points}");
    assert_eq!(block_bytes(&scene["cloud"]["points"]), 8 * points);
    let keyframes = scene["keyframes"].as_array().unwrap();
    let of_keyframes = keyframes
        .iter()
        .map(|keyframe| count(&keyframe["points"][1]));
    assert_eq!(of_keyframes.sum::<usize>(), points);
    assert!(
        keyframes
            .iter()
            .all(|keyframe| block_bytes(&keyframe["image"]) > 1000)
    );
    let frames = &scene["frames"];
    for column in ["index", "time", "state", "good", "milliseconds", "keyframe"] {
        assert_eq!(
            frames[column].as_array().unwrap().len(),
            crate::common::SMALL_FRAMES,
            "{column}"
        );
    }
    let poses = fs::read_to_string(run.join("trajectory.txt")).unwrap();
    let poses = poses.lines().filter(|line| !line.starts_with('#')).count();
    assert_eq!(scene["path"].as_array().unwrap().len(), poses);
}

fn what_is_up_is_said_and_found_again(run: &Path, summary: &serde_json::Value) {
    // the room is level in its own frame, which knows how the camera was held in it
    assert_eq!(summary["up"]["from"], "scene", "{summary}");
    assert!(summary["up"]["confidence"].as_f64().unwrap() > 0.2);
    let frame = read_sim3(&run.join("map_from_world.txt")).unwrap();
    let truth = read_trajectory(&small_sequence().join("groundtruth.txt")).unwrap();
    let up_in_world = truth[0].world_from_camera.rotation.inverse() * Vec3::z();
    let off_deg = (frame.rotation * up_in_world)
        .angle(&Vec3::z())
        .to_degrees();
    assert!(off_deg < 2.0, "{off_deg} degrees");
    // without the results beside it, the recording leads to the same frame and map
    let elsewhere = tempfile::tempdir().unwrap();
    let recording = elsewhere.path().join("recording.mgk");
    fs::copy(run.join("recording.mgk"), &recording).unwrap();
    let map = elsewhere.path().join("again.ot");
    let output = monogrid([Path::new("map"), &recording, Path::new("--out"), &map]);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    assert!(fs::read(map).unwrap() == fs::read(run.join("global.ot")).unwrap());
    // where the camera was is free
    let map = read_ot(&fs::read(run.join("global.ot")).unwrap()[..], 1 << 30).unwrap();
    let poses = read_trajectory(&run.join("trajectory.txt")).unwrap();
    let is_free =
        |pose: &TimedPose| map.state(pose.world_from_camera.translation.into()) == Occupancy::Free;
    assert!(poses.iter().all(is_free));
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
        fs::read(run.join("cells.ply")).unwrap()
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
fn what_nobody_told_of_the_camera_is_found() {
    let dir = tempfile::tempdir().unwrap();
    let file = |name: &str| dir.path().join(name);
    let pinhole = "251 251 159.5 119.5 320 240";
    fs::write(file("pinhole.txt"), pinhole).unwrap();
    fs::write(file("lens.txt"), "251 251 159.5 119.5 0.03 0 0 0 320 240").unwrap();
    // the lens of the world, its rolling shutter, and what is found although the calibration says a
    // pinhole
    for (lens, readout_ms, found) in [
        ("pinhole.txt", 25.0, "rolling shutter"),
        ("lens.txt", 0.0, "radial distortion"),
    ] {
        let config = SynthConfig {
            camera: Calibration::read(&file(lens), None).unwrap().camera,
            frames: 300,
            effects: EffectsConfig {
                readout_secs: readout_ms / 1e3,
                ..EffectsConfig::demo()
            },
            ..SynthConfig::small()
        };
        write_images(&room(config).shortened(110), &file("world"));
        fs::write(file("world").join("calibration.txt"), pinhole).unwrap();
        let run = [
            "run".into(),
            file("world"),
            "--json".into(),
            "--sensor-model".into(),
            "none".into(),
            "--force".into(),
            "--out".into(),
            file("out"),
        ];
        let output = monogrid(
            run.into_iter()
                .chain(WITHOUT_DENSE_DEPTH.map(PathBuf::from)),
        );
        assert_eq!(code(&output), 0, "{}", stderr(&output));
        let summary = json(&output);
        let found_ms = summary["rolling_shutter_ms"].as_f64().unwrap();
        assert!((found_ms - readout_ms).abs() < 4.0, "{found_ms}");
        let warnings = summary["warnings"].to_string();
        for word in ["rolling shutter", "radial distortion"] {
            assert_eq!(warnings.contains(word), word == found, "{warnings}");
        }
        if let Some(radial) = warnings.split("radial distortion of +").nth(1) {
            let radial: f64 = radial.split(' ').next().unwrap().parse().unwrap();
            assert!((radial - 0.03).abs() < 0.006, "{radial}");
        }
    }
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
fn images_have_as_many_pixels_as_is_asked_for() {
    let dir = tempfile::tempdir().unwrap();
    let few = dir.path().join("few");
    let settings = ["--profile", "fast", "--set", "working_pixels=19200"];
    let output = run(
        small_sequence(),
        &few,
        &[&settings[..], &["--json"]].concat(),
    );
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let summary = json(&output);
    assert_eq!(summary["profile"], "fast");
    assert_eq!(summary["working_size"], serde_json::json!([160, 120]));
    assert!(summary["points"].as_u64().unwrap() > 100, "{summary}");
    // the same settings from a file; an option wins
    let config = few.join("config.toml");
    let again = dir.path().join("again");
    let options = ["--config", config.to_str().unwrap(), "--size", "240x180"];
    let output = run(
        small_sequence(),
        &again,
        &[&options[..], &["--json"]].concat(),
    );
    let summary = json(&output);
    assert_eq!(summary["profile"], "fast");
    assert_eq!(summary["working_size"], serde_json::json!([240, 180]));
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
    assert!(summary["tracked"].as_u64().unwrap() as usize > crate::common::SMALL_FRAMES * 8 / 10);
}

/// Mesh and cells of a run are in colour, in files and on the page, and `map` makes the same mesh.
fn the_surface_is_coloured(out: &Path, mesh: &serde_json::Value) {
    let [vertices, triangles] = [0, 1].map(|k| mesh["count"][k].as_u64().unwrap() as usize);
    assert!(triangles > 100, "{triangles}");
    assert_eq!(block_bytes(&mesh["colours"]), 3 * vertices);
    assert_eq!(block_bytes(&mesh["triangles"]), 12 * triangles);
    // a block of pixels for each face, in the page and for other programs
    let number = |value: &serde_json::Value| value.as_u64().unwrap() as usize;
    let texture = &mesh["texture"];
    let blocks = [0, 1].map(|k| number(&texture["size"][k]) / number(&texture["block"]));
    assert!(blocks[0] * blocks[1] >= triangles / 2, "{blocks:?}");
    assert!(block_bytes(&texture["image"]) > triangles);
    let glb = fs::read(out.join("mesh.glb")).unwrap();
    let description = String::from_utf8_lossy(&glb[..3000]);
    for part in ["TEXCOORD_0", "image/jpeg", "KHR_materials_unlit"] {
        assert!(description.contains(part), "{part}");
    }
    let cells = fs::read(out.join("cells.ply")).unwrap();
    assert!(String::from_utf8_lossy(&cells[..300]).contains("property uchar blue"));
    let dir = tempfile::tempdir().unwrap();
    let alone = dir.path().join("alone.ply");
    let recording = out.join("recording.mgk");
    let (map, file) = (dir.path().join("again.ot"), alone.as_os_str());
    let output = monogrid([
        "map".as_ref(),
        recording.as_os_str(),
        "--out".as_ref(),
        map.as_os_str(),
        "--mesh".as_ref(),
        file,
    ]);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    assert!(fs::read(&alone).unwrap() == fs::read(out.join("mesh.ply")).unwrap());
}

/// A few images of the small sequence, tinted.
fn colour_sequence(to: &Path) {
    copy_of_small_sequence(to);
    for entry in fs::read_dir(to.join("rgb")).unwrap() {
        let path = entry.unwrap().path();
        let tinted = read_gray(&path).unwrap().map(|grey| {
            let grey = grey as u8;
            [grey.saturating_add(30), grey, grey.saturating_sub(60)]
        });
        fs::write(&path, encode_png_rgb(&tinted)).unwrap();
    }
}

/// Images, calibration and times in the file of messages are those of the run's keyframes.
fn what_is_played_is_the_run(mcap: &Path, run: &Path) {
    let bag = Bag::open(mcap).unwrap();
    let topics: Vec<&str> = bag
        .topics()
        .iter()
        .map(|topic| topic.name.as_str())
        .collect();
    for name in ["/tf", "/path", "/map/cells", "/map/grid", "/points"] {
        assert!(topics.contains(&name), "{name} {topics:?}");
    }
    let recording = run.join("recording.mgk");
    let recorded = Recording::read(&recording, ReadOptions::default()).unwrap();
    let topic = bag.image_topic(None).unwrap();
    let camera = bag.camera_of(topic).unwrap().unwrap();
    assert_eq!(camera.pinhole, recorded.session.pinhole);
    let images = bag.images(topic);
    let times: Vec<i64> = images.map(|image| image.unwrap().0).collect();
    let mut expected: Vec<i64> = recorded.keyframes.iter().map(|k| k.timestamp_ns).collect();
    expected.sort_unstable();
    assert!(times.len() > 1 && times == expected, "{times:?}");
}

#[test]
fn colour_of_the_source_is_kept_and_shown() {
    let dir = tempfile::tempdir().unwrap();
    let source = dir.path().join("source");
    colour_sequence(&source);
    let out = dir.path().join("out");
    let run = |out: &Path, more: &[&str]| {
        let args = [
            "run".as_ref(),
            source.as_os_str(),
            "--out".as_ref(),
            out.as_os_str(),
        ];
        let output = monogrid(args.into_iter().chain(more.iter().map(AsRef::as_ref)));
        assert_eq!(code(&output), 0, "{}", stderr(&output));
    };
    // depth and map are not looked at
    let quick = [
        "--resolution",
        "0.1",
        "--set",
        "mapping.mesh.min_faces=0",
        "--set",
        "mapping.quality=raw",
        "--set",
        "mapping.fill.enabled=false",
    ];
    let mcap = dir.path().join("run.mcap");
    let played = ["--max-frames", "70", "--mcap", mcap.to_str().unwrap()];
    run(&out, &[&played, &quick[..]].concat());
    what_is_played_is_the_run(&mcap, &out);
    let recording = out.join("recording.mgk");
    let recorded = Recording::read(&recording, ReadOptions::default()).unwrap();
    for keyframe in &recorded.keyframes {
        let jpeg = keyframe.colour.as_ref().expect("every keyframe has colour");
        let colour = decode_jpeg_rgb(jpeg, 1 << 20, &recording).unwrap().unwrap();
        let grey = keyframe.image.as_ref().unwrap();
        assert!((colour.width(), colour.height()) == (grey.width(), grey.height()));
        let [red, _, blue] = colour.at(160, 120);
        assert!(red > blue + 50, "{red} {blue}");
    }
    let cloud = fs::read(out.join("cloud.ply")).unwrap();
    let begin = cloud
        .windows(11)
        .position(|w| w == b"end_header\n")
        .unwrap()
        + 11;
    let rows = cloud[begin..].chunks_exact(19);
    assert!(rows.len() > 1000);
    let warm = rows
        .clone()
        .filter(|row| row[12] > row[14].saturating_add(30))
        .count();
    assert!(warm > rows.len() * 8 / 10, "{warm} of {}", rows.len());
    let html = fs::read_to_string(out.join("report.html")).unwrap();
    let scene: serde_json::Value = serde_json::from_str(block(&html, "id=\"scene\">")).unwrap();
    let points = scene["cloud"]["count"][0].as_u64().unwrap() as usize;
    assert_eq!(block_bytes(&scene["cloud"]["colours"]), 3 * points);
    the_surface_is_coloured(&out, &scene["mesh"]);
    let cells = scene["cells"]["count"][0].as_u64().unwrap() as usize;
    let colours = block_bytes(&scene["cells"]["colours"]);
    assert_eq!(colours, 3 * cells);
    // a run that goes on, and the same run in metres, have the colours still
    let (later, metric) = (dir.path().join("later"), dir.path().join("metric"));
    let earlier = out.display().to_string();
    let goes_on = ["--max-frames", "8", "--continue", &earlier];
    run(&later, &[&goes_on, &quick[..]].concat());
    let output = monogrid([
        "rescale".as_ref(),
        out.as_os_str(),
        "--scale-from".as_ref(),
        "factor=2".as_ref(),
        "--out".as_ref(),
        metric.as_os_str(),
    ]);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let colours = |folder: &Path| -> Vec<_> {
        let recording = folder.join("recording.mgk");
        let recorded = Recording::read(&recording, ReadOptions::default()).unwrap();
        let keyframes = recorded.keyframes.into_iter();
        keyframes.map(|k| k.colour.expect("colour")).collect()
    };
    let first = colours(&out);
    assert_eq!(first, colours(&metric));
    // a pipe in place of a table would be waited for
    for name in ["trajectory.txt", "summary.json"] {
        let (path, aside) = (out.join(name), out.join("aside"));
        fs::rename(&path, &aside).unwrap();
        assert!(
            Command::new("mkfifo")
                .arg(&path)
                .status()
                .unwrap()
                .success()
        );
        let again = dir.path().join("again").display().to_string();
        let output = monogrid([
            "rescale",
            &earlier,
            "--scale-from",
            "factor=2",
            "--out",
            &again,
        ]);
        assert_fails(&output, 2, &[name, "pipe"]);
        fs::rename(&aside, &path).unwrap();
    }
    // the report is written again, in metres
    let html = fs::read_to_string(metric.join("report.html")).unwrap();
    let again: serde_json::Value = serde_json::from_str(block(&html, "id=\"scene\">")).unwrap();
    assert_eq!(again["unit"], "m");
    let side = |scene: &serde_json::Value| scene["plan"]["size"][0].as_f64().unwrap();
    let times = side(&again) / side(&scene);
    assert!((1.8..2.2).contains(&times), "{times}");
    let corners = |scene: &serde_json::Value| block_bytes(&scene["mesh"]["colours"]);
    assert!(
        corners(&again) > corners(&scene) / 2,
        "the surface is as fine"
    );
    assert_eq!(first, colours(&later)[..first.len()]);
}

#[test]
fn a_depth_camera_is_used_with_every_frame_that_has_a_depth_image_that_can_be_read() {
    let dir = tempfile::tempdir().unwrap();
    let source = dir.path().join("room");
    copy_of_small_sequence(&source);
    let list = fs::read_to_string(source.join("depth.txt")).unwrap();
    let images: Vec<&str> = list
        .lines()
        .filter(|line| !line.starts_with('#'))
        .filter_map(|line| line.split_whitespace().nth(1))
        .collect();
    assert!(images.len() > 3, "{list}");
    fs::write(source.join(images[2]), b"no image").unwrap();
    let run = |out: &str, threads: &str| {
        let out = dir.path().join(out);
        let words = [
            "run".as_ref(),
            source.as_os_str(),
            "--out".as_ref(),
            out.as_os_str(),
        ];
        let more = ["--depth", "dataset", "--threads", threads, "--json"];
        let output = program().args(words).args(more).output().unwrap();
        assert_eq!(code(&output), 0, "{}", stderr(&output));
        (out, output)
    };
    let (one, output) = run("one", "1");
    let said = stderr(&output);
    assert!(
        said.contains(&format!(
            "{} of the frames have a depth image",
            images.len()
        )),
        "{said}"
    );
    assert_eq!(said.matches("the depth of frame").count(), 1, "{said}");
    let summary = json(&output);
    assert_eq!(summary["scale"], "metric");
    let count = |key: &str| summary[key].as_u64().unwrap();
    assert!(count("measured_keyframes") >= 2, "{summary}");
    assert!(count("measured_keyframes") <= count("keyframes"));
    let (two, _) = run("two", "2");
    for name in ["trajectory.txt", "recording.mgk", "global.ot"] {
        let [a, b] = [&one, &two].map(|out| fs::read(out.join(name)).unwrap());
        assert!(a == b, "{name}");
    }
}

/// Writes 60 frames of the small room with the images of two cameras.
fn write_stereo_pair(folder: &Path) {
    fs::create_dir(folder).unwrap();
    let sequence = room(SynthConfig::small()).shortened(60);
    let config = WriteConfig {
        depth_every: 0,
        with_mesh: false,
        baseline_m: 0.15,
    };
    write_tum_layout(&sequence, folder, &config, |_| {}).unwrap();
}

#[test]
fn a_stereo_pair_starts_with_the_first_frame_and_gives_metres() {
    let dir = tempfile::tempdir().unwrap();
    let source = dir.path().join("room");
    write_stereo_pair(&source);
    let check = monogrid(["check".into(), source.display().to_string()]);
    let said = String::from_utf8_lossy(&check.stdout).into_owned();
    assert!(
        said.contains("60 of the frames have a second image"),
        "{said}"
    );
    let run = |out: &str, threads: &str| {
        let out = dir.path().join(out);
        let paths = [
            "run".as_ref(),
            source.as_os_str(),
            "--out".as_ref(),
            out.as_os_str(),
        ];
        let more = ["--stereo", "--threads", threads, "--json"];
        let output = program().args(paths).args(more).output().unwrap();
        (out, output)
    };
    let (one, output) = run("one", "1");
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let summary = json(&output);
    assert_eq!(
        (summary["scale"].as_str(), summary["tracked"].as_u64()),
        (Some("metric"), Some(60))
    );
    assert_eq!(
        summary["measured_keyframes"], summary["keyframes"],
        "{summary}"
    );
    // the way between two frames, in metres
    let [found, truth] = [one.join("trajectory.txt"), source.join("groundtruth.txt")].map(|path| {
        let poses = read_trajectory(&path).unwrap();
        assert_eq!(poses.len(), 60);
        let place = |k: usize| poses[k].world_from_camera.translation;
        (place(59) - place(0)).norm()
    });
    assert!((found / truth - 1.0).abs() < 0.03, "{found} of {truth} m");
    let (two, _) = run("two", "2");
    for name in ["trajectory.txt", "recording.mgk", "global.ot"] {
        let [a, b] = [&one, &two].map(|out| fs::read(out.join(name)).unwrap());
        assert!(a == b, "{name}");
    }
    // one that cannot be used ends the run at once
    fs::write(source.join("image_1/000000.png"), b"no image").unwrap();
    assert_fails(&run("none", "1").1, 2, &["000000.png"]);
    fs::remove_dir_all(source.join("image_1")).unwrap();
    assert_fails(&run("none", "1").1, 2, &["second image", "cam0 and cam1"]);
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
    wait_for_keyframes(&mut child, out);
    child
}

/// Waits until the recording of a run is a few keyframes long.
fn wait_for_keyframes(child: &mut std::process::Child, out: &Path) {
    let begin = Instant::now();
    while !out.join("keyframes/00001_uncertainty.png").exists() {
        assert!(child.try_wait().unwrap().is_none(), "the run ended early");
        assert!(
            begin.elapsed() < Duration::from_secs(60),
            "no second keyframe"
        );
        std::thread::sleep(Duration::from_millis(5));
    }
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
    crate::common::interrupt(&child);
    let status = child.wait().unwrap();
    assert_eq!(status.code(), Some(4), "a state of its own");
    let text = fs::read_to_string(out.join("summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(summary["status"], "interrupted");
    assert!(summary["frames"].as_u64().unwrap() < crate::common::SMALL_FRAMES as u64);
    assert!(out.join("global.ot").exists());
}

#[cfg(unix)]
#[test]
fn an_interrupt_while_depth_is_made_dense_saves_what_there_is() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    let mut command = program();
    command
        .arg("run")
        .arg(small_sequence())
        .arg("--out")
        .arg(&out);
    // large images, of which dense depth takes long
    let large = ["--size", "1280x960", "--max-frames", "40"];
    command.args(["--seed-depth", "dataset", "--threads", "1"]);
    command.args(large);
    command.stdout(Stdio::null()).stderr(Stdio::piped());
    let mut child = command.spawn().unwrap();
    let mut said = BufReader::new(child.stderr.take().unwrap()).lines();
    let begins = said.find(|line| line.as_ref().unwrap().contains("depth and maps of"));
    begins.expect("the end of the run").unwrap();
    crate::common::interrupt(&child);
    let said: Vec<String> = said.map(Result::unwrap).collect();
    assert_eq!(child.wait().unwrap().code(), Some(4), "{said:?}");
    assert!(
        said.last().unwrap().contains("makes one of all"),
        "{said:?}"
    );
    let text = fs::read_to_string(out.join("summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(summary["status"], "interrupted");
    assert_eq!(summary["frames"], 40);
    let path = fs::read_to_string(out.join("trajectory.txt")).unwrap();
    assert!(path.lines().count() > 30, "{path}");
    let map = monogrid([Path::new("info"), &out.join("global.ot")]);
    assert_eq!(code(&map), 0, "{}", stderr(&map));
    // everything in it is known as ours
    let again = run(small_sequence(), &out, &["--max-frames", "20"]);
    assert_ne!(code(&again), 2, "{}", stderr(&again));
}

#[test]
fn an_inertial_sensor_makes_results_metric_and_level() {
    let dir = tempfile::tempdir().unwrap();
    let source = dir.path().join("source");
    copy_of_small_sequence(&source);
    let sequence = room(SynthConfig::small()).shortened(crate::common::SMALL_FRAMES);
    write_sequence_imu(&sequence, &source, &ImuConfig::default()).unwrap();
    let output = monogrid([Path::new("check"), &source, Path::new("--json")]);
    let imu = &json(&output)["imu"];
    assert!(
        (imu["rate_hz"].as_f64().unwrap() - 200.0).abs() < 1.0,
        "{imu}"
    );

    // from nothing: a depth image would say the scale
    let started = |out: &Path, more: &[&str]| {
        let places = [source.as_path(), Path::new("--out"), out];
        program()
            .arg("run")
            .args(places)
            .args(more)
            .arg("--json")
            .output()
            .unwrap()
    };
    let out = dir.path().join("out");
    let output = started(&out, &["--set", "slam.inertial.max_scale_sigma=0.1"]);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let summary = json(&output);
    assert_eq!(
        (&summary["scale"], &summary["up"]["from"]),
        (&"metric".into(), &"imu".into()),
        "{summary}"
    );
    let inertial = &summary["inertial"];
    let number = |value: &serde_json::Value| value.as_f64().unwrap();
    // the reference beside the images says what a unit is
    let error =
        (number(&inertial["metres_per_unit"]) / number(&summary["trajectory"]["scale"])).ln();
    assert!(
        error.abs() < 4.0 * number(&inertial["scale_sigma"]) && error.abs() < 0.1,
        "{error} {inertial}"
    );
    let compared = monogrid([
        "evaluate",
        "trajectory",
        out.join("trajectory.txt").to_str().unwrap(),
        source.join("groundtruth.txt").to_str().unwrap(),
        "--json",
    ]);
    let tilt = number(&json(&compared)["tilt_deg"]);
    assert!(tilt < 1.0, "{tilt}");

    // what is asked for is done
    let plain = dir.path().join("plain");
    let output = started(&plain, &["--imu", "none", "--max-frames", "90"]);
    assert_eq!(json(&output)["scale"], "arbitrary");
    assert!(json(&output)["inertial"].is_null());
}

/// Files of the book, in its order, as its contents list them.
fn chapters() -> Vec<std::path::PathBuf> {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs");
    let contents = fs::read_to_string(docs.join("SUMMARY.md")).unwrap();
    let linked = contents.lines().filter_map(|line| {
        let name = line.split_once("](")?.1.strip_suffix(')')?;
        Some(docs.join(name))
    });
    linked.collect()
}

/// The commands of a chapter.
fn commands_of(chapter: &Path) -> Vec<String> {
    let text = fs::read_to_string(chapter).unwrap();
    let blocks = text.split("```sh\n").skip(1);
    let lines = blocks.flat_map(|block| block.split("```").next().unwrap().lines());
    lines.map(str::to_owned).collect()
}

#[test]
fn every_command_of_the_book_works() {
    let dir = tempfile::tempdir().unwrap();
    copy_of_small_sequence(&dir.path().join("kitchen"));
    write_stereo_pair(&dir.path().join("corridor"));
    let chapters = chapters();
    assert!(chapters.len() >= 9 && chapters.iter().all(|chapter| chapter.is_file()));
    // cameras and streams, which the chapter on filming is about, are not here
    let in_book = chapters
        .iter()
        .filter(|chapter| chapter.parent().unwrap().ends_with("book"));
    let commands: Vec<String> = in_book.flat_map(|chapter| commands_of(chapter)).collect();
    assert!(commands.len() > 15, "{commands:?}");
    for (number, command) in commands.iter().enumerate() {
        if let Some(made) = command.strip_prefix("echo ") {
            let (text, file) = made.split_once(" > ").unwrap();
            fs::write(dir.path().join(file), format!("{text}\n")).unwrap();
            continue;
        }
        let mut words: Vec<String> = command.split_whitespace().map(str::to_owned).collect();
        assert_eq!(words.remove(0), "monogrid", "{command}");
        let has = |option: &str| words.iter().any(|word| word == option);
        match words[0].as_str() {
            // the whole of it takes minutes; another test runs its first frame
            "demo" => words.push("--help".into()),
            "run" => {
                let is_first = words.contains(&"runs/kitchen".to_owned()) && !has("--continue");
                let frames = if is_first { "90" } else { "60" };
                words.extend(["--max-frames".into(), frames.into()]);
                words.extend(WITHOUT_DENSE_DEPTH.map(str::to_owned));
            }
            // three seconds of video show hardly any free space
            "plan" if has("--on-floor") => words.push("--through-unknown".into()),
            // it would serve for ever
            "view" if !has("--png") => words.extend(["--html".into(), format!("{number}.html")]),
            _ => {}
        }
        let output = program()
            .args(&words)
            .current_dir(dir.path())
            .output()
            .unwrap();
        assert_eq!(code(&output), 0, "{command}: {}", stderr(&output));
    }
}

/// A program of this name and content, alone in a folder.
#[cfg(unix)]
fn fake(folder: &Path, script: &str) {
    use std::os::unix::fs::PermissionsExt;
    fs::create_dir_all(folder).unwrap();
    let program = folder.join("monogrid-rerun");
    fs::write(&program, format!("#!/bin/sh\n{script}\n")).unwrap();
    fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
}

#[cfg(unix)]
#[test]
fn rerun_looks_at_a_run_and_one_that_is_slow_gone_or_missing_harms_none() {
    let dir = tempfile::tempdir().unwrap();
    let plain = dir.path().join("plain");
    let short = ["--max-frames", "40", "--resolution", "0.1"];
    assert_eq!(code(&run(small_sequence(), &plain, &short)), 0);
    let view = |path: &Path, name: &str, view: &str| {
        let mut command = program();
        command.env("PATH", path).arg("run").arg(small_sequence());
        command.arg("--out").arg(dir.path().join(name));
        command.args(["--seed-depth", "dataset", view]).args(short);
        command.output().unwrap()
    };
    let nothing = dir.path().join("nothing");
    let missing = view(&nothing, "missing", "--view=rerun");
    assert_fails(&missing, 2, &["cargo install --path extra/monogrid-rerun"]);
    assert!(!dir.path().join("missing").exists(), "before anything else");

    let heard = dir.path().join("heard");
    let says = dir.path().join("says");
    let takes = format!(
        "read line; echo \"$@\" > {0}; echo \"$line\" >> {0}; : > \"$3\"",
        heard.display()
    );
    fake(&says, &takes);
    let file = dir.path().join("a run.rrd");
    let rrd = format!("--view=rrd={}", file.display());
    let output = view(&says, "said", &rrd);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    assert!(!stderr(&output).contains("warning: monogrid-rerun"));
    let heard = fs::read_to_string(heard).unwrap();
    // arguments are seen by every user of the computer
    let expected = format!("- --rrd {}\nhttp://127.0.0.1:", file.display());
    assert!(heard.starts_with(&expected), "{heard}");
    assert!(heard.ends_with("/\n"), "{heard}");
    fs::write(&file, "another").unwrap();
    assert_fails(&view(&says, "twice", &rrd), 2, &["exists"]);

    for (name, script, said) in [
        ("dead", "exit 7", "has not shown the whole run"),
        ("useless", "exit 0", "has not shown the whole run"),
        // a run that waited for it would take minutes, and so would whoever reads what it says
        ("asleep", "exec /bin/sleep 200", "too slow"),
    ] {
        let folder = dir.path().join(name);
        fake(&folder, script);
        let view_as = match name {
            "useless" => format!("--view=rrd={}", dir.path().join("none.rrd").display()),
            _ => "--view=rerun".to_owned(),
        };
        let output = view(&folder, &format!("{name}-run"), &view_as);
        assert_eq!(code(&output), 0, "{}", stderr(&output));
        assert!(stderr(&output).contains(said), "{}", stderr(&output));
        let path = |run: &str| fs::read(dir.path().join(run).join("trajectory.txt")).unwrap();
        assert_eq!(path(&format!("{name}-run")), path("plain"));
    }
}

/// A run that is watched, and the address of its page.
fn watched(out: &Path, more: &[&str]) -> (std::process::Child, String) {
    let mut command = program();
    command
        .arg("run")
        .arg(small_sequence())
        .arg("--out")
        .arg(out);
    command
        .args(["--seed-depth", "dataset", "--view"])
        .args(more);
    command.stdout(Stdio::null()).stderr(Stdio::piped());
    let mut child = command.spawn().unwrap();
    let mut said = BufReader::new(child.stderr.take().unwrap()).lines();
    let url = said.find_map(|line| {
        let line = line.unwrap();
        let rest = &line[line.find("http://127.0.0.1:")?..];
        Some(rest.split_whitespace().next()?.to_owned())
    });
    // a program that cannot say anything fails
    std::thread::spawn(move || said.for_each(drop));
    (child, url.expect("an address"))
}

#[test]
fn clients_that_are_held_open_hold_up_no_run_and_the_address_is_in_no_file() {
    let dir = tempfile::tempdir().unwrap();
    let (plain, seen) = (dir.path().join("plain"), dir.path().join("seen"));
    let short = ["--max-frames", "60", "--resolution", "0.1"];
    let begin = Instant::now();
    assert_eq!(code(&run(small_sequence(), &plain, &short)), 0);
    let time = begin.elapsed();
    let begin = Instant::now();
    let (mut child, url) = watched(&seen, &short);
    let clients = crate::common::hostile_clients(&url);
    assert!(crate::common::get(&url).starts_with(b"HTTP/1.1 200"));
    assert_eq!(child.wait().unwrap().code(), Some(0));
    // other tests take their share of the computer; a client that is waited for is waited for
    // without an end
    assert!(begin.elapsed() < 3 * time + Duration::from_secs(10));
    drop(clients);
    let (plain, seen) = (files(&plain), files(&seen));
    let names = |files: &[(String, Vec<u8>)]| -> Vec<String> {
        files.iter().map(|(name, _)| name.clone()).collect()
    };
    assert_eq!(names(&plain), names(&seen));
    let token = url.trim_end_matches('/').rsplit('/').next().unwrap();
    for ((name, expected), (_, bytes)) in plain.iter().zip(&seen) {
        let has_token = bytes.windows(token.len()).any(|w| w == token.as_bytes());
        assert!(!has_token, "{name} holds the address");
        assert!(holds_time(name) || expected == bytes, "{name} differs");
    }
}

#[cfg(unix)]
#[test]
fn an_interrupt_saves_whatever_clients_do() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    let (mut child, url) = watched(&out, &["--realtime"]);
    let clients = crate::common::hostile_clients(&url);
    wait_for_keyframes(&mut child, &out);
    crate::common::interrupt(&child);
    assert_eq!(child.wait().unwrap().code(), Some(4));
    drop(clients);
    let names: Vec<String> = files(&out).into_iter().map(|(name, _)| name).collect();
    for name in ["trajectory.txt", "global.ot", "summary.json", "report.html"] {
        assert!(
            names.iter().any(|known| known == name),
            "{name} of {names:?}"
        );
    }
}

#[test]
fn a_map_of_no_measurement_is_said_to_be_empty() {
    let dir = tempfile::tempdir().unwrap();
    let (source, out) = (small_sequence().to_str().unwrap(), dir.path().join("run"));
    let mut args = vec!["run", source, "--out", out.to_str().unwrap(), "--json"];
    args.extend(["--seed-depth", "dataset", "--max-frames", "30"]);
    args.extend(["--set", "mapping.quality=raw"]);
    args.extend(["--set", "mapping.filter.max_relative_sigma=0.000001"]);
    let summary = json(&monogrid(args));
    assert_eq!(summary["points"], 0);
    let trust = summary["trust"].as_str().unwrap();
    assert!(trust.contains("none of which is precise enough"), "{trust}");
}

#[test]
fn pages_of_failed_runs_show_what_was_filmed() {
    let dir = tempfile::tempdir().unwrap();
    let page = |name: &str, blank_from: usize, more: &[&str]| {
        let [source, out] = ["source", "out"].map(|part| dir.path().join(format!("{name}-{part}")));
        copy_of_small_sequence(&source);
        let images = files(&source.join("rgb"));
        for (k, (name, _)) in images.iter().enumerate().skip(blank_from) {
            let image = match blank_from {
                0 => images[0].1.clone(),
                // no two alike: those that repeat the one before are left out
                _ => encode_png_rgb(&Image::filled(320, 240, [50 + k as u8; 3])),
            };
            fs::write(source.join("rgb").join(name), image).unwrap();
        }
        let mut args = vec!["run", source.to_str().unwrap(), "--max-frames", "130"];
        args.extend(WITHOUT_DENSE_DEPTH.iter().chain(more));
        args.extend(["--out", out.to_str().unwrap()]);
        let output = monogrid(args);
        assert_eq!(code(&output), 3, "{name}: {}", stderr(&output));
        let html = fs::read_to_string(out.join("report.html")).unwrap();
        let (_, failed) = html.split_once("Where it went wrong").expect(name);
        let (failed, _) = failed.split_once("</a> says more").unwrap();
        assert!(failed.contains("Film again") && failed.contains("troubleshooting.md"));
        assert!(failed.contains("<figure><img src=\"data:image/jpeg;base64,"));
        (html.contains("id=\"explorer\""), failed.to_owned())
    };
    // a camera that stands still: its images, and no empty boxes
    let (has_explorer, failed) = page("still", 0, &[]);
    assert!(!has_explorer, "there is nothing to explore");
    assert!(failed.contains("<figcaption>frame 0"), "{failed}");
    // a lens that is covered after a while: what was seen there, and what was mapped
    let (has_explorer, failed) = page("covered", 40, &["--seed-depth", "dataset"]);
    assert!(has_explorer);
    assert_eq!(failed.matches("<figure>").count(), 1);
    assert!(failed.contains("<figcaption>frame 4"), "after frame 40");
    assert!(failed.contains("lost"), "and what happened");
}
