//! `--submaps`: finished keyframes in files that never change, and where the graph has them.
//!
//! They hold the records of the recording and are written beside it; commands read either
//! (`sessions::Source`).

use crate::process::failure::{Classify, Failure};
use crate::run::tracking::recorder::{depth_revision, keyframe_record, loaded};

use crate::output::OutputFolder;
use monogrid_datasets::{
    BuiltSubmap, ColourRecord, Record, SUBMAP_FOLDER, SUBMAP_TABLE, SessionInfo, SubmapBuilder,
    SubmapEntry, SubmapId, SubmapPose, SubmapTable,
};
use monogrid_geometry::Sim3;
use monogrid_slam::{KeptKeyframe, PoseSnapshot};
use std::collections::BTreeMap;
use std::sync::Arc;

/// When keyframes are closed into a submap: the oldest `keyframes` that are open, as soon as
/// `newest` others are. Depth that became better later goes into the next submap.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SubmapPolicy {
    /// Keyframes of a submap, at least 1; fewer where a fragment ends.
    pub keyframes: usize,
    /// The newest keyframes, which stay open: depth becomes better where the camera comes back, and
    /// mostly it does so soon.
    pub newest: usize,
}

impl SubmapPolicy {
    /// With so many keyframes in each.
    pub fn of(keyframes: usize) -> Self {
        Self {
            keyframes,
            newest: 2,
        }
    }
}

/// Closes submaps while a run goes on.
#[derive(Debug)]
pub struct Submaps {
    folder: Arc<OutputFolder>,
    session: SessionInfo,
    policy: SubmapPolicy,
    /// Keyframes that are in no submap.
    open: BTreeMap<u32, Open>,
    /// Keyframes of closed submaps whose depth became better since.
    better: BTreeMap<u32, KeptKeyframe>,
    closed: Vec<Closed>,
}

/// A keyframe that is in no submap.
#[derive(Debug)]
struct Open {
    keyframe: KeptKeyframe,
    /// Revision of its depth, as the recording counts.
    revision: u32,
    colour: Option<Vec<u8>>,
}

/// A submap that was written.
#[derive(Debug)]
struct Closed {
    id: SubmapId,
    bytes: u64,
    poses: Vec<SubmapPose>,
}

/// What is said of submaps that cannot be written.
const DOING: &str = "a submap cannot be written";

impl Submaps {
    /// None yet.
    pub fn new(folder: Arc<OutputFolder>, session: SessionInfo, policy: SubmapPolicy) -> Self {
        Self {
            folder,
            session,
            policy,
            open: BTreeMap::new(),
            better: BTreeMap::new(),
            closed: Vec::new(),
        }
    }

    /// Takes a keyframe with its colour, and closes submaps that are complete with it.
    pub fn finished(
        &mut self,
        keyframe: &KeptKeyframe,
        colour: Option<Vec<u8>>,
        snapshot: &PoseSnapshot,
    ) -> Result<(), Failure> {
        let open = Open {
            keyframe: keyframe.clone(),
            revision: 0,
            colour,
        };
        self.open.insert(keyframe.id, open);
        if self.open.len() < self.policy.keyframes + self.policy.newest {
            return Ok(());
        }
        self.close(snapshot, &[])?;
        self.write_table(snapshot)
    }

    /// Takes better depth of a keyframe.
    pub fn revised(&mut self, keyframe: &KeptKeyframe) {
        if let Some(open) = self.open.get_mut(&keyframe.id) {
            open.keyframe = keyframe.clone();
            open.revision = keyframe.revision;
        } else {
            self.better.insert(keyframe.id, keyframe.clone());
        }
    }

    /// Closes all that is open; the last submap has these records too.
    pub fn end(mut self, snapshot: &PoseSnapshot, last: &[Record]) -> Result<(), Failure> {
        while self.next_ids(snapshot).len() < self.open.len() {
            self.close(snapshot, &[])?;
        }
        self.close(snapshot, last)?;
        self.write_table(snapshot)
    }

    /// The keyframes that are closed next: of one fragment, so that they have a frame in common.
    fn next_ids(&self, snapshot: &PoseSnapshot) -> Vec<u32> {
        let fragment = |id: &u32| snapshot.fragment_of(*id);
        let ids = || self.open.keys().copied();
        let first = ids().next().map(|id| fragment(&id));
        let same = ids().take_while(|id| Some(fragment(id)) == first);
        same.take(self.policy.keyframes).collect()
    }

    /// Writes the next submap.
    fn close(&mut self, snapshot: &PoseSnapshot, more: &[Record]) -> Result<(), Failure> {
        let built = self.build(snapshot, more)?;
        let name = format!("{SUBMAP_FOLDER}/{}", built.id.file_name());
        self.folder.write(&name, &built.bytes)?;
        self.closed.push(Closed {
            id: built.id,
            bytes: built.bytes.len() as u64,
            poses: built.poses,
        });
        Ok(())
    }

    fn build(&mut self, snapshot: &PoseSnapshot, more: &[Record]) -> Result<BuiltSubmap, Failure> {
        let ids = self.next_ids(snapshot);
        let mut builder = whole(SubmapBuilder::new(&self.session))?;
        for id in &ids {
            if let Some(open) = self.open.remove(id) {
                let in_submap = submap_from_keyframe(snapshot, ids[0], *id);
                add(&mut builder, open, in_submap)?;
            }
        }
        for kept in std::mem::take(&mut self.better).into_values() {
            let depth = depth_revision(&loaded(&kept, DOING)?);
            whole(builder.add(&Record::Depth(depth)))?;
        }
        for record in more {
            whole(builder.add(record))?;
        }
        whole(builder.finish())
    }

    /// Says where all submaps are now.
    fn write_table(&self, snapshot: &PoseSnapshot) -> Result<(), Failure> {
        let world = |id| snapshot.in_main_map(id).copied();
        let closed = self.closed.iter();
        let placed = closed
            .map(|closed| SubmapEntry::placed((closed.id, closed.bytes), &closed.poses, world));
        let table = SubmapTable {
            pose_revision: Some(snapshot.revision),
            submaps: placed.collect(),
        };
        let name = format!("{SUBMAP_FOLDER}/{SUBMAP_TABLE}");
        self.folder.write(&name, table.to_json())
    }
}

/// Adds a keyframe and its colour.
fn add(
    builder: &mut SubmapBuilder,
    open: Open,
    submap_from_keyframe: Option<Sim3>,
) -> Result<(), Failure> {
    let keyframe = loaded(&open.keyframe, DOING)?;
    let record = keyframe_record(&keyframe, None);
    whole(builder.add_keyframe(record, open.revision, submap_from_keyframe))?;
    let keyframe_id = keyframe.id;
    match open.colour {
        Some(jpeg) => whole(builder.add(&Record::Colour(ColourRecord { keyframe_id, jpeg }))),
        None => Ok(()),
    }
}

/// Where a keyframe lies in the submap of another one, the first, which is of the same fragment.
fn submap_from_keyframe(snapshot: &PoseSnapshot, first: u32, id: u32) -> Option<Sim3> {
    if id == first {
        return Some(Sim3::identity());
    }
    let pose = |id: u32| snapshot.world_from_keyframe.get(id as usize);
    Some(pose(first)?.inverse() * *pose(id)?)
}

fn whole<T>(built: Option<T>) -> Result<T, Failure> {
    let too_large = || anyhow::anyhow!("a block exceeds 4 GiB");
    built.ok_or_else(too_large).while_running(DOING)
}
