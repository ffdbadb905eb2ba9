//! The public settings: which parameters a user may change, in which range, and why.
//!
//! Parameter structs such as [`SlamConfig`] hold all parameters; most of them follow from a profile
//! and stay as they are. Those listed in a [`Settings`] are read from files and `--set`, written to
//! `config.toml`, and described in docs/configuration.md. A row is the only place that makes a
//! parameter public. [`SLAM`] is the list of this crate; `monogrid-mapping` has another.

mod slam;
mod value;

use crate::ConfigError;
#[cfg(doc)]
use crate::SlamConfig;
use toml::{Table, Value};

pub use slam::SLAM;
pub use value::{SettingValue, of_word, other, to_word};

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
    /// Reads its value.
    pub get: fn(&C) -> Value,
    /// Changes it; an error says what was found and what is expected.
    pub set: fn(&mut C, &Value) -> Result<(), String>,
}

/// The public settings of a parameter struct.
pub struct Settings<C: 'static> {
    /// A row for each.
    pub rows: &'static [Setting<C>],
    /// Sections, and the names that are gone from each, between spaces; a name stands for all below
    /// it. Files and `--set` may still name them for one version; they have no effect.
    pub old: &'static [(&'static str, &'static str)],
}

impl<C> Clone for Settings<C> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<C> Copy for Settings<C> {}

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

/// [`Settings`] of rows `place => unit, ranges, meaning, reason;` of a parameter struct, after the
/// names that are gone; the name of a row is its place, so that none can be confused. Rows without
/// ranges are words, switches and names.
#[macro_export]
macro_rules! settings {
    (
        $config:ident: $type:ty, $old:expr,
        $($place:expr => $unit:literal, $ranges:tt, $meaning:literal, $reason:literal;)*
    ) => {
        $crate::settings::Settings {
            rows: &[$($crate::settings::Setting {
                name: stringify!($place),
                unit: $unit,
                ranges: &$ranges,
                meaning: $meaning,
                reason: $reason,
                get: |$config: &$type| $crate::settings!(get $ranges &$place),
                set: |$config: &mut $type, value| {
                    $place = $crate::settings!(set $ranges value)?;
                    Ok(())
                },
            }),*],
            old: $old,
        }
    };
    (get [] $value:expr) => { $crate::settings::to_word($value) };
    (get $ranges:tt $value:expr) => { $crate::settings::SettingValue::to_value($value) };
    (set [] $value:expr) => { $crate::settings::of_word($value) };
    (set $ranges:tt $value:expr) => { $crate::settings::SettingValue::of_value($value) };
}

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

impl<C> Settings<C> {
    /// The settings, in the order in which they are documented.
    pub fn iter(&self) -> std::slice::Iter<'static, Setting<C>> {
        self.rows.iter()
    }

    /// Checks that all settings are in their ranges.
    ///
    /// # Errors
    /// The first setting outside its range.
    pub fn check(&self, config: &C) -> Result<(), ConfigError> {
        self.iter().try_for_each(|setting| setting.check(config))
    }

    /// Whether a name was that of a setting or section, or of one below it.
    fn is_old(&self, name: &str) -> bool {
        self.old.iter().any(|(section, keys)| {
            let rest = name.strip_prefix(section);
            let rest = rest.and_then(|rest| rest.strip_prefix('.'));
            let key = rest.and_then(|rest| rest.split('.').next());
            key.is_some_and(|key| keys.split(' ').any(|old| old == key))
        })
    }
}

/// Section `section` of a configuration file: all settings, with the values that they have.
#[must_use]
pub fn to_table<C>(settings: Settings<C>, config: &C, section: &str) -> Table {
    let mut table = Table::new();
    for setting in settings.rows {
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
    if settings.is_old(name) {
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
