//! Recordings whose messages come in chunks.

use crate::bag::Messages;
use crate::error::BagError;
use crate::message::Raw;
use std::collections::VecDeque;
use std::io::Read;
use std::path::Path;

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
pub fn unpacked(compression: &str, data: &[u8], size: u64) -> Result<Vec<u8>, String> {
    if size > MAX_BYTES {
        return Err(format!(
            "a chunk claims {size} bytes, expected at most {MAX_BYTES}"
        ));
    }
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
