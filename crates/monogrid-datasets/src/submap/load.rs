//! A run that is read from its submaps.

use super::{ENDING, SUBMAP_TABLE, SubmapReader, SubmapTable};
use crate::recording::{Newest, spend};
use crate::{Damage, DatasetError, PixelBudget, PoseSnapshot, ReadOptions, Record, Recording};
use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

/// Folder of the submaps in that of their run.
pub const SUBMAP_FOLDER: &str = "submaps";

/// Whether a path names one submap.
#[must_use]
pub fn is_submap(path: &Path) -> bool {
    path.extension() == Some(OsStr::new(ENDING))
}

/// Whether a path names a table of submaps, and not a recording.
#[must_use]
pub fn is_submap_table(path: &Path) -> bool {
    path.file_name() == Some(OsStr::new(SUBMAP_TABLE))
}

/// The table of submaps in a folder: that of submaps, or of the run that closed them.
#[must_use]
pub fn submap_table_in(folder: &Path) -> Option<PathBuf> {
    let tables = [
        folder.join(SUBMAP_TABLE),
        folder.join(SUBMAP_FOLDER).join(SUBMAP_TABLE),
    ];
    tables.into_iter().find(|table| table.is_file())
}

/// What a recording of the same run gives. A submap that is missing or damaged is an error, since
/// it can be fetched again.
pub(crate) fn read_recording(
    table_file: &Path,
    options: ReadOptions,
) -> Result<Recording, DatasetError> {
    let table = SubmapTable::read(table_file)?;
    let folder = table_file.parent().unwrap_or(Path::new(""));
    let mut newest = Newest::default();
    let mut world = BTreeMap::new();
    for entry in &table.submaps {
        let path = folder.join(entry.file.file_name());
        let mut budget = PixelBudget::of_recording(&path, length_of(&path));
        let mut reader = SubmapReader::open(&path)?;
        world.extend(entry.world_from_keyframes(&mut reader)?);
        for record in reader.records(options) {
            let record = record?;
            spend(&mut budget, &record)?;
            match record {
                // those within the submap
                Record::Poses(_) => {}
                record => newest.take(record),
            }
        }
    }
    if let Some(snapshot) = table.snapshot(world) {
        newest.take(Record::Poses(snapshot));
    }
    newest.into_recording(Damage::default(), table_file)
}

/// One submap as a recording of its own: the world is its frame, keyframes are counted from 0, and
/// what the run says of all of them, or of those of other submaps, is left out.
pub(crate) fn read_single(file: &Path, options: ReadOptions) -> Result<Recording, DatasetError> {
    let mut reader = SubmapReader::open(file)?;
    let mut newest = Newest::default();
    let mut budget = PixelBudget::of_recording(file, length_of(file));
    for record in reader.records(options) {
        let record = record?;
        spend(&mut budget, &record)?;
        match record {
            Record::Poses(_) | Record::Continuation(_) | Record::End(_) => {}
            record => newest.take(record),
        }
    }
    let poses = reader.poses()?.into_iter();
    newest.take(Record::Poses(PoseSnapshot {
        revision: 0,
        poses: poses.filter_map(|(id, pose)| Some((id, pose?))).collect(),
    }));
    let mut recording = newest.into_recording(Damage::default(), file)?;
    for (id, keyframe) in (0..).zip(&mut recording.keyframes) {
        keyframe.id = id;
    }
    Ok(recording)
}

/// Bytes of a file; 0 of none, which is said by who opens it.
fn length_of(path: &Path) -> u64 {
    std::fs::metadata(path).map_or(0, |file| file.len())
}
