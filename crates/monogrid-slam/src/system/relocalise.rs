//! A camera that is lost finds back to any keyframe that it sees.

use super::graph::Links;
use super::trajectory::Visit;
use super::{Last, Slam};
use crate::frame::Frame;
use crate::graph::Relocalised;
use crate::policy::{KeyframeEvidence, keyframe_score};
use crate::tracker::Tracked;
use crate::{FrameReport, KeyframeId, LostReason, TrackingState};
use monogrid_alignment::Motion;
use monogrid_geometry::Se3;

impl Slam {
    /// The first frames with the map of an earlier session.
    pub(super) fn look_for_place(&mut self, frame: Frame, report: &mut FrameReport) {
        report.reason = Some(LostReason::NotRecognised);
        self.lost_in_a_row += 1;
        if !self.recognise_and_resume(&frame, report) {
            self.await_fragment(frame, report);
        }
    }

    /// Looks for a lost frame among all keyframes; where it is recognised and direct alignment agrees,
    /// tracking goes on there. Where it is not for long, a fragment of the map is started.
    pub(super) fn relocalise(&mut self, frame: Frame, report: &mut FrameReport) {
        let is_lost_enough = self.lost_in_a_row >= self.config.graph.places.min_lost_frames;
        if !(is_lost_enough && self.recognise_and_resume(&frame, report)) {
            self.await_fragment(frame, report);
        }
    }

    fn recognise_and_resume(&mut self, frame: &Frame, report: &mut FrameReport) -> bool {
        for found in self.recognise(&frame.pyramid) {
            // from the pose that its points give
            let predicted = Motion::from_pose(found.frame_from_keyframe);
            let view = &found.view;
            let tracked = self.track_on_other(&view.pyramid, &view.samples, frame, predicted);
            if tracked.state == TrackingState::Good && self.resume(frame, &found, &tracked, report)
            {
                return true;
            }
        }
        false
    }

    /// Goes on with the recognised keyframe where the frame shows about the same, else makes the frame a
    /// keyframe on top of it.
    fn resume(
        &mut self,
        frame: &Frame,
        found: &Relocalised,
        tracked: &Tracked,
        report: &mut FrameReport,
    ) -> bool {
        let alignment = &tracked.alignment;
        let evidence = KeyframeEvidence {
            relative_distance: alignment
                .motion
                .frame_from_keyframe
                .inverse()
                .translation
                .norm(),
            usage: f64::from(alignment.usage),
            ..KeyframeEvidence::default()
        };
        let config = &self.config.keyframes;
        let is_same_view = config.reactivation.enabled
            && self.nodes[found.view.id as usize].rank >= config.reactivation.first_keyframe
            && keyframe_score(&evidence, config) < config.reactivation.max_score;
        let motion =
            if (is_same_view || self.is_frozen) && self.resume_on_known(frame, found, report) {
                alignment.motion
            } else if !self.is_frozen && self.resume_on_new(frame, found, tracked, report) {
                Motion::from_pose(Se3::identity())
            } else {
                return false;
            };
        report.state = TrackingState::Good;
        report.reason = None;
        report.relocalised = true;
        report.covariance = alignment.covariance;
        report.exposure_gain = alignment.gain();
        self.end_loss();
        self.last = Some(Last {
            timestamp_ns: frame.timestamp_ns,
            pyramid: frame.pyramid.clone(),
            motion,
            frame_from_previous: Se3::identity(),
            interval_ns: 0,
        });
        self.remember(frame, motion);
        report.keyframe = self.current_node().map(|node| node.id);
        self.report_pose(report, &motion.frame_from_keyframe);
        self.relocalisations += 1;
        true
    }

    /// Uses the recognised keyframe again.
    fn resume_on_known(
        &mut self,
        frame: &Frame,
        found: &Relocalised,
        report: &mut FrameReport,
    ) -> bool {
        let id = found.view.id;
        let finished = self.finish_current();
        let Some(depth) = self.stored_depth(id) else {
            return false;
        };
        if let Some((left, view)) = finished {
            report.finished_keyframe = Some(left);
            self.submit_graph_job(view, Links::default(), false);
        }
        self.visits.push(Visit::new(id, frame.timestamp_ns));
        self.use_again(id, depth);
        report.reactivated_keyframe = Some(id);
        true
    }

    /// Makes the frame a keyframe on top of the recognised one.
    fn resume_on_new(
        &mut self,
        frame: &Frame,
        found: &Relocalised,
        tracked: &Tracked,
        report: &mut FrameReport,
    ) -> bool {
        let motion = tracked.alignment.motion;
        let image = found.view.pyramid.level(0).clone();
        // as it was when the keyframe was finished
        let Some(depth) = self.sampled_depth(image, &found.view.samples) else {
            return false;
        };
        let Some(successor) = self.successor(&depth, frame, &motion) else {
            return false;
        };
        let finished = self.finish_current();
        report.finished_keyframe = finished.as_ref().map(|(id, _)| *id);
        report.covariance = tracked.alignment.covariance;
        let newest = self.nodes.len() as KeyframeId;
        self.visits.push(Visit::new(newest, frame.timestamp_ns));
        let view = finished.and_then(|(_, view)| view);
        self.begin_keyframe(frame, found.view.id, &motion, successor, view, report);
        report.created_keyframe = true;
        true
    }
}
