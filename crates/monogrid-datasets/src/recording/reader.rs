//! Reading the records of a recording, whole or damaged.

use super::Record;
use super::format::{
    FILE_HEADER_BYTES, FILE_MAGIC, FORMAT_VERSION, RECORD_HEADER_BYTES, SYNC, decode_record,
    parse_record_header,
};
use crate::DatasetError;
use crate::files::open_file;
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// What to read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReadOptions {
    /// Whether keyframe images are decoded (mapping does not need them).
    pub with_images: bool,
}

impl Default for ReadOptions {
    fn default() -> Self {
        Self { with_images: true }
    }
}

/// What was lost of a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Damage {
    /// Places where bytes could not be understood and reading went on behind them.
    pub num_gaps: u64,
    /// Bytes that belong to no whole record, the tail included.
    pub lost_bytes: u64,
    /// Whether the file ends inside a record, as after a kill.
    pub truncated: bool,
}

/// Bytes that are read ahead.
const BUFFER_BYTES: usize = 1 << 16;

/// Iterates over the whole records of a file.
///
/// Memory and time are bounded by the bytes of the file, whatever they are: no more is allocated
/// than a record has bytes (an image: 64 times as much), and a file is read at most three times.
#[derive(Debug)]
pub struct RecordingReader<R = File> {
    input: BufReader<R>,
    path: PathBuf,
    /// Where the next record is looked for.
    position: u64,
    /// Where the next byte is read.
    offset: u64,
    length: u64,
    /// Bytes of records whose checksum was wrong. Records do not overlap, so that a file as we
    /// write it, however damaged, has no more of them than bytes; one that was made to be read
    /// again and again has.
    refuted_bytes: u64,
    /// Where the last whole record ends.
    whole_until: u64,
    with_images: bool,
    damage: Damage,
}

impl RecordingReader {
    /// Opens a file.
    ///
    /// # Errors
    /// When it cannot be read, is not a recording, or is of a later version.
    pub fn open(path: &Path, options: ReadOptions) -> Result<Self, DatasetError> {
        let (file, _) = open_file(path)?;
        Self::new(file, path, options)
    }
}

impl<R: Read + Seek> RecordingReader<R> {
    /// Reads from anything; `path` is only for messages.
    ///
    /// # Errors
    /// As [`RecordingReader::open`].
    pub fn new(input: R, path: &Path, options: ReadOptions) -> Result<Self, DatasetError> {
        let mut input = BufReader::with_capacity(BUFFER_BYTES, input);
        let io = |e| DatasetError::io("read", path, e);
        let length = input.seek(SeekFrom::End(0)).map_err(io)?;
        input.seek(SeekFrom::Start(0)).map_err(io)?;
        let mut header = [0; FILE_HEADER_BYTES];
        let is_ours = length >= FILE_HEADER_BYTES as u64 && {
            input.read_exact(&mut header).map_err(io)?;
            header[..8] == FILE_MAGIC
        };
        let unusable = |reason: String| DatasetError::binary(path, "recording", reason);
        if !is_ours {
            let reason = "it does not start with `monogrid`, as .mgk files do";
            return Err(unusable(reason.to_owned()));
        }
        let version = u32::from_le_bytes([header[8], header[9], header[10], header[11]]);
        if version != FORMAT_VERSION {
            return Err(unusable(format!(
                "format version {version}, this program reads version {FORMAT_VERSION}"
            )));
        }
        Ok(Self {
            input,
            path: path.to_path_buf(),
            position: FILE_HEADER_BYTES as u64,
            offset: FILE_HEADER_BYTES as u64,
            length,
            refuted_bytes: 0,
            whole_until: FILE_HEADER_BYTES as u64,
            with_images: options.with_images,
            damage: Damage::default(),
        })
    }

    /// Reads on where an earlier reader of the same file, which has grown, had its
    /// [`RecordingReader::whole_until`].
    #[must_use]
    pub fn read_on(mut self, whole_until: u64) -> Self {
        self.position = self.position.max(whole_until);
        self.whole_until = self.position;
        self
    }

    /// Where the last whole record that was read ends, bytes: what follows may still be being
    /// written.
    #[must_use]
    pub fn whole_until(&self) -> u64 {
        self.whole_until
    }

    /// Bytes of the file.
    #[must_use]
    pub fn length(&self) -> u64 {
        self.length
    }

    /// What was lost so far; complete once the iteration ended.
    #[must_use]
    pub fn damage(&self) -> Damage {
        self.damage
    }

    /// The next whole record of a known kind.
    fn next_record(&mut self) -> std::io::Result<Option<Record>> {
        while self.position < self.length {
            let start = self.position;
            match self.read_at(start)? {
                Some((end, outcome)) => {
                    self.position = end;
                    self.whole_until = end;
                    match outcome {
                        Ok(Some(record)) => return Ok(Some(record)),
                        // a kind of a later version
                        Ok(None) => {}
                        Err(()) => {
                            self.damage.num_gaps += 1;
                            self.damage.lost_bytes += end - start;
                        }
                    }
                }
                None => {
                    let next = self.find_sync(start + 1)?;
                    self.damage.lost_bytes += next - start;
                    self.damage.num_gaps += 1;
                    self.damage.truncated |= next == self.length;
                    self.position = next;
                }
            }
        }
        Ok(None)
    }

    /// The record that starts at `start` and where it ends; `None` when no whole one does.
    #[allow(clippy::type_complexity, reason = "private, used once")]
    fn read_at(
        &mut self,
        start: u64,
    ) -> std::io::Result<Option<(u64, Result<Option<Record>, ()>)>> {
        let body = start.saturating_add(RECORD_HEADER_BYTES as u64);
        if body > self.length {
            return Ok(None);
        }
        let mut bytes = [0; RECORD_HEADER_BYTES];
        self.read(start, &mut bytes)?;
        let Some(header) = parse_record_header(&bytes) else {
            return Ok(None);
        };
        let end = body + u64::from(header.payload_bytes);
        // never allocates more than the file holds
        if end > self.length || self.refuted_bytes > self.length {
            return Ok(None);
        }
        let mut payload = vec![0; header.payload_bytes as usize];
        self.read(body, &mut payload)?;
        if crc32fast::hash(&payload) != header.payload_crc {
            self.refuted_bytes += end - start;
            return Ok(None);
        }
        let record = decode_record(header.kind, &payload, self.with_images);
        Ok(Some((end, record)))
    }

    /// Moves to a position, within the buffer where that is possible.
    fn seek(&mut self, position: u64) -> std::io::Result<()> {
        let distance = position.wrapping_sub(self.offset) as i64;
        self.input.seek_relative(distance)?;
        self.offset = position;
        Ok(())
    }

    fn read(&mut self, position: u64, bytes: &mut [u8]) -> std::io::Result<()> {
        self.seek(position)?;
        self.input.read_exact(bytes)?;
        self.offset += bytes.len() as u64;
        Ok(())
    }

    /// First position at or after `from` where a record may start; the end of the file if none.
    fn find_sync(&mut self, from: u64) -> std::io::Result<u64> {
        let mut start = from;
        while start + SYNC.len() as u64 <= self.length {
            self.seek(start)?;
            let chunk = self.input.fill_buf()?;
            if chunk.len() < SYNC.len() {
                // the mark may straddle two buffers
                let mut mark = SYNC;
                self.read(start, &mut mark)?;
                if mark == SYNC {
                    return Ok(start);
                }
                start += 1;
                continue;
            }
            let found = chunk.windows(SYNC.len()).position(|window| window == SYNC);
            if let Some(offset) = found {
                return Ok(start + offset as u64);
            }
            start += (chunk.len() - (SYNC.len() - 1)) as u64;
        }
        Ok(self.length)
    }
}

impl<R: Read + Seek> Iterator for RecordingReader<R> {
    type Item = Result<Record, DatasetError>;

    fn next(&mut self) -> Option<Self::Item> {
        match self.next_record() {
            Ok(record) => record.map(Ok),
            Err(e) => {
                // reported once, then the iteration ends
                self.position = self.length;
                Some(Err(DatasetError::io("read", &self.path, e)))
            }
        }
    }
}
