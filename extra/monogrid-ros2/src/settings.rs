//! Settings of tracking and mapping from a file.

use anyhow::{Context, bail};
use monogrid_image::WorkingSize;
use monogrid_pipeline::Settings;
use monogrid_slam::SlamConfig;
use monogrid_slam::mapping::MappingConfig;
use serde::Deserialize;
use std::path::Path;

/// What a file may hold; what it does not name has its default.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct ConfigFile {
    profile: Option<String>,
    seed: u64,
    working_pixels: Option<usize>,
    slam: SlamConfig,
    mapping: MappingConfig,
}

/// Reads settings.
///
/// # Errors
/// A file that cannot be read, or settings that do not exist or are outside their range.
pub fn read_settings(path: &Path) -> anyhow::Result<Settings> {
    let which = || format!("configuration {}", path.display());
    let text = std::fs::read_to_string(path).with_context(which)?;
    parse_settings(&text).with_context(which)
}

fn parse_settings(text: &str) -> anyhow::Result<Settings> {
    let file: ConfigFile = toml::from_str(text)?;
    if let Some(profile) = file.profile.filter(|profile| profile != "default") {
        bail!(
            "profile is {profile:?}, but settings that are left out would be those of \"default\""
        );
    }
    file.slam.validate().map_err(anyhow::Error::msg)?;
    file.mapping.validate().map_err(anyhow::Error::msg)?;
    let allowed = WorkingSize::ALLOWED_PIXELS;
    let pixels = file.working_pixels.unwrap_or(WorkingSize::AUTOMATIC_PIXELS);
    if !allowed.contains(&pixels) {
        let (least, most) = (allowed.start(), allowed.end());
        bail!("working_pixels is {pixels}, allowed are {least} to {most}");
    }
    Ok(Settings {
        slam: file.slam,
        mapping: file.mapping,
        seed: file.seed,
        working_size: WorkingSize::Pixels(pixels),
        ..Settings::default()
    })
}

#[cfg(test)]
mod tests {
    use super::parse_settings;
    use monogrid_image::WorkingSize;

    #[test]
    fn settings_are_taken_or_refused_with_their_name() {
        let settings = parse_settings("seed = 7\n[mapping]\nresolution = 0.1\n").unwrap();
        assert_eq!((settings.seed, settings.mapping.resolution), (7, 0.1));
        assert_eq!(settings.working_size, WorkingSize::AUTOMATIC);
        let small = parse_settings("working_pixels = 120000\n").unwrap();
        assert_eq!(small.working_size, WorkingSize::Pixels(120_000));
        for (text, named) in [
            ("[mapping]\nresolution = -1.0\n", "resolution"),
            ("[mapping]\nresolutio = 0.1\n", "resolutio"),
            ("profile = \"thesis\"\n", "thesis"),
            ("working_pixels = 0\n", "working_pixels"),
        ] {
            let error = parse_settings(text).unwrap_err();
            assert!(format!("{error:#}").contains(named), "{error:#}");
        }
    }
}
