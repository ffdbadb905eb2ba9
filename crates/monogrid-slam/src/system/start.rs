//! The first keyframe of the main map, or of a fragment.

use super::graph::Links;
use super::trajectory::Visit;
use super::{Last, NUM_LEVELS, Record, Slam};
use crate::frame::Frame;
use crate::node::Exposure;
use crate::report::milliseconds;
use crate::start::{Start, StartOutcome, Started};
use crate::{FragmentId, FrameReport, KeyframeId, MAIN_MAP, Scale, TrackingState};
use monogrid_alignment::Motion;
use monogrid_geometry::{Rotation, Se3, Sim3, Vec3};
use std::time::Instant;

impl Slam {
    /// One frame before there is a map.
    pub(super) fn process_start(
        &mut self,
        mut start: Start,
        frame: Frame,
        seed_depth: Option<&monogrid_image::GrayImage>,
        begin: Instant,
    ) -> FrameReport {
        let mut report =
            FrameReport::new(frame.index, frame.timestamp_ns, TrackingState::Initialising);
        match start.add_frame(frame, seed_depth, &self.pinhole, &self.mask, &self.config) {
            StartOutcome::Waiting(reason) => {
                report.reason = Some(reason);
                self.start = Some(start);
            }
            StartOutcome::Started(started) => {
                self.scale = started.scale;
                self.sparse.has_seed = started.scale == Scale::Metric;
                self.begin_map(MAIN_MAP, *started, &mut report);
            }
        }
        report.milliseconds.tracking = milliseconds(begin);
        report
    }

    /// Makes the first keyframe of a fragment and tracks the frames that waited for it: those after it in
    /// their order, those before it backwards.
    pub(super) fn begin_map(
        &mut self,
        fragment: FragmentId,
        started: Started,
        report: &mut FrameReport,
    ) {
        let Started {
            keyframe,
            depth,
            world_scale,
            scale: _,
            first_step,
            later,
            earlier,
        } = started;
        let left = self.finish_current();
        let left_id = left.as_ref().map(|(id, _)| *id);
        let id = self.nodes.len() as KeyframeId;
        self.visits.push(Visit::new(id, keyframe.timestamp_ns));
        let fragment_from_keyframe = Sim3::new(world_scale, Rotation::identity(), Vec3::zeros());
        self.push_node(
            &keyframe,
            fragment,
            None,
            fragment_from_keyframe,
            Exposure::NEUTRAL,
        );
        self.adjust(&depth);
        if let Some((_, view)) = left {
            self.submit_graph_job(view, Links::default(), false);
        }
        self.set_current(id, depth);
        self.records.push(Record {
            frame_index: keyframe.index,
            timestamp_ns: keyframe.timestamp_ns,
            visit: self.visits.len() - 1,
            frame_from_keyframe: Se3::identity(),
        });
        let interval_ns = later.first().or(earlier.last()).map_or(0, |other| {
            (other.timestamp_ns - keyframe.timestamp_ns).abs()
        });
        let moving = |frame_from_previous: Se3| Last {
            timestamp_ns: keyframe.timestamp_ns,
            pyramid: keyframe.pyramid.clone(),
            motion: Motion::from_pose(Se3::identity()),
            frame_from_previous,
            interval_ns,
        };
        self.last = Some(moving(first_step.inverse()));
        let finest = self.config.tracking.alignment.finest_level;
        for buffered in earlier.iter().rev() {
            let frame = buffered.restore(&self.pinhole, finest, NUM_LEVELS);
            // Stops at the first frame that cannot be believed.
            let Some(motion) = self.track_silently(&frame) else {
                break;
            };
            self.remember(&frame, motion);
        }
        self.last = Some(moving(first_step));
        for buffered in &later {
            let begin = Instant::now();
            let frame = buffered.restore(&self.pinhole, finest, NUM_LEVELS);
            *report = self.process_running(frame, begin);
        }
        report.created_keyframe = true;
        report.keyframe = Some(id);
        if later.is_empty() {
            report.state = TrackingState::Good;
            self.report_pose(report, &Se3::identity());
        }
        report.finished_keyframe = left_id.or(report.finished_keyframe);
    }
}
