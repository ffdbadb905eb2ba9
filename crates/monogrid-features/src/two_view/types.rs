//! Matches, settings, and what two views tell.

use monogrid_geometry::{Se3, Vec2};

/// The same point seen in two images, in undistorted pixels of one camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Match {
    /// Pixel in image `a`; the point is anchored here.
    pub a: Vec2,
    /// Pixel in image `b`.
    pub b: Vec2,
}

/// Settings of [`two_view`](super::two_view).
#[derive(Clone, Debug, PartialEq)]
pub struct TwoViewConfig {
    /// Expected noise of a match, px. Default 1; outliers are beyond three of it.
    pub sigma_px: f64,
    /// Most random samples per model. Default 300.
    pub iterations: usize,
    /// Seed of the sampling. Default 0.
    pub seed: u64,
    /// Fewest matches to try. Default 50.
    pub min_matches: usize,
    /// Smallest share of matches that must agree with the motion. Default 0.5.
    pub min_inlier_ratio: f64,
    /// Smallest median angle between the two rays of a point, degrees. Default 1.
    pub min_parallax_deg: f64,
    /// Smallest median distance of the matches from the best rotation without translation, px.
    /// Default 3.
    pub min_rotation_residual_px: f64,
    /// Largest standard deviation of the direction of translation, degrees. Default 6.
    pub max_direction_sigma_deg: f64,
    /// Largest median of the relative standard deviation of inverse depths. Default 0.25.
    pub max_relative_idepth_sigma: f64,
    /// Another motion is a rival when its robust cost (chi squared) exceeds the best by less than
    /// this share of it. Default 0.1.
    pub rival_margin: f64,
}

impl Default for TwoViewConfig {
    fn default() -> Self {
        Self {
            sigma_px: 1.0,
            iterations: 300,
            seed: 0,
            min_matches: 50,
            min_inlier_ratio: 0.5,
            min_parallax_deg: 1.0,
            min_rotation_residual_px: 3.0,
            max_direction_sigma_deg: 6.0,
            max_relative_idepth_sigma: 0.25,
            rival_margin: 0.1,
        }
    }
}

/// Inverse depth of a match in the frame of `a`, in units of 1 / baseline.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TriangulatedPoint {
    /// Inverse depth along the optical axis of `a`; about zero at infinity.
    pub idepth: f64,
    /// Its standard deviation, with that of the motion.
    pub idepth_sigma: f64,
}

/// A motion between two views with the points that support it.
#[derive(Clone, Debug)]
pub struct TwoView {
    /// Motion with a translation of length one.
    pub b_from_a: Se3,
    /// One per match: `None` for outliers and for points that come out behind a camera.
    pub points: Vec<Option<TriangulatedPoint>>,
    /// Number of matches that agree.
    pub num_inliers: usize,
    /// Median angle between the two rays of a point, degrees.
    pub parallax_deg: f64,
    /// Median distance of the inliers from the best rotation without translation, px.
    pub rotation_residual_px: f64,
    /// Standard deviation of the direction of translation, degrees.
    pub direction_sigma_deg: f64,
    /// Median of `idepth_sigma / idepth`.
    pub relative_idepth_sigma: f64,
    /// Robust standard deviation of the distances from the epipolar lines, px.
    pub residual_px: f64,
    /// Robust cost (chi squared, truncated) per match, for comparison with alternatives.
    pub cost_per_match: f64,
    /// Score of the homography over the sum of both, R_H of `[ORB15]`: above 0.45 the points may
    /// lie on a plane.
    pub homography_share: f64,
}

/// What two views tell.
#[derive(Clone, Debug)]
pub enum TwoViewOutcome {
    /// One motion explains the matches, and clearly better than any other.
    Accepted(Box<TwoView>),
    /// Several motions explain the matches about equally well, best first: usually the two of a
    /// plane. A third view decides.
    Ambiguous {
        /// At least two motions.
        candidates: Vec<TwoView>,
    },
    /// The matches are explained by a rotation, or nearly so.
    NotEnoughParallax {
        /// Median angle between rays, degrees; zero when a rotation explains the matches.
        parallax_deg: f64,
        /// Median distance from the best rotation without translation, px.
        rotation_residual_px: f64,
    },
    /// There is parallax, yet the motion is not determined well enough.
    Uncertain {
        /// Standard deviation of the direction of translation, degrees.
        direction_sigma_deg: f64,
        /// Median relative standard deviation of the inverse depths.
        relative_idepth_sigma: f64,
    },
    /// Too few matches to try.
    TooFewMatches {
        /// Matches with finite pixels.
        found: usize,
        /// Matches needed.
        needed: usize,
    },
    /// No motion explains enough matches.
    NoMotion {
        /// Share of the matches that the best explains.
        inlier_ratio: f64,
    },
}
