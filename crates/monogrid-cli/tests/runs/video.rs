//! Videos as sources, with and without a calibration.

use crate::common::{
    WITHOUT_DENSE_DEPTH, assert_fails, code, data, json, monogrid, program, render, small_sequence,
    stderr,
};
use monogrid_bags::McapWriter;
use monogrid_datasets::{
    ReadOptions, RecordedKeyframe, Recording, decode_jpeg_rgb, encode_png, encode_png_rgb,
    read_gray,
};
use monogrid_image::Image;
use monogrid_messages::builtin_interfaces::Time;
use monogrid_messages::sensor_msgs::{CameraInfo, CompressedImage};
use monogrid_messages::std_msgs::Header;
use monogrid_worlds::EffectsConfig;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Stdio;

fn small(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../monogrid-video/tests/data")
        .join(name)
}

#[test]
#[ignore = "needs the sequences below MONOGRID_DATA"]
fn a_phone_video_of_real_data_with_nothing_else() {
    let video = data("phone-desk/video.mp4");
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("desk");
    let output = program()
        .args(["run", "--json"])
        .args(WITHOUT_DENSE_DEPTH)
        .args(["--max-frames", "400", "--out"])
        .args([&out, &video])
        .output()
        .unwrap();
    let text = stderr(&output);
    assert_eq!(code(&output), 0, "{text}");
    assert!(text.contains("400 frames of 364x674 pixels"), "{text}");
    assert!(text.contains("a first pass over the video"), "{text}");
    // this motion says little about the focal length: it is wide open, or assumed and said
    let is_wide = text.contains("estimated from the map of the first 400 frames");
    let is_assumed = text.contains("does not show its focal length");
    assert!(is_wide != is_assumed, "{text}");
    let summary = json(&output);
    assert_eq!(summary["frames"], 400);
    assert!(summary["tracked"].as_u64().unwrap() > 100, "{summary}");
    let camera = &summary["camera"];
    assert_eq!(camera["is_focal_assumed"], is_assumed, "{camera}");
    let sigma = camera["focal_sigma"].as_f64();
    assert!(
        is_assumed || sigma.is_some_and(|sigma| sigma < 0.1),
        "{camera}"
    );
    // the next run takes what this one found
    let calibration = fs::read_to_string(out.join("calibration.txt")).unwrap();
    assert_eq!(
        calibration.contains("assumed: pinhole"),
        is_assumed,
        "{calibration}"
    );
    let again = monogrid([
        "check".as_ref(),
        video.as_os_str(),
        "--max-frames".as_ref(),
        "30".as_ref(),
        "--calibration".as_ref(),
        out.join("calibration.txt").as_os_str(),
    ]);
    assert_eq!(code(&again), 0, "{}", stderr(&again));
}

#[test]
#[ignore = "needs the sequences below MONOGRID_DATA"]
fn a_wrong_calibration_of_real_data_is_noticed_while_the_map_grows() {
    let kitchen = data("red-kitchen");
    let dir = tempfile::tempdir().unwrap();
    let calibration = dir.path().join("calibration.txt");
    fs::write(&calibration, "300 300 319.5 239.5 640 480\n").unwrap();
    let output = program()
        .args(["run", "--json"])
        .args(WITHOUT_DENSE_DEPTH)
        .args(["--max-frames", "220", "--calibration"])
        .args([&calibration, &kitchen])
        .arg("--out")
        .arg(dir.path().join("out"))
        .output()
        .unwrap();
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let warnings = json(&output)["warnings"].to_string();
    assert!(warnings.contains("focal length is 300.0 px"), "{warnings}");
}

/// A picture turned clockwise by a quarter.
fn turned(image: &Image<u8>) -> Image<u8> {
    let (width, height) = (image.width(), image.height());
    Image::from_fn(height, width, |x, y| image.at(y, height - 1 - x))
}

#[test]
fn the_rolling_shutter_of_a_camera_that_was_held_upright() {
    let dir = tempfile::tempdir().unwrap();
    let [level, upright] = ["level", "upright"].map(|name| dir.path().join(name));
    let made = program()
        .args(["synth", "living-room", "--size", "320x240", "--quick-light"])
        .args(["--depth-every", "0", "--truth-resolution", "0.5"])
        .args(["--rolling-shutter", "25", "--max-frames", "120", "--out"])
        .arg(&level)
        .output()
        .unwrap();
    assert_eq!(code(&made), 0, "{}", stderr(&made));
    fs::create_dir_all(upright.join("rgb")).unwrap();
    fs::copy(level.join("rgb.txt"), upright.join("rgb.txt")).unwrap();
    for entry in fs::read_dir(level.join("rgb")).unwrap() {
        let path = entry.unwrap().path();
        let image = read_gray(&path).unwrap().map(|v| v as u8);
        let turned = encode_png(&turned(&image));
        fs::write(upright.join("rgb").join(path.file_name().unwrap()), turned).unwrap();
    }
    let output = monogrid(["check".as_ref(), upright.as_os_str()]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    // the first row has come to lie on the right
    let found = text.split("rolling shutter of ").nth(1).expect(&text);
    let ms: f64 = found.split(' ').next().unwrap().parse().unwrap();
    assert!((ms + 25.0).abs() < 6.0, "{text}");
}

#[test]
fn the_keyframes_of_a_video_are_in_colour() {
    let dir = tempfile::tempdir().unwrap();
    let [world, video, out] = ["world", "red.y4m", "out"].map(|name| dir.path().join(name));
    render(&world, EffectsConfig::default(), 60);
    let mut bytes = b"YUV4MPEG2 W320 H240 F30:1 C420jpeg XCOLORRANGE=FULL\n".to_vec();
    let frames = fs::read_dir(world.join("rgb")).unwrap();
    let mut paths: Vec<PathBuf> = frames.map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    for path in &paths {
        let image = read_gray(path).unwrap();
        bytes.extend_from_slice(b"FRAME\n");
        bytes.extend(image.as_slice().iter().map(|v| *v as u8));
        bytes.extend([vec![100; 160 * 120], vec![190; 160 * 120]].concat());
    }
    fs::write(&video, bytes).unwrap();
    let output = program()
        .args(["run", "--json", "--fov", "65", "--out"])
        .args([&out, &video])
        .output()
        .unwrap();
    let keyframes = Recording::read(&out.join("recording.mgk"), ReadOptions::default()).unwrap();
    let colours = keyframes.keyframes.iter().map(|k| k.colour.clone());
    let colours: Vec<Vec<u8>> = colours.map(|colour| colour.expect("colour")).collect();
    assert!(!colours.is_empty(), "{}", stderr(&output));
    for jpeg in colours {
        let image = decode_jpeg_rgb(&jpeg, 1 << 20, Path::new("keyframe")).unwrap();
        let (mut sum, image) = ([0.0; 3], image.expect("colour"));
        for pixel in image.as_slice() {
            (0..3).for_each(|c| sum[c] += f64::from(pixel[c]) / image.as_slice().len() as f64);
        }
        // BT.601: red is luma + 1.402 (Cr - 128), blue is luma + 1.772 (Cb - 128)
        let [red, _, blue] = sum;
        assert!((red - blue - 136.5).abs() < 25.0, "{sum:?}");
    }
}

/// How far the green of a keyframe lies beside its grey image to the right, in the upper and in the
/// lower third, px: by least squares over the slopes of the grey image.
fn colour_beside_grey(keyframe: &RecordedKeyframe) -> [f64; 2] {
    let jpeg = keyframe.colour.as_ref().expect("colour");
    let colour = decode_jpeg_rgb(jpeg, 1 << 20, Path::new("keyframe")).unwrap();
    let (colour, grey) = (colour.expect("colour"), keyframe.image.as_ref().unwrap());
    let (width, height) = (grey.width(), grey.height());
    assert_eq!((colour.width(), colour.height()), (width, height));
    [10..height / 3, 2 * height / 3..height - 10].map(|rows| {
        let (mut moved, mut slopes) = (0.0, 0.0);
        for y in rows {
            for x in 10..width - 10 {
                let slope = (f64::from(grey.at(x + 1, y)) - f64::from(grey.at(x - 1, y))) / 2.0;
                let difference = f64::from(grey.at(x, y)) - f64::from(colour.at(x, y)[1]);
                moved += slope * difference;
                slopes += slope * slope;
            }
        }
        moved / slopes
    })
}

#[test]
fn colours_lie_where_a_rolling_shutter_was_taken_out() {
    let dir = tempfile::tempdir().unwrap();
    let [world, out] = ["world", "out"].map(|name| dir.path().join(name));
    let effects = EffectsConfig {
        readout_secs: 0.03,
        ..EffectsConfig::demo()
    };
    render(&world, effects, 80);
    for entry in fs::read_dir(world.join("rgb")).unwrap() {
        let path = entry.unwrap().path();
        let tinted = read_gray(&path).unwrap().map(|grey| {
            let grey = grey as u8;
            [grey.saturating_add(20), grey, grey.saturating_sub(20)]
        });
        fs::write(&path, encode_png_rgb(&tinted)).unwrap();
    }
    let output = program()
        .args(["run", "--rolling-shutter", "30", "--out"])
        .args([&out, &world])
        .output()
        .unwrap();
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let recording = Recording::read(&out.join("recording.mgk"), ReadOptions::default()).unwrap();
    let beside = recording.keyframes.iter().map(colour_beside_grey);
    let beside: Vec<[f64; 2]> = beside.collect();
    assert!(beside.len() > 1);
    let is_there = |third: &f64| third.abs() < 0.15;
    assert!(beside.iter().flatten().all(is_there), "{beside:?}");
}

#[test]
fn what_check_says_of_a_video() {
    let output = monogrid(
        ["check", "--json", "--fov", "60", "--start", "5"]
            .map(PathBuf::from)
            .into_iter()
            .chain([small("reordered.mp4")]),
    );
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let report = json(&output);
    assert_eq!(report["frames"], 25);
    assert_eq!(report["layout"], "MP4, H.264");
    let rate = report["frames_per_second"].as_f64().unwrap();
    assert!((rate - 30.0).abs() < 0.01, "{rate}");
    let fov = report["horizontal_fov_deg"].as_f64().unwrap();
    assert!((fov - 60.0).abs() < 0.5, "{fov}");
}

/// The test pattern with pixels of this shape, under another name.
fn anamorphic(folder: &Path, [width, height]: [u32; 2]) -> PathBuf {
    let mut bytes = fs::read(small("reordered.mp4")).unwrap();
    let at = bytes.windows(4).position(|kind| kind == b"pasp").unwrap();
    bytes[at + 4..at + 8].copy_from_slice(&width.to_be_bytes());
    bytes[at + 8..at + 12].copy_from_slice(&height.to_be_bytes());
    let path = folder.join("recording");
    fs::write(&path, bytes).unwrap();
    path
}

#[test]
fn pixels_that_are_not_square_are_said_and_calibrations_of_both_sizes_fit() {
    let dir = tempfile::tempdir().unwrap();
    let video = anamorphic(dir.path(), [3, 4]).display().to_string();
    let output = monogrid(["check", &video, "--fov", "60", "--json"]);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let report = json(&output);
    assert_eq!(
        (&report["frames"], &report["layout"]),
        (&30.into(), &"MP4, H.264".into())
    );
    assert_eq!(report["image_size"], serde_json::json!([64, 64]));
    assert!(
        report["warnings"].to_string().contains("not square (3:4)"),
        "{report}"
    );
    // a stored row is three quarters as high as a pixel is wide
    let calibration = |line: &str| {
        let file = dir.path().join("calibration.txt");
        fs::write(&file, line).unwrap();
        let file = file.display().to_string();
        let output = monogrid(["check", &video, "--calibration", &file, "--json"]);
        assert_eq!(code(&output), 0, "{}", stderr(&output));
        let report = json(&output);
        let said = report["warnings"].to_string();
        (
            report["calibration"].to_string(),
            said.contains("stretched with them"),
        )
    };
    let (stored, is_stretched) = calibration("60 45 31.5 23.5 64 48");
    assert!(is_stretched);
    let (square, is_stretched) = calibration("60 60 31.5 31.5 64 64");
    assert!(!is_stretched);
    // the first says beside it for which images the file is
    let square = square.trim_end_matches('"');
    assert!(stored.starts_with(square), "{stored} {square}");
}

#[test]
fn a_stream_on_standard_input() {
    let mut stream = b"YUV4MPEG2 W64 H48 F25:1 Cmono\n".to_vec();
    for level in 0..3u8 {
        stream.extend_from_slice(b"FRAME\n");
        stream.extend_from_slice(&[100 + level; 64 * 48]);
    }
    let piped = |arguments: &[&str]| {
        let mut child = program()
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        // a program that refuses at once closes its end
        drop(std::io::Write::write_all(
            &mut child.stdin.take().unwrap(),
            &stream,
        ));
        child.wait_with_output().unwrap()
    };
    let output = piped(&["check", "-", "--fov", "60", "--json"]);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    assert_eq!(json(&output)["frames"], 3);
    let output = piped(&["check", "-"]);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let facts = String::from_utf8_lossy(&output.stdout).into_owned() + &stderr(&output);
    for word in ["assumed", "seen only once", "--fov", "--calibration"] {
        assert!(facts.contains(word), "{word}: {facts}");
    }
    assert_fails(
        &piped(&["run", "-", "--fov", "60", "--refine-calibration"]),
        2,
        &["--refine-calibration", "seen only once", "expected a file"],
    );
}

#[test]
fn videos_that_cannot_be_used() {
    let video = small("reordered.mp4").display().to_string();
    let beyond = monogrid(["check", &video, "--fov", "60", "--start", "30"]);
    assert_fails(&beyond, 2, &["--start 30", "30 frames"]);
    // a test pattern is no still scene: whatever comes of it, no invented camera
    let output = monogrid(["check", &video]);
    let text = stderr(&output) + &String::from_utf8_lossy(&output.stdout);
    let is_honest = text.contains("--fov DEG") && !text.contains("estimated from");
    assert!(is_honest, "{text}");
    let other = small("h265.mp4").display().to_string();
    let without_ffmpeg = program()
        .args(["check", &other, "--fov", "60"])
        .env("PATH", "")
        .output()
        .unwrap();
    assert_fails(&without_ffmpeg, 2, &["H.265", "ffmpeg", "type `"]);
}

#[test]
fn a_field_of_view_is_that_of_a_pinhole() {
    for wrong in ["0", "179", "wide"] {
        assert_fails(
            &monogrid(["check", "-", "--fov", wrong]),
            2,
            &["5 to 160 degrees"],
        );
    }
}

#[test]
fn the_list_of_cameras_may_be_empty() {
    let output = monogrid(["cameras", "--json"]);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    assert!(json(&output).is_array());
}

/// A recording of a robot that another program wrote.
fn recording(name: &str) -> PathBuf {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../monogrid-bags/tests/data");
    Path::new(folder).join(name)
}

/// Images with the calibration of a camera that nobody can undo, and times of a clock that is set
/// back.
fn write_awkward(path: &Path) {
    let mut writer = McapWriter::new(fs::File::create(path).unwrap(), "a test").unwrap();
    for k in 0..20_i64 {
        let time_ns = if k < 7 { 9_000_000_000 } else { 100_000_000 } + k * 50_000_000;
        let header = Header {
            stamp: Time::from_nanoseconds(time_ns),
            frame_id: "camera".to_owned(),
        };
        let info = CameraInfo {
            header: header.clone(),
            width: 64,
            height: 48,
            distortion_model: "rational_polynomial".to_owned(),
            d: vec![0.1, 0.2, 0.0, 0.0, 0.1, 0.3, 0.2, 0.1, 0.4, 0.1, 0.1, 0.1],
            k: [50.0, 0.0, 31.5, 0.0, 50.0, 23.5, 0.0, 0.0, 1.0],
            ..CameraInfo::default()
        };
        writer.write("/camera/camera_info", k, &info).unwrap();
        let image = Image::from_fn(64, 48, |x, y| (3 * x + 5 * y + k as usize) as u8);
        let message = CompressedImage {
            header,
            format: "png".to_owned(),
            data: encode_png(&image),
        };
        writer.write("/camera/image", k, &message).unwrap();
    }
    writer.finish().unwrap();
}

#[test]
fn what_a_recording_says_of_its_camera_can_be_replaced() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("awkward");
    write_awkward(&path);
    let bag = path.display().to_string();
    let refused = monogrid(["check", &bag]);
    assert_fails(
        &refused,
        2,
        &["rational_polynomial", "--calibration FILE", "--fov DEG"],
    );
    let file = dir.path().join("calibration.txt");
    fs::write(&file, "50 50 31.5 23.5 64 48").unwrap();
    let file = file.display().to_string();
    for option in [["--fov", "60"], ["--calibration", &file]] {
        let output = monogrid(["check", &bag, option[0], option[1], "--json"]);
        assert_eq!(code(&output), 0, "{}", stderr(&output));
        let report = json(&output);
        assert_eq!(report["frames"], 20, "{report}");
        // the clock that was set back goes on, and that is said
        assert!(
            report["warnings"].to_string().contains("set back 1 times"),
            "{report}"
        );
        let rate = report["frames_per_second"].as_f64().unwrap();
        assert!((rate - 20.0).abs() < 0.01, "{rate}");
    }
}

#[test]
fn recordings_of_robots_bring_their_calibration_along() {
    for name in ["zstd.mcap", "plain.db3", "lz4.bag"] {
        let output = monogrid([Path::new("check"), &recording(name), Path::new("--json")]);
        assert_eq!(code(&output), 0, "{}", stderr(&output));
        let report = json(&output);
        assert_eq!(report["frames"], 8, "{report}");
        assert!(
            report.to_string().contains("CameraInfo of the recording"),
            "{report}"
        );
    }
    let bag = recording("plain.mcap");
    let wrong = [
        Path::new("run"),
        &bag,
        Path::new("--topic"),
        Path::new("/left"),
    ];
    assert_fails(&monogrid(wrong), 2, &["/left", "/camera/image_raw"]);
    let images = [
        Path::new("run"),
        small_sequence(),
        Path::new("--topic"),
        Path::new("/left"),
    ];
    assert_fails(&monogrid(images), 2, &["--topic", "no recording"]);
}
