//! Tracking goes on with another keyframe.

use super::constrain::{Tie, handover, in_keyframe};
use super::depth::{Successor, successor};
use super::keyframes::finish_keyframe;
use super::outcome::KeyframeChange;
use super::points::adjust_points;
use super::reactivate::Confirmed;
use super::slam::Slam;
use crate::KeyframeId;
use crate::frame::Frame;
use crate::graph::{Link, OdometryEdge};
use crate::map::{FinishedKeyframe, KeyframeImage, NewKeyframe, View, VisitEnd};
use monogrid_alignment::{Alignment, Motion};
use monogrid_geometry::Se3;
use std::sync::Arc;

/// Relative standard deviation of the scale between successive keyframes that tracking and
/// propagation leave.
const ODOMETRY_SCALE_SIGMA: f64 = 0.05;

impl Slam {
    /// Goes on with another keyframe: one that shows the same, or the frame itself.
    pub(super) fn change_keyframe(
        &mut self,
        frame: &Frame,
        alignment: &Alignment,
    ) -> KeyframeChange {
        self.await_graph();
        let motion = &alignment.motion;
        if let Some(known) = self.find_known_view(frame, motion) {
            return self.hand_over(frame, alignment, known);
        }
        let Some(active) = self.camera.active.as_mut() else {
            return KeyframeChange::default();
        };
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
        let scale_sigma = ODOMETRY_SCALE_SIGMA;
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
            Link::Handover(handover(left, found, scale_sigma))
        });
        self.stopwatch.lap(|times| &mut times.depth);
        self.constrain(left.view, link, false);
        self.stopwatch.lap(|times| &mut times.graph);
        let end = VisitEnd {
            frame_from_keyframe: alignment.motion.frame_from_keyframe,
            frame_from_next: found.motion.frame_from_keyframe,
        };
        self.map.visit(id, frame.timestamp_ns, Some(end));
        self.camera.continue_on(found.motion, |step| step * growth);
        self.use_again(id, known.depth);
        KeyframeChange {
            finished: (!self.setup.is_frozen).then_some(left.id),
            reactivated: Some(id),
            created: false,
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
        self.map.visit(newest, frame.timestamp_ns, Some(end));
        let unit = successor.unit;
        self.make_keyframe(frame, left.id, alignment, successor, left.view);
        self.camera
            .continue_on(Motion::from_pose(Se3::identity()), |step| step / unit);
        KeyframeChange {
            finished: Some(left.id),
            reactivated: None,
            created: true,
        }
    }

    /// Makes `frame` the newest keyframe, on top of a parent that it was tracked on; `view` is the
    /// keyframe that was finished for it.
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
        let keyframe_from_frame = motion.frame_from_keyframe.inverse();
        let parent_from_keyframe = keyframe_from_frame.with_scale(unit);
        let older = &self.map[parent];
        self.map.create(NewKeyframe {
            fragment: older.fragment,
            parent: Some(parent),
            frame_index: frame.index,
            timestamp_ns: frame.timestamp_ns,
            image: KeyframeImage::new(self.map.store(), frame.image()),
            exposure: older.exposure.then(motion.log_gain.exp(), motion.bias),
            world_from_keyframe: older.world_from_keyframe * parent_from_keyframe,
        });
        self.stopwatch.lap(|times| &mut times.depth);
        adjust_points(&self.setup, &mut self.map, &depth);
        let link = alignment.covariance.as_ref().map(|covariance| {
            Link::Odometry(OdometryEdge {
                i: parent,
                j: id,
                i_from_j: parent_from_keyframe,
                covariance: in_keyframe(covariance, &keyframe_from_frame),
                scale_sigma: ODOMETRY_SCALE_SIGMA,
            })
        });
        self.constrain(view, link.unwrap_or_default(), false);
        self.stopwatch.lap(|times| &mut times.graph);
        let depth = self.observe_old_keyframes(id, depth);
        self.activate(id, depth);
    }
}
