//! A lost camera: recognised, or the beginning of a fragment of the map.
//!
//! A camera that stays lost starts a new fragment, which is joined when it is recognised, unless
//! its start lies in the map already (see `bridge`).
//!
//! Each fragment has a world of its own: the camera of its first keyframe. Everything that compares
//! poses (sparse layer, known views, graph) stays within one. What joins them is the recognition of
//! places, in the graph; the frames of a fragment follow their keyframes, so that the camera goes
//! on as if nothing happened.

use super::bridge::{Landing, land};
use super::outcome::Attempt;
use super::relocalise::{InUse, Recognised, relocalise};
use crate::KeyframeId;
use crate::frame::{BufferedFrame, Frame};
use crate::graph::Relocalised;
use crate::map::Map;
use crate::setup::Setup;
use crate::start::{Start, Started};
use monogrid_geometry::Se3;
use monogrid_image::Pyramid;
use std::collections::VecDeque;
use std::sync::Arc;

/// Frames that must be lost in a row before the camera is looked for elsewhere.
pub(super) const MIN_LOST_FRAMES: usize = 2;

/// Last frames with a pose that are kept, in case that the camera is lost after them: a start that
/// shows them goes on in their map.
pub(super) const BRIDGE_FRAMES: usize = 8;

/// Looks for a camera that is lost.
#[derive(Debug, Default)]
pub(super) struct LossRecovery {
    /// The last frames with a pose, the newest at the end.
    known: VecDeque<Known>,
    /// Frames without a pose since then.
    lost_in_a_row: usize,
    /// What is being done about a loss that lasts.
    loss: Loss,
}

/// A frame with a pose.
#[derive(Clone, Debug)]
pub(super) struct Known {
    pub frame_index: usize,
    pub timestamp_ns: i64,
    pub pyramid: Arc<Pyramid>,
    /// The keyframe that it was tracked on.
    pub keyframe: KeyframeId,
    pub frame_from_keyframe: Se3,
}

/// What became of a lost frame.
#[derive(Debug)]
pub(super) enum Recovery {
    /// It is still lost.
    None,
    /// It was recognised at a keyframe.
    Recognised(Box<Recognised>, Box<Frame>),
    /// A start shows the frames before the loss: the map goes on there.
    Landed(Box<Landing>, Box<Started>),
    /// A start shows nothing that is known.
    Fragment(Box<Started>),
}

impl LossRecovery {
    /// Frames without a pose since the last with one.
    pub(super) fn lost_in_a_row(&self) -> usize {
        self.lost_in_a_row
    }

    /// Counts a lost frame, and says whether it is worth looking for by its appearance: not so the
    /// first frames of a loss. Those before the map of an earlier session was recognised are.
    pub(super) fn count(&mut self, was_tracked: bool) -> bool {
        self.lost_in_a_row += 1;
        !was_tracked || self.lost_in_a_row >= MIN_LOST_FRAMES
    }

    /// Where a lost frame is, of which places that look like it were `found`. A camera that stays
    /// lost starts anew: in the map where the start shows the last frames before the loss, else as
    /// a fragment.
    pub(super) fn step(
        &mut self,
        setup: &Setup,
        map: &Map,
        frame: Frame,
        found: &[Relocalised],
        in_use: Option<InUse<'_>>,
    ) -> Recovery {
        if let Some(recognised) = relocalise(setup, map, found, &frame, in_use) {
            return Recovery::Recognised(Box::new(recognised), Box::new(frame));
        }
        let has_started = self.loss.advance(setup, map, frame);
        let started = self.loss.started.as_deref().filter(|_| has_started);
        let landing = started.and_then(|started| land(setup, map, &self.known, started));
        match (self.loss.take_started(setup, landing.is_some()), landing) {
            (None, _) => Recovery::None,
            (Some(started), Some(landing)) => Recovery::Landed(Box::new(landing), started),
            (Some(started), None) => Recovery::Fragment(started),
        }
    }

    /// Keeps a frame with a pose in case that the camera is lost after it.
    pub(super) fn remember(&mut self, frame: &Frame, attempt: &Attempt) {
        self.known.push_back(Known {
            frame_index: frame.index,
            timestamp_ns: frame.timestamp_ns,
            pyramid: Arc::clone(&frame.pyramid),
            keyframe: attempt.keyframe,
            frame_from_keyframe: attempt.tracked.alignment.motion.frame_from_keyframe,
        });
        while self.known.len() > BRIDGE_FRAMES {
            self.known.pop_front();
        }
    }

    #[cfg(test)]
    pub(super) fn known(&self) -> &VecDeque<Known> {
        &self.known
    }

    /// Forgets these frames: a map begins that does not know them.
    pub(super) fn forget(&mut self) {
        self.known.clear();
    }

    /// The frames of the loss, as far as they were kept.
    pub(super) fn take_frames(&mut self) -> Vec<BufferedFrame> {
        self.loss.take_frames()
    }

    /// The camera has a pose again; whether it had none.
    pub(super) fn end(&mut self) -> bool {
        self.loss = Loss::default();
        std::mem::take(&mut self.lost_in_a_row) > 0
    }
}

/// What is done about a loss that lasts.
#[derive(Debug, Default)]
struct Loss {
    /// Time of the last frame.
    last_ns: Option<i64>,
    /// Time of the loss in which the camera saw texture.
    textured_ns: i64,
    /// The start of a fragment, from the first lost frame on.
    start: Option<Start>,
    /// What it has found.
    started: Option<Box<Started>>,
}

/// A pause in the video longer than this does not count as time in which the place was not
/// recognised.
const MAX_STEP_NS: i64 = 200_000_000;

impl Loss {
    /// Brings the start of a new fragment forward by a frame; whether it has just succeeded.
    fn advance(&mut self, setup: &Setup, map: &Map, frame: Frame) -> bool {
        let (config, graph) = (&setup.config.fragments, &setup.config.graph);
        let can_be_joined = graph.enabled && graph.places.enabled && !setup.is_frozen;
        if !config.enabled || !can_be_joined || map.apart().count() >= config.max_apart {
            return false;
        }
        self.count(&frame);
        self.prepare(setup, map, frame)
    }

    /// What the start has found, to be used, where the loss has lasted long enough or need not.
    fn take_started(&mut self, setup: &Setup, need_not_last: bool) -> Option<Box<Started>> {
        let lost_secs = self.textured_ns as f64 * 1e-9;
        let is_due = need_not_last || lost_secs >= setup.config.fragments.min_lost_secs;
        self.started.take_if(|_| is_due)
    }

    /// Brings the start forward; frames after it wait to be tracked.
    fn prepare(&mut self, setup: &Setup, map: &Map, frame: Frame) -> bool {
        if let Some(started) = &mut self.started {
            started.later.push(BufferedFrame::new(&frame));
            return false;
        }
        let seed = setup.seed.wrapping_add(u64::from(map.next_fragment()));
        let start = self.start.take();
        let mut start = start.unwrap_or_else(|| Start::new(&setup.config, seed));
        self.started = start.add_frame(frame, setup).ok();
        if self.started.is_none() {
            self.start = Some(start);
        }
        self.started.is_some()
    }

    /// The frames of the loss, as far as they were kept.
    fn take_frames(&mut self) -> Vec<BufferedFrame> {
        match (self.start.take(), self.started.take()) {
            (_, Some(started)) => started.into_frames(),
            (Some(start), None) => start.into_frames(),
            (None, None) => Vec::new(),
        }
    }

    fn count(&mut self, frame: &Frame) {
        let last = self.last_ns.replace(frame.timestamp_ns);
        let step = last.map_or(0, |last| (frame.timestamp_ns - last).abs());
        if has_texture(&frame.pyramid) {
            self.textured_ns += step.min(MAX_STEP_NS);
        }
    }
}

/// Whether enough of an image is not plain: in a covered or overexposed one no place can be
/// recognised.
fn has_texture(pyramid: &Pyramid) -> bool {
    /// Level on which noise is averaged out.
    const LEVEL: usize = 2;
    /// Difference across two pixels, grey levels.
    const MIN_GRADIENT: f32 = 8.0;
    const MIN_SHARE: f64 = 0.01;
    let image = pyramid.level(LEVEL.min(pyramid.num_levels() - 1));
    let (width, height) = (image.width(), image.height());
    let mut textured = 0;
    for y in 1..height.saturating_sub(1) {
        for x in 1..width.saturating_sub(1) {
            let dx = image.at(x + 1, y) - image.at(x - 1, y);
            let dy = image.at(x, y + 1) - image.at(x, y - 1);
            textured += usize::from(dx.hypot(dy) >= MIN_GRADIENT);
        }
    }
    textured as f64 >= MIN_SHARE * (width * height) as f64
}

#[cfg(test)]
mod tests;
