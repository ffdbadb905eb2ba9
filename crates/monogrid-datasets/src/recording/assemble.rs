//! The state of a run at the end of its recording.

use super::{Continuation, Damage, PoseSnapshot};
use super::{
    DepthPixel, EndRecord, KeyframeRecord, ReadOptions, Record, RecordedCamera, RecordingReader,
    SessionInfo,
};
use crate::submap::{is_submap, is_submap_table, read_recording, read_single};
use crate::{DatasetError, PixelBudget};
use monogrid_geometry::{Camera, Distortion, Sim3};
use monogrid_image::Image;
use std::collections::BTreeMap;
use std::io::{Read, Seek};
use std::path::Path;

/// A keyframe with its newest depth and pose.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedKeyframe {
    /// Stable id.
    pub id: u32,
    /// Index of its frame in the source.
    pub frame_index: u64,
    /// Time, nanoseconds.
    pub timestamp_ns: i64,
    /// Its camera.
    pub camera: RecordedCamera,
    /// The undistorted image, if recorded and asked for.
    pub image: Option<Image<u8>>,
    /// The same in colour, a JPEG file as it was recorded, where the source has colour.
    pub colour: Option<Vec<u8>>,
    /// Newest depth; only valid pixels inside the image.
    pub pixels: Vec<DepthPixel>,
    /// Revision of that depth, 0 for the first.
    pub depth_revision: u32,
    /// Newest pose; `None` when the recording ends before one was written.
    pub world_from_keyframe: Option<Sim3>,
}

/// A recording in memory.
#[derive(Clone, Debug, PartialEq)]
pub struct Recording {
    /// What holds for all of it.
    pub session: SessionInfo,
    /// Keyframes in the order of their ids.
    pub keyframes: Vec<RecordedKeyframe>,
    /// Revision of the newest poses; `None` when there are none.
    pub pose_revision: Option<u64>,
    /// What a later session needs to go on; `None` when the run was killed or is of an earlier
    /// version.
    pub continuation: Option<Continuation>,
    /// The end marker; `None` when the run was killed or is still going on.
    pub end: Option<EndRecord>,
    /// What was lost.
    pub damage: Damage,
    /// Depth pixels that were dropped because they lie outside the image or are not finite and
    /// positive.
    pub num_invalid_pixels: u64,
    /// Parts of the continuation that were dropped because they name keyframes or pixels that do
    /// not exist, or measure nothing.
    pub num_invalid_links: usize,
}

impl Recording {
    /// Reads a recording, as far as it is whole, or the submaps of a run by their table
    /// ([`crate::SUBMAP_TABLE`]): the same where the run ended by itself; or one submap, whose
    /// frame is then the world.
    ///
    /// # Errors
    /// When the file cannot be read, is not a recording, or has lost its session record, without
    /// which depth cannot be turned into points; when a submap is missing or damaged.
    pub fn read(path: &Path, options: ReadOptions) -> Result<Self, DatasetError> {
        if is_submap_table(path) {
            return read_recording(path, options);
        }
        if is_submap(path) {
            return read_single(path, options);
        }
        Self::collect(RecordingReader::open(path, options)?, path)
    }

    /// Gathers the newest state from records; `path` is only for messages.
    ///
    /// # Errors
    /// As [`Recording::read`].
    pub fn collect<R: Read + Seek>(
        mut reader: RecordingReader<R>,
        path: &Path,
    ) -> Result<Self, DatasetError> {
        let mut newest = Newest::default();
        let mut budget = PixelBudget::of_recording(path, reader.length());
        for record in reader.by_ref() {
            let record = record?;
            spend(&mut budget, &record)?;
            newest.take(record);
        }
        newest.into_recording(reader.damage(), path)
    }
}

/// Takes the image of a record out of what those of its recording may show.
pub(crate) fn spend(budget: &mut PixelBudget, record: &Record) -> Result<(), DatasetError> {
    if let Record::Keyframe(KeyframeRecord { image, .. }) = record
        && let Some(image) = image
    {
        budget.spend(image.width(), image.height())?;
    }
    Ok(())
}

/// The newest record of each kind.
#[derive(Default)]
pub(crate) struct Newest {
    session: Option<SessionInfo>,
    keyframes: BTreeMap<u32, NewestKeyframe>,
    poses: Option<PoseSnapshot>,
    continuation: Option<Continuation>,
    end: Option<EndRecord>,
}

impl Newest {
    /// Keeps a record where none is newer. What came before its keyframe can only be of a keyframe
    /// lost to damage.
    pub(crate) fn take(&mut self, record: Record) {
        match record {
            Record::Session(session) => self.session = Some(session),
            Record::Keyframe(keyframe) => {
                let newest = NewestKeyframe {
                    record: keyframe,
                    colour: None,
                    depth_revision: 0,
                };
                self.keyframes.insert(newest.record.id, newest);
            }
            Record::Depth(depth) => {
                if let Some(keyframe) = self.keyframes.get_mut(&depth.keyframe_id)
                    && depth.revision >= keyframe.depth_revision
                {
                    keyframe.record.pixels = depth.pixels;
                    keyframe.depth_revision = depth.revision;
                }
            }
            Record::Colour(colour) => {
                if let Some(keyframe) = self.keyframes.get_mut(&colour.keyframe_id) {
                    keyframe.colour = Some(colour.jpeg);
                }
            }
            Record::Poses(poses) => {
                let is_newer = |newest: &PoseSnapshot| poses.revision >= newest.revision;
                if self.poses.as_ref().is_none_or(is_newer) {
                    self.poses = Some(poses);
                }
            }
            Record::Continuation(continuation) => self.continuation = Some(continuation),
            Record::End(end) => self.end = Some(end),
        }
    }

    /// What there is, checked; `path` is only for messages.
    pub(crate) fn into_recording(
        mut self,
        damage: Damage,
        path: &Path,
    ) -> Result<Recording, DatasetError> {
        let session = self.session.take();
        let session = session.filter(|session| is_usable(&session.camera()));
        let session = session
            .ok_or_else(|| DatasetError::binary(path, "recording", "it has no session record"))?;
        let pose_revision = self.poses.as_ref().map(|poses| poses.revision);
        let (mut continuation, end) = (self.continuation.take(), self.end.take());
        let mut keyframes = self.placed_keyframes(&session.camera());
        let num_invalid_pixels = keyframes
            .iter_mut()
            .map(|k| drop_invalid(&mut k.pixels, &k.camera))
            .sum();
        let num_invalid_links = continuation.as_mut().map_or(0, |c: &mut Continuation| {
            c.drop_invalid(|id: u32| {
                let found = keyframes.binary_search_by_key(&id, |k| k.id).ok()?;
                let camera = keyframes[found].camera;
                Some((camera.width, camera.height))
            })
        });
        Ok(Recording {
            session,
            keyframes,
            pose_revision,
            continuation,
            end,
            damage,
            num_invalid_pixels,
            num_invalid_links,
        })
    }

    /// The keyframes with their cameras, that of the session where they have none of their own, and
    /// poses. One whose camera could not be one is left out; an image of another size than its
    /// camera's belongs to none.
    fn placed_keyframes(self, of_session: &RecordedCamera) -> Vec<RecordedKeyframe> {
        let poses = self.poses.into_iter().flat_map(|poses| poses.poses);
        let poses: BTreeMap<u32, Sim3> = poses.collect();
        let keyframes = self.keyframes.into_values().filter_map(|newest| {
            let record = newest.record;
            let camera = record.camera.unwrap_or(*of_session);
            let size = (camera.width, camera.height);
            is_usable(&camera).then(|| RecordedKeyframe {
                id: record.id,
                frame_index: record.frame_index,
                timestamp_ns: record.timestamp_ns,
                camera,
                image: record
                    .image
                    .filter(|image| (image.width(), image.height()) == size),
                colour: newest.colour,
                pixels: record.pixels,
                depth_revision: newest.depth_revision,
                world_from_keyframe: poses.get(&record.id).copied(),
            })
        });
        keyframes.collect()
    }
}

/// The newest of what belongs to a keyframe.
struct NewestKeyframe {
    record: KeyframeRecord,
    colour: Option<Vec<u8>>,
    depth_revision: u32,
}

/// Longest side of a keyframe, px: that of the largest working size.
const MAX_SIDE: usize = 8192;

/// Whether a camera could be one.
fn is_usable(camera: &RecordedCamera) -> bool {
    let (width, height) = (camera.width, camera.height);
    width.max(height) <= MAX_SIDE
        && Camera::try_new(width, height, camera.pinhole, Distortion::None).is_ok()
}

/// Removes pixels that no mapper could use; returns how many.
fn drop_invalid(pixels: &mut Vec<DepthPixel>, camera: &RecordedCamera) -> u64 {
    let before = pixels.len();
    let positive = |v: f32| v.is_finite() && v > 0.0;
    pixels.retain(|p| {
        usize::from(p.x) < camera.width
            && usize::from(p.y) < camera.height
            && positive(p.idepth)
            && positive(p.idepth_var)
    });
    (before - pixels.len()) as u64
}
