//! Single files that the user names.

use super::Inputs;
use crate::failure::{Classify, Failure};
use monogrid_datasets::AtomicFile;
use std::io::Write;
use std::path::{Path, PathBuf};

/// A file that may be written.
#[derive(Debug)]
pub struct OutputFile {
    path: PathBuf,
    force: bool,
}

impl OutputFile {
    /// Refuses a path where something exists, unless it is a file and `force` is given, and what is read always.
    pub fn new(path: &Path, force: bool, inputs: &Inputs) -> Result<Self, Failure> {
        if let Some(what) = inputs.is_read(path) {
            return Err(Failure::input(format!(
                "output {} is {what}, which is read; choose another name",
                path.display()
            )));
        }
        let this = Self {
            path: path.to_owned(),
            force,
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
            Ok(_) if !self.force => "; choose another name, or replace it with --force",
            _ => return Ok(()),
        };
        let path = self.path.display();
        Err(Failure::input(format!("output {path} exists{why}")))
    }

    /// Writes the file, whole or not at all. A link is replaced, what it leads to stays as it is.
    pub fn write_with(
        &self,
        write: impl FnOnce(&mut dyn Write) -> anyhow::Result<()>,
    ) -> Result<(), Failure> {
        // it may have come into being while the content was computed
        self.check()?;
        let doing = format!("{} cannot be written", self.path.display());
        let mut file = AtomicFile::create(&self.path).while_running(&doing)?;
        write(&mut file).while_running(&doing)?;
        file.commit().while_running(&doing)
    }

    /// Writes these bytes.
    pub fn write(&self, content: &[u8]) -> Result<(), Failure> {
        self.write_with(|file| Ok(file.write_all(content)?))
    }
}
