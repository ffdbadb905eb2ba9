//! What the edges of the graph say, and how much they are believed.

use super::state::{CERTAIN, KeyframeGraph};
use crate::KeyframeId;
use crate::graph::job::{EdgeKind, OdometryEdge};
use crate::sparse::SharedPoints;
use monogrid_alignment::SimilarityConstraint;
use monogrid_geometry::{Mat6, Mat7, Sim3};
use monogrid_graph::RobustKernel;

impl KeyframeGraph {
    /// Holds two keyframes as they are to each other.
    pub(super) fn hold(&mut self, i: KeyframeId, j: KeyframeId) {
        let i_from_j = self.relative(i, j);
        if let Some(information) = self.with_model_error(Mat7::zeros(), &i_from_j) {
            self.set_edge((i, j, EdgeKind::Odometry), i_from_j, information, CERTAIN);
        }
    }

    /// The motion that tracking found holds a keyframe until something better does.
    pub(super) fn add_odometry(&mut self, odometry: &OdometryEdge) {
        let covariance = with_scale(&odometry.covariance, odometry.scale_sigma);
        let Some(information) = covariance.cholesky().map(|c| c.inverse()) else {
            return;
        };
        let key = (odometry.parent, odometry.keyframe, EdgeKind::Odometry);
        let measured = odometry.parent_from_keyframe;
        self.set_edge(key, measured, information, RobustKernel::None);
    }

    /// Covariance of a motion `[v, w]` as one of a similarity `[v, w, s]`: tracking does not measure scale.
    pub(super) fn with_unknown_scale(&self, motion: &Mat6) -> Mat7 {
        with_scale(motion, self.config.odometry_scale_sigma)
    }

    /// The relative pose of two keyframes as the sparse layer has it now.
    pub(super) fn set_sparse_edge(&mut self, found: &SharedPoints) {
        let config = &self.config.sparse_edges;
        let (i, j) = (found.i, found.j);
        let i_from_j = self.relative(i, j);
        let factor = (config.reference_points as f64 / found.count.max(1) as f64).max(1.0);
        let mut information = Mat7::zeros();
        for k in 0..7 {
            let sigma = match k {
                0..3 => config.translation_sigma,
                3..6 => config.rotation_sigma,
                _ => config.scale_sigma,
            };
            information[(k, k)] = 1.0 / (sigma * sigma * factor);
        }
        self.edges.remove(&(i, j, EdgeKind::Odometry));
        self.set_edge((i, j, EdgeKind::Sparse), i_from_j, information, CERTAIN);
    }

    /// Adds the edge of two keyframes that were recognised and aligned: it is right unless it contradicts what
    /// drift can do.
    pub(super) fn close_loop(
        &mut self,
        i: KeyframeId,
        j: KeyframeId,
        constraint: &SimilarityConstraint,
    ) {
        let kernel = if self.can_have_drifted(i, j, &constraint.b_from_a) {
            CERTAIN
        } else {
            self.doubted()
        };
        self.set_direct_edge(i, j, constraint, kernel);
        self.stats.loop_closures += 1;
    }

    pub(super) fn set_direct_edge(
        &mut self,
        i: KeyframeId,
        j: KeyframeId,
        constraint: &SimilarityConstraint,
        kernel: RobustKernel,
    ) {
        let Some(covariance) = constraint.information.cholesky().map(|c| c.inverse()) else {
            return;
        };
        let Some(information) = self.with_model_error(covariance, &constraint.b_from_a) else {
            return;
        };
        self.stats.constraints += 1;
        self.edges.remove(&(i, j, EdgeKind::Odometry));
        let key = (i, j, EdgeKind::Direct);
        self.set_edge(key, constraint.b_from_a, information, kernel);
    }

    /// Information of a relative pose when the errors that its residuals do not show are counted too.
    pub(super) fn with_model_error(&self, mut covariance: Mat7, i_from_j: &Sim3) -> Option<Mat7> {
        let config = &self.config.direct_edges;
        let moved = i_from_j.translation.norm() * config.translation_share;
        let translation_var = config.translation_sigma.powi(2) + moved * moved;
        for k in 0..7 {
            covariance[(k, k)] += match k {
                0..3 => translation_var,
                3..6 => config.rotation_sigma.powi(2),
                _ => config.scale_sigma.powi(2),
            };
        }
        let information = covariance.cholesky()?.inverse();
        Some((information + information.transpose()) * 0.5)
    }

    /// Kernel of edges that may be wrong.
    pub(super) fn doubted(&self) -> RobustKernel {
        RobustKernel::DynamicCovariance {
            phi: self.config.switch_chi_sq,
        }
    }
}

/// Covariance of a motion `[v, w]` and of the logarithm of its scale as one of a similarity `[v, w, s]`.
fn with_scale(motion: &Mat6, scale_sigma: f64) -> Mat7 {
    let mut covariance = Mat7::zeros();
    covariance.fixed_view_mut::<6, 6>(0, 0).copy_from(motion);
    covariance[(6, 6)] = scale_sigma * scale_sigma;
    covariance
}
