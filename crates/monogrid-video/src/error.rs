//! The one error type of this crate.

use std::io::{Error, ErrorKind};

/// What installs ffmpeg on this system.
const INSTALL_COMMAND: &str = if cfg!(target_os = "macos") {
    "brew install ffmpeg"
} else if cfg!(windows) {
    "winget install ffmpeg"
} else {
    "sudo apt install ffmpeg"
};

/// What is wrong with a video, camera or stream; every message names it, what was found and what to
/// do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum VideoError {
    /// There is no such file.
    #[error("no video at {video:?}; check the path")]
    Missing {
        /// What was asked for.
        video: String,
    },
    /// Reading failed.
    #[error("cannot read {video:?}: {source}")]
    Io {
        /// The file, camera or address.
        video: String,
        /// The cause.
        source: std::io::Error,
    },
    /// It can only be decoded by a program that is not there.
    #[error(
        "{video:?} ({found}) is decoded by ffmpeg, which is not installed: type `{}`",
        INSTALL_COMMAND
    )]
    NeedsFfmpeg {
        /// The file or address.
        video: String,
        /// Why it is not decoded here.
        found: String,
    },
    /// ffmpeg could not decode it.
    #[error("ffmpeg cannot decode {video:?}: {message}")]
    Ffmpeg {
        /// The file or address.
        video: String,
        /// Its last words.
        message: String,
    },
    /// The file as a whole cannot be understood.
    #[error("{video:?} is not a usable {kind}: found {found}, expected {expected}")]
    Content {
        /// The file, camera or address.
        video: String,
        /// "MP4", "AVI", ...
        kind: &'static str,
        /// What is in it.
        found: String,
        /// What would do.
        expected: String,
    },
    /// A single frame cannot be decoded; those that follow may be.
    #[error("frame {frame} of {video:?} cannot be decoded: {reason}")]
    Frame {
        /// The file, camera or address.
        video: String,
        /// Number of the frame in the order of the file, from 0.
        frame: usize,
        /// Why not.
        reason: String,
    },
    /// It sent nothing that is whole for longer than it may take.
    #[error(
        "{video:?} has sent no whole frame for {seconds} s: found silence or less than a frame, \
         expected at least one; check the sender and the network, or allow more time"
    )]
    Stalled {
        /// The address, pipe, file or camera.
        video: String,
        /// How long it was waited for.
        seconds: f64,
    },
    /// Whoever waited for it stopped waiting.
    #[error("waiting for {video:?} was interrupted")]
    Interrupted {
        /// What was waited for.
        video: String,
    },
    /// A stream that broke off within an image, or the program that decodes it within its work.
    #[error("{video:?} broke off after {frames} frames: {reason}")]
    BrokeOff {
        /// The address or file.
        video: String,
        /// Frames before.
        frames: usize,
        /// What was found, and what would have been the regular end.
        reason: String,
    },
    /// More frames than what is stored can be.
    #[error(transparent)]
    TooManyPixels(#[from] monogrid_datasets::TooManyPixels),
    /// A recording that cannot be read.
    #[error(transparent)]
    Recording(#[from] monogrid_bags::BagError),
    /// A camera that cannot be used.
    #[error("camera {camera:?}: {reason}")]
    Camera {
        /// Its device file.
        camera: String,
        /// What is wrong, and what would do.
        reason: String,
    },
}

pub(crate) fn endless_header() -> Error {
    Error::new(ErrorKind::InvalidData, "a header that does not end")
}

impl VideoError {
    /// Whether reading can go on after this error: only one frame is lost.
    #[must_use]
    pub fn is_single_frame(&self) -> bool {
        matches!(self, Self::Frame { .. })
    }

    pub(crate) fn io(video: &str, source: std::io::Error) -> Self {
        let video = video.to_owned();
        match source.kind() {
            ErrorKind::NotFound => Self::Missing { video },
            _ => Self::Io { video, source },
        }
    }

    pub(crate) fn content(
        video: &str,
        kind: &'static str,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> Self {
        Self::Content {
            video: video.to_owned(),
            kind,
            found: found.into(),
            expected: expected.into(),
        }
    }

    pub(crate) fn frame(video: &str, frame: usize, reason: impl Into<String>) -> Self {
        Self::Frame {
            video: video.to_owned(),
            frame,
            reason: reason.into(),
        }
    }
}
