//! What the colour of a keyframe is made from and nobody can read again: the colours of a video,
//! which is read only once, and how a rolling shutter was taken out of an image. Kept of the last
//! frames until it is known which become keyframes, and of those until they are recorded.
//!
//! What is kept follows from the order in which frames are tracked, not from when they were read,
//! so that a recording does not depend on how far the reader is ahead.

use monogrid_pipeline::Rectification;
use monogrid_video::Colour;
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Memory for frames that may still become keyframes: those of the last ten seconds, since a map
/// starts with a frame before.
const MAX_BYTES: usize = 12 << 20;

/// What is kept, by number of the frame.
#[derive(Debug, Default)]
pub struct FrameColours(Mutex<Kept>);

/// What is kept of a frame.
#[derive(Clone, Debug, Default)]
pub struct FrameColour {
    /// As a video showed it; image files are read again.
    pub colour: Colour,
    /// How the grey image was rectified; its colours must be as well.
    pub rectification: Option<Rectification>,
}

impl FrameColour {
    fn num_bytes(&self) -> usize {
        let rectification = self.rectification.as_ref();
        self.colour.num_bytes() + rectification.map_or(0, Rectification::num_bytes)
    }

    fn is_empty(&self) -> bool {
        self.colour == Colour::Grey && self.rectification.is_none()
    }
}

#[derive(Debug, Default)]
struct Kept {
    /// Read, and not tracked yet.
    ahead: VecDeque<(usize, Colour)>,
    /// The last frames that were tracked, and how many bytes they are.
    recent: VecDeque<(usize, FrameColour)>,
    recent_bytes: usize,
    /// Of frames that are keyframes.
    keyframes: BTreeMap<usize, FrameColour>,
}

impl FrameColours {
    /// A frame was read.
    pub fn arrive(&self, frame: usize, colour: Colour) {
        self.lock().ahead.push_back((frame, colour));
    }

    /// A frame was tracked, or passed over: how it was rectified, and whether it became a keyframe.
    pub fn pass(&self, frame: usize, rectification: Option<Rectification>, is_keyframe: bool) {
        let mut kept = self.lock();
        kept.pass((frame, rectification), is_keyframe, MAX_BYTES);
    }

    /// A frame that was passed before is a keyframe.
    pub fn keep(&self, frame: usize) {
        self.lock().keep(frame);
    }

    /// What was kept of a keyframe that is recorded now.
    pub fn take(&self, frame: usize) -> FrameColour {
        let mut kept = self.lock();
        kept.keep(frame);
        kept.keyframes.remove(&frame).unwrap_or_default()
    }

    fn lock(&self) -> MutexGuard<'_, Kept> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Kept {
    fn pass(
        &mut self,
        (frame, mut rectification): (usize, Option<Rectification>),
        is_keyframe: bool,
        max_bytes: usize,
    ) {
        let later = self.ahead.partition_point(|(index, _)| *index <= frame);
        let passed: Vec<(usize, Colour)> = self.ahead.drain(..later).collect();
        let is_ahead = passed.last().is_some_and(|(index, _)| *index == frame);
        // image files do not arrive
        let own = (!is_ahead).then_some((frame, Colour::Grey));
        for (index, colour) in passed.into_iter().chain(own) {
            let rectification = rectification.take_if(|_| index == frame);
            let kept = FrameColour {
                colour,
                rectification,
            };
            if !kept.is_empty() {
                self.recent_bytes += kept.num_bytes();
                self.recent.push_back((index, kept));
            }
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
        let recent = &mut self.recent;
        if let Ok(place) = recent.binary_search_by_key(&frame, |(index, _)| *index)
            && let Some((_, colour)) = recent.remove(place)
        {
            self.recent_bytes -= colour.num_bytes();
            self.keyframes.insert(frame, colour);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{FrameColours, Kept};
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
            kept.pass((frame, None), frame == 3, 100);
            if frame == 20 {
                // the map starts with a frame before
                kept.keep(15);
                kept.keep(2);
            }
        }
        let recent: Vec<usize> = kept.recent.iter().map(|(index, _)| *index).collect();
        assert_eq!(recent, (30..40).collect::<Vec<_>>());
        assert_eq!((kept.recent_bytes, kept.ahead.len()), (100, 10));
        let kept = FrameColours(kept.into());
        let taken = |frame: usize| kept.take(frame).colour;
        assert_eq!(taken(3), colour(3));
        assert_eq!(taken(15), colour(15));
        assert_eq!(taken(2), Colour::Grey, "it had been forgotten");
        assert_eq!(taken(35), colour(35));
        assert_eq!(taken(35), Colour::Grey);
        assert_eq!(taken(45), Colour::Grey, "it was not tracked yet");
    }
}
