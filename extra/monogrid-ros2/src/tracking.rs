//! The thread that tracks: images in, poses out; what the maps need goes to their thread.

use crate::args::{Args, FrameArgs};
use crate::convert::{gray_image, gray_of_compressed, odometry_of, transform_of};
use crate::frames::{Frames, Poses, frame_of_map};
use crate::node::{Outlet, Quality, RosNode};
use crate::work::{Answer, News, Picture, Tracked, Work, WorkReceiver, response};
use monogrid_geometry::{Camera, Sim3};
use monogrid_image::GrayImage;
use monogrid_inertial::ImuSample;
use monogrid_mapping::MapReader;
use monogrid_messages::builtin_interfaces::Time;
use monogrid_messages::nav_msgs::Odometry;
use monogrid_messages::std_msgs::Header;
use monogrid_messages::tf2_msgs::TFMessage;
use monogrid_pipeline::{Event, Pipeline, PipelineError, Settings, Unusable};
use monogrid_slam::{Effort, FrameReport};
use std::sync::mpsc::SyncSender;

/// Publishes where the camera is.
pub struct PosePublisher {
    frames: FrameArgs,
    odometry: Outlet<Odometry>,
    tf: Outlet<TFMessage>,
    tf_static: Outlet<TFMessage>,
    /// The optical frame that was published.
    optical: Option<String>,
    last_stamp: Option<Time>,
}

impl PosePublisher {
    /// Begins to publish.
    ///
    /// # Errors
    /// A network that cannot be used.
    pub fn new(node: &mut RosNode, frames: &FrameArgs) -> anyhow::Result<Self> {
        Ok(Self {
            frames: frames.clone(),
            odometry: node.publisher("odom", Quality::Stream)?,
            tf: node.publisher("/tf", Quality::Stream)?,
            tf_static: node.publisher("/tf_static", Quality::Latched)?,
            optical: None,
            last_stamp: None,
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

    /// Publishes poses at a time; returns how many messages could not be sent.
    fn publish(&mut self, stamp: Time, poses: &Poses) -> usize {
        let header = |frame: &str| Header {
            stamp,
            frame_id: frame.to_owned(),
        };
        let FrameArgs {
            map_frame,
            odom_frame,
            base_frame,
            ..
        } = &self.frames;
        let last = self.last_stamp.replace(stamp);
        let seconds = last.map(|last| (stamp.nanoseconds() - last.nanoseconds()) as f64 * 1e-9);
        let step = poses.step.zip(seconds);
        let odom_from_base = &poses.odom_from_base;
        let odometry = odometry_of(header(odom_frame), base_frame, odom_from_base, step);
        let mut unsent = usize::from(!self.odometry.publish(odometry));
        if !self.frames.no_tf {
            let transforms = vec![
                transform_of(header(map_frame), odom_frame, &poses.map_from_odom()),
                transform_of(header(odom_frame), base_frame, odom_from_base),
            ];
            unsent += usize::from(!self.tf.publish(TFMessage { transforms }));
        }
        unsent
    }
}

/// Tracks.
pub struct Tracking {
    settings: Settings,
    frames: Frames,
    /// Metres of a unit of the world, where somebody has told it.
    told_metres_per_unit: Option<f64>,
    /// Or why it is not known.
    camera: Result<Camera, String>,
    pipeline: Option<Pipeline>,
    /// Of the pipeline: what its maps are brought to.
    maps: Option<MapReader>,
    /// Number of the world that comes next.
    next_world: u32,
    last_stamp: Option<Time>,
    publisher: PosePublisher,
    news: SyncSender<News>,
}

impl Tracking {
    /// With nothing tracked yet.
    #[must_use]
    pub fn new(
        settings: Settings,
        args: &Args,
        camera: Result<Camera, String>,
        publisher: PosePublisher,
        news: SyncSender<News>,
    ) -> Self {
        let map_from_world = frame_of_map(&settings.map_from_world, args.metres_per_unit);
        Self {
            settings,
            frames: Frames::new(args.frames.mount(), map_from_world),
            told_metres_per_unit: args.metres_per_unit,
            camera,
            pipeline: None,
            maps: None,
            next_world: 0,
            last_stamp: None,
            publisher,
            news,
        }
    }

    /// Does all that is asked for, until nobody asks any more.
    pub fn run(mut self, work: &WorkReceiver) {
        while let Some(work) = work.next() {
            match work {
                Work::Camera(camera) => self.camera = camera,
                Work::Picture(picture) => self.take(&picture),
                Work::Reading(reading) => self.take_reading(reading),
                Work::Scale(told) => {
                    self.told_metres_per_unit = told;
                    self.tell(News::Scale(told));
                }
                Work::Reset(answer) => self.reset(answer),
                Work::Save(answer) => {
                    let pipeline = self.pipeline.as_ref();
                    let path = pipeline.map(|pipeline| pipeline.slam().trajectory());
                    self.tell(News::Save(answer, path.unwrap_or_default()));
                }
            }
        }
    }

    /// The thread of the maps ends after this one only.
    fn tell(&self, news: News) {
        let _ = self.news.send(news);
    }

    fn reset(&mut self, answer: Answer) {
        // its threads end by themselves
        (self.pipeline, self.maps) = (None, None);
        self.last_stamp = None;
        self.frames.begin_again();
        self.tell(News::Ended);
        let said = "the next image begins a new map; odometry goes on".to_owned();
        // whoever has gone away needs no answer
        let _ = answer.send(response(Ok(said)));
    }

    fn take(&mut self, picture: &Picture) {
        let (header, image) = match picture {
            Picture::Plain(image) => (&image.header, gray_image(image)),
            Picture::Compressed(image) => (&image.header, gray_of_compressed(image)),
        };
        let tracked = image
            .map_err(|error| error.to_string())
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
        if let Some(last) = self.last_stamp.filter(|last| *last >= stamp) {
            return Err(format!(
                "an image of {} ns came after one of {} ns: time runs backwards; call reset where \
                 that is meant",
                stamp.nanoseconds(),
                last.nanoseconds()
            ));
        }
        let mut pipeline = match self.pipeline.take() {
            Some(pipeline) => pipeline,
            None => self.begin()?,
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
        self.frames.map_from_world = self.frame_of_map();
        let poses = self.frames.advance(report);
        let stamp = Time::from_nanoseconds(report.timestamp_ns);
        poses.map_or(0, |poses| self.publisher.publish(stamp, &poses))
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
        let pipeline = self.pipeline.as_ref();
        self.tell(News::Tracked(Box::new(Tracked {
            stamp,
            report,
            poses: pipeline.map(|p| p.slam().snapshot()).unwrap_or_default(),
            unsent,
        })));
    }

    /// The frame of the map as it is now.
    fn frame_of_map(&self) -> Sim3 {
        let view = self.maps.as_ref().and_then(MapReader::latest);
        let base = self.settings.map_from_world;
        let mapper_from_world = view.map_or(base, |view| view.map_from_world);
        frame_of_map(&mapper_from_world, self.told_metres_per_unit)
    }

    fn begin(&mut self) -> Result<Pipeline, String> {
        let camera = self.camera.clone();
        let camera = camera.inspect_err(|why| self.tell(News::Waiting(why.clone())))?;
        self.pipeline_of(&camera).map_err(|error| error.to_string())
    }

    fn pipeline_of(&mut self, camera: &Camera) -> Result<Pipeline, PipelineError> {
        let mut pipeline = Pipeline::new(camera, self.settings.clone())?;
        let (news, world) = (self.news.clone(), self.next_world);
        self.next_world += 1;
        pipeline.listen(move |event: &Event| {
            if let Event::Finished(keyframe, poses) = event {
                // the thread of the maps ends after this one only
                let _ = news.send(News::Keyframe(world, keyframe.clone(), poses.clone()));
            }
        })?;
        let pinhole = *pipeline.preparation().pinhole();
        let maps = pipeline.live_map()?;
        self.maps = Some(maps.clone());
        self.tell(News::Begun(world, maps, pinhole));
        Ok(pipeline)
    }
}
