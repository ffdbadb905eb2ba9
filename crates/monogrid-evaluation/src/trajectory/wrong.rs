//! Poses that are far from the truth.

use super::align::align_poses;
use super::{PosePair, TrajectoryAlignment, apply, path_length};
use monogrid_geometry::Sim3;

/// When a pose counts as wrong.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WrongPoseConfig {
    /// Distance from the true position as a share of the path, (0, inf). Default 0.02.
    pub path_share: f64,
    /// Angle to the true orientation, degrees, (0, 180]. Default 3.
    pub degrees: f64,
}

impl Default for WrongPoseConfig {
    fn default() -> Self {
        Self {
            path_share: 0.02,
            degrees: 3.0,
        }
    }
}

/// Share of the poses that are wrong when positions and orientations are aligned together, each in units of what is
/// allowed. (By positions alone, the angle around a nearly straight path rests on their errors.)
pub(super) fn wrong_share(
    pairs: &[PosePair],
    alignment: TrajectoryAlignment,
    config: &WrongPoseConfig,
) -> f64 {
    let (max_distance, max_angle) = (
        config.path_share * path_length(pairs),
        config.degrees.to_radians(),
    );
    let radius = max_distance / max_angle;
    let gt_from_est = match alignment {
        TrajectoryAlignment::Sim3 => align_poses(pairs, radius, true),
        TrajectoryAlignment::Se3 => align_poses(pairs, radius, false),
        TrajectoryAlignment::None => Some(Sim3::identity()),
    };
    let is_wrong = |pair: &&PosePair| {
        gt_from_est.is_none_or(|gt_from_est| {
            let aligned = apply(&gt_from_est, &pair.est_from_camera);
            let error = pair.gt_from_camera.inverse() * aligned;
            error.translation.norm() > max_distance || error.rotation.angle() > max_angle
        })
    };
    pairs.iter().filter(is_wrong).count() as f64 / pairs.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::{Se3, Vec3, Vec6};

    /// A straight path of 10 m that sways by 3 cm, measured with an error of 5 cm that sways with it.
    fn pairs() -> Vec<PosePair> {
        (0..100)
            .map(|k| {
                let t = 0.1 * f64::from(k);
                let at = |sway: Vec3| {
                    let position = Vec3::new(t, 0.0, 0.0) + sway;
                    Se3::new(monogrid_geometry::Rotation::identity(), position)
                };
                let sway = Vec3::new(0.0, (2.0 * t).sin(), (2.0 * t).cos());
                PosePair {
                    time_secs: t,
                    est_from_camera: at(Vec3::new(0.0, -sway.z, sway.y) * 0.05),
                    gt_from_camera: at(sway * 0.03),
                }
            })
            .collect()
    }

    fn share(pairs: &[PosePair]) -> f64 {
        let config = WrongPoseConfig::default();
        wrong_share(pairs, TrajectoryAlignment::Sim3, &config)
    }

    #[test]
    fn errors_of_positions_across_a_straight_path_turn_nothing() {
        assert_eq!(share(&pairs()), 0.0);
    }

    #[test]
    fn poses_beyond_either_limit_are_wrong() {
        let spoiled = |twist: [f64; 6]| {
            let mut pairs = pairs();
            for pair in &mut pairs[95..] {
                let moved = Se3::exp(&Vec6::from_row_slice(&twist));
                pair.est_from_camera = pair.est_from_camera * moved;
            }
            share(&pairs)
        };
        assert_eq!(spoiled([0.0, 0.1, 0.0, 0.0, 0.0, 0.0]), 0.0);
        assert_eq!(spoiled([0.0, 0.5, 0.0, 0.0, 0.0, 0.0]), 0.05);
        assert_eq!(spoiled([0.0, 0.0, 0.0, 0.0, 0.03, 0.0]), 0.0);
        assert_eq!(spoiled([0.0, 0.0, 0.0, 0.0, 0.08, 0.0]), 0.05);
    }
}
