//! Every number among the settings has a range that is checked and safe.

use crate::common::{code, monogrid, small_sequence, stderr};
use monogrid_mapping::MAPPING;
use monogrid_slam::settings::SLAM;
use rayon::prelude::*;
use std::path::Path;

/// All settings that are numbers, and how many numbers they have.
fn numbers() -> Vec<(&'static str, usize)> {
    let slam = SLAM.iter().map(|s| (s.name, s.ranges.len()));
    let mapping = MAPPING.iter().map(|s| (s.name, s.ranges.len()));
    let all = slam.chain(mapping).filter(|(_, count)| *count > 0);
    all.chain([("working_pixels", 1)]).collect()
}

/// Exit code and messages of a run with some settings.
fn run(out: &Path, settings: &[String], frames: usize) -> (i32, String) {
    let mut args = vec![
        "run".to_owned(),
        small_sequence().display().to_string(),
        "--out".to_owned(),
        out.display().to_string(),
        "--size".to_owned(),
        "160x120".to_owned(),
        "--max-frames".to_owned(),
        frames.to_string(),
        "--threads".to_owned(),
        "1".to_owned(),
    ];
    for setting in settings {
        args.extend(["--set".to_owned(), setting.clone()]);
    }
    let output = monogrid(args);
    (code(&output), stderr(&output))
}

#[test]
fn every_number_is_refused_with_its_range_or_gives_a_run_that_ends() {
    let folder = tempfile::tempdir().unwrap();
    let attempts: Vec<(&str, String)> = numbers()
        .into_iter()
        .flat_map(|(name, count)| {
            let bad = ["nan", "-1", "0", "1e30"].into_iter();
            bad.map(move |bad| match count {
                1 => (name, bad.to_owned()),
                _ => (name, format!("[{}]", vec![bad; count].join(", "))),
            })
        })
        .collect();
    assert!(attempts.len() > 200, "{} attempts", attempts.len());
    let problems: Vec<String> = attempts
        .par_iter()
        .enumerate()
        .filter_map(|(i, (name, value))| {
            let setting = format!("{name}={value}");
            let out = folder.path().join(i.to_string());
            let (code, said) = run(&out, std::slice::from_ref(&setting), 45);
            let leaf = name.rsplit('.').next().unwrap();
            let is_right = match code {
                // tracking may well never start with such settings
                0 | 3 => !value.contains("nan"),
                2 => said.contains(leaf) && (said.contains("allowed") || said.contains("expected")),
                _ => false,
            };
            (!is_right || said.contains("panicked")).then(|| format!("{setting}: {code} {said}"))
        })
        .collect();
    assert!(problems.is_empty(), "{}", problems.join("\n"));
}
