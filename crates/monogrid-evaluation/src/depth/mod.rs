//! Semi-dense inverse depth and its variance against true depth.
//!
//! Flow: [`DepthEvaluator::add_keyframe`] for every keyframe, then [`DepthEvaluator::finish`]. One
//! scale, the median ratio of true to estimated depth over all keyframes, is applied before
//! anything is compared: a single camera does not see it. Images may be dropped after they were
//! added.

mod error;

pub use error::DepthError;

use crate::statistics::{median, median_of_many, robust_deviation_of_many};
use monogrid_image::DepthPixel;
use serde::Serialize;

/// One keyframe with its truth; images are row-major, `width * height` long.
#[derive(Clone, Copy, Debug)]
pub struct KeyframeDepth<'a> {
    /// Name in the report, usually the number of the keyframe.
    pub id: u64,
    /// Columns of the images.
    pub width: usize,
    /// Rows of the images.
    pub height: usize,
    /// What was estimated, at most once per pixel.
    pub estimates: &'a [DepthPixel],
    /// Length of the keyframe's unit in world units (the scale of its Sim(3)).
    pub world_scale: f64,
    /// True depth along the optical axis; not finite or not positive where unknown.
    pub true_depth: &'a [f32],
    /// Length of the image gradient, grey levels (0 to 255) per pixel.
    pub gradient: &'a [f32],
}

/// Settings of the evaluation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthConfig {
    /// Pixels of at least this gradient should have a depth, grey levels per pixel. Default 5.
    pub min_gradient: f32,
    /// Scale from estimated to true lengths. Default: the median ratio over all estimates.
    pub scale: Option<f64>,
}

impl Default for DepthConfig {
    fn default() -> Self {
        Self {
            min_gradient: 5.0,
            scale: None,
        }
    }
}

/// (d - d_gt)/sigma of all estimates: a standard normal distribution when the variance is honest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct NormalisedError {
    /// Median; near 0 without bias.
    pub median: f64,
    /// Magnitude of the median.
    pub absolute_median: f64,
    /// 1.48 times the median absolute deviation; 1 when honest, above when over-confident.
    pub robust_deviation: f64,
    /// Share of estimates within 2 sigma; 0.954 when normal and honest.
    pub within_2_sigma: f64,
    /// Plain standard deviation, which outliers rule.
    pub std: f64,
}

/// Shares of the pixels that should have a depth, [0, 1].
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct DepthShares {
    /// Have a depth within 3 % of the truth.
    pub within_3_percent: f64,
    /// Have a depth within 10 % of the truth.
    pub within_10_percent: f64,
    /// Have a depth.
    pub density: f64,
}

/// What is known about one keyframe.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct KeyframeDepthReport {
    /// The keyframe.
    pub id: u64,
    /// Estimates with known truth.
    pub estimates: usize,
    /// Median ratio of true to estimated depth of this keyframe alone; `None` without estimates.
    pub scale: Option<f64>,
    /// That over the global scale: 1 when the keyframes agree.
    pub relative_scale: Option<f64>,
    /// With the global scale.
    pub shares: DepthShares,
    /// With the keyframe's own scale: what is lost by drift of the scale is gained back here.
    pub shares_own_scale: DepthShares,
}

/// Result of the depth evaluation.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DepthReport {
    /// Scale applied, true length per estimated length.
    pub scale: f64,
    /// Keyframes looked at.
    pub keyframes: usize,
    /// Estimates where the truth is known.
    pub estimates: usize,
    /// Pixels of enough gradient where the truth is known: all that should have a depth.
    pub gradient_pixels: usize,
    /// Shares of these pixels with the global scale.
    #[serde(flatten)]
    pub shares: DepthShares,
    /// The same shares when each keyframe has its own scale.
    pub shares_own_scale: DepthShares,
    /// Pixels where the truth is known, textured or not.
    pub known_pixels: usize,
    /// Shares of all of these with the global scale.
    pub shares_of_known: DepthShares,
    /// Shares of the estimates themselves within 3 % and 10 %, whatever their gradient.
    pub estimates_within_3_percent: f64,
    /// See above.
    pub estimates_within_10_percent: f64,
    /// Median of (depth - true depth)/true depth over estimates of positive inverse depth.
    pub bias: f64,
    /// Median of (d - d_gt)/d_gt, d the inverse depth.
    pub idepth_bias: f64,
    /// Root mean square of ln(depth / true depth), over estimates of positive inverse depth.
    pub rmse_log_depth: f64,
    /// Honesty of the variance.
    pub normalised_error: NormalisedError,
    /// Every keyframe, in the order added.
    pub per_keyframe: Vec<KeyframeDepthReport>,
}

/// One estimate beside its truth, both inverse depths in keyframe units but for the global scale.
#[derive(Clone, Copy, Debug)]
struct Comparison {
    idepth: f64,
    idepth_sigma: f64,
    /// True inverse depth when the global scale is 1.
    true_idepth: f64,
    has_gradient: bool,
}

impl Comparison {
    /// True over estimated depth.
    fn depth_ratio(&self) -> f64 {
        self.idepth / self.true_idepth
    }

    fn is_within(&self, ratio: f64, scale: f64) -> bool {
        self.idepth > 0.0 && (self.relative_depth(scale) - 1.0).abs() <= ratio
    }

    /// Scaled estimated depth over true depth.
    fn relative_depth(&self, scale: f64) -> f64 {
        scale * self.true_idepth / self.idepth
    }

    fn normalised(&self, scale: f64) -> f64 {
        (self.idepth - scale * self.true_idepth) / self.idepth_sigma
    }
}

/// A comparison as it is kept until all keyframes are there: a run has millions.
#[derive(Clone, Copy, Debug)]
struct Kept {
    idepth: f32,
    idepth_var: f32,
    /// In the unit of the truth; negative where there is no gradient.
    true_depth: f32,
}

#[derive(Clone, Debug)]
struct Keyframe {
    id: u64,
    known_pixels: usize,
    gradient_pixels: usize,
    world_scale: f64,
    kept: Vec<Kept>,
}

impl Keyframe {
    fn comparisons(&self) -> impl Iterator<Item = Comparison> {
        self.kept.iter().map(|kept| Comparison {
            idepth: f64::from(kept.idepth),
            idepth_sigma: f64::from(kept.idepth_var).sqrt(),
            true_idepth: self.world_scale / f64::from(kept.true_depth.abs()),
            has_gradient: kept.true_depth > 0.0,
        })
    }

    fn shares(&self, scale: f64) -> DepthShares {
        shares_of_textured(std::slice::from_ref(self), |_| scale)
    }

    fn own_scale(&self) -> Option<f64> {
        let ratios: Vec<f64> = self.comparisons().map(|c| c.depth_ratio()).collect();
        median(&ratios).filter(|scale| *scale > 0.0)
    }
}

/// Collects keyframes and compares their depth with the truth.
#[derive(Clone, Debug)]
pub struct DepthEvaluator {
    config: DepthConfig,
    keyframes: Vec<Keyframe>,
    num_estimates: usize,
}

impl DepthEvaluator {
    /// An evaluator without keyframes.
    #[must_use]
    pub fn new(config: DepthConfig) -> Self {
        Self {
            config,
            keyframes: Vec::new(),
            num_estimates: 0,
        }
    }

    /// Adds a keyframe.
    ///
    /// # Errors
    /// Images of another size, or an estimate outside the image, that is not finite or whose
    /// variance is not positive.
    pub fn add_keyframe(&mut self, keyframe: &KeyframeDepth) -> Result<(), DepthError> {
        check(keyframe)?;
        let has_gradient = |gradient: f32| gradient >= self.config.min_gradient;
        let pixels = keyframe.true_depth.iter().zip(keyframe.gradient);
        let gradient_pixels = pixels
            .filter(|(depth, gradient)| is_known(**depth) && has_gradient(**gradient))
            .count();
        let compare = |estimate: &DepthPixel| {
            let index = usize::from(estimate.y) * keyframe.width + usize::from(estimate.x);
            let true_depth = keyframe.true_depth[index];
            let is_textured = has_gradient(keyframe.gradient[index]);
            is_known(true_depth).then_some(Kept {
                idepth: estimate.idepth,
                idepth_var: estimate.idepth_var,
                true_depth: if is_textured { true_depth } else { -true_depth },
            })
        };
        self.num_estimates += keyframe.estimates.len();
        self.keyframes.push(Keyframe {
            id: keyframe.id,
            known_pixels: keyframe.true_depth.iter().filter(|d| is_known(**d)).count(),
            gradient_pixels,
            world_scale: keyframe.world_scale,
            kept: keyframe.estimates.iter().filter_map(compare).collect(),
        });
        Ok(())
    }

    /// The report over all keyframes added.
    ///
    /// # Errors
    /// When no estimate lies where the truth is known, or a scale that was set is not positive.
    pub fn finish(self) -> Result<DepthReport, DepthError> {
        let all = || self.keyframes.iter().flat_map(Keyframe::comparisons);
        let num_compared = self.keyframes.iter().map(|k| k.kept.len()).sum();
        let no_truth = || DepthError::NoTruth(self.num_estimates);
        let fitted = median_of_many(|| all().map(|c| c.depth_ratio())).ok_or_else(no_truth)?;
        let scale = self.config.scale.unwrap_or(fitted);
        if !(scale > 0.0 && scale.is_finite()) {
            return Err(DepthError::Scale { id: 0, scale });
        }
        let normalised =
            normalised_error(|| all().map(|c| c.normalised(scale))).ok_or_else(no_truth)?;
        let idepth_errors = || all().map(|c| c.idepth / (scale * c.true_idepth) - 1.0);
        let relative_depths = || {
            let positive = all().filter(|c| c.idepth > 0.0);
            positive.map(|c| c.relative_depth(scale))
        };
        let share_of_estimates = |ratio: f64| {
            all().filter(|c| c.is_within(ratio, scale)).count() as f64 / num_compared as f64
        };
        let known_pixels = self.keyframes.iter().map(|k| k.known_pixels).sum();
        Ok(DepthReport {
            scale,
            keyframes: self.keyframes.len(),
            estimates: num_compared,
            gradient_pixels: self.keyframes.iter().map(|k| k.gradient_pixels).sum(),
            shares: shares_of_textured(&self.keyframes, |_| scale),
            shares_own_scale: shares_of_textured(&self.keyframes, |k| {
                k.own_scale().unwrap_or(scale)
            }),
            known_pixels,
            shares_of_known: shares(all().map(|c| (c, scale)), known_pixels),
            estimates_within_3_percent: share_of_estimates(0.03),
            estimates_within_10_percent: share_of_estimates(0.1),
            bias: median_of_many(relative_depths).ok_or_else(no_truth)? - 1.0,
            idepth_bias: median_of_many(idepth_errors).ok_or_else(no_truth)?,
            rmse_log_depth: rmse_log(relative_depths()),
            normalised_error: normalised,
            per_keyframe: self.keyframes.iter().map(|k| report(k, scale)).collect(),
        })
    }
}

fn is_known(depth: f32) -> bool {
    depth.is_finite() && depth > 0.0
}

fn check(keyframe: &KeyframeDepth) -> Result<(), DepthError> {
    let (id, width, height) = (keyframe.id, keyframe.width, keyframe.height);
    let check_size = |image, found| match found == width * height {
        true => Ok(()),
        false => Err(DepthError::Size {
            id,
            image,
            found,
            width,
            height,
        }),
    };
    check_size("true depth", keyframe.true_depth.len())?;
    check_size("gradient image", keyframe.gradient.len())?;
    let scale = keyframe.world_scale;
    if !(scale > 0.0 && scale.is_finite()) {
        return Err(DepthError::Scale { id, scale });
    }
    let is_good = |e: &DepthPixel| {
        usize::from(e.x) < width
            && usize::from(e.y) < height
            && e.idepth.is_finite()
            && e.idepth_var.is_finite()
            && e.idepth_var > 0.0
    };
    match keyframe.estimates.iter().find(|e| !is_good(e)) {
        None => Ok(()),
        Some(estimate) => Err(DepthError::Estimate {
            id,
            width,
            height,
            estimate: *estimate,
        }),
    }
}

/// Shares of the gradient pixels of `keyframes`, each with its scale.
fn shares_of_textured(keyframes: &[Keyframe], scale_of: impl Fn(&Keyframe) -> f64) -> DepthShares {
    let compared = keyframes.iter().flat_map(|keyframe| {
        let scale = scale_of(keyframe);
        let textured = keyframe.comparisons().filter(|c| c.has_gradient);
        textured.map(move |c| (c, scale))
    });
    shares(compared, keyframes.iter().map(|k| k.gradient_pixels).sum())
}

/// Shares of so many pixels that have comparisons, each with its scale; zero when there are none.
fn shares(compared: impl Iterator<Item = (Comparison, f64)>, pixels: usize) -> DepthShares {
    let mut counts = [0; 3];
    for (c, scale) in compared {
        counts[0] += usize::from(c.is_within(0.03, scale));
        counts[1] += usize::from(c.is_within(0.1, scale));
        counts[2] += 1;
    }
    let [within_3_percent, within_10_percent, density] =
        counts.map(|count| count as f64 / pixels.max(1) as f64);
    DepthShares {
        within_3_percent,
        within_10_percent,
        density,
    }
}

/// Of errors in standard deviations, which are made anew for each question.
fn normalised_error<I: Iterator<Item = f64>>(errors: impl Fn() -> I) -> Option<NormalisedError> {
    let median = median_of_many(&errors)?;
    let n = errors().count() as f64;
    let mean = errors().sum::<f64>() / n;
    let variance = errors().map(|e| (e - mean).powi(2)).sum::<f64>() / n;
    Some(NormalisedError {
        median,
        absolute_median: median.abs(),
        robust_deviation: robust_deviation_of_many(&errors, median)?,
        within_2_sigma: errors().filter(|e| e.abs() <= 2.0).count() as f64 / n,
        std: variance.sqrt(),
    })
}

fn rmse_log(relative_depths: impl Iterator<Item = f64>) -> f64 {
    let add = |(sum, count), ratio: f64| (sum + ratio.ln().powi(2), count + 1);
    let (sum, count) = relative_depths.fold((0.0, 0_usize), add);
    (sum / count.max(1) as f64).sqrt()
}

fn report(keyframe: &Keyframe, global_scale: f64) -> KeyframeDepthReport {
    let own = keyframe.own_scale();
    KeyframeDepthReport {
        id: keyframe.id,
        estimates: keyframe.kept.len(),
        scale: own,
        relative_scale: own.map(|scale| scale / global_scale),
        shares: keyframe.shares(global_scale),
        shares_own_scale: keyframe.shares(own.unwrap_or(global_scale)),
    }
}
