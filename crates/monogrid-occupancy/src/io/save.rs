//! Saving that survives a crash: the old file stays whole until the new one is.

use std::fs::File;
use std::path::Path;

use crate::error::MapError;

/// Writes a file through a temporary one beside it, flushed to disk and then renamed over `path`:
/// after a crash, even of the machine, there is the old file or the new one, never half of one.
///
/// # Errors
/// Whatever `write` returns, or a failure to create, flush or rename the file.
pub fn save_atomically(
    path: &Path,
    write: impl FnOnce(&mut File) -> Result<(), MapError>,
) -> Result<(), MapError> {
    let failed = |action: &'static str| {
        move |source| MapError::File {
            action,
            path: path.to_owned(),
            source,
        }
    };
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(format!(".tmp{}", std::process::id()));
    let temporary = path.with_file_name(name);
    let result = (|| {
        let mut file = File::create(&temporary).map_err(failed("creating"))?;
        write(&mut file)?;
        file.sync_all().map_err(failed("flushing"))?;
        // Closed before it is renamed: some systems do not rename open files.
        drop(file);
        std::fs::rename(&temporary, path).map_err(failed("replacing"))?;
        flush_folder(path);
        Ok(())
    })();
    if result.is_err() {
        // The first error matters; a temporary file that cannot be removed does not.
        let _ = std::fs::remove_file(&temporary);
    }
    result
}

/// Flushes the new name of a file. Not every system can open folders, and where it fails the file
/// itself is whole already: no reason to report the save as failed.
fn flush_folder(path: &Path) {
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty());
    if let Ok(folder) = File::open(folder.unwrap_or(Path::new("."))) {
        let _ = folder.sync_all();
    }
}
