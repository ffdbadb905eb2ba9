//! Uncertainty of a match along the epipolar line, px².

use crate::config::{DepthConfig, VarianceModel};
use crate::line_match::PATCH;

/// Degrees of freedom that the frame's noise estimate counts for beside the patch's own residual.
const PRIOR_FREEDOM: f32 = 6.0;

/// Variance of a match, px² along the line of the frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct MatchVariance {
    /// All of it.
    pub(crate) total: f32,
    /// The part common to all observations of this keyframe pixel: noise of its own patch, texture
    /// beside the pixel.
    pub(crate) shared: f32,
    /// Photometric part.
    pub(crate) photometric: f32,
}

/// How a frame's pose is uncertain, in px of displacement at the match.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LineUncertainty {
    /// Constant part, px².
    pub(crate) constant_sq: f32,
    /// Part that grows with inverse depth, px per (1/u).
    pub(crate) per_idepth: f32,
    /// Root mean square photometric residual of the tracker, grey levels (used by LSD's rule).
    pub(crate) residual_rms: f32,
}

impl LineUncertainty {
    /// Geometric variance along the line: a displacement `e` of the line moves the match by
    /// `<g, e> / <g, l>`, `[SDVO13]` equation 8.
    #[inline]
    pub(crate) fn geometric(&self, idepth: f32, inv_cos_sq: f32, model: VarianceModel) -> f32 {
        match model {
            VarianceModel::Lsd => {
                let sigma = 0.25 * (1.0 + self.residual_rms);
                sigma * sigma * inv_cos_sq
            }
            VarianceModel::Honest => {
                let translation = self.per_idepth * idepth;
                (self.constant_sq + translation * translation) * inv_cos_sq
            }
        }
    }
}

/// Puts the parts together: of the sum of squared slopes of the patch, (grey levels per px)²; the
/// sum of squared differences at the match and the expected variance of one, grey levels²; the
/// geometric variance, px²; and how far the depth of the matched texture may be from the pixel's,
/// px along the line.
#[inline]
pub(crate) fn match_variance(
    information: f32,
    (ssd, noise_var): (f32, f32),
    geometric: f32,
    slope_px: f32,
    config: &DepthConfig,
) -> MatchVariance {
    let information = information.max(1e-3);
    match config.variance {
        VarianceModel::Lsd => {
            let photometric = 4.0 * config.sensor_sigma * config.sensor_sigma / information;
            MatchVariance {
                total: 0.05 + geometric + photometric,
                shared: 0.0,
                photometric,
            }
        }
        VarianceModel::Honest => {
            let freedom = (PATCH - 1) as f32;
            let noise_var = (PRIOR_FREEDOM * noise_var + ssd) / (PRIOR_FREEDOM + freedom);
            let photometric = config.photometric_factor * noise_var / information;
            let slope = slope_px * slope_px;
            let floor = config.floor_px * config.floor_px;
            MatchVariance {
                total: photometric + geometric + slope + floor,
                shared: 0.5 * photometric + slope + floor,
                photometric,
            }
        }
    }
}
