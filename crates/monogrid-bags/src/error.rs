//! What can be wrong with a recording.

use crate::convert::{ImageError, InfoError};
use std::path::{Path, PathBuf};

/// Why a recording cannot be read, or not to its end.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BagError {
    /// The system says no.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// It is not what it should be, or has not the one topic that could be meant.
    #[error("{}: {reason}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What was found, and what was expected.
        reason: String,
    },
    /// A message that is no image.
    #[error("topic {topic}: {source}")]
    Image {
        /// Its topic.
        topic: String,
        /// The cause.
        source: ImageError,
    },
    /// A calibration that is none.
    #[error("topic {topic}: {source}")]
    Info {
        /// Its topic.
        topic: String,
        /// The cause.
        source: InfoError,
    },
}

impl BagError {
    pub(crate) fn damaged(path: &Path, reason: impl Into<String>) -> Self {
        Self::Damaged {
            path: path.to_owned(),
            reason: reason.into(),
        }
    }

    pub(crate) fn io(path: &Path) -> impl Fn(std::io::Error) -> Self + '_ {
        |source| Self::Io {
            path: path.to_owned(),
            source,
        }
    }

    /// Whether the frames behind it can still be read.
    #[must_use]
    pub fn is_single_frame(&self) -> bool {
        matches!(self, Self::Image { .. })
    }
}
