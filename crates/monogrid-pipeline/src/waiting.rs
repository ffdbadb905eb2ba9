//! Frames that wait for tracking while their source goes on at its own pace.
//!
//! A slow frame costs latency for a moment and no other frame. When tracking stays behind, what
//! waits is thinned evenly instead of cut off, so that the camera has moved as little as can be
//! from each frame to the next.

use crate::read_frame::ReadFrame;
use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Most frames that wait, whatever their times say.
const MAX_FRAMES: usize = 64;

/// Frames on their way from a reader that cannot wait to somebody who takes them in order.
#[derive(Debug)]
pub(crate) struct WaitingFrames {
    max_wait_ns: i64,
    queue: Mutex<Queue>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct Queue {
    /// In the order of the source; those that were dropped have no image any more.
    frames: VecDeque<ReadFrame>,
    /// Time of the last frame with an image that was taken, ns.
    taken_ns: Option<i64>,
    is_complete: bool,
}

impl WaitingFrames {
    /// Frames wait for at most this long, by their own times, before some are dropped.
    pub(crate) fn new(max_wait: Duration) -> Self {
        Self {
            max_wait_ns: i64::try_from(max_wait.as_nanos()).unwrap_or(i64::MAX),
            queue: Mutex::default(),
            changed: Condvar::new(),
        }
    }

    /// Where frames come in; there are no more when it is dropped.
    pub(crate) fn entrance(&self) -> Entrance<'_> {
        Entrance(self)
    }

    /// The next frame; waits for it. None after the last.
    pub(crate) fn take(&self) -> Option<ReadFrame> {
        let mut queue = self.lock();
        while queue.frames.is_empty() && !queue.is_complete {
            let woken = self.changed.wait(queue);
            queue = woken.unwrap_or_else(PoisonError::into_inner);
        }
        queue.take()
    }

    fn lock(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The reader's side of [`WaitingFrames`].
pub(crate) struct Entrance<'a>(&'a WaitingFrames);

impl Entrance<'_> {
    /// Lets a frame wait.
    pub(crate) fn add(&self, frame: ReadFrame) {
        self.0.lock().add(frame, self.0.max_wait_ns);
        self.0.changed.notify_one();
    }
}

impl Drop for Entrance<'_> {
    fn drop(&mut self) {
        self.0.lock().is_complete = true;
        self.0.changed.notify_one();
    }
}

impl Queue {
    fn take(&mut self) -> Option<ReadFrame> {
        let frame = self.frames.pop_front()?;
        if has_image(&frame) {
            self.taken_ns = Some(frame.timestamp_ns);
        }
        Some(frame)
    }

    /// Where the oldest frame waits for too long, one is dropped for each that comes: that without
    /// which the largest step in time stays the smallest.
    fn add(&mut self, frame: ReadFrame, max_wait_ns: i64) {
        self.frames.push_back(frame);
        let waiting: Vec<(usize, i64)> = (self.frames.iter().enumerate())
            .filter(|(_, frame)| has_image(frame))
            .map(|(place, frame)| (place, frame.timestamp_ns))
            .collect();
        let (Some(oldest), Some(newest)) = (waiting.first(), waiting.last()) else {
            return;
        };
        if newest.1.saturating_sub(oldest.1) <= max_wait_ns && waiting.len() <= MAX_FRAMES {
            return;
        }
        // the first frame of all has none before it and stays, and so does the newest
        let before = self.taken_ns.map(|time_ns| (usize::MAX, time_ns));
        let chain: Vec<(usize, i64)> = before.into_iter().chain(waiting).collect();
        let step = |around: &&[(usize, i64)]| around[2].1.saturating_sub(around[0].1);
        if let Some(around) = chain.windows(3).min_by_key(step) {
            let dropped = &mut self.frames[around[1].0];
            (dropped.image, dropped.depth) = (None, None);
        }
    }
}

fn has_image(frame: &ReadFrame) -> bool {
    matches!(frame.image, Some(Ok(_)))
}

#[cfg(test)]
mod tests {
    use super::{MAX_FRAMES, Queue, ReadFrame, has_image};
    use crate::unusable::Unusable;
    use monogrid_image::GrayImage;

    const WAIT_NS: i64 = 200;

    fn frame(index: usize, timestamp_ns: i64) -> ReadFrame {
        ReadFrame {
            index,
            timestamp_ns,
            readout_ms: 0.0,
            rectification: None,
            due: None,
            image: Some(Ok(GrayImage::filled(1, 1, 0.0))),
            depth: None,
        }
    }

    /// Takes up to the next frame with an image; what was taken goes to `handed`.
    fn take_used(queue: &mut Queue, handed: &mut Vec<ReadFrame>) -> Option<i64> {
        loop {
            let frame = queue.take()?;
            let time_ns = has_image(&frame).then_some(frame.timestamp_ns);
            handed.push(frame);
            if time_ns.is_some() {
                return time_ns;
            }
        }
    }

    /// Numbers of the frames that are left with an image when one is taken for `arriving` that
    /// come; all are handed on in order.
    fn used(count: usize, arriving: usize) -> Vec<usize> {
        let mut queue = Queue::default();
        let mut taken = Vec::new();
        for index in 0..count {
            queue.add(frame(index, 33 * index as i64), WAIT_NS);
            if index % arriving == 0 {
                take_used(&mut queue, &mut taken);
            }
        }
        while take_used(&mut queue, &mut taken).is_some() {}
        assert!(taken.iter().map(|frame| frame.index).eq(0..count));
        let with_image = taken.into_iter().filter(has_image);
        with_image.map(|frame| frame.index).collect()
    }

    #[test]
    fn a_slow_frame_costs_none_and_what_is_left_is_even() {
        assert_eq!(used(7, 7), [0, 1, 2, 3, 4, 5, 6]);
        let half = used(60, 2);
        assert!((30..=38).contains(&half.len()), "{half:?}");
        let steps = half.windows(2).map(|pair| pair[1] - pair[0]);
        assert!(steps.max() <= Some(3), "{half:?}");
        // nothing is taken for a second: what waited is spread over it
        let rested = used(30, 1000);
        assert_eq!(rested.len(), 8, "one is taken, seven wait: {rested:?}");
        let steps = rested.windows(2).map(|pair| pair[1] - pair[0]);
        assert!(steps.max() <= Some(8), "{rested:?}");
    }

    #[test]
    fn latency_comes_down_while_tracking_is_slower_than_the_source() {
        let (mut queue, mut handed) = (Queue::default(), Vec::new());
        let mut wait_ns = 0;
        for index in 0..90 {
            let now_ns = 33 * index as i64;
            queue.add(frame(index, now_ns), WAIT_NS);
            // a stall of a second, then every second frame is taken
            if index >= 30 && index % 2 == 0 {
                let taken_ns = take_used(&mut queue, &mut handed);
                wait_ns = now_ns - taken_ns.unwrap_or_default();
            }
            let count = queue.frames.iter().filter(|frame| has_image(frame)).count();
            assert!(count <= 7, "{count}");
        }
        assert!((1..=WAIT_NS + 66).contains(&wait_ns), "{wait_ns}");
    }

    #[test]
    fn frames_without_an_image_cost_nothing_and_without_times_there_is_a_limit() {
        let mut queue = Queue::default();
        for index in 0..50 {
            let repeats = ReadFrame {
                image: Some(Err(Unusable::Repeats)),
                ..frame(index, 33 * index as i64)
            };
            queue.add(if index == 20 { frame(20, 660) } else { repeats }, WAIT_NS);
        }
        assert!(queue.frames.iter().all(|frame| frame.image.is_some()));
        let mut queue = Queue::default();
        for index in 0..200 {
            queue.add(frame(index, 0), WAIT_NS);
        }
        let left = queue.frames.iter().filter(|frame| has_image(frame)).count();
        assert_eq!(left, MAX_FRAMES);
        assert!(has_image(&queue.frames[0]), "the first of all stays");
    }
}
