//! The graph with all that its jobs need.

use super::constraints::Constraints;
use super::join::Joining;
use crate::graph::GraphConfig;
use crate::graph::job::{EdgeKey, EdgeKind, GraphStats};
use crate::graph::places::{PlacesError, memory_of_places};
use crate::graph::search::Probes;
use crate::map::View;
use crate::stored::StoredEdge;
use crate::{FragmentConfig, FragmentId, KeyframeId, MAIN_MAP, PoseSnapshot};
use monogrid_alignment::KeyframeView;
use monogrid_features::PlaceMemory;
use monogrid_geometry::{Mat7, Pinhole, Sim3};
use monogrid_graph::RobustKernel;
use monogrid_graph::pose_graph::{GraphEdge, PoseGraphError};
use monogrid_image::Mask;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// A finished keyframe as the graph keeps it.
#[derive(Clone, Debug)]
pub(super) struct Entry {
    pub view: Arc<View>,
    pub probes: Probes,
}

/// Kernel of edges that are right but for single large errors.
pub(super) const CERTAIN: RobustKernel = RobustKernel::Huber { delta: 3.0 };

/// Constraints between keyframes and the optimisation of their poses.
#[derive(Clone, Debug)]
pub(crate) struct KeyframeGraph {
    pub(super) config: GraphConfig,
    /// What belongs to the picture; everything where there is none.
    pub(super) mask: Option<Mask>,
    pub(super) entries: BTreeMap<KeyframeId, Entry>,
    /// The keyframes as the job under way moves them. Each fragment has its own world, held by its first
    /// keyframe, and is optimised alone.
    pub(super) poses: PoseSnapshot,
    /// Fragments that the job under way has to do with.
    pub(super) active: BTreeSet<FragmentId>,
    pub(super) joining: Joining,
    pub(super) edges: Constraints,
    pub(super) refused: BTreeMap<(KeyframeId, KeyframeId), Sim3>,
    /// Keyframes by their appearance.
    pub(super) places: PlaceMemory,
    /// Prepared keyframes, the most recently used last.
    pub(super) prepared: Vec<(KeyframeId, Arc<KeyframeView>)>,
    /// Why an optimisation of the job under way failed, if one did.
    pub(super) failure: Option<PoseGraphError>,
    pub(super) stats: GraphStats,
}

impl KeyframeGraph {
    /// A graph without keyframes, in which frames with this camera are looked for. Of their images and those of keyframes `mask` says
    /// what belongs to the picture; without one keyframes may have cameras of their own.
    ///
    /// # Errors
    /// A vocabulary that cannot be used.
    pub(crate) fn new(
        config: GraphConfig,
        joining: FragmentConfig,
        pinhole: Pinhole,
        mask: Option<Mask>,
    ) -> Result<Self, PlacesError> {
        let places = memory_of_places(&config.places, pinhole)?;
        Ok(Self {
            config,
            mask,
            entries: BTreeMap::new(),
            poses: PoseSnapshot::default(),
            active: BTreeSet::from([MAIN_MAP]),
            joining: Joining::new(joining),
            edges: Constraints::default(),
            refused: BTreeMap::new(),
            places,
            prepared: Vec::new(),
            failure: None,
            stats: GraphStats::default(),
        })
    }

    /// Adds an edge or replaces one.
    pub(super) fn set_edge(
        &mut self,
        (i, j, kind): EdgeKey,
        i_from_j: Sim3,
        information: Mat7,
        kernel: RobustKernel,
    ) {
        let edge = GraphEdge {
            i: u64::from(i),
            j: u64::from(j),
            i_from_j,
            information,
            kernel,
        };
        self.edges.set((i, j, kind), edge);
    }

    /// All edges with where they come from.
    pub(crate) fn stored_edges(&self) -> Vec<StoredEdge> {
        self.edges.stored()
    }

    /// Whether two keyframes have a direct edge.
    pub(super) fn is_aligned(&self, i: KeyframeId, j: KeyframeId) -> bool {
        self.edges.has(&(i, j, EdgeKind::Direct))
    }

    /// The fragment of a keyframe.
    pub(super) fn fragment_of(&self, id: KeyframeId) -> FragmentId {
        self.poses.fragment_of(id)
    }

    pub(super) fn pose(&self, id: KeyframeId) -> Sim3 {
        self.poses.world_from_keyframe[id as usize]
    }

    pub(super) fn relative(&self, i: KeyframeId, j: KeyframeId) -> Sim3 {
        self.pose(i).inverse() * self.pose(j)
    }
}
