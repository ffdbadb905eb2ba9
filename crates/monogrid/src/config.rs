//! The configuration of a run: profile, then file, then `--set`, then options; written out as it was used.

use crate::args::{IntegrationArg, MappingArgs, Profile, SensorModelArg};
use crate::failure::{Classify, Failure};
use monogrid_datasets::read_file;
use monogrid_image::WorkingSize;
use monogrid_slam::SlamConfig;
use monogrid_slam::mapping::{IntegrationRule, MapQuality, MappingConfig, SensorModelKind};
use serde::{Deserialize, Serialize};
use std::path::Path;
use toml::{Table, Value};

/// First line of every `config.toml` that we write.
const CONFIG_MARKER: &str = "# effective configuration of a monogrid run";

/// Settings and sections that earlier versions had: what they did brought nothing on recordings
/// that had no part in choosing it (docs/studies.md, *Fewer stages*), or is in `mapping.planes`
/// now. Recordings may still name them; a file or `--set` must not.
const GONE: [&str; 7] = [
    "mapping.envelope",
    "mapping.fill.max_against",
    "mapping.fill.max_witnesses",
    "mapping.fill.tolerance",
    "mapping.rims",
    "mapping.straighten",
    "mapping.unseen",
];

/// Everything that decides the result of a run, besides its input.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
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
        let mut config = Self {
            profile,
            seed: 0,
            working_pixels: WorkingSize::AUTOMATIC_PIXELS,
            slam: SlamConfig::default(),
            mapping: MappingConfig::default(),
        };
        match profile {
            Profile::Default => {}
            Profile::Fast => {
                config.working_pixels = 400 * 300;
                config.mapping.quality = MapQuality::Fast;
                // in smaller images the start takes longer to be sure of; as many more of them fit in the same memory
                config.slam.initialization.max_buffered_frames *= 2;
                // the second round moves points by hundredths of a pixel
                config.slam.sparse.final_rounds = 1;
            }
            Profile::Thesis => {
                config.slam = SlamConfig::thesis();
                config.mapping = MappingConfig::thesis();
            }
        }
        config
    }

    /// The configuration of a profile with the values of a file and of `key=value` settings in place.
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
        let mut table = Table::try_from(Self::of(profile)).map_err(Failure::running)?;
        merge(&mut table, content);
        table.insert("profile".into(), Value::String(profile.name().into()));
        let from_file = Self::from_table(&table, &|error| match file {
            Some(path) => format!("configuration {}: {error}", path.display()),
            None => error,
        })?;
        from_file.with_settings(settings)
    }

    /// These settings with those of `--set key=value` in place.
    pub fn with_settings(self, settings: &[String]) -> Result<Self, Failure> {
        if settings.is_empty() {
            return Ok(self);
        }
        let mut table = Table::try_from(&self).map_err(Failure::running)?;
        let mut config = self;
        for setting in settings {
            apply_setting(&mut table, setting)?;
            config = Self::from_table(&table, &|error| format!("--set {setting}: {error}"))?;
        }
        Ok(config)
    }

    /// As [`Self::resolve`], with nothing of the file but its profile and its section `[mapping]`, so that
    /// the other settings may be those of another version.
    pub fn resolve_mapping(profile: Option<Profile>, file: Option<&Path>) -> Result<Self, Failure> {
        let Some(path) = file else {
            return Self::resolve(profile, None, &[]);
        };
        let content = read_table(path)?;
        Self::of_mapping_table(profile, content)
            .map_err(|error| Failure::input(format!("configuration {}: {error}", path.display())))
    }

    /// The mapping settings of a recorded configuration; `None` when they cannot be understood.
    pub fn recorded_mapping(text: &str) -> Option<Self> {
        Self::of_mapping_table(None, of_recording(text)?).ok()
    }

    /// All settings of a recorded configuration; `None` when they cannot be understood.
    pub fn recorded(text: &str) -> Option<Self> {
        let content = of_recording(text)?;
        let named = content.get("profile").cloned();
        let profile = named.map(Value::try_into).transpose().ok()?;
        let mut table = Table::try_from(Self::of(profile.unwrap_or_default())).ok()?;
        merge(&mut table, content);
        Self::from_table(&table, &|error| error).ok()
    }

    fn of_mapping_table(profile: Option<Profile>, mut content: Table) -> Result<Self, String> {
        let named: Option<Profile> = content
            .remove("profile")
            .and_then(|value| value.try_into().ok());
        let mut config = Self::of(profile.or(named).unwrap_or_default());
        if let Some(Value::Table(over)) = content.remove("mapping") {
            let mut table = Table::try_from(&config.mapping).map_err(|error| error.to_string())?;
            merge(&mut table, over);
            config.mapping = Value::Table(table)
                .try_into()
                .map_err(|error: toml::de::Error| in_one_line(&error))?;
        }
        Ok(config)
    }

    fn from_table(table: &Table, describe: &dyn Fn(String) -> String) -> Result<Self, Failure> {
        Value::Table(table.clone())
            .try_into()
            .map_err(|error: toml::de::Error| Failure::input(describe(in_one_line(&error))))
    }

    /// Applies the options of the command line.
    pub fn apply(&mut self, args: &MappingArgs) {
        let mapping = &mut self.mapping;
        if let Some(model) = args.sensor_model {
            mapping.sensor_model = match model {
                SensorModelArg::Thrun => SensorModelKind::Thrun,
                SensorModelArg::Andert => SensorModelKind::Andert,
                SensorModelArg::Ideal => SensorModelKind::Ideal,
                SensorModelArg::None => SensorModelKind::None,
            };
        }
        if let Some(resolution) = args.resolution {
            mapping.resolution = resolution;
            mapping.auto_resolution = false;
        }
        mapping.buffer = args.buffer.unwrap_or(mapping.buffer);
        mapping.significance = args.significance.unwrap_or(mapping.significance);
        mapping.max_range = args.max_range.unwrap_or(mapping.max_range);
        if let Some(integration) = args.integration {
            mapping.integration = match integration {
                IntegrationArg::Fused => IntegrationRule::Fused,
                IntegrationArg::Rays => IntegrationRule::Rays,
            };
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
        let body = toml::to_string(self).map_err(Failure::running)?;
        Ok(format!("{CONFIG_MARKER}\n{body}"))
    }
}

/// What is wrong, and which setting it is.
fn in_one_line(error: &toml::de::Error) -> String {
    error.to_string().trim().replace('\n', " ")
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
    let content = text.parse().map(with_explicit_resolution);
    let mut content = content.map_err(|error: toml::de::Error| {
        Failure::input(format!(
            "configuration {} is not TOML: {}",
            path.display(),
            error.to_string().trim_end()
        ))
    })?;
    match take_gone(&mut content).as_slice() {
        [] => Ok(content),
        gone => Err(Failure::input(format!(
            "configuration {}: {} does not exist any more; take it out of the file",
            path.display(),
            gone.join(", ")
        ))),
    }
}

/// The settings of a recording, but for those that exist no more.
fn of_recording(text: &str) -> Option<Table> {
    let mut content = with_explicit_resolution(text.parse().ok()?);
    take_gone(&mut content);
    Some(content)
}

/// Takes settings that exist no more out of a table; those that were there.
fn take_gone(content: &mut Table) -> Vec<&'static str> {
    let mut taken = GONE.to_vec();
    taken.retain(|name| {
        let mut path = name.split('.');
        let last = path.next_back().unwrap_or_default();
        let mut inner = Some(&mut *content);
        for part in path {
            inner = inner.and_then(|table| table.get_mut(part)?.as_table_mut());
        }
        inner.is_some_and(|table| table.remove(last).is_some())
    });
    taken
}

/// Replaces values of `base` by those of `over`, table by table.
fn merge(base: &mut Table, over: Table) {
    for (key, value) in over {
        match (base.get_mut(&key), value) {
            (Some(Value::Table(inner)), Value::Table(over)) => merge(inner, over),
            (_, value) => drop(base.insert(key, value)),
        }
    }
}

/// Whether a key is a setting, or of a section, of this name.
fn is_part_of(key: &str, name: &str) -> bool {
    let rest = key.strip_prefix(name);
    rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
}

/// `a.b.c=value`; the value is TOML, or a string when it is not.
fn apply_setting(table: &mut Table, setting: &str) -> Result<(), Failure> {
    let Some((key, text)) = setting.split_once('=') else {
        let said = format!("--set {setting}: expected KEY=VALUE, e.g. mapping.resolution=0.02");
        return Err(Failure::input(said));
    };
    if key.trim() == "profile" {
        return Err(Failure::input(format!(
            "--set {setting}: a profile is all settings at once; choose it with --profile NAME, or with `profile = \"NAME\"` in a file"
        )));
    }
    if let Some(gone) = GONE.iter().find(|name| is_part_of(key.trim(), name)) {
        let said = format!("--set {setting}: {gone} does not exist any more; leave it out");
        return Err(Failure::input(said));
    }
    let text = text.trim();
    let parsed = format!("value = {text}").parse::<Table>().ok();
    let value = parsed.and_then(|mut parsed| parsed.remove("value"));
    let value = value.unwrap_or_else(|| Value::String(text.to_owned()));
    let mut path: Vec<&str> = key.trim().split('.').collect();
    let last = path.pop().unwrap_or_default();
    let mut inner = table;
    for part in path {
        let Some(Value::Table(next)) = inner.get_mut(part) else {
            let said = format!("--set {setting}: there is no section `{part}`");
            return Err(Failure::input(said));
        };
        inner = next;
    }
    // `1` for a number with a fraction
    let value = match (inner.get(last), value) {
        (Some(Value::Float(_)), Value::Integer(number)) => Value::Float(number as f64),
        (_, value) => value,
    };
    inner.insert(last.to_owned(), value);
    if key.trim() == "mapping.resolution" {
        inner.insert("auto_resolution".to_owned(), Value::Boolean(false));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_slam::mapping::AutoLength;

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
    fn settings_that_exist_no_more_are_named_and_recordings_may_have_them() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("c.toml");
        for name in GONE {
            let (section, key) = name.rsplit_once('.').unwrap();
            let text = format!("profile = \"thesis\"\n[mapping]\nmax_range = 4.0\n[{section}]\n");
            let text = match section {
                "mapping" => {
                    format!("profile = \"thesis\"\n[mapping]\nmax_range = 4.0\n[{name}]\nx = 1\n")
                }
                _ => format!("{text}{key} = 1\n"),
            };
            std::fs::write(&path, &text).unwrap();
            for failure in [
                RunConfig::resolve(None, Some(&path), &[]).unwrap_err(),
                RunConfig::resolve_mapping(None, Some(&path)).unwrap_err(),
                RunConfig::resolve(None, None, &[format!("{name}.x=1")]).unwrap_err(),
                RunConfig::resolve(None, None, &[format!("{name}=1")]).unwrap_err(),
            ] {
                let said = message(&failure);
                assert!(said.contains(name) && said.contains("any more"), "{said}");
            }
            let expected = MappingConfig {
                max_range: 4.0,
                ..MappingConfig::thesis()
            };
            let recorded = RunConfig::recorded_mapping(&text).unwrap();
            assert_eq!(recorded.mapping, expected, "{name}");
            assert_eq!(RunConfig::recorded(&text).unwrap().mapping, expected);
        }
        // a name that only begins like one is as unknown as ever
        let other = format!("{}s.x=1", GONE[0]);
        let failure = RunConfig::resolve(None, None, &[other]).unwrap_err();
        assert!(!message(&failure).contains("any more"));
    }

    #[test]
    fn a_profile_on_the_command_line_starts_from_that_profile() {
        let config = RunConfig::resolve(Some(Profile::Thesis), None, &[]).unwrap();
        assert_eq!(config, RunConfig::of(Profile::Thesis));
    }
}
