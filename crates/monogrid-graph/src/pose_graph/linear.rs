//! Cost and normal equations of a pose graph.

use super::{EdgeFit, GraphEdge, PoseGraph};
use crate::RobustKernel;
use crate::blocks::{BlockMatrix, BlockPattern};
use crate::tangent::sim3_left_jacobian_inverse;
use monogrid_geometry::{Mat7, Sim3, Vec7};

/// What an edge leaves at some poses.
#[derive(Clone, Copy, Debug)]
pub(super) struct Residual {
    r: Vec7,
    chi2: f64,
}

/// The terms of a graph's cost, with indices instead of identities.
pub(super) struct Terms<'a> {
    edges: &'a [GraphEdge],
    /// Per edge whether an earlier optimisation has judged it: then its kernel is not widened.
    is_judged: &'a [bool],
    /// Per edge its nodes.
    pub ends: Vec<(usize, usize)>,
    /// Per edge the inverse of its measurement.
    j_from_i: Vec<Sim3>,
}

impl<'a> Terms<'a> {
    pub(super) fn new(graph: &'a PoseGraph) -> Self {
        // Every identity was checked on entry.
        let index = |id: u64| graph.index_of_id.get(&id).copied().unwrap_or(0);
        let ends = |e: &GraphEdge| (index(e.i), index(e.j));
        Self {
            edges: &graph.edges,
            is_judged: &graph.is_judged,
            ends: graph.edges.iter().map(ends).collect(),
            j_from_i: graph.edges.iter().map(|e| e.i_from_j.inverse()).collect(),
        }
    }

    /// `r = log(T_i^-1 T_j M^-1)`.
    fn residual(&self, edge: usize, poses: &[Sim3]) -> Vec7 {
        let (i, j) = self.ends[edge];
        (poses[i].inverse() * poses[j] * self.j_from_i[edge]).log()
    }

    fn chi2(&self, edge: usize, poses: &[Sim3]) -> f64 {
        self.fit(edge, poses).chi2
    }

    fn fit(&self, edge: usize, poses: &[Sim3]) -> Residual {
        let r = self.residual(edge, poses);
        let chi2 = r.dot(&(self.edges[edge].information * r)).max(0.0);
        Residual { r, chi2 }
    }

    /// Robust cost, with the bounded kernels of new edges `width` times as wide.
    pub(super) fn cost(&self, poses: &[Sim3], width: f64) -> f64 {
        self.evaluate(poses, width, &mut Vec::new())
    }

    /// The same; `residuals` becomes what all edges leave.
    pub(super) fn evaluate(
        &self,
        poses: &[Sim3],
        width: f64,
        residuals: &mut Vec<Residual>,
    ) -> f64 {
        residuals.clear();
        residuals.extend((0..self.edges.len()).map(|edge| self.fit(edge, poses)));
        let mut sum = 0.0;
        for (edge, residual) in residuals.iter().enumerate() {
            sum += self.kernel(edge, width).cost(residual.chi2);
        }
        0.5 * sum
    }

    pub(super) fn edge_fits(&self, poses: &[Sim3]) -> Vec<EdgeFit> {
        let fit = |(edge, e): (usize, &GraphEdge)| {
            let chi2 = self.chi2(edge, poses);
            let weight = e.kernel.weight(chi2);
            EdgeFit { chi2, weight }
        };
        self.edges.iter().enumerate().map(fit).collect()
    }

    /// The kernel of an edge, `width` times as wide if it could switch off an edge that is new.
    fn kernel(&self, edge: usize, width: f64) -> RobustKernel {
        match self.edges[edge].kernel {
            RobustKernel::DynamicCovariance { phi } if !self.is_judged[edge] => {
                RobustKernel::DynamicCovariance { phi: phi * width }
            }
            other => other,
        }
    }

    /// How many times wider bounded kernels must be for every new edge to be in their quadratic
    /// part.
    pub(super) fn quadratic_width(&self, poses: &[Sim3]) -> f64 {
        let mut width = 1.0_f64;
        for (edge, e) in self.edges.iter().enumerate() {
            if let RobustKernel::DynamicCovariance { phi } = e.kernel
                && !self.is_judged[edge]
            {
                width = width.max(self.chi2(edge, poses) / phi);
            }
        }
        width
    }

    /// Whether more than a tenth of the edges have not been judged by an earlier optimisation.
    pub(super) fn is_mostly_new(&self) -> bool {
        let new = self.is_judged.iter().filter(|&&judged| !judged).count();
        10 * new > self.edges.len()
    }

    /// Whether an edge that no earlier optimisation has judged is switched off.
    pub(super) fn has_new_edge_off(&self, poses: &[Sim3]) -> bool {
        let is_off = |edge: usize| {
            let kernel = self.edges[edge].kernel;
            matches!(kernel, RobustKernel::DynamicCovariance { .. })
                && !self.is_judged[edge]
                && kernel.weight(self.chi2(edge, poses)) < 0.5
        };
        (0..self.edges.len()).any(is_off)
    }

    /// Normal equations `H x = b` at `poses`, of which `residuals` are known; `slot` gives each
    /// node's place among the free ones.
    pub(super) fn linearise(
        &self,
        poses: &[Sim3],
        residuals: &[Residual],
        width: f64,
        slot: &[Option<usize>],
        pattern: &BlockPattern,
        h: &mut BlockMatrix,
    ) -> Vec<Vec7> {
        h.clear();
        let mut b = vec![Vec7::zeros(); slot.iter().flatten().count()];
        let adjoints: Vec<Mat7> = poses.iter().map(|pose| pose.inverse().adjoint()).collect();
        for (edge, e) in self.edges.iter().enumerate() {
            let (i, j) = self.ends[edge];
            if slot[i].is_none() && slot[j].is_none() {
                continue;
            }
            let residual = residuals[edge];
            let weight = self.kernel(edge, width).weight(residual.chi2);
            let (block, gradient) = normal_terms(&residual, &adjoints[i], &e.information, weight);
            if let Some(a) = slot[j] {
                pattern.add(h, (a, a), &block);
                b[a] -= gradient;
            }
            if let Some(a) = slot[i] {
                pattern.add(h, (a, a), &block);
                b[a] += gradient;
            }
            if let (Some(a), Some(c)) = (slot[i], slot[j]) {
                pattern.add(h, (a, c), &-block);
            }
        }
        b
    }

    /// Per node half of `b' H^-1 b` of its own block: see [`PoseGraph::strains`].
    pub(super) fn strains(&self, poses: &[Sim3]) -> Vec<f64> {
        let mut own = vec![(Mat7::zeros(), Vec7::zeros()); poses.len()];
        for (edge, e) in self.edges.iter().enumerate() {
            let (i, j) = self.ends[edge];
            let residual = self.fit(edge, poses);
            let weight = e.kernel.weight(residual.chi2);
            let adjoint = poses[i].inverse().adjoint();
            let (block, gradient) = normal_terms(&residual, &adjoint, &e.information, weight);
            for (node, sign) in [(i, 1.0), (j, -1.0)] {
                own[node].0 += block;
                own[node].1 += gradient * sign;
            }
        }
        let strain = |(h, b): (Mat7, Vec7)| h.cholesky().map_or(0.0, |c| 0.5 * b.dot(&c.solve(&b)));
        own.into_iter().map(strain).collect()
    }
}

/// What an edge adds to the normal equations of node `j`, block and gradient; node `i` has the same
/// block and the negative gradient.
fn normal_terms(
    residual: &Residual,
    adjoint: &Mat7,
    information: &Mat7,
    weight: f64,
) -> (Mat7, Vec7) {
    // d r / d T_j = J_l^-1(r) Ad(T_i^-1), and its negative by T_i
    let jacobian = sim3_left_jacobian_inverse(&residual.r) * adjoint;
    let weighted = jacobian.tr_mul(information) * weight;
    (weighted * jacobian, weighted * residual.r)
}

#[cfg(test)]
mod tests {
    use super::super::GraphNode;
    use super::*;

    /// Two free nodes with an edge: the gradient and, for a plain kernel near zero
    /// residual, the Hessian are the derivatives of the cost.
    #[test]
    fn normal_equations_are_the_derivatives_of_the_cost() {
        let tangents = [
            [0.0; 7],
            [0.02, -0.01, 0.03, 0.01, 0.02, -0.01, 0.01],
            [0.5, -0.7, 0.9, 0.6, -0.4, 0.3, 0.4],
            [3.0, 1.0, -2.0, 1.5, -2.0, 1.0, -0.6],
        ];
        let kernels = [
            RobustKernel::None,
            RobustKernel::Huber { delta: 1.0 },
            RobustKernel::Cauchy { scale: 2.0 },
            RobustKernel::DynamicCovariance { phi: 3.0 },
        ];
        assert_eq!(tangents.len() * kernels.len(), 16);
        for error in tangents {
            for kernel in kernels {
                check(&Vec7::from(error), kernel);
            }
        }
    }

    fn check(error: &Vec7, kernel: RobustKernel) {
        let a = Sim3::exp(&Vec7::from([1.0, -2.0, 0.5, 0.3, 1.2, -0.4, 0.3]));
        let b = Sim3::exp(&Vec7::from([-1.0, 0.4, 2.5, -0.9, 0.1, 0.8, -0.4]));
        let mut graph = PoseGraph::new();
        for (id, pose) in [(0, a), (1, b)] {
            let node = GraphNode {
                id,
                world_from_keyframe: pose,
                is_fixed: false,
            };
            assert!(graph.add_node(node).is_ok());
        }
        let square = Mat7::from_fn(|r, c| ((r * 3 + c * 5) % 7) as f64 * 0.3);
        let edge = GraphEdge {
            i: 0,
            j: 1,
            i_from_j: Sim3::exp(error) * a.inverse() * b,
            information: square * square.transpose() + Mat7::identity(),
            kernel,
        };
        graph.edges.push(edge);
        graph.is_judged.push(false);
        let terms = Terms::new(&graph);
        let slot = [Some(0), Some(1)];
        let pattern = BlockPattern::new(2, &terms.ends);
        let poses = [a, b];
        let mut residuals = Vec::new();
        terms.evaluate(&poses, 1.0, &mut residuals);
        let mut h = pattern.zeros();
        let gradient = terms.linearise(&poses, &residuals, 1.0, &slot, &pattern, &mut h);
        for node in 0..2 {
            for k in 0..7 {
                let cost = |h: f64| {
                    let mut d = Vec7::zeros();
                    d[k] = h;
                    let mut moved = poses;
                    moved[node] = Sim3::exp(&d) * moved[node];
                    terms.cost(&moved, 1.0)
                };
                let h = 1e-5;
                let numeric = (cost(h) - cost(-h)) / (2.0 * h);
                let scale = 1.0 + gradient[node].norm();
                let found = -gradient[node][k];
                assert!(
                    (numeric - found).abs() < 1e-6 * scale,
                    "{kernel:?}, node {node}, {k}: {found} instead of {numeric}"
                );
            }
        }
    }
}
