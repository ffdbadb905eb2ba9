//! A mask for all frames, or one for each: what moves before the camera, or with it, is not seen.

use crate::common::{
    WITHOUT_DENSE_DEPTH, assert_fails, code, copy_of_small_sequence, json, monogrid, stderr,
};
use monogrid_datasets::{Dataset, SourceOptions, encode_png, read_gray};
use monogrid_image::{GrayImage, Mask, to_gray8};
use serde_json::Value;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

/// Where something with much texture is in a frame: it goes up and down, and is always near.
fn is_covered(frame: usize, x: usize, y: usize) -> bool {
    let top = 40 + (frame * 3) % 90;
    (60..220).contains(&x) && (top..top + 110).contains(&y)
}

/// Its texture, which moves with it.
fn texture(frame: usize, x: usize, y: usize) -> f32 {
    let y = y + 200 - (frame * 3) % 90;
    if (x / 7 * 31 + y / 7 * 17) % 5 < 2 {
        230.0
    } else {
        20.0
    }
}

/// Covers a part of each image, and writes masks of it into a folder and a video.
fn cover(sequence: &Path, masks: &Path, video: &Path) {
    fs::create_dir(masks).unwrap();
    let mut film = Vec::new();
    for frame in Dataset::open(sequence, SourceOptions::default())
        .unwrap()
        .frames
    {
        let image = read_gray(&frame.path).unwrap();
        let (width, height, k) = (image.width(), image.height(), frame.index);
        let covered = GrayImage::from_fn(width, height, |x, y| match is_covered(k, x, y) {
            true => texture(k, x, y),
            false => image.at(x, y),
        });
        let mask = Mask::from_fn(
            width,
            height,
            |x, y| if is_covered(k, x, y) { 0 } else { 255 },
        );
        fs::write(&frame.path, encode_png(&covered.map(to_gray8))).unwrap();
        fs::write(
            masks.join(frame.path.file_name().unwrap()),
            encode_png(&mask),
        )
        .unwrap();
        if film.is_empty() {
            film = format!("YUV4MPEG2 W{width} H{height} F30:1 Ip A1:1 Cmono\n").into_bytes();
        }
        film.extend_from_slice(b"FRAME\n");
        film.extend_from_slice(mask.as_slice());
    }
    fs::write(video, film).unwrap();
}

/// The summary of a run.
fn run(sequence: &Path, out: &Path, more: &[&str]) -> Value {
    let mut args = vec![
        "run",
        sequence.to_str().unwrap(),
        "--out",
        out.to_str().unwrap(),
    ];
    args.extend(["--seed-depth", "dataset", "--json"]);
    args.extend(WITHOUT_DENSE_DEPTH);
    args.extend(more);
    let output = monogrid(args);
    assert!([0, 3].contains(&code(&output)), "{}", stderr(&output));
    json(&output)
}

fn error(summary: &Value) -> f64 {
    let found = summary["trajectory"]["ate_rmse"].as_f64();
    found.unwrap_or(f64::INFINITY) / summary["trajectory"]["coverage"].as_f64().unwrap_or(0.0)
}

#[test]
fn what_the_mask_of_a_frame_names_is_not_seen() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    let (free, covered) = (at("free"), at("covered"));
    copy_of_small_sequence(&free);
    copy_of_small_sequence(&covered);
    let (masks, video) = (at("masks"), at("masks.y4m"));
    cover(&covered, &masks, &video);
    let by_files = ["--mask", masks.to_str().unwrap()];
    let by_video = ["--mask", video.to_str().unwrap()];

    let few = ["--max-frames", "90"];
    let best = run(&free, &at("1"), &few);
    let worst = run(&covered, &at("2"), &few);
    let masked = run(&covered, &at("3"), &[&by_files[..], &few].concat());
    let said = format!("{} {} {}", error(&best), error(&masked), error(&worst));
    assert!(error(&masked) < 0.3 * error(&worst), "{said}");
    assert!(error(&masked) < 3.0 * error(&best) + 0.002, "{said}");
    let image = read_gray(&at("3").join("keyframes/00000_image.png")).unwrap();
    for (x, y) in (70..210).flat_map(|x| (50..140).map(move |y| (x, y))) {
        let step = (image.at(x + 1, y) - image.at(x, y)).abs();
        assert!(step < 12.0, "{x} {y}: {step}");
    }

    // the same masks as a video, of a part of the frames
    let part = ["--start", "20", "--every", "2", "--max-frames", "6"];
    run(&covered, &at("4"), &[&by_files[..], &part].concat());
    run(&covered, &at("5"), &[&by_video[..], &part].concat());
    let image = |name: &str| fs::read(at(name).join("keyframes/00000_image.png")).unwrap();
    assert_eq!(image("4"), image("5"));

    // one for all of them, of half their size, is the same as one for each
    let mask = Mask::from_fn(160, 120, |x, y| if x < 70 && y > 80 { 0 } else { 255 });
    fs::write(at("one.png"), encode_png(&mask)).unwrap();
    fs::create_dir(at("each")).unwrap();
    for entry in fs::read_dir(&masks).unwrap() {
        let name = entry.unwrap().file_name();
        fs::copy(at("one.png"), at("each").join(name)).unwrap();
    }
    for (name, out) in [("one.png", "7"), ("each", "8")] {
        let mask = at(name);
        let by_this = ["--mask", mask.to_str().unwrap()];
        run(&covered, &at(out), &[&by_this[..], &part].concat());
    }
    assert_eq!(image("7"), image("8"));
    assert_ne!(image("7"), image("4"));

    // one is missing, and one is damaged
    let names = fs::read_dir(&masks)
        .unwrap()
        .map(|entry| entry.unwrap().path());
    let mut names: Vec<_> = names.collect();
    names.sort();
    fs::remove_file(&names[30]).unwrap();
    fs::write(&names[40], b"\x89PNG").unwrap();
    let part = ["--start", "28", "--max-frames", "14"];
    let summary = run(&covered, &at("6"), &[&by_files[..], &part].concat());
    assert_eq!(summary["skipped"], 1);
    let mut warnings = String::new();
    write!(warnings, "{}", summary["warnings"]).unwrap();
    assert!(
        warnings.contains("1 of 13 frames have no mask"),
        "{warnings}"
    );
}

#[test]
fn masks_of_something_else_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let sequence = dir.path().join("sequence");
    copy_of_small_sequence(&sequence);
    let masks = dir.path().join("masks");
    fs::create_dir(&masks).unwrap();
    let (black, square) = (Mask::filled(320, 240, 0), Mask::filled(240, 240, 255));
    fs::write(masks.join("a.png"), encode_png(&black)).unwrap();
    let [all, other] = ["all.png", "other.png"].map(|name| dir.path().join(name));
    fs::write(&all, encode_png(&black)).unwrap();
    fs::write(&other, encode_png(&square)).unwrap();
    for (mask, said) in [
        (&masks, "the name of an image"),
        (&all, "all of it is black"),
        (&other, "240x240 pixels, the image is 320x240"),
    ] {
        let output = monogrid([
            "check".as_ref(),
            sequence.as_os_str(),
            "--mask".as_ref(),
            mask.as_os_str(),
        ]);
        assert_fails(&output, 2, &[said]);
    }
}
