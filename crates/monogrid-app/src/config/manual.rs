//! docs/configuration.md, printed from the table of settings.
//!
//! After a change of settings: `UPDATE_DOCS=1 cargo test -p monogrid-app --lib manual`.

use super::RunConfig;
use crate::args::Profile;
use monogrid_image::WorkingSize;
use monogrid_mapping::MAPPING;
use monogrid_slam::settings::{SLAM, Settings};
use std::fmt::{Display, Write};
use std::path::Path;

const HEAD: &str = "# Configuration

A run is decided by its input and by the settings below. Later sources win: the profile
(`--profile default`, `fast` or `thesis`), a file (`--config FILE`, TOML), `--set KEY=VALUE` (for
example `--set mapping.resolution=0.02`), and the other options of the command line. Every run
writes its settings to `config.toml`, which `--config` reads again.

A profile also fixes parameters that are not settings. Unknown names and values outside their range
are errors. Names that only earlier versions had are read with a warning and have no effect.

Where a profile differs from the default, its value stands below it. Ranges include their ends. Map
units are metres where the scale is known.

## Top level

| key | default | range | meaning |
|---|---|---|---|
";

/// A cell of a table.
fn cell(text: &str) -> String {
    text.replace('|', "\\|")
}

/// The value in every profile that has another one than the default.
fn defaults(value: &dyn Fn(&RunConfig) -> String) -> String {
    let of = |profile| value(&RunConfig::of(profile));
    let usual = of(Profile::Default);
    let mut text = format!("`{usual}`");
    for profile in [Profile::Fast, Profile::Thesis] {
        let own = of(profile);
        if own != usual {
            let _ = write!(text, "<br>{}: `{own}`", profile.name());
        }
    }
    text
}

fn range<T: Display>(low: T, high: T, unit: &str) -> String {
    format!("{low} to {high} {unit}").trim_end().to_owned()
}

fn row(key: &str, defaults: &str, ranges: &[String], meaning: &str, reason: &str) -> String {
    let (ranges, meaning) = (ranges.join(", "), cell(meaning));
    format!("| `{key}` | {defaults} | {ranges} | {meaning} {reason} |\n")
}

fn sections<C>(settings: Settings<C>, of: fn(&RunConfig) -> &C, manual: &mut String) {
    let mut section = "";
    for setting in settings.rows {
        let (own, key) = setting.name.rsplit_once('.').unwrap();
        if own != section {
            let _ = write!(
                manual,
                "\n## `[{own}]`\n\n| key | default | range | meaning |\n|---|---|---|---|\n"
            );
            section = own;
        }
        let ranges = setting.ranges.iter();
        let ranges: Vec<String> = ranges
            .map(|(low, high)| range(low, high, setting.unit))
            .collect();
        let defaults = defaults(&|config| setting.value(of(config)).to_string());
        manual.push_str(&row(
            key,
            &defaults,
            &ranges,
            setting.meaning,
            setting.reason,
        ));
    }
}

fn manual() -> String {
    let mut manual = HEAD.to_owned();
    manual.push_str(&row(
        "profile",
        "`\"default\"`",
        &[],
        "The complete set of values to start from: `default`, `fast` or `thesis`.",
        "`fast` is for small computers, `thesis` repeats LSD-SLAM and the thesis.",
    ));
    manual.push_str(&row(
        "seed",
        &defaults(&|config| config.seed.to_string()),
        &[],
        "Seed of everything random.",
        "Change it to see how much a result depends on chance.",
    ));
    let (least, most) = WorkingSize::ALLOWED_PIXELS.into_inner();
    manual.push_str(&row(
        "working_pixels",
        &defaults(&|config| config.working_pixels.to_string()),
        &[range(least, most, "pixels")],
        "Larger images are reduced to about this many pixels, where `--size` does not give their \
         size.",
        "Lower it for speed, raise it for detail.",
    ));
    sections(MAPPING, |config| &config.mapping, &mut manual);
    sections(SLAM, |config| &config.slam, &mut manual);
    manual
}

#[test]
fn the_document_is_what_the_table_of_settings_prints() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/configuration.md");
    let manual = manual();
    if std::env::var_os("UPDATE_DOCS").is_some() {
        std::fs::write(&path, &manual).unwrap();
    }
    let written = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(
        written == manual,
        "docs/configuration.md is not what the settings say; run \
         UPDATE_DOCS=1 cargo test -p monogrid-app --lib manual"
    );
    let rows = manual.lines().filter(|line| line.starts_with("| `"));
    assert!(rows.count() <= 80);
}
