//! `name=value` arguments of the examples.

use monogrid_slam::settings::{Settings, apply};
use std::collections::BTreeMap;
use std::fmt::Debug;
use std::str::FromStr;
use toml::Value;

/// Options by name.
pub struct Options(pub BTreeMap<String, String>);

impl Options {
    /// Reads the arguments that are left.
    pub fn read(args: impl Iterator<Item = String>) -> Self {
        let pairs = args.map(|a| {
            let (name, value) = a.split_once('=').unwrap();
            (name.to_owned(), value.to_owned())
        });
        Self(pairs.collect())
    }

    /// A number, or its default.
    pub fn number<T: FromStr<Err: Debug>>(&self, name: &str, default: T) -> T {
        self.0.get(name).map_or(default, |v| v.parse().unwrap())
    }

    /// Whether an option has a value.
    pub fn is(&self, name: &str, value: &str) -> bool {
        self.0.get(name).is_some_and(|found| found == value)
    }

    /// `config` with the settings whose names have a dot, below their section:
    /// `sparse.enabled=false`.
    pub fn applied_to<C>(&self, mut config: C, settings: Settings<C>, section: &str) -> C {
        let lines = self.0.iter().filter(|(key, _)| key.contains('.'));
        let lines: Vec<String> = lines.map(|(key, text)| format!("{key} = {text}")).collect();
        let table = lines.join("\n").parse().unwrap();
        let ignored = apply(settings, &mut config, section, &Value::Table(table)).unwrap();
        assert!(ignored.is_empty(), "no longer settings: {ignored:?}");
        config
    }
}
