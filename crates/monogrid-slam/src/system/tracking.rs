//! A frame is tracked on the current keyframe, and believed or not.

use super::{Current, Last, Record, Slam};
use crate::frame::Frame;
use crate::policy::{KeyframeEvidence, is_new_keyframe};
use crate::report::milliseconds;
use crate::tracker::{MotionPrior, Tracked, extrapolate, is_convincing, track};
use crate::{FrameInput, FrameReport, LostReason, TrackingState};
use monogrid_alignment::{DepthSample, Motion, Reference};
use monogrid_geometry::Se3;
use monogrid_image::Pyramid;
use std::time::Instant;

impl Slam {
    /// A byte-identical image has the pose of the one before and adds no information.
    pub(super) fn repeat(&mut self, input: &FrameInput) -> Option<FrameReport> {
        let last = self.last.as_ref()?;
        if self.start.is_some() || self.lost_in_a_row > 0 || last.pyramid.level(0) != &input.image {
            return None;
        }
        let node = self.current_node()?.id;
        let record = Record {
            frame_index: input.index,
            timestamp_ns: input.timestamp_ns,
            visit: self.visits.len().checked_sub(1)?,
            frame_from_keyframe: last.motion.frame_from_keyframe,
        };
        let mut report = FrameReport::new(input.index, input.timestamp_ns, TrackingState::Good);
        report.reason = Some(LostReason::Repeated);
        self.report_pose(&mut report, &record.frame_from_keyframe);
        report.keyframe = Some(node);
        report.exposure_gain = last.motion.log_gain.exp() as f32;
        self.records.push(record);
        Some(report)
    }

    /// One frame of normal operation: track, then refine the depth or make a keyframe; or find back.
    pub(super) fn process_running(&mut self, frame: Frame, begin: Instant) -> FrameReport {
        let mut report = FrameReport::new(frame.index, frame.timestamp_ns, TrackingState::Lost);
        self.count_graph_frame();
        report.milliseconds.graph = milliseconds(begin);
        let begin = Instant::now();
        let (Some(current), Some(last)) = (self.current.as_ref(), self.last.as_ref()) else {
            self.look_for_place(frame, &mut report);
            report.milliseconds.graph += milliseconds(begin);
            return report;
        };
        let tracked = self.doubt(self.track_on(current, last, &frame));
        report.milliseconds.tracking = milliseconds(begin);
        self.report_tracking(&tracked, &mut report);
        if tracked.state == TrackingState::Lost {
            self.lose(frame, &mut report);
        } else {
            self.follow(&frame, &tracked, &mut report);
        }
        report
    }

    /// Tracks a frame on the current keyframe without touching the map.
    pub(super) fn track_silently(&self, frame: &Frame) -> Option<Motion> {
        let (current, last) = (self.current.as_ref()?, self.last.as_ref()?);
        let tracked = self.track_on(current, last, frame);
        (tracked.state == TrackingState::Good).then_some(tracked.alignment.motion)
    }

    /// Tracks a frame on the current keyframe from where the motion of the last frames leads.
    fn track_on(&self, current: &Current, last: &Last, frame: &Frame) -> Tracked {
        let interval_ns = (frame.timestamp_ns - last.timestamp_ns).abs();
        let frame_from_last = if self.config.tracking.motion_hypotheses {
            extrapolate(&last.frame_from_previous, last.interval_ns, interval_ns)
        } else {
            Se3::identity()
        };
        let prior = MotionPrior {
            last_from_keyframe: last.motion,
            frame_from_last,
        };
        track(
            &current.reference,
            frame,
            &prior,
            Some(&last.pyramid),
            &self.pinhole,
            &self.config.tracking,
        )
    }

    /// Tracks a frame on a keyframe that is not the current one, from a predicted pose.
    pub(super) fn track_on_other(
        &self,
        keyframe: &Pyramid,
        samples: &[DepthSample],
        frame: &Frame,
        predicted: Motion,
    ) -> Tracked {
        let reference = self.reference(keyframe, samples);
        let prior = MotionPrior {
            last_from_keyframe: predicted,
            frame_from_last: Se3::identity(),
        };
        let config = &self.config.tracking;
        track(&reference, frame, &prior, None, &self.pinhole, config)
    }

    /// The points of a keyframe that frames are tracked on.
    pub(super) fn reference(&self, keyframe: &Pyramid, samples: &[DepthSample]) -> Reference {
        let levels = &self.config.tracking.alignment;
        Reference::new(
            keyframe,
            &self.pinhole,
            samples,
            levels.finest_level,
            levels.coarsest_level,
        )
    }

    /// After a loss, far from where the camera should be, or with degraded residuals, a pose must be
    /// convincing to count.
    fn doubt(&self, tracked: Tracked) -> Tracked {
        let was_lost = self.lost_in_a_row > 0;
        let is_doubtful =
            was_lost || tracked.is_surprising || tracked.state == TrackingState::Degraded;
        if tracked.state == TrackingState::Lost
            || !is_doubtful
            || is_convincing(&tracked.alignment, was_lost, &self.config.tracking)
        {
            return tracked;
        }
        Tracked {
            state: TrackingState::Lost,
            reason: Some(LostReason::Residuals),
            ..tracked
        }
    }

    fn report_tracking(&self, tracked: &Tracked, report: &mut FrameReport) {
        let alignment = &tracked.alignment;
        report.state = tracked.state;
        report.reason = tracked.reason;
        report.residual = alignment.residual_rms;
        report.good_share = alignment.good_of_visible;
        report.usage = alignment.usage;
        report.exposure_gain = alignment.gain();
        report.keyframe = self.current_node().map(|node| node.id);
    }

    /// A frame that could not be tracked is looked for elsewhere.
    fn lose(&mut self, frame: Frame, report: &mut FrameReport) {
        if self.lost_in_a_row == 0 {
            self.lost_episodes += 1;
        }
        self.lost_in_a_row += 1;
        let before = Instant::now();
        self.relocalise(frame, report);
        report.milliseconds.graph += milliseconds(before);
    }

    /// A tracked frame makes the map better: it refines the depth of its keyframe, or becomes one.
    fn follow(&mut self, frame: &Frame, tracked: &Tracked, report: &mut FrameReport) {
        self.end_loss();
        let alignment = &tracked.alignment;
        report.covariance = alignment.covariance;
        let motion = alignment.motion;
        self.remember(frame, motion);
        self.report_pose(report, &motion.frame_from_keyframe);
        let after_tracking = Instant::now();
        let graph_before = report.milliseconds.graph;
        let evidence = KeyframeEvidence {
            relative_distance: motion.frame_from_keyframe.inverse().translation.norm(),
            usage: f64::from(alignment.usage),
            num_mapped: self.current.as_ref().map_or(0, |c| c.num_mapped),
            num_keyframes: self.num_keyframes_in(self.current_fragment()),
        };
        if is_new_keyframe(&evidence, &self.config.keyframes) {
            self.leave_keyframe(frame, &motion, report);
        } else if tracked.state == TrackingState::Good {
            self.refine_depth(frame, alignment);
        }
        report.milliseconds.depth =
            milliseconds(after_tracking) - (report.milliseconds.graph - graph_before);
    }

    /// Stores a believed pose and makes it the prior of the next frame.
    pub(super) fn remember(&mut self, frame: &Frame, motion: Motion) {
        let Some(visit) = self.visits.len().checked_sub(1) else {
            return;
        };
        let (frame_from_previous, interval_ns) = match &self.last {
            Some(last) => (
                motion.frame_from_keyframe * last.motion.frame_from_keyframe.inverse(),
                (frame.timestamp_ns - last.timestamp_ns).abs(),
            ),
            None => (Se3::identity(), 0),
        };
        self.last = Some(Last {
            timestamp_ns: frame.timestamp_ns,
            pyramid: frame.pyramid.clone(),
            motion,
            frame_from_previous,
            interval_ns,
        });
        self.records.push(Record {
            frame_index: frame.index,
            timestamp_ns: frame.timestamp_ns,
            visit,
            frame_from_keyframe: motion.frame_from_keyframe,
        });
    }
}
