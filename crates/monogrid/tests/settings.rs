//! Every number among the settings has a range that is documented, checked, and safe.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "a test may panic and talk"
)]

mod common;

use common::{code, monogrid, small_sequence, stderr};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::Path;
use toml::{Table, Value};

/// Every number below a table, with its dotted name.
fn numbers(prefix: &str, table: &Table, out: &mut Vec<(String, Value)>) {
    for (key, value) in table {
        let name = format!("{prefix}{key}");
        match value {
            Value::Table(inner) => numbers(&format!("{name}."), inner, out),
            Value::Integer(_) | Value::Float(_) => out.push((name, value.clone())),
            // lists are set as a whole
            Value::Array(list) if list.iter().all(|v| v.is_integer() || v.is_float()) => {
                out.push((name, value.clone()));
            }
            _ => {}
        }
    }
}

/// The effective configuration of a run of the small sequence.
fn effective(folder: &Path) -> Vec<(String, Value)> {
    let out = folder.join("effective");
    // three frames are too few to start
    assert_eq!(run(&out, &[], 3).0, 3);
    let text = std::fs::read_to_string(out.join("config.toml")).unwrap();
    let mut found = Vec::new();
    numbers("", &text.parse().unwrap(), &mut found);
    assert!(found.len() > 180, "{} numbers", found.len());
    found
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
    let attempts: Vec<(String, String)> = effective(folder.path())
        .into_iter()
        .filter(|(name, _)| name != "seed")
        .flat_map(|(name, value)| {
            let bad = ["nan", "-1", "0", "1e30"].into_iter();
            bad.map(move |bad| {
                let text = match &value {
                    Value::Array(list) => format!("[{}]", vec![bad; list.len()].join(", ")),
                    _ => bad.to_owned(),
                };
                (name.clone(), text)
            })
        })
        .collect();
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

/// The documented range of each setting: whether the ends belong to it, and the ends.
fn documented() -> BTreeMap<String, (bool, f64, f64, bool)> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/configuration.md");
    let text = std::fs::read_to_string(path).unwrap();
    let mut section = String::new();
    let mut ranges = BTreeMap::new();
    for line in text.lines() {
        if let Some(rest) = line.strip_prefix("## `[") {
            section = rest.trim_end_matches("]`").to_owned();
        }
        let Some((key, rest)) = line.strip_prefix("| `").and_then(|l| l.split_once('`')) else {
            continue;
        };
        let Some((_, range)) = rest.rsplit_once("ange ") else {
            continue;
        };
        let end = range.find([']', ')']).unwrap();
        let (low, high) = range[1..end].split_once(", ").unwrap();
        let range = (
            range.starts_with('['),
            low.parse().unwrap(),
            high.parse().unwrap(),
            range[end..].starts_with(']'),
        );
        // a key of the top level has no section
        let name = format!("{section}.{key}");
        ranges.insert(name.trim_start_matches('.').to_owned(), range);
    }
    ranges
}

/// Settings made of two numbers or of one per level.
const LISTS: [&str; 4] = [
    "update_limits",
    "updates_to_belief",
    "clamp",
    "max_iterations",
];

#[test]
fn the_documented_ranges_are_those_that_are_checked() {
    let folder = tempfile::tempdir().unwrap();
    let ranges = documented();
    let mut attempts: Vec<(String, String, bool)> = Vec::new();
    for (name, value) in effective(folder.path()) {
        let leaf = name.rsplit('.').next().unwrap();
        if name == "seed" || matches!(value, Value::Array(_)) || name.contains(".robust.") {
            assert!(
                name == "seed" || name.contains("robust") || LISTS.contains(&leaf),
                "{name}"
            );
            continue;
        }
        let (low_in, low, high, high_in) = *ranges
            .get(&name)
            .unwrap_or_else(|| panic!("no range is documented for {name}"));
        let is_integer = value.is_integer();
        let step = |v: f64| {
            if is_integer {
                1.0
            } else {
                (v.abs() * 0.01).max(1e-9)
            }
        };
        let text = |v: f64| {
            if is_integer {
                format!("{v:.0}")
            } else {
                format!("{v:?}")
            }
        };
        attempts.push((name.clone(), text(low), low_in));
        attempts.push((name.clone(), text(low - step(low)), false));
        if high.is_finite() {
            attempts.push((name.clone(), text(high), high_in));
            attempts.push((name, text(high + step(high)), false));
        }
    }
    let problems: Vec<String> = attempts
        .par_iter()
        .enumerate()
        .filter_map(|(i, (name, value, is_allowed))| {
            // the source does not exist: settings are looked at first
            let out = folder.path().join(format!("r{i}"));
            let setting = format!("{name}={value}");
            let output = monogrid([
                "run",
                "/does/not/exist",
                "--set",
                &setting,
                "--out",
                &out.display().to_string(),
            ]);
            let said = stderr(&output);
            let is_refused = said.contains(name) && !said.contains("source not found");
            (is_refused == *is_allowed).then(|| format!("{setting}: {said}"))
        })
        .collect();
    assert!(problems.is_empty(), "{}", problems.join("\n"));
}
