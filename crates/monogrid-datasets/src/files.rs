//! Opening files that may be anything. Paths may lead into archives that are open.

use crate::{DatasetError, archive};
use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

/// Opens a regular file (through links) and says how many bytes it has.
///
/// Anything else is refused before it is opened: a pipe would wait for a writer for ever, a device
/// may have no end.
///
/// # Errors
/// When it does not exist, is a folder, pipe or device, or cannot be opened.
pub fn open_file(path: &Path) -> Result<(File, u64), DatasetError> {
    let io = |e| DatasetError::io("read", path, e);
    let metadata = std::fs::metadata(path).map_err(io)?;
    if !metadata.is_file() {
        let found = if metadata.is_dir() {
            "a folder"
        } else {
            "a pipe, socket or device"
        };
        return Err(DatasetError::content(path, found, "a regular file"));
    }
    Ok((File::open(path).map_err(io)?, metadata.len()))
}

/// The content of a regular file of at most `max_bytes`.
///
/// A path may lead into the archive of a [`Dataset`](crate::Dataset) that is still there.
///
/// # Errors
/// When it cannot be read, is a folder, pipe or device, or holds more.
pub fn read_file(path: &Path, max_bytes: u64) -> Result<Vec<u8>, DatasetError> {
    let most = max_bytes.saturating_add(1);
    let bytes = match archive::within(path) {
        Some((archive, name)) if archive.is_file(&name) => archive.read(&name, most),
        _ => {
            let (file, length) = open_file(path)?;
            let mut bytes = Vec::with_capacity(length.min(max_bytes) as usize);
            // files of the system say that they are empty, and are not
            let read = file.take(most).read_to_end(&mut bytes);
            read.map(|_| bytes)
        }
    };
    let bytes = bytes.map_err(|e| DatasetError::io("read", path, e))?;
    if bytes.len() as u64 > max_bytes {
        let found = format!("more than {max_bytes} bytes");
        let expected = format!("a file of at most {max_bytes} bytes");
        return Err(DatasetError::content(path, found, expected));
    }
    Ok(bytes)
}

/// Whether a path leads to a regular file.
pub(crate) fn is_file(path: &Path) -> bool {
    match archive::within(path) {
        Some((archive, name)) if archive.is_file(&name) => true,
        _ => path.is_file(),
    }
}

/// Whether a path leads to a folder.
pub(crate) fn is_folder(path: &Path) -> bool {
    match archive::within(path) {
        Some((archive, name)) if archive.is_folder(&name) => true,
        _ => path.is_dir(),
    }
}

/// Paths of the files and folders in a folder, in any order.
pub(crate) fn paths_in(folder: &Path) -> io::Result<Vec<PathBuf>> {
    match archive::within(folder) {
        Some((archive, name)) if archive.is_folder(&name) => {
            let names = archive.names_in(&name).into_iter();
            Ok(names.map(|name| folder.join(name)).collect())
        }
        _ => {
            let entries = std::fs::read_dir(folder)?;
            Ok(entries
                .filter_map(|entry| Some(entry.ok()?.path()))
                .collect())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_files_of_the_size_asked_for_are_read() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("f");
        std::fs::write(&path, b"12345").expect("writable");
        assert_eq!(read_file(&path, 5).expect("five bytes"), b"12345");
        let error = read_file(&path, 4).expect_err("too long").to_string();
        assert!(error.contains("at most 4 bytes"), "{error}");
        let error = read_file(folder.path(), 5)
            .expect_err("a folder")
            .to_string();
        assert!(
            error.contains("a folder, expected a regular file"),
            "{error}"
        );
        assert!(read_file(&folder.path().join("none"), 5).is_err());
    }

    #[cfg(unix)]
    #[test]
    fn pipes_and_devices_are_refused_at_once() {
        let folder = tempfile::tempdir().expect("folder");
        let pipe = folder.path().join("pipe.png");
        let made = std::process::Command::new("mkfifo").arg(&pipe).status();
        let link = folder.path().join("link.png");
        std::os::unix::fs::symlink("/dev/zero", &link).expect("link");
        let mut odd = vec![link, "/dev/zero".into()];
        if made.is_ok_and(|status| status.success()) {
            odd.push(pipe);
        }
        for path in odd {
            let error = read_file(&path, 5).expect_err("no file").to_string();
            assert!(error.contains("pipe, socket or device"), "{error}");
        }
    }
}
