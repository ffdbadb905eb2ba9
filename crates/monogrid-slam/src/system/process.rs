//! What is done with a frame, in order.

use super::camera::Camera;
use super::constrain::{GraphLink, Link};
use super::depth::observe_depth;
use super::keyframes::{Use, decide_use};
use super::outcome::{Attempt, FrameOutcome, KeyframeChange, Localised};
use super::points::adjust_whole;
use super::slam::Slam;
use super::tracking::track_frame;
use crate::frame::Frame;
use crate::map::{Change, Event, Record};
use crate::policy::larger_map;
use crate::report::{Stage, Stopwatch};
use crate::start::{Start, StartOutcome};
use crate::{FragmentId, FrameInput, FrameReport, KeyframeId, MAIN_MAP, Scale};
use monogrid_geometry::Se3;
use monogrid_image::GrayImage;

/// Hears where a frame is, and says what it is used for.
pub type Told<'a> = dyn FnMut(&FrameReport) -> Effort + Send + 'a;

/// What a frame with a pose is used for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effort {
    /// It makes the map better where it can.
    Whole,
    /// The next one waits already: it refines no depth. A new keyframe, without which the camera would be lost, is made all the same.
    Hurried,
}

impl Slam {
    /// Processes the next frame.
    pub fn process_frame(&mut self, input: FrameInput) -> FrameReport {
        self.process_frame_telling(input, &mut |_| Effort::Whole)
    }

    /// The same; a frame that is tracked is told of as soon as it has its pose, before it makes the map better, which takes several times
    /// as long. What is told is the report so far, with the same poses, but not what the frame does to keyframes. Nothing is told of
    /// frames that have no pose, that wait, or that were found by their appearance. Who always answers [`Effort::Whole`] gets the results of
    /// [`Slam::process_frame`].
    pub fn process_frame_telling(&mut self, input: FrameInput, told: &mut Told<'_>) -> FrameReport {
        // inside the pool of threads its many short parallel steps begin without waking anybody
        rayon::scope(|_| {
            self.stopwatch = Stopwatch::start();
            self.frame_index = input.index;
            let timestamp_ns = input.timestamp_ns;
            let outcome = self.process(input, told);
            self.events = self.map.take_events();
            let mut report = outcome.report(self.frame_index, timestamp_ns);
            report.joined_fragments = joined(&self.events);
            report.odom_from_camera = outcome
                .odom_from_camera
                .or_else(|| self.advance_odometry(&report));
            report.milliseconds = self.stopwatch.times();
            report
        })
    }

    /// Odometry with the pose of a frame.
    fn advance_odometry(&mut self, report: &FrameReport) -> Option<Se3> {
        let pose = report.world_from_camera.as_ref()?;
        Some(self.odometry.advance(&self.map, report.index, pose))
    }

    /// Finishes the last keyframe; its identity, if there is one.
    pub fn finish(&mut self) -> Option<KeyframeId> {
        let last = self.finish_keyframe()?;
        self.adjust_all();
        Some(last)
    }

    /// The same after the last frame of all: what only more frames would need ([`Self::release`]) is given back before the last
    /// adjustment, which takes much memory itself. `released` hears of it, since images and depth of keyframes are not needed before that
    /// adjustment is done.
    pub fn conclude(&mut self, released: &mut dyn FnMut(&Self)) -> Option<KeyframeId> {
        let last = self.finish_keyframe();
        self.await_graph();
        self.release_camera();
        released(self);
        let last = last?;
        self.adjust_all();
        Some(last)
    }

    /// Finishes the last keyframe and gives the graph all that there is; the keyframe, if there is one.
    fn finish_keyframe(&mut self) -> Option<KeyframeId> {
        self.events.clear();
        if self.setup.is_frozen {
            return None;
        }
        self.await_graph();
        let left = self.leave()?;
        self.join_all_by_inertia();
        self.await_graph();
        self.constrain(left.view, Link::None, true);
        self.await_graph();
        Some(left.id)
    }

    /// Adjusts all that was mapped.
    fn adjust_all(&mut self) {
        for fragment in self.map.grown_fragments() {
            adjust_whole(&self.setup, &mut self.map, fragment);
        }
        self.prefer_larger_map();
        self.events = self.map.take_events();
    }

    /// The largest fragment is the result, where nobody has asked for the first one: its unit and its place say nothing.
    fn prefer_larger_map(&mut self) {
        if self.map.scale() == Scale::Metric || self.map.is_restored() {
            return;
        }
        let fragments = self.map.fragments();
        let apart = fragments.iter().filter(|f| f.joined.is_none());
        let frames = self.map.num_frames_in(MAIN_MAP);
        let apart = apart.map(|f| (f.id, f.frames));
        if let Some(larger) = larger_map(frames, apart, &self.setup.config.fragments) {
            self.map.apply(Change::Exchanged(larger));
        }
    }

    /// Gives back the memory that only more frames would need: that of tracking and of the graph's thread, and of keyframes what is not
    /// published. All that was found stays; the camera is lost in frames that come afterwards.
    pub fn release(&mut self) {
        self.await_graph();
        self.release_camera();
        self.map.release();
    }

    fn release_camera(&mut self) {
        self.camera = Camera::default();
        self.start = None;
        if let Some(graph) = &mut self.graph {
            graph.end();
        }
    }

    fn process(&mut self, mut input: FrameInput, told: &mut Told<'_>) -> FrameOutcome {
        if let Some(repeated) = self.repeat(&input) {
            return repeated;
        }
        let seed_depth = input.seed_depth.take();
        let frame = self.setup.frame(input);
        self.stopwatch.lap(Stage::Tracking);
        let outcome = match self.start.take() {
            Some(start) => self.start(start, frame, seed_depth.as_ref()),
            None => self.track(frame, Some(told)),
        };
        self.catch_up(outcome)
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
    fn track(&mut self, frame: Frame, told: Option<&mut Told<'_>>) -> FrameOutcome {
        let update = self.graph.as_mut().and_then(GraphLink::count_frame);
        self.follow_graph(update);
        self.stopwatch.lap(Stage::Graph);

        let attempt = track_frame(&self.setup, &self.map, &self.camera, &frame);
        self.stopwatch.lap(Stage::Tracking);
        let mut attempt = match attempt {
            Some(attempt) if attempt.is_believed() => attempt,
            attempt => return self.find_back(frame, attempt),
        };
        let tracking = &self.setup.config.tracking;
        attempt.doubt = (self.camera.doubt).judge(&attempt.tracked.alignment, tracking);
        let motion = attempt.tracked.alignment.motion;
        let place = self
            .map
            .locate(attempt.keyframe, &motion.frame_from_keyframe);
        self.remember(&frame, &attempt);
        self.find_missed(&frame, motion);
        self.end_loss(attempt.keyframe, false);
        self.believe(&frame, motion);
        let tracked = Localised::Tracked(place);
        let (odom_from_camera, effort) = told.map_or((None, Effort::Whole), |told| {
            let mut report = tracked.report_of(Some(&attempt), frame.index, frame.timestamp_ns);
            report.odom_from_camera = self.advance_odometry(&report);
            (report.odom_from_camera, told(&report))
        });

        let change = match decide_use(&self.setup, &self.map, &self.camera, &attempt, effort) {
            Use::RefineDepth => self.observe(&frame, &attempt),
            Use::ChangeKeyframe => {
                let change = self.change_keyframe(&frame, &attempt.tracked.alignment);
                self.join_by_inertia();
                change
            }
            Use::PassOver => self.pass_over(),
            Use::None => KeyframeChange::default(),
        };
        self.stopwatch.lap(Stage::Depth);
        FrameOutcome {
            change,
            odom_from_camera,
            ..FrameOutcome::new(Some(attempt), tracked)
        }
    }

    /// Tracks the frames that waited for a map which has begun; the outcome of the last stands for all.
    fn catch_up(&mut self, mut outcome: FrameOutcome) -> FrameOutcome {
        let Some(mut begun) = outcome.begun.take() else {
            return outcome;
        };
        let finished = outcome.change.finished;
        for buffered in std::mem::take(&mut begun.later) {
            let next = self.track(self.setup.restored(&buffered), None);
            outcome = self.catch_up(next);
        }
        outcome.change.finished = finished.or(outcome.change.finished);
        outcome.begun = Some(begun);
        outcome
    }

    /// The frame refines the depth of the keyframe in use.
    pub(super) fn observe(&mut self, frame: &Frame, attempt: &Attempt) -> KeyframeChange {
        let alignment = &attempt.tracked.alignment;
        self.camera.active = self
            .camera
            .active
            .take()
            .map(|active| observe_depth(&self.setup, active, frame, alignment));
        KeyframeChange::default()
    }

    /// The frame leaves the depth of the keyframe in use as it is.
    fn pass_over(&mut self) -> KeyframeChange {
        if let Some(active) = self.camera.active.as_mut() {
            active.num_mapped += 1;
            active.num_passed += 1;
        }
        KeyframeChange::default()
    }
}

/// Fragments that became a part of another, by identity.
fn joined(events: &[Event]) -> Vec<FragmentId> {
    let joined = |event: &Event| match event {
        Event::Joined(fragment) => Some(fragment.id),
        _ => None,
    };
    let mut ids: Vec<FragmentId> = events.iter().filter_map(joined).collect();
    ids.sort_unstable();
    ids
}

#[cfg(test)]
mod tests {
    use super::Effort;
    use crate::test_world::small_demo;
    use crate::{FrameInput, FrameReport, RefinementConfig, Slam, SlamConfig};
    use monogrid_image::Mask;

    const FRAMES: usize = 10;

    /// A system for the sequence.
    fn slam(refinement: RefinementConfig) -> Slam {
        let camera = small_demo().camera();
        let mask = Mask::filled(camera.width, camera.height, 255);
        let mut config = SlamConfig::default();
        config.keyframes.refinement = refinement;
        Slam::new(config, camera.pinhole, mask, 0).unwrap()
    }

    /// The next of every `step` frames of the sequence, the first with its depth.
    fn input(k: usize, step: usize) -> FrameInput {
        let sequence = small_demo();
        FrameInput {
            index: k,
            timestamp_ns: (k * step) as i64 * 33_333_333,
            image: sequence.frame(step * k).unwrap().image,
            seed_depth: sequence.depth(k).filter(|_| k == 0),
        }
    }

    /// Frames that refine the first keyframe of the first ten, and whether all have a pose.
    fn num_refined(refinement: RefinementConfig) -> (usize, bool) {
        let mut slam = slam(refinement);
        let is_tracked = (0..FRAMES).all(|k| {
            let report = slam.process_frame(input(k, 1));
            report.world_from_camera.is_some()
        });
        let active = slam.camera.active.as_ref().unwrap();
        assert_eq!(active.id, 0);
        assert_eq!(active.num_mapped, FRAMES - 1, "all of them count");
        (active.num_refined as usize, is_tracked)
    }

    /// Every third of as many frames makes some keyframes.
    const TOLD_FRAMES: usize = 30;
    const TOLD_STEP: usize = 3;

    /// Reports on the first frames, and what was told of them before, where the answer is always this one.
    fn told(effort: Effort) -> (Slam, Vec<(FrameReport, Option<FrameReport>)>) {
        let mut slam = slam(RefinementConfig::default());
        let reports = (0..TOLD_FRAMES).map(|k| {
            let mut told = None;
            let report = slam.process_frame_telling(input(k, TOLD_STEP), &mut |report| {
                told = Some(report.clone());
                effort
            });
            (report, told)
        });
        let reports = reports.collect();
        (slam, reports)
    }

    #[test]
    fn poses_are_told_before_the_map_is_made_better_and_are_those_of_the_reports() {
        let (_, reports) = told(Effort::Whole);
        assert!(reports[0].1.is_none(), "the first frame begins the map");
        for (report, told) in &reports[1..] {
            let told = told.as_ref().unwrap();
            assert_eq!(told.world_from_camera, report.world_from_camera);
            assert_eq!(told.odom_from_camera, report.odom_from_camera);
            assert!(told.odom_from_camera.is_some());
            let frame = |report: &FrameReport| (report.index, report.state, report.keyframe);
            assert_eq!(frame(told), frame(report));
            assert!(!told.created_keyframe && told.finished_keyframe.is_none());
        }
        assert!(reports.iter().any(|(report, _)| report.created_keyframe));
        // who says nothing has the same
        let mut slam = slam(RefinementConfig::default());
        for (k, (with, _)) in reports.iter().enumerate() {
            let report = slam.process_frame(input(k, TOLD_STEP));
            assert_eq!(report.world_from_camera, with.world_from_camera);
            assert_eq!(report.odom_from_camera, with.odom_from_camera);
        }
    }

    #[test]
    fn a_hurried_frame_refines_no_depth_and_makes_a_keyframe_all_the_same() {
        let (slam, hurried) = told(Effort::Hurried);
        let (whole_slam, _) = told(Effort::Whole);
        assert!(hurried.iter().any(|(report, _)| report.created_keyframe));
        let has_pose = |(report, _): &(FrameReport, _)| report.world_from_camera.is_some();
        assert!(hurried.iter().all(has_pose));
        let [refined, whole] = [&slam, &whole_slam].map(|slam| {
            let active = slam.camera.active.as_ref().unwrap();
            (active.num_refined as usize, active.num_mapped)
        });
        assert!(refined.0 * 4 <= refined.1, "{refined:?}");
        assert!(whole.0 > refined.0, "{whole:?} {refined:?}");
    }

    #[test]
    fn a_slow_camera_refines_depth_with_some_of_its_frames() {
        // all but the first, which is the keyframe
        let all = num_refined(RefinementConfig::thesis());
        assert_eq!(all, (FRAMES - 1, true));
        let RefinementConfig {
            first_frames,
            max_passed,
            ..
        } = RefinementConfig::default();
        let later = FRAMES - 1 - first_frames;
        let expected = first_frames + later / (max_passed + 1);
        assert_eq!(num_refined(RefinementConfig::default()), (expected, true));
    }
}
