//! Where a run is read from: its recording, or its submaps.

use super::RECORDING;
use crate::process::failure::{Classify, Failure};
use monogrid_datasets::{
    ReadOptions, Recording, SUBMAP_FOLDER, SubmapTable, is_submap, is_submap_table, submap_table_in,
};
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

/// A recording, or a table of submaps: both hold the same, and are read by the same call.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Source {
    /// The file.
    pub file: PathBuf,
}

impl Source {
    /// What is meant by a path: a file itself; of a folder its recording, else its submaps, or
    /// those of the run in it.
    pub fn find(path: &Path) -> Result<Self, Failure> {
        let found = if path.is_dir() {
            Self::in_folder(path)
        } else {
            path.exists().then(|| Self {
                file: path.to_owned(),
            })
        };
        found.ok_or_else(|| {
            Failure::input(format!(
                "{}: there is no {RECORDING} and no submaps; expected the output folder of an \
                 earlier run, its submaps, or a recording",
                path.display()
            ))
        })
    }

    /// What a folder holds of a run, if anything.
    pub fn in_folder(folder: &Path) -> Option<Self> {
        let recording = Some(folder.join(RECORDING)).filter(|file| file.is_file());
        let file = recording.or_else(|| submap_table_in(folder))?;
        Some(Self { file })
    }

    /// Whether a path is what a run leaves, and not a map or images.
    pub fn is_at(path: &Path) -> bool {
        if path.is_dir() {
            return Self::in_folder(path).is_some();
        }
        is_submap_table(path) || is_submap(path) || path.extension() == Some(OsStr::new("mgk"))
    }

    /// All of it.
    pub fn read(&self) -> Result<Recording, Failure> {
        Recording::read(&self.file, ReadOptions::default()).bad_input()
    }

    /// The folder with the results of the run.
    pub fn folder_of_run(&self) -> PathBuf {
        folder_of_run(&self.file)
    }
}

/// The folder with the results of the run: that of a recording, or the one around submaps.
pub(super) fn folder_of_run(file: &Path) -> PathBuf {
    let folder = file.parent().unwrap_or(Path::new(""));
    if !is_submap_table(file) {
        return folder.to_owned();
    }
    match (folder.file_name(), folder.parent()) {
        (Some(name), Some(around)) if name == SUBMAP_FOLDER => around.to_owned(),
        // `submaps.json` alone, and `.`
        (None, _) => folder.join(".."),
        _ => folder.to_owned(),
    }
}

/// All files that are read of what a path names, the submaps of a table too; those that exist.
pub fn files_of(path: &Path) -> Vec<PathBuf> {
    let Ok(source) = Source::find(path) else {
        return Vec::new();
    };
    let folder = source.file.parent().unwrap_or(Path::new(""));
    let is_table = is_submap_table(&source.file);
    let table = is_table.then(|| SubmapTable::read(&source.file).ok());
    let submaps = table.flatten().into_iter().flat_map(|table| table.submaps);
    let submaps = submaps.map(|entry| folder.join(entry.file.file_name()));
    submaps.chain([source.file.clone()]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_lie_beside_a_recording_and_around_submaps() {
        for (file, folder) in [
            ("run/recording.mgk", "run"),
            ("recording.mgk", ""),
            ("run/submaps/submaps.json", "run"),
            ("submaps/submaps.json", ""),
            ("elsewhere/submaps.json", "elsewhere"),
            ("submaps.json", ".."),
        ] {
            assert_eq!(folder_of_run(Path::new(file)), Path::new(folder), "{file}");
        }
    }

    #[test]
    fn a_recording_goes_before_submaps() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path();
        assert!(Source::find(path).is_err() && !Source::is_at(path));
        std::fs::create_dir(path.join(SUBMAP_FOLDER)).unwrap();
        let table = path.join("submaps/submaps.json");
        std::fs::write(&table, "").unwrap();
        for place in [path, &path.join("submaps"), &table] {
            assert_eq!(Source::find(place).unwrap().file, table);
            assert!(Source::is_at(place));
        }
        std::fs::write(path.join(RECORDING), "").unwrap();
        assert_eq!(Source::find(path).unwrap().file, path.join(RECORDING));
        assert!(Source::is_at(&path.join(RECORDING)) && Source::find(&path.join("x.mgk")).is_err());
    }
}
