//! Covariances from the inverse of the graph's information matrix.

use super::linear::Terms;
use super::solver::{free_slots, pattern};
use super::{PoseGraph, PoseGraphError};
use crate::blocks::{BlockPattern, Factor};
use monogrid_geometry::{Mat7, Sim3};
use std::collections::BTreeMap;

/// Uncertainty of a graph at the poses it had when this was made, given the nodes that are held and
/// the weights that the robust kernels leave the edges.
///
/// It is as honest as the information matrices of the edges.
pub struct GraphUncertainty {
    /// Nothing when every node is held.
    system: Option<(BlockPattern, Factor)>,
    /// Per identity the place among the free nodes, if free, and the pose.
    nodes: BTreeMap<u64, (Option<usize>, Sim3)>,
}

impl GraphUncertainty {
    pub(super) fn new(graph: &PoseGraph) -> Result<Self, PoseGraphError> {
        let slot = free_slots(graph);
        let free = slot.iter().flatten().count();
        let terms = Terms::new(graph);
        let system = if free == 0 {
            None
        } else {
            let pattern = pattern(&terms, &slot);
            let poses = graph.poses();
            let mut residuals = Vec::new();
            terms.evaluate(&poses, 1.0, &mut residuals);
            let mut h = pattern.zeros();
            terms.linearise(&poses, &residuals, 1.0, &slot, &pattern, &mut h);
            let mut factor = pattern.factor();
            pattern
                .factorise(&h, &mut factor)
                .ok_or(PoseGraphError::Singular)?;
            Some((pattern, factor))
        };
        let nodes = graph.nodes.iter().zip(&slot);
        Ok(Self {
            system,
            nodes: nodes
                .map(|(n, &slot)| (n.id, (slot, n.world_from_keyframe)))
                .collect(),
        })
    }

    /// Covariance of a left update `[v, w, s]` of `i_from_j`, in the units of keyframe `i`: what is
    /// not known about one keyframe as seen from another. This, not the absolute covariance, blurs
    /// a map.
    ///
    /// # Errors
    /// When a keyframe is unknown.
    pub fn relative(&self, i: u64, j: u64) -> Result<Mat7, PoseGraphError> {
        let (slot_i, world_from_i) = self.node(i)?;
        let (slot_j, _) = self.node(j)?;
        // i_from_j = T_i^-1 T_j moves by Ad(T_i^-1) (d_j - d_i)
        let given = [(slot_j, 1.0), (slot_i, -1.0)].into_iter();
        let given = given.filter_map(|(slot, sign)| Some((slot?, sign)));
        let in_world = self.quadratic(&given.collect::<Vec<_>>())?;
        let adjoint = world_from_i.inverse().adjoint();
        Ok(adjoint * in_world * adjoint.transpose())
    }

    /// Covariance of a left update of `world_from_keyframe`, given the held nodes; zero for those.
    ///
    /// # Errors
    /// When the keyframe is unknown.
    pub fn absolute(&self, id: u64) -> Result<Mat7, PoseGraphError> {
        let (slot, _) = self.node(id)?;
        let given: Vec<_> = slot.into_iter().map(|k| (k, 1.0)).collect();
        self.quadratic(&given)
    }

    fn node(&self, id: u64) -> Result<(Option<usize>, Sim3), PoseGraphError> {
        let found = self.nodes.get(&id).copied();
        found.ok_or(PoseGraphError::Unknown { id })
    }

    /// `E' H^-1 E` for the selection `E` of signed blocks.
    fn quadratic(&self, given: &[(usize, f64)]) -> Result<Mat7, PoseGraphError> {
        let Some((pattern, factor)) = &self.system else {
            return Ok(Mat7::zeros());
        };
        let wanted: Vec<_> = given.iter().map(|&(slot, _)| slot).collect();
        let blocks = pattern.solve_blocks(factor, given, &wanted);
        let signed = given.iter().zip(blocks).map(|(&(_, sign), x)| x * sign);
        let sum: Mat7 = signed.sum();
        Ok((sum + sum.transpose()) * 0.5)
    }
}
