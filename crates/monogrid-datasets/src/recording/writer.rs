//! Appending to a recording.

use super::format::{encode_record, file_header};
use super::{DepthRevision, EndRecord, KeyframeRecord, PoseSnapshot, Record, SessionInfo};
use crate::DatasetError;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Writes records one by one; what was appended survives a kill of the process.
#[derive(Debug)]
pub struct RecordingWriter {
    file: File,
    path: PathBuf,
}

impl RecordingWriter {
    /// Starts a recording, replacing an older file.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn create(path: &Path, session: &SessionInfo) -> Result<Self, DatasetError> {
        let file = File::create(path).map_err(|e| DatasetError::io("write", path, e))?;
        let path = path.to_path_buf();
        let mut writer = Self { file, path };
        writer.write(&file_header())?;
        writer.append(&Record::Session(session.clone()))?;
        Ok(writer)
    }

    /// Appends a new keyframe.
    ///
    /// # Errors
    /// When the disk is full or the record too large.
    pub fn append_keyframe(&mut self, keyframe: KeyframeRecord) -> Result<(), DatasetError> {
        self.append(&Record::Keyframe(keyframe))
    }

    /// Appends new depth of a keyframe.
    ///
    /// # Errors
    /// When the disk is full or the record too large.
    pub fn append_depth(&mut self, depth: DepthRevision) -> Result<(), DatasetError> {
        self.append(&Record::Depth(depth))
    }

    /// Appends new poses of all keyframes.
    ///
    /// # Errors
    /// When the disk is full or the record too large.
    pub fn append_poses(&mut self, poses: PoseSnapshot) -> Result<(), DatasetError> {
        self.append(&Record::Poses(poses))
    }

    /// Appends the end marker and makes sure that everything is on the disk.
    ///
    /// # Errors
    /// When the disk is full.
    pub fn finish(mut self, end: EndRecord) -> Result<(), DatasetError> {
        self.append(&Record::End(end))?;
        let synced = self.file.sync_all();
        synced.map_err(|e| DatasetError::io("write", &self.path, e))
    }

    /// Appends any record.
    ///
    /// # Errors
    /// When the disk is full or the record exceeds 4 GiB.
    pub fn append(&mut self, record: &Record) -> Result<(), DatasetError> {
        let bytes = encode_record(record).ok_or_else(|| {
            DatasetError::binary(&self.path, "recording", "a record exceeds 4 GiB")
        })?;
        self.write(&bytes)
    }

    /// Straight to the operating system, so that nothing waits in a buffer of ours.
    fn write(&mut self, bytes: &[u8]) -> Result<(), DatasetError> {
        let written = self.file.write_all(bytes);
        written.map_err(|e| DatasetError::io("write", &self.path, e))
    }
}
