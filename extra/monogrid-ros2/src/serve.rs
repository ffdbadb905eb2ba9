//! The thread of the middleware: hands on what comes, answers services, waits for nothing.

use crate::args::{Args, checked_scale};
use crate::convert::{camera_of, imu_sample_of};
use crate::node::{Quality, RosNode, Wire};
use crate::work::{Answer, Counts, Picture, Work, WorkSender, response};
use futures::channel::oneshot;
use futures::{Stream, StreamExt, future};
use monogrid_messages::sensor_msgs::{CameraInfo, CompressedImage, Image, Imu};
use monogrid_messages::std_srvs::{TriggerRequest, TriggerResponse};
use ros2_client::{MessageInfo, NodeOptions, ParameterValue, ReadError, Server, Subscription};

/// Name of the parameter that says how long a unit of the world is, m; 0 where nobody has told.
const SCALE: &str = "metres_per_unit";

/// A node with its parameter, which goes to the tracking thread when somebody sets it.
pub fn options(args: &Args, work: WorkSender) -> NodeOptions {
    let value = ParameterValue::Double(args.metres_per_unit.unwrap_or(0.0));
    NodeOptions::new()
        .enable_rosout(false)
        .declare_parameter(SCALE, value)
        .parameter_validator(Box::new(|name, value| match value {
            ParameterValue::Double(metres) if name == SCALE => told_scale(*metres).map(|_| ()),
            _ if name == SCALE => Err(format!("{SCALE} is a number with a decimal point")),
            _ => Ok(()),
        }))
        // this is called with the first value too
        .parameter_set_action(Box::new(move |name, value| match value {
            ParameterValue::Double(metres) if name == SCALE => work
                .send(Work::Scale(told_scale(*metres)?))
                .map_err(|_| "the node is ending".to_owned()),
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
    save: Trigger,
    reset: Trigger,
    is_rectified: bool,
}

enum Images {
    Plain(Subscription<Image>),
    Compressed(Subscription<CompressedImage>),
}

type Trigger = Server<Wire<TriggerRequest>, Wire<TriggerResponse>>;

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
        let info = match &args.calibration {
            Some(_) => None,
            None => Some(node.subscription(&args.info, Quality::Sensor)?),
        };
        let imu = args.imu.as_ref();
        let imu = imu.map(|topic| node.subscription(topic, Quality::Readings));
        Ok(Self {
            images,
            info,
            imu: imu.transpose()?,
            save: node.server("save", "Trigger")?,
            reset: node.server("reset", "Trigger")?,
            is_rectified: args.rectified,
        })
    }

    /// Hands on all that comes; does not end.
    pub async fn serve(self, work: &WorkSender, counts: &Counts) {
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
        let info = async {
            if let Some(topic) = &self.info {
                take_infos(topic, self.is_rectified, work).await;
            }
        };
        let readings = async {
            if let Some(topic) = &self.imu {
                take_readings(topic, work, counts).await;
            }
        };
        let save = answer(&self.save, work, Work::Save);
        let reset = answer(&self.reset, work, Work::Reset);
        future::join5(images, info, readings, save, reset).await;
    }
}

/// Hands on images as long as there is room, and counts.
async fn take_images<M>(
    messages: impl Stream<Item = Result<(M, MessageInfo), ReadError>>,
    picture: fn(M) -> Picture,
    work: &WorkSender,
    counts: &Counts,
) {
    let mut numbers = Numbers { last: None };
    let messages = std::pin::pin!(messages);
    messages
        .for_each(|message| {
            if let Ok((message, info)) = message {
                counts.received.add(1);
                counts
                    .lost
                    .add(numbers.gap(info.publisher_gid(), info.sequence_number()));
                if !work.offer(picture(message)) {
                    counts.dropped.add(1);
                }
            } else {
                // something came that is no image
                counts.lost.add(1);
            }
            future::ready(())
        })
        .await;
}

/// The numbers that the sender gives its messages.
struct Numbers<S> {
    last: Option<(S, i64)>,
}

impl<S: PartialEq> Numbers<S> {
    /// How many messages are missing before this one of a sender.
    fn gap(&mut self, sender: S, number: i64) -> u64 {
        let before = self.last.take().filter(|(before, _)| *before == sender);
        self.last = Some((sender, number));
        let missing = before.map_or(0, |(_, before)| number.saturating_sub(before) - 1);
        u64::try_from(missing).unwrap_or(0)
    }
}

/// Hands on the calibration when it is another than before.
async fn take_infos(topic: &Subscription<CameraInfo>, is_rectified: bool, work: &WorkSender) {
    let mut last = None;
    let infos = std::pin::pin!(topic.async_stream());
    infos
        .for_each(|message| {
            if let Ok((info, _)) = message {
                let camera = camera_of(&info, is_rectified);
                if last.as_ref() != Some(&camera) {
                    last = Some(camera.clone());
                    // the other threads end after this one
                    let _ = work.send(Work::Camera(camera.map_err(|error| error.to_string())));
                }
            }
            future::ready(())
        })
        .await;
}

/// Hands on the readings of an inertial sensor; those that have none of the two are of no use.
async fn take_readings(topic: &Subscription<Imu>, work: &WorkSender, counts: &Counts) {
    let readings = std::pin::pin!(topic.async_stream());
    readings
        .for_each(|message| {
            let reading = message
                .ok()
                .and_then(|(reading, _)| imu_sample_of(&reading));
            if let Some(reading) = reading {
                counts.readings.add(1);
                // the other threads end after this one
                let _ = work.send(Work::Reading(reading));
            }
            future::ready(())
        })
        .await;
}

/// Answers a service when its work is done.
async fn answer(server: &Trigger, work: &WorkSender, ask: fn(Answer) -> Work) {
    let requests = std::pin::pin!(server.receive_request_stream());
    requests
        .for_each(|request| async move {
            let Ok((id, _)) = request else {
                return;
            };
            let (answer, answered) = oneshot::channel();
            let ended = || response(Err("the node is ending".to_owned()));
            let said = match work.send(ask(answer)) {
                Ok(()) => answered.await.unwrap_or_else(|_| ended()),
                Err(_) => ended(),
            };
            // whoever has gone away needs no answer
            let _ = server.async_send_response(id, Wire(said)).await;
        })
        .await;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_in_the_numbers_of_a_sender_are_what_was_lost() {
        let mut numbers = Numbers { last: None };
        let [a, b] = ["a", "b"];
        // what was sent before anybody listened is not lost
        assert_eq!(numbers.gap(a, 17), 0);
        assert_eq!(numbers.gap(a, 18), 0);
        assert_eq!(numbers.gap(a, 21), 2);
        // the camera was started again
        assert_eq!(numbers.gap(b, 1), 0);
        // late, or twice
        assert_eq!(numbers.gap(b, 1), 0);
        assert_eq!(numbers.gap(b, 0), 0);
    }
}
