//! What a call reads, and so must not write.

use crate::process::failure::{Classify, Failure};
use monogrid_datasets::{Dataset, SourceOptions};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Files and folders that a call reads.
#[derive(Clone, Debug, Default)]
pub struct Inputs {
    /// What each is, for people, and where it lies.
    read: Vec<(&'static str, PathBuf)>,
}

/// What a file is, whatever its name: the same for all links to it.
#[cfg(unix)]
pub(super) type Identity = (u64, u64);
/// What a file is, whatever its name; hard links count as files of their own.
#[cfg(not(unix))]
pub(super) type Identity = PathBuf;

/// The identity of what a path leads to; `None` where nothing can be read.
pub(super) fn identity(path: &Path) -> Option<Identity> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        let metadata = std::fs::metadata(path).ok()?;
        Some((metadata.dev(), metadata.ino()))
    }
    #[cfg(not(unix))]
    path.canonicalize().ok()
}

/// The map in the folder of a run.
pub const MAP: &str = "global.ot";

/// The map that a path leads to: the file, or that of the run in a folder.
#[must_use]
pub fn map_at(path: &Path) -> PathBuf {
    result_at(path, MAP)
}

/// The result of this name that a path leads to: the file, or that of the run in a folder.
#[must_use]
pub fn result_at(path: &Path, name: &str) -> PathBuf {
    let file = path.join(name);
    match file.is_file() {
        true => file,
        false => path.to_owned(),
    }
}

impl Inputs {
    /// One file or folder; `what` names it in sentences.
    pub fn of(what: &'static str, path: impl Into<PathBuf>) -> Self {
        Self::default().and(what, path)
    }

    /// These and another one; an empty path is none.
    #[must_use]
    pub fn and(mut self, what: &'static str, path: impl Into<PathBuf>) -> Self {
        let path = path.into();
        if !path.as_os_str().is_empty() {
            let map = Some(map_at(&path)).filter(|map| *map != path);
            self.read.push((what, path));
            self.read.extend(map.map(|map| (what, map)));
        }
        self
    }

    /// These and others, such as an option that may be missing.
    #[must_use]
    pub fn and_all<P: Into<PathBuf>>(
        self,
        what: &'static str,
        paths: impl IntoIterator<Item = P>,
    ) -> Self {
        let paths = paths.into_iter();
        paths.fold(self, |inputs, path| inputs.and(what, path))
    }

    /// These and the file that an argument such as `gt:FILE` names.
    #[must_use]
    pub fn and_named(self, what: &'static str, argument: Option<&str>) -> Self {
        let file = argument.and_then(|text| Some(text.split_once(':')?.1));
        self.and_all(what, file)
    }

    /// These and all files of a folder or list of images and depth images.
    pub fn and_dataset(self, source: &Path) -> Result<Self, Failure> {
        let dataset = Dataset::open(source, SourceOptions::default()).bad_input()?;
        Ok(self.and("the source", source).and_files_of(&dataset))
    }

    /// These and all files of a sequence.
    #[must_use]
    pub fn and_files_of(self, dataset: &Dataset) -> Self {
        let images = dataset.frames.iter().map(|frame| &frame.path);
        let depths = dataset.depths.iter().map(|depth| &depth.path);
        self.and_all("an image", images)
            .and_all("a depth image", depths)
            .and_all("the reference trajectory", &dataset.ground_truth)
            .and_all("the calibration", &dataset.calibration_path)
            .and_all("the calibration", &dataset.depth_calibration_path)
            .and_all("the response", &dataset.response_path)
            .and_all("the vignette", &dataset.vignette_path)
            .and_all("the inertial readings", &dataset.imu_path)
    }

    /// Where all of them lie, as they were named.
    pub fn paths(&self) -> impl Iterator<Item = &Path> {
        self.read.iter().map(|(_, path)| path.as_path())
    }

    /// What an input that a path leads to is.
    pub(super) fn is_read(&self, path: &Path) -> Option<&'static str> {
        let wanted = identity(path)?;
        let is_it = |read: &PathBuf| identity(read).is_some_and(|read| read == wanted);
        let found = self.read.iter().find(|(_, read)| is_it(read));
        found.map(|(what, _)| *what)
    }

    /// What an input is that lies in `folder` by its name, or is one of the files of `identities`.
    pub(super) fn is_read_in(
        &self,
        folder: &Path,
        identities: &BTreeSet<Identity>,
    ) -> Option<&'static str> {
        let folder = folder.canonicalize().ok()?;
        let mut last_parent: Option<(PathBuf, Option<PathBuf>)> = None;
        let mut is_below = |read: &Path| {
            let parent = read.parent().filter(|p| !p.as_os_str().is_empty());
            let parent = parent.unwrap_or(Path::new("."));
            // images of a sequence have one parent
            if last_parent.as_ref().is_none_or(|(of, _)| of != parent) {
                last_parent = Some((parent.to_owned(), parent.canonicalize().ok()));
            }
            let real = last_parent.as_ref().and_then(|(_, real)| real.as_ref());
            real.is_some_and(|real| real.starts_with(&folder))
        };
        let mut read = self.read.iter();
        read.find(|(_, path)| {
            is_below(path) || identity(path).is_some_and(|id| identities.contains(&id))
        })
        .map(|(what, _)| *what)
    }
}
