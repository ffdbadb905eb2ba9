//! `docs/configuration.md` is made from the comments on the settings, so that it cannot lie.
//!
//! After a change of settings: `UPDATE_DOCS=1 cargo test -p monogrid --test configuration`.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "a test may panic and talk"
)]

use monogrid_slam::SlamConfig;
use monogrid_slam::mapping::MappingConfig;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use toml::{Table, Value};

/// A field of a struct: name, type, comment.
type Field = (String, String, String);

fn crates() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// All Rust sources below a folder.
fn sources(folder: &Path, out: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, out);
        } else if path.extension().is_some_and(|e| e == "rs") {
            out.push(path);
        }
    }
}

/// Fields of every struct whose name ends in `Config`.
fn structs() -> BTreeMap<String, Vec<Field>> {
    let mut files = Vec::new();
    for name in [
        "monogrid-slam",
        "monogrid-depth",
        "monogrid-alignment",
        "monogrid-inertial",
    ] {
        sources(&crates().join(name).join("src"), &mut files);
    }
    let mut out = BTreeMap::new();
    for file in files {
        let text = std::fs::read_to_string(file).unwrap();
        let mut current: Option<(String, Vec<Field>)> = None;
        let mut comment = String::new();
        for line in text.lines() {
            let line = line.trim();
            if let Some(rest) = line.strip_prefix("pub struct ") {
                let name = rest.trim_end_matches(['{', ' ']).to_owned();
                if name.ends_with("Config") && rest.ends_with('{') {
                    current = Some((name, Vec::new()));
                }
                comment.clear();
            } else if let Some(text) = line.strip_prefix("///") {
                comment.push_str(text);
            } else if line == "}" {
                out.extend(current.take());
            } else if let (Some((_, fields)), Some(rest)) =
                (&mut current, line.strip_prefix("pub "))
            {
                if let Some((name, kind)) = rest.split_once(": ") {
                    let kind = kind.trim_end_matches(',').to_owned();
                    fields.push((name.to_owned(), kind, comment.trim().to_owned()));
                }
                comment.clear();
            } else if !line.starts_with('#') {
                comment.clear();
            }
        }
    }
    out
}

fn section(
    manual: &mut String,
    path: &str,
    name: &str,
    values: &Table,
    structs: &BTreeMap<String, Vec<Field>>,
) {
    let fields = structs
        .get(name)
        .unwrap_or_else(|| panic!("no struct {name} for [{path}]"));
    let _ = writeln!(manual, "\n## `[{path}]`\n");
    let mut inner = Vec::new();
    let mut rows = String::new();
    for (field, kind, comment) in fields {
        match values.get(field) {
            Some(Value::Table(table)) if structs.contains_key(kind) => {
                inner.push((format!("{path}.{field}"), kind, table));
            }
            Some(value) => {
                assert!(!comment.is_empty(), "{name}.{field} has no comment");
                let comment = comment.replace('|', "\\|");
                let _ = writeln!(rows, "| `{field}` | `{}` | {comment} |", short(value));
            }
            // an option that is not set by default
            None => {
                let _ = writeln!(rows, "| `{field}` | | {comment} |");
            }
        }
    }
    if !rows.is_empty() {
        let _ = writeln!(manual, "| key | default | meaning |\n|---|---|---|");
        manual.push_str(&rows);
    }
    for (path, kind, table) in inner {
        section(manual, &path, kind, table, structs);
    }
}

/// A value without the noise of `f32` printed as `f64`.
fn short(value: &Value) -> String {
    match value {
        Value::Float(float) => {
            let single = *float as f32;
            if f64::from(single).to_bits() == float.to_bits() {
                format!("{single}")
            } else {
                format!("{float}")
            }
        }
        other => other.to_string().replace('\n', " "),
    }
}

#[test]
fn the_manual_says_what_the_comments_say() {
    let structs = structs();
    let slam = Table::try_from(SlamConfig::default()).unwrap();
    let mapping = Table::try_from(MappingConfig::default()).unwrap();
    let mut manual = String::from(
        "# Configuration\n\n\
         A run is decided by its input and these settings. They come from, later ones win: the profile (`--profile default`,\n\
         `fast` or `thesis`), a file (`--config FILE`, TOML), `--set KEY=VALUE` (e.g. `--set mapping.resolution=0.02`), and the\n\
         options of the command line. Every run writes what it used into `config.toml`, which can be given to `--config`.\n\
         Unknown keys and values outside their range are errors. The defaults below are those of the profile `default`.\n\n\
         At the top level stand `profile` (`\"default\"`, `\"fast\"` or `\"thesis\"`), `seed` (of everything random, default 0) and\n\n\
         | key | default | meaning |\n|---|---|---|\n\
         | `working_pixels` | `307200` | About how many pixels the images have that are worked with, where `--size` does not say it; smaller \
         ones stay as they are. Default 307200 (640x480), in the profile `fast` 120000 (400x300). Range [4096, 4000000]. |\n",
    );
    section(&mut manual, "mapping", "MappingConfig", &mapping, &structs);
    section(&mut manual, "slam", "SlamConfig", &slam, &structs);
    let path = crates().join("../docs/configuration.md");
    if std::env::var_os("UPDATE_DOCS").is_some() {
        std::fs::write(&path, &manual).unwrap();
    }
    let written = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(
        written == manual,
        "docs/configuration.md is not what the comments say; run \
         UPDATE_DOCS=1 cargo test -p monogrid --test configuration"
    );
}
