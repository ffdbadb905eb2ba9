//! The first keyframe of the main map, or of a fragment.

use super::camera::Last;
use super::constrain::Link;
use super::keyframes::first_keyframe;
use super::outcome::{Begun, FrameOutcome, Localised};
use super::slam::Slam;
use super::tracking::track_on_active;
use crate::frame::BufferedFrame;
use crate::map::{Change, Record};
use crate::start::Started;
use crate::{FragmentId, TrackingState};
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
        self.track_backwards(&earlier);
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

    /// Tracks the frames before the first keyframe, the last of them first, as long as they can be believed.
    fn track_backwards(&mut self, earlier: &[BufferedFrame]) {
        for buffered in earlier.iter().rev() {
            let frame = self.setup.restored(buffered);
            let (Some(active), Some(last)) = (&self.camera.active, &self.camera.last) else {
                return;
            };
            let tracked = track_on_active(&self.setup, &self.map, active, last, &frame);
            if tracked.state != TrackingState::Good {
                return;
            }
            self.believe(&frame, tracked.alignment.motion);
        }
    }
}
