//! The alignment of the estimate to the truth.

use super::{PosePair, TrajectoryAlignment};
use monogrid_geometry::{
    AlignmentError, Mat3, Rotation, Sim3, Vec3, align_similarity, nalgebra::Rotation3,
};

/// A path whose spread across is a smaller share of that along does not tell how the camera was
/// turned around it.
const STRAIGHT: f64 = 0.01;
/// Weight of the orientations beside the positions of a straight path: these fix two angles, those
/// the third.
const ORIENTATION_WEIGHT: f64 = 1e-3;

/// The similarity or rigid transform that brings the estimated positions closest to the true ones;
/// on a straight path the angle around it comes from the orientations, where they are known.
pub(super) fn align(
    pairs: &[PosePair],
    alignment: TrajectoryAlignment,
    has_orientations: bool,
) -> Result<Sim3, AlignmentError> {
    let Some(with_scale) = alignment.with_scale() else {
        return Ok(Sim3::identity());
    };
    if has_orientations && let Some(aligned) = along_a_line(pairs, with_scale) {
        return Ok(aligned);
    }
    let (source, target): (Vec<Vec3>, Vec<Vec3>) = pairs.iter().map(positions).unzip();
    Ok(align_similarity(&source, &target, with_scale)?.target_from_source)
}

/// Of the camera in the estimate and in the truth.
fn positions(pair: &PosePair) -> (Vec3, Vec3) {
    (
        pair.est_from_camera.translation,
        pair.gt_from_camera.translation,
    )
}

/// The transform for a true path along a line; `None` where it is none, or where nobody moves.
fn along_a_line(pairs: &[PosePair], with_scale: bool) -> Option<Sim3> {
    let moments = Moments::of(pairs);
    let spread = (moments.scatter.symmetric_eigenvalues()).map(|v| v.max(0.0).sqrt());
    let (longest, sum) = (spread.max(), spread.sum());
    let across = sum - longest - spread.min();
    let strength = moments.covariance.norm();
    if !(longest > 0.0 && across < STRAIGHT * longest && strength > 0.0) {
        return None;
    }
    let turn =
        nearest_rotation(&(moments.covariance / strength + moments.turns * ORIENTATION_WEIGHT))?;
    moments.transform(&turn, with_scale)
}

/// The transform that brings positions and orientations together at once: an error of `radius` in a
/// position counts as much as one radian. `None` where nobody moves.
pub(super) fn align_poses(pairs: &[PosePair], radius: f64, with_scale: bool) -> Option<Sim3> {
    /// The scale depends on the rotation, which depends on the scale.
    const ROUNDS: usize = 5;
    let moments = Moments::of(pairs);
    let mut turn = nearest_rotation(&moments.turns)?;
    for _ in 0..ROUNDS {
        let scale = moments.scale(&turn, with_scale)?;
        // 2 scale from the squared distances, radius² from the squared angles
        let both = moments.covariance * (2.0 * scale) + moments.turns * (radius * radius);
        turn = nearest_rotation(&both)?;
    }
    moments.transform(&turn, with_scale)
}

/// What an alignment needs to know about pairs of poses.
struct Moments {
    mean_source: Vec3,
    mean_target: Vec3,
    /// Of the target.
    scatter: Mat3,
    /// Of target and source.
    covariance: Mat3,
    var_source: f64,
    /// Mean rotation, true world from estimated world.
    turns: Mat3,
}

impl Moments {
    fn of(pairs: &[PosePair]) -> Self {
        let n = pairs.len() as f64;
        let mut moments = Self {
            mean_source: pairs.iter().map(|p| positions(p).0).sum::<Vec3>() / n,
            mean_target: pairs.iter().map(|p| positions(p).1).sum::<Vec3>() / n,
            scatter: Mat3::zeros(),
            covariance: Mat3::zeros(),
            var_source: 0.0,
            turns: Mat3::zeros(),
        };
        for pair in pairs {
            let (source, target) = positions(pair);
            let (ds, dt) = (source - moments.mean_source, target - moments.mean_target);
            moments.scatter += dt * dt.transpose() / n;
            moments.covariance += dt * ds.transpose() / n;
            moments.var_source += ds.norm_squared() / n;
            moments.turns += rotation(pair.gt_from_camera.rotation)
                * rotation(pair.est_from_camera.rotation).transpose()
                / n;
        }
        moments
    }

    /// The best scale for a rotation; `None` where the estimate does not move.
    fn scale(&self, turn: &Mat3, with_scale: bool) -> Option<f64> {
        if !with_scale {
            return Some(1.0);
        }
        let scale = (turn.transpose() * self.covariance).trace() / self.var_source;
        (scale > 0.0 && scale.is_finite()).then_some(scale)
    }

    fn transform(&self, turn: &Mat3, with_scale: bool) -> Option<Sim3> {
        let scale = self.scale(turn, with_scale)?;
        let turn = Rotation::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*turn));
        let mean = self.mean_target - turn * self.mean_source * scale;
        let aligned = Sim3::new(scale, turn, mean);
        aligned.is_finite().then_some(aligned)
    }
}

/// The rotation with the largest trace of its transpose times a matrix.
fn nearest_rotation(matrix: &Mat3) -> Option<Mat3> {
    let svd = matrix.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    let sign = (u.determinant() * v_t.determinant()).signum();
    Some(u * Mat3::from_diagonal(&Vec3::new(1.0, 1.0, sign)) * v_t)
}

fn rotation(rotation: Rotation) -> Mat3 {
    rotation.to_rotation_matrix().into_inner()
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::{Se3, Vec6};

    fn twist(v: [f64; 6]) -> Se3 {
        Se3::exp(&Vec6::from_row_slice(&v))
    }

    /// A camera that turns a little while it drives `across` off a straight line, seen from another
    /// frame.
    fn pairs(gt_from_est: &Sim3, across: f64) -> Vec<PosePair> {
        (0..40)
            .map(|i| {
                let t = f64::from(i);
                let est_from_camera = Se3::new(
                    twist([0.0, 0.0, 0.0, 0.01 * t, -0.02 * (0.3 * t).sin(), 0.1]).rotation,
                    Vec3::new(0.5 * t, across * (0.4 * t).sin(), across * (0.7 * t).cos()),
                );
                let moved = *gt_from_est * est_from_camera.with_scale(1.0);
                PosePair {
                    time_secs: t,
                    est_from_camera,
                    gt_from_camera: moved.to_se3(),
                }
            })
            .collect()
    }

    #[test]
    fn straight_paths_are_aligned_by_orientation_too() {
        let truth = twist([3.0, -1.0, 2.0, 0.4, 1.2, -0.7]).with_scale(2.5);
        for across in [0.0, 1e-9, 0.001, 0.05, 2.0] {
            let found = align(&pairs(&truth, across), TrajectoryAlignment::Sim3, true).unwrap();
            let angle = found.rotation.angle_to(&truth.rotation);
            assert!(angle < 1e-6, "{across}: {angle}");
            assert!((found.scale / truth.scale - 1.0).abs() < 1e-9, "{across}");
            assert!(
                (found.translation - truth.translation).norm() < 1e-6,
                "{across}"
            );
        }
        let rigid = truth.to_se3().with_scale(1.0);
        let found = align(&pairs(&rigid, 0.0), TrajectoryAlignment::Se3, true).unwrap();
        assert!(found.rotation.angle_to(&rigid.rotation) < 1e-6 && found.scale == 1.0);
    }

    #[test]
    fn positions_and_orientations_together_find_the_exact_transform() {
        let truth = twist([3.0, -1.0, 2.0, 0.4, 1.2, -0.7]).with_scale(2.5);
        for across in [0.0, 0.05, 2.0] {
            let found = align_poses(&pairs(&truth, across), 1.0, true).unwrap();
            assert!(found.rotation.angle_to(&truth.rotation) < 1e-6, "{across}");
            assert!((found.scale / truth.scale - 1.0).abs() < 1e-9, "{across}");
            assert!((found.translation - truth.translation).norm() < 1e-6);
        }
    }

    #[test]
    fn a_camera_that_stands_still_cannot_be_aligned() {
        let mut still = pairs(&Sim3::identity(), 0.0);
        for pair in &mut still {
            pair.gt_from_camera.translation = Vec3::zeros();
            pair.est_from_camera.translation = Vec3::zeros();
        }
        assert!(align(&still, TrajectoryAlignment::Sim3, true).is_err());
    }
}
