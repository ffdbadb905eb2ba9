//! The first keyframe of the main map, or of a fragment.

use super::bridge::Landing;
use super::camera::Last;
use super::constrain::Link;
use super::depth::stored_depth;
use super::keyframes::{Use, decide_use, first_keyframe};
use super::missed::track_back;
use super::outcome::{Attempt, Begun, FrameOutcome, Localised};
use super::process::Effort;
use super::slam::Slam;
use super::tracking::track_on_active;
use crate::frame::{BufferedFrame, Frame};
use crate::map::{Change, NewKeyframe, Record};
use crate::start::Started;
use crate::{FragmentId, KeyframeId, MAIN_MAP, TrackingState};
use monogrid_geometry::Se3;

impl Slam {
    /// Makes the first keyframe of a fragment and tracks the frames that waited for it: those before it
    /// backwards. Those after it are left to be tracked.
    pub(super) fn begin_map(&mut self, fragment: FragmentId, started: Started) -> FrameOutcome {
        let first = first_keyframe(
            self.map.store(),
            fragment,
            &started.keyframe,
            started.world_scale,
        );
        let mut outcome = self.begin_with(first, Link::None, started);
        if let Some(begun) = &mut outcome.begun {
            begun.fragment = Some(fragment).filter(|id| *id != MAIN_MAP);
        }
        outcome
    }

    /// The same in a map that exists, at a place that is known there.
    pub(super) fn begin_at(&mut self, landing: &Landing, started: Started) -> FrameOutcome {
        let id = self.map.next_id();
        let parent = &self.map[landing.parent];
        let first = NewKeyframe {
            parent: Some(parent.id),
            world_from_keyframe: parent.world_from_keyframe * landing.parent_from_start,
            ..first_keyframe(
                self.map.store(),
                parent.fragment,
                &started.keyframe,
                started.world_scale,
            )
        };
        let bridge = landing.bridge(id, started.keyframe.index);
        self.map.apply(Change::Bridged(bridge));
        self.begin_with(first, landing.link(id), started)
    }

    /// Makes the first keyframe of a start.
    fn begin_with(&mut self, first: NewKeyframe, link: Link, started: Started) -> FrameOutcome {
        let interval_ns = started.first_interval_ns();
        let Started {
            keyframe,
            depth,
            first_step,
            later,
            earlier,
            ..
        } = started;
        let left = self.leave();
        let id = self.map.next_id();
        self.map.apply(Change::Created(first));
        self.map
            .apply(Change::Visited(id, keyframe.timestamp_ns, None));
        self.adjust(&depth);
        if left.is_some() || !matches!(link, Link::None) {
            let view = left.as_ref().and_then(|left| left.view.clone());
            self.constrain(view, link, false);
        }
        self.activate(id, depth);
        let record = Record::new(keyframe.index, keyframe.timestamp_ns, Se3::identity());
        self.map.apply(Change::Tracked(record));

        self.camera.known.clear();
        let moving = |step: Se3| Some(Last::moving(&keyframe, step, interval_ns));
        self.camera.last = moving(first_step.inverse());
        self.track_backwards(id, &earlier);
        self.return_to(id, keyframe.timestamp_ns);
        self.camera.last = moving(first_step);
        let place = self.map.locate(id, &Se3::identity());
        let mut outcome = FrameOutcome::new(None, Localised::Begun(place));
        outcome.change.finished = left.map(|left| left.id);
        outcome.begun = Some(Begun {
            fragment: None,
            keyframe: id,
            later,
        });
        outcome
    }

    /// Tracks the frames before the first keyframe, the last of them first: on it alone where it shows enough of all of
    /// them, else with keyframes of their own, as long as they can be believed.
    fn track_backwards(&mut self, first: KeyframeId, earlier: &[BufferedFrame]) {
        if let Some(active) = self.camera.active.as_mut() {
            // all views of the start have refined its depth
            active.num_mapped = self.setup.config.keyframes.min_mapped_frames;
        }
        if let (Some(active), Some(last)) = (&self.camera.active, &self.camera.last) {
            let motions = track_back(&self.setup, &self.map, active, last.clone(), earlier);
            if motions.len() == earlier.len() {
                return self.store_backwards(earlier, &motions);
            }
        }
        for buffered in earlier.iter().rev() {
            let frame = self.setup.restored(buffered);
            if !self.track_back(first, &frame) {
                return;
            }
        }
    }

    /// Tracks one of these frames; false where it cannot be believed.
    fn track_back(&mut self, first: KeyframeId, frame: &Frame) -> bool {
        let (Some(active), Some(last)) = (&self.camera.active, &self.camera.last) else {
            return false;
        };
        let attempt = Attempt {
            keyframe: active.id,
            tracked: track_on_active(&self.setup, &self.map, active, last, frame),
            doubt: None,
        };
        if attempt.tracked.state != TrackingState::Good {
            return false;
        }
        let alignment = &attempt.tracked.alignment;
        self.believe(frame, alignment.motion);
        // without, the depth of the first keyframe would not be kept for the way forward
        let may_change = self.setup.config.keyframes.reactivation.enabled;
        match decide_use(
            &self.setup,
            &self.map,
            &self.camera,
            &attempt,
            Effort::Whole,
        ) {
            Use::ChangeKeyframe if may_change => {
                self.change_keyframe(frame, alignment);
            }
            Use::RefineDepth if attempt.keyframe != first => {
                self.observe(frame, &attempt);
            }
            _ => {}
        }
        true
    }

    /// Makes the first keyframe, taken at a time, the one in use again.
    fn return_to(&mut self, first: KeyframeId, timestamp_ns: i64) {
        if let Some(active) = self.camera.active.as_mut().filter(|a| a.id == first) {
            active.num_mapped = 0;
            return;
        }
        let Some(depth) = stored_depth(&self.setup, &self.map[first]) else {
            return;
        };
        self.await_graph();
        if let Some(left) = self.leave() {
            self.constrain(left.view, Link::None, false);
        }
        self.map.apply(Change::Visited(first, timestamp_ns, None));
        self.use_again(first, depth);
    }
}

#[cfg(test)]
mod tests;
