//! A run: frames in, trajectory, keyframes and maps out.
//!
//! Threads own their data and pass messages over bounded channels: the reader decodes ahead, the
//! calling thread tracks (with the pool of threads for its inner loops), the recorder saves, the mapper
//! integrates keyframes and follows the graph. Every channel is first in, first out and no result depends on a clock: they are
//! the same for any number of threads (`--realtime`, which drops frames, excepted).

pub mod align;
pub mod outputs;
pub mod progress;
pub mod reader;
pub mod recorder;
pub mod report;
pub mod sessions;
pub mod summary;

use crate::config::RunConfig;
use crate::failure::Failure;
use crate::input::{Input, MAX_UNREADABLE_IN_A_ROW};
use crate::output::OutputFolder;
use crate::usage::{give_way, process_cpu, thread_cpu};
use monogrid_datasets::{EndRecord, SessionInfo};
use monogrid_geometry::Sim3;
use monogrid_image::GrayImage;
use monogrid_occupancy::MapError;
use monogrid_slam::mapping::{
    KeyframeCamera, KeyframeScan, LiveMaps, Mapper, z_up_from_camera_world,
};
use monogrid_slam::{
    FrameInput, FrameReport, Keyframe, PoseSnapshot, Purpose, Slam, TrackingState, TrajectoryPose,
};
use progress::Progress;
use reader::{Delivered, Reader};
use recorder::Change;
use sessions::{Continued, Earlier, continuation};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};
use std::thread;
use std::time::Duration;

/// Changes that may wait for the recorder or the mapper before tracking waits for them.
const CHANGES_AHEAD: usize = 4;

/// What a run is asked for, besides its input.
#[derive(Debug)]
pub struct RunSettings {
    /// All settings.
    pub config: RunConfig,
    /// Depth (metres) to start with, and the index of the frame it belongs to.
    pub seed_depth: Option<(usize, GrayImage)>,
    /// The map to go on with.
    pub continued: Option<Continued>,
    /// Play at the frames' own pace.
    pub realtime: bool,
    /// Threads for the final maps.
    pub threads: usize,
    /// Whether to show a progress bar.
    pub show_progress: bool,
}

impl RunSettings {
    /// Whether the map of an earlier run is only used, not changed.
    pub fn is_localise_only(&self) -> bool {
        let purpose = self.continued.as_ref().map(|continued| continued.purpose);
        purpose == Some(Purpose::LocaliseOnly)
    }

    fn earlier(&self) -> Option<&Earlier> {
        self.continued.as_ref().map(|continued| &continued.earlier)
    }
}

/// What became of a frame.
#[derive(Clone, Debug)]
pub enum FrameFate {
    /// It was given to tracking.
    Processed(Box<FrameReport>),
    /// It could not be used.
    Skipped(String),
    /// It came while the program was behind.
    Dropped,
    /// It lies before the frame with the seed depth.
    BeforeSeed,
}

/// One frame of the source and what became of it.
#[derive(Clone, Debug)]
pub struct FrameRow {
    /// Index in the source.
    pub index: usize,
    /// Time, nanoseconds.
    pub timestamp_ns: i64,
    /// What became of it.
    pub fate: FrameFate,
}

impl FrameRow {
    /// The report of a processed frame.
    pub fn report(&self) -> Option<&FrameReport> {
        match &self.fate {
            FrameFate::Processed(report) => Some(report),
            _ => None,
        }
    }

    /// Whether there was a map and the frame has no pose in it.
    pub fn has_no_place(&self) -> bool {
        let placeless = [TrackingState::Lost, TrackingState::Fragment];
        self.report()
            .is_some_and(|report| placeless.contains(&report.state))
    }
}

/// CPU time by what it was used for.
#[derive(Clone, Copy, Debug, Default)]
pub struct CpuTimes {
    /// Tracking, depth and graph together.
    pub slam: Duration,
    /// Occupancy maps.
    pub mapping: Duration,
    /// Decoding and undistortion.
    pub reading: Duration,
    /// Recording and pictures of keyframes.
    pub recording: Duration,
}

/// Why a run ended before its last frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum EarlyEnd {
    /// The user interrupted it.
    Interrupted,
    /// Too many frames in a row were unreadable; the reason of the last.
    Unreadable(String),
}

/// Everything that a run found, before the final maps.
#[derive(Debug)]
pub struct Tracked {
    /// Every frame.
    pub rows: Vec<FrameRow>,
    /// Frames with a believed pose, final.
    pub trajectory: Vec<TrajectoryPose>,
    /// The system, which holds the finished keyframes.
    pub slam: Slam,
    /// Final poses of the keyframes.
    pub snapshot: Arc<PoseSnapshot>,
    /// Maps as they grew, or why they could not.
    pub live_maps: Result<LiveMaps, MapError>,
    /// CPU time.
    pub cpu: CpuTimes,
    /// Why it ended early.
    pub early_end: Option<EarlyEnd>,
}

/// Tracks all frames, records keyframes and grows the maps.
pub fn track(
    input: &Input,
    folder: &OutputFolder,
    settings: &RunSettings,
    interrupted: &AtomicBool,
) -> Result<Tracked, Failure> {
    let config = &settings.config;
    let slam = system(input, settings)?;
    let (width, height) = input.size();
    let camera = KeyframeCamera {
        pinhole: *input.pinhole(),
        width,
        height,
    };
    // one thread: mapping runs beside tracking, which uses the others
    let mapper = Mapper::new(config.mapping.clone(), camera, 1);
    let live = LiveMaps::new(mapper, z_up_from_camera_world()).map_err(Failure::input)?;
    let session = session_info(input, settings)?;
    let process_before = process_cpu();
    let stop = AtomicBool::new(false);
    thread::scope(|scope| {
        let (record_sender, record_changes) = sync_channel(CHANGES_AHEAD);
        let (map_sender, map_changes) = sync_channel(CHANGES_AHEAD);
        let is_recorded = !settings.is_localise_only();
        let recorder = scope.spawn(move || {
            // owned here, so that the channel closes if this thread fails
            let changes = record_changes;
            if is_recorded {
                recorder::record(&changes, folder, &session)
            } else {
                Ok(Duration::ZERO)
            }
        });
        let mapping = scope.spawn(move || grow_maps(&map_changes, live, &camera));
        let reader = Reader::start(scope, input, settings.realtime, &stop)
            .map_err(|error| Failure::running(format!("cannot start a thread: {error}")))?;
        let mut listeners = vec![record_sender, map_sender];
        if !is_recorded {
            // closes the channels, whose receivers then end
            listeners.clear();
        }
        let mut tracking = Tracking {
            slam,
            settings,
            rows: Vec::with_capacity(input.frames.len()),
            published: Vec::new(),
            published_poses: 0,
            listeners,
            progress: Progress::new(input.frames.len(), settings.show_progress),
        };
        // keyframes of an earlier session are new to the listeners
        tracking.publish();
        let early_end = tracking.process_all(&reader.frames, interrupted);
        stop.store(true, Ordering::Relaxed);
        let reading = reader.join();
        let ended = tracking.finish(&input.name);
        let recorded = recorder
            .join()
            .unwrap_or_else(|_| Err(Failure::running("the recorder failed")))?;
        let (live_maps, mapping) = mapping
            .join()
            .map_err(|_| Failure::running("the mapper failed"))?;
        let others = reading + recorded + mapping;
        Ok(Tracked {
            rows: ended.rows,
            trajectory: ended.trajectory,
            slam: ended.slam,
            snapshot: ended.snapshot,
            cpu: CpuTimes {
                slam: (process_cpu() - process_before).saturating_sub(others),
                mapping,
                reading,
                recording: recorded,
            },
            live_maps,
            early_end,
        })
    })
}

/// A new system, or one that goes on with the map of an earlier run.
fn system(input: &Input, settings: &RunSettings) -> Result<Slam, Failure> {
    let config = &settings.config;
    let (slam, mask) = (config.slam.clone(), input.mask().clone());
    let made = match &settings.continued {
        None => Slam::new(slam, *input.pinhole(), mask, config.seed),
        Some(Continued { earlier, purpose }) => Slam::continue_from(
            slam,
            *input.pinhole(),
            mask,
            config.seed,
            earlier.map.clone(),
            *purpose,
        ),
    };
    made.map_err(Failure::input)
}

fn session_info(input: &Input, settings: &RunSettings) -> Result<SessionInfo, Failure> {
    let (width, height) = input.size();
    Ok(SessionInfo {
        pinhole: *input.pinhole(),
        width,
        height,
        scale: match (&settings.seed_depth, settings.earlier()) {
            (Some(_), _) => monogrid_datasets::Scale::Metric,
            (None, Some(earlier)) => earlier.session.scale,
            (None, None) => monogrid_datasets::Scale::Arbitrary,
        },
        seed: settings.config.seed,
        profile: settings.config.profile.name().to_owned(),
        source: input.name.clone(),
        config: settings.config.to_toml()?,
    })
}

/// Integrates keyframes as they are finished, and lets the maps follow the graph while there is nothing
/// else to do; returns the maps and the CPU time used.
fn grow_maps(
    changes: &Receiver<Change>,
    mut maps: LiveMaps,
    camera: &KeyframeCamera,
) -> (Result<LiveMaps, MapError>, Duration) {
    give_way();
    let mut result = Ok(());
    let mut has_work = false;
    loop {
        let received = if has_work {
            changes.try_recv()
        } else {
            changes.recv().map_err(|_| TryRecvError::Disconnected)
        };
        match received {
            // what is left to be done is done for the final maps, on all threads
            Err(TryRecvError::Disconnected) => break,
            // after an error changes are still received, so that nobody waits for this thread
            _ if result.is_err() => has_work = false,
            Ok(change) => {
                result = take_change(&mut maps, &change, camera);
                has_work = true;
            }
            Err(TryRecvError::Empty) => match maps.step() {
                Ok(has_worked) => has_work = has_worked,
                Err(error) => result = Err(error),
            },
        }
    }
    (result.map(|()| maps), thread_cpu())
}

fn take_change(
    maps: &mut LiveMaps,
    change: &Change,
    camera: &KeyframeCamera,
) -> Result<(), MapError> {
    match change {
        Change::Finished(keyframe, snapshot) => {
            let scan = scan_of(keyframe, maps, camera);
            match snapshot.in_main_map(keyframe.id) {
                Some(pose) => maps.add(scan, *pose)?,
                None => maps.add_apart(scan),
            }
            maps.follow(Arc::clone(snapshot))
        }
        Change::Revised(keyframe) => {
            maps.revise(scan_of(keyframe, maps, camera));
            Ok(())
        }
        Change::Moved(snapshot) | Change::End(snapshot, ..) => maps.follow(Arc::clone(snapshot)),
    }
}

fn scan_of(keyframe: &Keyframe, maps: &LiveMaps, camera: &KeyframeCamera) -> KeyframeScan {
    let config = maps.mapper().config();
    KeyframeScan::new(
        keyframe.id,
        &keyframe.pixels,
        Some(&keyframe.image),
        camera,
        config,
    )
}

/// The thread that tracks.
struct Tracking<'a> {
    slam: Slam,
    settings: &'a RunSettings,
    rows: Vec<FrameRow>,
    /// Revision of the depth of each keyframe that the listeners know.
    published: Vec<u32>,
    /// Revision of the poses that the listeners know.
    published_poses: u64,
    /// Recorder and mapper; none when the map stays as it is.
    listeners: Vec<SyncSender<Change>>,
    progress: Progress,
}

impl Tracking<'_> {
    /// Takes frames until there are no more, the user stops, or the source is unreadable.
    fn process_all(
        &mut self,
        frames: &Receiver<Delivered>,
        interrupted: &AtomicBool,
    ) -> Option<EarlyEnd> {
        let mut unreadable_in_a_row = 0;
        for delivered in frames {
            if interrupted.load(Ordering::Relaxed) {
                return Some(EarlyEnd::Interrupted);
            }
            let row = match delivered {
                Delivered::Frame {
                    index,
                    timestamp_ns,
                    image,
                } => {
                    unreadable_in_a_row = 0;
                    self.process(index, timestamp_ns, image)
                }
                Delivered::Skipped {
                    index,
                    timestamp_ns,
                    reason,
                } => {
                    unreadable_in_a_row += 1;
                    self.progress
                        .warn(&format!("frame {index} skipped: {reason}"));
                    if unreadable_in_a_row >= MAX_UNREADABLE_IN_A_ROW {
                        self.rows.push(FrameRow {
                            index,
                            timestamp_ns,
                            fate: FrameFate::Skipped(reason.clone()),
                        });
                        return Some(EarlyEnd::Unreadable(reason));
                    }
                    FrameRow {
                        index,
                        timestamp_ns,
                        fate: FrameFate::Skipped(reason),
                    }
                }
                Delivered::Dropped {
                    index,
                    timestamp_ns,
                } => FrameRow {
                    index,
                    timestamp_ns,
                    fate: FrameFate::Dropped,
                },
            };
            self.progress.frame(&row, self.published.len());
            self.rows.push(row);
        }
        None
    }

    fn process(&mut self, index: usize, timestamp_ns: i64, image: GrayImage) -> FrameRow {
        let row = |fate| FrameRow {
            index,
            timestamp_ns,
            fate,
        };
        let seed_depth = match &self.settings.seed_depth {
            Some((seeded, _)) if index < *seeded => return row(FrameFate::BeforeSeed),
            Some((seeded, depth)) if index == *seeded => Some(depth.clone()),
            _ => None,
        };
        let report = self.slam.process_frame(FrameInput {
            index,
            timestamp_ns,
            image,
            seed_depth,
        });
        self.publish();
        row(FrameFate::Processed(Box::new(report)))
    }

    /// Tells the listeners about new keyframes, and new depth and poses of old ones.
    fn publish(&mut self) {
        let mut changes = Vec::new();
        for (position, keyframe) in self.slam.keyframes().iter().enumerate() {
            match self.published.get_mut(position) {
                Some(known) if *known == keyframe.revision => {}
                Some(known) => {
                    *known = keyframe.revision;
                    changes.push(Change::Revised(Arc::new(keyframe.clone())));
                }
                None => {
                    self.published.push(keyframe.revision);
                    let keyframe = Arc::new(keyframe.clone());
                    changes.push(Change::Finished(keyframe, self.slam.snapshot()));
                }
            }
        }
        let snapshot = self.slam.snapshot();
        if snapshot.revision != self.published_poses && !self.published.is_empty() {
            self.published_poses = snapshot.revision;
            if !changes.iter().any(|c| matches!(c, Change::Finished(..))) {
                changes.push(Change::Moved(snapshot));
            }
        }
        for change in changes {
            self.send(&change);
        }
    }

    /// A listener that has failed says so when it is joined.
    fn send(&self, change: &Change) {
        for listener in &self.listeners {
            let _ = listener.send(change.clone());
        }
    }

    /// Finishes the last keyframe and closes the channels.
    fn finish(mut self, source: &str) -> Ended {
        self.slam.finish();
        self.publish();
        let snapshot = self.slam.snapshot();
        let trajectory = self.slam.trajectory();
        let end = EndRecord {
            num_frames: self.rows.len() as u64,
            num_tracked: trajectory.len() as u64,
            summary: String::new(),
        };
        if !self.listeners.is_empty() {
            let continuation = continuation(&self.slam, self.settings.earlier(), source);
            let continuation = Arc::new(continuation);
            self.send(&Change::End(Arc::clone(&snapshot), continuation, end));
        }
        self.progress.finish();
        Ended {
            rows: self.rows,
            trajectory,
            slam: self.slam,
            snapshot,
        }
    }
}

/// What tracking leaves behind.
struct Ended {
    rows: Vec<FrameRow>,
    trajectory: Vec<TrajectoryPose>,
    slam: Slam,
    snapshot: Arc<PoseSnapshot>,
}

/// `map_from_camera` of a pose in the world: the scale of the frame applies to the position only.
pub fn in_map(
    map_from_world: &Sim3,
    world_from_camera: &monogrid_geometry::Se3,
) -> monogrid_geometry::Se3 {
    (*map_from_world * world_from_camera.with_scale(1.0)).to_se3()
}
