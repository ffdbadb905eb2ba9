//! Videos, cameras and streams as a source.

use crate::args::SourceArgs;
use crate::input::frame_colours::FrameColours;
use crate::process::failure::Failure;
use monogrid_geometry::ReadoutDirection;
use monogrid_image::GrayImage;
use monogrid_pipeline::Unusable;
use monogrid_video::{Patience, Recorded, Video, VideoError, is_pipe, is_recording, is_video_file};
use std::ffi::OsStr;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

/// A video that is read from its beginning, or a stream that is read once.
#[derive(Debug)]
pub struct VideoSource {
    /// What was opened.
    pub path: PathBuf,
    /// The topic of a recording.
    topic: Option<String>,
    /// The camera that a recording says, or why it cannot be used.
    pub recorded: Recorded,
    /// For people.
    pub description: String,
    /// Width and height of the first frame, px.
    pub size: (usize, usize),
    /// As it is stored, where its pixels are not square: a calibration may be for this size.
    pub stored_size: (usize, usize),
    /// How it was understood, in sentences.
    pub notes: Vec<String>,
    /// Frames of the longest reading, and what was wrong with them, in sentences.
    faults: Mutex<(usize, Vec<String>)>,
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
    patience: Patience,
    /// CPU time of the last reading, ns.
    pub cpu_ns: AtomicU64,
}

/// A frame as it comes: number, time in nanoseconds, image or why there is none.
pub type VideoItem = (usize, i64, Result<GrayImage, Unusable>);

/// Endings of files that are no videos: they have readers of their own, or none.
const NO_VIDEOS: [&str; 16] = [
    "txt", "zip", "tar", "gz", "tgz", "mgk", "ot", "bt", "mgo", "ply", "pcd", "stl", "toml",
    "yaml", "json", "csv",
];

/// Whether a source is a video, a camera or a stream, files by their content; everything else is
/// images.
pub fn is_video(source: &Path) -> bool {
    let name = source.to_string_lossy();
    if name == "-" || name.contains("://") || name.starts_with("/dev/video") {
        return true;
    }
    let may_be_video = |ending: &OsStr| {
        let ending = ending.to_string_lossy().to_lowercase();
        !NO_VIDEOS.contains(&ending.as_str())
    };
    if is_pipe(source) || is_video_file(source) || is_recording(source) {
        return true;
    }
    // formats that only ffmpeg knows
    source.is_file() && source.extension().is_some_and(may_be_video)
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
fn open_source(
    path: &Path,
    topic: Option<&str>,
    patience: Patience,
) -> Result<(Video, Recorded), VideoError> {
    if is_recording(path) {
        return Video::open_recording(path, topic, patience);
    }
    Ok((Video::open_within(path, patience)?, Ok(None)))
}

/// A source that cannot be opened is bad input, unless it may be better the next time.
fn not_opened(error: VideoError) -> Failure {
    match error {
        VideoError::Interrupted { .. } => Failure::Interrupted,
        VideoError::Stalled { .. } | VideoError::BrokeOff { .. } => Failure::running(error),
        error => Failure::Input(error.into()),
    }
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
        let patience = args.patience(path);
        // asked before it is opened: a file that is removed meanwhile is still no stream
        let is_file = path.is_file() || is_recording(path);
        let opened = open_source(path, topic.as_deref(), patience);
        let (video, recorded) = opened.map_err(not_opened)?;
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
            recorded,
            description: video.description().to_owned(),
            size: video.size(),
            stored_size: video.stored_size(),
            notes: video.notes().to_vec(),
            faults: Mutex::default(),
            direction: video.readout_direction(),
            expected_frames: left.map(|left| left.min(max_frames.unwrap_or(left))),
            start,
            every,
            max_frames: max_frames.unwrap_or(usize::MAX),
            is_file,
            opened: Mutex::new(Some(video)),
            patience,
            cpu_ns: AtomicU64::new(0),
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

    /// What was wrong with the frames of the longest reading, in sentences.
    pub fn faults(&self) -> Vec<String> {
        let faults = self.faults.lock();
        faults.unwrap_or_else(PoisonError::into_inner).1.clone()
    }

    /// The frames to use, in order; their colours go to `colours`. A stream has them only once.
    pub fn frames<'a>(
        &'a self,
        colours: Option<&'a FrameColours>,
    ) -> Box<dyn Iterator<Item = VideoItem> + Send + 'a> {
        let opened = self.opened.lock().ok().and_then(|mut opened| opened.take());
        let video = match opened {
            Some(video) => Ok(video),
            None if self.is_file => {
                let topic = self.topic.as_deref();
                open_source(&self.path, topic, self.patience).map(|(video, _)| video)
            }
            None => return broken_off(self.start, "the stream was read before"),
        };
        let mut video = match video {
            Ok(video) => video,
            // whoever interrupted knows why there are none
            Err(VideoError::Interrupted { .. }) => return Box::new(std::iter::empty()),
            Err(error) => return broken_off(self.start, error),
        };
        let mut num_read = 0;
        let items = std::iter::from_fn(move || {
            let item = video.next();
            let cpu_ns = video.cpu().as_nanos() as u64;
            self.cpu_ns.store(cpu_ns, Ordering::Relaxed);
            num_read += usize::from(item.is_some());
            let faults = self.faults.lock();
            let mut faults = faults.unwrap_or_else(PoisonError::into_inner);
            if num_read >= faults.0 {
                *faults = (num_read, video.faults());
            }
            item
        });
        // the end is said also where it does not come at a frame to use
        let is_used = |(index, item): &(usize, Result<_, VideoError>)| {
            let is_end = item.as_ref().is_err_and(|e| !e.is_single_frame());
            is_end || (*index >= self.start && (index - self.start).is_multiple_of(self.every))
        };
        let used = items.enumerate().filter(is_used);
        let mut last_ns = 0;
        Box::new(used.take(self.max_frames).map(move |(index, item)| {
            let image = item.map(|frame| {
                last_ns = frame.timestamp_ns;
                if let Some(colours) = colours {
                    colours.arrive(index, frame.colour);
                }
                frame.image.map(f32::from)
            });
            // a frame without an image has no time either: right after the one before
            last_ns += i64::from(image.is_err());
            (index, last_ns, image.map_err(unusable))
        }))
    }
}

/// Nothing but the reason.
fn broken_off(index: usize, reason: impl ToString) -> Box<dyn Iterator<Item = VideoItem> + Send> {
    let reason = Unusable::BrokeOff(reason.to_string());
    Box::new(std::iter::once((index, 0, Err(reason))))
}

fn unusable(error: VideoError) -> Unusable {
    match error.is_single_frame() {
        true => Unusable::Unreadable(error.to_string()),
        false => Unusable::BrokeOff(error.to_string()),
    }
}
