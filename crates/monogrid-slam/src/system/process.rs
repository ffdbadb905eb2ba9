//! What is done with a frame, in order.

use super::camera::Last;
use super::constrain::{GraphLink, Link, Tie, graph_job, handover, odometry_edge};
use super::depth::{Successor, activate, observe_depth, observe_old_keyframes, successor};
use super::keyframes::{Use, decide_use, finish_keyframe, first_keyframe, new_keyframe};
use super::outcome::{Attempt, Begun, FrameOutcome, KeyframeChange, Localised, NextKeyframe};
use super::points::adjust_points;
use super::reactivate::{Confirmed, find_known_view};
use super::relocalise::{Recognised, Resume, relocalise};
use super::slam::Slam;
use super::tracking::{track_frame, track_on_active};
use crate::frame::{BufferedFrame, Frame};
use crate::map::{Change, Event, Found, Record, View, VisitEnd};
use crate::report::{Stage, Stopwatch};
use crate::start::{Start, StartOutcome, Started};
use crate::{
    Fragment, FragmentId, FrameInput, FrameReport, KeyframeId, LostReason, MAIN_MAP, TrackingState,
};
use monogrid_alignment::{Alignment, Motion};
use monogrid_depth::DepthMap;
use monogrid_geometry::{Mat6, Se3};
use monogrid_image::GrayImage;
use std::sync::Arc;

/// The keyframe that was in use.
struct Left {
    id: KeyframeId,
    /// What the graph needs of it.
    view: Option<Arc<View>>,
}

impl Slam {
    /// Processes the next frame.
    pub fn process_frame(&mut self, input: FrameInput) -> FrameReport {
        // inside the pool of threads its many short parallel steps begin without waking anybody
        rayon::scope(|_| {
            self.stopwatch = Stopwatch::start();
            self.frame_index = input.index;
            let timestamp_ns = input.timestamp_ns;
            let outcome = self.process(input);
            self.events = self.map.take_events();
            let mut report = outcome.report(self.frame_index, timestamp_ns);
            report.joined_fragments = joined(&self.events);
            report.odom_from_camera = report
                .world_from_camera
                .map(|pose| self.odometry.advance(&self.map, report.index, &pose));
            report.milliseconds = self.stopwatch.times();
            report
        })
    }

    /// Finishes the last keyframe; its identity, if there is one.
    pub fn finish(&mut self) -> Option<KeyframeId> {
        self.events.clear();
        if self.setup.is_frozen {
            return None;
        }
        self.await_graph();
        let left = self.leave()?;
        self.constrain(left.view, Link::None, true);
        self.await_graph();
        self.events = self.map.take_events();
        Some(left.id)
    }

    fn process(&mut self, mut input: FrameInput) -> FrameOutcome {
        if let Some(repeated) = self.repeat(&input) {
            return repeated;
        }
        let seed_depth = input.seed_depth.take();
        let frame = self.setup.frame(input);
        match self.start.take() {
            Some(start) => self.start(start, frame, seed_depth.as_ref()),
            None => self.localise(frame),
        }
    }

    /// A byte-identical image has the pose of the one before and adds no information.
    fn repeat(&mut self, input: &FrameInput) -> Option<FrameOutcome> {
        let (last, keyframe) = self.camera.repeated(&input.image)?;
        let pose = last.motion.frame_from_keyframe;
        let gain = last.motion.log_gain.exp() as f32;
        let record = Record::new(input.index, input.timestamp_ns, pose);
        self.map.apply(Change::Tracked(record));
        let localised = Localised::Repeated {
            place: self.map.locate(keyframe, &pose),
            keyframe,
            gain,
        };
        Some(FrameOutcome::new(None, localised))
    }

    /// One frame before there is a map.
    fn start(
        &mut self,
        mut start: Start,
        frame: Frame,
        seed_depth: Option<&GrayImage>,
    ) -> FrameOutcome {
        let setup = &self.setup;
        let outcome = start.add_frame(
            frame,
            seed_depth,
            &setup.pinhole,
            &setup.mask,
            &setup.config,
        );
        self.stopwatch.lap(Stage::Tracking);
        match outcome {
            StartOutcome::Waiting(reason) => {
                self.start = Some(start);
                FrameOutcome::new(None, Localised::Waiting(reason))
            }
            StartOutcome::Started(started) => {
                self.map.apply(Change::Scaled(started.scale));
                self.begin_map(MAIN_MAP, *started)
            }
        }
    }

    /// One frame of normal operation: tracked, it makes the map better; lost, it is looked for elsewhere.
    fn localise(&mut self, frame: Frame) -> FrameOutcome {
        self.stopwatch.lap(Stage::Tracking);
        let update = self.graph.as_mut().and_then(GraphLink::count_frame);
        self.follow_graph(update);
        self.stopwatch.lap(Stage::Graph);
        let attempt = track_frame(&self.setup, &self.camera, &frame);
        self.stopwatch.lap(Stage::Tracking);
        match attempt {
            Some(attempt) if attempt.tracked.state != TrackingState::Lost => {
                self.follow(&frame, attempt)
            }
            attempt => self.find_back(frame, attempt),
        }
    }

    /// A tracked frame refines the depth of its keyframe, or has it changed.
    fn follow(&mut self, frame: &Frame, attempt: Attempt) -> FrameOutcome {
        let motion = attempt.tracked.alignment.motion;
        let place = self
            .map
            .locate(attempt.keyframe, &motion.frame_from_keyframe);
        self.end_loss(attempt.keyframe, false);
        self.believe(frame, motion);
        let mut outcome = FrameOutcome::new(None, Localised::Tracked(place));
        if let Some(active) = self.camera.active.take() {
            let alignment = &attempt.tracked.alignment;
            let used = decide_use(&self.setup, &self.map, &active, &attempt);
            self.camera.active = Some(match used {
                Use::RefineDepth => {
                    let keyframe = &self.map[active.id];
                    observe_depth(&self.setup, keyframe, active, frame, alignment)
                }
                Use::ChangeKeyframe | Use::None => active,
            });
            if used == Use::ChangeKeyframe {
                outcome.change = self.change_keyframe(frame, alignment);
            }
        }
        self.stopwatch.lap(Stage::Depth);
        outcome.attempt = Some(attempt);
        outcome
    }

    /// Goes on with another keyframe: one that shows the same, or the frame itself.
    fn change_keyframe(&mut self, frame: &Frame, alignment: &Alignment) -> KeyframeChange {
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
        match successor(&self.setup, &active.depth, frame, motion) {
            Some(successor) => self.succeed(frame, alignment, successor),
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
    ) -> KeyframeChange {
        let Some(left) = self.leave() else {
            return KeyframeChange::default();
        };
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
    fn make_keyframe(
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
        let keyframe = new_keyframe(frame, &self.map[parent], motion, unit);
        self.map.apply(Change::Created(keyframe));
        self.stopwatch.lap(Stage::Depth);
        self.adjust(&depth);
        let odometry =
            |covariance: &Mat6| Link::Odometry(odometry_edge(parent, id, motion, unit, covariance));
        let link = alignment.covariance.as_ref().map_or(Link::None, odometry);
        self.constrain(view, link, false);
        self.stopwatch.lap(Stage::Graph);
        let depth = observe_old_keyframes(&self.setup, &self.map, &self.map[id], depth);
        self.activate(id, depth);
    }

    /// A lost frame is looked for among all keyframes; where it is not recognised for long, a fragment of the
    /// map is started.
    fn find_back(&mut self, frame: Frame, attempt: Option<Attempt>) -> FrameOutcome {
        if attempt.is_some() && self.camera.lost_in_a_row == 0 {
            self.map.apply(Change::Lost(self.frame_index));
        }
        self.camera.lost_in_a_row += 1;
        let recognised = self.recognise(&frame, attempt.is_some());
        let outcome = match recognised {
            Some(recognised) => self.resume(&frame, attempt, recognised),
            None => self.wait_for_fragment(frame, attempt),
        };
        self.stopwatch.lap(Stage::Graph);
        outcome
    }

    /// Where a lost frame is; the first frames of a loss, and those before the map of an earlier session was
    /// recognised, are not worth the same effort.
    fn recognise(&mut self, frame: &Frame, was_tracked: bool) -> Option<Recognised> {
        let places = &self.setup.config.graph.places;
        let is_lost_enough = self.camera.lost_in_a_row >= places.min_lost_frames;
        if !places.enabled || (was_tracked && !is_lost_enough) {
            return None;
        }
        self.await_graph();
        let found = self.graph.as_ref()?.recognise(&frame.pyramid);
        let active = self.camera.active.as_ref();
        relocalise(&self.setup, &self.map, active, &found, frame)
    }

    /// Goes on where the camera was recognised.
    fn resume(
        &mut self,
        frame: &Frame,
        attempt: Option<Attempt>,
        recognised: Recognised,
    ) -> FrameOutcome {
        let Recognised {
            id,
            alignment,
            resume,
        } = recognised;
        let left = self.leave();
        let finished = left.as_ref().map(|left| left.id);
        let finished = finished.filter(|_| !self.setup.is_frozen);
        let view = left.and_then(|left| left.view);
        let (keyframe, motion, next) = match resume {
            Resume::Known(depth) => {
                if view.is_some() {
                    self.constrain(view, Link::None, false);
                }
                self.map
                    .apply(Change::Visited(id, frame.timestamp_ns, None));
                self.use_again(id, depth);
                (id, alignment.motion, NextKeyframe::Reactivated(id))
            }
            Resume::New(successor) => {
                let newest = self.map.next_id();
                self.map
                    .apply(Change::Visited(newest, frame.timestamp_ns, None));
                self.make_keyframe(frame, id, &alignment, successor, view);
                let motion = Motion::from_pose(Se3::identity());
                (newest, motion, NextKeyframe::Created)
            }
        };
        self.end_loss(keyframe, true);
        self.camera.last = None;
        self.believe(frame, motion);
        let localised = Localised::Relocalised {
            place: self.map.locate(keyframe, &motion.frame_from_keyframe),
            keyframe,
            alignment: Box::new(alignment),
        };
        FrameOutcome {
            change: KeyframeChange {
                finished,
                next: Some(next),
            },
            ..FrameOutcome::new(attempt, localised)
        }
    }

    /// A camera that stays lost begins a fragment of the map.
    fn wait_for_fragment(&mut self, frame: Frame, attempt: Option<Attempt>) -> FrameOutcome {
        let loss = &mut self.camera.loss;
        let Some(started) = loss.await_fragment(&self.setup, &self.map, frame) else {
            let reason = match &attempt {
                Some(attempt) => attempt.tracked.reason,
                None => Some(LostReason::NotRecognised),
            };
            return FrameOutcome::new(attempt, Localised::Lost(reason));
        };
        self.await_graph();
        let first_keyframe = self.map.next_id();
        self.end_loss(first_keyframe, false);
        let id = self.map.next_fragment();
        let fragment = Fragment::begun(id, first_keyframe, started.keyframe.index);
        self.map.apply(Change::Started(fragment));
        let outcome = self.begin_map(id, started);
        FrameOutcome {
            attempt: outcome.attempt.or(attempt),
            ..outcome
        }
    }

    /// Makes the first keyframe of a fragment and tracks the frames that waited for it: those before it
    /// backwards, those after it in their order.
    fn begin_map(&mut self, fragment: FragmentId, started: Started) -> FrameOutcome {
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
        let finished = left.as_ref().map(|left| left.id);
        let id = self.map.next_id();
        let first = first_keyframe(fragment, &keyframe, world_scale);
        self.map.apply(Change::Created(first));
        self.map
            .apply(Change::Visited(id, keyframe.timestamp_ns, None));
        self.adjust(&depth);
        if let Some(left) = left {
            self.constrain(left.view, Link::None, false);
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
        for buffered in &later {
            outcome = self.localise(self.setup.restored(buffered));
        }
        outcome.change.finished = finished.or(outcome.change.finished);
        outcome.begun = Some(Begun {
            fragment,
            keyframe: id,
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
            let tracked = track_on_active(&self.setup, active, last, &frame);
            if tracked.state != TrackingState::Good {
                return;
            }
            self.believe(&frame, tracked.alignment.motion);
        }
    }

    /// Stores a believed pose and makes it the prior of the next frame.
    fn believe(&mut self, frame: &Frame, motion: Motion) {
        let pose = motion.frame_from_keyframe;
        let record = Record::new(frame.index, frame.timestamp_ns, pose);
        self.map.apply(Change::Tracked(record));
        self.camera.last = Some(Last::after(self.camera.last.as_ref(), frame, motion));
    }

    /// The camera has a pose again, on a keyframe.
    fn end_loss(&mut self, keyframe: KeyframeId, is_recognised: bool) {
        if self.camera.lost_in_a_row > 0 {
            self.map.apply(Change::Found(Found {
                frame_index: self.frame_index,
                keyframe,
                is_recognised,
            }));
        }
        self.camera.end_loss();
    }

    /// Publishes the keyframe in use, which is in use no longer.
    fn leave(&mut self) -> Option<Left> {
        let active = self.camera.active.take()?;
        let id = active.id;
        if self.setup.is_frozen {
            return Some(Left { id, view: None });
        }
        let finished = finish_keyframe(&self.setup, &self.map, &active);
        let view = finished.view.clone();
        self.map.apply(Change::Finished(finished));
        Some(Left { id, view })
    }

    /// Makes a keyframe that was left the one in use again.
    fn use_again(&mut self, id: KeyframeId, depth: DepthMap) {
        self.map.apply(Change::Reactivated(id));
        self.activate(id, depth);
    }

    fn activate(&mut self, id: KeyframeId, depth: DepthMap) {
        self.camera.active = Some(activate(&self.setup, &self.map[id], depth));
    }

    /// Brings the newest keyframe into the sparse layer.
    fn adjust(&mut self, depth: &DepthMap) {
        if let Some(stats) = adjust_points(&self.setup, &mut self.map, depth) {
            self.sparse_stats = stats;
        }
    }

    /// Gives the graph a finished keyframe and the poses as they are now.
    fn constrain(&mut self, finished: Option<Arc<View>>, link: Link, is_final: bool) {
        if let Some(graph) = self.graph.as_mut().filter(|_| !self.setup.is_frozen) {
            graph.submit(graph_job(&self.setup, &self.map, finished, link, is_final));
        }
    }

    /// Takes over the result of the graph's job under way, waiting for it when it is not ready.
    fn await_graph(&mut self) {
        let update = self.graph.as_mut().and_then(GraphLink::wait);
        self.follow_graph(update);
    }
}

/// Fragments that became a part of another, by identity.
fn joined(events: &[Event]) -> Vec<FragmentId> {
    let mut ids: Vec<FragmentId> = events
        .iter()
        .filter_map(|event| match event {
            Event::Joined(fragment) => Some(fragment.id),
            _ => None,
        })
        .collect();
    ids.sort_unstable();
    ids
}
