//! Decoding and undistorting frames ahead of tracking, in a thread of its own.

use crate::input::Input;
use crate::usage::thread_cpu;
use monogrid_image::GrayImage;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::{self, Scope, ScopedJoinHandle};
use std::time::{Duration, Instant};

/// Frames decoded ahead: enough to bridge a slow file, few enough to stay small.
const FRAMES_AHEAD: usize = 6;

/// What the reader delivers, in the order of the source.
#[derive(Debug)]
pub struct Delivered {
    /// Index in the source.
    pub index: usize,
    /// Time, nanoseconds.
    pub timestamp_ns: i64,
    /// What there is of the frame.
    pub content: Content,
}

/// What there is of a frame.
#[derive(Debug)]
pub enum Content {
    /// A working image.
    Image(GrayImage),
    /// Nothing that could be used, and why.
    Unusable(String),
    /// Nothing, because it came too early for a program that is behind (only with `--realtime`).
    TooEarly,
}

/// A running reader; ends when its frames are delivered, `stop` is set, or nobody listens.
pub struct Reader<'scope> {
    /// Frames in order.
    pub frames: Receiver<Delivered>,
    thread: ScopedJoinHandle<'scope, Duration>,
}

impl<'scope> Reader<'scope> {
    /// Starts reading.
    pub fn start<'env>(
        scope: &'scope Scope<'scope, 'env>,
        input: &'env Input,
        realtime: bool,
        stop: &'env AtomicBool,
    ) -> std::io::Result<Self> {
        let ahead = if realtime { 1 } else { FRAMES_AHEAD };
        let (sender, frames) = sync_channel(ahead);
        let thread =
            thread::Builder::new()
                .name("reader".into())
                .spawn_scoped(scope, move || {
                    if realtime {
                        read_at_pace(input, &sender, stop);
                    } else {
                        read_all(input, &sender, stop);
                    }
                    thread_cpu()
                })?;
        Ok(Self { frames, thread })
    }

    /// Waits for the reader; its CPU time.
    pub fn join(self) -> Duration {
        drop(self.frames);
        self.thread.join().unwrap_or_default()
    }
}

fn read(input: &Input, position: usize) -> Delivered {
    let entry = &input.frames[position];
    Delivered {
        index: entry.index,
        timestamp_ns: entry.timestamp_ns,
        content: match input.read(entry) {
            Ok(image) => Content::Image(image),
            Err(reason) => Content::Unusable(reason.to_string()),
        },
    }
}

fn read_all(input: &Input, sender: &SyncSender<Delivered>, stop: &AtomicBool) {
    for position in 0..input.frames.len() {
        if stop.load(Ordering::Relaxed) || sender.send(read(input, position)).is_err() {
            return;
        }
    }
}

/// Each frame at its own time; one that finds the channel full is dropped and counted.
fn read_at_pace(input: &Input, sender: &SyncSender<Delivered>, stop: &AtomicBool) {
    let Some(first) = input.frames.first() else {
        return;
    };
    let begin = Instant::now();
    let mut pending: Vec<Delivered> = Vec::new();
    for position in 0..input.frames.len() {
        let delivered = read(input, position);
        let offset = delivered
            .timestamp_ns
            .saturating_sub(first.timestamp_ns)
            .max(0) as u64;
        let due = Duration::from_nanos(offset);
        while begin.elapsed() < due && !stop.load(Ordering::Relaxed) {
            thread::sleep((due - begin.elapsed().min(due)).min(Duration::from_millis(50)));
        }
        if stop.load(Ordering::Relaxed) {
            return;
        }
        match sender.try_send(delivered) {
            Ok(()) => {}
            Err(TrySendError::Full(late)) => pending.push(Delivered {
                content: Content::TooEarly,
                ..late
            }),
            Err(TrySendError::Disconnected(_)) => return,
        }
    }
    for dropped in pending {
        if sender.send(dropped).is_err() {
            return;
        }
    }
}
