//! Settings of the depth filter.

use serde::{Deserialize, Serialize};

/// Which gradient decides that a pixel can have a depth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GradientSelection {
    /// The pixel's own gradient: no hypotheses beside an edge that belong to the edge.
    Own,
    /// The largest gradient in its 3x3 neighbourhood (LSD-SLAM).
    Dilated,
}

/// Which of several stereo frames a pixel is compared with.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FrameChoice {
    /// The first frame of the list that sees the pixel, whatever is gained (LSD-SLAM).
    First,
    /// The frame with the smallest predicted variance; none when nothing would be gained.
    Predicted,
}

/// How the variance of one observation is computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum VarianceModel {
    /// LSD-SLAM's constants: `alpha² (0.05 + (0.25 (1 + residual))² |g|²/(g·l)² + 4 sigma_I²/G)`.
    Lsd,
    /// Pose uncertainty, noise estimated from the residuals, the part shared by all observations of a
    /// pixel kept apart as a floor.
    Honest,
}

/// Settings of the depth filter; [`DepthConfig::default`] is the best known,
/// [`DepthConfig::thesis`] follows LSD-SLAM.
///
/// Inverse depths are in 1/u with a mean of about 1 in each keyframe.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DepthConfig {
    /// Which gradient is compared with `min_gradient`.
    pub selection: GradientSelection,
    /// Smallest gradient of a pixel with depth, grey levels per px. Range [1, 100].
    pub min_gradient: f32,
    /// Smallest component of the gradient along the epipolar line, grey levels per px. Range [0, 100].
    pub min_line_gradient: f32,
    /// Smallest cosine of the angle between gradient and epipolar line. Range [0, 1).
    pub min_line_cosine: f32,
    /// Which stereo frame is used per pixel.
    pub frame_choice: FrameChoice,
    /// An observation is fused only when its predicted variance is below this multiple of the present
    /// one; keeps correlated observations from being counted as new. Range (0, 100].
    pub max_gain_ratio: f32,
    /// Validity from which a pixel is observed only for gain; younger ones are confirmed with any
    /// baseline. Range [0, 255].
    pub mature_validity: u8,
    /// A mature pixel is checked (not fused) every this many frames; 0 = never. Range [0, 255].
    pub verify_interval: u32,
    /// Half width of the search interval, standard deviations of the prior. Range [1, 5].
    pub search_sigmas: f32,
    /// Longest search along the epipolar line for an existing hypothesis, px. Range [3, 240].
    pub max_update_search_px: f32,
    /// Longest search along the epipolar line for a new hypothesis, px. Range [3, 240].
    pub max_create_search_px: f32,
    /// Whether a longer segment is cut to its far end (LSD-SLAM) instead of being left to a frame
    /// with a shorter baseline.
    pub crop_to_far_end: bool,
    /// Largest inverse depth searched, 1/u. Range (0, 1000].
    pub max_idepth: f32,
    /// New pixels are searched up to this multiple of the 98th percentile of the known inverse depths.
    /// Range [1, 1000].
    pub near_search_factor: f32,
    /// Range of `z_frame / z_keyframe` in which patches are compared, as the largest ratio of either.
    /// Range [1.01, 1.8].
    pub max_scale_change: f32,
    /// Sensor noise, grey levels; where the noise is estimated it is the start value. Range [0.1, 50].
    pub sensor_sigma: f32,
    /// Largest accepted root mean square difference of the patches, multiples of
    /// `sqrt(2) sensor_sigma`. Range [1, 20].
    pub max_residual_sigmas: f32,
    /// Share of the patch's own gradient that is added to the accepted difference. Range [0, 1].
    pub residual_gradient_share: f32,
    /// A match is ambiguous when a minimum elsewhere costs less than this multiple. Range [1, 10].
    pub ambiguity_ratio: f32,
    /// Whether the mean difference of the patches is removed (for local changes of light).
    pub remove_mean: bool,
    /// Variance of one observation.
    pub variance: VarianceModel,
    /// Factor on the photometric variance for the correlation of interpolated samples. Range [0.1, 10].
    pub photometric_factor: f32,
    /// Standard deviation of the match that no number of observations reduces, px. Range [0, 1].
    pub floor_px: f32,
    /// Uncertainty of the epipolar line besides that of the pose (calibration, shutter), px. Range [0, 5].
    pub line_sigma_px: f32,
    /// Relative change of inverse depth per px that an unknown surface has; turns distance between a
    /// pixel and the texture that was matched into variance. Range [0, 0.2].
    pub slope_per_px: f32,
    /// Observation and prior farther apart than this many standard deviations contradict each other.
    /// Range (0, 10].
    pub max_disagreement_sigma: f32,
    /// Variance of an existing hypothesis is multiplied by this before each update. Range [1, 2].
    pub success_inflation: f32,
    /// Variance is multiplied by this at each failed match. Range [1, 2].
    pub failure_inflation: f32,
    /// Hypotheses with a larger variance are dropped, 1/u². Range (0, 10].
    pub max_var: f32,
    /// Validity of a hypothesis created by a search. Range [0, 255].
    pub validity_created: u8,
    /// Validity gained by a successful observation. Range [0, 255].
    pub validity_gain: u8,
    /// Validity lost by a failed or contradicting one. Range [0, 255].
    pub validity_loss: u8,
    /// Largest validity of a pixel without gradient; LSD-SLAM adds `validity_per_gradient`. Range [1, 255].
    pub validity_max: u8,
    /// Added to the largest validity per grey level of gradient. Range [0, 10].
    pub validity_per_gradient: f32,
    /// Whether a pixel that failed is tried again only after 2, 4, 8 … 32 frames (8 when it has a
    /// hypothesis): it needs another baseline, and long searches are what costs time.
    pub backoff: bool,
    /// Sum of the validities in 5x5 below which a pixel is dropped. Range [0, 6375].
    pub min_support_keep: u16,
    /// Share of the validities in 5x5 that must agree with a pixel for it to be kept. Range [0, 1].
    pub min_support_share: f32,
    /// Sum of the validities in 5x5 above which a hole is filled. Range [0, 6375].
    pub min_support_fill: u16,
    /// Variance of filled pixels at least, relative to the squared inverse depth. Range [0, 10].
    pub fill_relative_var: f32,
    /// Relative change of inverse depth per px that smoothing assumes. Range (0, 1].
    pub smoothing_per_px: f32,
    /// Largest factor by which neighbours reduce the smoothed variance. Range [1, 25].
    pub max_smoothing_gain: f32,
    /// Variance factor of propagation to the next keyframe. Range [1, 10].
    pub propagation_inflation: f32,
    /// Relative standard deviation of inverse depth added by propagation. Range [0, 1].
    pub propagation_relative_sigma: f32,
    /// Share of the support at a pixel that the nearer of two surfaces needs to hide the other;
    /// 0 = the nearer always wins (LSD-SLAM). Range [0, 1].
    pub occlusion_support: f32,
    /// Whether propagation interpolates to the pixel centres; false = to the nearest pixel (LSD-SLAM).
    pub propagate_subpixel: bool,
}

impl Default for DepthConfig {
    fn default() -> Self {
        Self {
            selection: GradientSelection::Own,
            min_gradient: 4.0,
            min_line_gradient: 1.0,
            min_line_cosine: 0.15,
            frame_choice: FrameChoice::Predicted,
            max_gain_ratio: 0.8,
            mature_validity: 20,
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
            residual_gradient_share: 0.2,
            ambiguity_ratio: 1.5,
            remove_mean: false,
            variance: VarianceModel::Honest,
            photometric_factor: 1.8,
            floor_px: 0.05,
            line_sigma_px: 0.05,
            slope_per_px: 0.003,
            max_disagreement_sigma: 3.0,
            success_inflation: 1.0,
            failure_inflation: 1.1,
            max_var: 0.25,
            validity_created: 5,
            validity_gain: 5,
            validity_loss: 5,
            validity_max: 60,
            validity_per_gradient: 0.0,
            backoff: true,
            min_support_keep: 24,
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
    /// LSD-SLAM's rules and constants without the listed defects (no interpolation at interval ends,
    /// ambiguity by non-adjacent minima, no wrap-around at the border).
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

    /// Checks every range documented on the fields.
    ///
    /// # Errors
    /// The first field found outside its range.
    #[rustfmt::skip]
    pub fn validate(&self) -> Result<(), ConfigError> {
        let limits: [(&'static str, f32, f32, f32); 34] = [
            ("min_gradient", self.min_gradient, 1.0, 100.0),
            ("min_line_gradient", self.min_line_gradient, 0.0, 100.0),
            ("min_line_cosine", self.min_line_cosine, 0.0, 0.999),
            ("max_gain_ratio", self.max_gain_ratio, 1e-3, 100.0),
            ("search_sigmas", self.search_sigmas, 1.0, 5.0),
            ("max_update_search_px", self.max_update_search_px, 3.0, 240.0),
            ("max_create_search_px", self.max_create_search_px, 3.0, 240.0),
            ("max_idepth", self.max_idepth, 1e-3, 1000.0),
            ("max_scale_change", self.max_scale_change, 1.01, 1.8),
            ("sensor_sigma", self.sensor_sigma, 0.1, 50.0),
            ("max_residual_sigmas", self.max_residual_sigmas, 1.0, 20.0),
            ("residual_gradient_share", self.residual_gradient_share, 0.0, 1.0),
            ("ambiguity_ratio", self.ambiguity_ratio, 1.0, 10.0),
            ("photometric_factor", self.photometric_factor, 0.1, 10.0),
            ("floor_px", self.floor_px, 0.0, 1.0),
            ("line_sigma_px", self.line_sigma_px, 0.0, 5.0),
            ("slope_per_px", self.slope_per_px, 0.0, 0.2),
            ("max_disagreement_sigma", self.max_disagreement_sigma, 1e-3, 10.0),
            ("success_inflation", self.success_inflation, 1.0, 2.0),
            ("failure_inflation", self.failure_inflation, 1.0, 2.0),
            ("max_var", self.max_var, 1e-6, 10.0),
            ("smoothing_per_px", self.smoothing_per_px, 1e-6, 1.0),
            ("max_smoothing_gain", self.max_smoothing_gain, 1.0, 25.0),
            ("occlusion_support", self.occlusion_support, 0.0, 1.0),
            ("verify_interval", self.verify_interval as f32, 0.0, 255.0),
            ("min_support_keep", f32::from(self.min_support_keep), 0.0, 6375.0),
            ("min_support_fill", f32::from(self.min_support_fill), 0.0, 6375.0),
            ("min_support_share", self.min_support_share, 0.0, 1.0),
            ("near_search_factor", self.near_search_factor, 1.0, 1000.0),
            ("validity_per_gradient", self.validity_per_gradient, 0.0, 10.0),
            ("fill_relative_var", self.fill_relative_var, 0.0, 10.0),
            ("propagation_inflation", self.propagation_inflation, 1.0, 10.0),
            ("propagation_relative_sigma", self.propagation_relative_sigma, 0.0, 1.0),
            ("validity_max", f32::from(self.validity_max), 1.0, 255.0),
        ];
        // as they are written: 0.1 in single precision is 0.1
        let written = |v: f32| v.to_string().parse().unwrap_or(f64::NAN);
        let limits = limits.map(|(name, value, min, max)| {
            let [value, min, max] = [value, min, max].map(written);
            Limit(name, value, min, max)
        });
        first_outside(limits)
    }
}

/// A setting outside its documented range.
#[derive(Debug, thiserror::Error, Clone, PartialEq)]
#[error("{name} is {value}, allowed {min} to {max}")]
pub struct ConfigError {
    /// The field.
    pub name: &'static str,
    /// The rejected value.
    pub value: f64,
    /// Smallest allowed.
    pub min: f64,
    /// Largest allowed.
    pub max: f64,
}

/// A setting and its smallest and largest allowed value.
pub(crate) struct Limit(pub &'static str, pub f64, pub f64, pub f64);

/// The first setting outside its range.
pub(crate) fn first_outside(limits: impl IntoIterator<Item = Limit>) -> Result<(), ConfigError> {
    let mut limits = limits.into_iter();
    // NaN is in no range
    let outside = limits.find(|Limit(_, value, min, max)| !(min..=max).contains(&value));
    outside.map_or(Ok(()), |Limit(name, value, min, max)| {
        Err(ConfigError {
            name,
            value,
            min,
            max,
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_profiles_are_valid_and_survive_a_file() {
        for config in [DepthConfig::default(), DepthConfig::thesis()] {
            assert_eq!(config.validate(), Ok(()));
            let text = toml::to_string(&config).expect("writes");
            assert_eq!(toml::from_str::<DepthConfig>(&text).expect("reads"), config);
        }
        assert_ne!(DepthConfig::default(), DepthConfig::thesis());
    }

    #[test]
    fn unknown_keys_and_values_out_of_range_are_refused() {
        assert!(toml::from_str::<DepthConfig>("min_gradiant = 5.0").is_err());
        let config: DepthConfig = toml::from_str("search_sigmas = 9.0").expect("a known key");
        let error = config.validate().expect_err("beyond 5");
        assert_eq!(error.to_string(), "search_sigmas is 9, allowed 1 to 5");
        let nan = DepthConfig {
            max_var: f32::NAN,
            ..DepthConfig::default()
        };
        assert!(nan.validate().is_err());
    }
}
