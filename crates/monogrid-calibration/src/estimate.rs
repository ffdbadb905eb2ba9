//! What all windows of a video say about its camera.

use crate::adjust::{AdjustConfig, Adjusted, Scene, adjust};
use crate::intrinsics::{Intrinsics, ParameterMatrix, Parameters, Prior, READOUT};
use crate::reconstruct::reconstruct;
use crate::tracks::Window;

/// Settings of [`estimate_intrinsics`].
#[derive(Clone, Debug, PartialEq)]
pub struct EstimateConfig {
    /// Fields of view along the longer side that are tried, degrees. Range 10..150; default
    /// 45, 62, 85.
    pub guesses_deg: Vec<f64>,
    /// Bundle adjustment.
    pub adjust: AdjustConfig,
    /// Windows whose corners fit worse than this (root of the mean squared error) are not used, px.
    /// Default 1.5.
    pub max_rms_px: f64,
    /// By how much errors that the windows share (rolling shutter, corners that drift together)
    /// make the statistical standard deviations too small. Range 1..; default 3.
    pub inflation: f64,
    /// Relative standard deviation of the focal length up to which it counts as determined.
    /// Default 0.05.
    pub max_relative_sigma: f64,
    /// Seed of all sampling.
    pub seed: u64,
}

impl Default for EstimateConfig {
    fn default() -> Self {
        Self {
            guesses_deg: vec![45.0, 62.0, 85.0],
            adjust: AdjustConfig::default(),
            max_rms_px: 1.5,
            inflation: 3.0,
            max_relative_sigma: 0.05,
            seed: 0,
        }
    }
}

/// A camera as the video shows it.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// Most probable camera, for images of [`size`](Self::size).
    pub intrinsics: Intrinsics,
    /// Width and height of the images, px.
    pub size: (usize, usize),
    /// Standard deviations of `[ln f, k1, k2, cx, cy, readout]`: the first is relative, those of
    /// `cx` and `cy` in px.
    pub sigma: Parameters,
    /// Windows of the video that could be used.
    pub num_windows: usize,
    /// Windows that were given.
    pub num_given: usize,
    /// Root of the mean squared error of the corners that fit, px.
    pub rms_px: f64,
    /// Focal length in px and its relative standard deviation as each window that could be used
    /// says alone.
    pub each_focal: Vec<(f64, f64)>,
    max_relative_sigma: f64,
}

impl Estimate {
    /// Whether the motion determines the focal length; otherwise it is the prior's.
    #[must_use]
    pub fn is_determined(&self) -> bool {
        self.num_windows > 0 && self.sigma[0] <= self.max_relative_sigma
    }

    /// Time from the first row to the last in shares of the time from frame to frame, and its
    /// standard deviation; none where the motion does not show that it takes any, or where it would
    /// be longer than a frame.
    #[must_use]
    pub fn readout(&self) -> Option<(f64, f64)> {
        let (readout, sigma) = (self.intrinsics.readout, self.sigma[READOUT]);
        let is_shown = readout.abs() > MIN_READOUT.max(READOUT_SIGMAS * sigma);
        (self.num_windows > 0 && is_shown && readout.abs() < 1.1).then_some((readout, sigma))
    }

    /// The interval that holds the focal length with 95 % probability, px.
    #[must_use]
    pub fn focal_interval_px(&self) -> (f64, f64) {
        let factor = (1.96 * self.sigma[0]).exp();
        (
            self.intrinsics.focal / factor,
            self.intrinsics.focal * factor,
        )
    }

    /// The same for images enlarged by `factor` to `size`.
    #[must_use]
    pub fn scaled(&self, factor: f64, size: (usize, usize)) -> Self {
        let px = |sigma: f64| sigma * factor;
        let [log_focal, k1, k2, cx, cy, readout] = self.sigma.into();
        Self {
            intrinsics: self.intrinsics.scaled(factor),
            size,
            sigma: Parameters::from([log_focal, k1, k2, px(cx), px(cy), readout]),
            rms_px: self.rms_px * factor,
            each_focal: (self.each_focal.iter())
                .map(|(focal, sigma)| (px(*focal), *sigma))
                .collect(),
            ..self.clone()
        }
    }
}

/// Relative error of the focal length below which nothing is claimed: square pixels, two terms of
/// distortion, and corners that keep their place while they are seen from elsewhere hold only about
/// that well (maps of four sequences were 0.3, 0.8, 1.3 and 2.6 % off, with smaller statistical
/// errors).
const SIGMA_FLOOR: f64 = 0.013;

/// Standard deviations by which a readout must differ from none, and the least that matters, in
/// shares of the time from frame to frame.
const READOUT_SIGMAS: f64 = 3.0;
const MIN_READOUT: f64 = 0.1;

/// What a window says.
struct Opinion {
    parameters: Parameters,
    information: ParameterMatrix,
    squared_error_px: f64,
    count: usize,
}

/// Estimates the camera of a video from its windows, which have images of one size.
///
/// With no usable window the result is the prior. Some 0.3 s per window and guess.
#[must_use]
pub fn estimate_intrinsics(
    windows: &[Window],
    size: (usize, usize),
    prior: &Prior,
    config: &EstimateConfig,
) -> Estimate {
    let opinions: Vec<Opinion> = windows
        .iter()
        .filter_map(|window| opinion(window, prior, config))
        .collect();
    let rolling = conclude(&opinions, windows.len(), size, prior, config);
    if rolling.readout().is_some() {
        return rolling;
    }
    let global = prior.with_global_shutter();
    conclude(&opinions, windows.len(), size, &global, config)
}

/// Estimates the camera of scenes that are known but for it, as a map holds them: each is adjusted
/// once from where it is, and asked for when its turn comes. The scenes have images of one size.
///
/// With no usable scene the result is the prior. Some 5 ms per scene of twenty views.
#[must_use]
pub fn refine_intrinsics(
    scenes: impl IntoIterator<Item = Scene>,
    size: (usize, usize),
    prior: &Prior,
    config: &EstimateConfig,
) -> Estimate {
    let mut num_given = 0;
    let opinions: Vec<Opinion> = scenes
        .into_iter()
        .inspect(|_| num_given += 1)
        .filter_map(|scene| Opinion::of(&adjust(scene, prior, &config.adjust), config))
        .collect();
    conclude(&opinions, num_given, size, prior, config)
}

/// What the opinions come to.
fn conclude(
    opinions: &[Opinion],
    num_given: usize,
    size: (usize, usize),
    prior: &Prior,
    config: &EstimateConfig,
) -> Estimate {
    let (parameters, covariance) = fuse(opinions, prior, config);
    let count: usize = opinions.iter().map(|o| o.count).sum();
    let squared: f64 = opinions.iter().map(|o| o.squared_error_px).sum();
    let mut sigma = covariance.diagonal().map(|v| v.max(0.0).sqrt());
    sigma[0] = sigma[0].hypot(SIGMA_FLOOR);
    Estimate {
        intrinsics: Intrinsics::from_parameters(&parameters),
        size,
        sigma,
        num_windows: opinions.len(),
        num_given,
        rms_px: (squared / count.max(1) as f64).sqrt(),
        each_focal: opinions
            .iter()
            .map(|opinion| {
                let alone = std::slice::from_ref(opinion);
                let (parameters, covariance) = fuse(alone, prior, config);
                (parameters[0].exp(), covariance[(0, 0)].max(0.0).sqrt())
            })
            .collect(),
        max_relative_sigma: config.max_relative_sigma,
    }
}

/// Squared error, standard deviations, beyond which a corner does not belong to the scene.
const INLIER_CHI2: f64 = 25.0;

/// The camera that explains a window best, over all guesses.
fn opinion(window: &Window, prior: &Prior, config: &EstimateConfig) -> Option<Opinion> {
    let mut best: Option<(f64, Adjusted)> = None;
    for &fov_deg in &config.guesses_deg {
        let guess = Intrinsics::from_parameters(&Prior::ordinary(fov_deg, window.size).mean);
        let guess = Intrinsics {
            centre: Intrinsics::from_parameters(&prior.mean).centre,
            ..guess
        };
        let Some(scene) = reconstruct(window, &guess, config.seed) else {
            continue;
        };
        let first = adjust(scene, prior, &config.adjust);
        // once more with the camera found: what a wrong guess had bent away comes back
        let Some(scene) = reconstruct(window, &first.scene.intrinsics, config.seed) else {
            continue;
        };
        let adjusted = adjust(scene, prior, &config.adjust);
        let score = |chi2: &f64| (INLIER_CHI2 - chi2).max(0.0);
        let score: f64 = adjusted.chi2.iter().map(score).sum();
        if best.as_ref().is_none_or(|(most, _)| score > *most) {
            best = Some((score, adjusted));
        }
    }
    let (_, adjusted) = best?;
    Opinion::of(&adjusted, config)
}

impl Opinion {
    /// What an adjusted scene says; `None` where too little of it fits.
    fn of(adjusted: &Adjusted, config: &EstimateConfig) -> Option<Self> {
        let inliers = adjusted.chi2.iter().filter(|&&c| c < INLIER_CHI2);
        let (count, sum) = inliers.fold((0, 0.0), |(n, sum), c| (n + 1, sum + c));
        let squared_error_px = sum * config.adjust.sigma_px * config.adjust.sigma_px;
        let rms_px = (squared_error_px / f64::from(count.max(1))).sqrt();
        let is_usable = rms_px <= config.max_rms_px && 2 * count as usize >= adjusted.chi2.len();
        is_usable.then_some(Self {
            parameters: adjusted.scene.intrinsics.parameters(),
            information: adjusted.information,
            squared_error_px,
            count: count as usize,
        })
    }
}

/// Rounds of the weighting by agreement.
const FUSE_ROUNDS: usize = 10;

/// Mean of the opinions weighted by their information; opinions that contradict the others in many
/// standard deviations lose weight (Cauchy), and disagreement widens the covariance (Birge ratio).
fn fuse(
    opinions: &[Opinion],
    prior: &Prior,
    config: &EstimateConfig,
) -> (Parameters, ParameterMatrix) {
    let shrink = 1.0 / (config.inflation * config.inflation);
    let mut weights = vec![1.0; opinions.len()];
    let mut mean = prior.mean;
    let mut covariance = ParameterMatrix::from_diagonal(&prior.sigma.map(|s| s * s));
    for _ in 0..FUSE_ROUNDS {
        let mut information = prior.information();
        let mut right = information * prior.mean;
        for (opinion, weight) in opinions.iter().zip(&weights) {
            let weighted = opinion.information * (shrink * weight);
            information += weighted;
            right += weighted * opinion.parameters;
        }
        let Some(inverse) = information.try_inverse() else {
            break;
        };
        (mean, covariance) = (inverse * right, inverse);
        for (opinion, weight) in opinions.iter().zip(&mut weights) {
            *weight = 1.0 / (1.0 + disagreement(opinion, &mean, shrink));
        }
    }
    let disagreements = opinions
        .iter()
        .zip(&weights)
        .map(|(opinion, weight)| weight * disagreement(opinion, &mean, shrink));
    let birge = disagreements.sum::<f64>() / weights.iter().sum::<f64>().max(1.0);
    (mean, covariance * birge.max(1.0))
}

/// Squared distance of an opinion from the mean, per parameter, in its own standard deviations.
fn disagreement(opinion: &Opinion, mean: &Parameters, shrink: f64) -> f64 {
    let offset = opinion.parameters - mean;
    let squared = (opinion.information * offset).dot(&offset) * shrink;
    squared.max(0.0) / offset.len() as f64
}
