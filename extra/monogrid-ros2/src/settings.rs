//! Settings of tracking and mapping from a file.

use anyhow::{Context, bail};
use monogrid_image::WorkingSize;
use monogrid_mapping::MAPPING;
use monogrid_pipeline::Settings;
use monogrid_slam::settings::{SLAM, apply};
use std::io::{Write, stderr};
use std::path::Path;
use toml::Table;

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
    let mut settings = Settings::default();
    let mut ignored = Vec::new();
    for (key, value) in &text.parse::<Table>()? {
        match key.as_str() {
            "profile" if value.as_str() == Some("default") => {}
            "profile" => bail!(
                "profile is {value}, but settings that are left out would be those of \"default\""
            ),
            "seed" => settings.seed = value.clone().try_into().context("seed")?,
            "working_pixels" => {
                let pixels = value.clone().try_into().context("working_pixels")?;
                settings.working_size = WorkingSize::Pixels(pixels);
            }
            "slam" => ignored.extend(apply(SLAM, &mut settings.slam, key, value)?),
            "mapping" => ignored.extend(apply(MAPPING, &mut settings.mapping, key, value)?),
            _ => bail!("there is no setting or section `{key}`"),
        }
    }
    settings.slam.validate()?;
    settings.mapping.validate()?;
    let allowed = WorkingSize::ALLOWED_PIXELS;
    if let WorkingSize::Pixels(pixels) = settings.working_size
        && !allowed.contains(&pixels)
    {
        let (least, most) = (allowed.start(), allowed.end());
        bail!("working_pixels is {pixels}, allowed are {least} to {most}");
    }
    if !ignored.is_empty() {
        let names = ignored.join(", ");
        // a message that cannot be written is no reason to stop
        let _ = writeln!(
            stderr(),
            "warning: no longer settings, without effect: {names}"
        );
    }
    Ok(settings)
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
        // a name of earlier versions
        let old = parse_settings("[mapping]\nrims = 1\nresolution = 0.1\n").unwrap();
        assert_eq!(old.mapping.resolution, 0.1);
        for (text, named) in [
            ("[mapping]\nresolution = -1.0\n", "resolution"),
            ("[mapping]\nresolutio = 0.1\n", "resolutio"),
            ("profile = \"thesis\"\n", "thesis"),
            ("working_pixels = 0\n", "working_pixels"),
            ("sed = 1\n", "`sed`"),
        ] {
            let error = parse_settings(text).unwrap_err();
            assert!(format!("{error:#}").contains(named), "{error:#}");
        }
    }
}
