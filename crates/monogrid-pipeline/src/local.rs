//! A thread that maps what is around the camera, several times in a second.

use monogrid_geometry::Se3;
use monogrid_mapping::{KeyframeCamera, KeyframeScan, LocalMap, Mapper};
use monogrid_occupancy::{MapError, OccupancyMap};
use monogrid_slam::{KeyframeInUse, Slam};
use std::panic::resume_unwind;
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::{self, JoinHandle};

/// Time of the images between two maps at least, ns: 6 maps in a second of a camera of 30 Hz, 5 at
/// 10 Hz.
const EVERY_NS: i64 = 150_000_000;

/// The map around the camera at one moment, in the frame of odometry. It never changes.
#[derive(Clone, Debug)]
pub struct LocalView {
    /// Time of the newest image.
    pub timestamp_ns: i64,
    /// Where the camera was.
    pub local_from_camera: Se3,
    /// What is around it, with cells and radius as the settings have them.
    pub map: OccupancyMap,
}

/// Maps what is around the camera in a thread of its own, by odometry alone: no correction of the
/// graph moves it ([`LocalMap`]). It begins again where the way of the camera has a gap.
///
/// What a frame has found is offered to it after the frame; while it works, frames are passed over.
#[derive(Debug)]
pub struct LocalMapper {
    frames: SyncSender<Work>,
    thread: Option<JoinHandle<()>>,
    last_ns: Option<i64>,
}

/// What the thread is asked for.
struct Work {
    timestamp_ns: i64,
    local_from_camera: Se3,
    keyframe: KeyframeInUse,
}

impl LocalMapper {
    /// Begins; `shown` gets every map, or why there is none, in the thread of the maps.
    ///
    /// # Errors
    /// When the system has no more threads.
    pub fn start(
        mapper: Mapper,
        camera: KeyframeCamera,
        shown: impl FnMut(Result<LocalView, MapError>) + Send + 'static,
    ) -> std::io::Result<Self> {
        let (frames, received) = sync_channel(1);
        let builder = thread::Builder::new().name("local map".into());
        let thread = builder.spawn(move || map_around(&received, &mapper, &camera, shown))?;
        Ok(Self {
            frames,
            thread: Some(thread),
            last_ns: None,
        })
    }

    /// Whether an image of this time may have a map of its own.
    #[must_use]
    pub fn is_due(&self, timestamp_ns: i64) -> bool {
        let since = self.last_ns.map(|last| timestamp_ns - last);
        // also where time has jumped back
        since.is_none_or(|since| !(0..EVERY_NS).contains(&since))
    }

    /// Offers the newest frame, which is at `local_from_camera` by odometry, in units of the world.
    pub fn offer(&mut self, slam: &Slam, timestamp_ns: i64, local_from_camera: &Se3) {
        let keyframe = self.is_due(timestamp_ns).then(|| slam.keyframe_in_use());
        let Some(keyframe) = keyframe.flatten() else {
            return;
        };
        let work = Work {
            timestamp_ns,
            local_from_camera: *local_from_camera,
            keyframe,
        };
        match self.frames.try_send(work) {
            Ok(()) => self.last_ns = Some(timestamp_ns),
            Err(TrySendError::Full(_)) => {}
            Err(TrySendError::Disconnected(_)) => self.end(),
        }
    }

    /// Its panic, if it has panicked, goes on here.
    fn end(&mut self) {
        if let Some(Err(panic)) = self.thread.take().map(JoinHandle::join) {
            resume_unwind(panic);
        }
    }
}

fn map_around(
    frames: &Receiver<Work>,
    mapper: &Mapper,
    camera: &KeyframeCamera,
    mut shown: impl FnMut(Result<LocalView, MapError>),
) {
    let mut local: Option<(usize, LocalMap)> = None;
    for work in frames {
        let view = view_of(&mut local, work, mapper, camera);
        if view.is_err() {
            local = None;
        }
        shown(view);
    }
}

fn view_of(
    local: &mut Option<(usize, LocalMap)>,
    work: Work,
    mapper: &Mapper,
    camera: &KeyframeCamera,
) -> Result<LocalView, MapError> {
    let (keyframe, local_from_camera) = (work.keyframe, work.local_from_camera);
    // before a gap everything lay elsewhere
    let known = local.take().filter(|(gaps, _)| *gaps == keyframe.num_gaps);
    let mut map = match known {
        Some((_, map)) => map,
        None => LocalMap::new(mapper.clone())?,
    };
    let pixels = &keyframe.pixels;
    let scan = KeyframeScan::new(keyframe.id, pixels, None, camera, mapper.config());
    let local_from_keyframe = local_from_camera.with_scale(1.0) * keyframe.camera_from_keyframe;
    let around = map.take(scan, local_from_keyframe, local_from_camera.translation)?;
    *local = Some((keyframe.num_gaps, map));
    Ok(LocalView {
        timestamp_ns: work.timestamp_ns,
        local_from_camera,
        map: around,
    })
}
