//! The crate's own map file `.mgo`: exact evidence and settings, small, with checksums.
//!
//! `docs/formats.md` describes it so that it can be read without this library. Little endian:
//!
//! ```text
//! header  "MGRIDMAP", u32 version, u32 zero, f64 resolution, f32 x 2 clamps, f64 threshold,
//!         u64 bricks, u32 zero, u32 CRC-32 of the 52 bytes before
//! chunk   u32 bricks (1 to 1024), u32 bytes, u32 CRC-32 of the bytes, u32 CRC-32 of the 12
//!         bytes before; then the bytes: keys of the bricks, their cells
//! ```

mod bricks;
mod coder;

use std::io::{BufReader, BufWriter, Read, Write};

use self::bricks::Model;
use self::coder::{Decoder, Encoder};
use super::{read_error, write_error};
use crate::error::MapError;
use crate::evidence::UNKNOWN;
use crate::key::{BRICK_CELLS, BrickKey};
use crate::map::{MapConfig, OccupancyMap};

/// First bytes of a `.mgo` file.
pub const MGO_MAGIC: [u8; 8] = *b"MGRIDMAP";
const FORMAT: &str = ".mgo";
const VERSION: u32 = 1;
const HEADER_BYTES: usize = 56;
const CHUNK_HEADER_BYTES: usize = 16;
/// Bricks of a full chunk: enough to learn from, and no more memory than half a megabyte.
const CHUNK_BRICKS: usize = 1024;
/// More bytes than any chunk of so many bricks needs: ten for a key; a cell is at most 21 bits that
/// cost little more than a bit each, however unlikely they come.
const MAX_BYTES_PER_BRICK: usize = 16 + 4 * BRICK_CELLS;

/// Writes a map as `.mgo`: exact, about an eighth of `.ot`. Streams: memory beyond the map is that
/// of the list of bricks and of one chunk.
///
/// # Errors
/// Writing fails.
pub fn write_mgo(map: &OccupancyMap, out: &mut impl Write) -> Result<(), MapError> {
    let mut out = BufWriter::new(out);
    let bricks = map.bricks();
    let config = map.config();
    let mut header = Vec::with_capacity(HEADER_BYTES);
    header.extend(MGO_MAGIC);
    header.extend(VERSION.to_le_bytes());
    header.extend(0_u32.to_le_bytes());
    header.extend(config.resolution.to_le_bytes());
    header.extend(config.clamp_min.to_le_bytes());
    header.extend(config.clamp_max.to_le_bytes());
    header.extend(config.occupancy_threshold.to_le_bytes());
    header.extend((bricks.len() as u64).to_le_bytes());
    header.extend(0_u32.to_le_bytes());
    header.extend(crc32fast::hash(&header).to_le_bytes());
    out.write_all(&header).map_err(write_error)?;
    for chunk in bricks.chunks(CHUNK_BRICKS) {
        let bytes = encode(map, chunk);
        let sizes = [
            chunk.len() as u32,
            bytes.len() as u32,
            crc32fast::hash(&bytes),
        ];
        let mut header = sizes.map(u32::to_le_bytes).concat();
        header.extend(crc32fast::hash(&header).to_le_bytes());
        out.write_all(&header).map_err(write_error)?;
        out.write_all(&bytes).map_err(write_error)?;
    }
    out.flush().map_err(write_error)
}

fn encode(map: &OccupancyMap, bricks: &[BrickKey]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut next = 0;
    for key in bricks {
        // Keys ascend: a brick directly above the one before costs a zero.
        write_varint(&mut bytes, key.pack() - next);
        next = key.pack() + 1;
    }
    let mut encoder = Encoder::new(bytes);
    let mut model = Model::new(map.limits);
    for key in bricks {
        model.brick(&mut encoder, key.pack(), &mut map.brick_values(*key));
    }
    encoder.finish()
}

/// Seven bits per byte, lowest first; the highest bit says that more follow.
fn write_varint(bytes: &mut Vec<u8>, mut value: u64) {
    while value >= 128 {
        bytes.push(value as u8 | 128);
        value >>= 7;
    }
    bytes.push(value as u8);
}

/// Takes a number off the front; `None` if it is not whole or longer than 63 bits.
fn read_varint(bytes: &mut &[u8]) -> Option<u64> {
    let mut value = 0;
    for shift in (0..63).step_by(7) {
        let (&byte, rest) = bytes.split_first()?;
        *bytes = rest;
        value |= u64::from(byte & 127) << shift;
        if byte < 128 {
            return Some(value);
        }
    }
    None
}

/// Reads a `.mgo` map with the settings that it was made with and the given memory budget.
///
/// A damaged or hostile file gives an error, never a panic or an allocation beyond the budget.
///
/// # Errors
/// The file is not a whole `.mgo` of a known version, a checksum differs, or its map does not fit
/// into `memory_budget_bytes`.
pub fn read_mgo(input: impl Read, memory_budget_bytes: usize) -> Result<OccupancyMap, MapError> {
    let mut input = BufReader::new(input);
    let (config, num_bricks) = read_header(&mut input, memory_budget_bytes)?;
    let mut map = OccupancyMap::new(config)?;
    // All that is read has changed since revision 0.
    map.revision = 1;
    let mut left = num_bricks;
    let mut next_key = 0;
    let mut bytes = Vec::new();
    while left > 0 {
        let header: [u8; CHUNK_HEADER_BYTES] = read_array(&mut input)?;
        let [count, size, crc, header_crc] = words(&header);
        if crc32fast::hash(&header[..12]) != header_crc {
            return Err(damaged("the checksum of a chunk's header differs"));
        }
        let count = count as usize;
        let fits = (1..=CHUNK_BRICKS).contains(&count)
            && count as u64 <= left
            && size as usize <= count * MAX_BYTES_PER_BRICK;
        if !fits {
            return Err(damaged(format!(
                "a chunk says {count} bricks in {size} bytes, of {left} bricks left"
            )));
        }
        bytes.resize(size as usize, 0);
        read_exact(&mut input, &mut bytes)?;
        if crc32fast::hash(&bytes) != crc {
            return Err(damaged("the checksum of a chunk differs"));
        }
        next_key = decode(&mut map, &bytes, count, next_key)?;
        left -= count as u64;
    }
    Ok(map)
}

fn read_header(input: &mut impl Read, budget: usize) -> Result<(MapConfig, u64), MapError> {
    let header: [u8; HEADER_BYTES] = read_array(input)?;
    if header[..8] != MGO_MAGIC {
        return Err(damaged(format!(
            "it begins with {:?}, expected \"MGRIDMAP\"",
            String::from_utf8_lossy(&header[..8])
        )));
    }
    let words = words::<{ HEADER_BYTES / 4 }>(&header);
    let version = words[2];
    if version != VERSION {
        return Err(damaged(format!(
            "it has version {version}, this program reads version {VERSION}: use a newer program"
        )));
    }
    if crc32fast::hash(&header[..HEADER_BYTES - 4]) != words[13] {
        return Err(damaged("the checksum of its header differs"));
    }
    let long = |i: usize| u64::from(words[i]) | u64::from(words[i + 1]) << 32;
    let config = MapConfig {
        resolution: f64::from_bits(long(4)),
        clamp_min: f32::from_bits(words[6]),
        clamp_max: f32::from_bits(words[7]),
        occupancy_threshold: f64::from_bits(long(8)),
        memory_budget_bytes: budget,
    };
    Ok((config, long(10)))
}

/// Puts the bricks of a chunk into the map; returns the least key that may follow.
fn decode(
    map: &mut OccupancyMap,
    mut bytes: &[u8],
    count: usize,
    mut next_key: u64,
) -> Result<u64, MapError> {
    // The first key of a chunk is absolute, so that chunks can be read alone.
    let least = std::mem::take(&mut next_key);
    let mut keys = Vec::with_capacity(count);
    for _ in 0..count {
        let key = read_varint(&mut bytes)
            .and_then(|gap| next_key.checked_add(gap))
            .filter(|key| *key >= least && *key < 1 << 63)
            .ok_or_else(|| damaged("a brick has no possible place"))?;
        keys.push(key);
        next_key = key + 1;
    }
    let mut decoder = Decoder::new(bytes);
    let mut model = Model::new(map.limits);
    for key in keys {
        let mut cells = [UNKNOWN; BRICK_CELLS];
        model.brick(&mut decoder, key, &mut cells);
        map.put_brick(BrickKey::unpack(key), &cells)?;
    }
    Ok(next_key)
}

fn damaged(reason: impl Into<String>) -> MapError {
    MapError::format(FORMAT, reason)
}

/// The little-endian words of some bytes.
fn words<const N: usize>(bytes: &[u8]) -> [u32; N] {
    let words = bytes.as_chunks().0;
    std::array::from_fn(|i| u32::from_le_bytes(words[i]))
}

fn read_exact(input: &mut impl Read, bytes: &mut [u8]) -> Result<(), MapError> {
    let cut = || damaged("the file ends before its last brick");
    let read = input.read_exact(bytes);
    read.map_err(|error| read_error(error, cut))
}

fn read_array<const N: usize>(input: &mut impl Read) -> Result<[u8; N], MapError> {
    let mut bytes = [0; N];
    read_exact(input, &mut bytes)?;
    Ok(bytes)
}
