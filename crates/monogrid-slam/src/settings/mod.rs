//! The public settings: which parameters a user may change, in which range, and why.
//!
//! [`SlamConfig`] and [`MappingConfig`] hold all parameters; most of them follow from a profile and
//! stay as they are. Those listed here are read from files and `--set`, written to `config.toml`,
//! and described in docs/configuration.md. A row is the only place that makes a parameter public.

mod mapping;
mod old;
mod slam;
mod value;

use crate::mapping::MappingConfig;
use crate::{ConfigError, SlamConfig};
use old::is_old;
use toml::{Table, Value};
use value::{of_value, to_value};

pub use mapping::MAPPING;
pub use slam::SLAM;

/// A parameter that users may change.
pub struct Setting<C: 'static> {
    /// Dotted name, as in a configuration file.
    pub name: &'static str,
    /// Unit of its value; empty where it has none.
    pub unit: &'static str,
    /// Smallest and largest value; one for each number of a pair, none where any value will do.
    pub ranges: &'static [(f64, f64)],
    /// Its meaning, in sentences.
    pub meaning: &'static str,
    /// Why a user would change it, in a sentence.
    pub reason: &'static str,
    get: fn(&C) -> Value,
    set: fn(&mut C, &Value) -> Result<(), String>,
}

/// The public settings of a parameter struct.
pub type Settings<C> = &'static [Setting<C>];

/// A value that cannot be taken over.
#[derive(Debug, thiserror::Error, Clone, PartialEq, Eq)]
pub enum SettingError {
    /// No setting has this name, and none had it.
    #[error("there is no setting `{name}`; expected one of {known}")]
    Unknown {
        /// Dotted name.
        name: String,
        /// The settings of its section, or of all sections.
        known: String,
    },
    /// A value of another type.
    #[error("{name}: {problem}")]
    Value {
        /// Dotted name.
        name: String,
        /// Found and expected.
        problem: String,
    },
}

/// Rows `place: unit, ranges, meaning, reason;` of a parameter struct; the name of a row is its
/// place, so that none can be confused.
macro_rules! settings {
    ($config:ident: $type:ty, $($place:expr => $unit:literal, [$($range:expr),*], $meaning:literal, $reason:literal;)*) => {
        &[$($crate::settings::Setting {
            name: stringify!($place),
            unit: $unit,
            ranges: &[$($range),*],
            meaning: $meaning,
            reason: $reason,
            get: |$config: &$type| $crate::settings::to_value(&$place),
            set: |$config: &mut $type, value| {
                $place = $crate::settings::of_value(value)?;
                Ok(())
            },
        }),*]
    };
}
pub(crate) use settings;

impl<C> Setting<C> {
    /// The value in a configuration.
    #[must_use]
    pub fn value(&self, config: &C) -> Value {
        (self.get)(config)
    }

    /// The end of a sentence on a value of another type.
    fn allowed(&self) -> String {
        let ranges = self.ranges.iter();
        let ranges: Vec<String> = ranges
            .map(|(low, high)| format!("{low} to {high}"))
            .collect();
        match ranges.as_slice() {
            [] => String::new(),
            ranges => format!("; allowed {}", ranges.join(" and ")),
        }
    }

    fn check(&self, config: &C) -> Result<(), ConfigError> {
        let numbers = match self.value(config) {
            Value::Array(numbers) => numbers,
            number => vec![number],
        };
        for (number, (low, high)) in numbers.iter().zip(self.ranges) {
            let number = match number {
                Value::Float(number) => *number,
                Value::Integer(number) => *number as f64,
                // a word in place of a number
                _ => continue,
            };
            // NaN is in no range
            if !(*low..=*high).contains(&number) {
                return Err(ConfigError {
                    name: self.name.to_owned(),
                    value: number,
                    allowed: format!("{low} to {high}"),
                });
            }
        }
        Ok(())
    }
}

/// Checks that all settings are in their ranges.
fn check<C>(settings: Settings<C>, config: &C) -> Result<(), ConfigError> {
    settings
        .iter()
        .try_for_each(|setting| setting.check(config))
}

/// Checks the ranges of tracking and depth.
pub(crate) fn check_slam(slam: &SlamConfig) -> Result<(), ConfigError> {
    check(SLAM, slam)
}

/// Checks the ranges of maps.
pub(crate) fn check_mapping(mapping: &MappingConfig) -> Result<(), ConfigError> {
    check(MAPPING, mapping)
}

/// Section `section` of a configuration file: all settings, with the values that they have.
#[must_use]
pub fn to_table<C>(settings: Settings<C>, config: &C, section: &str) -> Table {
    let mut table = Table::new();
    for setting in settings {
        let mut path: Vec<&str> = below(setting.name, section).split('.').collect();
        let last = path.pop().unwrap_or_default();
        let mut inner = &mut table;
        for part in path {
            let next = inner
                .entry(part)
                .or_insert_with(|| Value::Table(Table::new()));
            let Value::Table(next) = next else {
                unreachable!("a setting cannot be a section too");
            };
            inner = next;
        }
        inner.insert(last.to_owned(), setting.value(config));
    }
    table
}

/// The rest of a name below its section.
fn below<'a>(name: &'a str, section: &str) -> &'a str {
    let rest = name
        .strip_prefix(section)
        .and_then(|rest| rest.strip_prefix('.'));
    rest.unwrap_or(name)
}

/// Changes what a section of a configuration file names; the names in it that are no longer
/// settings are ignored, and returned.
///
/// # Errors
/// A name that no setting has or had, or a value of another type. Ranges are not checked.
pub fn apply<C>(
    settings: Settings<C>,
    config: &mut C,
    section: &str,
    value: &Value,
) -> Result<Vec<String>, SettingError> {
    let mut ignored = Vec::new();
    apply_at(settings, config, section, value, &mut ignored)?;
    Ok(ignored)
}

fn apply_at<C>(
    settings: Settings<C>,
    config: &mut C,
    name: &str,
    value: &Value,
    ignored: &mut Vec<String>,
) -> Result<(), SettingError> {
    if let Some(setting) = settings.iter().find(|setting| setting.name == name) {
        return (setting.set)(config, value).map_err(|problem| SettingError::Value {
            name: name.to_owned(),
            problem: format!("{problem}{}", setting.allowed()),
        });
    }
    if is_old(name) {
        ignored.push(name.to_owned());
        return Ok(());
    }
    match value {
        Value::Table(table) => table.iter().try_for_each(|(key, value)| {
            apply_at(settings, config, &format!("{name}.{key}"), value, ignored)
        }),
        _ => Err(SettingError::Unknown {
            name: name.to_owned(),
            known: known_beside(settings, name),
        }),
    }
}

/// The settings of the section of a name; the sections where it has none.
fn known_beside<C>(settings: Settings<C>, name: &str) -> String {
    let section = |name: &'static str| name.rsplit_once('.').map_or("", |(section, _)| section);
    let own = name.rsplit_once('.').map_or("", |(section, _)| section);
    let mut known: Vec<&str> = settings
        .iter()
        .map(|setting| setting.name)
        .filter(|known| section(known) == own)
        .collect();
    if known.is_empty() {
        known = settings
            .iter()
            .map(|setting| section(setting.name))
            .collect();
        known.dedup();
    }
    known.join(", ")
}

#[cfg(test)]
mod tests;
