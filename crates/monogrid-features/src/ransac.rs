//! How many random samples are enough.

/// Probability with which at least one sample is without outliers.
const CONFIDENCE: f64 = 0.999;
/// Largest share of inliers that is reckoned with: with all of them, one sample would be enough.
const MAX_INLIER_RATIO: f64 = 0.99;

/// Samples of this size that are needed where so many matches are inliers; fewer than `least`, a
/// share, are not reckoned with.
pub(crate) fn samples_needed(inlier_ratio: f64, least: f64, sample_size: i32) -> usize {
    let clean = inlier_ratio
        .clamp(least, MAX_INLIER_RATIO)
        .powi(sample_size);
    ((1.0 - CONFIDENCE).ln() / (1.0 - clean).ln()).ceil() as usize
}
