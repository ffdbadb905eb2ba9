//! A run that is read from its submaps.

use super::{SUBMAP_TABLE, SubmapReader, SubmapTable};
use crate::recording::Newest;
use crate::{Damage, DatasetError, ReadOptions, Record, Recording};
use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

/// Folder of the submaps in that of their run.
const SUBMAP_FOLDER: &str = "submaps";

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

/// What a recording of the same run gives. A submap that is missing or damaged is an error, since it can be fetched again.
pub(crate) fn read_recording(
    table_file: &Path,
    options: ReadOptions,
) -> Result<Recording, DatasetError> {
    let table = SubmapTable::read(table_file)?;
    let folder = table_file.parent().unwrap_or(Path::new(""));
    let mut newest = Newest::default();
    let mut world = BTreeMap::new();
    for entry in &table.submaps {
        let mut reader = SubmapReader::open(&folder.join(entry.file.file_name()))?;
        world.extend(entry.world_from_keyframes(&mut reader)?);
        for record in reader.records(options) {
            match record? {
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
