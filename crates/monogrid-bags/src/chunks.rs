//! Recordings whose messages come in chunks.

use crate::error::BagError;
use crate::message::Raw;
use std::collections::VecDeque;
use std::io::Read;
use std::ops::ControlFlow;
use std::path::PathBuf;

/// Most bytes of a record, and of what is in a chunk.
const MAX_BYTES: u64 = 1 << 30;

/// The next bytes of a record, as many as it claims.
pub fn block(input: &mut impl Read, length: u64) -> Result<Vec<u8>, String> {
    if length > MAX_BYTES {
        return Err(format!(
            "a record claims {length} bytes, expected at most {MAX_BYTES}"
        ));
    }
    // grows with what is there, not with what is claimed
    let mut bytes = Vec::new();
    let read = input.take(length).read_to_end(&mut bytes);
    read.map_err(|error| format!("a record cannot be read: {error}"))?;
    if bytes.len() as u64 != length {
        return Err("the file ends within a record".to_owned());
    }
    Ok(bytes)
}

/// What is in a chunk that claims so many bytes.
pub fn unpacked(compression: &str, decoder: impl Read, size: u64) -> Result<Vec<u8>, String> {
    if size > MAX_BYTES {
        return Err(format!(
            "a chunk claims {size} bytes, expected at most {MAX_BYTES}"
        ));
    }
    let mut bytes = Vec::new();
    // one more, to see that there is none
    let read = decoder.take(size + 1).read_to_end(&mut bytes);
    read.map_err(|error| format!("a chunk cannot be decompressed ({compression}): {error}"))?;
    if bytes.len() as u64 != size {
        return Err(format!(
            "a chunk holds {} bytes, expected {size}",
            bytes.len()
        ));
    }
    Ok(bytes)
}

/// The records of a file.
pub trait Records {
    /// Reads some of the file and adds the messages that are in it; breaks at the end.
    fn read_on(&mut self, messages: &mut VecDeque<Raw>) -> Result<ControlFlow<()>, String>;
}

/// Messages one by one, until the end of the file or the first damage.
pub struct InChunks<R> {
    records: R,
    path: PathBuf,
    /// Of the chunk that was read last.
    ready: VecDeque<Raw>,
    ended: bool,
}

impl<R: Records> InChunks<R> {
    pub fn new(records: R, path: PathBuf) -> Self {
        Self {
            records,
            path,
            ready: VecDeque::new(),
            ended: false,
        }
    }
}

impl<R: Records> Iterator for InChunks<R> {
    type Item = Result<Raw, BagError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some(message) = self.ready.pop_front() {
                return Some(Ok(message));
            }
            if self.ended {
                return None;
            }
            match self.records.read_on(&mut self.ready) {
                Ok(ControlFlow::Continue(())) => {}
                Ok(ControlFlow::Break(())) => self.ended = true,
                Err(reason) => {
                    self.ended = true;
                    return Some(Err(BagError::damaged(&self.path, reason)));
                }
            }
        }
    }
}
