//! How the bytes of a block lie in the file.

use super::directory::MAX_EXPANSION;
use flate2::Compression;
use flate2::read::ZlibDecoder;
use flate2::write::ZlibEncoder;
use std::io::{Read, Write};

/// Bytes of a depth pixel, and of what stands before them in a block of depth.
const STRIDE: usize = 12;

/// How the bytes of a block are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Codec {
    /// As they are: images are compressed already.
    Plain,
    /// As zlib.
    Deflated,
    /// As zlib, all first bytes of twelve, then all second ones, ...: depth pixels, whose exponents
    /// are alike.
    Planes,
}

impl Codec {
    /// By their numbers in files.
    const ALL: [Self; 3] = [Self::Plain, Self::Deflated, Self::Planes];

    pub(super) fn number(self) -> u8 {
        self as u8
    }

    pub(super) fn of_number(number: u8) -> Option<Self> {
        Self::ALL.get(usize::from(number)).copied()
    }
}

/// The bytes to store: compressed as is wanted where that makes them smaller, and not more so than
/// readers believe.
///
/// Deflate at its lowest level: on depth in planes it is smaller and three times faster than the
/// fastest zstd in Rust, and the higher levels take three times as long for a twentieth of the
/// bytes.
pub(super) fn pack(wanted: Codec, payload: Vec<u8>) -> (Codec, Vec<u8>) {
    let packed = match wanted {
        Codec::Plain => None,
        Codec::Deflated => deflate(&payload),
        Codec::Planes => deflate(&in_planes(&payload)),
    };
    let is_worth_it = |packed: &Vec<u8>| {
        packed.len() < payload.len() && payload.len() / MAX_EXPANSION <= packed.len()
    };
    match packed.filter(is_worth_it) {
        Some(packed) => (wanted, packed),
        None => (Codec::Plain, payload),
    }
}

/// The bytes that were packed; `None` where there are not exactly `length`, or they cannot be
/// understood.
pub(super) fn unpack(codec: Codec, stored: Vec<u8>, length: usize) -> Option<Vec<u8>> {
    let payload = match codec {
        Codec::Plain => stored,
        Codec::Deflated => inflate(&stored, length)?,
        Codec::Planes => out_of_planes(&inflate(&stored, length)?),
    };
    (payload.len() == length).then_some(payload)
}

fn deflate(bytes: &[u8]) -> Option<Vec<u8>> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(bytes).ok()?;
    encoder.finish().ok()
}

/// At most one byte more than is wanted.
fn inflate(bytes: &[u8], length: usize) -> Option<Vec<u8>> {
    let mut inflated = Vec::with_capacity(length);
    let mut decoder = ZlibDecoder::new(bytes).take(length as u64 + 1);
    decoder.read_to_end(&mut inflated).ok()?;
    Some(inflated)
}

/// What is left over after whole strides stays at the end.
fn in_planes(bytes: &[u8]) -> Vec<u8> {
    let (rows, rest) = bytes.as_chunks::<STRIDE>();
    let plane = |byte: usize| rows.iter().map(move |row| row[byte]);
    let planes = (0..STRIDE).flat_map(plane);
    planes.chain(rest.iter().copied()).collect()
}

fn out_of_planes(bytes: &[u8]) -> Vec<u8> {
    let num_rows = bytes.len() / STRIDE;
    let (planes, rest) = bytes.split_at(num_rows * STRIDE);
    let mut rows = Vec::with_capacity(bytes.len());
    for row in 0..num_rows {
        rows.extend((0..STRIDE).map(|byte| planes[byte * num_rows + row]));
    }
    rows.extend(rest);
    rows
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_packed_comes_back_whatever_its_length() {
        for length in [0, 1, 11, 12, 13, 24, 1000] {
            let payload: Vec<u8> = (0..length).map(|i| (i % 12 * 20 + i / 100) as u8).collect();
            for wanted in [Codec::Plain, Codec::Deflated, Codec::Planes] {
                let (codec, stored) = pack(wanted, payload.clone());
                assert!(stored.len() <= payload.len());
                assert_eq!(unpack(codec, stored, length).as_ref(), Some(&payload));
            }
        }
    }

    #[test]
    fn planes_lie_one_behind_another() {
        let rows: Vec<u8> = (0..26).collect();
        let planes = in_planes(&rows);
        assert_eq!(planes[..4], [0, 12, 1, 13]);
        assert_eq!(planes[24..], [24, 25]);
    }

    #[test]
    fn depth_takes_less_room_in_planes() {
        let mut payload = vec![0; STRIDE];
        for i in 0..2000_u32 {
            let at = [(i % 640) as u16, (i / 640) as u16];
            payload.extend(at.map(u16::to_le_bytes).concat());
            let idepth = 0.5 + (i * 7919 % 1009) as f32 / 1009.0;
            payload.extend(idepth.to_le_bytes());
            payload.extend((idepth * 1e-4).to_le_bytes());
        }
        let (_, planes) = pack(Codec::Planes, payload.clone());
        let (_, rows) = pack(Codec::Deflated, payload);
        assert!(4 * planes.len() < 3 * rows.len());
    }

    #[test]
    fn what_would_grow_too_much_is_stored_as_it_is() {
        let (codec, stored) = pack(Codec::Deflated, vec![0; 100_000]);
        assert_eq!((codec, stored.len()), (Codec::Plain, 100_000));
    }

    #[test]
    fn other_lengths_than_were_said_are_refused() {
        let payload = b"some words, some more words, and words".repeat(3);
        let (codec, stored) = pack(Codec::Deflated, payload.clone());
        assert_eq!(codec, Codec::Deflated);
        for length in [0, payload.len() - 1, payload.len() + 1] {
            assert_eq!(unpack(codec, stored.clone(), length), None);
        }
        let cut = stored[..stored.len() / 2].to_vec();
        assert_eq!(unpack(codec, cut, payload.len()), None);
    }
}
