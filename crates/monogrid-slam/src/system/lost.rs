//! A lost camera: recognised, or the beginning of a fragment of the map.

use super::bridge::land;
use super::constrain::Link;
use super::outcome::{Attempt, FrameOutcome, KeyframeChange, Localised, NextKeyframe};
use super::relocalise::{Recognised, Resume, relocalise};
use super::slam::Slam;
use crate::frame::Frame;
use crate::map::Change;
use crate::report::Stage;
use crate::{Fragment, LostReason};
use monogrid_alignment::Motion;
use monogrid_geometry::Se3;

impl Slam {
    /// A lost frame is looked for among all keyframes; where it is not recognised for long, a fragment of the
    /// map is started.
    pub(super) fn find_back(&mut self, frame: Frame, attempt: Option<Attempt>) -> FrameOutcome {
        if attempt.is_some() && self.camera.lost_in_a_row == 0 {
            self.map.apply(Change::Lost(self.frame_index));
        }
        self.camera.lost_in_a_row += 1;
        let recognised = self.recognise(&frame, attempt.is_some());
        let outcome = match recognised {
            Some(recognised) => self.resume(&frame, attempt, recognised),
            None => self.wait_for_fragment(frame, attempt),
        };
        self.stopwatch.lap(Stage::Graph);
        outcome
    }

    /// Where a lost frame is; the first frames of a loss, and those before the map of an earlier session was
    /// recognised, are not worth the same effort.
    fn recognise(&mut self, frame: &Frame, was_tracked: bool) -> Option<Recognised> {
        let places = &self.setup.config.graph.places;
        let is_lost_enough = self.camera.lost_in_a_row >= places.min_lost_frames;
        if !places.enabled || (was_tracked && !is_lost_enough) {
            return None;
        }
        self.await_graph();
        let found = self.graph.as_ref()?.recognise(&frame.pyramid);
        let active = self.camera.active.as_ref();
        relocalise(&self.setup, &self.map, active, &found, frame)
    }

    /// Goes on where the camera was recognised.
    fn resume(
        &mut self,
        frame: &Frame,
        attempt: Option<Attempt>,
        recognised: Recognised,
    ) -> FrameOutcome {
        let Recognised {
            id,
            alignment,
            resume,
        } = recognised;
        let left = self.leave();
        let finished = left.as_ref().map(|left| left.id);
        let finished = finished.filter(|_| !self.setup.is_frozen);
        let view = left.and_then(|left| left.view);
        let (keyframe, motion, next) = match resume {
            Resume::Known(depth) => {
                if view.is_some() {
                    self.constrain(view, Link::None, false);
                }
                self.map
                    .apply(Change::Visited(id, frame.timestamp_ns, None));
                self.use_again(id, depth);
                (id, alignment.motion, NextKeyframe::Reactivated(id))
            }
            Resume::New(successor) => {
                let newest = self.map.next_id();
                self.map
                    .apply(Change::Visited(newest, frame.timestamp_ns, None));
                self.make_keyframe(frame, id, &alignment, successor, view);
                let motion = Motion::from_pose(Se3::identity());
                (newest, motion, NextKeyframe::Created)
            }
        };
        self.end_loss(keyframe, true);
        self.camera.last = None;
        self.believe(frame, motion);
        let localised = Localised::Relocalised {
            place: self.map.locate(keyframe, &motion.frame_from_keyframe),
            keyframe,
            alignment: Box::new(alignment),
        };
        FrameOutcome {
            change: KeyframeChange {
                finished,
                next: Some(next),
            },
            ..FrameOutcome::new(attempt, localised)
        }
    }

    /// A camera that stays lost starts anew: in the map where the start shows the last frames before the loss, else as a
    /// fragment.
    fn wait_for_fragment(&mut self, frame: Frame, attempt: Option<Attempt>) -> FrameOutcome {
        let has_started = self.camera.loss.advance(&self.setup, &self.map, frame);
        let started = self.camera.loss.started().filter(|_| has_started);
        let landing = started.and_then(|s| land(&self.setup, &self.map, &self.camera.known, s));
        let started = (self.camera.loss).take_started(&self.setup, landing.is_some());
        let Some(started) = started else {
            let reason = match &attempt {
                Some(attempt) => attempt.tracked.reason,
                None => Some(LostReason::NotRecognised),
            };
            return FrameOutcome::new(attempt, Localised::Lost(reason));
        };
        self.await_graph();
        let first_keyframe = self.map.next_id();
        self.end_loss(first_keyframe, false);
        let outcome = match landing {
            Some(landing) => self.begin_at(&landing, started),
            None => {
                let id = self.map.next_fragment();
                let fragment = Fragment::begun(id, first_keyframe, started.keyframe.index);
                self.map.apply(Change::Started(fragment));
                self.begin_map(id, started)
            }
        };
        FrameOutcome {
            attempt: outcome.attempt.or(attempt),
            ..outcome
        }
    }
}
