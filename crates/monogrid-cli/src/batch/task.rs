//! A recording as a task: a name of its own, the arguments of its run, and the hash of its
//! settings.

use super::keys::{Key, joined};
use super::list::{Listed, safe_name, without_outputs};
use super::sha256::sha256_of;
use crate::commands::runs::run::{self, RunArgs, configuration, inputs_of_options};
use clap::FromArgMatches;
use monogrid_app::config::RunConfig;
use monogrid_app::process::failure::Failure;
use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// What is to be done.
#[derive(Clone, Debug)]
pub struct Task {
    /// Name of its folders.
    pub name: String,
    /// What is read.
    pub source: PathBuf,
    /// Options of `monogrid run`.
    pub options: Vec<String>,
    /// Where it was named, for messages.
    pub place: String,
    /// Files that the options name to be read.
    pub option_files: Vec<PathBuf>,
    /// The file that it writes beside its folder.
    pub mcap: Option<PathBuf>,
    /// Hash of all settings of the run.
    pub settings_sha256: String,
}

/// The tasks of all recordings that were named, in their order; one that is named twice alike is
/// one.
///
/// # Errors
/// Where a recording cannot be one of a batch, its options are not understood, or two have one
/// name.
pub fn tasks(listed: &[Listed], of_all: &[Key]) -> Result<Vec<Task>, Failure> {
    let listed = without_outputs(listed, of_all);
    let names = names(&listed)?;
    let mut seen = BTreeSet::new();
    let named = listed.iter().zip(names);
    let new = named.filter(|(_, name)| seen.insert(name.clone()));
    new.map(|(listed, name)| task(listed, name, of_all))
        .collect()
}

/// A name for each, the same for those that are the same: what was said, else the name of the
/// source. Where several sources have one name, whatever its case, all of them get a part of the
/// hash of their line, so that names do not depend on the order.
fn names(listed: &[Listed]) -> Result<Vec<String>, Failure> {
    let line = |listed: &Listed| {
        let keys: Vec<String> = listed.keys.iter().map(Key::argument).collect();
        sha256_of(format!("{}\n{keys:?}", listed.source.display()).as_bytes())
    };
    let own = |listed: &Listed| match &listed.name {
        Some(name) => name.clone(),
        None => name_of(&listed.source),
    };
    let mut lines: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for one in listed {
        let name = own(one).to_lowercase();
        lines.entry(name).or_default().insert(line(one));
    }
    let name = |one: &Listed| {
        let same = lines.get(&own(one).to_lowercase());
        let is_alone = same.is_none_or(|lines| lines.len() < 2);
        match (is_alone, &one.name) {
            (true, _) => Ok(own(one)),
            (false, None) => Ok(format!("{}-{}", own(one), &line(one)[..8])),
            (false, Some(name)) => Err(of_another(one, name)),
        }
    };
    let names: Vec<String> = listed.iter().map(name).collect::<Result<_, _>>()?;
    // a name that was said may be one that was made, and that of the same line in another case
    let mut owners: BTreeMap<String, (&String, String)> = BTreeMap::new();
    for (one, name) in listed.iter().zip(&names) {
        let owner = owners
            .entry(name.to_lowercase())
            .or_insert((name, line(one)));
        if *owner != (name, line(one)) {
            return Err(of_another(one, name));
        }
    }
    Ok(names)
}

fn of_another(listed: &Listed, name: &str) -> Failure {
    Failure::input(format!(
        "{}: the name {name} is that of another recording too; expected names that differ not by \
         case alone",
        listed.place
    ))
}

fn name_of(source: &Path) -> String {
    let name = match source.is_dir() {
        true => source.file_name(),
        false => source.file_stem(),
    };
    safe_name(&name.unwrap_or_default().to_string_lossy())
}

fn task(listed: &Listed, name: String, of_all: &[Key]) -> Result<Task, Failure> {
    let source = listed.source.clone();
    refuse_streams(&source, &listed.place)?;
    let keys = joined(of_all, &listed.keys);
    let options: Vec<String> = keys.iter().map(Key::argument).collect();
    let args = parsed(&source, &options, &listed.place)?;
    // settings that cannot be read are found by the run itself, which says why
    let config = configuration(&args, None).ok();
    let read = inputs_of_options(&args, config.as_ref());
    Ok(Task {
        name,
        options,
        place: listed.place.clone(),
        option_files: read.paths().map(Path::to_owned).collect(),
        settings_sha256: settings_hash(config.as_ref()),
        mcap: args.mcap,
        source,
    })
}

/// A run that is not of files cannot be repeated.
fn refuse_streams(source: &Path, place: &str) -> Result<(), Failure> {
    let text = source.to_string_lossy();
    if text == "-" || text.contains("://") || text.starts_with("/dev/") {
        return Err(Failure::input(format!(
            "{place}: {text} is no file or folder; expected a recording that can be read again"
        )));
    }
    Ok(())
}

/// The options as `monogrid run` understands them.
fn parsed(source: &Path, options: &[String], place: &str) -> Result<RunArgs, Failure> {
    let mut arguments: Vec<OsString> = vec!["run".into()];
    arguments.extend(options.iter().map(OsString::from));
    arguments.extend(["--".into(), source.into()]);
    let parsed = run::command().try_get_matches_from(arguments);
    let parsed = parsed.and_then(|found| RunArgs::from_arg_matches(&found));
    parsed.map_err(|error| {
        let text = error.to_string();
        let said = text.lines().next().unwrap_or_default();
        let said = said.strip_prefix("error: ").unwrap_or(said);
        Failure::input(format!("{place}: {said}"))
    })
}

fn settings_hash(config: Option<&RunConfig>) -> String {
    let text = config.and_then(|config| config.to_toml().ok());
    text.map_or_else(|| "none".to_owned(), |text| sha256_of(text.as_bytes()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::batch::keys::parse_key;

    fn listed(source: &str, name: Option<&str>, keys: &[&str]) -> Listed {
        Listed {
            source: source.into(),
            name: name.map(str::to_owned),
            keys: keys.iter().map(|k| parse_key(k, "here").unwrap()).collect(),
            place: "here".into(),
            is_found: false,
        }
    }

    #[test]
    fn names_do_not_depend_on_the_order() {
        let one = listed("monday/video.mp4", None, &[]);
        let two = listed("tuesday/Video.mp4", None, &[]);
        let other = listed("kitchen.mp4", None, &[]);
        let [first, second, third] = names(&[one.clone(), two.clone(), other.clone()])
            .unwrap()
            .try_into()
            .unwrap();
        assert_eq!(third, "kitchen");
        assert!(first.starts_with("video-") && second.starts_with("Video-") && first != second);
        let turned = names(&[two, other.clone(), one.clone()]).unwrap();
        assert_eq!(turned, [second, third, first]);
        // named twice alike
        assert_eq!(
            tasks(&[other.clone(), other.clone()], &[]).unwrap().len(),
            1
        );
        let faster = listed("kitchen.mp4", None, &["every=2"]);
        assert_eq!(tasks(&[other, faster], &[]).unwrap().len(), 2);
        let [a, b] = ["a.mp4", "b.mp4"].map(|source| listed(source, Some("same"), &[]));
        assert!(tasks(&[a, b], &[]).is_err());
        // the same line under names that one folder would have on other systems
        let [a, b] = ["A", "a"].map(|name| listed("a.mp4", Some(name), &[]));
        assert!(tasks(&[a, b], &[]).is_err());
        // a name that is made of two others
        let [monday, tuesday] = ["monday/v.mp4", "tuesday/v.mp4"].map(|v| listed(v, None, &[]));
        let made = names(&[monday.clone(), tuesday.clone()]).unwrap();
        let said = listed("other.mp4", Some(&made[0]), &[]);
        assert!(tasks(&[monday, tuesday, said], &[]).is_err());
    }

    #[test]
    fn options_are_checked_before_anything_runs() {
        for (source, keys, said) in [
            ("a.mp4", &["max-frames=many"][..], "max-frames"),
            (
                "a.mp4",
                &["fov=60", "calibration=c.txt"],
                "cannot be used with",
            ),
            ("rtsp://camera", &[], "can be read again"),
            ("/dev/video0", &[], "can be read again"),
            ("-", &[], "can be read again"),
        ] {
            let error = tasks(&[listed(source, None, keys)], &[]).unwrap_err();
            let text = error.into_error().to_string();
            assert!(
                text.contains(said) && text.contains("here"),
                "{source}: {text}"
            );
        }
    }

    #[test]
    fn settings_of_a_recording_have_a_hash() {
        let hash = |keys: &[&str]| {
            let tasks = tasks(&[listed("a.mp4", None, keys)], &[]).unwrap();
            tasks[0].settings_sha256.clone()
        };
        assert_eq!(hash(&[]), hash(&["set=seed=0"]));
        assert_ne!(hash(&[]), hash(&["set=seed=1"]));
        assert_ne!(hash(&[]), hash(&["resolution=0.07"]));
        assert_eq!(hash(&["config=nowhere.toml"]), "none");
    }
}
