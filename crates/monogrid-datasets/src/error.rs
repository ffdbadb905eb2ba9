//! The one error type of this crate.

use std::path::{Path, PathBuf};

/// What is wrong with a file or folder; every message names it, what was found and what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DatasetError {
    /// The source does not exist.
    #[error("source not found: no file or folder at {0:?}; check the path")]
    SourceMissing(PathBuf),
    /// The source exists, but is of a kind that is not an image sequence.
    #[error("{path:?} is {found}, expected {expected}")]
    SourceKind {
        /// What was asked for.
        path: PathBuf,
        /// What it is.
        found: String,
        /// What would do.
        expected: &'static str,
    },
    /// A source without a single image.
    #[error("no frames in {path:?}: found {found}, expected {expected}")]
    NoFrames {
        /// Folder or list.
        path: PathBuf,
        /// What was there.
        found: String,
        /// What would do.
        expected: &'static str,
    },
    /// Time stamps that cannot order the frames.
    #[error(
        "{duplicates} of {frames} frames in {path:?} have the time stamp of another one, expected \
         increasing times in seconds"
    )]
    DuplicateTimes {
        /// List of frames.
        path: PathBuf,
        /// Frames with a time that occurred before.
        duplicates: usize,
        /// All frames.
        frames: usize,
    },
    /// Time stamps of more than one recording, or of a clock that was set.
    #[error(
        "time jumps back by {seconds:.3} s at frame {frame} of {path:?}, expected increasing \
         times; split the source there, or set its times right"
    )]
    TimesJumpBack {
        /// List of frames.
        path: PathBuf,
        /// The first frame behind the jump, counted from 0.
        frame: usize,
        /// How far.
        seconds: f64,
    },
    /// Reading or writing failed.
    #[error("cannot {action} {path:?}: {source}")]
    Io {
        /// "read", "write", ...
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// A line of a text file that cannot be understood.
    #[error("{path:?} line {line}: found {found:?}, expected {expected}")]
    Line {
        /// The file.
        path: PathBuf,
        /// Counted from 1.
        line: usize,
        /// The text (shortened).
        found: String,
        /// What would do.
        expected: String,
    },
    /// A file whose content as a whole cannot be understood.
    #[error("{path:?}: found {found}, expected {expected}")]
    Content {
        /// The file.
        path: PathBuf,
        /// What is in it.
        found: String,
        /// What would do.
        expected: String,
    },
    /// An image that cannot be decoded completely.
    #[error(
        "cannot decode image {path:?}: {reason}; expected a complete PNG, JPEG, PGM, PPM, TIFF, \
         WebP or BMP"
    )]
    Image {
        /// The file.
        path: PathBuf,
        /// Why not.
        reason: String,
    },
    /// More images than what is stored can be.
    #[error(transparent)]
    TooManyPixels(#[from] crate::TooManyPixels),
    /// Numbers that are not those of a camera.
    #[error("calibration {path:?}: {reason}")]
    Calibration {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// A recording or scan file that was not written by us, or is damaged beyond use.
    #[error("{path:?} is not a usable {kind}: {reason}")]
    Binary {
        /// The file.
        path: PathBuf,
        /// "recording", "scan file".
        kind: &'static str,
        /// What is wrong.
        reason: String,
    },
}

impl DatasetError {
    /// A failure of the system with a file.
    #[must_use]
    pub fn io(action: &'static str, path: &Path, source: std::io::Error) -> Self {
        Self::Io {
            action,
            path: path.to_path_buf(),
            source,
        }
    }

    pub(crate) fn line(path: &Path, line: usize, found: &str, expected: impl Into<String>) -> Self {
        Self::Line {
            path: path.to_path_buf(),
            line,
            found: shortened(found),
            expected: expected.into(),
        }
    }

    /// A file with `found` in it instead of `expected`.
    #[must_use]
    pub fn content(path: &Path, found: impl Into<String>, expected: impl Into<String>) -> Self {
        Self::Content {
            path: path.to_path_buf(),
            found: found.into(),
            expected: expected.into(),
        }
    }

    pub(crate) fn no_frames(path: &Path, found: impl Into<String>, expected: &'static str) -> Self {
        Self::NoFrames {
            path: path.to_path_buf(),
            found: found.into(),
            expected,
        }
    }

    pub(crate) fn binary(path: &Path, kind: &'static str, reason: impl Into<String>) -> Self {
        Self::Binary {
            path: path.to_path_buf(),
            kind,
            reason: reason.into(),
        }
    }

    pub(crate) fn calibration(path: &Path, reason: impl Into<String>) -> Self {
        Self::Calibration {
            path: path.to_path_buf(),
            reason: reason.into(),
        }
    }

    pub(crate) fn image(path: &Path, reason: impl Into<String>) -> Self {
        Self::Image {
            path: path.to_path_buf(),
            reason: reason.into(),
        }
    }
}

/// At most 80 characters of a text, for messages.
fn shortened(text: &str) -> String {
    let mut out: String = text.chars().take(80).collect();
    if out.len() < text.len() {
        out.push('…');
    }
    out
}
