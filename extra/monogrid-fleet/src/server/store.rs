//! What has come of the runs of all agents, on disk.

use super::limits::{KEPT_FREE_BYTES, Limits, OverLimit, Usage};
use super::transforms::{Frame, OwnPoses};
use crate::messages::{RunKey, WARNING};
use crate::packet::{Packet, PacketError, Unfinished, check_record, check_size};
use crate::packet_log::{PacketLog, append_at};
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
    /// The agent, or all agents together, would have more than they may.
    #[error(transparent)]
    OverLimit(#[from] OverLimit),
    /// What came of the run before cannot be gone on with.
    #[error("the run was closed when the server started: {0}")]
    Closed(String),
    /// The disk is nearly full.
    #[error("{free} bytes are free on the disk of {path}, {KEPT_FREE_BYTES} are kept free")]
    NoSpace {
        /// The folder.
        path: PathBuf,
        /// Bytes that are free.
        free: u64,
    },
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

impl StoreError {
    /// Whether the same packet can be taken later: it is the server that has trouble.
    #[must_use]
    pub fn can_pass(&self) -> bool {
        match self {
            Self::Packet(_) | Self::OverLimit(_) | Self::Closed(_) => false,
            Self::NoSpace { .. } | Self::File { .. } | Self::Recording(_) => true,
        }
    }
}

/// All runs. No file stays open between two calls: the number of runs is not that of file handles.
#[derive(Debug)]
pub struct Store {
    folder: PathBuf,
    limits: Limits,
    /// In the order in which they came.
    pub order: Vec<RunKey>,
    /// Those of which something has come.
    pub runs: BTreeMap<RunKey, StoredRun>,
    /// Those of an earlier server that cannot be gone on with, and why.
    closed: BTreeMap<RunKey, String>,
}

/// What has come of a run.
#[derive(Debug)]
pub struct StoredRun {
    packets: PathBuf,
    pub log: PacketLog,
    /// The same as a recording, which grows with it; poses are written when it is to be read.
    file: PathBuf,
    /// Bytes of the recording.
    recorded: u64,
    usage: Usage,
    /// Size of its images where keyframes have no camera of their own, px.
    size: (usize, usize),
    pub known: Known,
    /// Why it is not joined with others.
    pub apart: Option<Apart>,
}

/// Why a run is not joined, and until when.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Apart {
    /// The reason.
    pub why: String,
    /// It is tried again when so many packets have come, or when the run has ended.
    pub until_packets: u64,
    /// Whether it had ended then.
    pub had_ended: bool,
}

/// What its packets say, beside images and depth.
#[derive(Debug, Default)]
pub struct Known {
    /// The keyframes that have come.
    pub frames: BTreeMap<u32, Frame>,
    sizes: BTreeMap<u32, (u16, u16)>,
    poses: BTreeMap<u32, Sim3>,
    pose_revision: u64,
    /// Whether there are poses that the recording has not got.
    has_new_poses: bool,
    /// Whether the run has ended by itself, and all of it has come.
    pub has_ended: bool,
    unfinished: Unfinished,
}

/// What a packet will change.
struct Step {
    /// The record that it is, or completes.
    record: Option<Record>,
    /// The record as bytes, where the recording gets it now.
    recorded: Vec<u8>,
    unfinished: Unfinished,
}

/// What runs are joined.
#[derive(Debug, Default)]
pub struct Joinable {
    /// The runs, in the order in which they came.
    pub runs: Vec<RunKey>,
    /// Their recordings.
    pub files: Vec<PathBuf>,
    /// The poses that these hold.
    pub own: BTreeMap<RunKey, OwnPoses>,
    /// Runs that are left out this time, and why.
    pub left_out: Vec<String>,
}

/// The list of runs.
const RUNS: &str = "runs.txt";
/// The packets of a run.
const PACKETS: &str = "packets.mgf";

impl Store {
    /// Opens the folder of an earlier server, or makes one. `say` hears what of an earlier server
    /// cannot be gone on with.
    pub fn open(
        folder: &Path,
        limits: Limits,
        say: &mut dyn FnMut(String),
    ) -> Result<Self, StoreError> {
        let folder = folder.join("agents");
        std::fs::create_dir_all(&folder).map_err(at(&folder))?;
        let list = folder.join(RUNS);
        let mut store = Self {
            folder,
            // what is there is taken up whatever the limits are now; nothing more comes then
            limits: Limits::NONE,
            order: Vec::new(),
            runs: BTreeMap::new(),
            closed: BTreeMap::new(),
        };
        let text = match std::fs::read_to_string(&list) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => String::new(),
            text => text.map_err(at(&list))?,
        };
        for line in text.lines() {
            let run = line.parse().map_err(std::io::Error::other);
            let run: RunKey = run.map_err(at(&list))?;
            // named twice by a server that was killed before the first packet was kept
            if store.runs.contains_key(&run) || store.closed.contains_key(&run) {
                continue;
            }
            if let Err(error) = store.open_run(&run) {
                say(format!("{WARNING}closed: {run}: {error}"));
                store.closed.insert(run.clone(), error.to_string());
                // the packets before it were good
                if let Some(stored) = store.runs.get_mut(&run) {
                    stored.set_apart(error.to_string(), u64::MAX);
                }
            }
        }
        store.limits = limits;
        Ok(store)
    }

    /// Takes up what came of a run before.
    fn open_run(&mut self, run: &RunKey) -> Result<(), StoreError> {
        let packets = self.folder_of(run).join(PACKETS);
        let log = PacketLog::open(&packets).map_err(at(&packets))?;
        for number in 0..log.len() {
            let bytes = log.read(number).map_err(at(&packets))?.unwrap_or_default();
            let packet = Packet::decode(&bytes)?;
            match self.runs.get_mut(run) {
                None => self.begin(run, &packet, &bytes, false)?,
                Some(stored) => {
                    let step = stored.step(run, &packet, |first| parts(&log, first, number))?;
                    stored.record(&step.recorded)?;
                    stored.commit(step, bytes.len());
                }
            }
        }
        if let Some(stored) = self.runs.get_mut(run) {
            stored.log = log;
        }
        Ok(())
    }

    fn folder_of(&self, run: &RunKey) -> PathBuf {
        self.folder.join(run.to_string().replace('/', "-"))
    }

    /// Takes the next packet of a run, which may be a new one.
    ///
    /// # Errors
    /// When it is refused or cannot be kept; everything is as before then.
    pub fn take(&mut self, run: &RunKey, bytes: &[u8]) -> Result<(), StoreError> {
        if let Some(why) = self.closed.get(run) {
            return Err(StoreError::Closed(why.clone()));
        }
        let mut more = Usage {
            runs: u64::from(!self.runs.contains_key(run)),
            packets: 1,
            bytes: bytes.len() as u64,
            keyframes: 0,
        };
        // before anything is unpacked, and again when it is known what comes of it
        self.allow(run, more)?;
        let packet = Packet::decode(bytes)?;
        let Some(stored) = self.runs.get(run) else {
            return self.begin(run, &packet, bytes, true);
        };
        let (log, next) = (&stored.log, stored.log.len());
        let step = stored.step(run, &packet, |first| parts(log, first, next))?;
        more.bytes += step.recorded.len() as u64;
        more.keyframes = stored.known.new_keyframes(&step);
        self.allow(run, more)?;
        if let Some(stored) = self.runs.get_mut(run) {
            stored.log.append(bytes).map_err(at(&stored.packets))?;
            if let Err(error) = stored.record(&step.recorded) {
                stored.log.truncate(next).map_err(at(&stored.packets))?;
                return Err(error);
            }
            stored.commit(step, bytes.len());
        }
        Ok(())
    }

    /// Refuses what would pass a limit, or fill the disk.
    fn allow(&self, run: &RunKey, more: Usage) -> Result<(), StoreError> {
        let runs = self.runs.iter();
        let of_agent = runs.filter(|(key, _)| key.name() == run.name());
        let of_agent: Usage = of_agent.map(|(_, stored)| stored.usage).sum();
        let of_all = self.usage();
        self.limits
            .check(run.name(), &(of_agent + more), &(of_all + more))?;
        self.has_room(more.bytes)
    }

    /// Refuses what would fill the disk.
    fn has_room(&self, more: u64) -> Result<(), StoreError> {
        let free = free_bytes(&self.folder).map_err(at(&self.folder))?;
        if free < KEPT_FREE_BYTES.saturating_add(more) {
            let path = self.folder.clone();
            return Err(StoreError::NoSpace { path, free });
        }
        Ok(())
    }

    /// Why no packet of anybody would be kept now.
    pub fn why_nothing_is_kept(&self) -> Option<String> {
        self.has_room(0).err().map(|error| error.to_string())
    }

    /// Begins a run with its first packet, which is kept if it `is_new`.
    fn begin(
        &mut self,
        run: &RunKey,
        packet: &Packet,
        bytes: &[u8],
        is_new: bool,
    ) -> Result<(), StoreError> {
        let session = match packet {
            Packet::Record(part) => {
                let unfinished = Unfinished::default().after(part, 0)?;
                let whole = unfinished.is_whole().then_some(&part.bytes);
                whole.map(|bytes| unfinished.record(bytes)).transpose()?
            }
            _ => None,
        };
        let Some(record @ Record::Session(_)) = session else {
            return Err(PacketError::Content("a run does not begin with its session").into());
        };
        check_record(&record, 0, |_| false)?;
        let Record::Session(session) = record else {
            return Ok(());
        };
        let folder = self.folder_of(run);
        let made = self.make(run, &folder, session, is_new.then_some(bytes));
        let mut stored = made.inspect_err(|_| {
            if is_new {
                let _ = std::fs::remove_dir_all(&folder);
            }
        })?;
        stored.usage = Usage {
            runs: 1,
            keyframes: 0,
            packets: 1,
            bytes: bytes.len() as u64 + stored.recorded,
        };
        self.order.push(run.clone());
        self.runs.insert(run.clone(), stored);
        Ok(())
    }

    /// Makes the files of a run; `first` is its first packet where it is to be kept.
    fn make(
        &self,
        run: &RunKey,
        folder: &Path,
        session: SessionInfo,
        first: Option<&[u8]>,
    ) -> Result<StoredRun, StoreError> {
        std::fs::create_dir_all(folder).map_err(at(folder))?;
        let (packets, file) = (folder.join(PACKETS), folder.join("recording.mgk"));
        let size = (session.width, session.height);
        let source = run.to_string();
        RecordingWriter::create(&file, &SessionInfo { source, ..session })?;
        let recorded = file.metadata().map_err(at(&file))?.len();
        if first.is_some() {
            // what a server left that was killed before it named the run
            let _ = std::fs::remove_file(&packets);
        }
        let mut log = PacketLog::open(&packets).map_err(at(&packets))?;
        if let Some(first) = first {
            log.append(first).map_err(at(&packets))?;
            let list = self.folder.join(RUNS);
            let written = appended(&list).and_then(|mut file| writeln!(file, "{run}"));
            written.map_err(at(&list))?;
        }
        Ok(StoredRun {
            packets,
            log,
            file,
            recorded,
            usage: Usage::default(),
            size,
            known: Known::default(),
            apart: None,
        })
    }

    /// A packet of a run; `None` where it has not come.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn packet(&self, run: &RunKey, number: u64) -> Result<Option<Vec<u8>>, StoreError> {
        let Some(stored) = self.runs.get(run) else {
            return Ok(None);
        };
        stored.log.read(number).map_err(at(&stored.packets))
    }

    /// What is kept of all runs.
    #[must_use]
    pub fn usage(&self) -> Usage {
        self.runs.values().map(|stored| stored.usage).sum()
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

    /// Makes the recording of each run that can be joined ready for being read. A run whose
    /// recording cannot be written is left out.
    pub fn joinable(&mut self) -> Joinable {
        let mut joinable = Joinable::default();
        for key in self.order.clone() {
            let run = self.runs.get(&key).filter(|run| run.is_joinable());
            let Some(poses) = run.map(|run| run.new_poses()) else {
                continue;
            };
            let bytes = poses.len() as u64;
            let more = Usage {
                bytes,
                ..Usage::default()
            };
            let allowed = if bytes > 0 {
                self.allow(&key, more)
            } else {
                Ok(())
            };
            let Some(run) = self.runs.get_mut(&key) else {
                continue;
            };
            if let Err(error) = allowed.and_then(|()| run.record(&poses)) {
                let text = format!("{key} is left out: its poses cannot be written: {error}");
                joinable.left_out.push(text);
                continue;
            }
            run.usage.bytes += bytes;
            run.known.has_new_poses = false;
            joinable.own.insert(key.clone(), run.known.own_poses());
            joinable.files.push(run.file.clone());
            joinable.runs.push(key);
        }
        joinable
    }

    /// Those of some runs that are there, and their recordings.
    #[must_use]
    pub fn files(&self, runs: &[RunKey]) -> (Vec<RunKey>, Vec<PathBuf>) {
        let file = |key: &RunKey| Some((key.clone(), self.runs.get(key)?.file.clone()));
        runs.iter().filter_map(file).unzip()
    }

    /// Writes what is known of all beside their packets.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn write_fleet(&self, json: &[u8]) -> Result<(), StoreError> {
        Ok(write_atomically(&self.folder.join("fleet.json"), json)?)
    }

    /// A file for what the process that joins says.
    #[must_use]
    pub fn joining_log(&self) -> PathBuf {
        self.folder.join("joining.log")
    }

    /// The folder of the joined map.
    #[must_use]
    pub fn map(&self) -> PathBuf {
        self.folder.parent().unwrap_or(&self.folder).join("map")
    }

    /// A folder for trials, which may be deleted.
    #[must_use]
    pub fn trial(&self) -> PathBuf {
        self.folder.join("trial")
    }
}

impl StoredRun {
    /// Whether it has enough for being joined: two keyframes whose poses are known are a map.
    #[must_use]
    pub fn is_joinable(&self) -> bool {
        self.known.poses.len() >= 2 && !self.is_apart()
    }

    /// Whether it is set apart, for now.
    #[must_use]
    pub fn is_apart(&self) -> bool {
        self.apart.as_ref().is_some_and(|apart| {
            let has_ended_since = self.known.has_ended && !apart.had_ended;
            let is_final = apart.until_packets == u64::MAX;
            is_final || (self.log.len() < apart.until_packets && !has_ended_since)
        })
    }

    /// Sets it apart until so many packets have come.
    pub fn set_apart(&mut self, why: String, until_packets: u64) {
        self.apart = Some(Apart {
            why,
            until_packets,
            had_ended: self.known.has_ended,
        });
    }

    /// What a packet changes; nothing is changed yet. `parts` are the bytes of the parts of a
    /// record from the packet that is so many before this one.
    fn step(
        &self,
        key: &RunKey,
        packet: &Packet,
        parts: impl FnOnce(u64) -> std::io::Result<Vec<u8>>,
    ) -> Result<Step, StoreError> {
        let known = &self.known;
        // a record that something else comes in between of is given up
        let mut unfinished = Unfinished::default();
        let mut record = match packet {
            Packet::Keyframe(keyframe) => {
                check_size(keyframe.size)?;
                let size = (usize::from(keyframe.size.0), usize::from(keyframe.size.1));
                if keyframe.camera.is_none() && size != self.size {
                    let reason = "an image is not of the size of its camera";
                    return Err(PacketError::Content(reason).into());
                }
                Some(Record::Keyframe(keyframe.unpack()?))
            }
            Packet::Depth(depth) if known.sizes.get(&depth.keyframe_id) == Some(&depth.size) => {
                Some(Record::Depth(depth.unpack()?))
            }
            Packet::Depth(_) => {
                let reason = "depth is of no keyframe that has come";
                return Err(PacketError::Content(reason).into());
            }
            Packet::Record(part) => {
                let num_keyframes = known.frames.len();
                unfinished = known.unfinished.after(part, num_keyframes as u64)?;
                if unfinished.is_whole() {
                    let mut bytes = parts(unfinished.parts() - 1).map_err(at(&self.packets))?;
                    bytes.extend_from_slice(&part.bytes);
                    let record = unfinished.record(&bytes)?;
                    drop(bytes);
                    check_record(&record, num_keyframes, |id| known.frames.contains_key(&id))?;
                    unfinished = Unfinished::default();
                    Some(record)
                } else {
                    None
                }
            }
        };
        // the sources of the recording are named as the run
        if let Some(Record::Continuation(continuation)) = &mut record {
            for session in &mut continuation.sessions {
                session.source = key.to_string();
            }
        }
        let is_recorded =
            |record: &&Record| !matches!(record, Record::Session(_) | Record::Poses(_));
        let recorded = record.as_ref().filter(is_recorded);
        let recorded = recorded.map(|record| record.encode().ok_or(PacketError::TooLarge));
        Ok(Step {
            recorded: recorded.transpose()?.unwrap_or_default(),
            record,
            unfinished,
        })
    }

    /// Appends to the recording.
    fn record(&mut self, bytes: &[u8]) -> Result<(), StoreError> {
        if bytes.is_empty() {
            return Ok(());
        }
        let file = OpenOptions::new().write(true).open(&self.file);
        let written = file.and_then(|mut file| append_at(&mut file, self.recorded, bytes));
        written.map_err(at(&self.file))?;
        self.recorded += bytes.len() as u64;
        Ok(())
    }

    /// Knows what a packet of so many bytes said, once it is kept.
    fn commit(&mut self, step: Step, packet_bytes: usize) {
        self.usage.keyframes += self.known.new_keyframes(&step);
        self.usage.packets += 1;
        self.usage.bytes += packet_bytes as u64 + step.recorded.len() as u64;
        let known = &mut self.known;
        known.unfinished = step.unfinished;
        match step.record {
            Some(Record::Keyframe(keyframe)) => {
                let frame = (keyframe.frame_index, keyframe.timestamp_ns);
                known.frames.insert(keyframe.id, frame);
                let size = keyframe.image.map(|image| (image.width(), image.height()));
                let (width, height) = size.unwrap_or_default();
                let size = (width as u16, height as u16);
                known.sizes.insert(keyframe.id, size);
            }
            Some(Record::Poses(poses)) => {
                known.pose_revision = poses.revision;
                known.poses.extend(poses.poses);
                known.has_new_poses = true;
            }
            Some(Record::End(_)) => known.has_ended = true,
            _ => {}
        }
    }

    /// Poses as a record, if the recording has not got them; no bytes otherwise.
    fn new_poses(&self) -> Vec<u8> {
        let known = &self.known;
        let poses = || {
            Record::Poses(PoseSnapshot {
                revision: known.pose_revision,
                poses: known.poses.iter().map(|(id, pose)| (*id, *pose)).collect(),
            })
        };
        let bytes = known.has_new_poses.then(|| poses().encode());
        // less than 4 GiB: there are no more poses than keyframes
        bytes.flatten().unwrap_or_default()
    }
}

impl Known {
    fn new_keyframes(&self, step: &Step) -> u64 {
        match &step.record {
            Some(Record::Keyframe(keyframe)) => u64::from(!self.frames.contains_key(&keyframe.id)),
            _ => 0,
        }
    }

    fn own_poses(&self) -> OwnPoses {
        let frame_of = |(id, pose): (&u32, &Sim3)| Some((*self.frames.get(id)?, *pose));
        self.poses.iter().filter_map(frame_of).collect()
    }
}

/// The bytes of so many parts of a record, which came in the packets just before number `next`.
fn parts(log: &PacketLog, count: u64, next: u64) -> std::io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    for number in next.saturating_sub(count)..next {
        let packet = log.read(number)?.unwrap_or_default();
        // it was one when it came
        if let Ok(Packet::Record(part)) = Packet::decode(&packet) {
            bytes.extend(part.bytes);
        }
    }
    Ok(bytes)
}

/// Bytes that are free on the disk of a folder.
#[cfg(unix)]
fn free_bytes(folder: &Path) -> std::io::Result<u64> {
    let disk = rustix::fs::statvfs(folder)?;
    Ok(disk.f_bavail.saturating_mul(disk.f_frsize))
}

#[cfg(not(unix))]
fn free_bytes(_: &Path) -> std::io::Result<u64> {
    Ok(u64::MAX)
}

fn at(path: &Path) -> impl Fn(std::io::Error) -> StoreError {
    move |error| StoreError::File {
        path: path.to_owned(),
        error,
    }
}

/// A file that is appended to.
fn appended(path: &Path) -> std::io::Result<File> {
    OpenOptions::new().append(true).create(true).open(path)
}
