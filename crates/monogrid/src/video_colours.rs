//! Colours of a video, which is read only once: kept of the last frames until it is known which become keyframes, and of those
//! until they are recorded.
//!
//! What is kept follows from the order in which frames are tracked, not from when they were read, so that a recording does not
//! depend on how far the reader is ahead.

use monogrid_video::Colour;
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Memory for frames that may still become keyframes: those of the last ten seconds, since a map starts with a frame before.
const MAX_BYTES: usize = 12 << 20;

/// Colours by number of the frame.
#[derive(Debug, Default)]
pub struct VideoColours(Mutex<Kept>);

#[derive(Debug, Default)]
struct Kept {
    /// Read, and not tracked yet.
    ahead: VecDeque<(usize, Colour)>,
    /// The last frames that were tracked, and how many bytes they are.
    recent: VecDeque<(usize, Colour)>,
    recent_bytes: usize,
    /// Of frames that are keyframes.
    keyframes: BTreeMap<usize, Colour>,
}

impl VideoColours {
    /// A frame was read.
    pub fn arrive(&self, frame: usize, colour: Colour) {
        self.lock().ahead.push_back((frame, colour));
    }

    /// A frame was tracked, or passed over; it became a keyframe or not.
    pub fn pass(&self, frame: usize, is_keyframe: bool) {
        self.lock().pass(frame, is_keyframe, MAX_BYTES);
    }

    /// A frame that was passed before is a keyframe.
    pub fn keep(&self, frame: usize) {
        self.lock().keep(frame);
    }

    /// The colour of a keyframe that is recorded now.
    pub fn take(&self, frame: usize) -> Colour {
        let mut kept = self.lock();
        kept.keep(frame);
        kept.keyframes.remove(&frame).unwrap_or_default()
    }

    fn lock(&self) -> MutexGuard<'_, Kept> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Kept {
    fn pass(&mut self, frame: usize, is_keyframe: bool, max_bytes: usize) {
        let later = self.ahead.partition_point(|(index, _)| *index <= frame);
        for (index, colour) in self.ahead.drain(..later) {
            self.recent_bytes += colour.num_bytes();
            self.recent.push_back((index, colour));
        }
        if is_keyframe {
            self.keep(frame);
        }
        while self.recent_bytes > max_bytes
            && let Some((_, colour)) = self.recent.pop_front()
        {
            self.recent_bytes -= colour.num_bytes();
        }
    }

    fn keep(&mut self, frame: usize) {
        if let Ok(place) = self
            .recent
            .binary_search_by_key(&frame, |(index, _)| *index)
            && let Some((_, colour)) = self.recent.remove(place)
        {
            self.recent_bytes -= colour.num_bytes();
            self.keyframes.insert(frame, colour);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Kept, VideoColours};
    use monogrid_video::Colour;

    fn colour(frame: usize) -> Colour {
        Colour::Jpeg(vec![frame as u8; 10])
    }

    #[test]
    fn keyframes_keep_their_colour_however_long_they_are_in_use() {
        let mut kept = Kept::default();
        for frame in 0..50 {
            kept.ahead.push_back((frame, colour(frame)));
        }
        for frame in 0..40 {
            kept.pass(frame, frame == 3, 100);
            if frame == 20 {
                // the map starts with a frame before
                kept.keep(15);
                kept.keep(2);
            }
        }
        let recent: Vec<usize> = kept.recent.iter().map(|(index, _)| *index).collect();
        assert_eq!(recent, (30..40).collect::<Vec<_>>());
        assert_eq!((kept.recent_bytes, kept.ahead.len()), (100, 10));
        let kept = VideoColours(kept.into());
        assert_eq!(kept.take(3), colour(3));
        assert_eq!(kept.take(15), colour(15));
        assert_eq!(kept.take(2), Colour::Grey, "it had been forgotten");
        assert_eq!(kept.take(35), colour(35));
        assert_eq!(kept.take(35), Colour::Grey);
        assert_eq!(kept.take(45), Colour::Grey, "it was not tracked yet");
    }
}
