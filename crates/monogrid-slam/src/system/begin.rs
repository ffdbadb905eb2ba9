//! The first keyframe of the main map, or of a fragment.

use super::camera::Last;
use super::constrain::Link;
use super::depth::stored_depth;
use super::keyframes::{Use, decide_use, first_keyframe};
use super::missed::track_back;
use super::outcome::{Attempt, Begun, FrameOutcome, Localised};
use super::slam::Slam;
use super::tracking::track_on_active;
use crate::frame::{BufferedFrame, Frame};
use crate::map::{Change, Record};
use crate::start::Started;
use crate::{FragmentId, KeyframeId, TrackingState};
use monogrid_alignment::Motion;
use monogrid_geometry::Se3;

impl Slam {
    /// Makes the first keyframe of a fragment and tracks the frames that waited for it: those before it
    /// backwards. Those after it are left to be tracked.
    pub(super) fn begin_map(&mut self, fragment: FragmentId, started: Started) -> FrameOutcome {
        let Started {
            keyframe,
            depth,
            world_scale,
            scale: _,
            first_step,
            later,
            earlier,
        } = started;
        let left = self.leave();
        let id = self.map.next_id();
        let first = first_keyframe(fragment, &keyframe, world_scale);
        self.map.apply(Change::Created(first));
        self.map
            .apply(Change::Visited(id, keyframe.timestamp_ns, None));
        self.adjust(&depth);
        if let Some(left) = &left {
            self.constrain(left.view.clone(), Link::None, false);
        }
        self.activate(id, depth);
        let record = Record::new(keyframe.index, keyframe.timestamp_ns, Se3::identity());
        self.map.apply(Change::Tracked(record));

        let next = later.first().or(earlier.last());
        let interval_ns = next.map_or(0, |next| (next.timestamp_ns - keyframe.timestamp_ns).abs());
        let moving = |frame_from_previous: Se3| Last {
            frame_from_previous,
            interval_ns,
            ..Last::after(None, &keyframe, Motion::from_pose(Se3::identity()))
        };
        self.camera.last = Some(moving(first_step.inverse()));
        self.track_backwards(id, &earlier);
        self.return_to(id, keyframe.timestamp_ns);
        self.camera.last = Some(moving(first_step));
        let place = self.map.locate(id, &Se3::identity());
        let mut outcome = FrameOutcome::new(None, Localised::Begun(place));
        outcome.change.finished = left.map(|left| left.id);
        outcome.begun = Some(Begun {
            fragment,
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
        };
        if attempt.tracked.state != TrackingState::Good {
            return false;
        }
        let alignment = &attempt.tracked.alignment;
        self.believe(frame, alignment.motion);
        // without, the depth of the first keyframe would not be kept for the way forward
        let may_change = self.setup.config.keyframes.reactivation.enabled;
        match decide_use(&self.setup, &self.map, &self.camera, &attempt) {
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
