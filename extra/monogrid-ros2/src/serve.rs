//! The thread of the middleware: hands on what comes, answers services, waits for nothing.

use crate::args::{Args, FrameArgs, checked_scale};
use crate::clock::{Clock, SIMULATED};
use crate::convert::{camera_of, imu_sample_of, pose_of_transform};
use crate::node::{Quality, RosNode, Trigger, Wire};
use crate::parameters::ParameterServices;
use crate::work::{Answer, Counts, Picture, Work, WorkSender, response};
use futures::channel::oneshot;
use futures::future::{self, OptionFuture, join_all};
use futures::{Stream, StreamExt};
use monogrid_messages::geometry_msgs::{Pose, Transform, Vector3};
use monogrid_messages::nav_msgs::Odometry;
use monogrid_messages::rosgraph_msgs::Clock as ClockMessage;
use monogrid_messages::sensor_msgs::{CameraInfo, CompressedImage, Image, Imu};
use monogrid_messages::std_msgs::Header;
use monogrid_messages::tf2_msgs::TFMessage;
use ros2_client::{
    MessageInfo, Node, NodeOptions, ParameterValue, ReadError, ServiceTypeName, Subscription,
};
use std::path::PathBuf;
use std::pin::pin;
use std::sync::atomic::Ordering::Relaxed;

/// Name of the parameter that says how long a unit of the world is, m; 0 where nobody has told.
const SCALE: &str = "metres_per_unit";

/// Name of the parameter that says where the map is that is loaded next.
const LOAD_PATH: &str = "load_path";

/// What a call of a service asks for.
type Ask = fn(Answer, &Node) -> Work;

/// What the services ask for; each does it when it is called, and answers then.
const SERVICES: [(&str, Ask); 5] = [
    ("start", |answer, _| Work::Start(answer)),
    ("stop", |answer, _| Work::Stop(answer)),
    ("save", |answer, _| Work::Save(answer)),
    ("reset", |answer, _| Work::Reset(answer)),
    ("load", |answer, node| Work::Load(load_path(node), answer)),
];

fn load_path(node: &Node) -> PathBuf {
    match node.get_parameter(LOAD_PATH) {
        Some(ParameterValue::String(path)) => path.into(),
        _ => PathBuf::new(),
    }
}

/// A node with its parameters. The scale goes to the tracking thread when somebody sets it.
pub fn options(args: &Args, work: WorkSender) -> NodeOptions {
    let value = ParameterValue::Double(args.metres_per_unit.unwrap_or(0.0));
    let path = args.load_path.as_ref();
    let path = path.map_or_else(String::new, |path| path.display().to_string());
    NodeOptions::new()
        .enable_rosout(false)
        // they would be answered to some middlewares only: see `parameters`
        .start_parameter_services(false)
        .declare_parameter(SCALE, value)
        .declare_parameter(LOAD_PATH, ParameterValue::String(path))
        .declare_parameter(SIMULATED, ParameterValue::Boolean(args.use_sim_time))
        .parameter_validator(Box::new(|name, value| match value {
            ParameterValue::Double(metres) if name == SCALE => told_scale(*metres).map(|_| ()),
            _ if name == SCALE => Err(format!("{SCALE} is a number with a decimal point")),
            _ => Ok(()),
        }))
        // this is called with the first value too
        .parameter_set_action(Box::new(move |name, value| match value {
            ParameterValue::Double(metres) if name == SCALE => {
                work.send(Work::Scale(told_scale(*metres)?))
            }
            _ => Ok(()),
        }))
}

/// What the parameter says; nothing by 0.
fn told_scale(metres_per_unit: f64) -> Result<Option<f64>, String> {
    if metres_per_unit == 0.0 {
        return Ok(None);
    }
    checked_scale(metres_per_unit).map(Some)
}

/// What comes in.
pub struct Inputs {
    images: Images,
    info: Option<Subscription<CameraInfo>>,
    imu: Option<Subscription<Imu>>,
    odometry: Option<OwnOdometry>,
    clock: Subscription<ClockMessage>,
    frames: FrameArgs,
    services: Vec<Trigger>,
    parameters: ParameterServices,
    is_rectified: bool,
}

/// The robot's own odometry.
enum OwnOdometry {
    Tf(Subscription<TFMessage>),
    Topic(Subscription<Odometry>),
}

enum Images {
    Plain(Subscription<Image>),
    Compressed(Subscription<CompressedImage>),
}

impl Inputs {
    /// Begins to listen.
    ///
    /// # Errors
    /// A topic that is none, or a network that cannot be used.
    pub fn new(node: &mut RosNode, args: &Args) -> anyhow::Result<Self> {
        let images = if args.compressed {
            Images::Compressed(node.subscription(&args.image, Quality::Sensor)?)
        } else {
            Images::Plain(node.subscription(&args.image, Quality::Sensor)?)
        };
        let info = args.calibration.is_none().then_some(&args.info);
        let info = info.map(|topic| node.subscription(topic, Quality::Sensor));
        let imu = args.imu.as_ref();
        let imu = imu.map(|topic| node.subscription(topic, Quality::Readings));
        let odometry = args.frames.odometry.as_ref();
        let odometry = odometry.map(|name| -> anyhow::Result<OwnOdometry> {
            Ok(match name.starts_with('/') {
                true => OwnOdometry::Topic(node.subscription(name, Quality::Readings)?),
                false => OwnOdometry::Tf(node.subscription("/tf", Quality::Readings)?),
            })
        });
        let trigger = ServiceTypeName::new("std_srvs", "Trigger");
        let services = SERVICES.map(|(name, _)| node.service(name, &trigger));
        Ok(Self {
            images,
            info: info.transpose()?,
            imu: imu.transpose()?,
            odometry: odometry.transpose()?,
            clock: node.subscription("/clock", Quality::Clock)?,
            frames: args.frames.clone(),
            services: services.into_iter().collect::<anyhow::Result<_>>()?,
            parameters: ParameterServices::new(node)?,
            is_rectified: args.rectified,
        })
    }

    /// Hands on all that comes; does not end.
    pub async fn serve(self, node: &Node, work: &WorkSender, counts: &Counts, clock: &Clock) {
        let images = async {
            match &self.images {
                Images::Plain(topic) => {
                    take_images(topic.async_stream(), Picture::Plain, work, counts).await;
                }
                Images::Compressed(topic) => {
                    take_images(topic.async_stream(), Picture::Compressed, work, counts).await;
                }
            }
        };
        let info = self.info.as_ref();
        let info = info.map(|topic| take_infos(topic, self.is_rectified, work));
        let imu = self.imu.as_ref();
        let readings = imu.map(|topic| take_readings(topic, work, counts));
        let (info, readings) = (OptionFuture::from(info), OptionFuture::from(readings));
        let services = self.services.iter().zip(SERVICES);
        let services = services.map(|(service, (_, ask))| answer(service, work, node, ask));
        let services = future::join(join_all(services), self.parameters.serve(node, clock));
        let take = |pose: Moved<'_>| take_odometry(&pose, &self.frames, work, counts);
        let odometry = async {
            match &self.odometry {
                None => {}
                Some(OwnOdometry::Tf(topic)) => {
                    let mut messages = pin!(topic.async_stream());
                    while let Some(message) = messages.next().await {
                        let transforms = message.map(|(message, _)| message.transforms);
                        for moved in transforms.unwrap_or_default() {
                            take((&moved.header, &moved.child_frame_id, &moved.transform));
                        }
                    }
                }
                Some(OwnOdometry::Topic(topic)) => {
                    let mut messages = pin!(topic.async_stream());
                    while let Some(message) = messages.next().await {
                        if let Ok((moved, _)) = message {
                            let Pose {
                                position,
                                orientation,
                            } = moved.pose.pose;
                            let transform = Transform {
                                translation: Vector3 {
                                    x: position.x,
                                    y: position.y,
                                    z: position.z,
                                },
                                rotation: orientation,
                            };
                            take((&moved.header, &moved.child_frame_id, &transform));
                        }
                    }
                }
            }
        };
        let time = take_time(&self.clock, work, clock);
        let others = future::join(services, time);
        future::join5(images, info, readings, odometry, others).await;
    }
}

/// Hands on images as long as there is room, and counts.
async fn take_images<M>(
    messages: impl Stream<Item = Result<(M, MessageInfo), ReadError>>,
    picture: fn(M) -> Picture,
    work: &WorkSender,
    counts: &Counts,
) {
    let mut last = None;
    let mut messages = pin!(messages);
    while let Some(message) = messages.next().await {
        if let Ok((message, info)) = message {
            let lost = gap(&mut last, info.publisher_gid(), info.sequence_number());
            counts.received.fetch_add(1, Relaxed);
            counts.lost.fetch_add(lost, Relaxed);
            if !work.offer(picture(message)) {
                counts.dropped.fetch_add(1, Relaxed);
            }
        } else {
            // something came that is no image
            counts.lost.fetch_add(1, Relaxed);
        }
    }
}

/// How many messages are missing before this one of a sender, by the numbers that it gives them;
/// `last` are the sender and the number before.
fn gap<S: PartialEq>(last: &mut Option<(S, i64)>, sender: S, number: i64) -> u64 {
    let before = last.take().filter(|(before, _)| *before == sender);
    *last = Some((sender, number));
    let missing = before.map_or(0, |(_, before)| number.saturating_sub(before) - 1);
    u64::try_from(missing).unwrap_or(0)
}

/// Hands on the calibration when it is another than before.
async fn take_infos(topic: &Subscription<CameraInfo>, is_rectified: bool, work: &WorkSender) {
    let mut last = None;
    let mut infos = pin!(topic.async_stream());
    while let Some(message) = infos.next().await {
        let camera = message.ok().map(|(info, _)| camera_of(&info, is_rectified));
        if let Some(camera) = camera.filter(|camera| last.as_ref() != Some(camera)) {
            last = Some(camera.clone());
            // the other threads end after this one
            let _ = work.send(Work::Camera(camera.map_err(|error| error.to_string())));
        }
    }
}

/// Hands on the readings of an inertial sensor; those that have none of the two are of no use.
async fn take_readings(topic: &Subscription<Imu>, work: &WorkSender, counts: &Counts) {
    let mut readings = pin!(topic.async_stream());
    while let Some(message) = readings.next().await {
        let reading = message.ok();
        if let Some(reading) = reading.and_then(|(reading, _)| imu_sample_of(&reading)) {
            counts.readings.fetch_add(1, Relaxed);
            // the other threads end after this one
            let _ = work.send(Work::Reading(reading));
        }
    }
}

/// Takes the time of a simulation; one that begins again begins a new map.
async fn take_time(topic: &Subscription<ClockMessage>, work: &WorkSender, clock: &Clock) {
    let mut times = pin!(topic.async_stream());
    while let Some(message) = times.next().await {
        if message.is_ok_and(|(message, _)| clock.take(message.clock)) {
            let why = "the time of /clock has jumped back".to_owned();
            // the other threads end after this one
            let _ = work.send(Work::BeginAgain(why));
        }
    }
}

/// A transform to a child.
type Moved<'a> = (&'a Header, &'a str, &'a Transform);

/// Hands on where the base of the robot is; transforms of other frames are of no use.
fn take_odometry(
    (header, child, transform): &Moved<'_>,
    frames: &FrameArgs,
    work: &WorkSender,
    counts: &Counts,
) {
    if header.frame_id != frames.odom_frame() || *child != frames.base_frame {
        return;
    }
    if let Some(odom_from_base) = pose_of_transform(transform) {
        counts.odometry.fetch_add(1, Relaxed);
        let stamp = header.stamp.nanoseconds();
        // the other threads end after this one
        let _ = work.send(Work::Odometry(stamp, odom_from_base));
    }
}

/// Answers a service when its work is done.
async fn answer(service: &Trigger, work: &WorkSender, node: &Node, ask: Ask) {
    let reply = |_| async {
        let (answer, answered) = oneshot::channel();
        // what nobody takes is dropped, and the answer with it
        let _ = work.send(ask(answer, node));
        let ended = |_| response(Err("the node is ending".to_owned()));
        Wire(answered.await.unwrap_or_else(ended))
    };
    service.answer(reply).await;
}

#[cfg(test)]
mod tests {
    use super::gap;

    #[test]
    fn gaps_in_the_numbers_of_a_sender_are_what_was_lost() {
        let mut last = None;
        let mut missing = |sender, number| gap(&mut last, sender, number);
        let [a, b] = ["a", "b"];
        // what was sent before anybody listened is not lost
        assert_eq!(missing(a, 17), 0);
        assert_eq!(missing(a, 18), 0);
        assert_eq!(missing(a, 21), 2);
        // the camera was started again
        assert_eq!(missing(b, 1), 0);
        // late, or twice
        assert_eq!(missing(b, 1), 0);
        assert_eq!(missing(b, 0), 0);
    }
}
