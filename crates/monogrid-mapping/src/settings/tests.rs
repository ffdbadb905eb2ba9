use super::*;
use crate::{AutoLength, SensorModelKind};
use monogrid_slam::SlamConfig;
use monogrid_slam::settings::{SLAM, SettingError, apply, to_table};
use toml::{Table, Value};

fn changed(text: &str) -> Result<(MappingConfig, Vec<String>), SettingError> {
    let table: Table = text.parse().unwrap();
    let mut config = MappingConfig::default();
    let ignored = apply(MAPPING, &mut config, "mapping", &Value::Table(table))?;
    Ok((config, ignored))
}

fn all_names() -> Vec<&'static str> {
    let slam = SLAM.iter().map(|setting| setting.name);
    slam.chain(MAPPING.iter().map(|setting| setting.name))
        .collect()
}

#[test]
fn there_are_few_settings_and_each_has_a_sentence_and_a_reason() {
    assert!(MAPPING.rows.len() <= 35, "{}", MAPPING.rows.len());
    // seed, working_pixels and profile stand beside them
    assert!(all_names().len() + 3 <= 80, "{}", all_names().len());
    let texts = SLAM.iter().map(|s| (s.name, s.meaning, s.reason));
    let texts = texts.chain(MAPPING.iter().map(|s| (s.name, s.meaning, s.reason)));
    for (name, meaning, reason) in texts {
        for text in [meaning, reason] {
            let is_sentence = text.ends_with('.') && !text.contains("  ") && text.len() > 15;
            assert!(is_sentence, "{name}: {text}");
        }
    }
}

#[test]
fn every_profile_is_within_its_ranges_and_survives_a_file() {
    for config in [SlamConfig::default(), SlamConfig::thesis()] {
        SLAM.check(&config).unwrap();
        let table = Value::Table(to_table(SLAM, &config, "slam"));
        let mut back = config.clone();
        assert_eq!(apply(SLAM, &mut back, "slam", &table).unwrap(), [""; 0]);
        assert_eq!(back, config);
    }
    let thesis = to_table(MAPPING, &MappingConfig::thesis(), "mapping");
    let mut other = MappingConfig::default();
    apply(
        MAPPING,
        &mut other,
        "mapping",
        &Value::Table(thesis.clone()),
    )
    .unwrap();
    assert_eq!(to_table(MAPPING, &other, "mapping"), thesis);
    MAPPING.check(&other).unwrap();
}

#[test]
fn every_number_has_a_range_and_is_refused_outside_of_it() {
    fn refused<C: Default>(settings: Settings<C>) {
        for setting in settings.rows {
            let count = match setting.value(&C::default()) {
                Value::Integer(_) | Value::Float(_) => 1,
                Value::Array(numbers) => numbers.len(),
                Value::String(word) if word == "auto" => 1,
                _ => 0,
            };
            assert_eq!(setting.ranges.len(), count, "{}", setting.name);
            for bad in [f64::NAN, -1e9] {
                let bad = Value::Float(bad);
                let value = match count {
                    0 => continue,
                    1 => bad,
                    _ => Value::Array(vec![bad; count]),
                };
                let mut config = C::default();
                let said = match (setting.set)(&mut config, &value) {
                    // whole numbers
                    Err(said) => said,
                    Ok(()) => settings.check(&config).unwrap_err().to_string(),
                };
                assert!(said.contains("expected") || said.contains(setting.name));
            }
        }
    }
    refused(SLAM);
    refused(MAPPING);
}

#[test]
fn values_are_taken_over_and_old_names_are_returned() {
    let (config, ignored) = changed(
        "resolution = 1\nsensor_model = \"ideal\"\nbuffer = 2\nclamp = [-1, 2.5]\n\
         [filter]\nskip_keyframes = 3\nmax_agreed_sigma = 0.1\n[upright]\npitch_deg = 3.0\n",
    )
    .unwrap();
    let mut expected = MappingConfig {
        resolution: 1.0,
        sensor_model: SensorModelKind::Ideal,
        buffer: AutoLength::Fixed(2.0),
        clamp: [-1.0, 2.5],
        ..MappingConfig::default()
    };
    expected.filter.skip_keyframes = 3;
    assert_eq!(config, expected);
    assert_eq!(
        ignored,
        ["mapping.filter.max_agreed_sigma", "mapping.upright"]
    );
}

#[test]
fn unknown_names_and_other_types_are_named() {
    for (text, expected) in [
        ("resolutoin = 1.0", "`mapping.resolutoin`"),
        (
            "[filtre]\nskip_keyframes = 1",
            "`mapping.filtre.skip_keyframes`",
        ),
        ("[filter]\nskip = 1", "mapping.filter.skip_keyframes"),
        ("filter = 1", "`mapping.filter`"),
        ("resolution = \"wide\"", "expected a number; allowed"),
        ("buffer = true", "expected a number or \"auto\""),
        ("sensor_model = \"thrum\"", "thrun"),
        ("clamp = [1.0]", "two numbers"),
        ("updates_to_belief = [-1, 3]", "allowed 0 to 255"),
        ("[filter]\nskip_keyframes = 1.5", "a whole number"),
        ("[mesh]\nenabled = 1", "bool"),
    ] {
        let said = changed(text).unwrap_err().to_string();
        assert!(said.contains(expected), "{text}: {said}");
    }
}

/// All names that are gone.
fn old_names() -> impl Iterator<Item = String> {
    let of = |&(section, keys): &(&str, &'static str)| {
        let section = section.to_owned();
        keys.split(' ').map(move |key| format!("{section}.{key}"))
    };
    MAPPING.old.iter().chain(SLAM.old).flat_map(of)
}

/// Whether a file may still give the name a value.
fn is_ignored(name: &str) -> bool {
    let value = Value::Integer(1);
    let ignored = match name.starts_with("slam") {
        true => apply(SLAM, &mut SlamConfig::default(), name, &value),
        false => apply(MAPPING, &mut MappingConfig::default(), name, &value),
    };
    ignored.is_ok_and(|ignored| ignored == [name])
}

#[test]
fn no_name_is_a_setting_and_gone() {
    let settings = all_names();
    for old in old_names() {
        assert!(is_ignored(&old) && is_ignored(&format!("{old}.x")), "{old}");
        let section = format!("{old}.");
        assert!(!settings.contains(&old.as_str()), "{old}");
        assert!(
            !settings.iter().any(|name| name.starts_with(&section)),
            "{old}"
        );
    }
    for name in ["mapping.rimss", "mapping", "slam.rims"] {
        assert!(!is_ignored(name), "{name}");
    }
}
