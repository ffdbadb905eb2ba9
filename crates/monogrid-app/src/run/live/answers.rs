//! What the browser is told when it asks.

use super::{Known, Live, SeenFrame, Wanted, lock};
use monogrid_geometry::{Pinhole, Sim3};
use monogrid_mapping::{ImageOf, KeyframeCamera, z_up_from_camera_world};
use monogrid_report::colours::Colours;
use monogrid_report::explorer::{
    Answer, Camera, Cells, Cloud, CloudPoint, Keyframe, Look, PathPoint, SemiDense, picture,
    small_jpeg,
};
use monogrid_report::picture::base64;
use monogrid_slam::{DepthPixel, KeptKeyframe, Keyframe as SlamKeyframe, fault};
use serde::Serialize;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Points of a keyframe at most.
const MAX_POINTS: usize = 5_000;
/// Depths that are less certain are not shown.
const MAX_RELATIVE_SIGMA: f32 = 0.05;
/// Keyframes in one answer at most; the browser asks again.
const MAX_KEYFRAMES: usize = 12;
/// Time between cells: all of them are sent again.
const CELLS_EVERY: Duration = Duration::from_secs(3);

/// One answer.
#[derive(Serialize)]
struct News {
    /// What to ask from next.
    version: u64,
    /// Whether there are no more frames.
    ended: bool,
    /// Frames until now, and of how many; 0 where that is not known.
    frames: [usize; 2],
    /// Frames per second since the start.
    rate: f64,
    camera: Camera,
    frame: Option<FrameNews>,
    /// Positions of the camera, from the one that was asked for.
    path: Vec<PathPoint>,
    keyframes: Vec<KeyframeNews>,
    /// Poses of all keyframes: identity, unit, and the rows of the pose. Nothing if none has
    /// changed.
    poses: Vec<(u32, f64, [f64; 12])>,
    cells: Option<Cells>,
    /// Cells of the map that has the poses of the time.
    large: Option<Cells>,
    /// What is around the camera by odometry.
    local: Option<LocalNews>,
}

/// The map around the camera.
#[derive(Serialize)]
struct LocalNews {
    cells: Cells,
    /// Where odometry begins in the map, by the newest frame.
    pose: Option<[f64; 12]>,
}

#[derive(Serialize)]
struct FrameNews {
    index: usize,
    state: &'static str,
    reason: Option<String>,
    pose: Option<[f64; 12]>,
    /// JPEG in base64.
    image: Option<String>,
}

/// A keyframe whose depth is new.
#[derive(Serialize)]
struct KeyframeNews {
    id: u32,
    frame: usize,
    image: String,
    /// In the frame and the unit of the keyframe.
    cloud: Cloud,
}

/// What is shown.
pub struct Shown {
    live: Arc<Live>,
    pinhole: Pinhole,
    camera: Camera,
    /// When cells of the global and of the large map were sent last.
    cells_sent: Mutex<[Option<Instant>; 2]>,
    /// Time of the image of the local map that was sent last, ns.
    local_sent: Mutex<Option<i64>>,
}

impl Shown {
    /// Of a run with this camera (pinhole, width and height).
    pub fn new(live: Arc<Live>, camera: (&Pinhole, [usize; 2])) -> Self {
        Self {
            live,
            pinhole: *camera.0,
            camera: Camera::new(camera.0, camera.1),
            cells_sent: Mutex::default(),
            local_sent: Mutex::default(),
        }
    }

    /// The answer to `/live/VERSION/PATH/CELLS`: what has changed since a version, the path from a
    /// position on, and the cells that CELLS asks for ([`Wanted`]).
    pub fn answer(&self, path: &str) -> Option<Answer> {
        let (since, rest) = path.strip_prefix("/live/")?.split_once('/')?;
        let (from, cells) = rest.split_once('/')?;
        let (since, from): (u64, usize) = (since.parse().ok()?, from.parse().ok()?);
        let wanted = Wanted::parse(cells)?;
        self.live.note_question(wanted);
        fault::pass("viewer");
        // before what is known is taken: what is told is then all
        let has_ended = self.live.has_ended.load(Ordering::Relaxed);
        // references are taken while it is locked, work is done afterwards
        let known = lock(&self.live.known).clone();
        let mut news = self.news(&known, (since, from), has_ended);
        news.cells = wanted.global.then(|| self.cells(0)).flatten();
        news.large = wanted.large.then(|| self.cells(1)).flatten();
        news.local = wanted.local.then(|| self.local(&known)).flatten();
        let json = serde_json::to_vec(&news).ok()?;
        Some(Answer::json(json))
    }

    fn news(&self, known: &Known, (since, from): (u64, usize), has_ended: bool) -> News {
        let all = known.keyframes.values();
        let mut changed: Vec<_> = all.filter(|(version, _)| *version > since).collect();
        changed.sort_by_key(|(version, _)| *version);
        let is_all = changed.len() <= MAX_KEYFRAMES;
        changed.truncate(MAX_KEYFRAMES);
        let last = changed
            .last()
            .map_or(known.version, |(version, _)| *version);
        let seconds = self.live.begin.elapsed().as_secs_f64();
        let news = |(_, keyframe): &&(u64, KeptKeyframe)| {
            let colour = known.colours.get(&keyframe.id);
            Some(self.keyframe(&keyframe.load()?, colour.map(|jpeg| jpeg.as_slice())))
        };
        News {
            version: if is_all { known.version } else { last },
            ended: is_all && has_ended,
            frames: [known.num_frames, self.live.total],
            rate: known.num_frames as f64 / seconds.max(1e-3),
            camera: self.camera,
            frame: known.frame.as_ref().map(frame),
            path: known.path.get(from..).unwrap_or_default().to_vec(),
            keyframes: changed.iter().filter_map(news).collect(),
            poses: match known.posed > since {
                true => poses(known),
                false => Vec::new(),
            },
            cells: None,
            large: None,
            local: None,
        }
    }

    fn keyframe(&self, keyframe: &SlamKeyframe, colour: Option<&[u8]>) -> KeyframeNews {
        let is_certain = |p: &&DepthPixel| p.idepth_var.sqrt() <= MAX_RELATIVE_SIGMA * p.idepth;
        let certain: Vec<DepthPixel> = keyframe.pixels.iter().filter(is_certain).copied().collect();
        let every = certain.len().div_ceil(MAX_POINTS).max(1);
        let camera = KeyframeCamera::new(self.pinhole, keyframe.size());
        let semi_dense = SemiDense::recorded(keyframe.id, camera, &certain);
        let at_rest = Sim3::identity();
        let colours = colour.map(|jpeg| (keyframe.id, jpeg.to_vec()));
        let colours: Colours = colours.into_iter().collect();
        let look = Look::of(keyframe.id, Some(ImageOf::Held(&keyframe.image)), &colours);
        let image = picture(&look).unwrap_or_default();
        let points = semi_dense.points(look, &self.pinhole, &at_rest);
        let points: Vec<CloudPoint> = points.step_by(every).collect();
        KeyframeNews {
            id: keyframe.id,
            frame: keyframe.frame_index,
            image,
            cloud: Cloud::new(&[points], certain.len()).0,
        }
    }

    /// The cells of the global map (0) or the large one (1), now and then.
    fn cells(&self, which: usize) -> Option<Cells> {
        let mut sent = lock(&self.cells_sent);
        if sent[which].is_some_and(|sent| sent.elapsed() < CELLS_EVERY) {
            return None;
        }
        let view = self.live.latest_map()?;
        let cells = Cells::new([&view.global, &view.large][which], None).ok();
        sent[which] = Some(Instant::now());
        cells
    }

    /// The map around the camera, where there is a newer one than was sent.
    fn local(&self, known: &Known) -> Option<LocalNews> {
        let view = lock(&self.live.local).clone()?;
        let mut sent = lock(&self.local_sent);
        if *sent == Some(view.timestamp_ns) {
            return None;
        }
        *sent = Some(view.timestamp_ns);
        let pose = known.frame.as_ref()?.map_from_local;
        Some(LocalNews {
            cells: Cells::new(&view.map, None).ok()?,
            pose: pose.as_ref().map(Keyframe::rows),
        })
    }
}

fn frame(frame: &SeenFrame) -> FrameNews {
    FrameNews {
        index: frame.index,
        state: frame.state,
        reason: frame.reason.clone(),
        pose: frame.map_from_camera.as_ref().map(Keyframe::rows),
        image: frame.image.as_ref().map(|image| {
            let image = image.map(|grey| grey.clamp(0.0, 255.0) as u8);
            base64(&small_jpeg(&image))
        }),
    }
}

/// Poses of the keyframes of the main map.
fn poses(known: &Known) -> Vec<(u32, f64, [f64; 12])> {
    let z_up = z_up_from_camera_world();
    let pose = |id: &u32| {
        let pose = z_up * *known.poses.in_main_map(*id)?;
        Some((*id, pose.scale, Keyframe::rows(&pose)))
    };
    known.keyframes.keys().filter_map(pose).collect()
}

#[cfg(test)]
mod tests {
    use super::super::{Map, is_recent};
    use super::*;
    use monogrid_image::Image;
    use monogrid_mapping::MapReader;
    use monogrid_pipeline::Event;
    use monogrid_slam::{KeptKeyframe, PoseSnapshot};
    use serde_json::Value;
    use std::sync::mpsc::sync_channel;

    fn keyframe(id: u32) -> KeptKeyframe {
        let pixel = |x| DepthPixel {
            x,
            y: 1,
            idepth: 0.5,
            idepth_var: if x == 0 { 1.0 } else { 1e-6 },
        };
        KeptKeyframe::from(SlamKeyframe {
            id,
            frame_index: 10 * id as usize,
            timestamp_ns: 0,
            revision: 0,
            image: Image::filled(8, 4, 100u8),
            pixels: (0..5).map(pixel).collect(),
        })
    }

    fn poses_of(count: usize) -> Arc<PoseSnapshot> {
        Arc::new(PoseSnapshot {
            world_from_keyframe: vec![Sim3::identity(); count],
            ..PoseSnapshot::default()
        })
    }

    fn shown() -> Shown {
        let pinhole = Pinhole::new(4.0, 4.0, 3.5, 1.5);
        let live = Arc::new(Live::new(9));
        Shown::new(live, (&pinhole, [8, 4]))
    }

    fn ask(shown: &Shown, path: &str) -> Value {
        serde_json::from_slice(shown.answer(path).unwrap().content()).unwrap()
    }

    #[test]
    fn only_what_has_changed_is_told() {
        let shown = shown();
        assert!(!is_recent(lock(&shown.live.asked).news));
        for id in 0..2 {
            let poses = poses_of(id as usize + 1);
            shown.live.hear(&Event::Finished(keyframe(id), poses));
        }
        let first = ask(&shown, "/live/0/0/0");
        assert!(is_recent(lock(&shown.live.asked).news));
        assert_eq!(first["keyframes"].as_array().unwrap().len(), 2);
        assert_eq!(first["poses"].as_array().unwrap().len(), 2);
        // the pixel of which nothing is known is left out
        assert_eq!(first["keyframes"][0]["cloud"]["count"][0], 4);
        let version = first["version"].as_u64().unwrap();
        let next = |version: u64| ask(&shown, &format!("/live/{version}/0/0"));
        assert_eq!(next(version)["keyframes"].as_array().unwrap().len(), 0);
        assert_eq!(next(version)["poses"].as_array().unwrap().len(), 0);
        shown.live.hear(&Event::Revised(keyframe(1)));
        let revised = next(version);
        assert_eq!(revised["keyframes"][0]["id"], 1);
        assert_eq!(revised["poses"].as_array().unwrap().len(), 0);
        shown.live.hear(&Event::Moved(poses_of(2)));
        let moved = next(revised["version"].as_u64().unwrap());
        assert_eq!(moved["poses"].as_array().unwrap().len(), 2);
    }

    #[test]
    fn many_keyframes_come_in_several_answers_and_none_is_lost() {
        let shown = shown();
        for id in 0..40 {
            let poses = poses_of(id as usize + 1);
            shown.live.hear(&Event::Finished(keyframe(id), poses));
        }
        let (mut version, mut seen) = (0, Vec::new());
        for _ in 0..5 {
            let news = ask(&shown, &format!("/live/{version}/0/0"));
            version = news["version"].as_u64().unwrap();
            let keyframes = news["keyframes"].as_array().unwrap();
            seen.extend(keyframes.iter().map(|k| k["id"].as_u64().unwrap()));
        }
        assert_eq!(seen, (0..40).collect::<Vec<u64>>());
    }

    #[test]
    fn the_map_grows_only_while_somebody_looks_at_cells() {
        let shown = shown();
        let is_open = || matches!(*lock(&shown.live.map), Map::Open(_));
        let (sender, receiver) = sync_channel(1);
        ask(&shown, "/live/0/0/0");
        shown.live.follow_map(|| panic!("nobody asked for cells"));
        ask(&shown, "/live/0/0/1");
        shown.live.follow_map(|| receiver);
        // it is not there yet, and nobody waits for it
        shown.live.follow_map(|| panic!("it was asked for already"));
        assert!(!is_open());
        sender.send(Ok(MapReader::default())).unwrap();
        shown.live.follow_map(|| panic!("it was asked for already"));
        assert!(is_open());
        assert!(!shown.live.is_local_wanted());
        ask(&shown, "/live/0/0/4");
        assert!(shown.live.is_local_wanted());
        lock(&shown.live.asked).cells = None;
        shown.live.follow_map(|| panic!("nobody looks any more"));
        assert!(!is_open());
    }

    #[test]
    fn the_end_is_told_with_the_last_news() {
        let shown = shown();
        for id in 0..MAX_KEYFRAMES as u32 + 1 {
            let poses = poses_of(id as usize + 1);
            shown.live.hear(&Event::Finished(keyframe(id), poses));
        }
        shown.live.has_ended.store(true, Ordering::Relaxed);
        let first = ask(&shown, "/live/0/0/0");
        assert_eq!(first["ended"], false, "one keyframe is left");
        let last = ask(&shown, &format!("/live/{}/0/0", first["version"]));
        assert_eq!(last["ended"], true);
        assert_eq!(last["keyframes"].as_array().unwrap().len(), 1);
    }

    #[test]
    fn other_questions_have_no_answer() {
        let shown = shown();
        for path in [
            "/live",
            "/live/1/0",
            "/live/a/0/0",
            "/live/-1/0/0",
            "/live/0/0/8",
            "/etc/passwd",
        ] {
            assert!(shown.answer(path).is_none(), "{path}");
        }
        assert_eq!(
            ask(&shown, "/live/7/99/0")["path"]
                .as_array()
                .unwrap()
                .len(),
            0
        );
    }
}
