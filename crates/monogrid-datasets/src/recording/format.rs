//! Bytes of the records; `docs/formats.md` describes the same for people.

use super::continuation;
use super::{
    ColourRecord, DepthPixel, DepthRevision, EndRecord, KeyframeRecord, PoseSnapshot, Record,
    RecordedCamera, Scale, SessionInfo,
};
use crate::bytes::Input;
use crate::images::decode_png_luma8;
use crate::{encode_png, pose_from_numbers};
use monogrid_geometry::{Pinhole, Sim3};
use monogrid_image::Image;

/// Start of the file: name and version of the format.
pub(super) const FILE_MAGIC: [u8; 8] = *b"monogrid";
/// Version that is written; a reader refuses larger ones.
pub(super) const FORMAT_VERSION: u32 = 1;
/// Bytes of the file header: magic, version, zero.
pub(super) const FILE_HEADER_BYTES: usize = 16;

/// Start of every record, to find the next one after damage.
pub(super) const SYNC: [u8; 4] = *b"RMGK";
/// Bytes of a record header: sync, kind, payload length, payload CRC, CRC of these 16 bytes.
pub(super) const RECORD_HEADER_BYTES: usize = 20;

const KIND_SESSION: u32 = 1;
pub(crate) const KIND_KEYFRAME: u32 = 2;
const KIND_DEPTH: u32 = 3;
pub(crate) const KIND_POSES: u32 = 4;
const KIND_END: u32 = 5;
const KIND_CONTINUATION: u32 = 6;
const KIND_COLOUR: u32 = 7;
/// Unknown to readers that know one camera only, which would take the keyframe for one of it.
pub(crate) const KIND_KEYFRAME_OF_CAMERA: u32 = 8;

const IMAGE_NONE: u8 = 0;
const IMAGE_RAW: u8 = 1;
const IMAGE_PNG: u8 = 2;

/// The header of a record.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct RecordHeader {
    pub kind: u32,
    pub payload_bytes: u32,
    pub payload_crc: u32,
}

pub(super) fn file_header() -> [u8; FILE_HEADER_BYTES] {
    let mut header = [0; FILE_HEADER_BYTES];
    header[..8].copy_from_slice(&FILE_MAGIC);
    header[8..12].copy_from_slice(&FORMAT_VERSION.to_le_bytes());
    header
}

/// The header in these bytes; `None` when they are not one, or damaged.
pub(super) fn parse_record_header(bytes: &[u8; RECORD_HEADER_BYTES]) -> Option<RecordHeader> {
    let word = |i: usize| u32::from_le_bytes([bytes[i], bytes[i + 1], bytes[i + 2], bytes[i + 3]]);
    let is_whole = bytes[..4] == SYNC && word(16) == crc32fast::hash(&bytes[..16]);
    is_whole.then(|| RecordHeader {
        kind: word(4),
        payload_bytes: word(8),
        payload_crc: word(12),
    })
}

/// Header and payload; `None` when the payload exceeds 4 GiB.
pub(super) fn encode_record(record: &Record) -> Option<Vec<u8>> {
    let mut out = Bytes(vec![0; RECORD_HEADER_BYTES]);
    let kind = encode_payload(record, &mut out)?;
    let mut bytes = out.0;
    let payload = &bytes[RECORD_HEADER_BYTES..];
    let payload_bytes = u32::try_from(payload.len()).ok()?;
    let payload_crc = crc32fast::hash(payload);
    bytes[..4].copy_from_slice(&SYNC);
    bytes[4..8].copy_from_slice(&kind.to_le_bytes());
    bytes[8..12].copy_from_slice(&payload_bytes.to_le_bytes());
    bytes[12..16].copy_from_slice(&payload_crc.to_le_bytes());
    let header_crc = crc32fast::hash(&bytes[..16]);
    bytes[16..20].copy_from_slice(&header_crc.to_le_bytes());
    Some(bytes)
}

/// Appends what follows the header; its kind, or `None` when a list exceeds 4 GiB.
pub(super) fn encode_payload(record: &Record, out: &mut Bytes) -> Option<u32> {
    Some(match record {
        Record::Session(session) => encode_session(session, out),
        Record::Keyframe(keyframe) => encode_keyframe(keyframe, out)?,
        Record::Depth(depth) => {
            out.u32(depth.keyframe_id);
            out.u32(depth.revision);
            out.pixels(&depth.pixels)?;
            KIND_DEPTH
        }
        Record::Colour(colour) => {
            out.u32(colour.keyframe_id);
            out.blob(&colour.jpeg)?;
            KIND_COLOUR
        }
        Record::Poses(snapshot) => encode_poses(snapshot, out)?,
        Record::Continuation(continuation) => {
            continuation::encode(continuation, out)?;
            KIND_CONTINUATION
        }
        Record::End(end) => {
            out.u64(end.num_frames);
            out.u64(end.num_tracked);
            out.blob(end.summary.as_bytes())?;
            KIND_END
        }
    })
}

fn encode_session(session: &SessionInfo, out: &mut Bytes) -> u32 {
    encode_camera(&session.camera(), out);
    out.0.push(match session.scale {
        Scale::Arbitrary => 0,
        Scale::Metric => 1,
    });
    out.u64(session.seed);
    for text in [&session.profile, &session.source, &session.config] {
        // longer than 4 GiB: left empty rather than failing the run
        if out.blob(text.as_bytes()).is_none() {
            out.u32(0);
        }
    }
    KIND_SESSION
}

pub(crate) fn encode_camera(camera: &RecordedCamera, out: &mut Bytes) {
    let Pinhole { fx, fy, cx, cy } = camera.pinhole;
    out.numbers([fx, fy, cx, cy]);
    out.u32(camera.width as u32);
    out.u32(camera.height as u32);
}

fn encode_keyframe(keyframe: &KeyframeRecord, out: &mut Bytes) -> Option<u32> {
    if let Some(camera) = &keyframe.camera {
        encode_camera(camera, out);
    }
    out.u32(keyframe.id);
    out.u64(keyframe.frame_index);
    out.u64(keyframe.timestamp_ns as u64);
    match &keyframe.image {
        None => {
            out.0.push(IMAGE_NONE);
            // neither width nor height nor bytes
            [0; 3].into_iter().for_each(|none| out.u32(none));
        }
        Some(image) => {
            let (raw, png) = (image.as_slice(), encode_png(image));
            let is_smaller =
                (1..raw.len()).contains(&png.len()) && image_is_plausible(raw.len(), png.len());
            let (encoding, bytes) = match is_smaller {
                true => (IMAGE_PNG, png.as_slice()),
                false => (IMAGE_RAW, raw),
            };
            out.0.push(encoding);
            out.u32(image.width() as u32);
            out.u32(image.height() as u32);
            out.blob(bytes)?;
        }
    }
    out.pixels(&keyframe.pixels)?;
    Some(match keyframe.camera {
        None => KIND_KEYFRAME,
        Some(_) => KIND_KEYFRAME_OF_CAMERA,
    })
}

fn encode_poses(snapshot: &PoseSnapshot, out: &mut Bytes) -> Option<u32> {
    out.u64(snapshot.revision);
    out.count(snapshot.poses.len())?;
    for (id, pose) in &snapshot.poses {
        out.u32(*id);
        out.numbers(numbers_of_pose(pose));
    }
    Some(KIND_POSES)
}

/// The record of a payload whose checksum was right. `Ok(None)`: a kind of a later version.
/// `Err`: the payload is not what its kind says.
pub(crate) fn decode_record(
    kind: u32,
    payload: &[u8],
    with_images: bool,
) -> Result<Option<Record>, ()> {
    let mut input = Input::new(payload);
    let record = match kind {
        KIND_SESSION => decode_session(&mut input).map(Record::Session),
        KIND_KEYFRAME => decode_keyframe(&mut input, None, with_images).map(Record::Keyframe),
        KIND_KEYFRAME_OF_CAMERA => decode_camera(&mut input)
            .and_then(|camera| decode_keyframe(&mut input, Some(camera), with_images))
            .map(Record::Keyframe),
        KIND_DEPTH => decode_depth(&mut input).map(Record::Depth),
        KIND_COLOUR if !with_images => return Ok(None),
        KIND_COLOUR => decode_colour(&mut input).map(Record::Colour),
        KIND_POSES => decode_poses(&mut input).map(Record::Poses),
        KIND_CONTINUATION => continuation::decode(&mut input).map(Record::Continuation),
        KIND_END => decode_end(&mut input).map(Record::End),
        _ => return Ok(None),
    };
    record.map(Some).ok_or(())
}

fn decode_session(input: &mut Input) -> Option<SessionInfo> {
    let camera = decode_camera(input)?;
    Some(SessionInfo {
        pinhole: camera.pinhole,
        width: camera.width,
        height: camera.height,
        scale: match input.u8()? {
            0 => Scale::Arbitrary,
            1 => Scale::Metric,
            _ => return None,
        },
        seed: input.u64()?,
        profile: input.text()?,
        source: input.text()?,
        config: input.text()?,
    })
}

pub(crate) fn decode_camera(input: &mut Input) -> Option<RecordedCamera> {
    let [fx, fy, cx, cy] = input.numbers()?;
    Some(RecordedCamera {
        pinhole: Pinhole::new(fx, fy, cx, cy),
        width: input.u32()? as usize,
        height: input.u32()? as usize,
    })
}

fn decode_keyframe(
    input: &mut Input,
    camera: Option<RecordedCamera>,
    with_images: bool,
) -> Option<KeyframeRecord> {
    Some(KeyframeRecord {
        id: input.u32()?,
        frame_index: input.u64()?,
        timestamp_ns: input.u64()? as i64,
        camera,
        image: decode_image(input, with_images)?,
        pixels: input.pixels()?,
    })
}

/// The image of a keyframe, if it has one that is asked for.
fn decode_image(input: &mut Input, with_images: bool) -> Option<Option<Image<u8>>> {
    let encoding = input.u8()?;
    let (width, height) = (input.u32()? as usize, input.u32()? as usize);
    let bytes = input.blob()?;
    Some(match encoding {
        _ if !with_images => None,
        IMAGE_NONE => None,
        IMAGE_RAW => Some(raw_image(bytes, width, height)?),
        IMAGE_PNG => Some(png_image(bytes, width, height)?),
        _ => return None,
    })
}

/// Most pixels that a byte of a compressed image is believed to hold. Images that can be tracked
/// have 1 to 20; a deflate stream can be made to hold a thousand, and a small file would fill the
/// memory.
const MAX_PIXELS_PER_BYTE: usize = 64;

/// Whether a compressed image can be one of ours: simpler ones are written as they are.
pub(super) fn image_is_plausible(pixels: usize, compressed_bytes: usize) -> bool {
    pixels / MAX_PIXELS_PER_BYTE <= compressed_bytes
}

/// A grey PNG of the given size; nothing is allocated for any other.
fn png_image(bytes: &[u8], width: usize, height: usize) -> Option<Image<u8>> {
    let pixels = width.checked_mul(height)?;
    image_is_plausible(pixels, bytes.len())
        .then(|| decode_png_luma8(bytes, width, height))
        .flatten()
}

fn raw_image(bytes: &[u8], width: usize, height: usize) -> Option<Image<u8>> {
    (width.checked_mul(height)? == bytes.len())
        .then(|| Image::from_vec(width, height, bytes.to_vec()))?
}

fn decode_depth(input: &mut Input) -> Option<DepthRevision> {
    Some(DepthRevision {
        keyframe_id: input.u32()?,
        revision: input.u32()?,
        pixels: input.pixels()?,
    })
}

fn decode_colour(input: &mut Input) -> Option<ColourRecord> {
    Some(ColourRecord {
        keyframe_id: input.u32()?,
        jpeg: input.blob()?.to_vec(),
    })
}

fn decode_poses(input: &mut Input) -> Option<PoseSnapshot> {
    let revision = input.u64()?;
    let count = input.u32()? as usize;
    // 68 bytes each: no room is reserved for more than can be there
    let mut poses = Vec::with_capacity(count.min(input.len() / 68));
    for _ in 0..count {
        poses.push((input.u32()?, pose_of_numbers(&input.numbers()?)?));
    }
    Some(PoseSnapshot { revision, poses })
}

/// Scale, tx, ty, tz, qx, qy, qz, qw.
pub(crate) fn numbers_of_pose(pose: &Sim3) -> [f64; 8] {
    let (t, q) = (pose.translation, pose.rotation.quaternion());
    [pose.scale, t.x, t.y, t.z, q.i, q.j, q.k, q.w]
}

/// The pose with these [numbers](numbers_of_pose), if it is one.
pub(crate) fn pose_of_numbers(numbers: &[f64; 8]) -> Option<Sim3> {
    let [scale, rigid @ ..] = numbers;
    let pose: Sim3 = pose_from_numbers(rigid)?.with_scale(*scale);
    pose.is_finite().then_some(pose)
}

fn decode_end(input: &mut Input) -> Option<EndRecord> {
    Some(EndRecord {
        num_frames: input.u64()?,
        num_tracked: input.u64()?,
        summary: input.text()?,
    })
}

/// Little-endian output.
pub(crate) struct Bytes(pub(crate) Vec<u8>);

impl Bytes {
    pub(crate) fn u32(&mut self, v: u32) {
        self.0.extend_from_slice(&v.to_le_bytes());
    }
    pub(crate) fn u64(&mut self, v: u64) {
        self.0.extend_from_slice(&v.to_le_bytes());
    }
    pub(crate) fn f64(&mut self, v: f64) {
        self.0.extend_from_slice(&v.to_le_bytes());
    }
    pub(crate) fn numbers<const N: usize>(&mut self, numbers: [f64; N]) {
        numbers.into_iter().for_each(|v| self.f64(v));
    }
    pub(crate) fn count(&mut self, count: usize) -> Option<()> {
        self.u32(u32::try_from(count).ok()?);
        Some(())
    }
    pub(crate) fn blob(&mut self, bytes: &[u8]) -> Option<()> {
        self.count(bytes.len())?;
        self.0.extend_from_slice(bytes);
        Some(())
    }
    fn pixels(&mut self, pixels: &[DepthPixel]) -> Option<()> {
        self.count(pixels.len())?;
        self.0.reserve(pixels.len() * PIXEL_BYTES);
        for p in pixels {
            self.0.extend_from_slice(&p.x.to_le_bytes());
            self.0.extend_from_slice(&p.y.to_le_bytes());
            self.0.extend_from_slice(&p.idepth.to_le_bytes());
            self.0.extend_from_slice(&p.idepth_var.to_le_bytes());
        }
        Some(())
    }
}

/// Bytes of a depth pixel.
const PIXEL_BYTES: usize = 12;

impl Input<'_> {
    fn pixels(&mut self) -> Option<Vec<DepthPixel>> {
        let count = self.u32()? as usize;
        let bytes = self.take(count.checked_mul(PIXEL_BYTES)?)?;
        let pixels = bytes.chunks_exact(PIXEL_BYTES).map(|b| DepthPixel {
            x: u16::from_le_bytes([b[0], b[1]]),
            y: u16::from_le_bytes([b[2], b[3]]),
            idepth: f32::from_le_bytes([b[4], b[5], b[6], b[7]]),
            idepth_var: f32::from_le_bytes([b[8], b[9], b[10], b[11]]),
        });
        Some(pixels.collect())
    }
}
