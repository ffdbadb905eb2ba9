//! Where submaps lie: `submaps.json`.

use super::{SubmapId, SubmapPose, SubmapReader};
use crate::files::read_file;
use crate::recording::{numbers_of_pose, pose_of_numbers};
use crate::{DatasetError, PoseSnapshot};
use monogrid_geometry::Sim3;
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};
use std::collections::{BTreeMap, BTreeSet};
use std::io::{Read, Seek};
use std::path::Path;

/// Name of the table beside the submaps.
pub const SUBMAP_TABLE: &str = "submaps.json";
/// What the table says that it is.
const FORMAT: &str = "monogrid submaps";
/// Version that is written and read.
const VERSION: u32 = 1;
/// Largest table that is read: some million keyframes.
const MAX_TABLE_BYTES: u64 = 1 << 30;

/// The submaps of a run, and where they are in the world as the graph has it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SubmapTable {
    /// Revision of the poses, that of the recording; `None` when there are none.
    pub pose_revision: Option<u64>,
    /// The submaps in the order in which they were closed. What a later one says of a keyframe
    /// replaces what earlier ones say.
    pub submaps: Vec<SubmapEntry>,
}

/// A submap and where it is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SubmapEntry {
    /// Its name.
    #[serde(serialize_with = "write_id", deserialize_with = "read_id")]
    pub file: SubmapId,
    /// Bytes of the file.
    pub bytes: u64,
    /// Keyframes in it.
    pub keyframes: usize,
    /// Its pose; `None` where it has none in the map.
    #[serde(serialize_with = "write_pose", deserialize_with = "read_pose")]
    pub world_from_submap: Option<Sim3>,
    /// Keyframes whose pose in the world is another one than the submap's and theirs in it give, to
    /// the last bit, and that pose.
    pub moved: Vec<MovedKeyframe>,
}

/// A keyframe that moved in its submap.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MovedKeyframe {
    /// The keyframe.
    pub id: u32,
    /// Its pose; `None` where it has none in the map.
    #[serde(serialize_with = "write_pose", deserialize_with = "read_pose")]
    pub world_from_keyframe: Option<Sim3>,
}

/// The file.
#[derive(Serialize, Deserialize)]
struct TableFile {
    format: String,
    version: u32,
    pose_revision: Option<u64>,
    submaps: Vec<SubmapEntry>,
}

impl SubmapEntry {
    /// A submap of `bytes`, whose keyframes lie in it at `poses` and in the world where `world`
    /// says: with the first of them.
    #[must_use]
    pub fn placed(
        (file, bytes): (SubmapId, u64),
        poses: &[SubmapPose],
        world: impl Fn(u32) -> Option<Sim3>,
    ) -> Self {
        let mut this = Self {
            file,
            bytes,
            keyframes: poses.len(),
            world_from_submap: poses.first().and_then(|(first, _)| world(*first)),
            moved: Vec::new(),
        };
        for (id, in_submap) in poses {
            let world_from_keyframe = world(*id);
            if !is_same(this.composed(*in_submap), world_from_keyframe) {
                this.moved.push(MovedKeyframe {
                    id: *id,
                    world_from_keyframe,
                });
            }
        }
        this
    }

    /// Where its keyframes are in the world, by what the file says.
    ///
    /// # Errors
    /// When the file cannot be read or is damaged.
    pub fn world_from_keyframes<R: Read + Seek>(
        &self,
        reader: &mut SubmapReader<R>,
    ) -> Result<BTreeMap<u32, Sim3>, DatasetError> {
        let poses = reader.poses()?.into_iter();
        let mut world: BTreeMap<u32, Option<Sim3>> = poses
            .map(|(id, in_submap)| (id, self.composed(in_submap)))
            .collect();
        for moved in &self.moved {
            // one that the file does not hold is in no map
            if let Some(pose) = world.get_mut(&moved.id) {
                *pose = moved.world_from_keyframe;
            }
        }
        let placed = world.into_iter();
        Ok(placed.filter_map(|(id, pose)| Some((id, pose?))).collect())
    }

    fn composed(&self, submap_from_keyframe: Option<Sim3>) -> Option<Sim3> {
        let (world_from_submap, submap_from_keyframe) =
            (self.world_from_submap?, submap_from_keyframe?);
        // the first keyframe, which a product would round
        if submap_from_keyframe == Sim3::identity() {
            return Some(world_from_submap);
        }
        let pose = world_from_submap * submap_from_keyframe;
        pose.is_finite().then_some(pose)
    }
}

/// Whether two poses are the same bits.
fn is_same(a: Option<Sim3>, b: Option<Sim3>) -> bool {
    let bits = |pose: Option<Sim3>| pose.map(|pose| numbers_of_pose(&pose).map(f64::to_bits));
    bits(a) == bits(b)
}

impl SubmapTable {
    /// Reads a table.
    ///
    /// # Errors
    /// When it cannot be read, is none, or is of a later version.
    pub fn read(path: &Path) -> Result<Self, DatasetError> {
        let bytes = read_file(path, MAX_TABLE_BYTES)?;
        Self::parse(&bytes).map_err(|found| {
            let expected =
                format!("a table of submaps of version {VERSION}, as `{SUBMAP_TABLE}` is");
            DatasetError::content(path, found, expected)
        })
    }

    fn parse(bytes: &[u8]) -> Result<Self, String> {
        let file: TableFile = serde_json::from_slice(bytes).map_err(|error| error.to_string())?;
        if file.format != FORMAT || file.version != VERSION {
            return Err(format!("{:?}, version {}", file.format, file.version));
        }
        let mut named = BTreeSet::new();
        let twice = file.submaps.iter().find(|entry| !named.insert(entry.file));
        if let Some(entry) = twice {
            return Err(format!("{} twice", entry.file.file_name()));
        }
        Ok(Self {
            pose_revision: file.pose_revision,
            submaps: file.submaps,
        })
    }

    /// The content of the file, a line for each submap.
    #[must_use]
    pub fn to_json(&self) -> String {
        // numbers and texts are always written
        let json = |entry| serde_json::to_string(entry).unwrap_or_default();
        let submaps: Vec<String> = self.submaps.iter().map(json).collect();
        let revision = self
            .pose_revision
            .map_or("null".to_owned(), |revision| revision.to_string());
        format!(
            "{{\"format\":\"{FORMAT}\",\"version\":{VERSION},\"pose_revision\":{revision},\
             \"submaps\":[\n\
             {}\n]}}\n",
            submaps.join(",\n")
        )
    }

    /// The poses of these keyframes, as a recording has them.
    pub(super) fn snapshot(&self, world: BTreeMap<u32, Sim3>) -> Option<PoseSnapshot> {
        Some(PoseSnapshot {
            revision: self.pose_revision?,
            poses: world.into_iter().collect(),
        })
    }
}

fn write_id<S: Serializer>(id: &SubmapId, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(&id.file_name())
}

fn read_id<'de, D: Deserializer<'de>>(deserializer: D) -> Result<SubmapId, D::Error> {
    let name = String::deserialize(deserializer)?;
    let expected = || de::Error::custom("a submap is named by 64 hexadecimal digits and .mgs");
    SubmapId::of_file_name(&name).ok_or_else(expected)
}

fn write_pose<S: Serializer>(pose: &Option<Sim3>, serializer: S) -> Result<S::Ok, S::Error> {
    pose.as_ref().map(numbers_of_pose).serialize(serializer)
}

fn read_pose<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Sim3>, D::Error> {
    let numbers = Option::<[f64; 8]>::deserialize(deserializer)?;
    let Some(numbers) = numbers else {
        return Ok(None);
    };
    let expected = || de::Error::custom("a pose is scale, tx, ty, tz, qx, qy, qz, qw");
    pose_of_numbers(&numbers).map(Some).ok_or_else(expected)
}
