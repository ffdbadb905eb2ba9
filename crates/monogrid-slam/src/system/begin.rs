//! The first keyframe of the main map, or of a fragment.

use super::bridge::Landing;
use super::camera::Last;
use super::depth::stored_depth;
use super::keyframes::{Use, first_keyframe};
use super::outcome::Attempt;
use super::points::adjust_points;
use super::process::Effort;
use super::slam::Slam;
use crate::frame::{BufferedFrame, Frame};
use crate::graph::Link;
use crate::map::NewKeyframe;
use crate::start::Started;
use crate::{FragmentId, FrameReport, KeyframeId, MAIN_MAP, TrackingState};
use monogrid_geometry::Se3;

impl Slam {
    /// Makes the first keyframe of a fragment and tracks the frames that waited for it: those before it
    /// backwards. Those after it are left to be tracked.
    pub(super) fn begin_map(
        &mut self,
        fragment: FragmentId,
        started: Started,
        report: &mut FrameReport,
    ) {
        let first = first_keyframe(self.map.store(), fragment, &started);
        self.begin_with(first, Link::None, started, report);
        report.started_fragment = Some(fragment).filter(|id| *id != MAIN_MAP);
    }

    /// The same in a map that exists, at a place that is known there.
    pub(super) fn begin_at(
        &mut self,
        landing: &Landing,
        started: Started,
        report: &mut FrameReport,
    ) {
        let id = self.map.next_id();
        let parent = &self.map[landing.parent];
        let first = NewKeyframe {
            parent: Some(parent.id),
            world_from_keyframe: parent.world_from_keyframe * landing.parent_from_start,
            ..first_keyframe(self.map.store(), parent.fragment, &started)
        };
        self.map.bridge(landing.bridge(id, started.keyframe.index));
        self.begin_with(first, landing.link(id), started, report);
    }

    /// Makes the first keyframe of a start.
    fn begin_with(
        &mut self,
        first: NewKeyframe,
        link: Link,
        started: Started,
        report: &mut FrameReport,
    ) {
        let interval_ns = started.first_interval_ns();
        let keyframe = started.keyframe;
        let left = self.leave();
        let id = self.map.next_id();
        self.map.create(first);
        self.map.visit(id, keyframe.timestamp_ns, None);
        adjust_points(&self.setup, &mut self.map, &started.depth);
        if left.is_some() || !matches!(link, Link::None) {
            let view = left.as_ref().and_then(|left| left.view.clone());
            self.constrain(view, link, false);
        }
        self.activate(id, started.depth);
        let at_keyframe = Se3::identity();
        self.map
            .track(keyframe.index, keyframe.timestamp_ns, at_keyframe);

        self.camera.known.clear();
        let moving = |step: Se3| Some(Last::moving(&keyframe, step, interval_ns));
        self.camera.last = moving(started.first_step.inverse());
        self.track_backwards(id, &started.earlier);
        self.return_to(id, keyframe.timestamp_ns);
        self.camera.last = moving(started.first_step);
        self.waiting = started.later;
        report.place_anew(self.map.locate(id, &at_keyframe));
        report.keyframe = Some(id);
        report.created_keyframe = true;
        report.finished_keyframe = left.map(|left| left.id);
    }

    /// Tracks the frames before the first keyframe, the last of them first: on it alone where it shows enough of all of
    /// them, else with keyframes of their own, as long as they can be believed.
    fn track_backwards(&mut self, first: KeyframeId, earlier: &[BufferedFrame]) {
        if let Some(active) = self.camera.active.as_mut() {
            // all views of the start have refined its depth
            active.num_mapped = self.setup.config.keyframes.min_mapped_frames;
        }
        if let (Some(active), Some(last)) = (&self.camera.active, &self.camera.last) {
            let motions = self.track_back(active, last.clone(), earlier);
            if motions.len() == earlier.len() {
                return self.store_backwards(earlier, &motions);
            }
        }
        for buffered in earlier.iter().rev() {
            let frame = self.setup.restored(buffered);
            if !self.step_back(first, &frame) {
                return;
            }
        }
    }

    /// Tracks one of these frames; false where it cannot be believed.
    fn step_back(&mut self, first: KeyframeId, frame: &Frame) -> bool {
        let (Some(active), Some(last)) = (&self.camera.active, &self.camera.last) else {
            return false;
        };
        let attempt = Attempt {
            keyframe: active.id,
            tracked: self.track_on_active(active, last, frame),
        };
        if attempt.tracked.state != TrackingState::Good {
            return false;
        }
        let alignment = &attempt.tracked.alignment;
        self.believe(frame, alignment.motion);
        // without, the depth of the first keyframe would not be kept for the way forward
        let may_change = self.setup.config.keyframes.reactivation.enabled;
        match self.decide_use(&attempt, Effort::Whole) {
            Use::ChangeKeyframe if may_change => {
                self.change_keyframe(frame, alignment);
            }
            Use::RefineDepth if attempt.keyframe != first => self.observe(frame, alignment),
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
        self.map.visit(first, timestamp_ns, None);
        self.use_again(first, depth);
    }
}

#[cfg(test)]
mod tests;
