//! The end of a submap: what it holds and where.

use super::block::Codec;
use super::id::Hash;
use crate::bytes::Input;
use crate::recording::{
    Bytes, KIND_KEYFRAME, KIND_KEYFRAME_OF_CAMERA, decode_camera, encode_camera,
};
use crate::{RecordedCamera, Scale};

/// Start of the file, and of its end.
pub(super) const MAGIC: [u8; 8] = *b"mgsubmap";
pub(super) const END_MAGIC: [u8; 8] = *b"mgs-end\n";
/// Version that is written and read.
pub(super) const FORMAT_VERSION: u32 = 1;
/// Bytes before the first block: magic, version, zero.
pub(super) const HEADER_BYTES: u64 = 16;
/// Bytes behind the directory: where it begins, how long it is, its hash, magic.
pub(super) const TRAILER_BYTES: u64 = 56;
/// Most bytes that one of a compressed block is believed to hold.
pub(super) const MAX_EXPANSION: usize = 64;
/// Bytes of a block in the directory.
const BLOCK_BYTES: usize = 57;
/// In place of a keyframe.
const NO_KEYFRAME: u32 = u32::MAX;

/// What holds for all of a submap; in its directory.
#[derive(Clone, Debug, PartialEq)]
pub struct SubmapInfo {
    /// Camera of all keyframes that have none of their own.
    pub camera: RecordedCamera,
    /// Whether the unit of the world is the metre.
    pub scale: Scale,
    /// Times of the first and the last keyframe, nanoseconds; `None` without keyframes.
    pub times_ns: Option<[i64; 2]>,
    /// Lowest and highest coordinates of cameras and of what they saw well, in the frame and unit
    /// of the submap; `None` without keyframes that lie in it.
    pub bounds: Option<[[f64; 3]; 2]>,
}

/// A block: one record, found without reading the others.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SubmapBlock {
    /// The kind of its record, as in a recording.
    pub kind: u32,
    /// The keyframe that it belongs to.
    pub keyframe: Option<u32>,
    /// Where it begins in the file.
    pub offset: u64,
    /// Bytes that it takes there.
    pub stored_bytes: u32,
    /// Bytes of its record.
    pub record_bytes: u32,
    pub(super) codec: Codec,
    pub(super) hash: Hash,
}

impl SubmapBlock {
    /// Whether this is a keyframe, and not something that belongs to one.
    #[must_use]
    pub fn is_keyframe(&self) -> bool {
        matches!(self.kind, KIND_KEYFRAME | KIND_KEYFRAME_OF_CAMERA)
    }

    fn end(&self) -> Option<u64> {
        self.offset.checked_add(u64::from(self.stored_bytes))
    }

    /// Whether so few bytes can hold so many.
    fn is_plausible(&self) -> bool {
        let (stored, record) = (self.stored_bytes as usize, self.record_bytes as usize);
        match self.codec {
            Codec::Plain => stored == record,
            _ => record / MAX_EXPANSION <= stored,
        }
    }
}

/// `None` where there are more blocks than can be counted.
pub(super) fn encode(info: &SubmapInfo, blocks: &[SubmapBlock]) -> Option<Vec<u8>> {
    let mut out = Bytes(Vec::new());
    encode_camera(&info.camera, &mut out);
    out.0.push(u8::from(info.scale == Scale::Metric));
    out.0.push(u8::from(info.times_ns.is_some()));
    let times = info.times_ns.unwrap_or_default();
    times.into_iter().for_each(|time| out.u64(time as u64));
    out.0.push(u8::from(info.bounds.is_some()));
    let bounds = info.bounds.unwrap_or_default();
    bounds.into_iter().for_each(|corner| out.numbers(corner));
    out.count(blocks.len())?;
    for block in blocks {
        out.u32(block.kind);
        out.u32(block.keyframe.unwrap_or(NO_KEYFRAME));
        out.u64(block.offset);
        out.u32(block.stored_bytes);
        out.u32(block.record_bytes);
        out.0.push(block.codec.number());
        out.0.extend(block.hash);
    }
    Some(out.0)
}

/// The directory that ends at `end`; `None` where its blocks do not follow one another from the
/// header to itself.
pub(super) fn decode(bytes: &[u8], begin: u64) -> Option<(SubmapInfo, Vec<SubmapBlock>)> {
    let mut input = Input::new(bytes);
    let info = decode_info(&mut input)?;
    let count = input.u32()? as usize;
    if count.checked_mul(BLOCK_BYTES)? != input.len() {
        return None;
    }
    let mut blocks = Vec::with_capacity(count);
    let mut offset = HEADER_BYTES;
    for _ in 0..count {
        let block = decode_block(&mut input)?;
        if block.offset != offset || !block.is_plausible() {
            return None;
        }
        offset = block.end()?;
        blocks.push(block);
    }
    (offset == begin).then_some((info, blocks))
}

fn decode_info(input: &mut Input) -> Option<SubmapInfo> {
    let camera = decode_camera(input)?;
    let scale = match flag(input)? {
        true => Scale::Metric,
        false => Scale::Arbitrary,
    };
    let has_times = flag(input)?;
    let times = [input.u64()? as i64, input.u64()? as i64];
    let has_bounds = flag(input)?;
    let bounds = [input.finites()?, input.finites()?];
    Some(SubmapInfo {
        camera,
        scale,
        times_ns: has_times.then_some(times),
        bounds: has_bounds.then_some(bounds),
    })
}

fn flag(input: &mut Input) -> Option<bool> {
    match input.u8()? {
        0 => Some(false),
        1 => Some(true),
        _ => None,
    }
}

fn decode_block(input: &mut Input) -> Option<SubmapBlock> {
    Some(SubmapBlock {
        kind: input.u32()?,
        keyframe: Some(input.u32()?).filter(|id| *id != NO_KEYFRAME),
        offset: input.u64()?,
        stored_bytes: input.u32()?,
        record_bytes: input.u32()?,
        codec: Codec::of_number(input.u8()?)?,
        hash: *input.take(32)?.first_chunk()?,
    })
}
