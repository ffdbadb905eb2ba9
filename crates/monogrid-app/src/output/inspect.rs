//! What lies in an output folder, and whether it may be written to.

use super::Inputs;
use super::inputs::identity;
use super::manifest::{Listed, MANIFEST, Manifest, OpenError};
use crate::process::failure::Failure;
use std::collections::BTreeSet;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// What becomes of output folders in a folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Nested {
    /// What lies in them lies in the folder.
    Searched,
    /// They look after themselves.
    Trusted,
}

/// A folder that may be used, held.
pub struct Inspected {
    /// Held.
    pub manifest: Manifest,
    /// What an earlier call wrote.
    pub ours: Vec<Entry>,
    /// What else there is.
    pub foreign: Vec<Entry>,
}

/// Something that lies in a folder, at any depth: a file, a link, or whatever else is no folder.
pub struct Entry {
    /// Below the folder.
    pub name: PathBuf,
    /// Neither a link nor anything else.
    pub is_file: bool,
}

/// Looks through a folder that exists; refuses it where it must not be used. `None` where another
/// process writes into it.
pub fn inspect(
    path: &Path,
    force: bool,
    inputs: &Inputs,
    nested: Nested,
) -> Result<Option<Inspected>, Failure> {
    if !path.is_dir() {
        return Err(Failure::input(format!(
            "output {} is a file, expected a folder; choose another",
            path.display()
        )));
    }
    // held first where there is something to hold, so that nothing changes while it is looked
    // through
    let opened = || match Manifest::open(path) {
        Ok(opened) => Ok(Some(opened)),
        Err(OpenError::Busy) => Ok(None),
        Err(error) => Err(refused(path, error)),
    };
    let has_manifest = fs::symlink_metadata(path.join(MANIFEST)).is_ok();
    let held = if has_manifest { opened()? } else { None };
    if has_manifest && held.is_none() {
        return Ok(None);
    }
    let found = entries_below(path, nested).map_err(|error| unusable(path, &error))?;
    refuse_inputs(path, &found, inputs)?;
    if !has_manifest && !force {
        refuse_foreign(path, &found)?;
    }
    let Some((manifest, listed)) = held.map_or_else(opened, |held| Ok(Some(held)))? else {
        return Ok(None);
    };
    let (ours, mut foreign) = split(path, found, &listed);
    if nested == Nested::Trusted {
        foreign.retain(|entry| entry.name.file_name() != Some(MANIFEST.as_ref()));
    }
    if force {
        refuse_links(path, &foreign)?;
    } else {
        refuse_foreign(path, &foreign)?;
    }
    Ok(Some(Inspected {
        manifest,
        ours,
        foreign,
    }))
}

pub fn unusable(path: &Path, error: &io::Error) -> Failure {
    Failure::input(format!(
        "output folder {} cannot be written ({error}); choose another",
        path.display()
    ))
}

pub fn refused(path: &Path, error: OpenError) -> Failure {
    match error {
        OpenError::Busy => Failure::input(format!(
            "another process writes into {}; wait for it, or choose another folder",
            path.display()
        )),
        OpenError::Foreign => Failure::input(format!(
            "{} in {} was not written by monogrid; choose another folder",
            MANIFEST,
            path.display()
        )),
        OpenError::Io(error) => unusable(path, &error),
    }
}

fn refuse_inputs(path: &Path, found: &[Entry], inputs: &Inputs) -> Result<(), Failure> {
    if found.is_empty() {
        return Ok(());
    }
    let parents = found
        .iter()
        .flat_map(|entry| entry.name.ancestors().skip(1));
    let mut folders: BTreeSet<_> = parents.map(|parent| path.join(parent)).collect();
    folders.insert(path.to_owned());
    // what links lead to is not touched
    let files = found.iter().filter(|entry| entry.is_file);
    let files = files.map(|entry| path.join(&entry.name));
    let identities = folders.into_iter().chain(files);
    let identities = identities.filter_map(|path| identity(&path)).collect();
    inputs.is_read_in(path, &identities).map_or(Ok(()), |what| {
        Err(Failure::input(format!(
            "the output folder {} holds {what}, which is read; choose another",
            path.display()
        )))
    })
}

fn refuse_foreign(path: &Path, foreign: &[Entry]) -> Result<(), Failure> {
    let [first, others @ ..] = foreign else {
        return Ok(());
    };
    let others = match others.len() {
        0 => String::new(),
        1 => " and another file".to_owned(),
        more => format!(" and {more} other files"),
    };
    Err(Failure::input(format!(
        "output folder {} holds {}{others}, which monogrid did not write or which changed since; \
         choose another, or write beside them with --force (those of the same name are replaced)",
        path.display(),
        first.name.display()
    )))
}

/// What is written into a folder must not end up in another one.
fn refuse_links(path: &Path, foreign: &[Entry]) -> Result<(), Failure> {
    let leads_away = |entry: &&Entry| !entry.is_file && path.join(&entry.name).is_dir();
    match foreign.iter().find(leads_away) {
        Some(link) => Err(Failure::input(format!(
            "output folder {} holds {}, which leads to another folder; choose another",
            path.display(),
            link.name.display()
        ))),
        None => Ok(()),
    }
}

/// Everything below a folder but folders; links are not followed. In the order of the names.
/// Of output folders that are trusted there is the manifest only.
pub fn entries_below(folder: &Path, nested: Nested) -> io::Result<Vec<Entry>> {
    fn collect(root: &Path, below: &Path, nested: Nested, out: &mut Vec<Entry>) -> io::Result<()> {
        let manifest = below.join(MANIFEST);
        let is_root = below.as_os_str().is_empty();
        if nested == Nested::Trusted && !is_root && root.join(&manifest).is_file() {
            out.push(Entry {
                name: manifest,
                is_file: true,
            });
            return Ok(());
        }
        for entry in fs::read_dir(root.join(below))? {
            let entry = entry?;
            let name = below.join(entry.file_name());
            let kind = entry.file_type()?;
            if kind.is_dir() {
                collect(root, &name, nested, out)?;
            } else {
                out.push(Entry {
                    name,
                    is_file: kind.is_file(),
                });
            }
        }
        Ok(())
    }
    let mut out = Vec::new();
    collect(folder, Path::new(""), nested, &mut out)?;
    out.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(out)
}

/// A name as the manifest has it; `None` where it cannot be written there.
pub fn listed_name(name: &Path) -> Option<String> {
    let parts: Option<Vec<&str>> = name.iter().map(|part| part.to_str()).collect();
    let name = parts?.join("/");
    (!name.contains(['\n', '\r'])).then_some(name)
}

/// What was written by us and is as it was, and what else there is; the manifest is neither.
pub fn split(folder: &Path, found: Vec<Entry>, listed: &Listed) -> (Vec<Entry>, Vec<Entry>) {
    let found = found.into_iter();
    let others = found.filter(|entry| entry.name != Path::new(MANIFEST));
    others.partition(|entry| {
        let name = listed_name(&entry.name).filter(|_| entry.is_file);
        name.is_some_and(|name| listed.is_ours(&name, &folder.join(&entry.name)))
    })
}
