//! A recording as a whole: its topics, and the images of one of them.

use crate::convert::{camera_of, gray_image, gray_of_compressed, has_words, has_words_compressed};
use crate::error::BagError;
use crate::message::{Messages, Raw};
use crate::part::{Format, Part, is_packed, parts_of};
use crate::topic::{Family, Indexed, Topic, TopicKind, listed};
use crate::{db3, foxglove, mcap, ros1};
use monogrid_datasets::Levels;
use monogrid_geometry::Camera;
use monogrid_image::GrayImage;
use monogrid_messages::RosMessage;
use monogrid_messages::sensor_msgs::{CameraInfo, CompressedImage, Image};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Messages from the first image on that are looked at for topics where no index says them: some
/// seconds of a robot.
const HEAD_MESSAGES: usize = 5000;

/// Images with their times, ns.
pub type Images = Box<dyn Iterator<Item = Result<(i64, GrayImage), BagError>> + Send>;

/// A packet of a video.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Coded {
    /// When its picture was taken, ns.
    pub time_ns: i64,
    /// The codec, as `h264`.
    pub format: String,
    /// One picture.
    pub data: Vec<u8>,
}

/// Packets of a video.
pub type Packets = Box<dyn Iterator<Item = Result<Coded, BagError>> + Send>;

/// A recording.
#[derive(Debug)]
pub struct Bag {
    path: PathBuf,
    /// The files it is made of, in the order of time.
    parts: Vec<Part>,
    /// Those that have messages, by name.
    topics: Vec<Topic>,
}

/// Whether a path is a recording, or the folder of one.
#[must_use]
pub fn is_bag(path: &Path) -> bool {
    parts_of(path).is_ok_and(|parts| !parts.is_empty())
}

/// The messages of a file.
fn messages_of(part: &Part) -> Result<Messages, BagError> {
    match part.format {
        Format::Mcap => mcap::messages(part),
        Format::Db3 => db3::messages(part),
        Format::Ros1 => ros1::messages(part),
    }
}

/// The topics of a file by its index, where it has one.
fn index_of(part: &Part) -> Result<Option<Vec<Indexed>>, BagError> {
    match part.format {
        Format::Mcap => mcap::topics(part),
        Format::Db3 => db3::topics(part).map(Some),
        Format::Ros1 => ros1::topics(part),
    }
}

/// The topics of a file without an index: those of its messages, as far as one must read.
fn topics_by_reading(part: &Part) -> Result<Vec<Indexed>, BagError> {
    let mut topics = BTreeMap::new();
    let mut first_image = None;
    for (count, message) in messages_of(part)?.enumerate() {
        // calibrations begin somewhat later
        if first_image.is_some_and(|first| count >= first + HEAD_MESSAGES) {
            break;
        }
        match message {
            Ok(message) => {
                let topic = || Topic::clone(&message.topic);
                topics
                    .entry(message.topic.name.clone())
                    .or_insert_with(topic);
                if message.topic.has_images() {
                    first_image = first_image.or(Some(count));
                }
            }
            // what was read before the damage can still be used
            Err(_) if !topics.is_empty() => break,
            Err(error) => return Err(error),
        }
    }
    let indexed = |topic| Indexed {
        topic,
        messages: Some(1),
    };
    Ok(topics.into_values().map(indexed).collect())
}

impl Bag {
    /// Opens a recording and finds its topics: by its index, else by what it begins with. What was
    /// compressed as a whole is decompressed into the folder for temporary files.
    ///
    /// # Errors
    /// What is none, or damaged at its beginning.
    pub fn open(path: &Path) -> Result<Self, BagError> {
        let mut parts = parts_of(path).map_err(BagError::io(path))?;
        if parts.is_empty() {
            let reason = if is_packed(path) {
                "is compressed with zstd, and what it holds is no recording or cannot be \
                 decompressed: is it whole?"
            } else {
                "begins neither as MCAP, as SQLite nor as a ROS 1 bag: expected a .mcap, .db3 or \
                 .bag file, or the folder of a rosbag2"
            };
            return Err(BagError::damaged(path, reason));
        }
        parts.iter_mut().try_for_each(Part::prepare)?;
        let mut topics = BTreeMap::new();
        for part in &parts {
            let indexed = match index_of(part)? {
                Some(indexed) => indexed,
                None => topics_by_reading(part)?,
            };
            let with_messages = indexed.into_iter().filter(|i| i.messages != Some(0));
            topics.extend(with_messages.map(|i| (i.topic.name.clone(), i.topic)));
        }
        Ok(Self {
            path: path.to_owned(),
            parts,
            topics: topics.into_values().collect(),
        })
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// The topics, by name.
    #[must_use]
    pub fn topics(&self) -> &[Topic] {
        &self.topics
    }

    /// The topic of images that is named, or the only one.
    ///
    /// # Errors
    /// When there is none, or several could be meant; says which there are.
    pub fn image_topic(&self, name: Option<&str>) -> Result<&Topic, BagError> {
        let images: Vec<&Topic> = self.topics.iter().filter(|t| t.has_images()).collect();
        let found = match name {
            Some(name) => images.iter().find(|topic| topic.name == name).copied(),
            None => self.only_one(&images),
        };
        if let Some(found) = found {
            return Ok(found);
        }
        let reason = match name {
            _ if self.topics.is_empty() => "there are no messages".to_owned(),
            _ if images.is_empty() => format!(
                "there is no topic with images; there are {}; images are sensor_msgs/Image, \
                 CompressedImage, foxglove.RawImage, CompressedImage or CompressedVideo",
                listed(&self.topics)
            ),
            None => format!(
                "images of which topic? say it with --topic NAME; there are {}",
                listed(images)
            ),
            Some(name) => format!("no images of {name}: there are {}", listed(images)),
        };
        Err(BagError::damaged(&self.path, reason))
    }

    /// The only topic that can be meant: depth is not, nor is what an index names and nobody has
    /// seen.
    fn only_one<'a>(&self, images: &[&'a Topic]) -> Option<&'a Topic> {
        let mut left = images.to_vec();
        if left.len() > 1 {
            left.retain(|topic| !topic.is_depth());
        }
        // SQLite does not say which topics have messages
        if left.len() > 1 && self.parts.iter().any(|part| part.format == Format::Db3) {
            let head = self.messages().take(HEAD_MESSAGES).map_while(Result::ok);
            let seen: BTreeSet<String> = head.map(|message| message.topic.name.clone()).collect();
            left.retain(|topic| seen.contains(&topic.name));
        }
        match left[..] {
            [only] => Some(only),
            _ => None,
        }
    }

    /// The camera of a topic of images: by the calibration in the same namespace, where there is
    /// one.
    ///
    /// # Errors
    /// A calibration that is not understood.
    pub fn camera_of(&self, topic: &Topic) -> Result<Option<Camera>, BagError> {
        // /camera/image_raw and /camera/image_raw/compressed belong to /camera/camera_info, or to
        // /camera/calibration
        let namespaces = std::iter::successors(Some(topic.name.as_str()), |name| {
            name.rsplit_once('/').map(|(above, _)| above)
        });
        for namespace in namespaces.skip(1) {
            let beside = |name: &str| {
                let last = name
                    .strip_prefix(namespace)
                    .and_then(|rest| rest.strip_prefix('/'));
                matches!(
                    last,
                    Some("camera_info" | "calibration" | "camera_calibration")
                )
            };
            let infos = self
                .topics
                .iter()
                .filter(|t| t.kind == TopicKind::CameraInfo);
            let Some(info_topic) = infos.into_iter().find(|topic| beside(&topic.name)) else {
                continue;
            };
            let Some(info) = self.first_info(&info_topic.name)? else {
                continue;
            };
            let is_rectified = topic.name.contains("image_rect");
            let camera = camera_of(&info, is_rectified);
            return camera.map(Some).map_err(|source| BagError::Info {
                topic: info_topic.name.clone(),
                source,
            });
        }
        Ok(None)
    }

    /// The first calibration of a topic, before the first damage.
    fn first_info(&self, name: &str) -> Result<Option<CameraInfo>, BagError> {
        let mut messages = self.messages().map_while(Result::ok);
        let message = messages.find(|message| message.topic.name == name);
        message
            .map(|message| match message.topic.family {
                Family::Foxglove => foxglove::camera_info(&message).map_err(|reason| {
                    BagError::damaged(&self.path, format!("topic {name}: {reason}"))
                }),
                Family::Ros => content(&message, &self.path),
            })
            .transpose()
    }

    /// What the first images of a topic use of their 16 bits; all of it where they have fewer.
    #[must_use]
    pub fn levels(&self, topic: &Topic) -> Levels {
        let messages = self.messages_of_topic(topic).map_while(Result::ok);
        let first = messages.take(Levels::NUM_IMAGES).map(|message| {
            let Decoded { image, has_words } = decoded(&message, &self.path).ok()?.content;
            image.ok().filter(|_| has_words)
        });
        match first.collect::<Option<Vec<_>>>() {
            Some(images) => Levels::of_grey(images),
            None => Levels::ALL,
        }
    }

    /// All images of a topic, in the order of the recording, in their own [levels](Self::levels).
    #[must_use]
    pub fn images(&self, topic: &Topic) -> Images {
        self.images_in(topic, self.levels(topic))
    }

    /// All images of a topic; those of 16 bits are stretched by these levels.
    #[must_use]
    pub fn images_in(&self, topic: &Topic, levels: Levels) -> Images {
        let path = self.path.clone();
        let messages = self.messages_of_topic(topic);
        let shown = move |message: Result<Raw, BagError>| {
            let shown = decoded(&message?, &path)?;
            let Decoded { image, has_words } = shown.content;
            let is_part = has_words && levels != Levels::ALL;
            Ok(Shown {
                stamp_ns: shown.stamp_ns,
                log_ns: shown.log_ns,
                content: image.map(|image| {
                    if is_part {
                        levels.of_all(&image)
                    } else {
                        image
                    }
                }),
            })
        };
        Box::new(Timed::new(messages.map(shown)).map(|shown| {
            let (time_ns, image) = shown?;
            image.map(|image| (time_ns, image))
        }))
    }

    /// All packets of a topic of coded video, in the order of the recording.
    #[must_use]
    pub fn packets(&self, topic: &Topic) -> Packets {
        let path = self.path.clone();
        let messages = self.messages_of_topic(topic);
        let packet = move |message: Result<Raw, BagError>| -> Result<_, BagError> {
            let message = message?;
            let damaged = |reason| {
                BagError::damaged(&path, format!("topic {}: {reason}", message.topic.name))
            };
            let packet = foxglove::compressed_video(&message).map_err(damaged)?;
            Ok(Shown {
                stamp_ns: packet.header.stamp.nanoseconds(),
                log_ns: message.log_ns,
                content: (packet.format, packet.data),
            })
        };
        Box::new(Timed::new(messages.map(packet)).map(|shown| {
            shown.map(|(time_ns, (format, data))| Coded {
                time_ns,
                format,
                data,
            })
        }))
    }

    fn messages_of_topic(&self, topic: &Topic) -> Messages {
        let name = topic.name.clone();
        Box::new(self.messages().filter(move |message| match message {
            Ok(message) => message.topic.name == name,
            Err(_) => true,
        }))
    }

    /// All messages of all files; after an error of a file comes the next one.
    pub(crate) fn messages(&self) -> Messages {
        let parts = self.parts.clone().into_iter();
        Box::new(parts.flat_map(|part| {
            let messages = messages_of(&part);
            let messages = messages.unwrap_or_else(|error| Box::new(std::iter::once(Err(error))));
            let unpacker = Arc::new(part.unpacker());
            messages.map(move |message| {
                let unpacker = Arc::clone(&unpacker);
                message.map(|message| Raw {
                    unpacker,
                    ..message
                })
            })
        }))
    }
}

/// What a message shows, and its two times.
struct Shown<T> {
    /// When it was taken, ns; drivers that do not set it leave 0.
    stamp_ns: i64,
    /// When it was recorded, ns.
    log_ns: i64,
    content: T,
}

/// Gives each its time: when it was taken. Where the first two say 0, the driver sets none, and all
/// have the times of recording; where one of them says something else, 0 is a time, as at the start
/// of a simulation.
struct Timed<T, I> {
    shown: I,
    /// What was read to find out, and whether stamps are times.
    ahead: VecDeque<Result<Shown<T>, BagError>>,
    has_stamps: Option<bool>,
}

impl<T, I: Iterator<Item = Result<Shown<T>, BagError>>> Timed<T, I> {
    fn new(shown: I) -> Self {
        Self {
            shown,
            ahead: VecDeque::new(),
            has_stamps: None,
        }
    }

    /// Reads two stamps, or as many as there are before an end or an error.
    fn look(&mut self) -> bool {
        let mut has_stamps = false;
        for shown in self.shown.by_ref().take(2) {
            let stamp_ns = shown.as_ref().map_or(0, |shown| shown.stamp_ns);
            has_stamps |= stamp_ns != 0;
            let is_enough = stamp_ns != 0 || shown.is_err();
            self.ahead.push_back(shown);
            if is_enough {
                break;
            }
        }
        has_stamps
    }
}

impl<T, I: Iterator<Item = Result<Shown<T>, BagError>>> Iterator for Timed<T, I> {
    type Item = Result<(i64, T), BagError>;

    fn next(&mut self) -> Option<Self::Item> {
        let has_stamps = match self.has_stamps {
            Some(has_stamps) => has_stamps,
            None => {
                let has_stamps = self.look();
                self.has_stamps = Some(has_stamps);
                has_stamps
            }
        };
        let shown = self.ahead.pop_front().or_else(|| self.shown.next())?;
        Some(shown.map(|shown| {
            let time_ns = if has_stamps {
                shown.stamp_ns
            } else {
                shown.log_ns
            };
            (time_ns, shown.content)
        }))
    }
}

/// What is in a message of the recording at `path`.
fn content<M: RosMessage>(message: &Raw, path: &Path) -> Result<M, BagError> {
    let damaged =
        |reason| BagError::damaged(path, format!("topic {}: {reason}", message.topic.name));
    message.content().map_err(damaged)
}

/// An image of a message.
struct Decoded {
    image: Result<GrayImage, BagError>,
    /// Whether its samples have 16 bits, of which nothing says how many are used.
    has_words: bool,
}

/// The image of a message, and its times.
fn decoded(message: &Raw, path: &Path) -> Result<Shown<Decoded>, BagError> {
    let topic = &message.topic;
    let damaged = |reason| BagError::damaged(path, format!("topic {}: {reason}", topic.name));
    let (stamp, image, has_words) = if topic.kind == TopicKind::Image {
        let image: Image = match topic.family {
            Family::Ros => content(message, path)?,
            Family::Foxglove => foxglove::raw_image(message).map_err(damaged)?,
        };
        let has_words = has_words(&image.encoding);
        (image.header.stamp, gray_image(&image), has_words)
    } else {
        let image: CompressedImage = match topic.family {
            Family::Ros => content(message, path)?,
            Family::Foxglove => foxglove::compressed_image(message).map_err(damaged)?,
        };
        let has_words = has_words_compressed(&image.data);
        (image.header.stamp, gray_of_compressed(&image), has_words)
    };
    Ok(Shown {
        stamp_ns: stamp.nanoseconds(),
        log_ns: message.log_ns,
        content: Decoded {
            image: image.map_err(|source| BagError::Image {
                topic: topic.name.clone(),
                source,
            }),
            has_words,
        },
    })
}
