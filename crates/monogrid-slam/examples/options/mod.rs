//! `name=value` arguments of the examples.
#![allow(dead_code, reason = "each example uses a part")]

use serde::{Serialize, de::DeserializeOwned};
use std::collections::BTreeMap;
use std::fmt::Debug;
use std::str::FromStr;

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

    /// `config` with the settings whose names have a dot.
    pub fn applied_to<T: Serialize + DeserializeOwned>(&self, config: &T) -> T {
        let mut value = serde_json::to_value(config).unwrap();
        for (key, text) in self.0.iter().filter(|(key, _)| key.contains('.')) {
            let mut node = &mut value;
            for part in key.split('.') {
                node = node.get_mut(part).expect(key);
            }
            *node = serde_json::from_str(text).unwrap();
        }
        serde_json::from_value(value).unwrap()
    }
}
