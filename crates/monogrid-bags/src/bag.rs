//! A recording as a whole: its topics, and the images of one of them.

use crate::convert::{camera_of, gray_image, gray_of_compressed};
use crate::error::BagError;
use crate::message::Raw;
use crate::{db3, mcap, ros1, sqlite};
use monogrid_geometry::Camera;
use monogrid_image::GrayImage;
use monogrid_messages::RosMessage;
use monogrid_messages::sensor_msgs::{CameraInfo, CompressedImage, Image};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Messages at the beginning that are looked at for topics: some seconds of a robot.
const HEAD_MESSAGES: usize = 5000;

/// What a topic holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum TopicKind {
    /// `sensor_msgs/Image`.
    Image,
    /// `sensor_msgs/CompressedImage`.
    CompressedImage,
    /// `sensor_msgs/CameraInfo`.
    CameraInfo,
    /// Anything else.
    Other,
}

impl TopicKind {
    /// Of a type as ROS 1 (`sensor_msgs/Image`) or ROS 2 (`sensor_msgs/msg/Image`) calls it.
    pub(crate) fn of(type_name: &str) -> Self {
        match type_name.replace("/msg/", "/").as_str() {
            "sensor_msgs/Image" => Self::Image,
            "sensor_msgs/CompressedImage" => Self::CompressedImage,
            "sensor_msgs/CameraInfo" => Self::CameraInfo,
            _ => Self::Other,
        }
    }

    fn is_image(self) -> bool {
        matches!(self, Self::Image | Self::CompressedImage)
    }
}

/// A topic of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Topic {
    /// As it was recorded.
    pub name: String,
    /// What it holds.
    pub kind: TopicKind,
}

/// Reads the messages of a file.
type Reader = fn(&Path) -> Result<Messages, BagError>;

/// How a file is read, by its first bytes; `None` where it is something else.
fn reader_of(path: &Path) -> std::io::Result<Option<Reader>> {
    let mut head = Vec::new();
    File::open(path)?.take(16).read_to_end(&mut head)?;
    let formats: [(&[u8], Reader); 3] = [
        (mcap::MAGIC, mcap::messages),
        (sqlite::MAGIC, db3::messages),
        (ros1::MAGIC, ros1::messages),
    ];
    let mut formats = formats.into_iter();
    let found = formats.find(|(magic, _)| head.starts_with(magic));
    Ok(found.map(|(_, reader)| reader))
}

/// Messages one after the other.
pub(crate) type Messages = Box<dyn Iterator<Item = Result<Raw, BagError>> + Send>;

/// Images with their times, ns.
pub type Images = Box<dyn Iterator<Item = Result<(i64, GrayImage), BagError>> + Send>;

/// A recording.
#[derive(Debug)]
pub struct Bag {
    path: PathBuf,
    /// The files it is made of, in the order of time.
    files: Vec<(PathBuf, Reader)>,
    topics: Vec<Topic>,
    /// The first calibration of each topic.
    infos: BTreeMap<String, CameraInfo>,
}

/// Whether a path is a recording, or the folder of one.
#[must_use]
pub fn is_bag(path: &Path) -> bool {
    files_of(path).is_ok_and(|files| !files.is_empty())
}

/// The files of a recording; none where it is something else.
fn files_of(path: &Path) -> std::io::Result<Vec<(PathBuf, Reader)>> {
    let kind = std::fs::metadata(path)?;
    // a camera or a pipe is not read to find out what it is
    if kind.is_file() {
        let reader = reader_of(path)?.into_iter();
        return Ok(reader.map(|reader| (path.to_owned(), reader)).collect());
    }
    if !kind.is_dir() || !path.join("metadata.yaml").is_file() {
        return Ok(Vec::new());
    }
    let mut files = Vec::new();
    for entry in std::fs::read_dir(path)? {
        let file = entry?.path();
        if let Ok(Some(reader)) = reader_of(&file) {
            files.push((file, reader));
        }
    }
    // parts are numbered: name_2 comes before name_10
    files.sort_by_key(|(file, _)| {
        let name = file.to_string_lossy().into_owned();
        (name.len(), name)
    });
    Ok(files)
}

impl Bag {
    /// Opens a recording and looks at what it begins with.
    ///
    /// # Errors
    /// What is none, or damaged at its beginning.
    pub fn open(path: &Path) -> Result<Self, BagError> {
        let files = files_of(path).map_err(BagError::io(path))?;
        if files.is_empty() {
            return Err(BagError::damaged(
                path,
                "begins neither as MCAP, as SQLite nor as a ROS 1 bag: expected a .mcap, .db3 or .bag file, or the folder of a rosbag2",
            ));
        }
        let mut bag = Self {
            path: path.to_owned(),
            files,
            topics: Vec::new(),
            infos: BTreeMap::new(),
        };
        let mut kinds = BTreeMap::new();
        for message in bag.messages().take(HEAD_MESSAGES) {
            let message = match message {
                Ok(message) => message,
                // what was read before the damage can still be used
                Err(_) if !kinds.is_empty() => break,
                Err(error) => return Err(error),
            };
            kinds.insert(message.topic.to_string(), message.kind);
            if message.kind == TopicKind::CameraInfo && !bag.infos.contains_key(&*message.topic) {
                let info = content(&message, &bag.path)?;
                bag.infos.insert(message.topic.to_string(), info);
            }
        }
        let topics = kinds.into_iter();
        bag.topics = topics.map(|(name, kind)| Topic { name, kind }).collect();
        Ok(bag)
    }

    /// The topics at the beginning, by name.
    #[must_use]
    pub fn topics(&self) -> &[Topic] {
        &self.topics
    }

    /// The topic of images that is named, or the only one.
    ///
    /// # Errors
    /// When there is none, or several could be meant; says which there are.
    pub fn image_topic(&self, name: Option<&str>) -> Result<&Topic, BagError> {
        let images = self.topics.iter().filter(|topic| topic.kind.is_image());
        let images: Vec<&Topic> = images.collect();
        let found = match name {
            Some(name) => images.iter().find(|topic| topic.name == name),
            None => images.first().filter(|_| images.len() == 1),
        };
        if let Some(found) = found {
            return Ok(found);
        }
        let names: Vec<&str> = images.iter().map(|topic| topic.name.as_str()).collect();
        let names = names.join(", ");
        let reason = match name {
            _ if images.is_empty() => "there is no topic with images at its beginning".to_owned(),
            None => format!("images of which topic? there are {names}"),
            Some(name) => format!("no images of {name}: there are {names}"),
        };
        Err(BagError::damaged(&self.path, reason))
    }

    /// The camera of a topic of images: by the calibration in the same namespace, where there is one.
    ///
    /// # Errors
    /// A calibration that is not understood.
    pub fn camera_of(&self, topic: &Topic) -> Result<Option<Camera>, BagError> {
        // /camera/image_raw and /camera/image_raw/compressed belong to /camera/camera_info
        let namespaces = std::iter::successors(Some(topic.name.as_str()), |name| {
            name.rsplit_once('/').map(|(above, _)| above)
        });
        for namespace in namespaces.skip(1) {
            let name = format!("{namespace}/camera_info");
            if let Some(info) = self.infos.get(&name) {
                let is_rectified = topic.name.contains("image_rect");
                let camera = camera_of(info, is_rectified);
                return camera.map(Some).map_err(|source| BagError::Info {
                    topic: name,
                    source,
                });
            }
        }
        Ok(None)
    }

    /// All images of a topic, in the order of the recording.
    #[must_use]
    pub fn images(&self, topic: &Topic) -> Images {
        let (name, path) = (topic.name.clone(), self.path.clone());
        Box::new(self.messages().filter_map(move |message| match message {
            Ok(message) if *message.topic != *name => None,
            Ok(message) => Some(decoded(&message, &path)),
            Err(error) => Some(Err(error)),
        }))
    }

    /// All messages of all files; after an error of a file comes the next one.
    fn messages(&self) -> Messages {
        let files = self.files.clone().into_iter();
        Box::new(files.flat_map(|(path, messages)| {
            messages(&path).unwrap_or_else(|error| Box::new(std::iter::once(Err(error))))
        }))
    }
}

/// What is in a message of the recording at `path`.
fn content<M: RosMessage>(message: &Raw, path: &Path) -> Result<M, BagError> {
    let damaged = |reason| BagError::damaged(path, format!("topic {}: {reason}", message.topic));
    message.content().map_err(damaged)
}

/// The image of a message and its time.
fn decoded(message: &Raw, path: &Path) -> Result<(i64, GrayImage), BagError> {
    let (stamp, image) = if message.kind == TopicKind::Image {
        let image: Image = content(message, path)?;
        (image.header.stamp, gray_image(&image))
    } else {
        let image: CompressedImage = content(message, path)?;
        (image.header.stamp, gray_of_compressed(&image))
    };
    let image = image.map_err(|source| BagError::Image {
        topic: message.topic.to_string(),
        source,
    })?;
    // drivers that do not set it leave 0
    let time_ns = match stamp.nanoseconds() {
        0 => message.log_ns,
        stamp_ns => stamp_ns,
    };
    Ok((time_ns, image))
}
