//! The `.mgk` recording: everything mapping needs, appended while a run goes on.
//!
//! A recording is a sequence of self-contained, checksummed records (see `docs/formats.md`). Each
//! is handed to the operating system as soon as it is complete, so a killed program loses at most
//! the record it was writing; a damaged file yields every record that is whole.

mod assemble;
mod continuation;
mod format;
mod reader;
mod writer;

pub use assemble::{RecordedKeyframe, Recording};
pub use continuation::{
    Continuation, FragmentKeyframe, KeyframeLink, RecordedEdge, RecordedFrame, RecordedPoint,
    RecordedSession,
};
pub use reader::{Damage, ReadOptions, RecordingReader};
pub use writer::RecordingWriter;

pub(crate) use assemble::{Newest, spend};
pub(crate) use format::{
    Bytes, KIND_KEYFRAME, KIND_KEYFRAME_OF_CAMERA, KIND_POSES, decode_camera, decode_record,
    encode_camera, numbers_of_pose, pose_of_numbers,
};

use monogrid_geometry::{Pinhole, Sim3};
pub use monogrid_image::DepthPixel;
use monogrid_image::Image;

/// Whether lengths are metres.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Scale {
    /// Map units of a monocular run.
    #[default]
    Arbitrary,
    /// Metres.
    Metric,
}

/// What holds for the whole recording.
#[derive(Clone, Debug, PartialEq)]
pub struct SessionInfo {
    /// Intrinsics of the (undistorted) keyframe images, px.
    pub pinhole: Pinhole,
    /// Width of the keyframe images, px.
    pub width: usize,
    /// Height of the keyframe images, px.
    pub height: usize,
    /// Whether the world's unit is the metre.
    pub scale: Scale,
    /// Seed of the run.
    pub seed: u64,
    /// Name of the profile.
    pub profile: String,
    /// Name of the source.
    pub source: String,
    /// The effective configuration (TOML), may be empty.
    pub config: String,
}

/// Camera of the (undistorted) images of keyframes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RecordedCamera {
    /// Intrinsics, px.
    pub pinhole: Pinhole,
    /// Width of the images, px.
    pub width: usize,
    /// Height of the images, px.
    pub height: usize,
}

impl SessionInfo {
    /// The camera of all keyframes that have none of their own.
    #[must_use]
    pub fn camera(&self) -> RecordedCamera {
        RecordedCamera {
            pinhole: self.pinhole,
            width: self.width,
            height: self.height,
        }
    }
}

/// A keyframe when it is first recorded.
#[derive(Clone, Debug, PartialEq)]
pub struct KeyframeRecord {
    /// Stable id, never reused.
    pub id: u32,
    /// Index of its frame in the source.
    pub frame_index: u64,
    /// Time, nanoseconds.
    pub timestamp_ns: i64,
    /// Its camera, where it is not that of the session: recordings that were merged have several.
    pub camera: Option<RecordedCamera>,
    /// The undistorted image.
    pub image: Option<Image<u8>>,
    /// Its semi-dense depth.
    pub pixels: Vec<DepthPixel>,
}

/// Better depth for a keyframe that was recorded before; replaces all of its depth.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthRevision {
    /// The keyframe.
    pub keyframe_id: u32,
    /// Counts upwards; the record of the keyframe itself is revision 0.
    pub revision: u32,
    /// The new depth.
    pub pixels: Vec<DepthPixel>,
}

/// What a keyframe looks like in colour, for people: nothing is computed from it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ColourRecord {
    /// The keyframe.
    pub keyframe_id: u32,
    /// The undistorted image in colour, a JPEG file.
    pub jpeg: Vec<u8>,
}

/// Poses of all keyframes at one moment; replaces all earlier poses.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseSnapshot {
    /// Counts upwards.
    pub revision: u64,
    /// Keyframe id and `world_from_keyframe`, whose scale is the length of the keyframe's unit.
    pub poses: Vec<(u32, Sim3)>,
}

/// The last record of a run that ended by itself.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub struct EndRecord {
    /// Frames of the source that were used.
    pub num_frames: u64,
    /// Frames with a believed pose.
    pub num_tracked: u64,
    /// `summary.json` or nothing.
    pub summary: String,
}

/// One record.
#[derive(Clone, Debug, PartialEq)]
pub enum Record {
    /// The first record.
    Session(SessionInfo),
    /// A new keyframe.
    Keyframe(KeyframeRecord),
    /// Colour of a keyframe that was recorded before.
    Colour(ColourRecord),
    /// New depth for a keyframe.
    Depth(DepthRevision),
    /// New poses.
    Poses(PoseSnapshot),
    /// What a later session needs to go on.
    Continuation(Continuation),
    /// The run ended by itself.
    End(EndRecord),
}

impl Record {
    /// Bytes of the header of a record.
    pub const HEADER_BYTES: usize = format::RECORD_HEADER_BYTES;

    /// The bytes of the record as they stand in a file, its header included; `None` beyond 4 GiB.
    #[must_use]
    pub fn encode(&self) -> Option<Vec<u8>> {
        format::encode_record(self)
    }

    /// Its kind and payload, for files that have headers of their own; `None` where a list exceeds
    /// 4 GiB.
    pub(crate) fn payload(&self) -> Option<(u32, Vec<u8>)> {
        let mut payload = Bytes(Vec::new());
        let kind = format::encode_payload(self, &mut payload)?;
        Some((kind, payload.0))
    }

    /// Bytes of a whole record, its header included, by what that header says; `None` when this is
    /// none, or damaged. Whoever gets a record in pieces knows by the first one how much it will
    /// be.
    #[must_use]
    pub fn declared_bytes(header: &[u8; Self::HEADER_BYTES]) -> Option<u64> {
        let header = format::parse_record_header(header)?;
        Some(Self::HEADER_BYTES as u64 + u64::from(header.payload_bytes))
    }

    /// The record that these bytes are, from header to end; `None` when they are damaged, or of a
    /// kind of a later version.
    #[must_use]
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let (header, payload) = bytes.split_first_chunk()?;
        let header = format::parse_record_header(header)?;
        let is_whole = payload.len() == header.payload_bytes as usize
            && crc32fast::hash(payload) == header.payload_crc;
        if !is_whole {
            return None;
        }
        format::decode_record(header.kind, payload, true).ok()?
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_header_says_how_long_its_record_is_and_a_damaged_one_nothing() {
        let bytes = Record::End(EndRecord::default()).encode().unwrap();
        let mut header = *bytes.first_chunk().unwrap();
        assert_eq!(Record::declared_bytes(&header), Some(bytes.len() as u64));
        header[8] ^= 1;
        assert_eq!(Record::declared_bytes(&header), None);
    }
}
