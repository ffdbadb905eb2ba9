//! Which recordings a batch is of: lists, folders of recordings, recordings.
//!
//! A list has one recording per line: its source, then, separated by tabs, what is said of it
//! alone: `name=NAME` and options of `monogrid run` as `KEY=VALUE` or `KEY`. Empty lines and lines
//! that begin with `#` are left out.

use super::keys::{Key, joined, parse_key};
use monogrid_app::input::video_source::is_video;
use monogrid_app::output::{Inputs, resolved};
use monogrid_app::process::failure::{Classify, Failure};
use monogrid_datasets::{Dataset, SourceOptions};
use monogrid_video::is_recording;
use std::collections::BTreeSet;
use std::io::Read;
use std::path::{Path, PathBuf};

/// The option of `monogrid run` that names a file to be written.
const WRITTEN: &str = "mcap";

/// A recording as it was named.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Listed {
    /// What `monogrid run` reads.
    pub source: PathBuf,
    /// What the results are called, where that was said.
    pub name: Option<String>,
    /// Options of `monogrid run` that were said of it alone.
    pub keys: Vec<Key>,
    /// Where it was named, for messages.
    pub place: String,
    /// It was found in a folder of recordings, and nobody named it.
    pub is_found: bool,
}

/// Endings of files that are lists.
const LISTS: [&str; 2] = ["txt", "tsv"];
/// Endings of files that are recordings in a folder of recordings.
const RECORDINGS: [&str; 16] = [
    "mp4", "mov", "m4v", "mkv", "webm", "avi", "mpg", "ts", "y4m", "mjpeg", "mcap", "db3", "bag",
    "zip", "tar", "tgz",
];
/// Largest list that is read: a million recordings have one of this size.
const MAX_LIST_BYTES: u64 = 1 << 30;

/// All recordings that the arguments name, in their order; what is left out is said.
pub fn read_sources(
    arguments: &[PathBuf],
    out: &Path,
) -> Result<(Vec<Listed>, Vec<String>), Failure> {
    let (mut listed, mut said) = (Vec::new(), Vec::new());
    for argument in arguments {
        if is_list(argument) {
            listed.extend(parse_list(&list_text(argument)?, &place_of(argument))?);
        } else if argument.is_dir() && !is_sequence(argument) {
            let (found, left_out) = recordings_in(argument, out)?;
            if left_out > 0 {
                let folder = argument.display();
                said.push(format!(
                    "{folder}: {left_out} entries are no recordings and are left out"
                ));
            }
            listed.extend(found);
        } else {
            listed.push(Listed::alone(argument.clone(), "the command line"));
        }
    }
    if listed.is_empty() {
        return Err(Failure::input("there are no recordings in what was named"));
    }
    Ok((listed, said))
}

/// The lists themselves, which are read.
pub fn lists(arguments: &[PathBuf]) -> Inputs {
    let lists = arguments.iter().filter(|argument| is_list(argument));
    Inputs::default().and_all(
        "the list",
        lists.filter(|list| *list != Path::new("-")).cloned(),
    )
}

impl Listed {
    fn alone(source: PathBuf, place: &str) -> Self {
        Self {
            source,
            name: None,
            keys: Vec::new(),
            place: place.to_owned(),
            is_found: false,
        }
    }
}

fn ending_is(path: &Path, endings: &[&str]) -> bool {
    let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase());
    ending.is_some_and(|ending| endings.contains(&ending.as_str()))
}

fn is_list(argument: &Path) -> bool {
    argument == Path::new("-") || !argument.is_dir() && ending_is(argument, &LISTS)
}

/// Whether a folder is one recording.
fn is_sequence(folder: &Path) -> bool {
    is_recording(folder) || Dataset::open(folder, SourceOptions::default()).is_ok()
}

fn place_of(list: &Path) -> String {
    match list == Path::new("-") {
        true => "standard input".to_owned(),
        false => list.display().to_string(),
    }
}

fn list_text(list: &Path) -> Result<String, Failure> {
    let place = place_of(list);
    let mut bytes = Vec::new();
    let opened: std::io::Result<Box<dyn Read>> = match list == Path::new("-") {
        true => Ok(Box::new(std::io::stdin().lock())),
        false => std::fs::File::open(list).map(|file| Box::new(file) as Box<dyn Read>),
    };
    opened
        .and_then(|opened| opened.take(MAX_LIST_BYTES + 1).read_to_end(&mut bytes))
        .map_err(|error| Failure::input(format!("the list {place} cannot be read: {error}")))?;
    if bytes.len() as u64 > MAX_LIST_BYTES {
        return Err(Failure::input(format!(
            "the list {place} has more than {MAX_LIST_BYTES} bytes; expected a line of text per \
             recording"
        )));
    }
    String::from_utf8(bytes).map_err(|error| {
        let before = &error.as_bytes()[..error.utf8_error().valid_up_to()];
        let line = before.iter().filter(|byte| **byte == b'\n').count() + 1;
        Failure::input(format!(
            "{place}, line {line}: not UTF-8; name this recording on the command line"
        ))
    })
}

/// The recordings of a list.
fn parse_list(text: &str, place: &str) -> Result<Vec<Listed>, Failure> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let lines = text.lines().enumerate();
    let filled = lines.filter(|(_, line)| !line.trim().is_empty() && !line.starts_with('#'));
    filled
        .map(|(index, line)| parse_line(line, &format!("{place}, line {}", index + 1)))
        .collect()
}

fn parse_line(line: &str, place: &str) -> Result<Listed, Failure> {
    let mut fields = line.split('\t');
    let source = fields.next().unwrap_or_default();
    if source.is_empty() {
        let said = format!("{place}: begins with a tab, expected a source before it");
        return Err(Failure::input(said));
    }
    if source.contains('\0') {
        let said = format!("{place}: holds a zero byte, which no name of a file has");
        return Err(Failure::input(said));
    }
    let mut listed = Listed::alone(source.into(), place);
    for field in fields.filter(|field| !field.trim().is_empty()) {
        match field.strip_prefix("name=") {
            Some(name) => listed.name = Some(checked_name(name, place)?),
            None => listed.keys.push(parse_key(field, place)?),
        }
    }
    Ok(listed)
}

/// Longest name of a recording, bytes: names of files end at 255.
const MAX_NAME_BYTES: usize = 120;

/// A name that is one folder on every system.
fn checked_name(name: &str, place: &str) -> Result<String, Failure> {
    if name == safe_name(name) {
        return Ok(name.to_owned());
    }
    Err(Failure::input(format!(
        "{place}: name {name:?}, expected at most {MAX_NAME_BYTES} bytes of letters, digits, `-`, \
         `_` and `.`, which does not come first or last"
    )))
}

/// A name of a folder made of the name of a source.
pub fn safe_name(text: &str) -> String {
    let kept = |c: char| c.is_alphanumeric() || matches!(c, '-' | '_' | '.');
    let name = text.replace(|c| !kept(c), "-");
    let mut name = name.trim_matches('.').to_owned();
    while name.len() > MAX_NAME_BYTES {
        name.pop();
    }
    match name.trim_end_matches('.') {
        "" => "recording".to_owned(),
        name => name.to_owned(),
    }
}

/// The recordings in a folder, in the order of their names, and how many other things lie there.
fn recordings_in(folder: &Path, out: &Path) -> Result<(Vec<Listed>, usize), Failure> {
    let entries = std::fs::read_dir(folder).bad_input()?;
    let paths = entries.map(|entry| Ok(entry?.path()));
    let mut paths: Vec<PathBuf> = paths.collect::<std::io::Result<_>>().bad_input()?;
    paths.sort();
    let out = out.canonicalize().ok();
    let is_out = |path: &Path| out.is_some() && path.canonicalize().ok() == out;
    paths.retain(|path| !is_out(path));
    let count = paths.len();
    paths.retain(|path| match path.is_dir() {
        true => is_sequence(path),
        false => {
            ending_is(path, &RECORDINGS)
                && (is_video(path) || ending_is(path, &["zip", "tar", "tgz"]))
        }
    });
    let left_out = count - paths.len();
    let place = folder.display().to_string();
    let listed = paths.into_iter().map(|path| Listed {
        is_found: true,
        ..Listed::alone(path, &place)
    });
    Ok((listed.collect(), left_out))
}

/// Recordings without those that were only found in a folder and are outputs of this very batch.
pub fn without_outputs(listed: &[Listed], of_all: &[Key]) -> Vec<Listed> {
    let written: BTreeSet<PathBuf> = listed
        .iter()
        .flat_map(|listed| joined(of_all, &listed.keys))
        .filter(|key| key.name == WRITTEN)
        .filter_map(|key| key.value)
        .map(|file| resolved(Path::new(&file)))
        .collect();
    let is_output = |one: &Listed| {
        one.is_found && !written.is_empty() && written.contains(&resolved(&one.source))
    };
    listed
        .iter()
        .filter(|one| !is_output(one))
        .cloned()
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_sources_with_what_is_said_of_them() {
        let text = "\u{feff}# two\r\nkitchen.mp4\r\n\n a \
            b\tname=second\tmax-frames=3\trefine-calibration\t\n";
        let listed = parse_list(text, "l").unwrap();
        assert_eq!(listed[0].source, Path::new("kitchen.mp4"));
        assert_eq!(listed[0].place, "l, line 2");
        assert_eq!(listed[1].source, Path::new(" a b"), "spaces belong to it");
        assert_eq!(listed[1].name.as_deref(), Some("second"));
        assert_eq!(listed[1].keys.len(), 2);
    }

    #[test]
    fn what_is_no_list_is_refused_with_its_line() {
        for (bad, said) in [
            ("\tname=x\n", "begins with a tab"),
            ("a\nb\tname=../x\n", "line 2"),
            ("a\tname=\n", "expected at most"),
            ("a\tname=.\n", "expected at most"),
            ("a\tout=elsewhere\n", "out"),
            ("a\tnonsense=1\n", "nonsense"),
            ("a\0b\n", "zero byte"),
        ] {
            let Err(Failure::Input(error)) = parse_list(bad, "list") else {
                panic!("{bad:?}");
            };
            assert!(error.to_string().contains(said), "{bad:?}: {error}");
        }
    }

    #[test]
    fn names_are_folders() {
        for (text, name) in [
            ("kitchen", "kitchen"),
            ("a b/c\\d", "a-b-c-d"),
            ("..", "recording"),
            ("", "recording"),
            ("Küche 2", "Küche-2"),
            (".hidden.", "hidden"),
        ] {
            assert_eq!(safe_name(text), name);
        }
        let long = safe_name(&"ü".repeat(500));
        assert!(long.len() <= MAX_NAME_BYTES && !long.is_empty());
    }
}
