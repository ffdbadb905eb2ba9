//! What stages have found is applied here, and only here: the map changes by its own methods, and
//! each stage hears of what it has to go on with.

use super::bridge::Landing;
use super::change::{NextKeyframe, handover_link, keyframe_of, odometry_link};
use super::constrain::{GraphLink, graph_job};
use super::depth::{DepthStage, Successor, observe_old_keyframes, stored_depth};
use super::inertia::Placement;
use super::keyframes::{Effort, KeyframePolicy, Use, finish_keyframe, first_keyframe, view_of};
use super::lost::{MIN_LOST_FRAMES, Recovery};
use super::outcome::{Attempt, KeyframeChange};
use super::points::{adjust_points, adjust_whole};
use super::reactivate::Confirmed;
use super::relocalise::{InUse, Recognised, Resume};
use super::slam::Slam;
use super::tracking::{Active, Last};
use crate::depth_step::tracking_samples;
use crate::frame::{BufferedFrame, Frame};
use crate::graph::{GraphUpdate, Link};
use crate::map::{FinishedKeyframe, NewKeyframe, VisitEnd};
use crate::policy::larger_map;
use crate::start::Started;
use crate::view::{NUM_LEVELS, View};
use crate::{
    Fragment, FragmentId, FrameReport, KeyframeId, LostReason, MAIN_MAP, Scale, TrackingState,
};
use monogrid_alignment::{Alignment, Motion};
use monogrid_depth::DepthMap;
use monogrid_geometry::Se3;
use monogrid_image::Pyramid;
use std::sync::Arc;

/// The keyframe that was in use.
pub(super) struct Left {
    pub id: KeyframeId,
    /// What the graph needs of it.
    pub view: Option<Arc<View>>,
}

/// A frame is believed, and what it is for.
impl Slam {
    /// The pose of a frame is believed; a loss, if there was one, ends with it.
    pub(super) fn accept(&mut self, frame: &Frame, attempt: &Attempt) {
        let motion = attempt.tracked.alignment.motion;
        self.recovery.remember(frame, attempt);
        let missed = self.recovery.take_frames();
        let tracked = (frame, motion);
        let motions = (self.tracker).find_missed(&self.setup, &self.map, tracked, &missed);
        self.store_backwards(&missed, &motions);
        self.end_loss(attempt.keyframe, false);
        self.believe(frame, motion);
    }

    /// Does with a tracked frame what it is for.
    pub(super) fn make_use(
        &mut self,
        frame: &Frame,
        alignment: &Alignment,
        what: Use,
        report: &mut FrameReport,
    ) {
        if matches!(what, Use::RefineDepth | Use::PassOver) {
            self.take_measured(frame, &alignment.motion);
        }
        match what {
            Use::RefineDepth => self.refine(frame, alignment),
            Use::ChangeKeyframe => {
                let change = self.change_keyframe(frame, alignment);
                report.finished_keyframe = change.finished;
                report.created_keyframe = change.created;
                report.reactivated_keyframe = change.reactivated;
                self.join_by_inertia();
            }
            Use::PassOver => self.policy.passed_over(),
            Use::None => {}
        }
        self.stopwatch.lap(|times| &mut times.depth);
    }

    /// Stores the pose of a frame on the keyframe in use.
    pub(super) fn store_pose(&mut self, frame_index: usize, timestamp_ns: i64, pose: Se3) {
        self.map.track(frame_index, timestamp_ns, pose);
    }

    /// Stores a believed pose and makes it the prior of the next frame.
    fn believe(&mut self, frame: &Frame, motion: Motion) {
        self.store_pose(frame.index, frame.timestamp_ns, motion.frame_from_keyframe);
        self.tracker.believe(frame, motion);
    }

    /// Stores the poses of frames, the last of them first, as far as they are known.
    fn store_backwards(&mut self, frames: &[BufferedFrame], motions: &[Motion]) {
        for (frame, motion) in frames.iter().rev().zip(motions) {
            self.store_pose(frame.index, frame.timestamp_ns, motion.frame_from_keyframe);
        }
    }

    /// The frame refines the depth of the keyframe in use.
    fn refine(&mut self, frame: &Frame, alignment: &Alignment) {
        if self.setup.is_frozen {
            return self.policy.refined(None);
        }
        if let Some(samples) = self.depth.step(&self.setup, frame, alignment) {
            self.tracker.follow_depth(&self.setup, &samples);
            let place = alignment.motion.frame_from_keyframe.inverse().translation;
            self.policy.refined(Some(place));
        }
    }

    /// What a depth camera measured with the frame is taken by the keyframe in use, if that has
    /// nothing measured: depth images may come at another rate than frames.
    fn take_measured(&mut self, frame: &Frame, motion: &Motion) {
        let active = self.tracker.active.as_ref().map(|active| active.id);
        let (Some(id), Some(measured)) = (active, &frame.measured) else {
            return;
        };
        let Some(metres) = self.map.metres(id) else {
            return;
        };
        if self.setup.is_frozen || self.map[id].measured.is_some() {
            return;
        }
        let keyframe_from_frame = motion.frame_from_keyframe.inverse().stretched(metres);
        let seen = measured.seen_from(&keyframe_from_frame, &self.setup.pinhole);
        if let Some(samples) = self.depth.take_measured(&self.setup, (&seen, metres)) {
            self.tracker.follow_depth(&self.setup, &samples);
        }
        self.map.measure(id, &seen);
    }

    /// Goes on with another keyframe: one that shows the same, or the frame itself.
    fn change_keyframe(&mut self, frame: &Frame, alignment: &Alignment) -> KeyframeChange {
        self.await_graph();
        let motion = &alignment.motion;
        let Some(in_use) = InUse::of(&self.tracker, &self.depth) else {
            return KeyframeChange::default();
        };
        let (id, pose) = (in_use.keyframe, &motion.frame_from_keyframe);
        let still = frame.without_moving(&self.map, id, pose, self.setup.pinhole);
        let frame = still.as_ref().unwrap_or(frame);
        match NextKeyframe::choose(&self.setup, &self.map, in_use, frame, motion) {
            NextKeyframe::Known(known) => self.hand_over(frame, alignment, *known),
            NextKeyframe::Frame(next) => self.succeed(frame, alignment, next.0, next.1),
            NextKeyframe::NoBetter => {
                self.policy.wait();
                KeyframeChange::default()
            }
            NextKeyframe::None => KeyframeChange::default(),
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
        let link = handover_link((from, alignment), (to, found));
        self.stopwatch.lap(|times| &mut times.depth);
        self.constrain(left.view, link, false);
        self.stopwatch.lap(|times| &mut times.graph);
        let end = VisitEnd {
            frame_from_keyframe: alignment.motion.frame_from_keyframe,
            frame_from_next: found.motion.frame_from_keyframe,
        };
        self.map.visit(id, frame.timestamp_ns, Some(end));
        self.tracker.continue_on(found.motion, |step| step * growth);
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
        self.tracker
            .continue_on(Motion::from_pose(Se3::identity()), |step| step / unit);
        KeyframeChange {
            finished: Some(left.id),
            reactivated: None,
            created: true,
        }
    }

    /// Makes `frame` the newest keyframe, on top of a parent that it was tracked on; `view` is the
    /// keyframe that was finished for it.
    fn make_keyframe(
        &mut self,
        frame: &Frame,
        parent: KeyframeId,
        alignment: &Alignment,
        successor: Successor,
        view: Option<Arc<View>>,
    ) {
        let Successor { depth, unit } = successor;
        let id = self.map.next_id();
        let new = keyframe_of(&self.map, frame, parent, &alignment.motion, unit);
        self.map.create(new);
        self.stopwatch.lap(|times| &mut times.depth);
        adjust_points(&self.setup, &mut self.map, &depth);
        let link = odometry_link(parent, id, alignment, unit);
        self.constrain(view, link, false);
        self.stopwatch.lap(|times| &mut times.graph);
        let depth = observe_old_keyframes(&self.setup, &self.map, id, depth);
        self.activate(id, depth);
    }
}

/// The keyframe in use, and the graph.
impl Slam {
    /// Publishes the keyframe in use, which is in use no longer.
    pub(super) fn leave(&mut self) -> Option<Left> {
        let id = self.tracker.active.take()?.id;
        let depth = self.depth.take()?;
        if self.setup.is_frozen {
            return Some(Left { id, view: None });
        }
        let finished = finish_keyframe(&self.setup, &self.map, id, &depth);
        Some(self.leave_as(finished))
    }

    /// The same with what is to be published of it.
    fn leave_as(&mut self, finished: FinishedKeyframe) -> Left {
        self.tracker.active = None;
        self.depth.take();
        let left = Left {
            id: finished.id,
            view: finished.view.clone(),
        };
        self.map.finish(finished);
        left
    }

    /// Makes a keyframe that was left the one in use again.
    fn use_again(&mut self, id: KeyframeId, depth: DepthMap) {
        self.map.reactivate(id);
        self.activate(id, depth);
    }

    fn activate(&mut self, id: KeyframeId, depth: DepthMap) {
        let pyramid = self.map[id].pyramid();
        let made_again = || Arc::new(Pyramid::new(depth.host().image.clone(), NUM_LEVELS));
        let pyramid = pyramid.unwrap_or_else(made_again);
        let samples = tracking_samples(&depth, &self.setup.config.tracking);
        self.tracker.active = Some(Active::new(&self.setup, id, pyramid, &samples));
        self.depth = DepthStage::of(depth);
        self.policy = KeyframePolicy::default();
    }

    /// Gives the graph a finished keyframe and the poses as they are now.
    pub(super) fn constrain(&mut self, finished: Option<Arc<View>>, link: Link, is_final: bool) {
        if let Some(graph) = self.graph.as_mut().filter(|_| !self.setup.is_frozen) {
            graph.submit(graph_job(&self.setup, &self.map, finished, link, is_final));
        }
    }

    /// Takes over the result of the graph's job under way, waiting for it when it is not ready.
    pub(super) fn await_graph(&mut self) {
        let update = self.graph.as_mut().and_then(GraphLink::wait);
        self.follow_graph(update);
    }

    /// Takes over what the graph has found, if it has.
    pub(super) fn follow_graph(&mut self, update: Option<GraphUpdate>) {
        if let Some(update) = update {
            self.map.follow_graph(update, self.frame_index);
        }
    }
}

/// A loss, and what ends it.
impl Slam {
    /// A frame is lost; whether it is worth looking for.
    pub(super) fn count_lost(&mut self, was_tracked: bool) -> bool {
        if was_tracked && self.recovery.lost_in_a_row() == 0 {
            self.map.lose(self.frame_index);
        }
        self.recovery.count(was_tracked)
    }

    /// The keyframe on which the camera was lost, as it is, for the first frame that is looked for.
    pub(super) fn lost_on(&self) -> Option<Arc<View>> {
        let is_first = self.recovery.lost_in_a_row() == MIN_LOST_FRAMES;
        if self.graph.is_none() || !is_first || self.setup.is_frozen {
            return None;
        }
        let (active, depth) = (self.tracker.active.as_ref()?, self.depth.get()?);
        let view = view_of(&self.setup, &self.map, active.id, depth);
        Some(Arc::new(view))
    }

    /// What became of a lost frame.
    pub(super) fn recover(&mut self, recovery: Recovery, report: &mut FrameReport) {
        match recovery {
            Recovery::None => {
                if report.keyframe.is_none() {
                    report.reason = Some(LostReason::NotRecognised);
                }
            }
            Recovery::Recognised(recognised, frame) => self.resume(&frame, *recognised, report),
            Recovery::Landed(landing, started) => {
                self.await_graph();
                self.end_loss(self.map.next_id(), false);
                self.begin_at(&landing, *started, report);
            }
            Recovery::Fragment(started) => {
                self.await_graph();
                let first_keyframe = self.map.next_id();
                self.end_loss(first_keyframe, false);
                let id = self.map.next_fragment();
                let fragment = Fragment::begun(id, first_keyframe, started.keyframe.index);
                self.map.begin_fragment(fragment);
                self.begin_map(id, *started, report);
            }
        }
    }

    /// The camera has a pose again, on a keyframe.
    fn end_loss(&mut self, keyframe: KeyframeId, is_recognised: bool) {
        if self.recovery.end() {
            self.map.find(self.frame_index, keyframe, is_recognised);
        }
    }

    /// Goes on where the camera was recognised.
    fn resume(&mut self, frame: &Frame, recognised: Recognised, report: &mut FrameReport) {
        let (id, alignment) = (recognised.id, recognised.alignment);
        let left = self.leave();
        let finished = left.as_ref().map(|left| left.id);
        report.finished_keyframe = finished.filter(|_| !self.setup.is_frozen);
        let view = left.and_then(|left| left.view);
        let (keyframe, motion) = match recognised.resume {
            Resume::Known(depth) => {
                if view.is_some() {
                    self.constrain(view, Link::None, false);
                }
                self.map.visit(id, frame.timestamp_ns, None);
                self.use_again(id, depth);
                report.reactivated_keyframe = Some(id);
                (id, alignment.motion)
            }
            Resume::New(successor) => {
                let newest = self.map.next_id();
                self.map.visit(newest, frame.timestamp_ns, None);
                self.make_keyframe(frame, id, &alignment, successor, view);
                report.created_keyframe = true;
                (newest, Motion::from_pose(Se3::identity()))
            }
        };
        self.end_loss(keyframe, true);
        self.tracker.last = None;
        self.believe(frame, motion);
        let place = self.map.locate(keyframe, &motion.frame_from_keyframe);
        report.place_as(recognised.state, place);
        report.relocalised = true;
        report.keyframe = Some(keyframe);
        report.covariance = alignment.covariance;
        report.exposure_gain = alignment.gain();
    }

    /// The fragment that the camera is in becomes a part of the main map, where the readings say
    /// well enough where it lies.
    fn join_by_inertia(&mut self) {
        let active = self.tracker.active.as_ref();
        let fragment = active.map(|active| self.map[active.id].fragment);
        if let Some(fragment) = fragment.filter(|id| *id != MAIN_MAP) {
            self.join_fragment_by_inertia(fragment);
        }
    }

    /// The same with all fragments that are apart, at the end.
    pub(super) fn join_all_by_inertia(&mut self) {
        let apart = self.map.apart().map(|fragment| fragment.id);
        for fragment in apart.collect::<Vec<_>>() {
            self.join_fragment_by_inertia(fragment);
        }
    }

    fn join_fragment_by_inertia(&mut self, fragment: FragmentId) {
        if self.setup.imu.is_none() || self.setup.is_frozen {
            return;
        }
        // the poses must be those that a job begins with
        self.await_graph();
        if let Some(placed) = Placement::of(&self.setup, &self.map, fragment) {
            let to = placed.main_from_fragment();
            let joined = placed.joined;
            self.map.place(joined, to, self.frame_index);
            let link = placed.link(&self.map);
            self.constrain(None, link, false);
        }
    }
}

/// The first keyframe of the main map, or of a fragment.
impl Slam {
    /// Begins the main map, whose unit the start knows.
    pub(super) fn begin_main_map(&mut self, started: Started, report: &mut FrameReport) {
        self.map.set_scale(started.scale);
        self.begin_map(MAIN_MAP, started, report);
    }

    /// Makes the first keyframe of a fragment and tracks the frames that waited for it: those
    /// before it backwards. Those after it are left to be tracked.
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
    fn begin_at(&mut self, landing: &Landing, started: Started, report: &mut FrameReport) {
        let id = self.map.next_id();
        let parent = &self.map[landing.parent];
        let mut first = NewKeyframe {
            parent: Some(parent.id),
            world_from_keyframe: parent.world_from_keyframe * landing.parent_from_start,
            ..first_keyframe(self.map.store(), parent.fragment, &started)
        };
        if !self.map.is_metric(parent.fragment) {
            first.measured = None;
        } else if first.measured.is_some() {
            // both are in metres
            first.world_from_keyframe.scale = started.world_scale;
        }
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

        self.recovery.forget();
        let moving = |step: Se3| Some(Last::moving(&keyframe, step, interval_ns));
        self.tracker.last = moving(started.first_step.inverse());
        self.track_backwards(id, &started.earlier);
        self.return_to(id, keyframe.timestamp_ns);
        self.tracker.last = moving(started.first_step);
        self.waiting = started.later;
        report.place_anew(self.map.locate(id, &at_keyframe));
        report.keyframe = Some(id);
        report.created_keyframe = true;
        report.finished_keyframe = left.map(|left| left.id);
    }

    /// Tracks the frames before the first keyframe, the last of them first: on it alone where it
    /// shows enough of all of them, else with keyframes of their own, as long as they can be
    /// believed.
    fn track_backwards(&mut self, first: KeyframeId, earlier: &[BufferedFrame]) {
        // all views of the start have refined its depth
        let num_mapped = self.setup.config.keyframes.min_mapped_frames;
        self.policy = KeyframePolicy::after(num_mapped);
        let motions = (self.tracker).track_back(&self.setup, &self.map, earlier);
        if let Some(motions) = motions.filter(|motions| motions.len() == earlier.len()) {
            return self.store_backwards(earlier, &motions);
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
        let attempt = self.tracker.step_back(&self.setup, &self.map, frame);
        let good = attempt.filter(|attempt| attempt.tracked.state == TrackingState::Good);
        let Some(attempt) = good else {
            return false;
        };
        let alignment = &attempt.tracked.alignment;
        self.believe(frame, alignment.motion);
        // without, the depth of the first keyframe would not be kept for the way forward
        let may_change = self.setup.config.keyframes.reactivation.enabled;
        let what = (self.policy).step(&self.setup, &self.map, &attempt, Effort::Whole);
        match what {
            Use::ChangeKeyframe if may_change => {
                self.change_keyframe(frame, alignment);
            }
            Use::RefineDepth if attempt.keyframe != first => self.refine(frame, alignment),
            _ => {}
        }
        true
    }

    /// Makes the first keyframe, taken at a time, the one in use again.
    fn return_to(&mut self, first: KeyframeId, timestamp_ns: i64) {
        if self.tracker.active.as_ref().is_some_and(|a| a.id == first) {
            return self.policy.wait();
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

/// The end of a run.
impl Slam {
    /// Adjusts all that was mapped.
    pub(super) fn adjust_all(&mut self) {
        for fragment in self.map.grown_fragments() {
            adjust_whole(&self.setup, &mut self.map, fragment);
        }
        self.prefer_larger_map();
        self.events = self.map.take_events();
    }

    /// The largest fragment is the result, where nobody has asked for the first one: its unit and
    /// its place say nothing.
    fn prefer_larger_map(&mut self) {
        if self.map.scale() == Scale::Metric || self.map.is_restored() {
            return;
        }
        let apart = self.map.apart();
        let apart = apart.map(|f| (f.id, self.map.num_frames_in(f.id)));
        let frames = self.map.num_frames_in(MAIN_MAP);
        if let Some(larger) = larger_map(frames, apart, &self.setup.config.fragments) {
            self.map.exchange(larger);
        }
    }
}

#[cfg(test)]
mod tests;
