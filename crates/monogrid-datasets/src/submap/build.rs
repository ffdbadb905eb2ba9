//! Making a submap.

use super::block::{Codec, pack};
use super::directory::{self, END_MAGIC, FORMAT_VERSION, HEADER_BYTES, MAGIC};
use super::id::hash_of;
use super::{SubmapBlock, SubmapId, SubmapInfo, SubmapPose};
use crate::{
    DepthPixel, DepthRevision, KeyframeRecord, PoseSnapshot, Record, RecordedCamera, SessionInfo,
};
use monogrid_geometry::{Sim3, Vec3};

/// A submap that can be written under its [name](SubmapId::file_name).
#[derive(Clone, Debug)]
pub struct BuiltSubmap {
    /// Its name.
    pub id: SubmapId,
    /// The file.
    pub bytes: Vec<u8>,
    /// Where its keyframes lie in it.
    pub poses: Vec<SubmapPose>,
}

/// Gathers the blocks of a submap.
///
/// All return `None` where something exceeds 4 GiB, which nothing that is tracked does.
#[derive(Debug)]
pub struct SubmapBuilder {
    bytes: Vec<u8>,
    info: SubmapInfo,
    blocks: Vec<SubmapBlock>,
    poses: Vec<SubmapPose>,
}

/// Depth is within the bounds of a submap where its standard deviation is at most this part of it:
/// what is known less well lies anywhere.
const MAX_SIGMA_WITHIN: f32 = 0.1;

impl SubmapBuilder {
    /// A submap of this run.
    #[must_use]
    pub fn new(session: &SessionInfo) -> Option<Self> {
        let mut bytes = MAGIC.to_vec();
        bytes.extend(FORMAT_VERSION.to_le_bytes());
        bytes.resize(HEADER_BYTES as usize, 0);
        let mut this = Self {
            bytes,
            info: SubmapInfo {
                camera: session.camera(),
                scale: session.scale,
                times_ns: None,
                bounds: None,
            },
            blocks: Vec::new(),
            poses: Vec::new(),
        };
        this.add(&Record::Session(session.clone()))?;
        Some(this)
    }

    /// A keyframe with this revision of its depth, and where it lies; `None` where that is not
    /// known in the frame of the submap.
    pub fn add_keyframe(
        &mut self,
        mut keyframe: KeyframeRecord,
        revision: u32,
        submap_from_keyframe: Option<Sim3>,
    ) -> Option<()> {
        let [first, last] = self.info.times_ns.unwrap_or([keyframe.timestamp_ns; 2]);
        let time = keyframe.timestamp_ns;
        self.info.times_ns = Some([first.min(time), last.max(time)]);
        let id = keyframe.id;
        self.poses.push((id, submap_from_keyframe));
        let pixels = std::mem::take(&mut keyframe.pixels);
        if let Some(pose) = submap_from_keyframe {
            let camera = keyframe.camera.unwrap_or(self.info.camera);
            self.cover(&pose, &camera, &pixels);
        }
        self.add(&Record::Keyframe(keyframe))?;
        // a block of its own, that is compressed and read without the image
        self.add(&Record::Depth(DepthRevision {
            keyframe_id: id,
            revision,
            pixels,
        }))
    }

    /// Anything else that a recording can hold.
    pub fn add(&mut self, record: &Record) -> Option<()> {
        let (kind, payload) = record.payload()?;
        let record_bytes = u32::try_from(payload.len()).ok()?;
        let (codec, stored) = pack(codec_of(record), payload);
        self.blocks.push(SubmapBlock {
            kind,
            keyframe: keyframe_of(record),
            offset: self.bytes.len() as u64,
            stored_bytes: u32::try_from(stored.len()).ok()?,
            record_bytes,
            codec,
            hash: hash_of(&stored),
        });
        self.bytes.extend(stored);
        Some(())
    }

    /// The submap.
    #[must_use]
    pub fn finish(mut self) -> Option<BuiltSubmap> {
        let placed = self.poses.iter();
        let placed = placed.filter_map(|(id, pose)| Some((*id, (*pose)?)));
        let poses = PoseSnapshot {
            revision: 0,
            poses: placed.collect(),
        };
        self.add(&Record::Poses(poses))?;
        let directory = directory::encode(&self.info, &self.blocks)?;
        let (begin, length) = (self.bytes.len() as u64, directory.len() as u64);
        let id = SubmapId(hash_of(&directory));
        self.bytes.extend(directory);
        self.bytes.extend(begin.to_le_bytes());
        self.bytes.extend(length.to_le_bytes());
        self.bytes.extend(id.0);
        self.bytes.extend(END_MAGIC);
        Some(BuiltSubmap {
            id,
            bytes: self.bytes,
            poses: self.poses,
        })
    }

    /// Makes the bounds hold a camera and what it sees well.
    fn cover(&mut self, pose: &Sim3, camera: &RecordedCamera, pixels: &[DepthPixel]) {
        let is_known =
            |p: &&DepthPixel| p.idepth > 0.0 && p.idepth_var.sqrt() <= MAX_SIGMA_WITHIN * p.idepth;
        let pinhole = &camera.pinhole;
        let points = pixels.iter().filter(is_known).map(|p| {
            let x = (f64::from(p.x) - pinhole.cx) / pinhole.fx;
            let y = (f64::from(p.y) - pinhole.cy) / pinhole.fy;
            *pose * (Vec3::new(x, y, 1.0) / f64::from(p.idepth))
        });
        let points = std::iter::once(pose.translation).chain(points);
        for point in points.filter(|point| point.iter().all(|v| v.is_finite())) {
            let [low, high] = self.info.bounds.get_or_insert([point.into(); 2]);
            *low = [0, 1, 2].map(|axis| low[axis].min(point[axis]));
            *high = [0, 1, 2].map(|axis| high[axis].max(point[axis]));
        }
    }
}

fn codec_of(record: &Record) -> Codec {
    match record {
        // images are PNG and JPEG
        Record::Keyframe(_) | Record::Colour(_) => Codec::Plain,
        Record::Depth(_) => Codec::Planes,
        _ => Codec::Deflated,
    }
}

fn keyframe_of(record: &Record) -> Option<u32> {
    match record {
        Record::Keyframe(keyframe) => Some(keyframe.id),
        Record::Depth(depth) => Some(depth.keyframe_id),
        Record::Colour(colour) => Some(colour.keyframe_id),
        _ => None,
    }
}
