//! Single files that the user names.

use super::manifest::{Content, Manifest, Summed};
use super::{Inputs, OutputFolder, place_of_file};
use crate::process::failure::{Classify, Failure};
use monogrid_datasets::AtomicFile;
use std::io::Write;
use std::path::{Path, PathBuf};

/// A file that may be written.
#[derive(Debug)]
pub struct OutputFile {
    path: PathBuf,
    force: bool,
    /// The folder whose manifest may list it.
    folder: Option<PathBuf>,
}

impl OutputFile {
    /// Refuses a path where something exists, unless it is a file and `force` is given, and what is
    /// read always.
    pub fn new(path: &Path, force: bool, inputs: &Inputs) -> Result<Self, Failure> {
        Self::of_folder(None, path, force, inputs)
    }

    /// As [`Self::new`], for a file that is written with an output folder: that of an earlier call
    /// is replaced with the folder.
    pub fn of_folder(
        folder: Option<&Path>,
        path: &Path,
        force: bool,
        inputs: &Inputs,
    ) -> Result<Self, Failure> {
        if let Some(what) = inputs.is_read(path) {
            return Err(Failure::input(format!(
                "output {} is {what}, which is read; choose another name",
                path.display()
            )));
        }
        let this = Self {
            path: path.to_owned(),
            force,
            folder: folder.map(Path::to_owned),
        };
        this.check()?;
        Ok(this)
    }

    /// Where it is written.
    pub fn path(&self) -> &Path {
        &self.path
    }

    fn check(&self) -> Result<(), Failure> {
        let why = match std::fs::symlink_metadata(&self.path) {
            Ok(found) if !found.is_file() && !found.is_symlink() => " and is not a file",
            Ok(_) if !self.force && !self.is_of_its_folder() => {
                "; choose another name, or replace it with --force"
            }
            _ => return Ok(()),
        };
        let path = self.path.display();
        Err(Failure::input(format!("output {path} exists{why}")))
    }

    /// Whether its folder lists what is there, and it is as it was written.
    fn is_of_its_folder(&self) -> bool {
        let folder = self.folder.as_deref();
        folder.is_some_and(|folder| OutputFolder::wrote(folder, &self.path))
    }

    /// Writes the file, whole or not at all. A link is replaced, what it leads to stays as it is.
    pub fn write_with(
        &self,
        write: impl FnOnce(&mut dyn Write) -> anyhow::Result<()>,
    ) -> Result<(), Failure> {
        self.write_listed(None, write)
    }

    /// As [`Self::write_with`], listed in a manifest before the file gets its name.
    pub(super) fn write_listed(
        &self,
        manifest: Option<&Manifest>,
        write: impl FnOnce(&mut dyn Write) -> anyhow::Result<()>,
    ) -> Result<(), Failure> {
        // it may have come into being while the content was computed
        self.check()?;
        let doing = format!("{} cannot be written", self.path.display());
        let mut file = AtomicFile::create(&self.path).while_running(&doing)?;
        let mut summed = Summed::new(&mut file);
        write(&mut summed).while_running(&doing)?;
        if let (Some(manifest), Some(name)) = (manifest, name_beside(&self.path)) {
            let listed = manifest.list(&name, summed.digest(), Content::Whole);
            listed.while_running(&doing)?;
        }
        file.commit().while_running(&doing)
    }

    /// Writes these bytes.
    pub fn write(&self, content: &[u8]) -> Result<(), Failure> {
        self.write_with(|file| Ok(file.write_all(content)?))
    }
}

/// The name in a manifest of a file that lies outside of its folder: its whole path. `None` where
/// it cannot be written there.
pub(super) fn name_beside(path: &Path) -> Option<String> {
    let place = place_of_file(path)?;
    let name = place.to_str()?;
    (!name.contains(['\n', '\r'])).then(|| name.to_owned())
}
