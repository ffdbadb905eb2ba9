//! A recording that is still being written.

use monogrid_datasets::{DatasetError, ReadOptions, Record, RecordingReader};
use std::path::PathBuf;

/// Reads the records of a recording as they come.
#[derive(Debug, Default)]
pub struct Tail {
    /// The file, which need not exist yet.
    pub path: PathBuf,
    /// Bytes of the file when it was last looked at.
    pub length: u64,
    pub whole_until: u64,
}

impl Tail {
    /// Hands on the records that have become whole since the last call; whether the file has grown.
    ///
    /// # Errors
    /// When the file cannot be read or is no recording, or what `take` says.
    pub fn read<E: From<DatasetError>>(
        &mut self,
        mut take: impl FnMut(&Record) -> Result<(), E>,
    ) -> Result<bool, E> {
        // a recording begins with a header that may not be there yet
        let length = self.path.metadata().map_or(0, |file| file.len());
        if length == self.length || length < HEADER_BYTES {
            return Ok(false);
        }
        self.length = length;
        let reader = RecordingReader::open(&self.path, ReadOptions::default())?;
        let mut reader = reader.read_on(self.whole_until);
        while let Some(record) = reader.next() {
            take(&record?)?;
            self.whole_until = reader.whole_until();
        }
        Ok(true)
    }
}

/// Bytes of the header of a recording.
const HEADER_BYTES: u64 = 16;
