//! A camera that stays lost starts a new fragment of the map, which is joined when it is recognised, unless its start lies in
//! the map already (see `bridge`).
//!
//! Each fragment has a world of its own: the camera of its first keyframe. Everything that compares poses
//! (sparse layer, known views, graph) stays within one. What joins them is the recognition of places, in the
//! graph; the frames of a fragment follow their keyframes, so that the camera goes on as if nothing happened.

use super::setup::Setup;
use crate::frame::{BufferedFrame, Frame};
use crate::map::Map;
use crate::start::{Start, StartOutcome, Started};
use monogrid_image::Pyramid;

/// What is done about a loss that lasts.
#[derive(Debug, Default)]
pub(super) struct Loss {
    /// Time of the last frame.
    last_ns: Option<i64>,
    /// Time of the loss in which the camera saw texture.
    textured_ns: i64,
    /// The start of a fragment, from the first lost frame on.
    start: Option<Start>,
    /// What it has found.
    started: Option<Box<Started>>,
}

/// A pause in the video longer than this does not count as time in which the place was not recognised.
const MAX_STEP_NS: i64 = 200_000_000;

impl Loss {
    /// Brings the start of a new fragment forward by a frame; whether it has just succeeded.
    pub(super) fn advance(&mut self, setup: &Setup, map: &Map, frame: Frame) -> bool {
        let config = &setup.config.fragments;
        let graph = &setup.config.graph;
        let can_be_joined = graph.enabled && graph.places.enabled;
        if !config.enabled || !can_be_joined || setup.is_frozen {
            return false;
        }
        if map.num_apart() >= config.max_apart {
            return false;
        }
        self.count(&frame);
        self.prepare(setup, map, frame)
    }

    /// What the start has found, where it has.
    pub(super) fn started(&self) -> Option<&Started> {
        self.started.as_deref()
    }

    /// The same, to be used, where the loss has lasted long enough or need not.
    pub(super) fn take_started(&mut self, setup: &Setup, need_not_last: bool) -> Option<Started> {
        let lost_secs = self.textured_ns as f64 * 1e-9;
        let is_due = need_not_last || lost_secs >= setup.config.fragments.min_lost_secs;
        let started = if is_due { self.started.take() } else { None };
        started.map(|started| *started)
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
        match start.add_frame(frame, None, &setup.pinhole, &setup.mask, &setup.config) {
            StartOutcome::Waiting(_) => self.start = Some(start),
            StartOutcome::Started(started) => self.started = Some(started),
        }
        self.started.is_some()
    }

    /// The frames of the loss, as far as they were kept.
    pub(super) fn take_frames(&mut self) -> Vec<BufferedFrame> {
        match (self.start.take(), self.started.take()) {
            (_, Some(started)) => started.into_frames(),
            (Some(start), None) => start.into_frames(),
            (None, None) => Vec::new(),
        }
    }

    fn count(&mut self, frame: &Frame) {
        let step = self
            .last_ns
            .map_or(0, |last| (frame.timestamp_ns - last).abs());
        self.last_ns = Some(frame.timestamp_ns);
        if has_texture(&frame.pyramid) {
            self.textured_ns += step.min(MAX_STEP_NS);
        }
    }
}

/// Whether enough of an image is not plain: in a covered or overexposed one no place can be recognised.
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
