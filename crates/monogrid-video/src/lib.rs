//! Frames of video files, cameras and streams: 8-bit grey images with times in nanoseconds.
//!
//! [`Video::open`] takes what a person would name and yields [`VideoFrame`]s one by one:
//!
//! | named | decoded by |
//! |---|---|
//! | MP4 or MOV with H.264 | this process (`rust_h264`) |
//! | AVI with MJPEG, YUV4MPEG2, `-` or a named pipe (YUV4MPEG2) | this process |
//! | `/dev/video0` | this process: YUYV, MJPEG or grey of a V4L2 camera (Linux) |
//! | `http://...` that answers with MJPEG (a phone as camera) | this process |
//! | rosbag2 (`.mcap`, `.db3`) and ROS 1 bags, by [`Video::open_recording`] | this process (`monogrid-bags`) |
//! | every other file, `rtsp://...` and other addresses | the program `ffmpeg`, when it is installed |
//!
//! Images are luma; the colour of a frame comes beside it, as small as its source has it ([`Colour`]).
//! Never more than a few frames are in memory. Times are those of the container or camera (variable
//! rates, edit lists and reordered frames are understood), never number over rate, except where the
//! format knows only a rate (AVI, YUV4MPEG2). Videos that were filmed upright come out upright.
//!
//! ```no_run
//! let video = monogrid_video::Video::open("video.mp4")?;
//! println!("{}", video.description());
//! for frame in video {
//!     let frame = frame?;
//!     println!("{} ns: {}x{}", frame.timestamp_ns, frame.image.width(), frame.image.height());
//! }
//! # Ok::<(), monogrid_video::VideoError>(())
//! ```
//!
//! Everything that comes from outside is checked: a damaged or hostile file is an error, never a panic,
//! a hang, or memory without bounds. A source is opened and read in a thread of its own: one that stalls
//! costs whoever waits for it no more than their [`Patience`].
#![deny(missing_docs)]

mod aside;
mod avi;
mod camera;
mod colour;
mod error;
mod ffmpeg;
mod h264;
mod http;
mod mp4;
mod program;
mod recording;
mod turn;
mod y4m;

pub use aside::{Aside, Patience, Sink, Waited};
pub use camera::{CameraInfo, list_cameras};
pub use colour::{Chroma, Colour, ColourSpace};
pub use error::VideoError;
pub use monogrid_bags::is_bag as is_recording;

use monogrid_datasets::decode_jpeg_luma;
use monogrid_geometry::{Camera, ReadoutDirection};
use monogrid_image::Image;
use program::Program;
use std::collections::VecDeque;
use std::fs::File;
use std::io::{BufReader, Read, Seek};
use std::path::{Path, PathBuf};
use std::time::Duration;
use turn::Turn;

/// An 8-bit grey image.
pub type Grey = Image<u8>;

/// Most pixels of a frame: 8K and a half; more is taken for damage.
pub(crate) const MAX_PIXELS: usize = 1 << 26;

/// Bytes by which files are told apart.
const SNIFFED_BYTES: usize = 16;

/// One frame.
#[derive(Clone, Debug, PartialEq)]
pub struct VideoFrame {
    /// Luma as the source has it (not stretched to the full range), upright.
    pub image: Grey,
    /// What it shows beside luma.
    pub colour: Colour,
    /// Time, nanoseconds: of the container for files, since the first frame for cameras and streams.
    pub timestamp_ns: i64,
}

/// What every decoder yields.
pub(crate) type Frames = Box<dyn Iterator<Item = Result<VideoFrame, VideoError>> + Send>;

/// An open video, camera or stream: an iterator over its frames in the order of time.
///
/// An error that [is of a single frame](VideoError::is_single_frame) may be followed by more frames,
/// any other is the last item.
pub struct Video {
    name: String,
    begun: Begun,
    messages: Aside<Message>,
    program: Program,
    last_ns: Option<i64>,
    repaired: usize,
    ended: bool,
}

/// What the thread that reads has to say.
enum Message {
    /// First of all.
    Begun(Result<Begun, VideoError>),
    /// Then the frames, the first one too.
    Frame(Result<VideoFrame, VideoError>),
}

/// What is known from the first frame on.
struct Begun {
    description: String,
    length: Option<usize>,
    live: bool,
    turn: Turn,
    size: (usize, usize),
    camera: Option<Camera>,
}

/// A decoder and what is known before the first frame.
pub(crate) struct Opened {
    pub(crate) description: String,
    pub(crate) length: Option<usize>,
    pub(crate) live: bool,
    /// How frames were turned to be upright.
    pub(crate) turn: Turn,
    pub(crate) frames: Frames,
}

/// A decoder whose first frame was read.
struct Started {
    begun: Begun,
    /// What was read for that.
    ahead: VecDeque<Result<VideoFrame, VideoError>>,
    frames: Frames,
}

/// Frames without an image that are read before a video is given up when it is opened.
const MAX_UNREADABLE_AT_START: usize = 10;

/// A source, opened and read in the thread that reads.
struct Source {
    path: PathBuf,
    name: String,
    program: Program,
}

impl Source {
    /// Opens a file, a pipe, a camera or an address and decodes its first frame.
    fn start(&self) -> Result<Started, VideoError> {
        let (path, name) = (&self.path, &self.name);
        let opened = if name == "-" {
            open_y4m(name, std::io::stdin())?
        } else if name.starts_with("http://") {
            match http::open(name)? {
                Some(stream) => stream,
                None => ffmpeg::open(name, "not an MJPEG stream", &self.program)?,
            }
        } else if name.contains("://") {
            ffmpeg::open(name, "a network stream", &self.program)?
        } else if camera::is_camera(path) {
            camera::open(path)?
        } else if is_pipe(path) {
            open_y4m(name, File::open(path).map_err(|e| VideoError::io(name, e))?)?
        } else {
            return self.start_file();
        };
        Started::new(name, opened)
    }

    /// A file that is decoded here if possible, otherwise by ffmpeg.
    fn start_file(&self) -> Result<Started, VideoError> {
        let found = match open_here(&self.path, &self.name)? {
            Ok(opened) => match Started::new(&self.name, opened) {
                // the first frame is the first that shows what the decoder cannot do
                Err(VideoError::Frame { reason, .. }) => reason,
                outcome => return outcome,
            },
            Err(found) => found,
        };
        Started::new(&self.name, ffmpeg::open(&self.name, &found, &self.program)?)
    }

    /// A topic of a recording.
    fn start_recording(&self, topic: Option<&str>) -> Result<Started, VideoError> {
        let (opened, camera) = recording::open(&self.path, &self.name, topic)?;
        let mut started = Started::new(&self.name, opened)?;
        started.begun.camera = camera;
        Ok(started)
    }
}

impl Started {
    /// Reads the first frame, for the size.
    fn new(name: &str, opened: Opened) -> Result<Self, VideoError> {
        let mut ahead = VecDeque::new();
        let mut frames = opened.frames;
        for _ in 0..MAX_UNREADABLE_AT_START {
            match frames.next() {
                Some(Ok(frame)) => {
                    let size = (frame.image.width(), frame.image.height());
                    ahead.push_back(Ok(frame));
                    return Ok(Self {
                        begun: Begun {
                            description: opened.description,
                            length: opened.length,
                            live: opened.live,
                            turn: opened.turn,
                            size,
                            camera: None,
                        },
                        ahead,
                        frames,
                    });
                }
                Some(Err(error)) if error.is_single_frame() => ahead.push_back(Err(error)),
                Some(Err(error)) => return Err(error),
                None => break,
            }
        }
        Err(match ahead.pop_front() {
            Some(Err(error)) => error,
            _ => VideoError::content(name, "video", "no frames", "at least one"),
        })
    }

    /// Hands everything over, until nobody wants more.
    fn read(self, sink: &Sink<Message>) {
        if !sink.put(Message::Begun(Ok(self.begun))) {
            return;
        }
        for frame in self.ahead.into_iter().chain(self.frames) {
            if !sink.put(Message::Frame(frame)) {
                return;
            }
        }
    }
}

impl Video {
    /// Opens a file, `-`, a camera (`/dev/video0`) or an address and decodes its first frame, with the
    /// [usual patience](Patience::usual).
    ///
    /// # Errors
    /// When it is not there, cannot be decoded (also not by ffmpeg), or has no frame.
    pub fn open(source: impl AsRef<Path>) -> Result<Self, VideoError> {
        let patience = Patience::usual(source.as_ref());
        Self::open_within(source, patience)
    }

    /// As [`Self::open`], and waits for the source as long as one likes, now and for each frame.
    ///
    /// # Errors
    /// Those of [`Self::open`], and when it takes too long or is interrupted.
    pub fn open_within(source: impl AsRef<Path>, patience: Patience) -> Result<Self, VideoError> {
        Self::begin(source.as_ref(), patience, Source::start)
    }

    /// Opens a recording of a robot ([`is_recording`]): the images of a topic, or of the only one that has some, and the camera
    /// by the calibration that was recorded with them.
    ///
    /// # Errors
    /// When it cannot be read, or no topic or several could be meant; when it takes too long or is interrupted.
    pub fn open_recording(
        source: impl AsRef<Path>,
        topic: Option<&str>,
        patience: Patience,
    ) -> Result<(Self, Option<Camera>), VideoError> {
        let topic = topic.map(str::to_owned);
        let start = move |source: &Source| source.start_recording(topic.as_deref());
        let video = Self::begin(source.as_ref(), patience, start)?;
        let camera = video.begun.camera;
        Ok((video, camera))
    }

    fn begin(
        path: &Path,
        patience: Patience,
        start: impl FnOnce(&Source) -> Result<Started, VideoError> + Send + 'static,
    ) -> Result<Self, VideoError> {
        let name = path.to_string_lossy().into_owned();
        let program = Program::default();
        let source = Source {
            path: path.to_path_buf(),
            name: name.clone(),
            program: program.clone(),
        };
        let work = move |sink: &Sink<Message>| match start(&source) {
            Ok(started) => started.read(sink),
            Err(error) => {
                sink.put(Message::Begun(Err(error)));
            }
        };
        let messages = Aside::start("source", patience, work);
        let mut messages = messages.map_err(|e| VideoError::io(&name, e))?;
        let begun = match messages.wait() {
            Waited::Item(Message::Begun(begun)) => begun,
            waited => Err(not_begun(&name, &waited)),
        };
        match begun {
            Ok(begun) => Ok(Self {
                name,
                begun,
                messages,
                program,
                last_ns: None,
                repaired: 0,
                ended: false,
            }),
            Err(error) => {
                program.end();
                Err(error)
            }
        }
    }

    /// What was opened.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Container and codec, for people.
    #[must_use]
    pub fn description(&self) -> &str {
        &self.begun.description
    }

    /// Number of frames where the container says it; frames that cannot be decoded are among them.
    #[must_use]
    pub fn length(&self) -> Option<usize> {
        self.begun.length
    }

    /// Whether frames come as they happen and do not wait.
    #[must_use]
    pub fn is_live(&self) -> bool {
        self.begun.live
    }

    /// Width and height of the first frame, px.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        self.begun.size
    }

    /// Which way over its images a rolling shutter runs.
    #[must_use]
    pub fn readout_direction(&self) -> ReadoutDirection {
        self.begun.turn.readout_direction(self.begun.size)
    }

    /// Frames so far whose time did not come after that of the frame before and was set right behind it.
    #[must_use]
    pub fn repaired_times(&self) -> usize {
        self.repaired
    }

    /// CPU time of reading until the last frame.
    #[must_use]
    pub fn cpu(&self) -> Duration {
        self.messages.cpu()
    }

    /// Times that increase: containers written by editors repeat times, or swap them by microseconds.
    fn increasing(&mut self, mut frame: VideoFrame) -> VideoFrame {
        if let Some(last_ns) = self.last_ns
            && frame.timestamp_ns <= last_ns
        {
            frame.timestamp_ns = last_ns.saturating_add(1);
            self.repaired += 1;
        }
        self.last_ns = Some(frame.timestamp_ns);
        frame
    }
}

impl Iterator for Video {
    type Item = Result<VideoFrame, VideoError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.ended {
            return None;
        }
        let item = match self.messages.wait() {
            Waited::Item(Message::Frame(frame)) => Some(frame),
            // whoever interrupted knows why there are no more
            Waited::Item(Message::Begun(_)) | Waited::Ended | Waited::Interrupted => None,
            Waited::TooLong(limit) => Some(Err(stalled(&self.name, limit))),
        };
        self.ended = match &item {
            None => true,
            Some(Err(error)) => !error.is_single_frame(),
            Some(Ok(_)) => false,
        };
        item.map(|item| item.map(|frame| self.increasing(frame)))
    }
}

impl Drop for Video {
    fn drop(&mut self) {
        self.program.end();
    }
}

fn stalled(name: &str, limit: Duration) -> VideoError {
    VideoError::Stalled {
        video: name.to_owned(),
        seconds: limit.as_secs_f64(),
    }
}

/// Why there is not even a first frame.
fn not_begun(name: &str, waited: &Waited<Message>) -> VideoError {
    match waited {
        Waited::TooLong(limit) => stalled(name, *limit),
        Waited::Interrupted => VideoError::Interrupted {
            video: name.to_owned(),
        },
        Waited::Item(_) | Waited::Ended => {
            VideoError::content(name, "video", "no frames", "at least one")
        }
    }
}

/// Whether a path names a pipe, which is read once: YUV4MPEG2 as on standard input.
#[must_use]
pub fn is_pipe(path: &Path) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt;
        std::fs::metadata(path).is_ok_and(|metadata| metadata.file_type().is_fifo())
    }
    #[cfg(not(unix))]
    {
        let _ = path;
        false
    }
}

impl std::fmt::Debug for Video {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Video")
            .field("name", &self.name)
            .field("description", &self.begun.description)
            .field("length", &self.begun.length)
            .field("size", &self.begun.size)
            .finish_non_exhaustive()
    }
}

/// What this process makes of a file; or what it is, where it cannot decode it.
pub(crate) type Here = Result<Opened, String>;

fn open_here(path: &Path, name: &str) -> Result<Here, VideoError> {
    let io = |e| VideoError::io(name, e);
    let mut file = File::open(path).map_err(io)?;
    let metadata = file.metadata().map_err(io)?;
    let unusable =
        |found: &str, expected: &str| VideoError::content(name, "video", found, expected);
    if !metadata.is_file() {
        return Err(unusable("a folder or device", "a video file"));
    }
    let mut head = Vec::new();
    (&mut file)
        .take(SNIFFED_BYTES as u64)
        .read_to_end(&mut head)
        .map_err(io)?;
    file.rewind().map_err(io)?;
    match head.as_slice() {
        [] => Err(unusable("an empty file", "a video")),
        head if head.starts_with(y4m::MAGIC) => Ok(Ok(open_y4m(name, file)?)),
        [b'R', b'I', b'F', b'F', _, _, _, _, b'A', b'V', b'I', ..] => avi::open(name, file),
        [_, _, _, _, b'f', b't', b'y', b'p', ..]
        | [_, _, _, _, b'm', b'o', b'o', b'v', ..]
        | [_, _, _, _, b'm', b'd', b'a', b't', ..]
        | [_, _, _, _, b'w', b'i', b'd', b'e', ..] => h264::open(name, file, metadata.len()),
        _ => Ok(Err("a format that is not read directly".to_owned())),
    }
}

fn open_y4m(name: &str, reader: impl Read + Send + 'static) -> Result<Opened, VideoError> {
    let frames = y4m::Y4mReader::new(name, BufReader::with_capacity(1 << 20, reader))?;
    Ok(Opened {
        description: "YUV4MPEG2".to_owned(),
        length: None,
        live: false,
        turn: Turn::None,
        frames: Box::new(frames),
    })
}

/// The frame in a JPEG file, number `frame` of its video.
pub(crate) fn jpeg_frame(
    video: &str,
    frame: usize,
    jpeg: Vec<u8>,
    timestamp_ns: i64,
) -> Result<VideoFrame, VideoError> {
    let image = decode_jpeg_luma(&jpeg, MAX_PIXELS, Path::new(video));
    Ok(VideoFrame {
        image: image.map_err(|e| VideoError::frame(video, frame, e.to_string()))?,
        colour: Colour::Jpeg(jpeg),
        timestamp_ns,
    })
}

/// Time of a frame, nanoseconds, at so many frames per second: numerator and denominator.
pub(crate) fn time_at_rate(frame: usize, (numerator, denominator): (u64, u64)) -> i64 {
    let seconds_e9 = frame as u128 * u128::from(denominator) * 1_000_000_000;
    i64::try_from(seconds_e9 / u128::from(numerator)).unwrap_or(i64::MAX)
}
