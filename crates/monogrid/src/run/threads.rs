//! The threads of a run and the channels between them.

use super::RunSettings;
use super::frames::FrameRow;
use super::reader::Reader;
use super::sessions::Continued;
use super::tracking::{EarlyEnd, Tracking};
use super::{mapper, recorder};
use crate::failure::Failure;
use crate::input::Input;
use crate::output::OutputFolder;
use crate::usage::process_cpu;
use monogrid_datasets::SessionInfo;
use monogrid_occupancy::MapError;
use monogrid_slam::mapping::{KeyframeCamera, LiveMaps, Mapper, z_up_from_camera_world};
use monogrid_slam::{PoseSnapshot, Slam, TrajectoryPose};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::sync_channel;
use std::thread;
use std::time::Duration;

/// Changes that may wait for the recorder or the mapper before tracking waits for them.
const CHANGES_AHEAD: usize = 4;

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

/// Everything that a run found, but for its maps.
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
    /// CPU time.
    pub cpu: CpuTimes,
    /// Why it ended early.
    pub early_end: Option<EarlyEnd>,
}

/// Maps as they grew, or why they could not.
pub type GrownMaps = Result<LiveMaps, MapError>;

/// Tracks all frames, records keyframes and grows the maps.
pub fn track(
    input: &Input,
    folder: &OutputFolder,
    settings: &RunSettings,
    interrupted: &AtomicBool,
) -> Result<(Tracked, GrownMaps), Failure> {
    let slam = system(input, settings)?;
    let (width, height) = input.size();
    let camera = KeyframeCamera {
        pinhole: *input.pinhole(),
        width,
        height,
    };
    // one thread: mapping runs beside tracking, which uses the others
    let mapper = Mapper::new(settings.config.mapping.clone(), camera, 1);
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
        let mapping = scope.spawn(move || mapper::grow_maps(&map_changes, live, &camera));
        let reader = Reader::start(scope, input, settings.realtime, &stop)
            .map_err(|error| Failure::running(format!("cannot start a thread: {error}")))?;
        let mut listeners = vec![record_sender, map_sender];
        if !is_recorded {
            // closes the channels, whose receivers then end
            listeners.clear();
        }
        let mut tracking = Tracking::begin(slam, settings, input.frames.len(), listeners);
        let early_end = tracking.process_all(&reader.frames, interrupted);
        stop.store(true, Ordering::Relaxed);
        let reading = reader.join();
        let ended = tracking.finish(&input.name);
        let recording = recorder
            .join()
            .unwrap_or_else(|_| Err(Failure::running("the recorder failed")))?;
        let (maps, mapping) = mapping
            .join()
            .map_err(|_| Failure::running("the mapper failed"))?;
        let others = reading + recording + mapping;
        let tracked = Tracked {
            rows: ended.rows,
            trajectory: ended.trajectory,
            slam: ended.slam,
            snapshot: ended.snapshot,
            cpu: CpuTimes {
                slam: (process_cpu() - process_before).saturating_sub(others),
                mapping,
                reading,
                recording,
            },
            early_end,
        };
        Ok((tracked, maps))
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
