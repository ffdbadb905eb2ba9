//! Output folders and files: written atomically, replaced only when they are ours.

use crate::failure::Failure;
use std::fs;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// First line of every `config.toml` that we write; a folder with it is ours to replace.
pub const CONFIG_MARKER: &str = "# effective configuration of a monogrid run";

/// Written first into an output folder and removed when `config.toml` is in place, so that a run that
/// was killed early can be repeated.
const STARTED_MARKER: &str = ".monogrid-run";

/// An output folder that was checked to be usable.
#[derive(Debug, Clone)]
pub struct OutputFolder {
    path: PathBuf,
}

impl OutputFolder {
    /// Prepares `path`: creates it, or empties it if we wrote it (or `force`).
    pub fn prepare(path: &Path, force: bool) -> Result<Self, Failure> {
        if path.exists() {
            if !path.is_dir() {
                return Err(Failure::input(format!(
                    "output {} is a file, expected a folder; choose another with --out",
                    path.display()
                )));
            }
            let entries = fs::read_dir(path).map_err(|error| {
                Failure::input(format!(
                    "output folder {} cannot be read ({error}); choose another with --out",
                    path.display()
                ))
            })?;
            if entries.count() > 0 {
                if !force && !is_ours(path) {
                    return Err(Failure::input(format!(
                        "output folder {} exists and was not written by monogrid; \
                         choose another with --out, or replace it with --force",
                        path.display()
                    )));
                }
                clear(path).map_err(|error| unusable(path, &error))?;
            }
        }
        fs::create_dir_all(path).map_err(|error| unusable(path, &error))?;
        let this = Self {
            path: path.to_owned(),
        };
        fs::write(this.file(STARTED_MARKER), CONFIG_MARKER)
            .map_err(|error| unusable(path, &error))?;
        Ok(this)
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The path of a file in it.
    pub fn file(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// Writes a file atomically.
    pub fn write(&self, name: &str, content: impl AsRef<[u8]>) -> Result<(), Failure> {
        write_atomically(&self.file(name), |out| out.write_all(content.as_ref()))
    }

    /// Says that the folder holds a complete run: only `config.toml` marks it as ours from now on.
    pub fn complete(&self) {
        // The marker is only a help for runs that were killed: a leftover does no harm.
        let _ = fs::remove_file(self.file(STARTED_MARKER));
    }
}

fn unusable(path: &Path, error: &io::Error) -> Failure {
    Failure::input(format!(
        "output folder {} cannot be written ({error}); choose another with --out",
        path.display()
    ))
}

/// Whether a folder carries one of our marks.
fn is_ours(path: &Path) -> bool {
    path.join(STARTED_MARKER).is_file()
        || fs::read_to_string(path.join("config.toml"))
            .is_ok_and(|text| text.starts_with(CONFIG_MARKER))
}

/// Removes what is in a folder, not the folder itself (which may be a mount point or a link).
fn clear(path: &Path) -> io::Result<()> {
    for entry in fs::read_dir(path)? {
        let entry = entry?;
        if entry.file_type()?.is_dir() {
            fs::remove_dir_all(entry.path())?;
        } else {
            fs::remove_file(entry.path())?;
        }
    }
    Ok(())
}

/// Writes `path` through a temporary file beside it, so that no reader ever sees half of it.
pub fn write_atomically(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<fs::File>) -> io::Result<()>,
) -> Result<(), Failure> {
    let failed = |error: io::Error| {
        Failure::running(format!("{} cannot be written: {error}", path.display()))
    };
    let name = path
        .file_name()
        .ok_or_else(|| Failure::input(format!("{} is not a file name", path.display())))?;
    let mut temporary_name = std::ffi::OsString::from(".");
    temporary_name.push(name);
    temporary_name.push(format!(".{}.part", std::process::id()));
    let temporary = path.with_file_name(temporary_name);
    let result = (|| {
        let mut out = BufWriter::new(fs::File::create(&temporary)?);
        write(&mut out)?;
        out.into_inner().map_err(io::IntoInnerError::into_error)?;
        fs::rename(&temporary, path)
    })();
    if result.is_err() {
        // best effort: the error that matters is the first one
        let _ = fs::remove_file(&temporary);
    }
    result.map_err(failed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_is_replaced_only_if_it_is_ours_or_forced() {
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("out");
        let folder = OutputFolder::prepare(&out, false).unwrap();
        folder.write("config.toml", CONFIG_MARKER).unwrap();
        folder.complete();
        folder.write("map.ot", "x").unwrap();
        OutputFolder::prepare(&out, false).unwrap();
        assert!(!out.join("map.ot").exists(), "an old run is replaced");

        let other = dir.path().join("photos");
        fs::create_dir(&other).unwrap();
        fs::write(other.join("cat.jpg"), "x").unwrap();
        let error = OutputFolder::prepare(&other, false).unwrap_err();
        assert!(matches!(error, Failure::Input(_)));
        assert!(other.join("cat.jpg").exists());
        OutputFolder::prepare(&other, true).unwrap();
        assert!(!other.join("cat.jpg").exists());
    }

    #[test]
    fn a_failed_write_leaves_the_old_file_and_no_debris() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("file");
        write_atomically(&path, |out| out.write_all(b"old")).unwrap();
        let failed = write_atomically(&path, |out| {
            out.write_all(b"ne")?;
            Err(io::Error::other("full"))
        });
        assert!(failed.is_err());
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
    }
}
