//! What is saved where an interrupt comes while the end of a run takes its time.
//!
//! After the last frame everything is adjusted once more, depth is made dense and maps are built:
//! work that knows no interrupts and takes minutes where the map is large. What is known before it
//! is kept here. When somebody has interrupted and the run has not ended by itself soon after, that
//! is written, and the process ends.

use crate::output::OutputFolder;
use crate::process::failure::{Classify, Failure, Outcome};
use crate::process::interrupt::is_interrupted;
use crate::process::usage::process_cpu;
use crate::run::RunSettings;
use crate::run::align::in_map;
use crate::run::summary::Status;
use monogrid_datasets::{TimedPose, format_sim3, format_tum};
use monogrid_mapping::{
    KeyframeCamera, KeyframeScan, Mapper, MappingConfig, z_up_from_camera_world,
};
use monogrid_occupancy::{MapError, MapFormat, OccupancyMap};
use monogrid_slam::{KeptKeyframe, PoseSnapshot, Slam, TrajectoryPose};
use serde::Serialize;
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// How long the end of an interrupted run may take, on the clock and of the processor: on a busy
/// computer nothing is given up that only waits for its turn.
const GRACE: Duration = Duration::from_millis(1200);

/// After this it is given up whatever it waits for.
const LONGEST_GRACE: Duration = Duration::from_secs(10);

/// How long the map that is saved instead may take.
const MAP_TIME: Duration = Duration::from_millis(500);

/// Time between looks at whether there was an interrupt.
const LOOK_EVERY: Duration = Duration::from_millis(50);

/// What is known after the last frame.
struct Kept {
    num_frames: usize,
    trajectory: Vec<TrajectoryPose>,
    keyframes: Vec<KeptKeyframe>,
    poses: Arc<PoseSnapshot>,
    camera: KeyframeCamera,
}

/// Whoever saves holds it locked.
type Shared = Arc<Mutex<Option<Kept>>>;

/// Watches the end of a run; dropped when everything is written.
#[derive(Debug)]
pub struct Salvage {
    kept: Shared,
    /// Closed in the end.
    _running: Sender<()>,
}

impl std::fmt::Debug for Kept {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.debug_struct("Kept").finish_non_exhaustive()
    }
}

impl Salvage {
    /// Begins to watch a run that writes into this folder.
    pub fn watch(
        source: &str,
        folder: &Arc<OutputFolder>,
        settings: &RunSettings,
    ) -> Result<Self, Failure> {
        let kept = Shared::default();
        let (running, ended) = channel();
        let writer = Writer {
            source: source.to_owned(),
            folder: Arc::clone(folder),
            mapping: (!settings.is_localise_only()).then(|| settings.config.mapping.clone()),
        };
        let shared = Arc::clone(&kept);
        let watch = move || {
            let mut interrupted = None;
            while ended.recv_timeout(LOOK_EVERY) == Err(RecvTimeoutError::Timeout) {
                if is_interrupted() {
                    let (since, cpu) = *interrupted.get_or_insert((Instant::now(), process_cpu()));
                    let used = process_cpu().saturating_sub(cpu);
                    if is_over(since.elapsed(), used) {
                        writer.write_instead(&shared);
                    }
                }
            }
        };
        let thread = thread::Builder::new().name("salvage".to_owned());
        thread
            .spawn(watch)
            .while_running("no thread can be started")?;
        Ok(Self {
            kept,
            _running: running,
        })
    }

    /// Keeps what is known after so many frames.
    pub fn keep(&self, slam: &Slam, size: (usize, usize), num_frames: usize) {
        let kept = Kept {
            num_frames,
            trajectory: slam.whole_trajectory(),
            keyframes: slam.keyframes(),
            poses: slam.snapshot(),
            camera: KeyframeCamera::new(*slam.pinhole(), size),
        };
        *self.kept.lock().unwrap_or_else(PoisonError::into_inner) = Some(kept);
    }
}

impl Drop for Salvage {
    fn drop(&mut self) {
        // waits for ever where it is being written, which ends with the process
        *self.kept.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }
}

/// Whether the end of an interrupted run has taken too long.
fn is_over(elapsed: Duration, used: Duration) -> bool {
    elapsed >= GRACE && used >= GRACE || elapsed >= LONGEST_GRACE
}

/// A summary of little.
#[derive(Serialize)]
struct Short<'a> {
    source: &'a str,
    version: &'static str,
    status: Status,
    frames: usize,
    tracked: usize,
    keyframes: usize,
    warnings: [String; 1],
}

struct Writer {
    source: String,
    folder: Arc<OutputFolder>,
    /// `None` where the map is that of an earlier run.
    mapping: Option<MappingConfig>,
}

impl Writer {
    /// Writes what is kept and ends the process; does nothing while tracking goes on, which ends by
    /// itself.
    fn write_instead(&self, shared: &Shared) {
        let kept = shared.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(kept) = kept.as_ref() else {
            return;
        };
        let code = match self.write(kept) {
            Ok(said) => {
                eprintln!("{said}");
                Outcome::Interrupted.code()
            }
            Err(failure) => failure.report(),
        };
        std::process::exit(code.into());
    }

    /// Writes everything; what to say of it.
    fn write(&self, kept: &Kept) -> Result<String, Failure> {
        let folder = &self.folder;
        let map_from_world = z_up_from_camera_world();
        let timed = |pose: &TrajectoryPose| TimedPose {
            timestamp_ns: pose.timestamp_ns,
            world_from_camera: in_map(&map_from_world, &pose.world_from_camera),
        };
        let trajectory: Vec<TimedPose> = kept.trajectory.iter().map(timed).collect();
        folder.write("trajectory.txt", format_tum(&trajectory))?;
        folder.write("map_from_world.txt", format_sim3(&map_from_world))?;
        let path = folder.path().display();
        let again =
            format!("`monogrid map {path} --out MAP.ot` makes one of all that was recorded");
        let mapped = match self.map(kept).while_running("the map cannot be made")? {
            Some(map) => {
                folder.write_with("global.ot", |mut out| {
                    Ok(MapFormat::Ot.write(&map, &mut out)?)
                })?;
                format!("trajectory.txt and global.ot are saved in {path}, as they were; {again}")
            }
            None if self.mapping.is_none() => {
                format!("trajectory.txt is saved in {path}, as it was")
            }
            None => {
                format!("trajectory.txt is saved in {path}, as it was; there is no map: {again}")
            }
        };
        let said = format!(
            "interrupted before everything was adjusted and depth was made dense: {mapped}"
        );
        let summary = Short {
            source: &self.source,
            version: env!("CARGO_PKG_VERSION"),
            status: Status::Interrupted,
            frames: kept.num_frames,
            tracked: kept.trajectory.len(),
            keyframes: kept.keyframes.len(),
            warnings: [said.clone()],
        };
        let json = serde_json::to_string_pretty(&summary).map_err(Failure::running)?;
        folder.write("summary.json", json + "\n")?;
        Ok(said)
    }

    /// The map of the depth that the filter has left; `None` where that takes too long, or nothing
    /// is to be mapped.
    fn map(&self, kept: &Kept) -> Result<Option<OccupancyMap>, MapError> {
        let Some(config) = self.mapping.clone().filter(|_| !kept.keyframes.is_empty()) else {
            return Ok(None);
        };
        // the others are busy with what nobody waits for any more
        let mapper = Mapper::new(config, 1);
        let begin = Instant::now();
        let mut map = mapper.empty_map()?;
        for keyframe in &kept.keyframes {
            let Some(pose) = kept.poses.in_main_map(keyframe.id) else {
                continue;
            };
            let Some(pixels) = keyframe.pixels().filter(|_| begin.elapsed() < MAP_TIME) else {
                return Ok(None);
            };
            let scan = KeyframeScan::new(keyframe.id, &pixels, None, &kept.camera, mapper.config());
            mapper.integrate(&mut map, &scan, &(z_up_from_camera_world() * *pose))?;
        }
        Ok(Some(map))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_end_of_a_run_has_a_second_of_the_clock_and_of_the_processor() {
        let over = |elapsed: f64, used: f64| {
            is_over(
                Duration::from_secs_f64(elapsed),
                Duration::from_secs_f64(used),
            )
        };
        assert!(over(1.25, 1.25));
        assert!(!over(1.0, 2.0), "several threads");
        assert!(!over(5.0, 1.0), "a computer that does something else");
        assert!(over(10.0, 0.0), "something that hangs");
    }
}
