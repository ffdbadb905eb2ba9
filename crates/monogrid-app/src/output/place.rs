//! Where a path leads, whether or not something is there yet.

use std::collections::VecDeque;
use std::ffi::OsString;
use std::fs;
use std::path::{Component, Path, PathBuf};
use std::time::UNIX_EPOCH;

/// Links that are followed before a path is taken for one that leads round in circles, as Linux
/// does.
const MAX_LINKS: usize = 40;

/// The absolute path without links, `.` and `..` that a path leads to. What does not exist yet is
/// where it would be made, also behind a link that leads to nothing.
pub fn resolved(path: &Path) -> PathBuf {
    let absolute = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let mut rest = parts(&absolute);
    let (mut real, mut links) = (PathBuf::new(), 0);
    while let Some(part) = rest.pop_front() {
        if part == ".." {
            real.pop();
            continue;
        }
        real.push(&part);
        let Ok(target) = std::fs::read_link(&real) else {
            continue;
        };
        links += 1;
        if links > MAX_LINKS {
            return absolute;
        }
        real.pop();
        if target.is_absolute() {
            real.clear();
        }
        for part in parts(&target).into_iter().rev() {
            rest.push_front(part);
        }
    }
    // letters as the file system has them, where it does not tell their case apart
    real.canonicalize().unwrap_or(real)
}

/// The absolute path of a file that is written: a link of that name is replaced itself, those that
/// lead to it are followed. `None` where the path ends in no name.
pub fn place_of_file(path: &Path) -> Option<PathBuf> {
    let folder = path
        .parent()
        .filter(|folder| !folder.as_os_str().is_empty());
    Some(resolved(folder.unwrap_or(Path::new("."))).join(path.file_name()?))
}

fn parts(path: &Path) -> VecDeque<OsString> {
    let named = path.components().filter(|part| *part != Component::CurDir);
    named.map(|part| part.as_os_str().to_owned()).collect()
}

/// When a file was changed last, ns since 1970; 0 where the system does not say.
pub fn changed_ns(metadata: &fs::Metadata) -> u128 {
    let changed = metadata.modified().ok();
    let changed = changed.and_then(|time| time.duration_since(UNIX_EPOCH).ok());
    changed.map_or(0, |since| since.as_nanos())
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use std::fs;
    use std::os::unix::fs::symlink;

    #[test]
    fn every_way_to_a_place_is_one() {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path().canonicalize().unwrap();
        fs::create_dir_all(root.join("real/below")).unwrap();
        symlink("real", root.join("link")).unwrap();
        symlink(root.join("real/below"), root.join("far")).unwrap();
        symlink("link/new.mcap", root.join("nothing-there")).unwrap();
        symlink("round", root.join("round")).unwrap();
        let new = root.join("real/new.mcap");
        for way in [
            "real/new.mcap",
            "./real/./new.mcap",
            "link/new.mcap",
            "far/../new.mcap",
            "nowhere/../real/new.mcap",
            "nothing-there",
        ] {
            assert_eq!(resolved(&root.join(way)), new, "{way}");
        }
        assert_eq!(resolved(&root.join("round")), root.join("round"));
        assert_ne!(resolved(&root.join("new.mcap")), new);
    }
}
