//! `run --view`: the run in the browser while it goes on.
//!
//! The run puts what it knows into [`Live`], which only holds references to what exists anyway;
//! everything that costs time, such as packing points or pictures, is done on the thread of the
//! server, when a browser asks; the map grows only while a browser looks at its cells. So a slow or
//! absent viewer costs nothing, and nothing waits for one before all results are written.

mod answers;

mod rerun;

pub use rerun::View;

use crate::process::failure::Failure;
use crate::run::tracking::frames::FrameRow;
use answers::Shown;
use monogrid_geometry::{Pinhole, Se3, Sim3};
use monogrid_image::GrayImage;
use monogrid_mapping::{LiveView, MapReader, z_up_from_camera_world};
use monogrid_occupancy::MapError;
use monogrid_pipeline::{Event, Listener, ListenerError, LocalMapper, LocalView, Pipeline};
use monogrid_report::Page;
use monogrid_report::explorer::{Answer, LIVE_POLICY, PathPoint, Server, Serving, live_section};
use monogrid_slam::{FrameReport, KeptKeyframe, KeyframeId, PoseSnapshot};
use rerun::Rerun;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Receiver;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Images are kept for a browser only while one asks, and so often at most.
const IMAGE_EVERY: Duration = Duration::from_millis(150);
const ASKED_WITHIN: Duration = Duration::from_secs(2);

/// What is known of a run that goes on.
#[derive(Clone, Debug, Default)]
struct Known {
    /// Grows with every change of keyframes and poses.
    version: u64,
    frame: Option<SeenFrame>,
    num_frames: usize,
    path: Vec<PathPoint>,
    /// Keyframes, and the version in which their depth was changed last.
    keyframes: BTreeMap<KeyframeId, (u64, KeptKeyframe)>,
    poses: Arc<PoseSnapshot>,
    /// Version in which poses changed last.
    posed: u64,
    /// Keyframes in colour, as JPEG, of a source that has some.
    colours: BTreeMap<KeyframeId, Arc<Vec<u8>>>,
}

/// The newest frame.
#[derive(Clone, Debug)]
struct SeenFrame {
    index: usize,
    state: &'static str,
    reason: Option<String>,
    map_from_camera: Option<Sim3>,
    /// Where odometry begins in the map.
    map_from_local: Option<Sim3>,
    image: Option<Arc<GrayImage>>,
}

/// The cells that a browser asks for, as bits: 1 those of the global map, 2 of the large one, 4
/// what is around the camera.
#[derive(Clone, Copy, Debug, Default)]
struct Wanted {
    global: bool,
    large: bool,
    local: bool,
}

impl Wanted {
    fn parse(text: &str) -> Option<Self> {
        let bits = text.parse::<u8>().ok().filter(|bits| *bits < 8)?;
        Some(Self {
            global: bits & 1 != 0,
            large: bits & 2 != 0,
            local: bits & 4 != 0,
        })
    }
}

/// When a browser asked last.
#[derive(Clone, Copy, Debug, Default)]
struct Asked {
    /// For anything.
    news: Option<Instant>,
    /// For cells of the global map or the large one.
    cells: Option<Instant>,
    /// For what is around the camera.
    local: Option<Instant>,
}

/// The map that grows, which costs time as long as somebody holds it.
#[derive(Debug, Default)]
enum Map {
    /// Nobody looks at cells.
    #[default]
    Closed,
    /// It was asked for.
    Coming(Receiver<Result<MapReader, MapError>>),
    Open(MapReader),
}

/// What a run and its viewers share.
#[derive(Debug)]
pub struct Live {
    known: Mutex<Known>,
    asked: Mutex<Asked>,
    map: Mutex<Map>,
    /// The newest map around the camera, while a browser looks at it.
    local: Mutex<Option<Arc<LocalView>>>,
    begin: Instant,
    total: usize,
    /// Whether there are no more frames.
    has_ended: AtomicBool,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn is_recent(asked: Option<Instant>) -> bool {
    asked.is_some_and(|asked| asked.elapsed() < ASKED_WITHIN)
}

impl Live {
    /// Before the first frame; `total` is 0 where the number of frames is not known.
    fn new(total: usize) -> Self {
        Self {
            known: Mutex::default(),
            asked: Mutex::default(),
            map: Mutex::default(),
            local: Mutex::default(),
            begin: Instant::now(),
            total,
            has_ended: AtomicBool::new(false),
        }
    }

    /// Notes that a browser asks, and for which cells.
    fn note_question(&self, wanted: Wanted) {
        let now = Some(Instant::now());
        let mut asked = lock(&self.asked);
        asked.news = now;
        if wanted.global || wanted.large {
            asked.cells = now;
        }
        if wanted.local {
            asked.local = now;
        }
    }

    /// Whether a browser looks at what is around the camera.
    fn is_local_wanted(&self) -> bool {
        is_recent(lock(&self.asked).local)
    }

    /// The map, where it is open.
    fn latest_map(&self) -> Option<Arc<LiveView>> {
        match &*lock(&self.map) {
            Map::Open(reader) => reader.latest(),
            _ => None,
        }
    }

    /// Has the map grow as long as a browser looks at cells; never waits for it.
    fn follow_map(&self, open: impl FnOnce() -> Receiver<Result<MapReader, MapError>>) {
        let is_wanted = is_recent(lock(&self.asked).cells);
        let mut map = lock(&self.map);
        let next = match &*map {
            Map::Closed if is_wanted => Map::Coming(open()),
            Map::Coming(reader) => match reader.try_recv() {
                Ok(Ok(reader)) => Map::Open(reader),
                // a map that cannot grow is said at the end of the run
                Ok(Err(_)) | Err(_) => return,
            },
            Map::Open(_) if !is_wanted => Map::Closed,
            _ => return,
        };
        *map = next;
    }

    /// Takes what became of a frame.
    fn take(&self, row: &FrameRow, image: Option<Arc<GrayImage>>) {
        let z_up = z_up_from_camera_world();
        let report = row.report();
        let pose = report.and_then(|report| report.world_from_camera);
        let map_from_camera = pose.map(|pose: Se3| z_up * pose.with_scale(1.0));
        let correction = report.and_then(FrameReport::map_from_odom);
        let map_from_local = correction.map(|pose| z_up * pose.with_scale(1.0) * z_up.inverse());
        let mut known = lock(&self.known);
        known.num_frames += 1;
        if let Some(pose) = map_from_camera {
            let [x, y, z] = [0, 1, 2].map(|axis| pose.translation[axis] as f32);
            known.path.push((row.index, x, y, z));
        }
        let before = known.frame.take();
        known.frame = Some(SeenFrame {
            index: row.index,
            state: report.map_or("no image", |report| report.state.name()),
            reason: report.and_then(|report| Some(report.reason?.to_string())),
            map_from_camera,
            map_from_local,
            image: image.or_else(|| before?.image),
        });
    }

    /// Takes a change of the map of keyframes.
    fn hear(&self, event: &Event) {
        let mut known = lock(&self.known);
        match event {
            Event::Finished(keyframe, poses) => {
                known.change_depth(keyframe);
                known.change_poses(poses);
            }
            Event::Revised(keyframe) => known.change_depth(keyframe),
            Event::Moved(poses) => known.change_poses(poses),
            _ => {}
        }
    }
}

impl Known {
    fn change_depth(&mut self, keyframe: &KeptKeyframe) {
        self.version += 1;
        let changed = (self.version, keyframe.clone());
        self.keyframes.insert(keyframe.id, changed);
    }

    fn change_poses(&mut self, poses: &Arc<PoseSnapshot>) {
        self.version += 1;
        self.posed = self.version;
        self.poses = Arc::clone(poses);
    }
}

/// The ear of a viewer among the listeners of the pipeline.
#[derive(Clone, Debug)]
pub struct Ear(Arc<Live>);

impl Ear {
    /// Takes the colour of a keyframe, JPEG, which may come after it was shown in grey.
    pub fn colour(&self, id: KeyframeId, jpeg: &[u8]) {
        let mut known = lock(&self.0.known);
        known.colours.insert(id, Arc::new(jpeg.to_vec()));
        if let Some((_, keyframe)) = known.keyframes.get(&id).cloned() {
            known.change_depth(&keyframe);
        }
    }
}

impl Listener for Ear {
    fn hear(&mut self, event: &Event) -> Result<(), ListenerError> {
        self.0.hear(event);
        Ok(())
    }
}

/// The server of a run, which ends with this.
#[derive(Debug)]
pub struct Viewer {
    live: Arc<Live>,
    serving: Option<Serving>,
    rerun: Option<Rerun>,
    /// When there were no more frames.
    ended: Option<Instant>,
    last_image: Option<Instant>,
    /// While a browser looks at what is around the camera.
    local: Option<LocalMapper>,
}

impl Viewer {
    /// Begins to listen, and says where, or shows it to the program that was asked for.
    pub fn start(
        view: &View,
        title: &str,
        camera: (&Pinhole, [usize; 2]),
        total: usize,
    ) -> Result<Self, Failure> {
        let server = match view {
            View::Browser(address) => Server::listen_at(*address)?,
            View::Rerun(_) => Server::listen(0)?,
        };
        let url = server.url();
        let live = Arc::new(Live::new(total));
        let mut page = Page::default();
        page.html(&live_section()?);
        let page = page.finish_with(title, "This run goes on.", LIVE_POLICY);
        let page = Answer::page(page, LIVE_POLICY);
        let shown = Shown::new(Arc::clone(&live), camera);
        let serving = server.start(move |path| match path {
            "/" => Some(page.clone()),
            path => shown.answer(path),
        })?;
        let mut viewer = Self {
            live,
            serving: Some(serving),
            rerun: None,
            ended: None,
            last_image: None,
            local: None,
        };
        match view {
            View::Browser(address) if address.ip().is_loopback() => {
                eprintln!("{url} shows the run in a browser of this computer");
            }
            View::Browser(_) => eprintln!("{url} shows the run to all who know this address"),
            View::Rerun(file) => viewer.rerun = Some(Rerun::start(&url, file.as_deref())?),
        }
        Ok(viewer)
    }

    /// What hears of keyframes for it.
    pub fn ear(&self) -> Ear {
        Ear(Arc::clone(&self.live))
    }

    /// A copy of an image, if a browser wants to see one now.
    pub fn wanted(&mut self, image: &GrayImage) -> Option<Arc<GrayImage>> {
        let last = self.last_image;
        let is_due = last.is_none_or(|last| last.elapsed() >= IMAGE_EVERY);
        if !is_due || !is_recent(lock(&self.live.asked).news) {
            return None;
        }
        self.last_image = Some(Instant::now());
        Some(Arc::new(image.clone()))
    }

    /// Shows what became of a frame.
    pub fn show(&mut self, row: &FrameRow, image: Option<Arc<GrayImage>>, pipeline: &Pipeline) {
        self.live.take(row, image);
        self.live.follow_map(|| pipeline.live_map_later());
        self.map_around(row, pipeline);
    }

    /// Has what is around the camera mapped as long as a browser looks at it.
    fn map_around(&mut self, row: &FrameRow, pipeline: &Pipeline) {
        if !self.live.is_local_wanted() {
            self.local = None;
            return;
        }
        let slam = pipeline.slam();
        if self.local.is_none() {
            let live = Arc::clone(&self.live);
            // a map that is too large is not shown
            let shown = move |view: Result<LocalView, MapError>| {
                *lock(&live.local) = view.ok().map(Arc::new);
            };
            // without a thread for it there is none
            self.local = LocalMapper::start(pipeline.mapper().clone(), slam.camera(), shown).ok();
        }
        let odom_from_camera = row.report().and_then(|report| report.odom_from_camera);
        if let (Some(local), Some(odom_from_camera)) = (&mut self.local, odom_from_camera) {
            let local_from_camera = z_up_from_camera_world().to_se3() * odom_from_camera;
            local.offer(slam, row.timestamp_ns, &local_from_camera);
        }
    }

    /// Tells those who ask that there are no more frames; they take the last news while results are
    /// made.
    pub fn note_end(&mut self) {
        self.live.has_ended.store(true, Ordering::Relaxed);
        self.ended.get_or_insert_with(Instant::now);
        // the final maps need its memory
        *lock(&self.live.map) = Map::Closed;
        self.local = None;
    }

    /// Ends the server, after everything is written, and within a time whatever viewers do.
    ///
    /// # Errors
    /// A panic in one of its threads, in a sentence.
    pub fn end(mut self) -> Result<(), &'static str> {
        self.close()
    }

    fn close(&mut self) -> Result<(), &'static str> {
        self.note_end();
        if let (Some(rerun), Some(ended)) = (self.rerun.take(), self.ended) {
            rerun.end(ended);
        }
        self.serving.take().map_or(Ok(()), Serving::end)
    }
}

impl Drop for Viewer {
    fn drop(&mut self) {
        // a run that failed says why itself
        let _ = self.close();
    }
}
