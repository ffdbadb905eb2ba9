//! Where frames come from, and reading them ahead of tracking in a thread of its own.

use crate::clock::thread_cpu;
use crate::preparation::{Preparation, Preparer, Unusable};
use crate::shutter::Rectifier;
use monogrid_image::GrayImage;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{SyncSender, TrySendError, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

/// Frames decoded ahead: enough to bridge a slow file, few enough to stay small.
const FRAMES_AHEAD: usize = 6;

/// A frame of a source.
#[derive(Debug)]
pub struct SourceFrame {
    /// Number in the source; grows, and may leave out some.
    pub index: usize,
    /// Time, nanoseconds; grows.
    pub timestamp_ns: i64,
    /// The image of the camera (grey, 0 to 255), or why there is none.
    pub image: Result<GrayImage, Unusable>,
}

/// Frames of a file, a folder, a camera, a stream. Every iterator over frames is one.
pub trait FrameSource: Send {
    /// How many frames there will be; none where nobody knows, or there is no end.
    fn num_frames(&self) -> Option<usize>;

    /// The next frame; waits for it where it has not happened yet. None after the last.
    fn next_frame(&mut self) -> Option<SourceFrame>;
}

impl<I: Iterator<Item = SourceFrame> + Send> FrameSource for I {
    fn num_frames(&self) -> Option<usize> {
        match self.size_hint() {
            (low, Some(high)) if low == high => Some(low),
            _ => None,
        }
    }

    fn next_frame(&mut self) -> Option<SourceFrame> {
        self.next()
    }
}

/// A frame that was read.
#[derive(Debug)]
pub struct ReadFrame {
    /// Number in the source.
    pub index: usize,
    /// Time, nanoseconds.
    pub timestamp_ns: i64,
    /// The working image; `None` for one that came too early for a reader at [`Pace::Real`].
    pub image: Option<Result<GrayImage, Unusable>>,
}

/// How fast frames are read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Pace {
    /// As they are taken.
    #[default]
    Taken,
    /// Each at its own time; one that finds its predecessor waiting is dropped.
    Real,
}

/// How frames are read.
#[derive(Clone, Copy, Debug, Default)]
pub struct Reading {
    /// How fast.
    pub pace: Pace,
    /// The number of a frame that is used though it repeats the one before.
    pub must_be_used: Option<usize>,
}

/// Reads frames in a thread of its own, rectifies those of a rolling shutter, and hands each over, prepared, in the order of the source, until there
/// are no more or `take` breaks. Returns the CPU time of the reader.
///
/// # Errors
/// When the system has no more threads.
pub fn read_ahead(
    source: impl FrameSource,
    preparation: &Preparation,
    reading: Reading,
    mut take: impl FnMut(ReadFrame) -> ControlFlow<()>,
) -> std::io::Result<Duration> {
    let stop = AtomicBool::new(false);
    let ahead = match reading.pace {
        Pace::Taken => FRAMES_AHEAD,
        Pace::Real => 1,
    };
    thread::scope(|scope| {
        let (sender, frames) = sync_channel(ahead);
        let mut reader = Reader {
            source,
            preparation,
            preparer: Preparer::default(),
            rectifier: preparation.shutter().map(Rectifier::new),
            must_be_used: reading.must_be_used,
            stop: &stop,
        };
        let read = move || {
            match reading.pace {
                Pace::Taken => reader.read_all(&sender),
                Pace::Real => reader.read_at_pace(&sender),
            }
            thread_cpu()
        };
        let builder = thread::Builder::new().name("reader".into());
        let thread = builder.spawn_scoped(scope, read)?;
        for frame in &frames {
            if take(frame).is_break() {
                break;
            }
        }
        stop.store(true, Ordering::Relaxed);
        drop(frames);
        Ok(thread.join().unwrap_or_default())
    })
}

/// The reader's side.
struct Reader<'a, S> {
    source: S,
    preparation: &'a Preparation,
    preparer: Preparer,
    rectifier: Option<Rectifier>,
    must_be_used: Option<usize>,
    stop: &'a AtomicBool,
}

impl<S: FrameSource> Reader<'_, S> {
    /// The next frame; with a rolling shutter that is read one image ahead.
    fn next(&mut self) -> Option<ReadFrame> {
        let Some(mut rectifier) = self.rectifier.take() else {
            return self.prepared();
        };
        let ready = loop {
            if let Some(frame) = rectifier.take() {
                break Some(frame);
            }
            match self.prepared() {
                Some(frame) => rectifier.add(frame),
                None if self.is_stopped() || rectifier.is_empty() => break None,
                None => rectifier.finish(),
            }
        };
        self.rectifier = Some(rectifier);
        ready
    }

    /// The next frame of the source as a working image.
    fn prepared(&mut self) -> Option<ReadFrame> {
        if self.is_stopped() {
            return None;
        }
        let frame = self.source.next_frame()?;
        let must_be_used = self.must_be_used == Some(frame.index);
        let prepared = frame
            .image
            .and_then(|image| self.preparer.next(self.preparation, image, must_be_used));
        Some(ReadFrame {
            index: frame.index,
            timestamp_ns: frame.timestamp_ns,
            image: Some(prepared),
        })
    }

    fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    fn read_all(&mut self, sender: &SyncSender<ReadFrame>) {
        while let Some(frame) = self.next() {
            if sender.send(frame).is_err() {
                return;
            }
        }
    }

    /// Each frame at its own time; one that finds the channel full is dropped and told of at the end.
    fn read_at_pace(&mut self, sender: &SyncSender<ReadFrame>) {
        let begin = Instant::now();
        let mut first_ns = None;
        let mut dropped: Vec<ReadFrame> = Vec::new();
        while let Some(frame) = self.next() {
            let first_ns = *first_ns.get_or_insert(frame.timestamp_ns);
            let offset_ns = frame.timestamp_ns.saturating_sub(first_ns).max(0) as u64;
            self.wait_until(begin, Duration::from_nanos(offset_ns));
            if self.is_stopped() {
                return;
            }
            match sender.try_send(frame) {
                Ok(()) => {}
                Err(TrySendError::Full(late)) => dropped.push(ReadFrame {
                    image: None,
                    ..late
                }),
                Err(TrySendError::Disconnected(_)) => return,
            }
        }
        for frame in dropped {
            if sender.send(frame).is_err() {
                return;
            }
        }
    }

    fn wait_until(&self, begin: Instant, due: Duration) {
        while begin.elapsed() < due && !self.is_stopped() {
            thread::sleep((due - begin.elapsed().min(due)).min(Duration::from_millis(50)));
        }
    }
}
