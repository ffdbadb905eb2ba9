//! Recordings whose messages come in chunks.

use crate::bag::Messages;
use crate::error::BagError;
use crate::message::Raw;
use std::collections::VecDeque;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

/// Most bytes of a record: an image of 8K in colour is a tenth of it.
const MAX_BYTES: u64 = 1 << 30;

/// Bytes that any chunk may hold, and how many more for each of its own: recorders write chunks of one to four megabytes,
/// and images hardly shrink.
const CHUNK_BYTES: u64 = 32 << 20;
const CHUNK_GROWTH: u64 = 8;

/// Bytes that may come out of the chunks of a file, and how many more for each byte that went in.
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

/// Decompresses the chunks of one file, and sees to it that neither one of them nor all together grow without bound.
#[derive(Debug, Default)]
pub struct Unpacker {
    /// Bytes of all chunks so far, and what was in them.
    packed_bytes: u64,
    unpacked_bytes: u64,
}

impl Unpacker {
    /// What is in a chunk that claims so many bytes.
    pub fn unpacked(
        &mut self,
        compression: &str,
        data: &[u8],
        size: u64,
    ) -> Result<Vec<u8>, String> {
        let packed = data.len() as u64;
        let most = (CHUNK_BYTES + CHUNK_GROWTH * packed).min(MAX_BYTES);
        if size > most {
            return Err(format!(
                "a chunk of {packed} bytes claims to hold {size}, expected at most {most}"
            ));
        }
        self.packed_bytes += packed;
        self.unpacked_bytes += size;
        let most = FILE_BYTES + FILE_GROWTH * self.packed_bytes;
        if self.unpacked_bytes > most {
            return Err(format!(
                "chunks of {} bytes claim to hold {}, expected at most {most}",
                self.packed_bytes, self.unpacked_bytes
            ));
        }
        unpacked(compression, data, size)
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

/// A message that was compressed by itself.
pub fn unpacked_message(data: &[u8]) -> Result<Vec<u8>, String> {
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
    let most = FILE_BYTES + FILE_GROWTH * packed;
    let decoder = ruzstd::decoding::StreamingDecoder::new(BufReader::new(file))
        .map_err(|error| format!("it is not zstd: {error}"))?;
    let mut out = tempfile::tempfile()
        .map_err(|error| format!("no room to decompress it (TMPDIR): {error}"))?;
    let written = std::io::copy(&mut decoder.take(most + 1), &mut out)
        .map_err(|error| format!("it cannot be decompressed (zstd) into TMPDIR: {error}"))?;
    if written > most {
        return Err(format!(
            "a file of {packed} bytes holds more than {most}; decompress it with zstd -d, if you trust it"
        ));
    }
    Ok(out)
}

/// Messages one by one, until the end of the file or the first damage. `read_on` reads some of the file and adds the messages that are in it;
/// whether there may be more.
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
        let plain = zeros(32 << 20);
        assert_eq!(unpacked(&plain, 32 << 20).unwrap().len(), 32 << 20);
    }

    #[test]
    fn many_chunks_do_not_grow_without_bound_either() {
        let chunk = zeros(32 << 20);
        let mut unpacker = Unpacker::default();
        let mut unpack = || unpacker.unpacked("bz2", &chunk, 32 << 20);
        let count = std::iter::from_fn(|| unpack().ok()).count();
        assert_eq!(count, 8, "256 MiB");
        let error = unpack().unwrap_err();
        assert!(error.contains("chunks of"), "{error}");
    }
}
