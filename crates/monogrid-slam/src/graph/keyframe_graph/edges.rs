//! What the edges of the graph say, and how much they are believed; what drift can do between
//! keyframes: the one rule by which loops, and what is said about fragments, are told from errors.

use super::KeyframeGraph;
use crate::KeyframeId;
use crate::graph::DriftConfig;
use crate::graph::SharedPoints;
use crate::graph::job::{EdgeKind, OdometryEdge};
use crate::map::path_between;
use monogrid_alignment::SimilarityConstraint;
use monogrid_geometry::{Mat7, Sim3, Vec7};
use monogrid_graph::RobustKernel;
use std::ops::Add;

/// Squared normalised residual from which edges other than those between successive keyframes lose
/// weight.
const SWITCH_CHI_SQ: f64 = 25.0;
/// Error of the translation of direct alignment that its residuals do not show, as a share of it.
pub(super) const DIRECT_TRANSLATION_SHARE: f64 = 0.02;
/// The least such error, median depths.
pub(super) const DIRECT_TRANSLATION_SIGMA: f64 = 0.003;
/// That of the rotation, rad.
pub(super) const DIRECT_ROTATION_SIGMA: f64 = 0.003;
/// That of the logarithm of the scale.
pub(super) const DIRECT_SCALE_SIGMA: f64 = 0.01;
/// Shared points at which the standard deviations below hold; with fewer they grow with the root.
const REFERENCE_POINTS: usize = 100;
/// Standard deviation of the translation between two keyframes of the sparse layer with that many
/// shared points, median depths.
const SPARSE_TRANSLATION_SIGMA: f64 = 0.0008;
/// Standard deviation of their rotation, rad.
const SPARSE_ROTATION_SIGMA: f64 = 0.0005;
/// Standard deviation of the logarithm of their scale.
const SPARSE_SCALE_SIGMA: f64 = 0.005;

/// Kernel of edges that are right but for single large errors.
pub(super) const CERTAIN: RobustKernel = RobustKernel::Huber { delta: 3.0 };

impl OdometryEdge {
    /// Covariance `[v, w, s]` of the motion as one of a similarity: tracking does not measure
    /// scale.
    pub(super) fn covariance(&self) -> Mat7 {
        let mut covariance = Mat7::zeros();
        covariance
            .fixed_view_mut::<6, 6>(0, 0)
            .copy_from(&self.covariance);
        covariance[(6, 6)] = self.scale_sigma * self.scale_sigma;
        covariance
    }
}

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
        let Some(information) = odometry.covariance().cholesky().map(|c| c.inverse()) else {
            return;
        };
        let key = (odometry.i, odometry.j, EdgeKind::Odometry);
        self.set_edge(key, odometry.i_from_j, information, RobustKernel::None);
    }

    /// The relative pose of two keyframes as the sparse layer has it now.
    pub(super) fn set_sparse_edge(&mut self, found: &SharedPoints) {
        let (i, j) = (found.i, found.j);
        let i_from_j = self.relative(i, j);
        let factor = (REFERENCE_POINTS as f64 / found.count.max(1) as f64).max(1.0);
        let sigmas = [
            SPARSE_TRANSLATION_SIGMA,
            SPARSE_ROTATION_SIGMA,
            SPARSE_SCALE_SIGMA,
        ];
        let weights = by_part(sigmas).map(|sigma| 1.0 / (sigma * sigma * factor));
        let information = Mat7::from_diagonal(&weights);
        self.edges.remove(&(i, j, EdgeKind::Odometry));
        self.set_edge((i, j, EdgeKind::Sparse), i_from_j, information, CERTAIN);
    }

    /// Adds the edge of two keyframes that were recognised and aligned: it is right unless it
    /// contradicts what drift can do.
    pub(super) fn close_loop(
        &mut self,
        i: KeyframeId,
        j: KeyframeId,
        constraint: &SimilarityConstraint,
    ) {
        let is_certain = self.can_have_drifted(i, j, &constraint.b_from_a);
        self.set_direct_edge(i, j, constraint, is_certain);
        self.stats.loop_closures += 1;
    }

    /// Adds what direct alignment of two keyframes says; `is_certain` where only single large
    /// errors of it can be wrong.
    pub(super) fn set_direct_edge(
        &mut self,
        i: KeyframeId,
        j: KeyframeId,
        constraint: &SimilarityConstraint,
        is_certain: bool,
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
        let kernel = self.kernel(is_certain);
        self.set_edge(key, constraint.b_from_a, information, kernel);
    }

    /// Information of a relative pose when the errors that its residuals do not show are counted
    /// too.
    pub(super) fn with_model_error(&self, mut covariance: Mat7, i_from_j: &Sim3) -> Option<Mat7> {
        let moved = i_from_j.translation.norm() * DIRECT_TRANSLATION_SHARE;
        let translation_var = DIRECT_TRANSLATION_SIGMA.powi(2) + moved * moved;
        let shared = by_part([
            translation_var,
            DIRECT_ROTATION_SIGMA.powi(2),
            DIRECT_SCALE_SIGMA.powi(2),
        ]);
        covariance.set_diagonal(&(covariance.diagonal() + shared));
        let information = covariance.cholesky()?.inverse();
        Some((information + information.transpose()) * 0.5)
    }

    /// Kernel of edges that are right but for single large errors, or of those that may be wrong.
    pub(super) fn kernel(&self, is_certain: bool) -> RobustKernel {
        if is_certain {
            return CERTAIN;
        }
        RobustKernel::DynamicCovariance { phi: SWITCH_CHI_SQ }
    }

    /// Whether the poses of two keyframes differ from a measurement by more than drift is at least.
    /// A loop that agrees with them would not correct anything but tie keyframes together that see
    /// each other from far away, where direct alignment is worse than what holds them: in a room
    /// that is in view all the time such edges make the poses worse.
    pub(super) fn is_drift(&self, i: KeyframeId, j: KeyframeId, i_from_j: &Sim3) -> bool {
        let error = self.contradiction(i, j, i_from_j);
        !self.config.places.drift.explains(&error, Way::default())
    }

    /// Whether the poses of two keyframes differ from a measurement by no more than tracking drifts
    /// between them. The edges of the graph expect less: a loop that corrects drift contradicts
    /// them, and would be switched off as if it were wrong.
    pub(super) fn can_have_drifted(&self, i: KeyframeId, j: KeyframeId, i_from_j: &Sim3) -> bool {
        let error = self.contradiction(i, j, i_from_j);
        self.config.places.drift.explains(&error, self.way(i, j))
    }

    /// Logarithm of the similarity between a measurement and the poses of two keyframes.
    fn contradiction(&self, i: KeyframeId, j: KeyframeId, i_from_j: &Sim3) -> Vec7 {
        (i_from_j.inverse() * self.relative(i, j)).log()
    }

    /// The way along which tracking came from one keyframe to another.
    pub(super) fn way(&self, i: KeyframeId, j: KeyframeId) -> Way {
        let path = path_between(|id| self.poses.parent_of(id), i, j);
        let position = |id: KeyframeId| self.pose(id).translation;
        let length = |pair: &[KeyframeId]| (position(pair[1]) - position(pair[0])).norm();
        let in_world: f64 = path.windows(2).map(length).sum();
        Way {
            steps: path.len().saturating_sub(1) as f64,
            length: in_world / self.pose(j).scale,
        }
    }
}

/// The values for translation, rotation and scale at the places of a tangent `[v, w, s]`.
fn by_part(values: [f64; 3]) -> Vec7 {
    Vec7::from_fn(|k, _| values[k / 3])
}

/// The way along which tracking came from one keyframe to another.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Way {
    /// Keyframes.
    steps: f64,
    /// Length in units of the second keyframe.
    length: f64,
}

impl Add for Way {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            steps: self.steps + other.steps,
            length: self.length + other.length,
        }
    }
}

impl DriftConfig {
    /// Whether drift over a way can be as large as `error`, the logarithm of the similarity between
    /// what was measured and what was expected.
    ///
    /// Successive errors have common causes (calibration, the scale of what is seen), so drift
    /// grows with the way, not with its root as the edges of the graph would have it.
    pub(super) fn explains(&self, error: &Vec7, way: Way) -> bool {
        let (translation, rotation) = (error.fixed_rows::<3>(0), error.fixed_rows::<3>(3));
        translation.norm() <= self.translation_start + self.translation_share * way.length
            && rotation.norm() <= self.rotation_start + self.rotation_step * way.steps
            && error[6].abs() <= self.scale_start + self.scale_step * way.steps
    }

    /// The same growth over the way, from another start.
    pub(super) fn starting_at(&self, start: f64) -> Self {
        Self {
            translation_start: start,
            rotation_start: start,
            scale_start: start,
            ..self.clone()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(translation: f64, rotation: f64, scale: f64) -> Vec7 {
        Vec7::from_column_slice(&[0.0, translation, 0.0, rotation, 0.0, 0.0, -scale])
    }

    #[test]
    fn drift_grows_with_the_way_and_each_part_has_its_own_limit() {
        let drift = DriftConfig {
            translation_start: 0.1,
            translation_share: 0.5,
            rotation_start: 0.2,
            rotation_step: 0.25,
            scale_start: 0.3,
            scale_step: 0.125,
        };
        let way = Way {
            steps: 1.0,
            length: 1.0,
        } + Way {
            steps: 3.0,
            length: 1.0,
        };
        // limits: 0.1 + 0.5 * 2, 0.2 + 0.25 * 4, 0.3 + 0.125 * 4
        assert!(drift.explains(&error(1.09, 1.19, 0.79), way));
        assert!(!drift.explains(&error(1.11, 0.0, 0.0), way));
        assert!(!drift.explains(&error(0.0, 1.21, 0.0), way));
        assert!(!drift.explains(&error(0.0, 0.0, 0.81), way));
        assert!(!drift.explains(&error(0.11, 0.0, 0.0), Way::default()));
        let later = drift.starting_at(0.6);
        assert!(later.explains(&error(1.59, 1.59, 1.09), way));
        assert!(!later.explains(&error(0.0, 0.0, 1.11), way));
        assert!(!later.explains(&error(0.0, f64::NAN, 0.0), way));
    }
}
