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
//! | rosbag2 and ROS 1 bags, by [`Video::open_recording`] | this process (`monogrid-bags`) |
//! | other files, `rtsp://...` and other addresses | the program `ffmpeg`, when it is installed |
//!
//! Images are luma; the colour of a frame comes beside it, as small as its source has it
//! ([`Colour`]). Never more than a few frames are in memory. Times are those of the container or
//! camera (variable rates, edit lists and reordered frames are understood), never number over rate,
//! except where the format knows only a rate (AVI, YUV4MPEG2). Videos that were filmed upright come
//! out upright.
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
//! Everything that comes from outside is checked: a damaged or hostile file is an error, never a
//! panic, a hang, or memory without bounds. A source is opened and read in a thread of its own: one
//! that stalls costs whoever waits for it no more than their [`Patience`].
#![deny(missing_docs)]

mod aside;
mod avi;
mod camera;
mod clock;
mod colour;
mod error;
mod ffmpeg;
mod frame;
mod h264;
mod http;
mod kind;
mod mp4;
mod opened;
mod pixels;
mod program;
mod recording;
mod turn;
mod y4m;

pub use aside::{Aside, Patience, Sink, Waited};
pub use camera::{CameraInfo, list_cameras};
pub use colour::{Chroma, Colour, ColourSpace};
pub use error::VideoError;
pub use frame::{Grey, VideoFrame};
pub use kind::is_video_file;
pub use monogrid_bags::is_bag as is_recording;
pub use mp4::read_telemetry;
pub use recording::Recorded;

use clock::Clock;
use frame::{Frames, MIN_FRAME_PIXELS};
use kind::Kind;
use monogrid_datasets::PixelBudget;
use monogrid_geometry::ReadoutDirection;
use opened::{Elsewhere, Here, Missing, Opened, stored_bytes};
use program::Program;
use std::collections::VecDeque;
use std::fs::File;
use std::io::{BufReader, Read, Seek};
use std::path::{Path, PathBuf};
use std::time::Duration;
use turn::Turn;

/// An open video, camera or stream: an iterator over its frames in the order of time.
///
/// An error that [is of a single frame](VideoError::is_single_frame) may be followed by more
/// frames, any other is the last item.
pub struct Video {
    name: String,
    begun: Begun,
    messages: Aside<Message>,
    program: Program,
    clock: Clock,
    /// What the frames may show together; `None` for what comes as it happens.
    budget: Option<PixelBudget>,
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
    stored_size: (usize, usize),
    notes: Vec<String>,
    missing: Missing,
    recorded: Recorded,
}

/// A decoder whose first frame was read.
struct Started {
    begun: Begun,
    /// From the first one on.
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
                None => self.by_ffmpeg(Elsewhere::new("not an MJPEG stream"))?,
            }
        } else if name.contains("://") {
            self.by_ffmpeg(Elsewhere::new("a network stream"))?
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
        let elsewhere = match open_here(&self.path, &self.name)? {
            Ok(opened) => match Started::new(&self.name, opened) {
                // the first frame is the first that shows what the decoder cannot do
                Err(VideoError::Frame { reason, .. }) => Elsewhere::new(reason),
                outcome => return outcome,
            },
            Err(elsewhere) => elsewhere,
        };
        Started::new(&self.name, self.by_ffmpeg(elsewhere)?)
    }

    fn by_ffmpeg(&self, elsewhere: Elsewhere) -> Result<Opened, VideoError> {
        ffmpeg::open(&self.name, &elsewhere, &self.program)
    }

    /// A topic of a recording.
    fn start_recording(&self, topic: Option<&str>) -> Result<Started, VideoError> {
        let (opened, camera, topics) = recording::open(&self.path, &self.name, topic)?;
        let started = Started::new(&self.name, opened);
        let mut started = started.map_err(|error| topics.without_image(&self.name, error))?;
        started.begun.recorded = camera;
        Ok(started)
    }
}

impl Started {
    /// Reads the first frame, for the size.
    fn new(name: &str, opened: Opened) -> Result<Self, VideoError> {
        let mut ahead = VecDeque::new();
        let pixels = opened.pixels;
        let mut frames = opened.frames;
        for _ in 0..MAX_UNREADABLE_AT_START {
            match frames.next() {
                Some(Ok(frame)) => {
                    let stored_size = (frame.image.width(), frame.image.height());
                    let mut notes = opened.notes;
                    notes.extend(pixels.note(stored_size));
                    ahead.push_back(Ok(frame));
                    let begun = Begun {
                        description: opened.description,
                        length: opened.length,
                        live: opened.live,
                        turn: opened.turn,
                        size: pixels.square_size(stored_size).unwrap_or(stored_size),
                        stored_size,
                        notes,
                        missing: opened.missing,
                        recorded: Ok(None),
                    };
                    let frames = ahead.into_iter().chain(frames);
                    let squared = move |frame: VideoFrame| VideoFrame {
                        image: pixels.squared(frame.image),
                        ..frame
                    };
                    return Ok(Self {
                        begun,
                        frames: Box::new(frames.map(move |frame| frame.map(squared))),
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
        for frame in self.frames {
            if !sink.put(Message::Frame(frame)) {
                return;
            }
        }
    }
}

impl Video {
    /// Opens a file, `-`, a camera (`/dev/video0`) or an address and decodes its first frame, with
    /// the [usual patience](Patience::usual).
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

    /// Opens a recording of a robot ([`is_recording`]): the images of a topic, or of the only one
    /// that has some, and the camera by the calibration that was recorded with them.
    ///
    /// # Errors
    /// When it cannot be read, or no topic or several could be meant; when it takes too long or is
    /// interrupted.
    pub fn open_recording(
        source: impl AsRef<Path>,
        topic: Option<&str>,
        patience: Patience,
    ) -> Result<(Self, Recorded), VideoError> {
        let topic = topic.map(str::to_owned);
        let start = move |source: &Source| source.start_recording(topic.as_deref());
        let mut video = Self::begin(source.as_ref(), patience, start)?;
        video.clock.can_be_set_back = true;
        let recorded = std::mem::replace(&mut video.begun.recorded, Ok(None));
        Ok((video, recorded))
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
                clock: Clock::new(begun.live),
                begun,
                messages,
                program,
                budget: stored_bytes(path).map(|bytes| PixelBudget::of_source(path, bytes)),
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

    /// Width and height of the first frame before its pixels were made square, px: a calibration
    /// may be for images of this size.
    #[must_use]
    pub fn stored_size(&self) -> (usize, usize) {
        self.begun.stored_size
    }

    /// Which way over its images a rolling shutter runs.
    #[must_use]
    pub fn readout_direction(&self) -> ReadoutDirection {
        self.begun.turn.readout_direction(self.begun.size)
    }

    /// Frames so far whose time did not come after that of the frame before and was set right
    /// behind it.
    #[must_use]
    pub fn repaired_times(&self) -> usize {
        self.clock.repaired
    }

    /// How the source was understood, in sentences: what a person should know before results are
    /// believed.
    #[must_use]
    pub fn notes(&self) -> &[String] {
        &self.begun.notes
    }

    /// What was wrong with the frames so far, in sentences: frames that are missing, times that go
    /// back.
    #[must_use]
    pub fn faults(&self) -> Vec<String> {
        let missing = self.begun.missing.count();
        let missing = (missing > 0).then(|| {
            format!(
                "{missing} frames of the file are damaged or could not be decoded: they are \
                 missing, or show what is not so"
            )
        });
        missing.into_iter().chain(self.clock.fault()).collect()
    }

    /// CPU time of reading until the last frame.
    #[must_use]
    pub fn cpu(&self) -> Duration {
        self.messages.cpu()
    }
}

impl Video {
    /// The frame, if there is room for it.
    fn spend(&mut self, frame: VideoFrame) -> Result<VideoFrame, VideoError> {
        if let Some(budget) = &mut self.budget {
            let pixels = frame.image.width() * frame.image.height();
            budget.spend(pixels.max(MIN_FRAME_PIXELS), 1)?;
        }
        Ok(frame)
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
        let item = item.map(|item| item.and_then(|frame| self.spend(frame)));
        self.ended = match &item {
            None => true,
            Some(Err(error)) => !error.is_single_frame(),
            Some(Ok(_)) => false,
        };
        item.map(|item| {
            item.map(|mut frame| {
                frame.timestamp_ns = self.clock.increasing(frame.timestamp_ns);
                frame
            })
        })
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

fn open_here(path: &Path, name: &str) -> Result<Here, VideoError> {
    let io = |e| VideoError::io(name, e);
    let mut file = File::open(path).map_err(io)?;
    let metadata = file.metadata().map_err(io)?;
    let unusable =
        |found: &str, expected: &str| VideoError::content(name, "video", found, expected);
    if !metadata.is_file() {
        return Err(unusable("a folder or device", "a video file"));
    }
    if metadata.len() == 0 {
        return Err(unusable("an empty file", "a video"));
    }
    let kind = Kind::of(&mut file).map_err(io)?;
    file.rewind().map_err(io)?;
    match kind {
        Some(Kind::Y4m) => Ok(Ok(open_y4m(name, file)?)),
        Some(Kind::Avi) => avi::open(name, file),
        Some(Kind::Mp4) => h264::open(name, file, metadata.len()),
        Some(Kind::Other) | None => Ok(Err(Elsewhere::new("a format that is not read directly"))),
    }
}

fn open_y4m(name: &str, reader: impl Read + Send + 'static) -> Result<Opened, VideoError> {
    let frames = y4m::Y4mReader::new(name, BufReader::with_capacity(1 << 20, reader))?;
    Ok(Opened {
        pixels: frames.pixels(),
        notes: frames.note().into_iter().collect(),
        ..Opened::new("YUV4MPEG2", Box::new(frames))
    })
}
