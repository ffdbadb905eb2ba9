//! The system: one frame after the other, in the order in which a reader would do it by hand.
//!
//! ```text
//! process_frame
//!   -> start        until there is a first keyframe
//!   -> tracking     each frame on the current keyframe
//!        lost:       -> relocalise -> fragments     find back, or begin anew
//!        tracked:    -> depth                       refine the keyframe
//!                    -> keyframes  -> reactivate    change to another one, known or new
//!                                  -> graph         what constrains the one that was left
//!   -> odometry     motion without corrections
//! trajectory, sessions: what is known of all frames; what is kept for a later run
//! ```

mod depth;
mod fragments;
mod graph;
mod keyframes;
mod odometry;
mod reactivate;
mod relocalise;
mod sessions;
mod start;
mod tracking;
mod trajectory;

use self::fragments::Loss;
use self::graph::{GraphLink, Links};
use self::odometry::Odometry;
use self::trajectory::Visit;
use crate::frame::Frame;
use crate::node::Node;
use crate::sparse::scale::DenseLink;
use crate::sparse::{SparseLayer, SparseStats};
use crate::start::Start;
use crate::{
    Fragment, FrameInput, FrameReport, Keyframe, KeyframeId, MapSize, PoseSnapshot, Scale,
    SlamConfig, SlamError,
};
use monogrid_alignment::{Motion, Reference};
use monogrid_depth::DepthMap;
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
}
