//! The system and what it tells about itself.

use super::constrain::GraphLink;
use super::depth::DepthStage;
use super::keyframes::{KeyframePolicy, public_pixels};
use super::lost::LossRecovery;
use super::odometry::Odometry;
use super::sessions::{restored, stored, stored_edges, stored_link, stored_points};
use super::tracking::Tracker;
use crate::frame::BufferedFrame;
use crate::graph::GraphStats;
use crate::map::{Counts, Event, Map, parts};
use crate::report::Stopwatch;
use crate::setup::Setup;
use crate::start::Start;
use crate::store::SpillError;
use crate::store::Store;
use crate::stored::{ContinueError, Purpose, StoredEdge, StoredLink, StoredMap, StoredPoint};
use crate::{
    Bridge, Fragment, FragmentId, InertialPath, KeptKeyframe, KeyframeCamera, KeyframeId,
    KeyframeInUse, MAIN_MAP, MapSize, MemoryConfig, PoseSnapshot, Scale, SlamConfig, SlamError,
    TrackedFrame, TrajectoryPose,
};
use monogrid_geometry::{Mat7, Pinhole};
use monogrid_graph::RobustKernel;
use monogrid_graph::pose_graph::{GraphEdge, GraphNode, PoseGraph};
use monogrid_image::Mask;
use monogrid_inertial::{Imu, ImuSample};
use std::fs::File;
use std::sync::Arc;

/// Direct semi-dense monocular SLAM.
#[derive(Debug)]
pub struct Slam {
    pub(super) setup: Setup,
    /// Until there is a first keyframe.
    pub(super) start: Option<Start>,
    /// Frames after the first keyframe of a map or fragment that has just begun, which waited for
    /// it.
    pub(super) waiting: Vec<BufferedFrame>,
    pub(super) map: Map,
    pub(super) tracker: Tracker,
    pub(super) policy: KeyframePolicy,
    pub(super) depth: DepthStage,
    pub(super) recovery: LossRecovery,
    /// Motion without corrections.
    pub(super) odometry: Odometry,
    /// Constraints and optimisation in the background.
    pub(super) graph: Option<GraphLink>,
    /// Frame that is being processed.
    pub(super) frame_index: usize,
    pub(super) stopwatch: Stopwatch,
    pub(super) events: Vec<Event>,
}

/// Room that keyframes of a [`Slam`] have in memory.
#[derive(Clone, Debug)]
pub struct KeyframeRoom(Store);

impl KeyframeRoom {
    /// From now on keyframes have so much room instead of what the settings say, bytes. No result
    /// depends on it.
    pub fn give(&self, bytes: usize) {
        const OWN_SHARE: f64 = 0.75;
        let megabytes = bytes as f64 * 1e-6;
        self.0.resize(&MemoryConfig {
            keyframes_mb: megabytes * OWN_SHARE,
            prepared_mb: megabytes * (1.0 - OWN_SHARE),
        });
    }

    /// What images, depth and corners of keyframes, and what was made of them, take in memory now,
    /// bytes.
    #[must_use]
    pub fn bytes_in_memory(&self) -> usize {
        let bytes = self.0.bytes();
        bytes.own + bytes.derived
    }
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
        let setup = Setup::new(config, pinhole, mask, seed);
        let graph = GraphLink::new(&setup, None)?.map(|(link, _)| link);
        let map = Map::new(Store::new(&setup.config.memory));
        Ok(Self {
            start: Some(start),
            ..Self::with_map(setup, map, graph)
        })
    }

    /// A system that goes on with a map. Until the camera is recognised in it, frames are lost.
    ///
    /// # Errors
    /// As [`Slam::new`], and when the map is damaged, belongs to images of another size, or the
    /// settings keep places from being recognised.
    pub fn continue_from(
        config: SlamConfig,
        pinhole: Pinhole,
        mask: Mask,
        seed: u64,
        map: StoredMap,
        purpose: Purpose,
    ) -> Result<Self, SlamError> {
        config.validate()?;
        map.check((mask.width(), mask.height()))?;
        if !(config.graph.enabled && config.graph.places.enabled) {
            return Err(ContinueError::NoPlaces.into());
        }
        let setup = Setup {
            is_frozen: purpose == Purpose::LocaliseOnly,
            ..Setup::new(config, pinhole, mask, seed)
        };
        let store = Store::new(&setup.config.memory);
        let (mut restored, graph) = restored(&|_| &setup, &store, map)?;
        let graph = GraphLink::new(&setup, Some(graph))?.map(|(link, edges)| {
            restored.set_edges(edges);
            link
        });
        Ok(Self::with_map(setup, restored, graph))
    }

    /// The same with the readings of an inertial sensor beside the camera, on the clock of the
    /// frames: they say how the camera turns from frame to frame.
    #[must_use]
    pub fn with_imu(mut self, imu: Arc<Imu>) -> Self {
        self.setup.imu = Some(imu);
        self
    }

    /// The same where the depth of the frame with this number was measured: the first keyframe is
    /// that one, and frames before it wait.
    #[must_use]
    pub fn with_first_measured(mut self, index: usize) -> Self {
        if self.start.is_some() {
            self.start = Some(Start::with_measured(index));
        }
        self
    }

    /// Adds readings of that sensor as they come, before the frames that are later than they are;
    /// without a sensor ([`Self::with_imu`]) nothing is done. Those of the last half an hour are
    /// kept.
    pub fn add_readings(&mut self, readings: &[ImuSample]) {
        /// Readings of a fast sensor over this time take some twenty megabytes, ns.
        const KEPT_NS: i64 = 30 * 60 * 1_000_000_000;
        let Some(imu) = &mut self.setup.imu else {
            return;
        };
        let imu = Arc::make_mut(imu);
        imu.add(readings);
        if let Some(newest) = imu.samples().last() {
            imu.forget_before(newest.timestamp_ns.saturating_sub(KEPT_NS));
        }
    }

    /// The path of the main map as it is now beside the readings of the inertial sensor; `None`
    /// without a sensor.
    #[must_use]
    pub fn inertial_path(&self) -> Option<InertialPath> {
        let imu = Arc::clone(self.setup.imu.as_ref()?);
        let config = self.setup.config.inertial.clone();
        let is_metric = self.scale() == Scale::Metric;
        Some(InertialPath::new(
            imu,
            &self.trajectory(),
            config,
            is_metric,
        ))
    }

    /// What the calibration has left of the radial distortion of the lens in the images: a ray at
    /// `x` from the axis, in focal lengths, is seen at `x (1 + radial |x|^2)`. The keyframes are
    /// adjusted by it after the last frame.
    pub fn take_left_radial(&mut self, radial: f64) {
        self.setup.left_radial = radial;
    }

    /// A system that looks for the camera in a map.
    fn with_map(setup: Setup, map: Map, graph: Option<GraphLink>) -> Self {
        let mut slam = Self {
            setup,
            start: None,
            waiting: Vec::new(),
            map,
            tracker: Tracker::default(),
            policy: KeyframePolicy::default(),
            depth: DepthStage::default(),
            recovery: LossRecovery::default(),
            odometry: Odometry::default(),
            graph,
            frame_index: 0,
            stopwatch: Stopwatch::start(),
            events: Vec::new(),
        };
        slam.events = slam.map.take_events();
        slam
    }

    /// What the last call has changed about the map: [`Slam::process_frame`], [`Slam::finish`], or
    /// [`Slam::continue_from`], whose keyframes are all new to a listener.
    #[must_use]
    pub fn events(&self) -> &[Event] {
        &self.events
    }

    /// Finished keyframes, by identity.
    #[must_use]
    pub fn keyframes(&self) -> Vec<KeptKeyframe> {
        self.map.published().collect()
    }

    /// The keyframe of the main map on which the newest frame was tracked; `None` where that has no
    /// pose there.
    #[must_use]
    pub fn keyframe_in_use(&self) -> Option<KeyframeInUse> {
        let (active, last) = (self.tracker.active.as_ref()?, self.tracker.last.as_ref()?);
        let (keyframe, depth) = (&self.map[active.id], self.depth.get()?);
        let is_here = self.recovery.lost_in_a_row() == 0 && keyframe.fragment == MAIN_MAP;
        let unit = keyframe.world_from_keyframe.scale;
        let pose = last.motion.frame_from_keyframe.stretched(unit);
        is_here.then(|| KeyframeInUse {
            id: active.id,
            camera_from_keyframe: pose.with_scale(unit),
            pixels: public_pixels(&self.setup, keyframe, depth),
            num_gaps: self.odometry.num_gaps,
        })
    }

    /// The number of finished keyframes.
    #[must_use]
    pub fn num_keyframes(&self) -> usize {
        self.map.num_published()
    }

    /// The number of keyframes of which a depth camera measured the depth.
    #[must_use]
    pub fn num_measured_keyframes(&self) -> usize {
        let keyframes = self.map.keyframes().iter();
        keyframes
            .filter(|keyframe| keyframe.measured.is_some())
            .count()
    }

    /// Lets images and depth of keyframes for which there is no room in memory
    /// ([`crate::MemoryConfig`]) lie in a file, which nobody else may use; without one all of them
    /// stay in memory. Its bytes mean nothing to anybody else.
    pub fn spill_into(&self, file: File) {
        self.map.store().spill_into(file);
    }

    /// The room of the keyframes, for a thread beside those that use the system.
    #[must_use]
    pub fn room(&self) -> KeyframeRoom {
        KeyframeRoom(self.map.store().clone())
    }

    /// What went wrong with that file first, if anything did.
    #[must_use]
    pub fn spill_failure(&self) -> Option<String> {
        self.map.store().failure()
    }

    /// Whether all keyframes that were asked for came back from that file. Depth that does not is
    /// missing in what was made meanwhile, so whoever hands over maps asks this last.
    ///
    /// # Errors
    /// A keyframe could not be read back.
    pub fn check_spilled(&self) -> Result<(), SpillError> {
        self.map.store().check()
    }

    /// The camera of its keyframes.
    #[must_use]
    pub fn camera(&self) -> KeyframeCamera {
        self.setup.camera()
    }

    /// Where its keyframes lie, with room for what is made of them.
    #[must_use]
    pub fn store(&self) -> &Store {
        self.map.store()
    }

    /// The newest poses of all keyframes.
    #[must_use]
    pub fn snapshot(&self) -> Arc<PoseSnapshot> {
        Arc::clone(self.map.snapshot())
    }

    /// Whether lengths are metres.
    #[must_use]
    pub fn scale(&self) -> Scale {
        self.map.scale()
    }

    /// The fragments other than the main map, by identity.
    #[must_use]
    pub fn fragments(&self) -> Vec<Fragment> {
        self.map.fragments()
    }

    /// The fragment that is the main map since [`Slam::finish`], under the name that it had before:
    /// it was much larger than the first map, which has that name now. `None` while the first map
    /// is the main map.
    #[must_use]
    pub fn exchanged(&self) -> Option<FragmentId> {
        self.map.exchanged()
    }

    /// Of each keyframe, by identity, the oldest one that points or direct alignments hold together
    /// with it, perhaps over others: within such a part places are known well. Two parts know of
    /// each other only by tracked motion, or across a loss.
    #[must_use]
    pub fn parts(&self) -> Vec<KeyframeId> {
        parts(self.map.keyframes().len(), self.map.edges())
    }

    /// Losses after which the map went on with frames that both sides know, in the order of time.
    #[must_use]
    pub fn bridges(&self) -> &[Bridge] {
        self.map.bridges()
    }

    /// All frames with a believed pose in the main map, with everything known now, in the order of
    /// time.
    ///
    /// Frames are known relative to their keyframe. Where the keyframe after it says something else
    /// about the last of them, the difference is spread over the frames of the visit.
    #[must_use]
    pub fn trajectory(&self) -> Vec<TrajectoryPose> {
        self.trajectory_in(MAIN_MAP)
    }

    /// [`Self::trajectory`], and between its frames those in which the camera was lost for a short
    /// time: where it would be if it went on as it moved. As long as the error of that is small, by
    /// how much the camera accelerates elsewhere, and for a second and a half at most.
    #[must_use]
    pub fn whole_trajectory(&self) -> Vec<TrajectoryPose> {
        self.map.whole_trajectory()
    }

    /// The frames of a fragment with a pose, in its own world; empty once it is joined to another.
    #[must_use]
    pub fn trajectory_in(&self, fragment: FragmentId) -> Vec<TrajectoryPose> {
        self.map.trajectory_in(fragment)
    }

    /// What the graph has done so far.
    #[must_use]
    pub fn graph_stats(&self) -> GraphStats {
        self.graph
            .as_ref()
            .map(|link| link.stats)
            .unwrap_or_default()
    }

    /// How often something has happened.
    #[must_use]
    pub fn counts(&self) -> &Counts {
        self.map.counts()
    }

    /// What grows while the camera sees new places, and only then.
    #[must_use]
    pub fn map_size(&self) -> MapSize {
        let mut size = self.map.size();
        if self.graph.is_none() {
            // keyframes form a chain
            size.edges = size.keyframes.saturating_sub(1);
        }
        size
    }

    /// The map as [`Slam::continue_from`] takes it. Only finished keyframes are in it: call
    /// [`Slam::finish`] before.
    #[must_use]
    pub fn stored_map(&self) -> StoredMap {
        stored(&self.map, |_| self.setup.pinhole)
    }

    /// How the finished keyframes are linked, by identity: what [`Self::stored_map`] says of them
    /// without images and depth.
    #[must_use]
    pub fn links(&self) -> Vec<StoredLink> {
        let keyframes = self.map.keyframes().iter();
        let finished = keyframes.filter(|keyframe| keyframe.published.is_some());
        finished.map(stored_link).collect()
    }

    /// The constraints between finished keyframes.
    #[must_use]
    pub fn edges(&self) -> Vec<StoredEdge> {
        stored_edges(&self.map)
    }

    /// The points of the sparse layer, by their hosts, as finished keyframes see them; made one by
    /// one.
    pub fn points(&self) -> impl Iterator<Item = StoredPoint> {
        stored_points(&self.map)
    }

    /// Frames with a believed pose in any fragment, relative to their keyframes, in the order of
    /// time.
    #[must_use]
    pub fn tracked_frames(&self) -> Vec<TrackedFrame> {
        self.map.tracked_frames()
    }

    /// Intrinsics of the working images.
    #[must_use]
    pub fn pinhole(&self) -> &Pinhole {
        &self.setup.pinhole
    }

    /// The graph of the main map's keyframes with the newest poses; with chain edges alone when
    /// there is no graph.
    #[must_use]
    pub fn pose_graph(&self) -> PoseGraph {
        let mut graph = PoseGraph::new();
        let first = self.map.in_fragment(MAIN_MAP).next().map(|k| k.id);
        for keyframe in self.map.in_fragment(MAIN_MAP) {
            // identities are unique and poses finite, so nothing is refused
            let _ = graph.add_node(GraphNode {
                id: u64::from(keyframe.id),
                world_from_keyframe: keyframe.world_from_keyframe,
                is_fixed: Some(keyframe.id) == first,
            });
        }
        for edge in self.map.edges() {
            // those of other fragments have no nodes here
            let _ = graph.add_edge(edge.edge);
        }
        let is_chain = self.map.edges().is_empty();
        for pair in self.map.keyframes().windows(2).filter(|_| is_chain) {
            let _ = graph.add_edge(GraphEdge {
                i: u64::from(pair[0].id),
                j: u64::from(pair[1].id),
                i_from_j: pair[0].world_from_keyframe.inverse() * pair[1].world_from_keyframe,
                information: Mat7::identity(),
                kernel: RobustKernel::None,
            });
        }
        graph
    }
}
