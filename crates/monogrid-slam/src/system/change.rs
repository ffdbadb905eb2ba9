//! Tracking goes on with another keyframe.

use super::constrain::{Link, Tie, handover, odometry_edge};
use super::depth::{Successor, observe_old_keyframes, successor};
use super::keyframes::{finish_keyframe, new_keyframe};
use super::outcome::{KeyframeChange, NextKeyframe};
use super::reactivate::{Confirmed, find_known_view};
use super::slam::Slam;
use crate::KeyframeId;
use crate::frame::Frame;
use crate::map::{Change, FinishedKeyframe, View, VisitEnd};
use crate::report::Stage;
use monogrid_alignment::{Alignment, Motion};
use monogrid_geometry::{Mat6, Se3};
use std::sync::Arc;

impl Slam {
    /// Goes on with another keyframe: one that shows the same, or the frame itself.
    pub(super) fn change_keyframe(
        &mut self,
        frame: &Frame,
        alignment: &Alignment,
    ) -> KeyframeChange {
        self.await_graph();
        let Some(active) = self.camera.active.as_mut() else {
            return KeyframeChange::default();
        };
        let motion = &alignment.motion;
        let known = find_known_view(&self.setup, &self.map, active, frame, motion);
        if let Some(known) = known {
            return self.hand_over(frame, alignment, known);
        }
        if self.setup.is_frozen {
            // there is no better keyframe; it is looked for again after a while
            active.num_mapped = 0;
            return KeyframeChange::default();
        }
        let (setup, map, active) = (&self.setup, &self.map, &*active);
        let (next, finished) = rayon::join(
            || successor(setup, &active.depth, frame, motion),
            || finish_keyframe(setup, map, active),
        );
        match next {
            Some(next) => self.succeed(frame, alignment, next, finished),
            // no depth can be handed on
            None => KeyframeChange::default(),
        }
    }

    /// Goes on with a keyframe that shows what the frame shows.
    fn hand_over(
        &mut self,
        frame: &Frame,
        alignment: &Alignment,
        known: Confirmed,
    ) -> KeyframeChange {
        let Some(left) = self.leave() else {
            return KeyframeChange::default();
        };
        let (id, found) = (known.id, &known.alignment);
        let (from, to) = (&self.map[left.id], &self.map[id]);
        let growth = from.world_from_keyframe.scale / to.world_from_keyframe.scale;
        let link = alignment.covariance.as_ref().map_or(Link::None, |own| {
            let left = Tie {
                keyframe: from,
                motion: &alignment.motion,
                covariance: own,
            };
            let found = Tie {
                keyframe: to,
                motion: &found.motion,
                covariance: found.covariance.as_ref().unwrap_or(own),
            };
            Link::Handover(handover(left, found))
        });
        self.stopwatch.lap(Stage::Depth);
        self.constrain(left.view, link, false);
        self.stopwatch.lap(Stage::Graph);
        let end = VisitEnd {
            frame_from_keyframe: alignment.motion.frame_from_keyframe,
            frame_from_next: found.motion.frame_from_keyframe,
        };
        self.map
            .apply(Change::Visited(id, frame.timestamp_ns, Some(end)));
        self.camera.continue_on(found.motion, |step| step * growth);
        self.use_again(id, known.depth);
        KeyframeChange {
            finished: (!self.setup.is_frozen).then_some(left.id),
            next: Some(NextKeyframe::Reactivated(id)),
        }
    }

    /// Lets the frame take over from the keyframe in use.
    fn succeed(
        &mut self,
        frame: &Frame,
        alignment: &Alignment,
        successor: Successor,
        finished: FinishedKeyframe,
    ) -> KeyframeChange {
        let left = self.leave_as(finished);
        let end = VisitEnd {
            frame_from_keyframe: alignment.motion.frame_from_keyframe,
            frame_from_next: Se3::identity(),
        };
        let newest = self.map.next_id();
        self.map
            .apply(Change::Visited(newest, frame.timestamp_ns, Some(end)));
        let unit = successor.unit;
        self.make_keyframe(frame, left.id, alignment, successor, left.view);
        self.camera
            .continue_on(Motion::from_pose(Se3::identity()), |step| step / unit);
        KeyframeChange {
            finished: Some(left.id),
            next: Some(NextKeyframe::Created),
        }
    }

    /// Makes `frame` the newest keyframe, on top of a parent that it was tracked on; `view` is the keyframe
    /// that was finished for it.
    pub(super) fn make_keyframe(
        &mut self,
        frame: &Frame,
        parent: KeyframeId,
        alignment: &Alignment,
        successor: Successor,
        view: Option<Arc<View>>,
    ) {
        let Successor { depth, unit } = successor;
        let motion = &alignment.motion;
        let id = self.map.next_id();
        let keyframe = new_keyframe(self.map.store(), frame, &self.map[parent], motion, unit);
        self.map.apply(Change::Created(keyframe));
        self.stopwatch.lap(Stage::Depth);
        self.adjust(&depth);
        let scale_sigma = self.setup.config.graph.odometry_scale_sigma;
        let odometry = |covariance: &Mat6| {
            let edge = odometry_edge(parent, id, motion, unit, covariance, scale_sigma);
            Link::Odometry(edge)
        };
        let link = alignment.covariance.as_ref().map_or(Link::None, odometry);
        self.constrain(view, link, false);
        self.stopwatch.lap(Stage::Graph);
        let depth = observe_old_keyframes(&self.setup, &self.map, &self.map[id], depth);
        self.activate(id, depth);
    }
}
