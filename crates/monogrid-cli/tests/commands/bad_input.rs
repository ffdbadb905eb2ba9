//! Bad input gets a sentence that helps and exit code 2, never a panic.

use crate::common::{assert_fails, code, json, monogrid, stderr};
use monogrid_datasets::encode_png;
use monogrid_image::Image;
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

const CALIBRATION: &str = "60 60 39.5 29.5 80 60\n";

/// A folder with `count` images of 80x60 pixels that differ from each other, and a calibration.
fn image_folder(count: usize) -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    for i in 0..count {
        let image = Image::from_fn(80, 60, |x, y| ((x * 7 + y * 13 + i * 3) % 251) as u8);
        fs::write(dir.path().join(format!("{i:03}.png")), encode_png(&image)).unwrap();
    }
    fs::write(dir.path().join("calibration.txt"), CALIBRATION).unwrap();
    dir
}

fn run(source: &Path, out: &Path, more: &[&str]) -> std::process::Output {
    let mut args = vec!["run".to_owned(), source.display().to_string()];
    args.extend(["--out".to_owned(), out.display().to_string()]);
    args.extend(more.iter().map(|s| (*s).to_owned()));
    monogrid(args)
}

fn out_in(dir: &TempDir) -> PathBuf {
    dir.path().join("out")
}

#[test]
fn wrong_usage_is_exit_code_2() {
    for args in [
        &["run"][..],
        &["run", "x", "--resolution", "-1"],
        &["run", "x", "--size", "640"],
        &["run", "x", "--threads", "0"],
        &["run", "x", "--set", "nonsense"],
        &["run", "x", "--set", "mapping.no_such=1"],
        &["run", "x", "--align", "somewhere"],
        &["map", "x.mgk", "--out", "x.png"],
        &["no-such-command"],
    ] {
        let output = monogrid(args);
        assert_eq!(code(&output), 2, "{args:?}: {}", stderr(&output));
    }
}

#[test]
fn help_exists_for_every_command_and_names_nothing_that_is_missing() {
    for command in [
        &["--help"][..],
        &["demo", "--help"],
        &["run", "--help"],
        &["check", "--help"],
        &["map", "--help"],
        &["info", "--help"],
        &["convert", "--help"],
        &["evaluate", "trajectory", "--help"],
        &["evaluate", "depth", "--help"],
    ] {
        let output = monogrid(command);
        assert_eq!(code(&output), 0);
        assert!(String::from_utf8_lossy(&output.stdout).contains("monogrid"));
    }
}

#[test]
fn missing_and_empty_sources() {
    let output = monogrid(["check", "/dev/zero"]);
    assert_fails(&output, 2, &["/dev/zero", "device", "expected a video"]);
    let dir = tempfile::tempdir().unwrap();
    let missing = dir.path().join("nowhere");
    assert_fails(&run(&missing, &out_in(&dir), &[]), 2, &["nowhere"]);
    let empty = dir.path().join("empty");
    fs::create_dir(&empty).unwrap();
    assert_fails(&run(&empty, &out_in(&dir), &[]), 2, &["no frames"]);
    assert!(!out_in(&dir).exists(), "nothing is written for bad input");
    assert_fails(&monogrid([Path::new("check"), &missing]), 2, &["nowhere"]);
}

#[test]
fn calibrations_that_cannot_be_right() {
    let dir = image_folder(3);
    let file = dir.path().join("calibration.txt");
    for (content, expected) in [
        ("nan 60 39.5 29.5 80 60", "calibration"),
        ("0 60 39.5 29.5 80 60", "calibration"),
        ("60 60 39.5", "calibration"),
        ("60 60 39.5 29.5 100 60", "80x60"),
    ] {
        fs::write(&file, content).unwrap();
        assert_fails(&run(dir.path(), &out_in(&dir), &[]), 2, &[expected]);
    }
    // twice the size, the same picture
    fs::write(&file, "120 120 79.5 59.5 160 120").unwrap();
    let output = monogrid([Path::new("check"), dir.path(), Path::new("--json")]);
    let report = crate::common::json(&output);
    assert!(
        report["warnings"].to_string().contains("it was scaled"),
        "{report}"
    );
    let calibration = report["calibration"].as_str().unwrap();
    let degrees = report["horizontal_fov_deg"].as_f64().unwrap();
    assert!((degrees - 67.38).abs() < 0.01, "{calibration}: {degrees}");
    // what lies there and is not understood: the facts all the same, and why a run refuses it
    fs::write(&file, "60 60 39.5").unwrap();
    let output = monogrid([Path::new("check"), dir.path(), Path::new("--json")]);
    assert_fails(&output, 2, &["calibration"]);
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["frames"], 3);
    assert_eq!(report["calibration"], "not understood");
    // none at all: an ordinary camera is taken, and it is said why
    fs::remove_file(&file).unwrap();
    let said = ["focal length is not known", "assumed", "--calibration"];
    assert_fails(&run(dir.path(), &out_in(&dir), &[]), 3, &said);
    let output = monogrid([Path::new("check"), dir.path(), Path::new("--json")]);
    let report = json(&output);
    assert_eq!(report["frames"], 3);
    assert!(
        report["warnings"].to_string().contains("assumed"),
        "{report}"
    );
}

/// Grey levels without an end, smooth between random ones at whole numbers.
fn texture(x: f64, y: f64) -> f64 {
    let level = |x: f64, y: f64| {
        let mixed = (x as i64 as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15)
            ^ (y as i64 as u64).wrapping_mul(0xC2B2_AE3D_27D4_EB4F);
        (monogrid_geometry::mix(mixed) >> 40) as f64 / f64::from(1 << 24) * 220.0 + 20.0
    };
    let (left, top) = (x.floor(), y.floor());
    let smooth = |t: f64| t * t * (3.0 - 2.0 * t);
    let (u, v) = (smooth(x - left), smooth(y - top));
    let across = |y: f64| level(left, y) * (1.0 - u) + level(left + 1.0, y) * u;
    across(top) * (1.0 - v) + across(top + 1.0) * v
}

/// A folder with 45 images, 320x240, of which each pixel is `of` the number of the image and its
/// place.
fn made_folder(of: impl Fn(usize, f64, f64) -> f64) -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    for k in 0..45 {
        let image = Image::from_fn(320, 240, |x, y| of(k, x as f64, y as f64) as u8);
        fs::write(dir.path().join(format!("{k:03}.png")), encode_png(&image)).unwrap();
    }
    dir
}

/// What the walls around a camera look like that turns about its vertical axis: its focal length is
/// 260 px.
fn turned(angle: f64, x: f64, y: f64) -> f64 {
    let (x, y) = ((x - 159.5) / 260.0, (y - 119.5) / 260.0);
    let around = angle + x.atan();
    texture(30.0 * around, 30.0 * (y / x.hypot(1.0)).atan())
}

#[test]
fn a_camera_that_shows_no_depth_ends_with_code_3_and_says_what_to_film() {
    let turns = made_folder(|k, x, y| turned(0.02 * k as f64, x, y));
    let passes = |k: usize, x: f64| (7 * k..7 * k + 90).contains(&(x as usize));
    let stands = made_folder(|k, x, y| match passes(k, x) && y > 80.0 {
        true => texture(0.1 * (x - 7.0 * k as f64) + 700.0, 0.1 * y),
        false => turned(0.0, x, y),
    });
    for (dir, status, motion, said) in [
        (&turns, "only_turns", "only turns", "only turns"),
        (&stands, "stands_still", "stands still", "stands still"),
    ] {
        for calibration in [None, Some("260 260 159.5 119.5 320 240\n")] {
            let file = dir.path().join("calibration.txt");
            let written = calibration.map(|text| fs::write(&file, text));
            written.transpose().unwrap();
            let out = out_in(dir);
            let output = run(dir.path(), &out, &["--json"]);
            assert_eq!(code(&output), 3, "{status}: {}", stderr(&output));
            let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
            assert_eq!(summary["status"], status);
            assert_eq!(
                (&summary["frames"], &summary["keyframes"]),
                (&45.into(), &0.into())
            );
            assert!(stderr(&output).contains(said) && stderr(&output).contains("filming"));
            assert!(!out.join("global.ot").exists() && out.join("report.html").exists());
            let checked = monogrid([Path::new("check"), dir.path(), Path::new("--json")]);
            assert_eq!(json(&checked)["motion"], motion);
            fs::remove_dir_all(&out).unwrap();
        }
    }
}

#[test]
fn borders_are_found_and_said() {
    // a picture of what a turning camera sees on a screen with other things on it
    let is_inside = |x: f64, y: f64| (60.0..280.0).contains(&x) && (30.0..200.0).contains(&y);
    let dir = made_folder(|k, x, y| match is_inside(x, y) {
        true => turned(0.05 * k as f64, x, y),
        false => texture(0.2 * x + 300.0, 0.2 * y),
    });
    let report = json(&monogrid([
        Path::new("check"),
        dir.path(),
        Path::new("--json"),
    ]));
    let picture = report["picture"].as_array().unwrap();
    let picture: Vec<f64> = picture.iter().map(|n| n.as_f64().unwrap()).collect();
    for (found, expected) in picture.iter().zip([60.0, 30.0, 220.0, 170.0]) {
        assert!((found - expected).abs() <= 4.0, "{picture:?}");
    }
    assert!(
        report["warnings"].to_string().contains("is a border"),
        "{report}"
    );
    assert_eq!(
        report["motion"], "only turns",
        "the border alone stands still"
    );
}

#[test]
fn options_that_do_not_fit_the_source() {
    let dir = image_folder(3);
    let out = out_in(&dir);
    assert_fails(&run(dir.path(), &out, &["--start", "3"]), 2, &["3 frames"]);
    assert_fails(
        &run(dir.path(), &out, &["--max-frames", "0"]),
        2,
        &["at least 1"],
    );
    assert_fails(
        &run(dir.path(), &out, &["--seed-depth", "dataset"]),
        2,
        &["--seed-depth", "no depth image"],
    );
    assert_fails(
        &run(dir.path(), &out, &["--depth", "dataset"]),
        2,
        &["--depth", "no depth image"],
    );
    let mask = dir.path().join("mask.pgm");
    fs::write(&mask, b"P5\n2 2\n255\n\xff\xff\xff\xff").unwrap();
    let mask = mask.display().to_string();
    assert_fails(
        &run(dir.path(), &out, &["--mask", &mask]),
        2,
        &["2x2", "80x60"],
    );
}

#[test]
fn an_output_folder_that_is_not_ours_is_left_alone() {
    let dir = image_folder(3);
    let photos = dir.path().join("photos");
    fs::create_dir(&photos).unwrap();
    fs::write(photos.join("cat.jpg"), "cat").unwrap();
    assert_fails(&run(dir.path(), &photos, &[]), 2, &["--force"]);
    assert_eq!(fs::read(photos.join("cat.jpg")).unwrap(), b"cat");
    // not even with --force may the source be emptied
    assert_fails(
        &run(dir.path(), dir.path(), &["--force"]),
        2,
        &["holds the source"],
    );
    assert!(dir.path().join("000.png").exists());
    let file = dir.path().join("file");
    fs::write(&file, "x").unwrap();
    assert_fails(&run(dir.path(), &file, &[]), 2, &["is a file"]);
    assert_fails(
        &run(dir.path(), &file.join("below"), &[]),
        2,
        &["cannot be written"],
    );
}

#[test]
fn constant_images_end_with_code_3_and_without_a_map() {
    let dir = tempfile::tempdir().unwrap();
    for i in 0..20 {
        let image = Image::filled(80, 60, 128u8);
        fs::write(dir.path().join(format!("{i:03}.png")), encode_png(&image)).unwrap();
    }
    fs::write(dir.path().join("calibration.txt"), CALIBRATION).unwrap();
    let out = out_in(&dir);
    let output = run(dir.path(), &out, &["--json"]);
    assert_eq!(code(&output), 3, "{}", stderr(&output));
    let summary = crate::common::json(&output);
    assert_eq!(summary["keyframes"], 0);
    assert_eq!(summary["status"], "not_initialised");
    assert!(!out.join("global.ot").exists());
    for name in ["summary.json", "report.html", "frames.csv", "config.toml"] {
        assert!(out.join(name).exists(), "{name}");
    }
    // ours now: replaced without --force
    assert_eq!(code(&run(dir.path(), &out, &[])), 3);
}

#[test]
fn unreadable_images_are_skipped_and_ten_in_a_row_end_the_run() {
    let dir = image_folder(30);
    fs::write(dir.path().join("004.png"), "not an image").unwrap();
    let whole = fs::read(dir.path().join("006.png")).unwrap();
    fs::write(dir.path().join("006.png"), &whole[..whole.len() / 2]).unwrap();
    let small = Image::filled(40, 30, 9u8);
    fs::write(dir.path().join("008.png"), encode_png(&small)).unwrap();
    let output = run(dir.path(), &out_in(&dir), &["--json"]);
    let summary = crate::common::json(&output);
    assert_eq!(summary["skipped"], 3, "{}", stderr(&output));
    assert_eq!(summary["frames"], 30);
    assert!(stderr(&output).contains("40x30"));
    for i in 10..20 {
        fs::write(dir.path().join(format!("{i:03}.png")), "x").unwrap();
    }
    let output = run(dir.path(), &out_in(&dir), &[]);
    assert_fails(&output, 1, &["10 images in a row"]);
    assert!(out_in(&dir).join("summary.json").exists());
}

#[test]
fn unsorted_and_duplicate_times_are_put_in_order() {
    let dir = image_folder(4);
    let list = "# list\n0.2 002.png\n0.1 001.png\n0.1 003.png\n0.0 000.png\n";
    fs::write(dir.path().join("rgb.txt"), list).unwrap();
    let output = monogrid([Path::new("check"), dir.path(), Path::new("--json")]);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let report = crate::common::json(&output);
    assert_eq!(report["frames"], 3);
    let warnings = report["warnings"].to_string();
    assert!(
        warnings.contains("backwards") && warnings.contains("repeat"),
        "{warnings}"
    );
}

#[test]
fn maps_and_recordings_that_are_not() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).display().to_string();
    fs::write(path("a.ot"), "hello").unwrap();
    assert_fails(
        &monogrid(["info", &path("a.ot")]),
        2,
        &["a.ot", "not a map"],
    );
    assert_fails(&monogrid(["info", &path("b.ot")]), 2, &["b.ot"]);
    assert_fails(
        &monogrid(["convert", &path("a.ot"), &path("a.ply")]),
        2,
        &["not a map"],
    );
    assert_fails(
        &monogrid(["convert", &path("a.ot"), &path("a.xyz")]),
        2,
        &["a.xyz", ".ply"],
    );
    fs::write(path("r.mgk"), "hello").unwrap();
    assert_fails(
        &monogrid(["map", &path("r.mgk"), "--out", &path("m.ot")]),
        2,
        &["r.mgk"],
    );
    fs::write(path("r.scans"), "hello").unwrap();
    assert_fails(
        &monogrid(["map", &path("r.scans"), "--out", &path("m.ot")]),
        2,
        &["r.scans"],
    );
    assert_fails(
        &monogrid(["evaluate", "trajectory", &path("a.ot"), &path("none")]),
        2,
        &["a.ot", "line 1"],
    );
}

#[test]
fn a_reader_that_goes_away_does_no_harm() {
    let folder = tempfile::tempdir().unwrap();
    let curves = folder.path().join("curves");
    let mut child = std::process::Command::new(env!("CARGO_BIN_EXE_monogrid"))
        .args(["thesis", "sensor-model"])
        .args(["--json", "--plot"])
        .arg(&curves)
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    // both ends are closed before anything is written
    drop(child.stdout.take());
    drop(child.stderr.take());
    assert_eq!(child.wait().unwrap().code(), Some(1));
    assert!(
        curves.join("sensor-models.html").is_file(),
        "what was complete stays"
    );
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_standard_output_is_said_and_is_a_failure() {
    let folder = tempfile::tempdir().unwrap();
    let curves = folder.path().join("curves").display().to_string();
    for args in [
        &["--help"][..],
        &["thesis", "sensor-model", "--plot", &curves, "--json"],
    ] {
        let full = fs::File::options().write(true).open("/dev/full").unwrap();
        let output = crate::common::program()
            .args(args)
            .stdout(full)
            .output()
            .unwrap();
        assert_fails(&output, 1, &["standard output cannot be written"]);
    }
    assert!(Path::new(&curves).join("sensor-models.html").is_file());
}

#[test]
fn repeated_images_are_left_out_and_counted() {
    let dir = image_folder(20);
    for i in 0..20 {
        let name = |k: usize| dir.path().join(format!("{i:03}{}.png", ["", "b"][k]));
        fs::copy(name(0), name(1)).unwrap();
    }
    let out = out_in(&dir);
    let output = run(dir.path(), &out, &["--json"]);
    let summary = crate::common::json(&output);
    assert_eq!(
        (&summary["frames"], &summary["repeated"]),
        (&20.into(), &20.into())
    );
    let warnings = summary["warnings"].to_string();
    assert!(warnings.contains("20 frames repeat"), "{warnings}");
    assert!(stderr(&output).contains("20 more frames repeat"));
    let frames = fs::read_to_string(out.join("frames.csv")).unwrap();
    assert_eq!(frames.matches(",repeated,").count(), 20);
}

#[cfg(unix)]
#[test]
fn names_are_shown_and_never_obeyed() {
    let dir = tempfile::tempdir().unwrap();
    let name = "\x1b[2J\x1b]0;title\x07\r\u{9b}31m\u{202e}gnp";
    let folder = dir.path().join(name);
    std::fs::create_dir(&folder).unwrap();
    let file = folder.join("\x1b[8m.ot");
    std::fs::write(&file, "# Octomap OcTree file\nid \x1b[31m\u{9b}2J\n").unwrap();
    let list = dir.path().join("list.tsv");
    std::fs::write(&list, format!("{}\tname=a\n", folder.display())).unwrap();
    let path = |path: &Path| path.display().to_string();
    let [folder, file, list] = [&folder, &file, &list].map(|p| path(p));
    let out = path(&dir.path().join("\x1bout"));
    for words in [
        &["run", &folder, "--out", &out][..],
        &["check", &folder],
        &["info", &file],
        &["convert", &file, &out],
        &["batch", &list, "--out", &out],
        &["batch", &list, "--out", &out, "--dry-run"],
        &["batch", &list, "--out", &out, "--dry-run", "--json"],
        &["evaluate", "trajectory", &file, &folder],
        &[name],
        &["run", &folder, &format!("--{name}")],
        &["run", &folder, "--resolution", name],
        &["run", &folder, "--set", name],
        &["run", &folder, "--set", &format!("{name}=1")],
    ] {
        let output = monogrid(words);
        for bytes in [&output.stdout, &output.stderr] {
            let text = String::from_utf8_lossy(bytes);
            let obeyed = |c: char| c.is_control() && !matches!(c, '\n' | '\t') || c == '\u{202e}';
            assert!(!text.contains(obeyed), "{words:?}: {text:?}");
        }
        let text = stderr(&output) + &String::from_utf8_lossy(&output.stdout);
        assert!(
            text.contains("\\u00") || text.contains("\\u{1b}"),
            "{words:?}: {text}"
        );
    }
    let planned = monogrid(["batch", &list, "--out", &out, "--dry-run", "--json"]);
    assert_eq!(json(&planned)[0]["source"], folder);
}

#[test]
fn a_source_that_shows_far_more_than_it_stores_breaks_off() {
    let dir = tempfile::tempdir().unwrap();
    // 12 million black pixels in 12 kB, listed again and again
    let plain = encode_png(&Image::from_fn(3500, 3500, |_, _| 0));
    assert!(plain.len() < 100_000, "{}", plain.len());
    fs::write(dir.path().join("plain.png"), plain).unwrap();
    let list: String = (0..1000).map(|k| format!("{k}.0 plain.png\n")).collect();
    fs::write(dir.path().join("rgb.txt"), list).unwrap();
    let source = dir.path().display().to_string();
    let out = dir.path().join("out").display().to_string();
    let ended = monogrid(["run", &source, "--fov", "60", "--out", &out]);
    assert_fails(
        &ended,
        1,
        &["broke off", "shows more than", "fewer of its frames"],
    );
    let ended = monogrid(["check", &source, "--fov", "60"]);
    assert_fails(&ended, 1, &["shows more than"]);
    let words = dir.path().join("words").display().to_string();
    let ended = monogrid(["thesis", "vocabulary", &source, "--out", &words]);
    assert_fails(&ended, 2, &["shows more than"]);
}
