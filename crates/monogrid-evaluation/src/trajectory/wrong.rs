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

/// A pose that is wrong.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WrongPose {
    /// Time of the pose, seconds.
    pub time_secs: f64,
    /// Distance from the true position, units of the truth.
    pub distance: f64,
    /// Angle to the true orientation, degrees.
    pub degrees: f64,
}

/// The poses that are wrong when positions and orientations are aligned together, each in units of
/// what is allowed; all of them where they determine no alignment. (By positions alone, the angle
/// around a nearly straight path rests on their errors.)
pub(super) fn wrong_poses(
    pairs: &[PosePair],
    alignment: TrajectoryAlignment,
    config: &WrongPoseConfig,
) -> Vec<WrongPose> {
    let max_distance = config.path_share * path_length(pairs);
    let radius = max_distance / config.degrees.to_radians();
    let gt_from_est = match alignment.with_scale() {
        Some(with_scale) => align_poses(pairs, radius, with_scale),
        None => Some(Sim3::identity()),
    };
    let measured = |pair: &PosePair| {
        let error = gt_from_est.as_ref().map(|gt_from_est| {
            pair.gt_from_camera.inverse() * apply(gt_from_est, &pair.est_from_camera)
        });
        WrongPose {
            time_secs: pair.time_secs,
            distance: error.map_or(f64::INFINITY, |error| error.translation.norm()),
            degrees: error.map_or(180.0, |error| error.rotation.angle().to_degrees()),
        }
    };
    let is_wrong = |pose: &WrongPose| pose.distance > max_distance || pose.degrees > config.degrees;
    pairs.iter().map(measured).filter(is_wrong).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::{Se3, Vec3, Vec6};

    /// A straight path of 10 m that sways by 3 cm, measured with an error of 5 cm that sways with
    /// it.
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
        let wrong = wrong_poses(pairs, TrajectoryAlignment::Sim3, &config);
        wrong.len() as f64 / pairs.len() as f64
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

    #[test]
    fn a_wrong_pose_is_named_with_its_errors() {
        let mut pairs = pairs();
        let turned = Se3::exp(&Vec6::from_row_slice(&[0.0, 0.0, 0.0, 0.0, 0.2, 0.0]));
        pairs[40].est_from_camera = pairs[40].est_from_camera * turned;
        let wrong = wrong_poses(
            &pairs,
            TrajectoryAlignment::None,
            &WrongPoseConfig::default(),
        );
        assert_eq!(wrong.len(), 1);
        assert_eq!(wrong[0].time_secs, pairs[40].time_secs);
        assert!((wrong[0].degrees - 0.2_f64.to_degrees()).abs() < 1e-9);
        // what sways by 3 cm and what sways by 5 cm, at right angles
        let distance = 0.05_f64.hypot(0.03);
        assert!((wrong[0].distance - distance).abs() < 1e-9);
    }
}
