//! Keyframe pose graph on Sim(3).
//!
//! Nodes are keyframes (`world_from_keyframe`), edges are measured similarities `i_from_j` with an
//! information matrix and a robust kernel. [`PoseGraph::optimise`] descends on
//!
//! ```text
//! 1/2 sum rho(r' W r),   r = log(T_i^-1 T_j M_ij^-1)
//! ```
//!
//! * Tangents are `[v, w, s]`, updates on the left; `W` is the inverse covariance of a left update
//!   of `i_from_j`, in the units of keyframe `i`.
//! * Derivatives are exact: `dr/dT_j = J_l^-1(r) Ad(T_i^-1) = -dr/dT_i`.
//! * Gauge: nodes marked fixed; in every connected part without one, its first node is held.
//! * Scale cannot collapse: it is a logarithm, residuals are in keyframe units, implausible scale
//!   ratios are refused on entry, and no single step may change a scale by more than a factor two.
//! * Wrong edges: bounded kernels ([`crate::RobustKernel::DynamicCovariance`]) are graduated, from
//!   nearly quadratic to their own shape (graduated non-convexity, `[YANG20]`), so
//!   that right edges with a large initial error are not switched off. Only edges added since the
//!   last optimisation are graduated: a closure into a graph at rest costs a few steps. Give edges
//!   that must not tear, such as odometry, an unbounded kernel.
//!
//! References: `[STRASDAT10]`, `[AGARWAL13]`.

mod linear;
mod solver;
mod uncertainty;

use crate::RobustKernel;
use monogrid_geometry::{Mat7, Sim3};
use std::collections::BTreeMap;
pub use uncertainty::GraphUncertainty;

/// A keyframe of the graph.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GraphNode {
    /// Identity of the keyframe, never reused.
    pub id: u64,
    /// Pose and scale: the scale is the length of the keyframe's unit in the world.
    pub world_from_keyframe: Sim3,
    /// Whether it must not move.
    pub is_fixed: bool,
}

/// A measured similarity between two keyframes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GraphEdge {
    /// Identity of keyframe `i`.
    pub i: u64,
    /// Identity of keyframe `j`.
    pub j: u64,
    /// The measurement.
    pub i_from_j: Sim3,
    /// Inverse covariance of a left update `[v, w, s]` of `i_from_j`; symmetric, not negative.
    pub information: Mat7,
    /// Robust kernel on `r' W r`.
    pub kernel: RobustKernel,
}

/// Settings of [`PoseGraph::optimise`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseGraphConfig {
    /// Accepted steps at most, once the kernels have their own shape. Default 20.
    pub max_iterations: usize,
    /// Stop when an accepted step lowers the cost by less than this share. Default 1e-5.
    pub min_relative_decrease: f64,
    /// Damping at the start, as a share of the diagonal. Default 1e-8: measurements determine a
    /// connected graph.
    pub initial_damping: f64,
    /// Factor by which bounded kernels are narrowed from one stage to the next; `None` uses them as
    /// they are from the start. Default 4.
    pub graduation: Option<f64>,
    /// Accepted steps at most in each stage before the last. Default 2.
    pub iterations_per_stage: usize,
    /// Further descents, by other ways, when the first one switched off edges of a graph that is
    /// largely new; the one with the least cost wins. Of 1000 random graphs with a tenth of all
    /// edges wrong, 20 need them. Default 3.
    pub second_opinions: usize,
}

impl Default for PoseGraphConfig {
    fn default() -> Self {
        Self {
            max_iterations: 20,
            min_relative_decrease: 1e-5,
            initial_damping: 1e-8,
            graduation: Some(4.0),
            iterations_per_stage: 2,
            second_opinions: 3,
        }
    }
}

/// Largest scale ratio of an edge: beyond it the measurement is certainly wrong, and the seed of a
/// collapse of scale.
pub const MAX_EDGE_SCALE_RATIO: f64 = 10.0;

/// How well one edge fits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgeFit {
    /// Squared whitened residual.
    pub chi2: f64,
    /// Weight that its kernel leaves it, in (0, 1].
    pub weight: f64,
}

/// Why the optimisation ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GraphOutcome {
    /// The cost no longer falls.
    Converged,
    /// Stopped at [`PoseGraphConfig::max_iterations`] while the cost still fell.
    IterationLimit,
    /// No node may move.
    NothingToDo,
}

/// What an optimisation did.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseGraphReport {
    /// Robust cost before.
    pub initial_cost: f64,
    /// Robust cost after; never more than before.
    pub final_cost: f64,
    /// Accepted steps, all stages.
    pub iterations: usize,
    /// Why it ended.
    pub outcome: GraphOutcome,
    /// Per edge, in the order of insertion, its fit.
    pub edges: Vec<EdgeFit>,
    /// Per node, in the order of insertion, whether it moved at all.
    pub moved: Vec<bool>,
}

/// What is wrong with a node, an edge or a request.
#[derive(Debug, thiserror::Error, Clone, PartialEq)]
#[non_exhaustive]
pub enum PoseGraphError {
    /// The identity exists already.
    #[error("keyframe {id} is in the graph already; use `set_pose` to change it")]
    Duplicate {
        /// The identity.
        id: u64,
    },
    /// The identity does not exist.
    #[error("keyframe {id} is not in the graph; add its node first")]
    Unknown {
        /// The identity.
        id: u64,
    },
    /// An edge from a keyframe to itself.
    #[error("edge from keyframe {id} to itself")]
    Loop {
        /// The identity.
        id: u64,
    },
    /// Not finite, or a scale that is not positive.
    #[error("{what} is not a finite similarity with positive scale")]
    Transform {
        /// Which transform.
        what: String,
    },
    /// A scale ratio that no measurement has.
    #[error(
        "edge {i}-{j} has scale {scale}, expected between 1/{max} and {max}: reject the constraint"
    )]
    Scale {
        /// From.
        i: u64,
        /// To.
        j: u64,
        /// What was found.
        scale: f64,
        /// Largest accepted.
        max: f64,
    },
    /// An information matrix that is not finite, not symmetric or negative on its diagonal.
    #[error("information of edge {i}-{j} is not a finite symmetric matrix with a diagonal >= 0")]
    Information {
        /// From.
        i: u64,
        /// To.
        j: u64,
    },
    /// A number out of range.
    #[error("{what} is {value}, expected {expected}")]
    Value {
        /// Which number.
        what: &'static str,
        /// What was found.
        value: f64,
        /// What is allowed.
        expected: &'static str,
    },
    /// The measurements leave some node undetermined.
    #[error("the graph's equations are singular: some keyframe has edges without information")]
    Singular,
}

/// A graph of keyframes. Order of insertion decides every order inside: equal calls give equal
/// bits.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PoseGraph {
    nodes: Vec<GraphNode>,
    edges: Vec<GraphEdge>,
    /// Per edge whether an optimisation has judged it.
    is_judged: Vec<bool>,
    index_of_id: BTreeMap<u64, usize>,
}

impl PoseGraph {
    /// A graph without keyframes.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a keyframe.
    ///
    /// # Errors
    /// When the identity exists or the pose is invalid.
    pub fn add_node(&mut self, node: GraphNode) -> Result<(), PoseGraphError> {
        check_transform(&node.world_from_keyframe, || {
            format!("pose of keyframe {}", node.id)
        })?;
        if self.index_of_id.contains_key(&node.id) {
            return Err(PoseGraphError::Duplicate { id: node.id });
        }
        self.index_of_id.insert(node.id, self.nodes.len());
        self.nodes.push(node);
        Ok(())
    }

    /// Adds a measurement.
    ///
    /// # Errors
    /// When a keyframe is unknown or the measurement invalid or implausible.
    pub fn add_edge(&mut self, edge: GraphEdge) -> Result<(), PoseGraphError> {
        let (i, j) = (edge.i, edge.j);
        self.check_pair(i, j)?;
        check_transform(&edge.i_from_j, || format!("measurement of edge {i}-{j}"))?;
        let (scale, max) = (edge.i_from_j.scale, MAX_EDGE_SCALE_RATIO);
        if !(1.0 / max..=max).contains(&scale) {
            return Err(PoseGraphError::Scale { i, j, scale, max });
        }
        let w = &edge.information;
        let tolerance = 1e-9 * w.amax();
        if !w.iter().all(|x| x.is_finite())
            || (w - w.transpose()).amax() > tolerance
            || w.diagonal().min() < 0.0
        {
            return Err(PoseGraphError::Information { i, j });
        }
        if !edge.kernel.is_valid() {
            return Err(PoseGraphError::Value {
                what: "kernel threshold, seen through its cost of 1",
                value: edge.kernel.cost(1.0),
                expected: "a positive threshold",
            });
        }
        self.edges.push(edge);
        self.is_judged.push(false);
        Ok(())
    }

    /// Adds a measurement that an earlier optimisation of the same graph has judged: its kernel is
    /// used as it is.
    ///
    /// # Errors
    /// As [`PoseGraph::add_edge`].
    pub fn add_judged_edge(&mut self, edge: GraphEdge) -> Result<(), PoseGraphError> {
        self.add_edge(edge)?;
        if let Some(is_judged) = self.is_judged.last_mut() {
            *is_judged = true;
        }
        Ok(())
    }

    fn check_pair(&self, i: u64, j: u64) -> Result<(), PoseGraphError> {
        self.index(i)?;
        self.index(j)?;
        if i == j {
            return Err(PoseGraphError::Loop { id: i });
        }
        Ok(())
    }

    /// Keyframes, in the order of insertion.
    #[must_use]
    pub fn nodes(&self) -> &[GraphNode] {
        &self.nodes
    }

    /// Measurements, in the order of insertion.
    #[must_use]
    pub fn edges(&self) -> &[GraphEdge] {
        &self.edges
    }

    /// Pose of a keyframe.
    #[must_use]
    pub fn pose(&self, id: u64) -> Option<Sim3> {
        let index = self.index_of_id.get(&id)?;
        Some(self.nodes[*index].world_from_keyframe)
    }

    /// Moves a keyframe.
    ///
    /// # Errors
    /// When it is unknown or the pose invalid.
    pub fn set_pose(&mut self, id: u64, world_from_keyframe: Sim3) -> Result<(), PoseGraphError> {
        check_transform(&world_from_keyframe, || format!("pose of keyframe {id}"))?;
        let index = self.index(id)?;
        self.nodes[index].world_from_keyframe = world_from_keyframe;
        Ok(())
    }

    /// Fixes a keyframe, or lets it move.
    ///
    /// # Errors
    /// When it is unknown.
    pub fn set_fixed(&mut self, id: u64, is_fixed: bool) -> Result<(), PoseGraphError> {
        let index = self.index(id)?;
        self.nodes[index].is_fixed = is_fixed;
        Ok(())
    }

    fn index(&self, id: u64) -> Result<usize, PoseGraphError> {
        let found = self.index_of_id.get(&id).copied();
        found.ok_or(PoseGraphError::Unknown { id })
    }

    /// Squared whitened residual and weight of every edge at the current poses.
    #[must_use]
    pub fn edge_fits(&self) -> Vec<EdgeFit> {
        linear::Terms::new(self).edge_fits(&self.poses())
    }

    /// Robust cost of the current poses.
    #[must_use]
    pub fn cost(&self) -> f64 {
        linear::Terms::new(self).cost(&self.poses(), 1.0)
    }

    /// Per node, in the order of insertion, by how much the cost would fall to first order if it
    /// alone could move, fixed or not: a fixed node with much strain is where the others would push
    /// it. Zero where the edges of a node do not determine it.
    #[must_use]
    pub fn strains(&self) -> Vec<f64> {
        linear::Terms::new(self).strains(&self.poses())
    }

    /// Moves the nodes to a minimum of the cost.
    ///
    /// # Errors
    /// When a setting is out of range, or the equations are singular.
    pub fn optimise(
        &mut self,
        config: &PoseGraphConfig,
    ) -> Result<PoseGraphReport, PoseGraphError> {
        solver::optimise(self, config)
    }

    /// Uncertainty at the current poses: one factorisation, then each query costs one solve.
    ///
    /// # Errors
    /// When the equations are singular.
    pub fn uncertainty(&self) -> Result<GraphUncertainty, PoseGraphError> {
        GraphUncertainty::new(self)
    }

    fn poses(&self) -> Vec<Sim3> {
        self.nodes.iter().map(|n| n.world_from_keyframe).collect()
    }
}

fn check_transform(t: &Sim3, what: impl Fn() -> String) -> Result<(), PoseGraphError> {
    if t.is_finite() {
        return Ok(());
    }
    Err(PoseGraphError::Transform { what: what() })
}
