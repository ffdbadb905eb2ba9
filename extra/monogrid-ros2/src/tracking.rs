//! The thread that tracks: images in, poses out; what the maps need goes to their thread.

use crate::args::{Args, FrameArgs};
use crate::clock::BEGINS_AGAIN_NS;
use crate::convert::{
    OdometryDeviations, UNKNOWN_DEVIATION, gray_image, gray_of_compressed, has_words,
    has_words_compressed, odometry_of, transform_of,
};
use crate::frames::{Frames, Poses, frame_of_map, map_from_camera};
use crate::levels::LiveLevels;
use crate::load::Loaded;
use crate::local::Local;
use crate::log::{Log, Severity};
use crate::node::{Outlet, Quality, RosNode};
use crate::wheels::{Scale, Wheels};
use crate::work::{Answer, Begun, Known, News, Picture, Tracked, Work, WorkReceiver, response};
use monogrid_app::config::RunConfig;
use monogrid_app::run::sessions::continuation;
use monogrid_app::run::tracking::recorder::MapNow;
use monogrid_datasets::{RecordedSession, SessionInfo};
use monogrid_geometry::{Camera, Se3, Sim3};
use monogrid_image::GrayImage;
use monogrid_inertial::ImuSample;
use monogrid_mapping::MapReader;
use monogrid_messages::builtin_interfaces::Time;
use monogrid_messages::geometry_msgs::TransformStamped;
use monogrid_messages::nav_msgs::Odometry;
use monogrid_messages::std_msgs::Header;
use monogrid_messages::tf2_msgs::TFMessage;
use monogrid_pipeline::{Event, Pipeline, Settings, Unusable};
use monogrid_slam::{Effort, FrameReport, KeyframeId, PoseSnapshot, Purpose, Slam};
use std::collections::VecDeque;
use std::path::Path;
use std::sync::mpsc::SyncSender;
use std::sync::{Arc, OnceLock};

/// Publishes where the camera is.
pub struct PosePublisher {
    frames: FrameArgs,
    /// Where the robot has none of its own.
    odometry: Option<Outlet<Odometry>>,
    tf: Outlet<TFMessage>,
    tf_static: Outlet<TFMessage>,
    /// The optical frame that was published.
    optical: Option<String>,
    last_stamp: Option<Time>,
    /// How far the base has moved and turned, m and rad.
    moved: [f64; 2],
}

impl PosePublisher {
    /// Begins to publish.
    ///
    /// # Errors
    /// A network that cannot be used.
    pub fn new(node: &mut RosNode, frames: &FrameArgs) -> anyhow::Result<Self> {
        Ok(Self {
            frames: frames.clone(),
            odometry: match frames.odometry {
                None => Some(node.publisher("odom", Quality::Stream)?),
                Some(_) => None,
            },
            tf: node.publisher("/tf", Quality::Stream)?,
            tf_static: node.publisher("/tf_static", Quality::Latched)?,
            optical: None,
            last_stamp: None,
            moved: [0.0; 2],
        })
    }

    /// Says where the camera sits, in the frame that its images name, when that is new.
    fn say_mount(&mut self, header: &Header) {
        let is_new = self.optical.as_ref() != Some(&header.frame_id);
        let is_wanted = !self.frames.no_tf && !self.frames.no_camera_tf;
        if !is_wanted || !is_new || header.frame_id.is_empty() {
            return;
        }
        let parent = Header {
            stamp: header.stamp,
            frame_id: self.frames.base_frame.clone(),
        };
        let transform = transform_of(parent, &header.frame_id, &self.frames.mount());
        let transforms = vec![transform];
        // what could not be sent is sent with the next image
        if self.tf_static.publish(TFMessage { transforms }) {
            self.optical = Some(header.frame_id.clone());
        }
    }

    /// Publishes poses at a time; returns how many messages could not be sent. `is_metric`: whether
    /// the scale is known.
    fn publish(&mut self, stamp: Time, poses: &Poses, is_metric: bool) -> usize {
        let odom_from_base = poses.odom_from_base;
        let last = self.last_stamp.replace(stamp);
        let seconds = last.map(|last| (stamp.nanoseconds() - last.nanoseconds()) as f64 * 1e-9);
        if let Some(step) = poses.step {
            self.moved[0] += step.translation.norm();
            self.moved[1] += step.rotation.angle();
        }
        let step = poses.step.zip(seconds);
        let (odom, base) = (self.frames.odom_frame(), &self.frames.base_frame);
        let deviations = deviations(self.moved, is_metric);
        let message = odometry_of(
            header(stamp, odom),
            base,
            &odom_from_base,
            step,
            &deviations,
        );
        let odometry = self.odometry.as_ref();
        let is_unsent = odometry.is_some_and(|odometry| !odometry.publish(message));
        let moved = transform_of(header(stamp, odom), base, &odom_from_base);
        usize::from(is_unsent) + self.publish_map(stamp, &poses.map_from_odom(), Some(moved))
    }

    /// Publishes where odometry begins in the map, and where the base is, if that is given.
    fn publish_map(
        &self,
        stamp: Time,
        map_from_odom: &Se3,
        odom_from_base: Option<TransformStamped>,
    ) -> usize {
        if self.frames.no_tf {
            return 0;
        }
        let (map, odom) = (&self.frames.map_frame, self.frames.odom_frame());
        let mut transforms = vec![transform_of(header(stamp, map), odom, map_from_odom)];
        transforms.extend(odom_from_base);
        usize::from(!self.tf.publish(TFMessage { transforms }))
    }
}

fn header(stamp: Time, frame: &str) -> Header {
    Header {
        stamp,
        frame_id: frame.to_owned(),
    }
}

/// What an odometry by images drifts, of the way and of the turns.
const DRIFT: [f64; 2] = [0.02, 0.01];
/// What it is wrong at the beginning, m and rad.
const FIRST_DEVIATIONS: [f64; 2] = [0.01, 0.005];
/// m/s and rad/s.
const VELOCITY_DEVIATIONS: [f64; 2] = [0.1, 0.05];

/// The error of odometry for filters that fuse it, after so many metres and radians. Without
/// a scale nothing is known of lengths.
fn deviations(moved: [f64; 2], is_metric: bool) -> OdometryDeviations {
    let of = |axis: usize| FIRST_DEVIATIONS[axis] + DRIFT[axis] * moved[axis];
    let [velocity, turning] = VELOCITY_DEVIATIONS;
    let metric = |deviation: f64| {
        if is_metric {
            deviation
        } else {
            UNKNOWN_DEVIATION
        }
    };
    OdometryDeviations {
        pose: [metric(of(0)), of(1)],
        velocity: [metric(velocity), turning],
    }
}

/// Images that wait for odometry of their time.
const WAITING: usize = 30;
/// Where odometry begins in the map is published so often at most, ns.
const CORRECTION_EVERY_NS: i64 = 20_000_000;

/// An image with a pose that waits for odometry of its time.
struct Waiting {
    time_ns: i64,
    world_from_camera: Se3,
    keyframe: KeyframeId,
    poses: Arc<PoseSnapshot>,
}

/// The robot's own odometry.
struct Beside {
    wheels: Wheels,
    waiting: VecDeque<Waiting>,
    map_from_odom: Option<Se3>,
    last_sent_ns: i64,
}

/// What tracking begins with.
pub struct Beginning {
    /// Settings of the pipeline.
    pub settings: Settings,
    /// The settings that they were made of.
    pub config: RunConfig,
    /// The calibration, or why there is none.
    pub camera: Result<Camera, String>,
    /// A map to go on with.
    pub loaded: Option<Loaded>,
}

/// What is said while no images are taken.
const STOPPED: &str = "stopped";

/// Tracks.
pub struct Tracking {
    settings: Settings,
    config: RunConfig,
    /// What is said of where images come from.
    source: String,
    /// What becomes of a map that is loaded.
    purpose: Purpose,
    /// The map that the world goes on with.
    loaded: Option<Loaded>,
    is_stopped: bool,
    /// Of images of 16 bits.
    levels: LiveLevels,
    frames: Frames,
    /// Metres of a unit of the world, where somebody has told it.
    told_metres_per_unit: Option<f64>,
    /// Or why it is not known.
    camera: Result<Camera, String>,
    pipeline: Option<Pipeline>,
    /// Of the pipeline: what its maps are brought to.
    maps: Arc<OnceLock<MapReader>>,
    /// Number of the world that comes next.
    next_world: u32,
    last_stamp: Option<Time>,
    publisher: PosePublisher,
    local: Local,
    /// Where odometry has the robot at the newest image.
    odom_from_base: Option<Se3>,
    beside: Option<Beside>,
    base_from_camera: Se3,
    /// What went wrong with the file for what is old, once it was said.
    said_failure: Option<String>,
    news: SyncSender<News>,
    log: Arc<Log>,
}

impl Tracking {
    /// With nothing tracked yet.
    #[must_use]
    pub fn new(
        begin: Beginning,
        args: &Args,
        (publisher, local): (PosePublisher, Local),
        news: SyncSender<News>,
        log: Arc<Log>,
    ) -> Self {
        let Beginning {
            settings,
            config,
            camera,
            loaded,
        } = begin;
        let told = args.metres_per_unit.map(Scale::given);
        let map_from_world = frame_of_map(&settings.map_from_world, told);
        let base_from_camera = args.frames.mount();
        let beside = args.frames.odometry.as_ref().map(|_| Beside {
            wheels: Wheels::new(base_from_camera),
            waiting: VecDeque::new(),
            map_from_odom: None,
            last_sent_ns: i64::MIN,
        });
        Self {
            settings,
            config,
            source: args.image.clone(),
            purpose: match args.localise_only {
                true => Purpose::LocaliseOnly,
                false => Purpose::Extend,
            },
            loaded,
            is_stopped: false,
            levels: LiveLevels::default(),
            beside,
            base_from_camera,
            frames: Frames::new(base_from_camera, map_from_world),
            told_metres_per_unit: args.metres_per_unit,
            camera,
            pipeline: None,
            maps: Arc::default(),
            next_world: 0,
            last_stamp: None,
            publisher,
            local,
            odom_from_base: None,
            said_failure: None,
            news,
            log,
        }
    }

    /// Does all that is asked for, until nobody asks any more.
    pub fn run(mut self, work: &WorkReceiver) {
        while let Some(work) = work.next() {
            match work {
                Work::Picture(_) | Work::Reading(_) if self.is_stopped => {}
                Work::Camera(camera) => self.take_camera(camera),
                Work::Picture(picture) => self.take(&picture),
                Work::Reading(reading) => self.take_reading(reading),
                Work::Scale(told) => {
                    self.told_metres_per_unit = told;
                    self.tell(News::Scale(self.scale()));
                }
                Work::Odometry(time_ns, odom_from_base) => {
                    self.take_odometry(time_ns, odom_from_base);
                }
                Work::BeginAgain(why) => self.restart(&why),
                Work::Start(answer) => self.start(answer),
                Work::Stop(answer) => self.stop(answer),
                Work::Reset(answer) => self.reset(answer),
                Work::Load(path, answer) => self.load(&path, answer),
                Work::Save(answer) => self.save(answer),
            }
        }
    }

    /// The thread of the maps ends after this one only.
    fn tell(&self, news: News) {
        let _ = self.news.send(news);
    }

    fn take_camera(&mut self, camera: Result<Camera, String>) {
        match &camera {
            Ok(camera) => {
                let (width, height, model) = (camera.width, camera.height, camera.pinhole);
                let said = format!("calibration: {width}x{height} px, {model:?}");
                self.log.say(Severity::Info, &said);
            }
            Err(why) => self
                .log
                .say(Severity::Error, &format!("calibration: {why}")),
        }
        self.camera = camera;
    }

    /// Begins again, unless nothing has begun; in a map that was loaded, if one was.
    fn restart(&mut self, why: &str) {
        if self.last_stamp.is_none() {
            return;
        }
        let path = self.loaded.as_ref().map(|loaded| loaded.path.clone());
        let loaded = path.map(|path| Loaded::read(&path)).transpose();
        let next = match &loaded {
            Ok(None) => "the next image begins a new map".to_owned(),
            Ok(Some(loaded)) => format!("the next image is looked for in {loaded}"),
            Err(error) => format!("the next image begins a new map, since {error}"),
        };
        self.log.say(Severity::Warn, &format!("{why}: {next}"));
        self.begin_again(loaded.unwrap_or_default());
    }

    fn stop(&mut self, answer: Answer) {
        self.is_stopped = true;
        self.tell(News::Waiting(STOPPED.to_owned()));
        let said = "images are not taken until `start`; the map stays".to_owned();
        // whoever has gone away needs no answer
        let _ = answer.send(response(Ok(said)));
    }

    fn start(&mut self, answer: Answer) {
        if std::mem::take(&mut self.is_stopped) {
            self.tell(News::Waiting("started, no image has come since".to_owned()));
        }
        // whoever has gone away needs no answer
        let _ = answer.send(response(Ok("images are taken".to_owned())));
    }

    /// Goes on with a map that was saved; what there is stays where it cannot be read.
    fn load(&mut self, path: &Path, answer: Answer) {
        let loaded = Loaded::read(path).map(|loaded| {
            loaded.say(&self.log);
            let said = format!("the next image is looked for in {loaded}");
            self.begin_again(Some(loaded));
            said
        });
        // whoever has gone away needs no answer
        let _ = answer.send(response(loaded));
    }

    fn reset(&mut self, answer: Answer) {
        self.begin_again(None);
        let said = "the next image begins a new map; odometry goes on".to_owned();
        // whoever has gone away needs no answer
        let _ = answer.send(response(Ok(said)));
    }

    fn begin_again(&mut self, loaded: Option<Loaded>) {
        self.loaded = loaded;
        self.levels = LiveLevels::default();
        // its threads end by themselves
        (self.pipeline, self.maps) = (None, Arc::default());
        self.last_stamp = None;
        self.frames.begin_again();
        self.local.begin_again();
        if let Some(beside) = &mut self.beside {
            beside.wheels.begin_again();
            beside.waiting.clear();
            beside.map_from_odom = None;
        }
        self.tell(News::Ended);
        self.tell(News::Scale(self.scale()));
        if self.is_stopped {
            self.tell(News::Waiting(STOPPED.to_owned()));
        }
    }

    /// Hands over what is known now, unless some of it is lost.
    fn save(&self, answer: Answer) {
        let pipeline = self.pipeline.as_ref();
        let known = pipeline.map(|pipeline| Box::new(self.known(pipeline)));
        let checked = pipeline.map_or(Ok(()), |pipeline| pipeline.slam().check_spilled());
        if let Err(lost) = checked {
            let why = lost.to_string();
            self.log
                .say(Severity::Error, &format!("no map saved: {why}"));
            // whoever has gone away needs no answer
            let _ = answer.send(response(Err(why)));
            return;
        }
        self.tell(News::Save(answer, known));
    }

    /// What is known now.
    fn known(&self, pipeline: &Pipeline) -> Known {
        let slam = pipeline.slam();
        let loaded = self.loaded.as_ref();
        let mut sessions = loaded.map_or_else(Vec::new, |loaded| loaded.sessions.clone());
        sessions.push(RecordedSession {
            source: self.source.clone(),
            first_keyframe: loaded.map_or(0, |loaded| loaded.num_keyframes as u32),
        });
        let frames = loaded.map_or_else(Vec::new, |loaded| loaded.frames.clone());
        let (width, height) = pipeline.preparation().size();
        let session = SessionInfo {
            pinhole: *pipeline.preparation().pinhole(),
            width,
            height,
            scale: match slam.scale() {
                monogrid_slam::Scale::Metric => monogrid_datasets::Scale::Metric,
                monogrid_slam::Scale::Arbitrary => monogrid_datasets::Scale::Arbitrary,
            },
            seed: self.config.seed,
            profile: self.config.profile.name().to_owned(),
            source: self.source.clone(),
            // without, a later run has to be told the settings
            config: self.config.to_toml().unwrap_or_default(),
        };
        Known {
            trajectory: slam.trajectory(),
            map: MapNow {
                session,
                keyframes: slam.keyframes(),
                poses: slam.snapshot(),
                continuation: continuation(slam, sessions, frames),
            },
        }
    }

    fn take(&mut self, picture: &Picture) {
        let (header, image, has_words) = match picture {
            Picture::Plain(image) => {
                let has_words = has_words(&image.encoding);
                (&image.header, gray_image(image), has_words)
            }
            Picture::Compressed(image) => {
                let has_words = has_words_compressed(&image.data);
                (&image.header, gray_of_compressed(image), has_words)
            }
        };
        let tracked = image
            .map_err(|error| error.to_string())
            .and_then(|image| match has_words {
                true => self.levels.show(image),
                false => Ok(image),
            })
            .and_then(|image| self.push(header, image));
        match tracked {
            Ok((report, unsent)) => self.conclude(report, unsent),
            Err(why) => self.tell(News::Unusable(why)),
        }
    }

    /// A reading, and the image that waited for it, if one did. What was read before the first
    /// image is of no use.
    fn take_reading(&mut self, reading: ImuSample) {
        let pipeline = self.pipeline.as_mut();
        if let Some(report) = pipeline.and_then(|pipeline| pipeline.push_readings(&[reading])) {
            self.conclude(report, None);
        }
    }

    /// Gives an image to the pipeline, which begins with the first one after the calibration. What
    /// became of it, or of an earlier image, and how many messages about it could not be sent,
    /// where its poses were published already: as soon as they were known.
    fn push(
        &mut self,
        header: &Header,
        image: GrayImage,
    ) -> Result<(Result<FrameReport, Unusable>, Option<usize>), String> {
        let stamp = header.stamp;
        let last = self
            .last_stamp
            .map(|last| (last.nanoseconds(), stamp.nanoseconds()));
        match last {
            Some((last, now)) if last - now > BEGINS_AGAIN_NS => {
                self.restart("the times of images have jumped back");
            }
            Some((last, now)) if last >= now => {
                return Err(format!(
                    "an image of {now} ns came after one of {last} ns: time runs backwards"
                ));
            }
            _ => {}
        }
        let mut pipeline = match self.pipeline.take() {
            Some(pipeline) => pipeline,
            None => self.begin(stamp)?,
        };
        self.publisher.say_mount(header);
        let mut unsent = None;
        let report = pipeline.push_telling(image, stamp.nanoseconds(), &mut |report| {
            unsent = Some(self.publish(report));
            Effort::Whole
        });
        self.pipeline = Some(pipeline);
        self.last_stamp = Some(stamp);
        Ok((report, unsent))
    }

    /// Publishes where everything was at an image; how many messages could not be sent.
    fn publish(&mut self, report: &FrameReport) -> usize {
        if self.beside.is_some() {
            return 0;
        }
        self.frames.map_from_world = self.frame_of_map();
        let poses = self.frames.advance(report);
        self.odom_from_base = poses.map(|poses| poses.odom_from_base);
        let stamp = Time::from_nanoseconds(report.timestamp_ns);
        let is_metric = self.is_metric();
        poses.map_or(0, |poses| self.publisher.publish(stamp, &poses, is_metric))
    }

    /// Says what became of an image, and where everything was if that was not published.
    fn conclude(&mut self, report: Result<FrameReport, Unusable>, unsent: Option<usize>) {
        let report = match report {
            Ok(report) => report,
            // it is heard of later
            Err(Unusable::Waits) => return,
            Err(unusable) => return self.tell(News::Unusable(unusable.to_string())),
        };
        let stamp = Time::from_nanoseconds(report.timestamp_ns);
        let unsent = unsent.unwrap_or_else(|| self.publish(&report));
        if let Some(odom_from_base) = self.odom_from_base.take() {
            self.map_around(report.timestamp_ns, &odom_from_base);
        }
        let pipeline = self.pipeline.as_ref();
        let poses = pipeline.map(|p| p.slam().snapshot()).unwrap_or_default();
        let failure = pipeline.and_then(|pipeline| pipeline.slam().spill_failure());
        if let Some(failure) = &failure
            && self.said_failure.is_none()
        {
            self.log.say(Severity::Error, failure);
        }
        self.said_failure = failure;
        if let (Some(beside), Some(world_from_camera), Some(keyframe)) =
            (&mut self.beside, report.world_from_camera, report.keyframe)
        {
            if beside.waiting.len() == WAITING {
                beside.waiting.pop_front();
            }
            beside.waiting.push_back(Waiting {
                time_ns: report.timestamp_ns,
                world_from_camera,
                keyframe,
                poses: Arc::clone(&poses),
            });
            self.settle();
        }
        self.tell(News::Tracked(Box::new(Tracked {
            stamp,
            report,
            poses,
            unsent,
        })));
    }

    /// A reading of the robot's own odometry. The robot goes on by it where the camera is lost, so
    /// where it begins in the map is said at each of its times.
    fn take_odometry(&mut self, time_ns: i64, odom_from_base: Se3) {
        let Some(beside) = &mut self.beside else {
            return;
        };
        beside.wheels.add(time_ns, odom_from_base);
        self.settle();
        let is_metric = self.is_metric();
        let Some(beside) = &mut self.beside else {
            return;
        };
        let since = time_ns.saturating_sub(beside.last_sent_ns);
        // also where time has jumped back
        let is_due = !(0..CORRECTION_EVERY_NS).contains(&since);
        if let Some(map_from_odom) = beside.map_from_odom.filter(|_| is_due && is_metric) {
            beside.last_sent_ns = time_ns;
            let stamp = Time::from_nanoseconds(time_ns);
            // the next one says the same
            self.publisher.publish_map(stamp, &map_from_odom, None);
        }
    }

    /// Compares images with the odometry of their time, where that is known now.
    fn settle(&mut self) {
        let (mut is_other, mut newest) = (false, None);
        while let Some(beside) = &mut self.beside
            && let Some(image) = beside.waiting.pop_front()
        {
            let Some(odom_from_base) = beside.wheels.at(image.time_ns) else {
                if beside
                    .wheels
                    .newest_ns()
                    .is_none_or(|newest| newest < image.time_ns)
                {
                    beside.waiting.push_front(image);
                    break;
                }
                continue;
            };
            let world_from_camera = &image.world_from_camera;
            let (keyframe, poses) = (image.keyframe, &image.poses);
            let wheels = &mut beside.wheels;
            is_other |= wheels.compare(world_from_camera, keyframe, poses, &odom_from_base);
            let map_from_camera = map_from_camera(&self.frame_of_map(), world_from_camera);
            let map_from_base = map_from_camera * self.base_from_camera.inverse();
            if let Some(beside) = &mut self.beside {
                beside.map_from_odom = Some(map_from_base * odom_from_base.inverse());
                // of an earlier one it is not known any more what was seen
                newest = beside
                    .waiting
                    .is_empty()
                    .then_some((image.time_ns, odom_from_base));
            }
        }
        if let Some((time_ns, odom_from_base)) = newest {
            self.map_around(time_ns, &odom_from_base);
        }
        if is_other {
            self.tell(News::Scale(self.scale()));
        }
    }

    /// Has what is around the newest image mapped.
    fn map_around(&mut self, time_ns: i64, odom_from_base: &Se3) {
        let odom_from_camera = *odom_from_base * self.base_from_camera;
        let metres_per_unit = self.frame_of_map().scale;
        if let Some(pipeline) = &self.pipeline {
            let local = &mut self.local;
            local.take(pipeline, time_ns, &odom_from_camera, metres_per_unit);
        }
    }

    /// How long a unit of the world is, where somebody tells it or wheels have shown it.
    fn scale(&self) -> Option<Scale> {
        let wheels = self
            .beside
            .as_ref()
            .and_then(|beside| beside.wheels.scale());
        let loaded = self
            .loaded
            .as_ref()
            .and_then(|loaded| loaded.metres_per_unit);
        let told = self.told_metres_per_unit.or(loaded).map(Scale::given);
        told.or(wheels)
    }

    /// Whether lengths are metres: an inertial sensor changes the scale of the mapper's frame.
    fn is_metric(&self) -> bool {
        let sensed = self.frame_of_mapper().scale != self.frame_of_settings().scale;
        sensed || self.scale().is_some()
    }

    fn frame_of_mapper(&self) -> Sim3 {
        let view = self.maps.get().and_then(MapReader::latest);
        view.map_or(self.frame_of_settings(), |view| view.map_from_world)
    }

    /// The frame of the map before an inertial sensor has a say.
    fn frame_of_settings(&self) -> Sim3 {
        let loaded = self.loaded.as_ref();
        let loaded = loaded.and_then(|loaded| loaded.map_from_world);
        loaded.unwrap_or(self.settings.map_from_world)
    }

    /// The frame of the map as it is now.
    fn frame_of_map(&self) -> Sim3 {
        frame_of_map(&self.frame_of_mapper(), self.scale())
    }

    /// Lets what is old leave memory for a file, which has no name and ends with the world.
    fn bound_memory(&self, slam: &Slam) {
        match tempfile::tempfile() {
            Ok(file) => slam.spill_into(file),
            Err(error) => {
                let folder = std::env::temp_dir();
                let said = format!(
                    "memory will grow, since no file can be made in {} (TMPDIR names another \
                     folder): {error}",
                    folder.display()
                );
                self.log.say(Severity::Warn, &said);
            }
        }
    }

    /// Begins a world at the time of its first image.
    fn begin(&mut self, stamp: Time) -> Result<Pipeline, String> {
        let camera = self.camera.clone();
        let camera = camera.inspect_err(|why| self.tell(News::Waiting(why.clone())))?;
        let map_from_world = self.frame_of_settings();
        let mut settings = Settings {
            map_from_world,
            ..self.settings.clone()
        };
        if let Some(loaded) = &self.loaded {
            settings.working_size = loaded.working_size;
        }
        let preparation = settings.preparation(&camera);
        let loaded = self.loaded.as_mut();
        let map = loaded.map(|loaded| loaded.take(&preparation, &self.source));
        let map = map.transpose()?.map(|map| (map, self.purpose));
        let pipeline = Pipeline::with(preparation, settings, map);
        let mut pipeline = pipeline.map_err(|error| error.to_string())?;
        self.bound_memory(pipeline.slam());
        let (news, number) = (self.news.clone(), self.next_world);
        self.next_world += 1;
        self.tell(News::Begun(Box::new(Begun {
            number,
            coming: pipeline.live_map_later(),
            maps: Arc::clone(&self.maps),
            map_from_world,
            pinhole: *pipeline.preparation().pinhole(),
            finished: vec![stamp; pipeline.slam().num_keyframes()],
        })));
        let listening = pipeline.listen(move |event: &Event| {
            if let Event::Finished(keyframe, poses) = event {
                // the thread of the maps ends after this one only
                let _ = news.send(News::Keyframe(number, keyframe.clone(), poses.clone()));
            }
        });
        listening.map_err(|error| error.to_string())?;
        Ok(pipeline)
    }
}
