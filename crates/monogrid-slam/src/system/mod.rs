//! The system: one frame after the other, in the order in which a reader would do it by hand.

mod fragments;
mod graph;
mod keyframes;
mod odometry;
mod reactivate;
mod relocalise;
mod sessions;
mod start;
mod trajectory;

use self::fragments::Loss;
use self::graph::{GraphLink, Links};
use self::odometry::Odometry;
use self::trajectory::Visit;
use crate::depth_step::{observe, regularize};
use crate::frame::Frame;
use crate::node::Node;
use crate::policy::{KeyframeEvidence, is_new_keyframe};
use crate::sparse::scale::DenseLink;
use crate::sparse::{SparseLayer, SparseStats};
use crate::start::Start;
use crate::tracker::{MotionPrior, extrapolate, is_convincing, track};
use crate::{
    Fragment, FrameInput, FrameReport, Keyframe, KeyframeId, LostReason, MapSize, PoseSnapshot,
    Scale, SlamConfig, SlamError, StageTimes, TrackingState,
};
use monogrid_alignment::{Motion, Reference};
use monogrid_depth::{DepthMap, StereoFrame};
use monogrid_geometry::{Mat7, Pinhole, Se3};
use monogrid_image::{Mask, Pyramid};
use std::sync::Arc;
use std::time::Instant;

/// Levels of all pyramids.
const NUM_LEVELS: usize = 5;

/// Direct semi-dense monocular SLAM.
#[derive(Debug)]
pub struct Slam {
    config: SlamConfig,
    pinhole: Pinhole,
    mask: Mask,
    seed: u64,
    start: Option<Start>,
    /// Whether the map must stay as it is.
    is_frozen: bool,
    nodes: Vec<Node>,
    current: Option<Current>,
    /// All keyframes in the order in which tracking last used them, the newest at the end.
    recent: Vec<KeyframeId>,
    /// Stretches of time on one keyframe.
    visits: Vec<Visit>,
    last: Option<Last>,
    records: Vec<Record>,
    finished: Vec<Keyframe>,
    snapshot: Arc<PoseSnapshot>,
    scale: Scale,
    lost_in_a_row: usize,
    /// What is being done about a loss that lasts.
    loss: Loss,
    /// All but the main map, by identity.
    fragments: Vec<Fragment>,
    /// Frame that is being processed.
    frame_index: usize,
    lost_episodes: usize,
    relocalisations: usize,
    reactivations: usize,
    sparse: SparseLayer,
    sparse_stats: SparseStats,
    /// Dense depth at the points that a keyframe sees, by identity.
    links: Vec<Vec<DenseLink>>,
    /// Constraints and optimisation in the background.
    graph: Option<GraphLink>,
    /// Covariance of each keyframe relative to its parent, by identity.
    relative_covariance: Vec<Option<Mat7>>,
    /// Motion without corrections.
    odometry: Odometry,
}

/// The keyframe that frames are tracked on.
#[derive(Debug)]
struct Current {
    id: KeyframeId,
    depth: DepthMap,
    reference: Reference,
    /// Frames that refined its depth since it is in use.
    num_mapped: usize,
}

/// The last frame with a believed pose.
#[derive(Debug)]
struct Last {
    timestamp_ns: i64,
    pyramid: Pyramid,
    /// Relative to the current keyframe.
    motion: Motion,
    /// Motion between the last two distinct frames, in the current keyframe's units, and its time.
    frame_from_previous: Se3,
    interval_ns: i64,
}

/// A tracked frame, relative to its keyframe.
#[derive(Clone, Copy, Debug)]
struct Record {
    frame_index: usize,
    timestamp_ns: i64,
    /// Position in the list of visits.
    visit: usize,
    frame_from_keyframe: Se3,
}

impl Slam {
    /// A system for working images of the given camera. `mask` has their size.
    ///
    /// # Errors
    /// When a setting is outside its range, or a vocabulary for places cannot be used.
    pub fn new(
        config: SlamConfig,
        pinhole: Pinhole,
        mask: Mask,
        seed: u64,
    ) -> Result<Self, SlamError> {
        config.validate()?;
        let start = Start::new(&config, seed);
        let graph = GraphLink::new(&config, pinhole, &mask)?;
        Ok(Self {
            config,
            pinhole,
            mask,
            seed,
            start: Some(start),
            is_frozen: false,
            nodes: Vec::new(),
            current: None,
            recent: Vec::new(),
            visits: Vec::new(),
            last: None,
            records: Vec::new(),
            finished: Vec::new(),
            snapshot: Arc::default(),
            scale: Scale::Arbitrary,
            lost_in_a_row: 0,
            loss: Loss::default(),
            fragments: Vec::new(),
            frame_index: 0,
            lost_episodes: 0,
            relocalisations: 0,
            reactivations: 0,
            sparse: SparseLayer::default(),
            sparse_stats: SparseStats::default(),
            links: Vec::new(),
            graph,
            relative_covariance: Vec::new(),
            odometry: Odometry::default(),
        })
    }

    /// Processes the next frame.
    pub fn process_frame(&mut self, input: FrameInput) -> FrameReport {
        // inside the pool of threads its many short parallel steps begin without waking anybody
        rayon::scope(|_| {
            self.frame_index = input.index;
            let before = self.open_fragments();
            let mut report = self.process_in_pool(input);
            self.report_joined(&before, &mut report);
            self.advance_odometry(&mut report);
            report
        })
    }

    fn process_in_pool(&mut self, input: FrameInput) -> FrameReport {
        let begin = Instant::now();
        if let Some(report) = self.repeat(&input) {
            return report;
        }
        let seed_depth = input.seed_depth.clone();
        let finest = self.config.tracking.alignment.finest_level;
        let frame = Frame::new(input, &self.pinhole, finest, NUM_LEVELS);
        match self.start.take() {
            Some(start) => self.process_start(start, frame, seed_depth.as_ref(), begin),
            None => self.process_running(frame, begin),
        }
    }

    /// Finishes the last keyframe; its identity, if there is one.
    pub fn finish(&mut self) -> Option<KeyframeId> {
        if self.is_frozen {
            return None;
        }
        self.take_graph_update();
        let (id, view) = self.finish_current()?;
        self.submit_graph_job(view, Links::default(), true);
        self.take_graph_update();
        Some(id)
    }

    /// Finished keyframes, by identity.
    #[must_use]
    pub fn keyframes(&self) -> &[Keyframe] {
        &self.finished
    }

    /// The newest poses of all keyframes.
    #[must_use]
    pub fn snapshot(&self) -> Arc<PoseSnapshot> {
        Arc::clone(&self.snapshot)
    }

    /// Whether lengths are metres.
    #[must_use]
    pub fn scale(&self) -> Scale {
        self.scale
    }

    /// What the sparse layer did for the newest keyframe.
    #[must_use]
    pub fn sparse_stats(&self) -> &SparseStats {
        &self.sparse_stats
    }

    /// Times that tracking was lost.
    #[must_use]
    pub fn lost_episodes(&self) -> usize {
        self.lost_episodes
    }

    /// Times that a lost camera was recognised at another keyframe.
    #[must_use]
    pub fn relocalisations(&self) -> usize {
        self.relocalisations
    }

    /// Times that tracking went on with a keyframe that existed already instead of a new one.
    #[must_use]
    pub fn reactivations(&self) -> usize {
        self.reactivations
    }

    /// What grows while the camera sees new places, and only then.
    #[must_use]
    pub fn map_size(&self) -> MapSize {
        let packed = self.nodes.iter().filter_map(|node| node.depth.as_ref());
        MapSize {
            keyframes: self.nodes.len(),
            edges: self.num_edges(),
            points: self.sparse.points.len(),
            depth_bytes: packed.map(|depth| depth.bytes_in_memory()).sum(),
        }
    }

    /// The keyframe that frames are tracked on.
    fn current_node(&self) -> Option<&Node> {
        self.nodes.get(self.current.as_ref()?.id as usize)
    }

    /// Intrinsics of the working images.
    #[must_use]
    pub fn pinhole(&self) -> &Pinhole {
        &self.pinhole
    }

    /// A byte-identical image has the pose of the one before and adds no information.
    fn repeat(&mut self, input: &FrameInput) -> Option<FrameReport> {
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
        let mut report = blank_report(input.index, input.timestamp_ns, TrackingState::Good);
        report.reason = Some(LostReason::Repeated);
        self.report_pose(&mut report, &record.frame_from_keyframe);
        report.keyframe = Some(node);
        report.exposure_gain = last.motion.log_gain.exp() as f32;
        self.records.push(record);
        Some(report)
    }

    /// Tracks a frame on the current keyframe without touching the map.
    fn track_silently(&self, frame: &Frame) -> Option<Motion> {
        let (current, last) = (self.current.as_ref()?, self.last.as_ref()?);
        let tracked = self.track_on(current, last, frame);
        (tracked.state == TrackingState::Good).then_some(tracked.alignment.motion)
    }

    fn track_on(&self, current: &Current, last: &Last, frame: &Frame) -> crate::tracker::Tracked {
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

    /// Stores a believed pose and makes it the prior of the next frame.
    fn remember(&mut self, frame: &Frame, motion: Motion) {
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

    /// One frame of normal operation: track, then refine the depth or make a keyframe.
    fn process_running(&mut self, frame: Frame, begin: Instant) -> FrameReport {
        let mut report = blank_report(frame.index, frame.timestamp_ns, TrackingState::Lost);
        self.count_graph_frame();
        report.milliseconds.graph = milliseconds(begin);
        let begin = Instant::now();
        let (Some(current), Some(last)) = (self.current.as_ref(), self.last.as_ref()) else {
            self.look_for_place(frame, &mut report);
            report.milliseconds.graph += milliseconds(begin);
            return report;
        };
        let mut tracked = self.track_on(current, last, &frame);
        let is_doubtful = self.lost_in_a_row > 0
            || tracked.is_surprising
            || tracked.state == TrackingState::Degraded;
        if is_doubtful
            && tracked.state != TrackingState::Lost
            && !is_convincing(
                &tracked.alignment,
                self.lost_in_a_row > 0,
                &self.config.tracking,
            )
        {
            tracked.state = TrackingState::Lost;
            tracked.reason = Some(LostReason::Residuals);
        }
        let alignment = &tracked.alignment;
        report.milliseconds.tracking = milliseconds(begin);
        report.state = tracked.state;
        report.reason = tracked.reason;
        report.residual = alignment.residual_rms;
        report.good_share = alignment.good_of_visible;
        report.usage = alignment.usage;
        report.exposure_gain = alignment.gain();
        report.keyframe = self.current_node().map(|node| node.id);
        if tracked.state == TrackingState::Lost {
            if self.lost_in_a_row == 0 {
                self.lost_episodes += 1;
            }
            self.lost_in_a_row += 1;
            let before = Instant::now();
            self.relocalise(frame, &mut report);
            report.milliseconds.graph += milliseconds(before);
            return report;
        }
        self.end_loss();
        report.covariance = alignment.covariance;
        let motion = alignment.motion;
        self.remember(&frame, motion);
        self.report_pose(&mut report, &motion.frame_from_keyframe);
        let after_tracking = Instant::now();
        let graph_before = report.milliseconds.graph;
        let evidence = KeyframeEvidence {
            relative_distance: motion.frame_from_keyframe.inverse().translation.norm(),
            usage: f64::from(alignment.usage),
            num_mapped: self.current.as_ref().map_or(0, |c| c.num_mapped),
            num_keyframes: self.num_keyframes_in(self.current_fragment()),
        };
        if is_new_keyframe(&evidence, &self.config.keyframes) {
            self.leave_keyframe(&frame, &motion, &mut report);
        } else if tracked.state == TrackingState::Good {
            self.refine_depth(&frame, &tracked.alignment);
        }
        report.milliseconds.depth =
            milliseconds(after_tracking) - (report.milliseconds.graph - graph_before);
        report
    }

    /// Observes the current keyframe's pixels in a tracked frame.
    fn refine_depth(&mut self, frame: &Frame, alignment: &monogrid_alignment::Alignment) {
        let Some(current) = self.current.as_mut() else {
            return;
        };
        current.num_mapped += 1;
        if self.is_frozen {
            return;
        }
        let (pose_sigma_trans, pose_sigma_rot) = pose_sigmas(alignment.covariance.as_ref());
        let stereo = StereoFrame {
            image: frame.image(),
            frame_from_keyframe: alignment.motion.frame_from_keyframe,
            gain: alignment.gain(),
            bias: alignment.bias(),
            residual_rms: alignment.residual_rms,
            pose_sigma_trans,
            pose_sigma_rot,
            id: frame.index as u32,
        };
        let config = &self.config.depth;
        observe(&mut current.depth, &[stereo], config);
        regularize(&mut current.depth, config);
        self.refresh_reference();
    }
}

/// Standard deviations of translation (keyframe units) and rotation (rad) from a pose covariance.
fn pose_sigmas(covariance: Option<&monogrid_geometry::Mat6>) -> (f32, f32) {
    covariance.map_or((0.005, 0.002), |c| {
        let mean = |from: usize| {
            ((c[(from, from)] + c[(from + 1, from + 1)] + c[(from + 2, from + 2)]) / 3.0).sqrt()
        };
        (mean(0) as f32, mean(3) as f32)
    })
}

fn milliseconds(begin: Instant) -> f64 {
    begin.elapsed().as_secs_f64() * 1e3
}

fn blank_report(index: usize, timestamp_ns: i64, state: TrackingState) -> FrameReport {
    FrameReport {
        index,
        timestamp_ns,
        state,
        reason: None,
        world_from_camera: None,
        odom_from_camera: None,
        covariance: None,
        residual: 0.0,
        good_share: 0.0,
        usage: 0.0,
        exposure_gain: 1.0,
        milliseconds: StageTimes::default(),
        keyframe: None,
        finished_keyframe: None,
        created_keyframe: false,
        reactivated_keyframe: None,
        relocalised: false,
        fragment: None,
        started_fragment: None,
        joined_fragments: Vec::new(),
    }
}
