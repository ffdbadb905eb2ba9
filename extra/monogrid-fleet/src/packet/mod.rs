//! What an agent delivers: self-contained, checksummed, versioned packets. `README.md` describes
//! the bytes.

mod bounds;
mod depth;
mod keyframe;
mod part;

pub use bounds::{MAX_PACKET_BYTES, MAX_PIXELS, MAX_RECORD_BYTES, MAX_SIDE};
pub(crate) use bounds::{check_record, check_size};
pub use depth::{IDEPTH_STEP, PackedDepth, SIGMA_STEPS_PER_OCTAVE};
pub use keyframe::PackedKeyframe;
pub use part::{PART_BYTES, RecordPart, Unfinished, parts_of};

use monogrid_datasets::DepthRevision;
use serde::{Deserialize, Serialize};

/// Start of every packet.
const MAGIC: [u8; 4] = *b"MGFP";
/// Version of the packets that are written; others are refused.
pub const VERSION: u32 = 1;
/// Bytes of the header: magic, version, bytes of the payload, CRC-32 of version, bytes and payload.
pub const HEADER_BYTES: usize = 16;
/// Pixels of an image per byte of its packet at most: a deflate stream can be made to hold far
/// more, and a small packet would fill the memory.
const MAX_PIXELS_PER_BYTE: usize = 64;

/// One packet.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Packet {
    /// A record as the recording has it, or a part of one.
    Record(RecordPart),
    /// A new keyframe.
    Keyframe(PackedKeyframe),
    /// New depth for a keyframe that was delivered before.
    Depth(PackedRevision),
}

/// New depth for a keyframe.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PackedRevision {
    /// The keyframe.
    pub keyframe_id: u32,
    /// Counts upwards.
    pub revision: u32,
    /// Width and height of the keyframe's image, px.
    pub size: (u16, u16),
    /// The new depth.
    pub depth: PackedDepth,
}

/// Why bytes are not a packet, or a record cannot become one.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PacketError {
    /// The first bytes are others.
    #[error("found {0} bytes that do not begin with MGFP; expected a packet of monogrid-fleet")]
    NotAPacket(usize),
    /// Agent and server are not of one version.
    #[error(
        "found a packet of version {found}, this program reads version {VERSION}: update {}",
        if *found > VERSION { "the server" } else { "the agent" }
    )]
    Version {
        /// Version of the packet.
        found: u32,
    },
    /// There are fewer or more bytes than the header says.
    #[error("found {found} bytes of payload, expected {expected}: the packet is cut off")]
    Length {
        /// Bytes that are there.
        found: usize,
        /// Bytes that the header says.
        expected: usize,
    },
    /// The checksum is wrong.
    #[error(
        "the checksum of a packet is wrong: it was damaged on its way and has to be sent again"
    )]
    Damaged,
    /// The payload is not what a packet holds.
    #[error("{0}; the packet was not made by monogrid-fleet")]
    Content(&'static str),
    /// A record that cannot be delivered.
    #[error("keyframe {0} has no image, without which no place is recognised")]
    NoImage(u32),
    /// A record that cannot be delivered.
    #[error("a packet or record is larger than a server takes; it cannot be delivered")]
    TooLarge,
    /// Something is more than a packet may hold, or is no sane number.
    #[error("found {what} of {found}, expected {expected}")]
    Beyond {
        /// What it is.
        what: &'static str,
        /// What was found.
        found: String,
        /// What can be.
        expected: String,
    },
}

impl Packet {
    /// The bytes of the packet.
    ///
    /// # Errors
    /// [`PacketError::TooLarge`].
    pub fn encode(&self) -> Result<Vec<u8>, PacketError> {
        let payload = postcard::to_stdvec(self).map_err(|_| PacketError::TooLarge)?;
        if HEADER_BYTES + payload.len() > MAX_PACKET_BYTES {
            return Err(PacketError::TooLarge);
        }
        let length = payload.len() as u32;
        let mut bytes = Vec::with_capacity(HEADER_BYTES + payload.len());
        bytes.extend(MAGIC);
        bytes.extend(VERSION.to_le_bytes());
        bytes.extend(length.to_le_bytes());
        bytes.extend(checksum(&bytes[4..12], &payload).to_le_bytes());
        bytes.extend(payload);
        Ok(bytes)
    }

    /// The packet that these bytes are.
    ///
    /// # Errors
    /// All but [`PacketError::NoImage`] and [`PacketError::TooLarge`]. What a keyframe holds is
    /// looked at by [`PackedKeyframe::unpack`].
    pub fn decode(bytes: &[u8]) -> Result<Self, PacketError> {
        bounds::at_most("a packet", bytes.len() as u64, MAX_PACKET_BYTES as u64)?;
        let payload = payload(bytes)?;
        let (packet, rest) = postcard::take_from_bytes(payload)
            .map_err(|_| PacketError::Content("the fields of a packet do not fit its bytes"))?;
        if !rest.is_empty() {
            return Err(PacketError::Content(
                "there are bytes behind the last field",
            ));
        }
        Ok(packet)
    }
}

/// Bytes of a packet by its header; `None` where this is none.
pub(crate) fn packet_bytes(header: &[u8; HEADER_BYTES]) -> Option<usize> {
    (header[..4] == MAGIC).then(|| HEADER_BYTES + word(header, 8) as usize)
}

/// The payload, if header and checksum are right.
fn payload(bytes: &[u8]) -> Result<&[u8], PacketError> {
    let Some((header, payload)) = bytes.split_first_chunk::<HEADER_BYTES>() else {
        return Err(PacketError::NotAPacket(bytes.len()));
    };
    let expected = packet_bytes(header).ok_or(PacketError::NotAPacket(bytes.len()))? - HEADER_BYTES;
    let found = word(header, 4);
    if found != VERSION {
        return Err(PacketError::Version { found });
    }
    if payload.len() != expected {
        let found = payload.len();
        return Err(PacketError::Length { found, expected });
    }
    if checksum(&header[4..12], payload) != word(header, 12) {
        return Err(PacketError::Damaged);
    }
    Ok(payload)
}

fn word(header: &[u8; HEADER_BYTES], at: usize) -> u32 {
    u32::from_le_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]])
}

fn checksum(head: &[u8], payload: &[u8]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(head);
    hasher.update(payload);
    hasher.finalize()
}

/// Whether so many pixels can be in so many bytes.
fn is_plausible((width, height): (u16, u16), bytes: usize) -> bool {
    let pixels = usize::from(width) * usize::from(height);
    pixels > 0 && pixels / MAX_PIXELS_PER_BYTE <= bytes
}

impl PackedRevision {
    /// New depth, packed.
    #[must_use]
    pub fn pack(revision: &DepthRevision, size: (u16, u16)) -> Self {
        Self {
            keyframe_id: revision.keyframe_id,
            revision: revision.revision,
            size,
            depth: PackedDepth::pack(&revision.pixels, size),
        }
    }

    /// The new depth.
    ///
    /// # Errors
    /// [`PacketError::Content`].
    pub fn unpack(&self) -> Result<DepthRevision, PacketError> {
        Ok(DepthRevision {
            keyframe_id: self.keyframe_id,
            revision: self.revision,
            pixels: self.depth.unpack(self.size)?,
        })
    }
}
