//! The configuration of a run: profile, then file, then `--set`, then options; written out as it
//! was used.

use crate::args::{MappingArgs, Profile};
use crate::process::failure::{Classify, Failure};
use monogrid_datasets::read_file;
use monogrid_image::WorkingSize;
use monogrid_mapping::{MAPPING, MappingConfig};
use monogrid_pipeline::Settings;
use monogrid_slam::SlamConfig;
use monogrid_slam::settings::{self, SLAM};
use std::path::Path;
use toml::{Table, Value};

/// First line of every `config.toml` that we write.
const CONFIG_MARKER: &str = "# effective configuration of a monogrid run";

/// Everything that decides the result of a run, besides its input.
#[derive(Clone, Debug, PartialEq)]
pub struct RunConfig {
    /// The configuration that this one started from.
    pub profile: Profile,
    /// Seed of everything random.
    pub seed: u64,
    /// About how many pixels the images have that are worked with; smaller ones stay as they are.
    pub working_pixels: usize,
    /// Tracking and depth.
    pub slam: SlamConfig,
    /// Occupancy maps.
    pub mapping: MappingConfig,
}

impl RunConfig {
    /// The complete configuration of a profile.
    pub fn of(profile: Profile) -> Self {
        let settings = Settings::of_profile(profile.name()).unwrap_or_default();
        Self {
            profile,
            seed: settings.seed,
            working_pixels: match settings.working_size {
                WorkingSize::Pixels(pixels) => pixels,
                _ => WorkingSize::AUTOMATIC_PIXELS,
            },
            slam: settings.slam,
            mapping: settings.mapping,
        }
    }

    /// The configuration of a profile with the values of a file and of `key=value` settings in
    /// place.
    ///
    /// The profile is `profile`, else what the file says, else the default one.
    pub fn resolve(
        profile: Option<Profile>,
        file: Option<&Path>,
        settings: &[String],
    ) -> Result<Self, Failure> {
        let content = file.map(read_table).transpose()?.unwrap_or_default();
        let named = content.get("profile").map(|value| {
            value.clone().try_into::<Profile>().map_err(|_| {
                Failure::input(format!(
                    "profile is {value} in {}, expected \"default\", \"fast\" or \"thesis\"",
                    file.unwrap_or(Path::new("")).display()
                ))
            })
        });
        let profile = profile.or(named.transpose()?).unwrap_or_default();
        let mut config = Self::of(profile);
        if let Some(path) = file {
            let place = format!("configuration {}", path.display());
            config.change(content, &place)?;
        }
        config.with_settings(settings)
    }

    /// These settings with those of `--set key=value` in place.
    pub fn with_settings(mut self, settings: &[String]) -> Result<Self, Failure> {
        for setting in settings {
            self.change(table_of(setting)?, &format!("--set {setting}"))?;
        }
        Ok(self)
    }

    /// As [`Self::resolve`], with nothing of the file but its profile and its section `[mapping]`,
    /// so that the other settings may be those of another version.
    pub fn resolve_mapping(profile: Option<Profile>, file: Option<&Path>) -> Result<Self, Failure> {
        let Some(path) = file else {
            return Self::resolve(profile, None, &[]);
        };
        let (mut config, content) = Self::of_mapping(profile, read_table(path)?);
        config.change(content, &format!("configuration {}", path.display()))?;
        Ok(config)
    }

    /// The mapping settings of a recorded configuration; `None` when they cannot be understood.
    pub fn recorded_mapping(text: &str) -> Option<Self> {
        let content = with_explicit_resolution(text.parse().ok()?);
        let (mut config, content) = Self::of_mapping(None, content);
        config.take(&content).ok()?;
        Some(config)
    }

    /// All settings of a recorded configuration; `None` when they cannot be understood.
    pub fn recorded(text: &str) -> Option<Self> {
        let content = with_explicit_resolution(text.parse().ok()?);
        let named = content.get("profile").cloned();
        let profile = named.map(Value::try_into).transpose().ok()?;
        let mut config = Self::of(profile.unwrap_or_default());
        config.take(&content).ok()?;
        Some(config)
    }

    /// The configuration of a profile, and what a file says of maps.
    fn of_mapping(profile: Option<Profile>, content: Table) -> (Self, Table) {
        let named = content.get("profile").cloned();
        let named = named.and_then(|value| value.try_into().ok());
        let config = Self::of(profile.or(named).unwrap_or_default());
        let mapping = content.into_iter().filter(|(key, _)| key == "mapping");
        (config, mapping.collect())
    }

    /// Takes over settings from a place; those that are settings no longer have no effect, which is
    /// said.
    fn change(&mut self, content: Table, place: &str) -> Result<(), Failure> {
        let ignored = self.take(&with_explicit_resolution(content));
        let ignored = ignored.map_err(|error| Failure::input(format!("{place}: {error}")))?;
        if let Some(said) = no_longer_settings(&ignored) {
            eprintln!("warning: {place}: {said}");
        }
        Ok(())
    }

    /// Takes over settings; returns the names among them that are settings no longer.
    fn take(&mut self, content: &Table) -> Result<Vec<String>, String> {
        let mut ignored = Vec::new();
        for (key, value) in content {
            match key.as_str() {
                // that is where these settings start from
                "profile" => {}
                "seed" => self.seed = whole_number(key, value)?,
                "working_pixels" => self.working_pixels = whole_number(key, value)?,
                "slam" => ignored.extend(
                    settings::apply(SLAM, &mut self.slam, key, value).map_err(|e| e.to_string())?,
                ),
                "mapping" => ignored.extend(
                    settings::apply(MAPPING, &mut self.mapping, key, value)
                        .map_err(|e| e.to_string())?,
                ),
                _ => {
                    return Err(format!(
                        "there is no setting or section `{key}`; expected profile, seed, \
                         working_pixels, mapping or slam"
                    ));
                }
            }
        }
        Ok(ignored)
    }

    /// Applies the options of the command line.
    pub fn apply(&mut self, args: &MappingArgs) {
        let mapping = &mut self.mapping;
        if let Some(model) = args.sensor_model {
            mapping.sensor_model = model.into();
        }
        if let Some(resolution) = args.resolution {
            mapping.resolution = resolution;
            mapping.auto_resolution = false;
        }
        mapping.buffer = args.buffer.unwrap_or(mapping.buffer);
        mapping.significance = args.significance.unwrap_or(mapping.significance);
        mapping.max_range = args.max_range.unwrap_or(mapping.max_range);
        if let Some(integration) = args.integration {
            mapping.integration = integration.into();
        }
    }

    /// Checks the ranges of all settings.
    pub fn validate(&self) -> Result<(), Failure> {
        let (least, most) = WorkingSize::ALLOWED_PIXELS.into_inner();
        let pixels = self.working_pixels;
        if !(least..=most).contains(&pixels) {
            let said = format!("working_pixels is {pixels}, allowed are {least} to {most}");
            return Err(Failure::input(said));
        }
        self.slam.validate().map_err(Failure::input)?;
        self.mapping.validate().map_err(Failure::input)
    }

    /// The size of working images, where no option gives it.
    pub fn working_size(&self) -> WorkingSize {
        WorkingSize::Pixels(self.working_pixels)
    }

    /// The content of `config.toml`.
    pub fn to_toml(&self) -> Result<String, Failure> {
        let mut table = Table::new();
        table.insert("profile".into(), Value::String(self.profile.name().into()));
        // larger numbers do not fit into TOML
        let seed = i64::try_from(self.seed).map_err(Failure::running)?;
        table.insert("seed".into(), Value::Integer(seed));
        let pixels = i64::try_from(self.working_pixels).map_err(Failure::running)?;
        table.insert("working_pixels".into(), Value::Integer(pixels));
        let slam = settings::to_table(SLAM, &self.slam, "slam");
        table.insert("slam".into(), Value::Table(slam));
        let mapping = settings::to_table(MAPPING, &self.mapping, "mapping");
        table.insert("mapping".into(), Value::Table(mapping));
        let body = toml::to_string(&table).map_err(Failure::running)?;
        Ok(format!("{CONFIG_MARKER}\n{body}"))
    }
}

fn whole_number<T: TryFrom<i64>>(key: &str, value: &Value) -> Result<T, String> {
    let number = value.as_integer().and_then(|number| number.try_into().ok());
    number.ok_or_else(|| format!("{key}: found {value}, expected a whole number"))
}

/// Names in a warning; the others are counted.
const NAMED: usize = 3;

/// What is wrong with names that are settings no longer.
fn no_longer_settings(names: &[String]) -> Option<String> {
    match names {
        [] => None,
        [name] => Some(format!("{name} is no longer a setting and has no effect")),
        names => {
            let named = names.iter().take(NAMED).cloned().collect::<Vec<_>>();
            let more = match names.len().saturating_sub(NAMED) {
                0 => String::new(),
                more => format!(" and {more} more"),
            };
            Some(format!(
                "{} names are no longer settings and have no effect: {}{more}",
                names.len(),
                named.join(", ")
            ))
        }
    }
}

/// Largest configuration that is read.
const MAX_CONFIG_BYTES: u64 = 1 << 20;

/// A file that names the edge of a cell does not ask for that of the scene.
fn with_explicit_resolution(mut content: Table) -> Table {
    if let Some(Value::Table(mapping)) = content.get_mut("mapping")
        && mapping.contains_key("resolution")
        && !mapping.contains_key("auto_resolution")
    {
        mapping.insert("auto_resolution".to_owned(), Value::Boolean(false));
    }
    content
}

fn read_table(path: &Path) -> Result<Table, Failure> {
    let bytes = read_file(path, MAX_CONFIG_BYTES).bad_input()?;
    let text = String::from_utf8_lossy(&bytes);
    text.parse().map_err(|error: toml::de::Error| {
        Failure::input(format!(
            "configuration {} is not TOML: {}",
            path.display(),
            error.to_string().trim_end()
        ))
    })
}

/// `a.b.c=value` as a file would have it; the value is TOML, or a string when it is not.
fn table_of(setting: &str) -> Result<Table, Failure> {
    let Some((key, text)) = setting.split_once('=') else {
        let said = format!("--set {setting}: expected KEY=VALUE, e.g. mapping.resolution=0.02");
        return Err(Failure::input(said));
    };
    if key.trim() == "profile" {
        return Err(Failure::input(format!(
            "--set {setting}: a profile is all settings at once; choose it with --profile NAME, or \
             with `profile = \"NAME\"` in a file"
        )));
    }
    let text = text.trim();
    let parsed = format!("value = {text}").parse::<Table>().ok();
    let value = parsed.and_then(|mut parsed| parsed.remove("value"));
    let value = value.unwrap_or_else(|| Value::String(text.to_owned()));
    let mut path: Vec<&str> = key.trim().split('.').collect();
    let first = path.remove(0);
    let value = path.into_iter().rev().fold(value, |value, part| {
        Value::Table(Table::from_iter([(part.to_owned(), value)]))
    });
    Ok(Table::from_iter([(first.to_owned(), value)]))
}

#[cfg(test)]
mod manual;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::args::SensorModelArg;
    use monogrid_mapping::MapQuality;
    use monogrid_mapping::{AutoLength, SensorModelKind};

    fn message(failure: &Failure) -> String {
        match failure {
            Failure::Input(error) | Failure::Running(error) => error.to_string(),
            Failure::Interrupted => panic!("nobody interrupted"),
        }
    }

    #[test]
    fn profiles_round_trip_through_their_file() {
        for profile in [Profile::Default, Profile::Fast, Profile::Thesis] {
            let config = RunConfig::of(profile);
            config.validate().unwrap();
            let dir = tempfile::tempdir().unwrap();
            let path = dir.path().join("config.toml");
            std::fs::write(&path, config.to_toml().unwrap()).unwrap();
            assert_eq!(RunConfig::resolve(None, Some(&path), &[]).unwrap(), config);
        }
        assert_ne!(
            RunConfig::of(Profile::Default).slam,
            RunConfig::of(Profile::Thesis).slam
        );
    }

    #[test]
    fn the_fast_profile_has_fewer_pixels_quicker_maps_more_time_to_start_and_one_round_at_the_end()
    {
        let mut fast = RunConfig::of(Profile::Fast);
        assert_eq!(fast.working_size().resolve(640, 480), (400, 300));
        assert_eq!(fast.mapping.quality, MapQuality::Fast);
        let default = RunConfig::of(Profile::Default);
        fast.profile = default.profile;
        fast.working_pixels = default.working_pixels;
        fast.mapping.quality = default.mapping.quality;
        let buffered = &mut fast.slam.initialization.max_buffered_frames;
        assert_eq!(*buffered, 600);
        *buffered = default.slam.initialization.max_buffered_frames;
        let rounds = &mut fast.slam.sparse.final_rounds;
        assert_eq!(*rounds, 1);
        *rounds = default.slam.sparse.final_rounds;
        assert_eq!(fast, default);
    }

    #[test]
    fn later_sources_win() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("c.toml");
        std::fs::write(
            &path,
            "seed = 5\n[mapping]\nresolution = 0.1\nmax_range = 4.0\n",
        )
        .unwrap();
        let settings = ["mapping.resolution=0.2".to_owned(), "seed=7".to_owned()];
        let mut config = RunConfig::resolve(None, Some(&path), &settings).unwrap();
        config.apply(&MappingArgs {
            sensor_model: Some(SensorModelArg::Andert),
            buffer: Some(AutoLength::Fixed(0.3)),
            ..MappingArgs::default()
        });
        let mapping = &config.mapping;
        assert_eq!(config.seed, 7);
        assert!((mapping.resolution - 0.2).abs() < 1e-12);
        assert!(!mapping.auto_resolution);
        assert!((mapping.max_range - 4.0).abs() < 1e-12);
        assert_eq!(mapping.sensor_model, SensorModelKind::Andert);
        assert_eq!(mapping.buffer, AutoLength::Fixed(0.3));
    }

    #[test]
    fn whoever_names_the_edge_of_a_cell_gets_it() {
        let of = |settings: &[&str]| {
            let settings: Vec<String> = settings.iter().map(|&s| s.to_owned()).collect();
            RunConfig::resolve(None, None, &settings).unwrap().mapping
        };
        assert!(of(&[]).auto_resolution);
        assert!(of(&["mapping.max_range=4.0"]).auto_resolution);
        assert!(!of(&["mapping.resolution=0.1"]).auto_resolution);
        let both = ["mapping.resolution=0.1", "mapping.auto_resolution=true"];
        assert!(of(&both).auto_resolution);
        let mut config = RunConfig::of(Profile::Default);
        config.apply(&MappingArgs {
            resolution: Some(0.02),
            ..MappingArgs::default()
        });
        assert!(!config.mapping.auto_resolution);
        // what an effective configuration says, and what one of before this setting says
        let text = RunConfig::of(Profile::Default).to_toml().unwrap();
        assert!(RunConfig::recorded(&text).unwrap().mapping.auto_resolution);
        let earlier = RunConfig::recorded("[mapping]\nresolution = 0.05\n").unwrap();
        assert!(!earlier.mapping.auto_resolution);
    }

    #[test]
    fn whole_numbers_and_words_are_understood() {
        let settings = [
            "mapping.max_range=3",
            "mapping.sensor_model=ideal",
            "mapping.buffer=1",
        ];
        let settings = settings.map(str::to_owned);
        let config = RunConfig::resolve(None, None, &settings).unwrap();
        assert!((config.mapping.max_range - 3.0).abs() < 1e-12);
        assert_eq!(config.mapping.sensor_model, SensorModelKind::Ideal);
        assert_eq!(config.mapping.buffer, AutoLength::Fixed(1.0));
    }

    #[test]
    fn unknown_and_malformed_settings_are_named() {
        for (setting, expected) in [
            ("mapping.resolutoin=0.1", "resolutoin"),
            ("mapping.resolutoin=0.1", "mapping.resolution,"),
            ("mapping.filtre.skip_keyframes=1", "filtre"),
            ("maping.resolution=0.1", "`maping`"),
            ("mapping.resolution", "KEY=VALUE"),
            ("mapping.resolution=wide", "mapping.resolution=wide"),
            ("profile=thesis", "--profile"),
        ] {
            let failure = RunConfig::resolve(None, None, &[setting.to_owned()]).unwrap_err();
            let text = message(&failure);
            assert!(text.contains(expected), "{setting}: {text}");
            assert!(matches!(failure, Failure::Input(_)));
        }
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("c.toml");
        for bad in ["[mapping]\nx = 1", "profile = \"quick\"", "nonsense"] {
            std::fs::write(&path, bad).unwrap();
            let failure = RunConfig::resolve(None, Some(&path), &[]).unwrap_err();
            assert!(message(&failure).contains("c.toml"));
        }
        assert!(RunConfig::resolve(None, Some(Path::new("/does/not/exist")), &[]).is_err());
    }

    #[test]
    fn mapping_settings_are_found_in_files_of_other_versions() {
        let text =
            "profile = \"thesis\"\nold = 1\n[slam]\nolder = 2\n[mapping]\nresolution = 0.3\n";
        let config = RunConfig::recorded_mapping(text).unwrap();
        let expected = MappingConfig {
            resolution: 0.3,
            ..MappingConfig::thesis()
        };
        assert_eq!(config.mapping, expected);
        assert!(RunConfig::recorded_mapping("[mapping]\nnew = 1").is_none());
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("c.toml");
        std::fs::write(&path, text).unwrap();
        let config = RunConfig::resolve_mapping(Some(Profile::Default), Some(&path)).unwrap();
        assert!((config.mapping.resolution - 0.3).abs() < 1e-12);
        assert_eq!(config.mapping.buffer, AutoLength::Auto);
    }

    #[test]
    fn names_that_are_settings_no_longer_are_read_and_have_no_effect() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("c.toml");
        let text = "profile = \"thesis\"\n[mapping]\nmax_range = 4.0\n[mapping.fill]\nsamples = \
            60\n[mapping.rims]\nx = 1\n[slam.tracking]\nmin_points = 9\n";
        std::fs::write(&path, text).unwrap();
        let mut expected = RunConfig::of(Profile::Thesis);
        expected.mapping.max_range = 4.0;
        assert_eq!(
            RunConfig::resolve(None, Some(&path), &[]).unwrap(),
            expected
        );
        assert_eq!(RunConfig::recorded(text).unwrap(), expected);
        assert_eq!(RunConfig::recorded_mapping(text).unwrap(), expected);
        let mapping = RunConfig::resolve_mapping(None, Some(&path)).unwrap();
        assert_eq!(mapping, expected);
        let set = ["slam.depth.max_var=1", "mapping.fill.samples=60"].map(str::to_owned);
        let config = RunConfig::resolve(None, None, &set).unwrap();
        assert_eq!(config, RunConfig::of(Profile::Default));
        let content = text.parse().unwrap();
        let ignored = RunConfig::of(Profile::Default).take(&content).unwrap();
        let names = [
            "mapping.fill.samples",
            "mapping.rims",
            "slam.tracking.min_points",
        ];
        assert_eq!(ignored, names);
    }

    #[test]
    fn a_warning_names_the_first_names_and_counts_the_others() {
        let names = |n: usize| -> Vec<String> { (0..n).map(|i| format!("a{i}")).collect() };
        assert_eq!(no_longer_settings(&[]), None);
        let said = |n| no_longer_settings(&names(n)).unwrap();
        assert_eq!(said(1), "a0 is no longer a setting and has no effect");
        assert!(said(3).starts_with("3 names") && said(3).ends_with("a0, a1, a2"));
        assert!(said(9).ends_with("a0, a1, a2 and 6 more"));
    }

    /// The defaults are those of the profile; what a profile has beyond its public settings comes
    /// back with its name.
    #[test]
    fn parameters_that_are_no_settings_come_back_with_the_profile() {
        let thesis = RunConfig::of(Profile::Thesis);
        let text = thesis.to_toml().unwrap();
        assert!(!text.contains("frame_choice") && !text.contains("band_by_slope"));
        let back = RunConfig::recorded(&text).unwrap();
        assert_eq!(back.slam.depth, thesis.slam.depth);
        assert_eq!(back, thesis);
    }

    #[test]
    fn a_profile_on_the_command_line_starts_from_that_profile() {
        let config = RunConfig::resolve(Some(Profile::Thesis), None, &[]).unwrap();
        assert_eq!(config, RunConfig::of(Profile::Thesis));
    }
}
