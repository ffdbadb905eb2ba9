//! Recordings whose messages come in chunks.

use crate::error::BagError;
use crate::message::{Messages, Raw};
use std::collections::VecDeque;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

/// Most bytes of a record: an image of 8K in colour is a tenth of it.
const MAX_BYTES: u64 = 1 << 30;

/// Bytes that any chunk may hold, and how many more for each of its own: recorders write chunks of
/// one to four megabytes, and images hardly shrink. A plain image of so many pixels is some 300 MB
/// of memory on its way.
const CHUNK_BYTES: u64 = 16 << 20;
const CHUNK_GROWTH: u64 = 8;

/// Bytes that may come out of all that is compressed in a file, and how many more for each of its
/// bytes.
const FILE_BYTES: u64 = 256 << 20;
const FILE_GROWTH: u64 = 64;

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

/// Decompresses the chunks or messages of one file, and sees to it that neither one of them nor all
/// together grow without bound.
#[derive(Debug, Default)]
pub struct Unpacker {
    /// Bytes of the file as it is stored: what is compressed once more in it counts no more than it
    /// does.
    stored_bytes: u64,
    /// Bytes that have come out so far.
    unpacked_bytes: AtomicU64,
}

impl Unpacker {
    pub fn of_file(stored_bytes: u64) -> Self {
        Self {
            stored_bytes,
            unpacked_bytes: AtomicU64::new(0),
        }
    }

    /// Counts what comes out.
    fn count(&self, bytes: u64) -> Result<(), String> {
        let all = self
            .unpacked_bytes
            .fetch_add(bytes, Ordering::Relaxed)
            .saturating_add(bytes);
        let most = FILE_GROWTH.saturating_mul(self.stored_bytes);
        let most = most.saturating_add(FILE_BYTES);
        if all > most {
            return Err(format!(
                "what is compressed in a file of {} bytes holds {all} or more, expected at most \
                 {most}",
                self.stored_bytes
            ));
        }
        Ok(())
    }

    /// What is in a chunk that claims so many bytes.
    pub fn unpacked(&self, compression: &str, data: &[u8], size: u64) -> Result<Vec<u8>, String> {
        let packed = data.len() as u64;
        let most = (CHUNK_BYTES + CHUNK_GROWTH * packed).min(MAX_BYTES);
        if size > most {
            return Err(format!(
                "a chunk of {packed} bytes claims to hold {size}, expected at most {most}"
            ));
        }
        self.count(size)?;
        unpacked(compression, data, size)
    }

    /// What is in a message that was compressed by itself.
    pub fn unpacked_message(&self, data: &[u8]) -> Result<Vec<u8>, String> {
        // where there was too much already, nothing more comes out
        self.count(0)?;
        let bytes = unpacked_message(data)?;
        self.count(bytes.len() as u64)?;
        Ok(bytes)
    }
}

fn unpacked(compression: &str, data: &[u8], size: u64) -> Result<Vec<u8>, String> {
    let decoder: Box<dyn Read + '_> = match compression {
        "" | "none" => Box::new(data),
        "bz2" => Box::new(bzip2::read::BzDecoder::new(data)),
        "lz4" => Box::new(lz4_flex::frame::FrameDecoder::new(data)),
        "zstd" => {
            let decoder = ruzstd::decoding::StreamingDecoder::new(data);
            Box::new(decoder.map_err(|error| format!("a chunk is not zstd: {error}"))?)
        }
        other => {
            return Err(format!(
                "compression {other:?} is not supported, expected none, zstd, lz4 or bz2"
            ));
        }
    };
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

fn unpacked_message(data: &[u8]) -> Result<Vec<u8>, String> {
    let most = CHUNK_BYTES + CHUNK_GROWTH * data.len() as u64;
    let decoder = ruzstd::decoding::StreamingDecoder::new(data)
        .map_err(|error| format!("a message is not zstd: {error}"))?;
    let mut bytes = Vec::new();
    let read = decoder.take(most + 1).read_to_end(&mut bytes);
    read.map_err(|error| format!("a message cannot be decompressed (zstd): {error}"))?;
    if bytes.len() as u64 > most {
        return Err(format!(
            "a message of {} bytes holds more than {most}",
            data.len()
        ));
    }
    Ok(bytes)
}

/// What is in a file that was compressed as a whole, as a file without a name in the folder for
/// temporary files.
pub fn unpacked_file(file: &File) -> Result<File, String> {
    let packed = file.metadata().map_err(|error| error.to_string())?.len();
    unpacked_within(file, FILE_BYTES + FILE_GROWTH * packed)
}

fn unpacked_within(file: &File, most: u64) -> Result<File, String> {
    let decoder = ruzstd::decoding::StreamingDecoder::new(BufReader::new(file))
        .map_err(|error| format!("it is not zstd: {error}"))?;
    let mut out = tempfile::tempfile()
        .map_err(|error| format!("no room to decompress it (TMPDIR): {error}"))?;
    let written = std::io::copy(&mut decoder.take(most + 1), &mut out)
        .map_err(|error| format!("it cannot be decompressed (zstd) into TMPDIR: {error}"))?;
    if written > most {
        return Err(format!(
            "it holds more than {most} bytes; decompress it with zstd -d, if you trust it"
        ));
    }
    Ok(out)
}

/// Messages one by one, until the end of the file or the first damage. `read_on` reads some of the
/// file and adds the messages that are in it; whether there may be more.
pub fn in_chunks(
    path: &Path,
    mut read_on: impl FnMut(&mut VecDeque<Raw>) -> Result<bool, String> + Send + 'static,
) -> Messages {
    let path = path.to_owned();
    // of the chunk that was read last
    let mut ready = VecDeque::new();
    let mut has_more = true;
    Box::new(std::iter::from_fn(move || {
        while has_more && ready.is_empty() {
            let read = read_on(&mut ready);
            has_more = read.as_ref().is_ok_and(|has_more| *has_more);
            if let Err(reason) = read {
                return Some(Err(BagError::damaged(&path, reason)));
            }
        }
        ready.pop_front().map(Ok)
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write as _;

    /// Zeros as bzip2: a thousandth of a thousandth of them.
    fn zeros(count: usize) -> Vec<u8> {
        let mut encoder = bzip2::write::BzEncoder::new(Vec::new(), bzip2::Compression::best());
        let block = vec![0; 1 << 20];
        for _ in 0..count >> 20 {
            encoder.write_all(&block).unwrap();
        }
        encoder.finish().unwrap()
    }

    fn unpacked(data: &[u8], size: u64) -> Result<Vec<u8>, String> {
        Unpacker::default().unpacked("bz2", data, size)
    }

    #[test]
    fn a_chunk_that_claims_far_more_than_it_has_is_refused_before_memory_is_taken() {
        let bomb = zeros(256 << 20);
        assert!(bomb.len() < 10_000, "{}", bomb.len());
        let error = unpacked(&bomb, 256 << 20).unwrap_err();
        assert!(error.contains("claims to hold 268435456"), "{error}");
        // one that lies is cut off behind what it claims
        let error = unpacked(&bomb, 1 << 20).unwrap_err();
        assert!(error.contains("holds 1048577 bytes"), "{error}");
        let plain = zeros(16 << 20);
        assert_eq!(unpacked(&plain, 16 << 20).unwrap().len(), 16 << 20);
    }

    #[test]
    fn many_chunks_do_not_grow_without_bound_either() {
        let chunk = zeros(16 << 20);
        let unpacker = Unpacker::default();
        let unpack = || unpacker.unpacked("bz2", &chunk, 16 << 20);
        let count = std::iter::from_fn(|| unpack().ok()).count();
        assert_eq!(count, 16, "256 MiB");
        let error = unpack().unwrap_err();
        assert!(error.contains("file of 0 bytes holds"), "{error}");
        // a file of 512 kB may hold 32 MiB more
        let larger = Unpacker::of_file(1 << 19);
        let unpack = || larger.unpacked("bz2", &chunk, 16 << 20);
        assert_eq!(std::iter::from_fn(|| unpack().ok()).count(), 18);
    }

    /// Zeros as zstd: four bytes for 128 kB of them.
    fn zstd_zeros(blocks: u32) -> Vec<u8> {
        const BLOCK: u32 = 1 << 17;
        let mut frame = vec![0x28, 0xb5, 0x2f, 0xfd, 0, 7 << 3];
        for block in 1..=blocks {
            let head = BLOCK << 3 | 1 << 1 | u32::from(block == blocks);
            frame.extend(&head.to_le_bytes()[..3]);
            frame.push(0);
        }
        frame
    }

    #[test]
    fn messages_that_are_compressed_one_by_one_do_not_grow_without_bound_either() {
        let unpacker = Unpacker::default();
        let message = zstd_zeros(8 * 16);
        assert!(message.len() < 1000);
        let unpack = || unpacker.unpacked_message(&message);
        assert_eq!(std::iter::from_fn(|| unpack().ok()).count(), 16);
        let error = unpack().unwrap_err();
        assert!(error.contains("expected at most 268435456"), "{error}");
        let error = Unpacker::default()
            .unpacked_message(&zstd_zeros(8 * 33))
            .unwrap_err();
        assert!(error.contains("a message of"), "{error}");
    }
    #[test]
    fn a_record_has_the_bytes_that_it_claims_and_no_more_than_a_gigabyte() {
        let read = |length| block(&mut &b"abc"[..], length);
        assert_eq!(read(2).unwrap(), b"ab");
        assert_eq!(read(3).unwrap(), b"abc");
        assert!(read(4).unwrap_err().contains("ends within a record"));
        let error = read((1 << 30) + 1).unwrap_err();
        assert!(error.contains("claims 1073741825 bytes"), "{error}");
        // of a large chunk, too
        let error = unpacked(&vec![0; 1 << 27], (1 << 30) + 1).unwrap_err();
        assert!(error.contains("claims to hold 1073741825"), "{error}");
    }

    #[test]
    fn what_a_file_may_hold_depends_on_what_it_stores() {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), zstd_zeros(2)).unwrap();
        let unpacked = |most| unpacked_within(&file.reopen().unwrap(), most);
        let whole = unpacked(2 << 17).unwrap();
        assert_eq!(whole.metadata().unwrap().len(), 2 << 17);
        let error = unpacked((2 << 17) - 1).unwrap_err();
        assert!(error.contains("more than 262143 bytes"), "{error}");
        let plain = [crate::mcap::MAGIC, &[0; 92]].concat();
        std::fs::write(file.path(), plain).unwrap();
        let part = crate::part::parts_of(file.path()).unwrap().remove(0);
        assert_eq!(part.unpacker().stored_bytes, 100);
    }
}
