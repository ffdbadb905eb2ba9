//! Settings of the depth filter.

/// Which gradient decides that a pixel can have a depth.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GradientSelection {
    /// The pixel's own gradient: no hypotheses beside an edge that belong to the edge.
    Own,
    /// The largest gradient in its 3x3 neighbourhood (LSD-SLAM).
    Dilated,
}

/// Which of several stereo frames a pixel is compared with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameChoice {
    /// The first frame of the list that sees the pixel, whatever is gained (LSD-SLAM).
    First,
    /// The frame with the smallest predicted variance; none when nothing would be gained.
    Predicted,
}

/// How the variance of one observation is computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VarianceModel {
    /// LSD-SLAM's constants: `alpha² (0.05 + (0.25 (1 + residual))² |g|²/(g·l)² + 4 sigma_I²/G)`.
    Lsd,
    /// Pose uncertainty, noise estimated from the residuals, the part shared by all observations of
    /// a pixel kept apart as a floor.
    Honest,
}

/// Settings of the depth filter; [`DepthConfig::default`] is the best known,
/// [`DepthConfig::thesis`] follows LSD-SLAM.
///
/// Inverse depths are in 1/u with a mean of about 1 in each keyframe.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthConfig {
    /// Which gradient is compared with `min_gradient`.
    pub selection: GradientSelection,
    /// Smallest gradient of a pixel with depth, grey levels per px.
    pub min_gradient: f32,
    /// Which stereo frame is used per pixel.
    pub frame_choice: FrameChoice,
    /// An observation is fused only when its predicted variance is below this multiple of the
    /// present one; keeps correlated observations from being counted as new.
    pub max_gain_ratio: f32,
    /// A mature pixel is checked (not fused) every this many frames; 0 = never.
    pub verify_interval: u32,
    /// Half width of the search interval, standard deviations of the prior.
    pub search_sigmas: f32,
    /// Longest search along the epipolar line for an existing hypothesis, px.
    pub max_update_search_px: f32,
    /// Longest search along the epipolar line for a new hypothesis, px.
    pub max_create_search_px: f32,
    /// Whether a longer segment is cut to its far end (LSD-SLAM) instead of being left to a frame
    /// with a shorter baseline.
    pub crop_to_far_end: bool,
    /// Largest inverse depth searched, 1/u.
    pub max_idepth: f32,
    /// New pixels are searched up to this multiple of the 98th percentile of the known inverse
    /// depths.
    pub near_search_factor: f32,
    /// Range of `z_frame / z_keyframe` in which patches are compared, as the largest ratio of
    /// either.
    pub max_scale_change: f32,
    /// Sensor noise, grey levels; where the noise is estimated it is the start value.
    pub sensor_sigma: f32,
    /// Largest accepted root mean square difference of the patches, multiples of `sqrt(2)
    /// sensor_sigma`.
    pub max_residual_sigmas: f32,
    /// Variance of one observation.
    pub variance: VarianceModel,
    /// Factor on the photometric variance for the correlation of interpolated samples.
    pub photometric_factor: f32,
    /// Standard deviation of the match that no number of observations reduces, px.
    pub floor_px: f32,
    /// Uncertainty of the epipolar line besides that of the pose (calibration, shutter), px.
    pub line_sigma_px: f32,
    /// Relative change of inverse depth per px that an unknown surface has; turns distance between
    /// a pixel and the texture that was matched into variance.
    pub slope_per_px: f32,
    /// Observation and prior farther apart than this many standard deviations contradict each
    /// other.
    pub max_disagreement_sigma: f32,
    /// Variance of an existing hypothesis is multiplied by this before each update.
    pub success_inflation: f32,
    /// Largest validity of a pixel without gradient; LSD-SLAM adds `validity_per_gradient`.
    pub validity_max: u8,
    /// Added to the largest validity per grey level of gradient.
    pub validity_per_gradient: f32,
    /// Whether a pixel that failed is tried again only after 2, 4, 8 … 32 frames (8 when it has a
    /// hypothesis): it needs another baseline, and long searches are what costs time.
    pub backoff: bool,
    /// Share of the validities in 5x5 that must agree with a pixel for it to be kept.
    pub min_support_share: f32,
    /// Sum of the validities in 5x5 above which a hole is filled.
    pub min_support_fill: u16,
    /// Variance of filled pixels at least, relative to the squared inverse depth.
    pub fill_relative_var: f32,
    /// Relative change of inverse depth per px that smoothing assumes.
    pub smoothing_per_px: f32,
    /// Largest factor by which neighbours reduce the smoothed variance.
    pub max_smoothing_gain: f32,
    /// Variance factor of propagation to the next keyframe.
    pub propagation_inflation: f32,
    /// Relative standard deviation of inverse depth added by propagation.
    pub propagation_relative_sigma: f32,
    /// Share of the support at a pixel that the nearer of two surfaces needs to hide the other; 0 =
    /// the nearer always wins (LSD-SLAM).
    pub occlusion_support: f32,
    /// Whether propagation interpolates to the pixel centres; false = to the nearest pixel
    /// (LSD-SLAM).
    pub propagate_subpixel: bool,
}

impl Default for DepthConfig {
    fn default() -> Self {
        Self {
            selection: GradientSelection::Own,
            min_gradient: 4.0,
            frame_choice: FrameChoice::Predicted,
            max_gain_ratio: 0.8,
            verify_interval: 8,
            search_sigmas: 2.5,
            max_update_search_px: 60.0,
            max_create_search_px: 200.0,
            crop_to_far_end: false,
            max_idepth: 10.0,
            near_search_factor: 2.5,
            max_scale_change: 1.6,
            sensor_sigma: 4.0,
            max_residual_sigmas: 3.0,
            variance: VarianceModel::Honest,
            photometric_factor: 1.8,
            floor_px: 0.05,
            line_sigma_px: 0.05,
            slope_per_px: 0.003,
            max_disagreement_sigma: 3.0,
            success_inflation: 1.0,
            validity_max: 60,
            validity_per_gradient: 0.0,
            backoff: true,
            min_support_share: 0.4,
            min_support_fill: 30,
            fill_relative_var: 0.0025,
            smoothing_per_px: 0.01,
            max_smoothing_gain: 3.0,
            propagation_inflation: 1.05,
            propagation_relative_sigma: 0.002,
            occlusion_support: 0.35,
            propagate_subpixel: true,
        }
    }
}

impl DepthConfig {
    /// LSD-SLAM's rules and constants without the listed defects (no interpolation at interval
    /// ends, ambiguity by non-adjacent minima, no wrap-around at the border).
    #[must_use]
    pub fn thesis() -> Self {
        Self {
            selection: GradientSelection::Dilated,
            min_gradient: 5.0,
            frame_choice: FrameChoice::First,
            max_gain_ratio: 100.0,
            verify_interval: 0,
            search_sigmas: 2.0,
            max_update_search_px: 30.0,
            max_create_search_px: 30.0,
            crop_to_far_end: true,
            max_idepth: 20.0,
            near_search_factor: 1000.0,
            max_scale_change: 1.4,
            max_residual_sigmas: 2.85,
            variance: VarianceModel::Lsd,
            photometric_factor: 1.0,
            floor_px: 0.0,
            line_sigma_px: 0.0,
            slope_per_px: 0.0,
            max_disagreement_sigma: 1.0,
            success_inflation: 1.01,
            validity_max: 5,
            min_support_share: 0.0,
            backoff: false,
            validity_per_gradient: 250.0 / 255.0,
            fill_relative_var: 0.125,
            smoothing_per_px: 0.075,
            max_smoothing_gain: 25.0,
            propagation_inflation: 1.0,
            propagation_relative_sigma: 0.0,
            occlusion_support: 0.0,
            propagate_subpixel: false,
            ..Self::default()
        }
    }
}
