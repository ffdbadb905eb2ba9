//! Output folders.

use super::Inputs;
use super::inputs::identity;
use super::manifest::{Content, Digest, Listed, MANIFEST, Manifest, OpenError, Summed};
use super::numbered::numbered_folder;
use crate::failure::{Classify, Failure};
use monogrid_datasets::AtomicFile;
use std::collections::BTreeSet;
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// An output folder that was checked to be usable, and that nobody else uses as long as this exists.
#[derive(Debug)]
pub struct OutputFolder {
    path: PathBuf,
    manifest: Manifest,
    /// Names of what lay there and is not ours.
    foreign: BTreeSet<PathBuf>,
}

/// What becomes of the files of an earlier call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Earlier {
    Removed,
    Kept,
}

/// Something that lies in a folder, at any depth: a file, a link, or whatever else is no folder.
struct Entry {
    /// Below the folder.
    name: PathBuf,
    is_file: bool,
}

impl OutputFolder {
    /// A folder for a new result: made if there is none; what an earlier call wrote into it is removed.
    ///
    /// With `force` it may hold other things, which stay as long as they have the name of no file that is written.
    pub fn replace(path: &Path, force: bool, inputs: &Inputs) -> Result<Self, Failure> {
        Self::open(path, force, inputs, Earlier::Removed)
    }

    /// As [`Self::replace`]; where the user names no folder, a new one under `runs` with this name.
    pub fn named_or_new(
        path: Option<&Path>,
        name: &str,
        force: bool,
        inputs: &Inputs,
    ) -> Result<Self, Failure> {
        match path {
            Some(path) => Self::replace(path, force, inputs),
            None => Self::replace(&numbered_folder(name)?, force, inputs),
        }
    }

    /// As [`Self::replace`], with what an earlier call wrote in its place.
    pub fn resume(path: &Path, force: bool, inputs: &Inputs) -> Result<Self, Failure> {
        Self::open(path, force, inputs, Earlier::Kept)
    }

    fn open(path: &Path, force: bool, inputs: &Inputs, earlier: Earlier) -> Result<Self, Failure> {
        if path.exists() && !path.is_dir() {
            return Err(Failure::input(format!(
                "output {} is a file, expected a folder; choose another",
                path.display()
            )));
        }
        let failed = |error: io::Error| unusable(path, &error);
        fs::create_dir_all(path).map_err(failed)?;
        let found = entries_below(path).map_err(failed)?;
        refuse_inputs(path, &found, inputs)?;
        let has_manifest = found.iter().any(|entry| entry.name == Path::new(MANIFEST));
        if !has_manifest && !force {
            refuse_foreign(path, found.iter())?;
        }
        let (manifest, listed) = Manifest::open(path).map_err(|error| refused(path, error))?;
        let (ours, foreign) = split(path, found, &listed);
        if force {
            refuse_links(path, &foreign)?;
        } else {
            refuse_foreign(path, foreign.iter())?;
        }
        if earlier == Earlier::Removed {
            remove(path, &ours).map_err(failed)?;
            manifest.clear().map_err(failed)?;
        }
        manifest.begin().map_err(failed)?;
        Ok(Self {
            path: path.to_owned(),
            manifest,
            foreign: foreign.into_iter().map(|entry| entry.name).collect(),
        })
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Writes a file, whole or not at all; `name` may be in a subfolder, with `/`.
    pub fn write(&self, name: &str, content: impl AsRef<[u8]>) -> Result<(), Failure> {
        self.write_with(name, |file| Ok(file.write_all(content.as_ref())?))
    }

    /// As [`Self::write`], with content that is made while it is written.
    pub fn write_with(
        &self,
        name: &str,
        write: impl FnOnce(&mut dyn Write) -> anyhow::Result<()>,
    ) -> Result<(), Failure> {
        let path = self.place(name)?;
        let doing = format!("{} cannot be written", path.display());
        let mut file = AtomicFile::create(&path).while_running(&doing)?;
        let mut summed = Summed::new(&mut file);
        write(&mut summed).while_running(&doing)?;
        let content = Content::Whole(summed.digest());
        self.manifest.list(name, content).while_running(&doing)?;
        file.commit().while_running(&doing)
    }

    /// The path of a file that grows and is written by somebody else. What has that name is removed.
    pub fn begin(&self, name: &str) -> Result<PathBuf, Failure> {
        let path = self.place(name)?;
        let doing = format!("{} cannot be replaced", path.display());
        match fs::remove_file(&path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                Err(error).while_running(&doing)?;
            }
            _ => {}
        }
        let nothing = Digest::of(io::empty()).while_running(&doing)?;
        let content = Content::Begins(nothing);
        self.manifest.list(name, content).while_running(&doing)?;
        Ok(path)
    }

    /// Lists a file that somebody else wrote, as it is now; one that grows may do so.
    pub fn list(&self, name: &str, content: fn(Digest) -> Content) -> Result<(), Failure> {
        let path = self.path.join(name);
        let doing = format!("{} cannot be read", path.display());
        let file = fs::File::open(&path).while_running(&doing)?;
        let digest = Digest::of(file).while_running(&doing)?;
        self.manifest
            .list(name, content(digest))
            .while_running(&doing)
    }

    /// Lists everything that has come into the folder since it was opened.
    pub fn list_new(&self) -> Result<(), Failure> {
        let doing = format!("{} cannot be read", self.path.display());
        for entry in entries_below(&self.path).while_running(&doing)? {
            let is_new = entry.is_file && !self.foreign.contains(&entry.name);
            if let Some(name) = listed_name(&entry.name).filter(|name| is_new && name != MANIFEST) {
                self.list(&name, Content::Whole)?;
            }
        }
        Ok(())
    }

    /// Removes what was written, and the folder if nothing else lies in it.
    pub fn discard(self) -> Result<(), Failure> {
        let Self { path, manifest, .. } = self;
        let failed = |error: io::Error| unusable(&path, &error);
        let listed = manifest.listed().map_err(|error| refused(&path, error))?;
        let found = entries_below(&path).map_err(failed)?;
        let (mut ours, foreign) = split(&path, found, &listed);
        ours.push(Entry {
            name: MANIFEST.into(),
            is_file: true,
        });
        // closed first: some systems do not remove open files
        drop(manifest);
        remove(&path, &ours).map_err(failed)?;
        if foreign.is_empty() {
            fs::remove_dir(&path).map_err(failed)?;
        }
        Ok(())
    }

    /// Where a file is written; its subfolder is made, and must not be a link to somewhere else.
    fn place(&self, name: &str) -> Result<PathBuf, Failure> {
        let mut path = self.path.clone();
        let (folders, file) = name
            .rsplit_once('/')
            .map_or((None, name), |(f, n)| (Some(f), n));
        for folder in folders.into_iter().flat_map(|folders| folders.split('/')) {
            path.push(folder);
            match fs::symlink_metadata(&path) {
                Ok(metadata) if metadata.is_dir() => {}
                Ok(_) => {
                    return Err(Failure::running(format!(
                        "{} is not a folder, nothing is written there",
                        path.display()
                    )));
                }
                Err(_) => fs::create_dir(&path).map_err(|error| unusable(&path, &error))?,
            }
        }
        Ok(path.join(file))
    }
}

fn unusable(path: &Path, error: &io::Error) -> Failure {
    Failure::input(format!(
        "output folder {} cannot be written ({error}); choose another",
        path.display()
    ))
}

fn refused(path: &Path, error: OpenError) -> Failure {
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
    let mut folders = BTreeSet::from([path.to_owned()]);
    folders.extend(found.iter().flat_map(|entry| {
        let parents = entry.name.ancestors().skip(1);
        parents.map(|parent| path.join(parent))
    }));
    // what links lead to is not touched
    let files = found.iter().filter(|entry| entry.is_file);
    let files = files.map(|entry| path.join(&entry.name));
    let identities = folders.into_iter().chain(files);
    let identities = identities.filter_map(|path| identity(&path)).collect();
    match inputs.is_read_in(path, &identities) {
        Some(what) => Err(Failure::input(format!(
            "the output folder {} holds {what}, which is read; choose another",
            path.display()
        ))),
        None => Ok(()),
    }
}

fn refuse_foreign<'a>(
    path: &Path,
    mut foreign: impl ExactSizeIterator<Item = &'a Entry>,
) -> Result<(), Failure> {
    let count = foreign.len();
    let Some(first) = foreign.next() else {
        return Ok(());
    };
    let others = match count - 1 {
        0 => String::new(),
        1 => " and another file".to_owned(),
        more => format!(" and {more} other files"),
    };
    Err(Failure::input(format!(
        "output folder {} holds {}{others}, which monogrid did not write or which changed since; choose another, or \
         write beside them with --force (those of the same name are replaced)",
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
fn entries_below(folder: &Path) -> io::Result<Vec<Entry>> {
    fn collect(root: &Path, below: &Path, out: &mut Vec<Entry>) -> io::Result<()> {
        for entry in fs::read_dir(root.join(below))? {
            let entry = entry?;
            let name = below.join(entry.file_name());
            let kind = entry.file_type()?;
            if kind.is_dir() {
                collect(root, &name, out)?;
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
    collect(folder, Path::new(""), &mut out)?;
    out.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(out)
}

/// A name as the manifest has it; `None` where it cannot be written there.
fn listed_name(name: &Path) -> Option<String> {
    let parts: Option<Vec<&str>> = name.iter().map(|part| part.to_str()).collect();
    let name = parts?.join("/");
    (!name.contains(['\n', '\r'])).then_some(name)
}

/// What was written by us and is as it was, and what else there is; the manifest is neither.
fn split(folder: &Path, found: Vec<Entry>, listed: &Listed) -> (Vec<Entry>, Vec<Entry>) {
    let others = found
        .into_iter()
        .filter(|entry| entry.name != Path::new(MANIFEST));
    others.partition(|entry| {
        let name = listed_name(&entry.name).filter(|_| entry.is_file);
        name.is_some_and(|name| listed.is_ours(&name, &folder.join(&entry.name)))
    })
}

/// Removes files and the subfolders that are empty without them.
fn remove(folder: &Path, ours: &[Entry]) -> io::Result<()> {
    let mut folders = BTreeSet::new();
    for entry in ours {
        fs::remove_file(folder.join(&entry.name))?;
        let parents = entry.name.ancestors().skip(1);
        folders.extend(parents.filter(|parent| !parent.as_os_str().is_empty()));
    }
    // the deepest first
    for below in folders.into_iter().rev() {
        // one that holds something else stays
        let _ = fs::remove_dir(folder.join(below));
    }
    Ok(())
}
