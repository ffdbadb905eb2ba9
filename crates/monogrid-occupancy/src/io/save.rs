//! Saving that survives a crash: the old file stays whole until the new one is.

use std::fs::File;
use std::path::Path;

use crate::error::MapError;

/// Writes a file through a temporary one beside it, flushed to disk and then renamed over `path`:
/// after a crash there is the old file or the new one, never half of one.
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
        std::fs::rename(&temporary, path).map_err(failed("replacing"))
    })();
    if result.is_err() {
        // The first error matters; a temporary file that cannot be removed does not.
        let _ = std::fs::remove_file(&temporary);
    }
    result
}
