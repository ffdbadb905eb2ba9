//! Where frames come from, and reading them ahead of tracking in a thread of its own.

use crate::clock::thread_cpu;
use crate::preparation::{Preparation, Preparer};
use crate::read_frame::ReadFrame;
use crate::shutter::{MAX_WAITING, Rectifier};
use crate::unusable::Unusable;
use crate::waiting::{Entrance, WaitingFrames};
use monogrid_image::GrayImage;
use monogrid_slam::{DepthInput, fault};
use std::collections::VecDeque;
use std::ops::ControlFlow;
use std::panic::resume_unwind;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, SyncSender, channel, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

/// Frames decoded ahead: enough to bridge a slow file; each takes four bytes per pixel.
const FRAMES_AHEAD: usize = 3;

/// A frame of a source.
#[derive(Debug)]
pub struct SourceFrame {
    /// Number in the source; grows, and may leave out some.
    pub index: usize,
    /// Time, nanoseconds; grows.
    pub timestamp_ns: i64,
    /// The image of the camera (grey, 0 to 255), or why there is none.
    pub image: Result<GrayImage, Unusable>,
    /// What a depth camera or the second camera of a stereo pair says, for the camera of the
    /// working images, or why it cannot be used.
    pub depth: Option<Result<DepthInput, Unusable>>,
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
        let (low, high) = self.size_hint();
        high.filter(|high| *high == low)
    }

    fn next_frame(&mut self) -> Option<SourceFrame> {
        self.next()
    }
}

/// How to read on after a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum ReadOn {
    /// As before.
    #[default]
    AsBefore,
    /// Some frames later (always as many), images are rectified for a camera that takes this long
    /// from its first row to the last, ms.
    Rectified {
        /// 0 where all rows are read at once; negative where it begins with the last.
        readout_ms: f64,
    },
}

/// Frames after which what was found of the rolling shutter is used: more than can be read and not
/// taken yet, so that it does not depend on how far ahead the reader is.
const FRAMES_UNTIL_RECTIFIED: usize = 28;
const _: () = assert!(FRAMES_UNTIL_RECTIFIED > FRAMES_AHEAD + MAX_WAITING + 2);

/// How fast frames are read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Pace {
    /// As they are taken.
    #[default]
    Taken,
    /// Each at its own time. Frames wait where tracking takes longer for one; when the oldest would
    /// wait for longer than `max_wait`, some are dropped, evenly.
    Real {
        /// By the times of the frames; 0.2 s covers the slowest frames, those that make a keyframe.
        max_wait: Duration,
    },
}

/// How frames are read.
#[derive(Clone, Copy, Debug, Default)]
pub struct Reading {
    /// How fast.
    pub pace: Pace,
    /// The number of a frame that is used though it repeats the one before.
    pub must_be_used: Option<usize>,
}

/// Reads frames in a thread of its own, rectifies those of a rolling shutter, and hands each over,
/// prepared, in the order of the source, until there are no more or `take` breaks. Returns the CPU
/// time of the reader.
///
/// # Errors
/// When the system has no more threads.
pub fn read_ahead(
    source: impl FrameSource,
    preparation: &Preparation,
    reading: Reading,
    take: impl FnMut(ReadFrame) -> ControlFlow<(), ReadOn>,
) -> std::io::Result<Duration> {
    let stop = AtomicBool::new(false);
    let (readouts, wanted) = channel();
    let mut reader = Reader {
        source,
        preparation,
        preparer: Preparer::default(),
        readout_ms: preparation.readout_ms(),
        rectifier: preparation.shutter().map(Rectifier::new),
        num_read: 0,
        first_read: None,
        wanted,
        pending: VecDeque::new(),
        must_be_used: reading.must_be_used,
        stop: &stop,
    };
    match reading.pace {
        Pace::Taken => {
            let (sender, frames) = sync_channel(FRAMES_AHEAD);
            let read = move || reader.read_all(&sender);
            side_by_side(read, frames.into_iter(), (&stop, readouts), take)
        }
        Pace::Real { max_wait } => {
            let waiting = WaitingFrames::new(max_wait);
            let entrance = waiting.entrance();
            let read = move || reader.read_at_pace(&entrance);
            let frames = std::iter::from_fn(|| waiting.take());
            side_by_side(read, frames, (&stop, readouts), take)
        }
    }
}

/// Reads in a thread of its own and hands over here what comes of it. Returns the CPU time of the
/// reader.
fn side_by_side(
    read: impl FnOnce() + Send,
    frames: impl Iterator<Item = ReadFrame>,
    (stop, readouts): (&AtomicBool, Sender<WantedReadout>),
    mut take: impl FnMut(ReadFrame) -> ControlFlow<(), ReadOn>,
) -> std::io::Result<Duration> {
    thread::scope(|scope| {
        let builder = thread::Builder::new().name("reader".into());
        let thread = builder.spawn_scoped(scope, || {
            read();
            thread_cpu()
        })?;
        let stopping = Stopping(stop);
        for (before, frame) in frames.enumerate() {
            match take(frame) {
                ControlFlow::Break(()) => break,
                ControlFlow::Continue(ReadOn::AsBefore) => {}
                ControlFlow::Continue(ReadOn::Rectified { readout_ms }) => {
                    let from = before + FRAMES_UNTIL_RECTIFIED;
                    // a reader that is at its end needs it no more
                    let _ = readouts.send(WantedReadout { from, readout_ms });
                }
            }
        }
        drop(stopping);
        // a panic of the reader goes on here
        Ok(thread.join().unwrap_or_else(|panic| resume_unwind(panic)))
    })
}

/// The rolling shutter to take out of images from this one on, counted as they are read.
#[derive(Clone, Copy, Debug)]
struct WantedReadout {
    from: usize,
    readout_ms: f64,
}

/// Stops the reader when it is dropped, also by a panic of the one who takes.
struct Stopping<'a>(&'a AtomicBool);

impl Drop for Stopping<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// The reader's side.
struct Reader<'a, S> {
    source: S,
    preparation: &'a Preparation,
    preparer: Preparer,
    readout_ms: f64,
    rectifier: Option<Rectifier>,
    num_read: usize,
    /// When the first frame was decoded, and its time, ns.
    first_read: Option<(Instant, i64)>,
    wanted: Receiver<WantedReadout>,
    /// What is wanted and not due yet.
    pending: VecDeque<WantedReadout>,
    must_be_used: Option<usize>,
    stop: &'a AtomicBool,
}

impl<S: FrameSource> Reader<'_, S> {
    /// The next frame; with a rolling shutter that is read one image ahead.
    fn next(&mut self) -> Option<ReadFrame> {
        self.rectify_as_wanted();
        let Some(mut rectifier) = self.rectifier.take() else {
            return self.prepared();
        };
        let ready = loop {
            if let Some(frame) = rectifier.take() {
                break Some(frame);
            }
            match self.prepared() {
                Some(frame) => rectifier.add(frame),
                None if self.is_stopped() || rectifier.num_waiting() == 0 => break None,
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
        fault::pass("reader");
        self.num_read += 1;
        let first = (Instant::now(), frame.timestamp_ns);
        self.first_read.get_or_insert(first);
        let must_be_used = self.must_be_used == Some(frame.index);
        let prepared = frame
            .image
            .and_then(|image| self.preparer.next(self.preparation, &image, must_be_used));
        Some(ReadFrame {
            index: frame.index,
            timestamp_ns: frame.timestamp_ns,
            image: Some(prepared),
            depth: frame.depth,
            readout_ms: self.readout_ms,
            rectification: None,
            due: None,
        })
    }

    /// From here on with the rolling shutter that is due, if one is.
    fn rectify_as_wanted(&mut self) {
        self.pending.extend(self.wanted.try_iter());
        let next = self.pending.front();
        let Some(due) = next.copied().filter(|next| next.from <= self.num_read) else {
            return;
        };
        self.pending.pop_front();
        self.readout_ms = due.readout_ms;
        match &mut self.rectifier {
            Some(rectifier) => rectifier.take_readout_ms(due.readout_ms),
            None => {
                let preparation = self.preparation.clone().with_readout_ms(due.readout_ms);
                self.rectifier = preparation.shutter().map(Rectifier::new);
            }
        }
    }

    fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    fn read_all(&mut self, sender: &SyncSender<ReadFrame>) {
        while let Some(frame) = self.next()
            && sender.send(frame).is_ok()
        {}
    }

    /// Each frame at its own time.
    fn read_at_pace(&mut self, waiting: &Entrance) {
        let begin = Instant::now();
        while let Some(mut frame) = self.next() {
            let (read, first_ns) = self.first_read.unwrap_or((begin, frame.timestamp_ns));
            let offset_ns = frame.timestamp_ns.saturating_sub(first_ns).max(0) as u64;
            let offset = Duration::from_nanos(offset_ns);
            frame.due = Some(read + offset);
            self.wait_until(begin, offset);
            if self.is_stopped() {
                return;
            }
            waiting.add(frame);
        }
    }

    fn wait_until(&self, begin: Instant, due: Duration) {
        while begin.elapsed() < due && !self.is_stopped() {
            thread::sleep((due - begin.elapsed().min(due)).min(Duration::from_millis(50)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::{Camera, Distortion, Pinhole};
    use monogrid_image::{Photometric, WorkingSize};

    fn preparation() -> Preparation {
        let camera = Camera {
            width: 40,
            height: 30,
            pinhole: Pinhole::new(30.0, 30.0, 19.5, 14.5),
            distortion: Distortion::None,
        };
        let size = WorkingSize::AUTOMATIC;
        Preparation::new(&camera, size, None, Photometric::default())
    }

    /// Frames without end, 1 ms apart.
    fn endless() -> impl Iterator<Item = SourceFrame> + Send {
        (0..).map(|index: usize| SourceFrame {
            index,
            timestamp_ns: 1_000_000 * index as i64,
            image: Ok(GrayImage::filled(40, 30, (index % 200) as f32)),
            depth: None,
        })
    }

    fn at_pace(max_wait: Duration) -> Reading {
        Reading {
            pace: Pace::Real { max_wait },
            ..Reading::default()
        }
    }

    #[test]
    fn a_slow_reader_of_a_stream_loses_nothing_within_the_time_to_wait() {
        let mut next = 0;
        let reading = at_pace(Duration::from_secs(100));
        let begin = Instant::now();
        let read = read_ahead(endless().take(30), &preparation(), reading, |frame| {
            thread::sleep(Duration::from_millis(3));
            assert_eq!(frame.index, next);
            assert!(frame.image.is_some());
            // each takes 3 ms, and one comes every 1 ms
            let since_begin = begin.elapsed();
            let late = frame.due.map(|due| due.elapsed()).unwrap_or_default();
            let index = frame.index as u64;
            assert!(late >= Duration::from_millis(2 * index), "{late:?} {index}");
            assert!(late + Duration::from_millis(index) <= since_begin);
            next += 1;
            ControlFlow::Continue(ReadOn::AsBefore)
        });
        assert!(read.is_ok());
        assert_eq!(next, 30);
    }

    #[test]
    fn what_is_dropped_is_told_in_order_while_the_stream_goes_on() {
        let (mut next, mut dropped) = (0, 0);
        let reading = at_pace(Duration::ZERO);
        let read = read_ahead(endless(), &preparation(), reading, |frame| {
            assert_eq!(frame.index, next);
            next += 1;
            dropped += usize::from(frame.image.is_none());
            if frame.image.is_some() {
                thread::sleep(Duration::from_millis(10));
            }
            match dropped > 20 {
                true => ControlFlow::Break(()),
                false => ControlFlow::Continue(ReadOn::AsBefore),
            }
        });
        assert!(read.is_ok());
    }

    #[test]
    fn a_rolling_shutter_that_is_found_on_the_way_is_taken_out_from_always_the_same_frame_on() {
        let readouts_of = |pause: Duration| {
            let mut readouts = Vec::new();
            let read = read_ahead(
                endless().take(120),
                &preparation(),
                Reading::default(),
                |frame| {
                    thread::sleep(pause);
                    readouts.push(frame.readout_ms);
                    ControlFlow::Continue(match frame.index {
                        10 => ReadOn::Rectified { readout_ms: 20.0 },
                        // before the first is due
                        12 => ReadOn::Rectified { readout_ms: 25.0 },
                        60 => ReadOn::Rectified { readout_ms: 0.0 },
                        _ => ReadOn::AsBefore,
                    })
                },
            );
            assert!(read.is_ok());
            readouts
        };
        let readouts = readouts_of(Duration::ZERO);
        assert_eq!(readouts.len(), 120);
        let later = super::FRAMES_UNTIL_RECTIFIED;
        let changes = [
            (0, 0.0),
            (10 + later, 20.0),
            (12 + later, 25.0),
            (60 + later, 0.0),
        ];
        for (k, pair) in readouts.windows(2).enumerate() {
            let change = changes.iter().find(|(from, _)| *from == k + 1);
            let expected = change.map_or(pair[0], |(_, readout_ms)| *readout_ms);
            assert_eq!(pair[1], expected, "{k}");
        }
        assert_eq!(readouts_of(Duration::from_millis(1)), readouts);
    }
}
