//! A lost camera: recognised, or the beginning of a fragment of the map.
//!
//! A camera that stays lost starts a new fragment, which is joined when it is recognised, unless
//! its start lies in the map already (see `bridge`).
//!
//! Each fragment has a world of its own: the camera of its first keyframe. Everything that compares
//! poses (sparse layer, known views, graph) stays within one. What joins them is the recognition of
//! places, in the graph; the frames of a fragment follow their keyframes, so that the camera goes
//! on as if nothing happened.

use super::relocalise::{Recognised, Resume};
use super::setup::Setup;
use super::slam::Slam;
use crate::frame::{BufferedFrame, Frame};
use crate::graph::Link;
use crate::map::Map;
use crate::start::{Start, Started};
use crate::{Fragment, FrameReport, LostReason};
use monogrid_alignment::Motion;
use monogrid_geometry::Se3;
use monogrid_image::Pyramid;

/// Frames that must be lost in a row before the camera is looked for elsewhere.
const MIN_LOST_FRAMES: usize = 2;

impl Slam {
    /// A lost frame is looked for among all keyframes; where it is not recognised for long, a
    /// fragment of the map is started.
    pub(super) fn find_back(&mut self, frame: Frame, mut report: FrameReport) -> FrameReport {
        let was_tracked = report.keyframe.is_some();
        if was_tracked && self.camera.lost_in_a_row == 0 {
            self.map.lose(self.frame_index);
        }
        self.camera.lost_in_a_row += 1;
        match self.recognise(&frame, was_tracked) {
            Some(recognised) => self.resume(&frame, recognised, &mut report),
            None => self.wait_for_fragment(frame, &mut report),
        }
        self.stopwatch.lap(|times| &mut times.graph);
        report
    }

    /// Where a lost frame is; the first frames of a loss, and those before the map of an earlier
    /// session was recognised, are not worth the same effort.
    fn recognise(&mut self, frame: &Frame, was_tracked: bool) -> Option<Recognised> {
        let places = &self.setup.config.graph.places;
        let is_lost_enough = self.camera.lost_in_a_row >= MIN_LOST_FRAMES;
        if !places.enabled || (was_tracked && !is_lost_enough) {
            return None;
        }
        self.await_graph();
        let found = self.graph.as_mut()?.recognise(&frame.pyramid);
        self.relocalise(&found, frame)
    }

    /// Goes on where the camera was recognised.
    fn resume(&mut self, frame: &Frame, recognised: Recognised, report: &mut FrameReport) {
        let (id, alignment) = (recognised.id, recognised.alignment);
        let left = self.leave();
        let finished = left.as_ref().map(|left| left.id);
        report.finished_keyframe = finished.filter(|_| !self.setup.is_frozen);
        let view = left.and_then(|left| left.view);
        let (keyframe, motion) = match recognised.resume {
            Resume::Known(depth) => {
                if view.is_some() {
                    self.constrain(view, Link::None, false);
                }
                self.map.visit(id, frame.timestamp_ns, None);
                self.use_again(id, depth);
                report.reactivated_keyframe = Some(id);
                (id, alignment.motion)
            }
            Resume::New(successor) => {
                let newest = self.map.next_id();
                self.map.visit(newest, frame.timestamp_ns, None);
                self.make_keyframe(frame, id, &alignment, successor, view);
                report.created_keyframe = true;
                (newest, Motion::from_pose(Se3::identity()))
            }
        };
        self.end_loss(keyframe, true);
        self.camera.last = None;
        self.believe(frame, motion);
        report.place_anew(self.map.locate(keyframe, &motion.frame_from_keyframe));
        report.relocalised = true;
        report.keyframe = Some(keyframe);
        report.covariance = alignment.covariance;
        report.exposure_gain = alignment.gain();
    }

    /// A camera that stays lost starts anew: in the map where the start shows the last frames
    /// before the loss, else as a fragment.
    fn wait_for_fragment(&mut self, frame: Frame, report: &mut FrameReport) {
        let has_started = self.camera.loss.advance(&self.setup, &self.map, frame);
        let started = self.camera.loss.started.as_deref().filter(|_| has_started);
        let landing = started.and_then(|started| self.land(started));
        let started = (self.camera.loss).take_started(&self.setup, landing.is_some());
        let Some(started) = started else {
            if report.keyframe.is_none() {
                report.reason = Some(LostReason::NotRecognised);
            }
            return;
        };
        self.await_graph();
        let first_keyframe = self.map.next_id();
        self.end_loss(first_keyframe, false);
        if let Some(landing) = landing {
            return self.begin_at(&landing, started, report);
        }
        let id = self.map.next_fragment();
        let fragment = Fragment::begun(id, first_keyframe, started.keyframe.index);
        self.map.begin_fragment(fragment);
        self.begin_map(id, started, report);
    }
}

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

/// A pause in the video longer than this does not count as time in which the place was not
/// recognised.
const MAX_STEP_NS: i64 = 200_000_000;

impl Loss {
    /// Brings the start of a new fragment forward by a frame; whether it has just succeeded.
    pub(super) fn advance(&mut self, setup: &Setup, map: &Map, frame: Frame) -> bool {
        let (config, graph) = (&setup.config.fragments, &setup.config.graph);
        let can_be_joined = graph.enabled && graph.places.enabled && !setup.is_frozen;
        if !config.enabled || !can_be_joined || map.apart().count() >= config.max_apart {
            return false;
        }
        self.count(&frame);
        self.prepare(setup, map, frame)
    }

    /// What the start has found, to be used, where the loss has lasted long enough or need not.
    pub(super) fn take_started(&mut self, setup: &Setup, need_not_last: bool) -> Option<Started> {
        let lost_secs = self.textured_ns as f64 * 1e-9;
        let is_due = need_not_last || lost_secs >= setup.config.fragments.min_lost_secs;
        let started = self.started.take_if(|_| is_due);
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
        self.started = start.add_frame(frame, None, setup).ok();
        if self.started.is_none() {
            self.start = Some(start);
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
