//! What happened to each pixel, counted.

/// The outcome of one frame for one candidate pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(usize)]
pub enum PixelOutcome {
    /// A new hypothesis was found by a search.
    Created,
    /// An observation was fused.
    Updated,
    /// An observation confirmed a hypothesis that it could not improve.
    Verified,
    /// Nothing would have been gained.
    NoGain,
    /// A pixel that failed before waits.
    Waiting,
    /// No frame has enough baseline for this pixel.
    BaselineTooShort,
    /// No frame sees the pixel, or not all of the patch.
    OutOfImage,
    /// The gradient is across the epipolar line, or too small along it.
    GradientAcrossLine,
    /// Its size changes too much between the images.
    ScaleChange,
    /// The search would be too long.
    SearchTooLong,
    /// Best match at the end of the interval.
    AtIntervalEnd,
    /// Two places match alike.
    Ambiguous,
    /// Even the best match is not alike.
    Dissimilar,
    /// The refinement left the minimum.
    NotConverged,
    /// The observation contradicts the hypothesis.
    Inconsistent,
    /// The hypothesis was dropped after failures.
    Dropped,
}

/// Counters of one call of [`crate::DepthBand::observe`]; add them up in the order of the bands.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct ObserveStats {
    counts: [u32; PixelOutcome::Dropped as usize + 1],
    /// Sum over accepted matches of the mean squared patch difference, grey levels².
    pub residual_sq_sum: f64,
    /// Number of accepted matches in `residual_sq_sum`.
    pub num_residuals: u32,
}

impl ObserveStats {
    /// How often `outcome` happened.
    #[must_use]
    pub fn count(&self, outcome: PixelOutcome) -> u32 {
        self.counts[outcome as usize]
    }

    /// Number of candidate pixels.
    #[must_use]
    pub fn num_candidates(&self) -> u32 {
        self.counts.iter().sum()
    }

    /// Counts one pixel.
    pub(crate) fn add(&mut self, outcome: PixelOutcome) {
        self.counts[outcome as usize] += 1;
    }

    /// Adds the counters of the next band.
    pub fn merge(&mut self, other: &Self) {
        for (a, b) in self.counts.iter_mut().zip(other.counts) {
            *a += b;
        }
        self.residual_sq_sum += other.residual_sq_sum;
        self.num_residuals += other.num_residuals;
    }
}
