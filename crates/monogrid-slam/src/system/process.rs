//! What is done with a frame, in order.

use super::constrain::GraphLink;
use super::depth::DepthStage;
use super::keyframes::{Effort, KeyframePolicy};
use super::lost::LossRecovery;
use super::relocalise::InUse;
use super::slam::Slam;
use super::tracking::Tracker;
use crate::frame::Frame;
use crate::graph::Link;
use crate::map::Event;
use crate::report::Stopwatch;
use crate::start::Start;
use crate::{FragmentId, FrameInput, FrameReport, KeyframeId, LostReason, TrackingState};

/// Hears where a frame is, and says what it is used for.
pub type Told<'a> = dyn FnMut(&FrameReport) -> Effort + Send + 'a;

impl Slam {
    /// Processes the next frame.
    pub fn process_frame(&mut self, input: FrameInput) -> FrameReport {
        self.process_frame_telling(input, &mut |_| Effort::Whole)
    }

    /// The same; a frame that is tracked is told of as soon as it has its pose, before it makes the
    /// map better, which takes several times as long. What is told is the report so far, with the
    /// same poses, but not what the frame does to keyframes. Nothing is told of frames that have no
    /// pose, that wait, or that were found by their appearance. Who always answers
    /// [`Effort::Whole`] gets the results of [`Slam::process_frame`].
    pub fn process_frame_telling(&mut self, input: FrameInput, told: &mut Told<'_>) -> FrameReport {
        // inside the pool of threads its many short parallel steps begin without waking anybody
        rayon::scope(|_| {
            self.stopwatch = Stopwatch::start();
            self.frame_index = input.index;
            let mut report = self.process(input, told);
            self.events = self.map.take_events();
            report.joined_fragments = joined(&self.events);
            let told = report.odom_from_camera;
            report.odom_from_camera = told.or_else(|| self.odometry.step(&self.map, &report));
            report.milliseconds = self.stopwatch.times;
            report
        })
    }

    /// Finishes the last keyframe; its identity, if there is one.
    pub fn finish(&mut self) -> Option<KeyframeId> {
        let last = self.finish_keyframe()?;
        self.adjust_all();
        Some(last)
    }

    /// The same after the last frame of all: what only more frames would need ([`Self::release`])
    /// is given back before the last adjustment, which takes much memory itself. `released` hears
    /// of it, since images and depth of keyframes are not needed before that adjustment is done.
    pub fn conclude(&mut self, released: &mut dyn FnMut(&Self)) -> Option<KeyframeId> {
        let last = self.finish_keyframe();
        self.await_graph();
        self.release_camera();
        released(self);
        let last = last?;
        self.adjust_all();
        Some(last)
    }

    /// Finishes the last keyframe and gives the graph all that there is; the keyframe, if there is
    /// one.
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

    /// Gives back the memory that only more frames would need: that of tracking and of the graph's
    /// thread, and of keyframes what is not published. All that was found stays; the camera is lost
    /// in frames that come afterwards.
    pub fn release(&mut self) {
        self.await_graph();
        self.release_camera();
        self.map.release();
    }

    fn release_camera(&mut self) {
        self.tracker = Tracker::default();
        self.policy = KeyframePolicy::default();
        self.depth = DepthStage::default();
        self.recovery = LossRecovery::default();
        self.start = None;
        if let Some(graph) = &mut self.graph {
            graph.end();
        }
    }

    fn process(&mut self, input: FrameInput, told: &mut Told<'_>) -> FrameReport {
        if let Some(repeated) = self.repeat(&input) {
            return repeated;
        }
        let frame = self.setup.frame(input);
        self.stopwatch.lap(|times| &mut times.tracking);
        let report = match self.start.take() {
            Some(start) => self.start(start, frame),
            None => self.track(frame, Some(told)),
        };
        self.catch_up(report)
    }

    /// A byte-identical image has the pose of the one before and adds no information.
    fn repeat(&mut self, input: &FrameInput) -> Option<FrameReport> {
        let (last, active) = (self.tracker.last.as_ref()?, self.tracker.active.as_ref()?);
        if self.recovery.lost_in_a_row() > 0 || *last.pyramid.level(0) != input.image {
            return None;
        }
        let keyframe = active.id;
        let pose = last.motion.frame_from_keyframe;
        let mut report = FrameReport {
            reason: Some(LostReason::Repeated),
            keyframe: Some(keyframe),
            exposure_gain: last.motion.log_gain.exp() as f32,
            ..FrameReport::new(input.index, input.timestamp_ns, TrackingState::Good)
        };
        self.store_pose(input.index, input.timestamp_ns, pose);
        report.place(self.map.locate(keyframe, &pose));
        Some(report)
    }

    /// One frame before there is a map.
    fn start(&mut self, mut start: Start, frame: Frame) -> FrameReport {
        let (index, timestamp_ns) = (frame.index, frame.timestamp_ns);
        let mut report = FrameReport::new(index, timestamp_ns, TrackingState::Initialising);
        let outcome = start.add_frame(frame, &self.setup);
        self.stopwatch.lap(|times| &mut times.tracking);
        match outcome {
            Err(reason) => {
                self.start = Some(start);
                report.reason = Some(reason);
            }
            Ok(started) => {
                self.begin_main_map(*started, &mut report);
            }
        }
        report
    }

    /// One frame of normal operation: tracked, it makes the map better; lost, it is looked for
    /// elsewhere.
    fn track(&mut self, frame: Frame, told: Option<&mut Told<'_>>) -> FrameReport {
        let update = self.graph.as_mut().and_then(GraphLink::count_frame);
        self.follow_graph(update);
        self.stopwatch.lap(|times| &mut times.graph);

        let lost_in_a_row = self.recovery.lost_in_a_row();
        let attempt = (self.tracker).step(&self.setup, &self.map, &frame, lost_in_a_row);
        self.stopwatch.lap(|times| &mut times.tracking);
        let mut report = FrameReport::of(&frame, attempt.as_ref());
        let believed = attempt.filter(|_| report.state != TrackingState::Lost);
        let Some(attempt) = believed else {
            return self.find_back(frame, report);
        };
        let alignment = &attempt.tracked.alignment;
        let pose = &alignment.motion.frame_from_keyframe;
        report.place(self.map.locate(attempt.keyframe, pose));
        self.accept(&frame, &attempt);
        let effort = told.map_or(Effort::Whole, |told| {
            report.odom_from_camera = self.odometry.step(&self.map, &report);
            told(&report)
        });
        let what = (self.policy).step(&self.setup, &self.map, &attempt, effort);
        self.make_use(&frame, alignment, what, &mut report);
        report
    }

    /// A lost frame is looked for among all keyframes; where it is not recognised for long, a
    /// fragment of the map is started.
    fn find_back(&mut self, frame: Frame, mut report: FrameReport) -> FrameReport {
        let was_tracked = report.keyframe.is_some();
        let is_worth_it = self.count_lost(was_tracked);
        let mut found = Vec::new();
        if is_worth_it && self.setup.config.graph.places.enabled {
            self.await_graph();
            let in_use = self.lost_on();
            if let Some(graph) = self.graph.as_mut() {
                found = graph.recognise(&frame.pyramid, in_use);
            }
        }
        let (tracker, depth) = (&self.tracker, &self.depth);
        let in_use = InUse::of(tracker, depth);
        let recovery = (self.recovery).step(&self.setup, &self.map, frame, &found, in_use);
        self.recover(recovery, &mut report);
        if report.state == TrackingState::Lost {
            self.map.miss(report.index, report.timestamp_ns);
        }
        self.stopwatch.lap(|times| &mut times.graph);
        report
    }

    /// Tracks the frames that waited for a map which has begun; the report on the last stands for
    /// all.
    fn catch_up(&mut self, begun: FrameReport) -> FrameReport {
        let mut last = None;
        for buffered in std::mem::take(&mut self.waiting) {
            let next = self.track(self.setup.restored(&buffered), None);
            last = Some(self.catch_up(next));
        }
        let Some(last) = last else {
            return begun;
        };
        FrameReport {
            finished_keyframe: begun.finished_keyframe.or(last.finished_keyframe),
            created_keyframe: true,
            keyframe: begun.keyframe,
            started_fragment: begun.started_fragment,
            ..last
        }
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
    use crate::Effort;
    use crate::policy::FIRST_FRAMES;
    use crate::test_world::small_demo;
    use crate::{FrameInput, FrameReport, RefinementConfig, Slam, SlamConfig, TrackingState};
    use monogrid_geometry::{Rng, Se3};
    use monogrid_image::{GrayImage, Mask};

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
            depth: sequence.depth(k).filter(|_| k == 0).map(Into::into),
        }
    }

    /// Frames that refine the first keyframe of the first ten, and whether all have a pose.
    fn num_refined(refinement: RefinementConfig) -> (usize, bool) {
        let mut slam = slam(refinement);
        let is_tracked = (0..FRAMES).all(|k| {
            let report = slam.process_frame(input(k, 1));
            report.world_from_camera.is_some()
        });
        assert_eq!(slam.tracker.active.as_ref().unwrap().id, 0);
        assert_eq!(slam.policy.num_mapped(), FRAMES - 1, "all of them count");
        (slam.depth.num_refined() as usize, is_tracked)
    }

    /// Every third of as many frames makes some keyframes.
    const TOLD_FRAMES: usize = 28;
    const TOLD_STEP: usize = 3;

    /// Reports on the first frames, and what was told of them before, where the answer is always
    /// this one.
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
            let num_refined = slam.depth.num_refined() as usize;
            (num_refined, slam.policy.num_mapped())
        });
        assert!(refined.0 * 4 <= refined.1, "{refined:?}");
        assert!(whole.0 > refined.0, "{whole:?} {refined:?}");
    }

    /// What becomes of frames of which those from the third on show another place, on so many
    /// threads.
    fn lost_at_once(threads: usize) -> Vec<(TrackingState, Option<Se3>)> {
        let elsewhere = |k: usize| {
            let mut words = Rng::new(k as u64);
            let camera = small_demo().camera();
            let grey: Vec<u8> = (0..camera.width * camera.height)
                .map(|_| words.next_u64() as u8)
                .collect();
            GrayImage::from_gray8(camera.width, camera.height, &grey).unwrap()
        };
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
        pool.build().unwrap().install(|| {
            let mut slam = slam(RefinementConfig::default());
            let report = |k: usize| {
                let mut frame = input(k, 1);
                if k >= 3 {
                    frame.image = elsewhere(k);
                }
                let report = slam.process_frame(frame);
                (report.state, report.world_from_camera)
            };
            (0..15).map(report).collect()
        })
    }

    #[test]
    fn a_camera_that_is_lost_before_any_place_is_known_stays_lost_on_any_number_of_threads() {
        let reports = lost_at_once(1);
        let is_lost = |(state, _): &(TrackingState, _)| *state == TrackingState::Lost;
        assert!(!reports[..3].iter().any(is_lost));
        assert!(reports[3..].iter().all(is_lost));
        assert_eq!(lost_at_once(2), reports);
        assert_eq!(lost_at_once(8), reports);
    }

    #[test]
    fn a_camera_is_found_in_the_keyframe_on_which_it_was_lost() {
        const JUMP: usize = 240;
        let mut slam = slam(RefinementConfig::default());
        for k in 0..4 {
            slam.process_frame(input(k, 1));
        }
        assert_eq!(slam.map.next_id(), 1, "the graph knows no keyframe yet");
        let far = |index: usize| FrameInput {
            index,
            timestamp_ns: index as i64 * 33_333_333,
            ..input(JUMP, 1)
        };
        // one frame may be a bad one
        assert!(!slam.process_frame(far(4)).relocalised);
        let report = slam.process_frame(far(5));
        assert!(report.relocalised, "{report:?}");
        let truth = |k| small_demo().world_from_camera(k).unwrap();
        let expected = truth(0).inverse() * truth(JUMP);
        let error = expected.inverse() * report.world_from_camera.unwrap();
        assert!(error.translation.norm() < 0.05, "{error:?}");
        assert!(error.rotation.angle() < 0.02, "{error:?}");
    }

    #[test]
    fn a_slow_camera_refines_depth_with_some_of_its_frames() {
        // all but the first, which is the keyframe
        let all = num_refined(RefinementConfig::thesis());
        assert_eq!(all, (FRAMES - 1, true));
        let RefinementConfig { max_passed } = RefinementConfig::default();
        let later = FRAMES - 1 - FIRST_FRAMES;
        let expected = FIRST_FRAMES + later / (max_passed + 1);
        assert_eq!(num_refined(RefinementConfig::default()), (expected, true));
    }
}
