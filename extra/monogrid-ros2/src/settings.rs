//! Settings of tracking and mapping from a file.

use anyhow::{Context, bail};
use monogrid_image::WorkingSize;
use monogrid_mapping::MAPPING;
use monogrid_pipeline::Settings;
use monogrid_slam::settings::{SLAM, apply};
use std::io::{Write, stderr};
use std::path::Path;
use toml::Table;

/// The settings of a profile, with those of a file in their place; the profile is the one that is
/// named, else that of the file, else `default`.
///
/// # Errors
/// A file that cannot be read, or settings that do not exist or are outside their range.
pub fn read_settings(profile: Option<&str>, path: Option<&Path>) -> anyhow::Result<Settings> {
    let Some(path) = path else {
        return parse_settings(profile, "");
    };
    let which = || format!("configuration {}", path.display());
    let text = std::fs::read_to_string(path).with_context(which)?;
    parse_settings(profile, &text).with_context(which)
}

fn parse_settings(profile: Option<&str>, text: &str) -> anyhow::Result<Settings> {
    let table = text.parse::<Table>()?;
    let named = table.get("profile").map(|named| {
        let profile = named.as_str();
        profile.with_context(|| format!("profile is {named}, expected a name in quotes"))
    });
    let profile = profile.or(named.transpose()?).unwrap_or("default");
    let mut settings = Settings::of_profile(profile).with_context(|| {
        format!("profile is {profile:?}, expected \"default\", \"fast\" or \"thesis\"")
    })?;
    let mut ignored = Vec::new();
    for (key, value) in &table {
        match key.as_str() {
            "profile" => {}
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
    use monogrid_mapping::MappingConfig;

    #[test]
    fn every_profile_is_taken() {
        let thesis = parse_settings(None, "profile = \"thesis\"\n[mapping]\nbuffer = 0.3\n");
        let mapping = thesis.unwrap().mapping;
        assert_eq!(mapping.sensor_model, MappingConfig::thesis().sensor_model);
        assert_ne!(mapping.buffer, MappingConfig::thesis().buffer);
        assert_eq!(mapping.clamp, MappingConfig::thesis().clamp);
        let fast = parse_settings(Some("fast"), "profile = \"thesis\"\n").unwrap();
        assert_eq!(fast.working_size, WorkingSize::Pixels(120_000));
        assert_eq!(fast.mapping.clamp, MappingConfig::default().clamp);
    }

    #[test]
    fn settings_are_taken_or_refused_with_their_name() {
        let parse_settings = |text: &str| parse_settings(None, text);
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
            ("profile = \"thesi\"\n", "thesi"),
            ("profile = 1\n", "profile is 1"),
            ("working_pixels = 0\n", "working_pixels"),
            ("sed = 1\n", "`sed`"),
        ] {
            let error = parse_settings(text).unwrap_err();
            assert!(format!("{error:#}").contains(named), "{error:#}");
        }
    }
}
