//! What has come of the runs of all agents, on disk.

use super::transforms::{Frame, OwnPoses};
use crate::messages::RunKey;
use crate::packet::{Packet, PacketError, Unfinished};
use crate::packet_log::PacketLog;
use monogrid_datasets::{
    DatasetError, PoseSnapshot, Record, RecordingWriter, SessionInfo, write_atomically,
};
use monogrid_geometry::Sim3;
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Why something cannot be kept.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// It is no packet, or not what one holds.
    #[error(transparent)]
    Packet(#[from] PacketError),
    /// The disk is full, or a file is damaged.
    #[error("{path}: {error}")]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        error: std::io::Error,
    },
    /// A recording cannot be written.
    #[error(transparent)]
    Recording(#[from] DatasetError),
}

/// All runs.
#[derive(Debug)]
pub struct Store {
    folder: PathBuf,
    /// In the order in which they came.
    pub order: Vec<RunKey>,
    /// Those of which something has come.
    pub runs: BTreeMap<RunKey, StoredRun>,
}

/// What has come of a run.
#[derive(Debug)]
pub struct StoredRun {
    packets: PathBuf,
    pub log: PacketLog,
    /// The same as a recording, which grows with it; poses are written when it is to be read.
    recording: RecordingWriter,
    file: PathBuf,
    pub known: Known,
}

/// What its packets say, beside images and depth.
#[derive(Debug, Default)]
pub struct Known {
    /// The keyframes that have come.
    pub frames: BTreeMap<u32, Frame>,
    sizes: BTreeMap<u32, (u16, u16)>,
    poses: BTreeMap<u32, Sim3>,
    pose_revision: u64,
    /// Whether the run has ended by itself, and all of it has come.
    pub has_ended: bool,
    unfinished: Unfinished,
}

/// The list of runs.
const RUNS: &str = "runs.txt";
/// The packets of a run.
const PACKETS: &str = "packets.mgf";

impl Store {
    /// Opens the folder of an earlier server, or makes one.
    pub fn open(folder: &Path) -> Result<Self, StoreError> {
        let folder = folder.join("agents");
        std::fs::create_dir_all(&folder).map_err(at(&folder))?;
        let list = folder.join(RUNS);
        let mut store = Self {
            folder,
            order: Vec::new(),
            runs: BTreeMap::new(),
        };
        let text = match std::fs::read_to_string(&list) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => String::new(),
            text => text.map_err(at(&list))?,
        };
        for line in text.lines() {
            let run = line.parse().map_err(std::io::Error::other);
            let run: RunKey = run.map_err(at(&list))?;
            // named twice by a server that was killed before the first packet was kept
            if !store.runs.contains_key(&run) {
                store.open_run(&run)?;
            }
        }
        Ok(store)
    }

    /// Takes up what came of a run before.
    fn open_run(&mut self, run: &RunKey) -> Result<(), StoreError> {
        let packets = self.folder_of(run)?.join(PACKETS);
        let mut log = PacketLog::open(&packets).map_err(at(&packets))?;
        for number in 0..log.len() {
            let bytes = log.read(number).map_err(at(&packets))?.unwrap_or_default();
            self.understand(run, &bytes)?;
        }
        if let Some(stored) = self.runs.get_mut(run) {
            stored.log = log;
        }
        Ok(())
    }

    fn folder_of(&self, run: &RunKey) -> Result<PathBuf, StoreError> {
        let folder = self.folder.join(run.to_string().replace('/', "-"));
        std::fs::create_dir_all(&folder).map_err(at(&folder))?;
        Ok(folder)
    }

    /// Takes the next packet of a run, which may be a new one.
    ///
    /// # Errors
    /// [`StoreError::Packet`] for what is refused, after which everything is as before; others when it cannot be kept.
    pub fn take(&mut self, run: &RunKey, packet: &[u8]) -> Result<(), StoreError> {
        let is_new = !self.runs.contains_key(run);
        self.understand(run, packet)?;
        if is_new {
            let list = self.folder.join(RUNS);
            let written = log_file(&list).and_then(|mut file| writeln!(file, "{run}"));
            written.map_err(at(&list))?;
        }
        if let Some(stored) = self.runs.get_mut(run) {
            stored.log.append(packet).map_err(at(&stored.packets))?;
        }
        Ok(())
    }

    /// Takes what a packet says, but not the packet itself.
    fn understand(&mut self, run: &RunKey, packet: &[u8]) -> Result<(), StoreError> {
        let packet = Packet::decode(packet)?;
        if let Some(stored) = self.runs.get_mut(run) {
            let record = stored.known.record_of(&packet)?;
            return record.map_or(Ok(()), |record| stored.know(run, record));
        }
        let Some(Record::Session(session)) = Known::default().record_of(&packet)? else {
            return Err(PacketError::Content("a run does not begin with its session").into());
        };
        let folder = self.folder_of(run)?;
        let (packets, file) = (folder.join(PACKETS), folder.join("recording.mgk"));
        let source = run.to_string();
        let session = SessionInfo { source, ..session };
        let stored = StoredRun {
            log: PacketLog::open(&packets).map_err(at(&packets))?,
            packets,
            recording: RecordingWriter::create(&file, &session)?,
            file,
            known: Known::default(),
        };
        self.order.push(run.clone());
        self.runs.insert(run.clone(), stored);
        Ok(())
    }

    /// A packet of a run; `None` where it has not come.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn packet(&mut self, run: &RunKey, number: u64) -> Result<Option<Vec<u8>>, StoreError> {
        let Some(stored) = self.runs.get_mut(run) else {
            return Ok(None);
        };
        stored.log.read(number).map_err(at(&stored.packets))
    }

    /// Keyframes of all runs.
    #[must_use]
    pub fn num_keyframes(&self) -> u64 {
        let keyframes = self.runs.values().map(|run| run.known.frames.len() as u64);
        keyframes.sum()
    }

    /// Number of runs that are so.
    #[must_use]
    pub fn count(&self, is_so: fn(&StoredRun) -> bool) -> usize {
        self.runs.values().filter(|run| is_so(run)).count()
    }

    /// Makes the recording of each run that can be joined ready for being read; the files, and the poses that they hold.
    ///
    /// # Errors
    /// When they cannot be written.
    pub fn recordings(&mut self) -> Result<(Vec<PathBuf>, BTreeMap<RunKey, OwnPoses>), StoreError> {
        let mut files = Vec::new();
        let mut own = BTreeMap::new();
        for key in &self.order {
            let run = self.runs.get_mut(key).filter(|run| run.is_joinable());
            let Some(run) = run else {
                continue;
            };
            let Known { frames, poses, .. } = &run.known;
            let frame_of = |(id, pose): (&u32, &Sim3)| Some((*frames.get(id)?, *pose));
            own.insert(key.clone(), poses.iter().filter_map(frame_of).collect());
            run.recording.append_poses(PoseSnapshot {
                revision: run.known.pose_revision,
                poses: poses.iter().map(|(id, pose)| (*id, *pose)).collect(),
            })?;
            files.push(run.file.clone());
        }
        Ok((files, own))
    }

    /// Writes what is known of all beside their packets.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn write_fleet(&self, json: &[u8]) -> Result<(), StoreError> {
        Ok(write_atomically(&self.folder.join("fleet.json"), json)?)
    }

    /// A file for what the process that joins says, and the folder of what it makes.
    #[must_use]
    pub fn joined(&self) -> (PathBuf, PathBuf) {
        let above = self.folder.parent().unwrap_or(&self.folder);
        (self.folder.join("joining.log"), above.join("map"))
    }
}

impl StoredRun {
    /// Whether it has enough for being joined: two keyframes whose poses are known are a map.
    #[must_use]
    pub fn is_joinable(&self) -> bool {
        self.known.poses.len() >= 2
    }

    /// Takes what a packet said. The sources of the recording are named as the run.
    fn know(&mut self, key: &RunKey, record: Record) -> Result<(), StoreError> {
        let known = &mut self.known;
        match record {
            Record::Keyframe(keyframe) => {
                let frame = (keyframe.frame_index, keyframe.timestamp_ns);
                known.frames.insert(keyframe.id, frame);
                self.recording.append_keyframe(keyframe)?;
            }
            Record::Depth(depth) => self.recording.append_depth(depth)?,
            Record::Poses(poses) => {
                known.pose_revision = poses.revision;
                known.poses.extend(poses.poses);
            }
            Record::Continuation(mut continuation) => {
                for session in &mut continuation.sessions {
                    session.source = key.to_string();
                }
                self.recording.append(&Record::Continuation(continuation))?;
            }
            Record::End(end) => {
                known.has_ended = true;
                self.recording.append(&Record::End(end))?;
            }
            Record::Session(_) | Record::Colour(_) => {}
        }
        Ok(())
    }
}

impl Known {
    /// The record that a packet is, or completes. What cannot be of this run is refused.
    fn record_of(&mut self, packet: &Packet) -> Result<Option<Record>, PacketError> {
        match packet {
            Packet::Keyframe(keyframe) => {
                let record = keyframe.unpack()?;
                self.sizes.insert(keyframe.id, keyframe.size);
                Ok(Some(Record::Keyframe(record)))
            }
            Packet::Depth(depth) if self.sizes.get(&depth.keyframe_id) == Some(&depth.size) => {
                Ok(Some(Record::Depth(depth.unpack()?)))
            }
            Packet::Depth(_) => Err(PacketError::Content(
                "depth is of no keyframe that has come",
            )),
            Packet::Record(part) => self.unfinished.take(part),
        }
    }
}

fn at(path: &Path) -> impl Fn(std::io::Error) -> StoreError {
    move |error| StoreError::File {
        path: path.to_owned(),
        error,
    }
}

/// A file that is appended to.
pub(super) fn log_file(path: &Path) -> std::io::Result<File> {
    OpenOptions::new().append(true).create(true).open(path)
}
