//! Files that appear complete or not at all.

use crate::DatasetError;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// A file written beside its destination and renamed into place by [`AtomicFile::commit`].
///
/// Dropping it without commit removes the temporary file and leaves an older destination untouched.
#[derive(Debug)]
pub struct AtomicFile {
    destination: PathBuf,
    temporary: PathBuf,
    writer: Option<BufWriter<File>>,
}

impl AtomicFile {
    /// Starts writing `destination`, whose folder must exist.
    ///
    /// # Errors
    /// When the folder is not writable.
    pub fn create(destination: &Path) -> Result<Self, DatasetError> {
        let name = destination
            .file_name()
            .unwrap_or_default()
            .to_string_lossy();
        let temporary = destination.with_file_name(format!(".{name}.{}.part", std::process::id()));
        let file =
            File::create(&temporary).map_err(|e| DatasetError::io("write", destination, e))?;
        Ok(Self {
            destination: destination.to_path_buf(),
            temporary,
            writer: Some(BufWriter::with_capacity(1 << 18, file)),
        })
    }

    /// Flushes to the disk and renames into place: after a crash, even of the machine, there is the
    /// old file or the new one, never half of one.
    ///
    /// # Errors
    /// When the disk is full or the destination cannot be replaced; the old file then stays.
    pub fn commit(mut self) -> Result<(), DatasetError> {
        let error = |e| DatasetError::io("write", &self.destination, e);
        let Some(writer) = self.writer.take() else {
            return Ok(());
        };
        let file = writer.into_inner().map_err(|e| error(e.into_error()))?;
        file.sync_all().map_err(error)?;
        // closing before the rename: some systems do not rename open files
        drop(file);
        std::fs::rename(&self.temporary, &self.destination).map_err(error)
    }
}

impl Write for AtomicFile {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.writer
            .as_mut()
            .map_or(Err(std::io::ErrorKind::BrokenPipe.into()), |w| {
                w.write(bytes)
            })
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.writer.as_mut().map_or(Ok(()), Write::flush)
    }
}

impl Drop for AtomicFile {
    fn drop(&mut self) {
        // after a successful commit the temporary file no longer exists, which is fine
        if self.temporary.exists() {
            self.writer = None;
            let _ = std::fs::remove_file(&self.temporary);
        }
    }
}

/// Writes a whole file at once, atomically.
///
/// # Errors
/// When the folder is missing or not writable, or the disk is full.
pub fn write_atomically(destination: &Path, content: &[u8]) -> Result<(), DatasetError> {
    write_atomically_with(destination, |file| file.write_all(content))
}

/// Writes a file with the given function, atomically.
///
/// # Errors
/// As [`write_atomically`], and what the function returns.
pub fn write_atomically_with(
    destination: &Path,
    write: impl FnOnce(&mut AtomicFile) -> std::io::Result<()>,
) -> Result<(), DatasetError> {
    let mut file = AtomicFile::create(destination)?;
    write(&mut file).map_err(|e| DatasetError::io("write", destination, e))?;
    file.commit()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_write_keeps_the_old_file_and_leaves_nothing_behind() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("map.ot");
        write_atomically(&path, b"old").expect("writable");
        let failed = write_atomically_with(&path, |file| {
            file.write_all(b"half")?;
            Err(std::io::Error::other("disk full"))
        });
        assert!(failed.is_err());
        assert_eq!(std::fs::read(&path).expect("old file"), b"old");
        assert_eq!(std::fs::read_dir(folder.path()).expect("folder").count(), 1);
        write_atomically(&path, b"new").expect("writable");
        assert_eq!(std::fs::read(&path).expect("new file"), b"new");
        assert_eq!(std::fs::read_dir(folder.path()).expect("folder").count(), 1);
    }

    #[test]
    fn a_missing_folder_is_an_error_that_names_the_file() {
        let error = write_atomically(Path::new("/no/such/folder/x.txt"), b"").expect_err("missing");
        assert!(
            error.to_string().contains("/no/such/folder/x.txt"),
            "{error}"
        );
    }
}
