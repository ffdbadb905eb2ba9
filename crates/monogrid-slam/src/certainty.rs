//! How well the pose of a keyframe is known.
//!
//! Where little is in view, turning and moving sideways look alike: the camera slides, what comes
//! into view gets its depth from wrong poses, and each frame agrees with its keyframe well enough
//! to be believed. The covariance of bundle adjustment shows it.

use monogrid_geometry::Mat6;

/// Largest standard deviation of the place of a keyframe whose pose is certain, in median depths of
/// what it sees.
const MAX_PLACE: f64 = 0.01;
/// Largest standard deviation of its orientation, degrees.
const MAX_TURN_DEG: f64 = 0.4;

/// Standard deviations of the pose of a keyframe beside those that an adjustment did not move:
/// roots of the traces of the two blocks of its covariance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PoseSigma {
    /// Of its place, median depths of what it sees.
    pub place: f64,
    /// Of its orientation, rad.
    pub turn: f64,
}

impl PoseSigma {
    /// Of a pose that no points hold.
    pub(crate) const UNKNOWN: Self = Self {
        place: f64::INFINITY,
        turn: f64::INFINITY,
    };

    /// From the covariance of an update `[v, w]` in units of the world, and the median depth in
    /// them.
    pub(crate) fn of(covariance: &Mat6, median_depth: f64) -> Self {
        let variances = covariance.diagonal();
        Self {
            place: variances.fixed_rows::<3>(0).sum().sqrt() / median_depth,
            turn: variances.fixed_rows::<3>(3).sum().sqrt(),
        }
    }

    /// Whether the pose is certain.
    pub(crate) fn is_certain(&self) -> bool {
        // NaN is not
        self.place <= MAX_PLACE && self.turn <= MAX_TURN_DEG.to_radians()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::Vec6;

    #[test]
    fn the_trace_of_each_block_counts() {
        let variances = Vec6::new(1.0, 4.0, 4.0, 4.0, 16.0, 16.0);
        let sigma = PoseSigma::of(&Mat6::from_diagonal(&variances), 2.0);
        assert_eq!((sigma.place, sigma.turn), (1.5, 6.0));
    }

    #[test]
    fn a_pose_is_certain_when_points_hold_both_its_place_and_its_orientation() {
        let limit = PoseSigma {
            place: MAX_PLACE,
            turn: MAX_TURN_DEG.to_radians(),
        };
        assert!(limit.is_certain());
        for (place, turn) in [(1.01, 1.0), (1.0, 1.01), (f64::NAN, 1.0), (1.0, f64::NAN)] {
            let looser = PoseSigma {
                place: place * limit.place,
                turn: turn * limit.turn,
            };
            assert!(!looser.is_certain(), "{looser:?}");
        }
        assert!(!PoseSigma::UNKNOWN.is_certain());
    }
}
