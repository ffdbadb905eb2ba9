//! Options of `monogrid run` as lists say them: `KEY=VALUE`, or `KEY` for those without a value.

use crate::commands::runs::run;
use monogrid_app::process::failure::Failure;
use std::collections::BTreeSet;
use std::sync::LazyLock;

/// An option.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Key {
    /// Its name without `--`.
    pub name: String,
    /// Its value, where it has one.
    pub value: Option<String>,
}

/// Options that a batch decides about, or that mean nothing in it.
const NOT_IN_A_BATCH: [&str; 8] = [
    "out",
    "force",
    "json",
    "view",
    "threads",
    "continue",
    "localise-only",
    "realtime",
];
/// Options that may be said several times.
const ADDED: [&str; 1] = ["set"];

/// Understands one option; `place` says where it stands.
pub fn parse_key(text: &str, place: &str) -> Result<Key, Failure> {
    let (name, value) = match text.split_once('=') {
        Some((name, value)) => (name, Some(value.to_owned())),
        None => (text, None),
    };
    let name = name.strip_prefix("--").unwrap_or(name);
    if NOT_IN_A_BATCH.contains(&name) {
        let said = format!("{place}: `{name}` cannot be said of a recording of a batch");
        return Err(Failure::input(said));
    }
    if !OPTIONS_OF_RUN.contains(name) {
        return Err(Failure::input(format!(
            "{place}: `{name}` is no option of `monogrid run`; expected KEY=VALUE, such as \
             max-frames=300, or name=NAME"
        )));
    }
    Ok(Key {
        name: name.to_owned(),
        value,
    })
}

/// The long names of the options of `monogrid run`.
static OPTIONS_OF_RUN: LazyLock<BTreeSet<String>> = LazyLock::new(|| {
    let run = run::command();
    let names = run.get_arguments().filter_map(clap::Arg::get_long);
    names.map(str::to_owned).collect()
});

impl Key {
    /// As an argument of the command line.
    pub fn argument(&self) -> String {
        match &self.value {
            Some(value) => format!("--{}={value}", self.name),
            None => format!("--{}", self.name),
        }
    }
}

/// What is said of all recordings and of one alone: what is said of one alone wins.
pub fn joined(of_all: &[Key], alone: &[Key]) -> Vec<Key> {
    let is_replaced = |key: &&Key| {
        !ADDED.contains(&key.name.as_str()) && alone.iter().any(|other| other.name == key.name)
    };
    let kept = of_all.iter().filter(|key| !is_replaced(key));
    kept.chain(alone).cloned().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_said_of_one_recording_wins_and_settings_add_up() {
        let keys = |texts: &[&str]| -> Vec<Key> {
            texts
                .iter()
                .map(|t| parse_key(t, "here").unwrap())
                .collect()
        };
        let of_all = keys(&["max-frames=300", "set=seed=1", "every=2"]);
        let alone = keys(&["max-frames=30", "set=mapping.resolution=0.1"]);
        let arguments: Vec<String> = joined(&of_all, &alone).iter().map(Key::argument).collect();
        assert_eq!(
            arguments,
            [
                "--set=seed=1",
                "--every=2",
                "--max-frames=30",
                "--set=mapping.resolution=0.1"
            ]
        );
    }
}
