//! Folders that the user did not name.

use crate::process::failure::Failure;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Where results go that nobody named a folder for.
const RUNS: &str = "runs";
/// The name that leads to the last of them.
const LATEST: &str = "latest";

/// A new folder `runs/NAME`, or `runs/NAME-2`, ... where that exists; `runs/latest` leads to it
/// from now on.
pub fn numbered_folder(name: &str) -> Result<PathBuf, Failure> {
    let folder = new_folder(Path::new(RUNS), name).map_err(|error| {
        Failure::input(format!(
            "no folder for the results can be made in {RUNS} ({error}); name one with --out"
        ))
    })?;
    if let Err(error) = point_latest(&folder) {
        eprintln!(
            "warning: {RUNS}/{LATEST} does not lead to {}: {error}",
            folder.display()
        );
    }
    Ok(folder)
}

fn new_folder(runs: &Path, name: &str) -> io::Result<PathBuf> {
    fs::create_dir_all(runs)?;
    for number in 1u64.. {
        let folder = match number {
            1 if name != LATEST => runs.join(name),
            1 => continue,
            number => runs.join(format!("{name}-{number}")),
        };
        match fs::create_dir(&folder) {
            Ok(()) => return Ok(folder),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            Err(error) => return Err(error),
        }
    }
    Err(io::ErrorKind::AlreadyExists.into())
}

/// Lets `latest` beside a folder lead to it: a link, or where there are none a text file with its
/// name. Whatever else is called so stays.
fn point_latest(folder: &Path) -> io::Result<()> {
    let (Some(runs), Some(name)) = (folder.parent(), folder.file_name()) else {
        return Ok(());
    };
    let latest = runs.join(LATEST);
    if let Ok(metadata) = fs::symlink_metadata(&latest) {
        let leads_to = if metadata.is_symlink() {
            fs::read_link(&latest)?
        } else if metadata.is_file() && metadata.len() < 4096 {
            PathBuf::from(fs::read_to_string(&latest)?.trim_end())
        } else {
            PathBuf::new()
        };
        // only what leads to a folder beside it is ours
        let is_ours = leads_to.file_name() == Some(leads_to.as_os_str())
            && (metadata.is_symlink() || runs.join(&leads_to).is_dir());
        if !is_ours {
            return Err(io::Error::other("it was not made by monogrid"));
        }
    }
    let temporary = runs.join(format!(".{LATEST}.{}.part", std::process::id()));
    if !link(Path::new(name), &temporary) {
        fs::write(&temporary, format!("{}\n", name.to_string_lossy()))?;
    }
    fs::rename(&temporary, &latest).inspect_err(|_| {
        // the first error is the one that matters
        let _ = fs::remove_file(&temporary);
    })
}

#[cfg(unix)]
fn link(target: &Path, link: &Path) -> bool {
    std::os::unix::fs::symlink(target, link).is_ok()
}

/// Links need rights there that users do not have.
#[cfg(not(unix))]
fn link(_: &Path, _: &Path) -> bool {
    false
}
