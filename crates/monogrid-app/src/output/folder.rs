//! Output folders.

use super::Inputs;
use super::file::{OutputFile, name_beside};
use super::inspect::{
    Entry, Nested, entries_below, inspect, listed_name, refused, split, unusable,
};
use super::manifest::{Content, Digest, Listed, MANIFEST, Manifest, OpenError, Summed};
use super::numbered::numbered_folder;
use crate::process::failure::{Classify, Failure};
use monogrid_datasets::AtomicFile;
use std::collections::BTreeSet;
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

/// An output folder that was checked to be usable, and that nobody else uses as long as this
/// exists.
#[derive(Debug)]
pub struct OutputFolder {
    path: PathBuf,
    manifest: Manifest,
    /// Names of what lay there and is not ours.
    foreign: BTreeSet<PathBuf>,
}

/// How long it is waited for others that look through a folder of folders.
const PATIENCE: Duration = Duration::from_secs(30);

/// What becomes of the files of an earlier call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Earlier {
    Removed,
    Kept,
}

impl OutputFolder {
    /// A folder for a new result: made if there is none; what an earlier call wrote into it is
    /// removed.
    ///
    /// With `force` it may hold other things, which stay as long as they have the name of no file
    /// that is written.
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

    /// As [`Self::resume`]; `None` where another process writes into the folder.
    pub fn resume_unless_in_use(path: &Path, force: bool) -> Result<Option<Self>, Failure> {
        Self::open_unless_in_use(path, force, &Inputs::default(), Earlier::Kept)
    }

    /// Whether another process writes into a folder of ours.
    pub fn is_in_use(path: &Path) -> bool {
        path.join(MANIFEST).is_file() && matches!(Manifest::open(path), Err(OpenError::Busy))
    }

    /// Whether a folder lists a file outside of it, which is as it was written.
    pub fn wrote(folder: &Path, file: &Path) -> bool {
        let listed = Manifest::read(folder);
        let name = name_beside(file);
        let is_file = fs::symlink_metadata(file).is_ok_and(|metadata| metadata.is_file());
        let mut beside = listed.iter().flat_map(Listed::beside);
        is_file && beside.any(|(listed, ..)| Some(listed) == name.as_deref())
    }

    /// Writes a file outside of the folder, which the folder replaces when it is replaced itself.
    pub fn write_beside(
        &self,
        file: &OutputFile,
        write: impl FnOnce(&mut dyn Write) -> anyhow::Result<()>,
    ) -> Result<(), Failure> {
        file.write_listed(Some(&self.manifest), write)
    }

    /// Refuses what [`Self::resume`] would refuse, and changes nothing. A folder that does not
    /// exist, or into which another process writes, is not looked into.
    pub fn check(path: &Path, force: bool) -> Result<(), Failure> {
        if !path.exists() {
            return Ok(());
        }
        inspect(path, force, &Inputs::default(), Nested::Searched).map(|_| ())
    }

    /// A folder in which nothing lies but other output folders, each with a manifest of its own. It
    /// is made if there is none and marked as ours; nobody holds it, so that several processes may
    /// work on the folders in it.
    pub fn of_folders(path: &Path, force: bool, inputs: &Inputs) -> Result<(), Failure> {
        fs::create_dir_all(path).map_err(|error| unusable(path, &error))?;
        // others hold it for as long as they look through it
        let begin = Instant::now();
        let inspected = loop {
            match inspect(path, force, inputs, Nested::Trusted)? {
                Some(inspected) => break inspected,
                None if begin.elapsed() < PATIENCE => thread::sleep(PATIENCE / 1000),
                None => return Err(refused(path, OpenError::Busy)),
            }
        };
        let begun = inspected.manifest.begin();
        begun.map_err(|error| unusable(path, &error))
    }

    fn open(path: &Path, force: bool, inputs: &Inputs, earlier: Earlier) -> Result<Self, Failure> {
        let opened = Self::open_unless_in_use(path, force, inputs, earlier)?;
        opened.ok_or_else(|| refused(path, OpenError::Busy))
    }

    fn open_unless_in_use(
        path: &Path,
        force: bool,
        inputs: &Inputs,
        earlier: Earlier,
    ) -> Result<Option<Self>, Failure> {
        let failed = |error: io::Error| unusable(path, &error);
        if !path.exists() {
            fs::create_dir_all(path).map_err(failed)?;
        }
        let Some(found) = inspect(path, force, inputs, Nested::Searched)? else {
            return Ok(None);
        };
        let listed = found.manifest.listed().map_err(|e| refused(path, e))?;
        if earlier == Earlier::Removed {
            remove(path, &found.ours).map_err(failed)?;
            found.manifest.clear().map_err(failed)?;
        }
        found.manifest.begin().map_err(failed)?;
        if earlier == Earlier::Removed {
            // they stay until they are replaced
            for (name, digest, content) in listed.beside() {
                let listed = found.manifest.list(name, digest, content);
                listed.map_err(failed)?;
            }
        }
        let foreign = found.foreign.into_iter().map(|entry| entry.name);
        Ok(Some(Self {
            path: path.to_owned(),
            manifest: found.manifest,
            foreign: foreign.collect(),
        }))
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
        let listed = self.manifest.list(name, summed.digest(), Content::Whole);
        listed.while_running(&doing)?;
        file.commit().while_running(&doing)
    }

    /// The path of a file that grows and is written by somebody else. What has that name is
    /// removed.
    pub fn begin(&self, name: &str) -> Result<PathBuf, Failure> {
        let path = self.place(name)?;
        let doing = format!("{} cannot be replaced", path.display());
        unless(io::ErrorKind::NotFound, fs::remove_file(&path)).while_running(&doing)?;
        let nothing = Digest::of(io::empty()).while_running(&doing)?;
        let listed = self.manifest.list(name, nothing, Content::Begins);
        listed.while_running(&doing)?;
        Ok(path)
    }

    /// Lists a file that somebody else wrote, as it is now; one that grows may do so.
    pub fn list(&self, name: &str, content: Content) -> Result<(), Failure> {
        let path = self.path.join(name);
        let doing = format!("{} cannot be read", path.display());
        let file = fs::File::open(&path).while_running(&doing)?;
        let digest = Digest::of(file).while_running(&doing)?;
        let listed = self.manifest.list(name, digest, content);
        listed.while_running(&doing)
    }

    /// Lists everything that has come into the folder since it was opened.
    pub fn list_new(&self) -> Result<(), Failure> {
        let doing = format!("{} cannot be read", self.path.display());
        for entry in entries_below(&self.path, Nested::Searched).while_running(&doing)? {
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
        let found = entries_below(&path, Nested::Searched).map_err(failed)?;
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
        let mut folders: Vec<&str> = name.split('/').collect();
        let file = folders.pop().unwrap_or_default();
        for folder in folders {
            path.push(folder);
            // there may be one, or another thread was faster
            let made = unless(io::ErrorKind::AlreadyExists, fs::create_dir(&path));
            made.map_err(|error| unusable(&path, &error))?;
            if !fs::symlink_metadata(&path).is_ok_and(|metadata| metadata.is_dir()) {
                return Err(Failure::running(format!(
                    "{} is not a folder, nothing is written there",
                    path.display()
                )));
            }
        }
        Ok(path.join(file))
    }
}

/// A result with errors of this kind taken for success.
fn unless(kind: io::ErrorKind, result: io::Result<()>) -> io::Result<()> {
    result.or_else(|error| match error.kind() == kind {
        true => Ok(()),
        false => Err(error),
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Barrier;

    #[test]
    fn threads_may_write_into_a_new_subfolder_at_once() {
        const THREADS: usize = 4;
        let dir = tempfile::tempdir().unwrap();
        let folder = OutputFolder::replace(&dir.path().join("out"), false, &Inputs::default());
        let folder = folder.unwrap();
        for round in 0..100 {
            let barrier = Barrier::new(THREADS);
            thread::scope(|scope| {
                for thread in 0..THREADS {
                    let (folder, barrier) = (&folder, &barrier);
                    scope.spawn(move || {
                        barrier.wait();
                        let name = format!("{round}/below/{thread}.txt");
                        folder.write(&name, "content").unwrap();
                    });
                }
            });
            let written = fs::read_dir(folder.path().join(format!("{round}/below")));
            assert_eq!(written.unwrap().count(), THREADS);
        }
    }
}
