//! A source that a decoder has opened, and one that it leaves to others.

use crate::frame::Frames;
use crate::pixels::PixelShape;
use crate::turn::Turn;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Frames that a file should have and that gave no picture, so far.
#[derive(Clone, Debug, Default)]
pub(crate) struct Missing(Arc<AtomicUsize>);

impl Missing {
    pub(crate) fn add(&self, frames: usize) {
        self.0.fetch_add(frames, Ordering::Relaxed);
    }

    /// One that was counted has come.
    pub(crate) fn take_back(&self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }

    /// How many.
    pub(crate) fn count(&self) -> usize {
        self.0.load(Ordering::Relaxed)
    }
}

/// A decoder and what is known before the first frame.
pub(crate) struct Opened {
    pub(crate) description: String,
    pub(crate) length: Option<usize>,
    pub(crate) live: bool,
    /// How frames were turned to be upright.
    pub(crate) turn: Turn,
    /// The shape of their pixels, as they were turned.
    pub(crate) pixels: PixelShape,
    /// What people should know of how the source is read.
    pub(crate) notes: Vec<String>,
    pub(crate) missing: Missing,
    pub(crate) frames: Frames,
}

impl Opened {
    /// Of upright frames with square pixels.
    pub(crate) fn new(description: impl Into<String>, frames: Frames) -> Self {
        Self {
            description: description.into(),
            length: None,
            live: false,
            turn: Turn::None,
            pixels: PixelShape::SQUARE,
            notes: Vec::new(),
            missing: Missing::default(),
            frames,
        }
    }
}

/// A file that is not decoded here.
pub(crate) struct Elsewhere {
    /// What it is, for people.
    pub(crate) found: String,
    /// Whether its container mirrors the picture, which is not to be done.
    pub(crate) is_mirrored: bool,
}

impl Elsewhere {
    pub(crate) fn new(found: impl Into<String>) -> Self {
        Self {
            found: found.into(),
            is_mirrored: false,
        }
    }
}

/// What is said of a container that mirrors its picture.
pub(crate) const MIRRORED: &str = "the display matrix of the container mirrors the picture, and a \
    mirrored picture makes a mirrored world: images are used as they are stored";

/// What this process makes of a file; or what it is, where it cannot decode it.
pub(crate) type Here = Result<Opened, Elsewhere>;

/// Bytes of a file, or of the files in a folder; `None` of anything else, which may be endless.
pub(crate) fn stored_bytes(path: &Path) -> Option<u64> {
    let metadata = std::fs::metadata(path).ok()?;
    if !metadata.is_dir() {
        return metadata.is_file().then_some(metadata.len());
    }
    let files = std::fs::read_dir(path).ok()?;
    let files = files.filter_map(|entry| std::fs::metadata(entry.ok()?.path()).ok());
    Some(files.filter(|f| f.is_file()).map(|f| f.len()).sum())
}
