//! The words of FAB-MAP: trained by the program, used by a run.

use crate::common::{assert_fails, code, json, monogrid, small_sequence, stderr};
use std::fs;

#[test]
fn a_trained_vocabulary_serves_a_run_and_a_damaged_one_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("small.vocabulary").display().to_string();
    let images = small_sequence().display().to_string();
    let train = |out: &str| {
        let arguments = ["--every", "15", "--words", "100", "--json", "--out", out];
        monogrid(
            ["thesis", "vocabulary", images.as_str()]
                .into_iter()
                .chain(arguments),
        )
    };
    let trained = train(&file);
    assert_eq!(code(&trained), 0, "{}", stderr(&trained));
    assert_eq!(json(&trained)["words"], 100);
    let again = dir.path().join("again").display().to_string();
    train(&again);
    assert!(fs::read(&file).unwrap() == fs::read(&again).unwrap());

    let out = dir.path().join("out").display().to_string();
    let run = |max_frames: &str| {
        monogrid([
            "run",
            &images,
            "--out",
            &out,
            "--max-frames",
            max_frames,
            "--set",
            "slam.graph.places.method=\"fab-map\"",
            "--set",
            &format!("slam.graph.places.vocabulary=\"{file}\""),
        ])
    };
    let used = run("60");
    assert_eq!(code(&used), 0, "{}", stderr(&used));
    let mut bytes = fs::read(&file).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&file, bytes).unwrap();
    assert_fails(&run("5"), 2, &["small.vocabulary", "damaged"]);
    fs::remove_file(&file).unwrap();
    assert_fails(&run("5"), 2, &["small.vocabulary", "monogrid vocabulary"]);
}

#[test]
fn too_little_to_train_on_is_said() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("v").display().to_string();
    let empty = dir.path().join("no images").display().to_string();
    let failed = monogrid(["thesis", "vocabulary", &empty, "--out", &out]);
    assert_fails(&failed, 2, &["no images"]);
    assert!(!dir.path().join("v").exists());
}
