//! Recordings of robots: the images of one topic.

use crate::frame::VideoFrame;
use crate::h264::PacketFrames;
use crate::opened::{Opened, stored_bytes};
use crate::{Colour, VideoError};
use monogrid_bags::{Bag, BagError, TopicKind, listed};
use monogrid_datasets::PixelBudget;
use monogrid_geometry::Camera;
use monogrid_image::{GrayImage, to_gray8};
use std::path::Path;

/// The camera that a recording says, where it says one, or why it cannot be used: another may be
/// given in its place.
pub type Recorded = Result<Option<Camera>, BagError>;

/// The topic that is read, and all that there are, for people.
pub(crate) struct Topics {
    read: String,
    all: String,
}

impl Topics {
    /// Why there is no image, and what else there is.
    pub(crate) fn without_image(&self, name: &str, error: VideoError) -> VideoError {
        let reason = match error {
            VideoError::Frame { reason, .. } => reason,
            VideoError::Content { found, .. } => found,
            VideoError::Recording(error @ BagError::Damaged { .. }) => error.to_string(),
            error => return error,
        };
        let Self { read, all } = self;
        let found = format!("no image that can be read on {read}: {reason}; there are {all}");
        let expected = "images, or video that is coded as h264; another topic: --topic NAME";
        VideoError::content(name, "recording", found, expected)
    }
}

/// Opens a topic of a recording, or the only one with images; with the camera that the recording
/// says.
pub(crate) fn open(
    path: &Path,
    name: &str,
    topic: Option<&str>,
) -> Result<(Opened, Recorded, Topics), VideoError> {
    let bag = Bag::open(path)?;
    let topic = bag.image_topic(topic)?;
    let topics = Topics {
        read: topic.to_string(),
        all: listed(bag.topics()),
    };
    // another calibration may take its place
    let camera = bag.camera_of(topic);
    let description = format!("recording, topic {}", topic.name);
    if topic.kind == TopicKind::CompressedVideo {
        let budget = stored_bytes(path).map(|bytes| PixelBudget::of_source(path, bytes));
        let frames = PacketFrames::new(name, bag.packets(topic), budget);
        let opened = Opened::new(description, Box::new(frames));
        return Ok((opened, camera, topics));
    }
    let levels = bag.levels(topic);
    let images = bag.images_in(topic, levels);
    let name = name.to_owned();
    let frame = move |(frame, image): (usize, Result<(i64, GrayImage), BagError>)| match image {
        Ok((timestamp_ns, image)) => Ok(VideoFrame {
            image: image.map(to_gray8),
            colour: Colour::Grey,
            timestamp_ns,
        }),
        Err(error) if error.is_single_frame() => {
            Err(VideoError::frame(&name, frame, error.to_string()))
        }
        Err(error) => Err(error.into()),
    };
    let mut opened = Opened::new(description, Box::new(images.enumerate().map(frame)));
    opened.notes.extend(levels.note());
    Ok((opened, camera, topics))
}
