//! Videos, cameras and streams as a source.

use crate::args::SourceArgs;
use crate::failure::{Classify, Failure};
use crate::frame_colours::FrameColours;
use monogrid_geometry::{Camera, ReadoutDirection};
use monogrid_image::GrayImage;
use monogrid_video::{Video, VideoError, is_recording};
use std::ffi::OsStr;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// A video that is read from its beginning, or a stream that is read once.
#[derive(Debug)]
pub struct VideoSource {
    /// What was opened.
    pub path: PathBuf,
    /// The topic of a recording.
    topic: Option<String>,
    /// The camera, where a recording says it.
    pub camera: Option<Camera>,
    /// For people.
    pub description: String,
    /// Width and height of the first frame, px.
    pub size: (usize, usize),
    /// Which way over its images a rolling shutter runs.
    pub direction: ReadoutDirection,
    /// Frames to use, where that is known.
    pub expected_frames: Option<usize>,
    /// First frame to use, every how many-th is, and how many at most.
    start: usize,
    every: usize,
    max_frames: usize,
    /// What was opened, until somebody reads it.
    opened: Mutex<Option<Video>>,
    /// Whether it can be read again.
    pub is_file: bool,
}

/// A frame as it comes: number, time in nanoseconds, image or why there is none.
pub type VideoItem = (usize, i64, Result<GrayImage, String>);

/// Endings of files that are no videos: they have readers of their own, or none.
const NO_VIDEOS: [&str; 14] = [
    "txt", "zip", "tar", "gz", "tgz", "mgk", "ot", "bt", "mgo", "ply", "toml", "yaml", "json",
    "csv",
];

/// Whether a source is a video, a camera or a stream; everything else is images.
pub fn is_video(source: &Path) -> bool {
    let name = source.to_string_lossy();
    if name == "-" || name.contains("://") || name.starts_with("/dev/video") {
        return true;
    }
    let may_be_video = |ending: &OsStr| {
        let ending = ending.to_string_lossy().to_lowercase();
        !NO_VIDEOS.contains(&ending.as_str())
    };
    let is_file = source.is_file() && source.extension().is_some_and(may_be_video);
    is_file || source.is_dir() && is_recording(source)
}

/// Refuses a topic of what has none.
pub fn check_topic(source: &Path, args: &SourceArgs) -> Result<(), Failure> {
    if args.topic.is_none() || is_recording(source) {
        return Ok(());
    }
    Err(Failure::input(format!(
        "--topic: {} is no recording of a robot (.mcap, .db3 or .bag)",
        source.display()
    )))
}

/// Opens a video, or the topic of a recording; with the camera that a recording says.
fn open_source(path: &Path, topic: Option<&str>) -> Result<(Video, Option<Camera>), VideoError> {
    if is_recording(path) {
        return Video::open_recording(path, topic);
    }
    Ok((Video::open(path)?, None))
}

impl VideoSource {
    /// Opens a video and reads its first frame.
    pub fn open(path: &Path, args: &SourceArgs) -> Result<Self, Failure> {
        let (start, max_frames) = (args.start, args.max_frames);
        let every = args.every.map_or(1, NonZeroUsize::get);
        if max_frames == Some(0) {
            return Err(Failure::input("--max-frames is 0, expected at least 1"));
        }
        let topic = args.topic.clone();
        let (video, camera) = open_source(path, topic.as_deref()).bad_input()?;
        let length = video.length();
        if length.is_some_and(|length| start >= length) {
            return Err(Failure::input(format!(
                "--start {start} is beyond the last frame of {}, which has {} frames",
                path.display(),
                length.unwrap_or_default()
            )));
        }
        let left = length.map(|length| (length - start).div_ceil(every));
        Ok(Self {
            path: path.to_path_buf(),
            topic,
            camera,
            description: video.description().to_owned(),
            size: video.size(),
            direction: video.readout_direction(),
            expected_frames: left.map(|left| left.min(max_frames.unwrap_or(left))),
            start,
            every,
            max_frames: max_frames.unwrap_or(usize::MAX),
            is_file: path.is_file() || is_recording(path),
            opened: Mutex::new(Some(video)),
        })
    }

    /// A name for people and folders: that of the file, camera or host.
    pub fn name(&self) -> String {
        let path = self.path.to_string_lossy();
        let stem = self.path.file_stem().unwrap_or_default().to_string_lossy();
        let name: &str = match path.split_once("://") {
            Some((_, address)) => address.split(['/', ':', '?']).next().unwrap_or_default(),
            None if path == "-" => "stdin",
            None => &stem,
        };
        if name.is_empty() { "video" } else { name }.to_owned()
    }

    /// The frames to use, in order; their colours go to `colours`. A stream has them only once.
    pub fn frames<'a>(
        &'a self,
        colours: Option<&'a FrameColours>,
    ) -> Box<dyn Iterator<Item = VideoItem> + Send + 'a> {
        let opened = self.opened.lock().ok().and_then(|mut opened| opened.take());
        let video = match opened {
            Some(video) => Ok(video),
            None if self.is_file => open_source(&self.path, self.topic.as_deref())
                .map(|(video, _)| video)
                .map_err(|e| e.to_string()),
            None => Err("the stream was read before".to_owned()),
        };
        let video = match video {
            Ok(video) => video,
            Err(reason) => return Box::new(std::iter::once((self.start, 0, Err(reason)))),
        };
        let mut last_ns = 0;
        let numbered = video.enumerate().skip(self.start).step_by(self.every);
        Box::new(numbered.take(self.max_frames).map(move |(index, item)| {
            let image = item.map(|frame| {
                last_ns = frame.timestamp_ns;
                if let Some(colours) = colours {
                    colours.arrive(index, frame.colour);
                }
                frame.image.map(f32::from)
            });
            // a frame without an image has no time either: right after the one before
            last_ns += i64::from(image.is_err());
            (index, last_ns, image.map_err(|e: VideoError| e.to_string()))
        }))
    }
}
