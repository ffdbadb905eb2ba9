//! Records that are delivered as they are, large ones in parts.

use super::bounds::{MAX_RECORD_BYTES, at_most, record_limit};
use super::depth::{deflated, inflated};
use super::{Packet, PacketError};
use flate2::read::DeflateDecoder;
use monogrid_datasets::Record;
use serde::{Deserialize, Serialize};
use std::io::Read;

/// Bytes of a part at most: a slow link carries it in less than a second.
pub const PART_BYTES: usize = 64 << 10;
/// Bytes that a deflated byte becomes at most in records of more than [`SMALL_BYTES`]: numbers of
/// points and edges take a third of theirs. A deflate stream can be made to hold a thousand.
const MAX_GROWTH: u64 = 64;
/// Bytes of a record that are too few for harm.
const SMALL_BYTES: u64 = 1 << 20;

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

/// How far a record has come: the parts themselves lie where packets are kept, so that a record
/// that is never finished takes no memory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Unfinished {
    /// Parts that have come.
    parts: u32,
    /// Parts that there are to be.
    count: u32,
    /// Deflated bytes of the parts that have come.
    bytes: u64,
    /// Bytes of the whole record, as its first part says.
    declared: u64,
}

impl Unfinished {
    /// How far the record is after a part, of a run of which so many keyframes have come. The first
    /// part already says how much the record will be. It begins a new record; what was unfinished
    /// is given up.
    ///
    /// # Errors
    /// [`PacketError::Content`] where parts do not follow each other, [`PacketError::Beyond`] for
    /// records that are too large.
    pub fn after(&self, part: &RecordPart, num_keyframes: u64) -> Result<Self, PacketError> {
        at_most("a part", part.bytes.len() as u64, PART_BYTES as u64)?;
        let before = match part.index {
            0 => Self::begun_by(part, num_keyframes)?,
            _ => *self,
        };
        let follows = part.index == before.parts && part.count == before.count;
        if !follows || part.index >= part.count {
            let reason = "parts of a record do not follow each other";
            return Err(PacketError::Content(reason));
        }
        let bytes = before.bytes + part.bytes.len() as u64;
        at_most("a deflated record", bytes, most_deflated(before.declared))?;
        let parts = before.parts + 1;
        Ok(Self {
            parts,
            bytes,
            ..before
        })
    }

    /// What the first part says of the whole.
    fn begun_by(part: &RecordPart, num_keyframes: u64) -> Result<Self, PacketError> {
        let mut header = [0; Record::HEADER_BYTES];
        let mut start = DeflateDecoder::new(part.bytes.as_slice());
        let read = start.read_exact(&mut header);
        let declared = read.ok().and_then(|()| Record::declared_bytes(&header));
        let declared = declared.ok_or(UNKNOWN)?;
        at_most("a record", declared, record_limit(num_keyframes))?;
        let most = most_deflated(declared).div_ceil(PART_BYTES as u64);
        let count = u64::from(part.count);
        // few parts that become much are refused before they are gathered, too
        if count > most || !is_believed(declared, count * PART_BYTES as u64) {
            let reason = "a record has another number of parts than its bytes need";
            return Err(PacketError::Content(reason));
        }
        Ok(Self {
            declared,
            count: part.count,
            ..Self::default()
        })
    }

    /// Number of parts that have come.
    #[must_use]
    pub fn parts(&self) -> u64 {
        u64::from(self.parts)
    }

    /// Whether all parts have come.
    #[must_use]
    pub fn is_whole(&self) -> bool {
        self.parts > 0 && self.parts == self.count
    }

    /// The record whose parts, behind each other, are `deflated`.
    ///
    /// # Errors
    /// [`PacketError::Content`] for what is no record, or another one than its first part said.
    pub fn record(&self, deflated: &[u8]) -> Result<Record, PacketError> {
        if !is_believed(self.declared, deflated.len() as u64) {
            let reason = "a record is larger than its bytes can tell";
            return Err(PacketError::Content(reason));
        }
        let record = inflated(deflated, self.declared as usize);
        record
            .and_then(|bytes| Record::decode(&bytes))
            .ok_or(UNKNOWN)
    }
}

const UNKNOWN: PacketError =
    PacketError::Content("the parts of a record are none that this program knows");

/// Bytes that a record takes when nothing of it can be deflated: five more for each block.
fn most_deflated(bytes: u64) -> u64 {
    bytes + bytes / 1000 + 64
}

/// Whether so many deflated bytes can be a record of so many.
fn is_believed(bytes: u64, deflated: u64) -> bool {
    bytes <= SMALL_BYTES.max(deflated.saturating_mul(MAX_GROWTH))
}
