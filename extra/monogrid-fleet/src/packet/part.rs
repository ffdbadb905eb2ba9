//! Records that are delivered as they are, large ones in parts.

use super::depth::{deflated, inflated};
use super::{Packet, PacketError};
use monogrid_datasets::Record;
use serde::{Deserialize, Serialize};

/// Bytes of a part at most: a slow link carries it in less than a second.
pub const PART_BYTES: usize = 64 << 10;
/// Bytes of a record at most: the points and edges of some 10,000 keyframes.
const MAX_RECORD_BYTES: usize = 1 << 30;
/// Bytes that a deflated byte can become at most.
const MAX_DEFLATE_RATIO: usize = 1032;

/// A record as a recording has it, header included, deflated; or a part of that.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RecordPart {
    /// Which part, from 0.
    pub index: u32,
    /// Number of parts.
    pub count: u32,
    /// The bytes.
    pub bytes: Vec<u8>,
}

/// The packets of a record.
///
/// # Errors
/// [`PacketError::TooLarge`].
pub fn parts_of(record: &Record) -> Result<Vec<Packet>, PacketError> {
    let bytes = record.encode().ok_or(PacketError::TooLarge)?;
    if bytes.len() > MAX_RECORD_BYTES {
        return Err(PacketError::TooLarge);
    }
    let bytes = deflated(&bytes);
    let count = bytes.len().div_ceil(PART_BYTES) as u32;
    let parts = bytes.chunks(PART_BYTES).zip(0..);
    let part = |(bytes, index): (&[u8], u32)| {
        let bytes = bytes.to_vec();
        Packet::Record(RecordPart {
            index,
            count,
            bytes,
        })
    };
    Ok(parts.map(part).collect())
}

/// A record of which some parts have come.
#[derive(Clone, Debug, Default)]
pub struct Unfinished {
    bytes: Vec<u8>,
    parts: u32,
}

impl Unfinished {
    /// Takes the next part; the record once it is whole. After an error everything is as before.
    ///
    /// # Errors
    /// [`PacketError::Content`] where parts do not follow each other, or are no record.
    pub fn take(&mut self, part: &RecordPart) -> Result<Option<Record>, PacketError> {
        if part.index != self.parts || part.index >= part.count {
            let reason = "parts of a record do not follow each other";
            return Err(PacketError::Content(reason));
        }
        if part.index + 1 < part.count {
            self.bytes.extend(&part.bytes);
            self.parts += 1;
            return Ok(None);
        }
        let bytes = [self.bytes.as_slice(), part.bytes.as_slice()].concat();
        let limit = bytes.len().saturating_mul(MAX_DEFLATE_RATIO);
        let record = inflated(&bytes, limit.min(MAX_RECORD_BYTES));
        let record = record.and_then(|bytes| Record::decode(&bytes));
        let unknown =
            PacketError::Content("the parts of a record are none that this program knows");
        let record = record.ok_or(unknown)?;
        *self = Self::default();
        Ok(Some(record))
    }
}
