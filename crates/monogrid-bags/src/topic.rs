//! What a topic is called and what it holds.

use std::fmt;

/// What a topic holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum TopicKind {
    /// Pixels: `sensor_msgs/Image`, `foxglove.RawImage`.
    Image,
    /// Files of images: `sensor_msgs/CompressedImage`, `foxglove.CompressedImage`.
    CompressedImage,
    /// The packets of a video: `foxglove.CompressedVideo`.
    CompressedVideo,
    /// Calibrations: `sensor_msgs/CameraInfo`, `foxglove.CameraCalibration`.
    CameraInfo,
    /// Readings of inertial sensors: `sensor_msgs/Imu`.
    Imu,
    /// Poses of frames: `tf2_msgs/TFMessage`.
    Transforms,
    /// Anything else.
    Other,
}

/// Whose definition a message follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Family {
    Ros,
    Foxglove,
}

/// Kind and family of a type as ROS 1 (`sensor_msgs/Image`), ROS 2 (`sensor_msgs/msg/Image`) or
/// Foxglove (`foxglove.RawImage`) calls it.
fn kind_of(type_name: &str) -> (TopicKind, Family) {
    let name = type_name
        .replace("/msg/", "/")
        .replace("foxglove_msgs/", "foxglove.");
    match name.as_str() {
        "sensor_msgs/Image" => (TopicKind::Image, Family::Ros),
        "sensor_msgs/CompressedImage" => (TopicKind::CompressedImage, Family::Ros),
        "sensor_msgs/CameraInfo" => (TopicKind::CameraInfo, Family::Ros),
        "sensor_msgs/Imu" => (TopicKind::Imu, Family::Ros),
        "tf2_msgs/TFMessage" | "tf/tfMessage" => (TopicKind::Transforms, Family::Ros),
        "foxglove.RawImage" => (TopicKind::Image, Family::Foxglove),
        "foxglove.CompressedImage" => (TopicKind::CompressedImage, Family::Foxglove),
        "foxglove.CompressedVideo" => (TopicKind::CompressedVideo, Family::Foxglove),
        "foxglove.CameraCalibration" => (TopicKind::CameraInfo, Family::Foxglove),
        _ => (TopicKind::Other, Family::Ros),
    }
}

/// A topic of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Topic {
    /// As it was recorded.
    pub name: String,
    /// What it holds.
    pub kind: TopicKind,
    /// What the type of its messages is called.
    pub type_name: String,
    pub(crate) family: Family,
}

impl Topic {
    pub(crate) fn new(name: &str, type_name: &str) -> Self {
        let (kind, family) = kind_of(type_name);
        Self {
            name: name.to_owned(),
            kind,
            type_name: type_name.to_owned(),
            family,
        }
    }

    /// Whether it has pictures, or something that is taken for such.
    pub(crate) fn has_images(&self) -> bool {
        matches!(
            self.kind,
            TopicKind::Image | TopicKind::CompressedImage | TopicKind::CompressedVideo
        )
    }

    /// Whether what it has is depth by its name, which image_transport gives.
    pub(crate) fn is_depth(&self) -> bool {
        self.name.ends_with("/compressedDepth")
    }
}

impl fmt::Display for Topic {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{} ({})", self.name, self.type_name)
    }
}

/// Names and types of topics, for people.
#[must_use]
pub fn listed<'a>(topics: impl IntoIterator<Item = &'a Topic>) -> String {
    let topics = topics.into_iter().map(Topic::to_string);
    topics.collect::<Vec<_>>().join(", ")
}

/// A topic, and how many messages it has, where an index says it.
pub(crate) struct Indexed {
    pub topic: Topic,
    pub messages: Option<u64>,
}
