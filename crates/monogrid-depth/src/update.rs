//! What an observation does to a pixel: create, fuse, confirm or doubt.

use crate::config::{DepthConfig, FrameChoice};
use crate::line_match::PATCH;
use crate::map::{MAX_FAILURES, MAX_VAR};
use crate::measure::Observation;
use crate::observe::{DepthBand, Pixel, Prepared};
use crate::stats::{ObserveStats, PixelOutcome};
use monogrid_image::bilinear;

/// Variance is multiplied by this at each failed match.
const FAILURE_INFLATION: f32 = 1.1;
/// Validity of a hypothesis created by a search.
const VALIDITY_CREATED: u8 = 5;
/// Validity gained by a successful observation.
const VALIDITY_GAIN: u8 = 5;
/// Distance of the samples of a patch that is compared, px.
const PATCH_STEP_PX: f32 = 1.5;
/// Standard deviation of the place of a pixel in a frame, px.
const MISPLACED_PX: f32 = 0.15;
/// Largest squared difference of two patches with the same content, multiples of the variance of
/// the noise: three standard deviations above the mean of chi squared with four degrees of freedom.
const MAX_NOISE: f32 = 12.5;
/// Largest squared difference by a wrong place, multiples of its variance: three sigma.
const MAX_MISPLACED: f32 = 9.0;
/// Validity lost by a patch that contradicts: one in five of a surface that stands still may.
const CONTRADICTION_LOSS: u8 = 20;
/// Validity lost by a failed or contradicting one.
const VALIDITY_LOSS: u8 = 5;

impl DepthBand<'_> {
    /// Refines an existing hypothesis.
    pub(crate) fn update(
        &mut self,
        pixel: Pixel,
        frames: &[Prepared<'_>],
        config: &DepthConfig,
        stats: &mut ObserveStats,
    ) -> PixelOutcome {
        let i = pixel.i;
        let (idepth, var) = (self.idepth[i], self.var[i]);
        if self.waits(pixel, frames, 3, config) {
            return PixelOutcome::Waiting;
        }
        let worth = self.worthwhile_var(pixel, frames, config);
        let choice = match self.choose_for_update(pixel, frames, worth, config) {
            Ok(choice) => choice,
            Err(PixelOutcome::NoGain | PixelOutcome::BaselineTooShort) if self.is_measured => {
                return self.compare(pixel, &frames[0], config);
            }
            Err(outcome) => return outcome,
        };
        let gains = choice.predicted_var < config.max_gain_ratio * var;
        let sigma = config.search_sigmas * var.sqrt();
        let interval = (idepth - sigma, idepth + sigma);
        match self.observe_line(pixel, &choice, (idepth, interval), config) {
            Ok((observation, residual)) => {
                stats.residual_sq_sum += f64::from(residual);
                stats.num_residuals += 1;
                self.fuse(pixel, &observation, gains, config)
            }
            Err(outcome) => self.doubt(pixel, outcome, config),
        }
    }

    /// Compares the patch of a pixel whose depth the frame cannot improve with that where it should
    /// be in the frame. What a depth camera measured is too certain to be searched for: of a
    /// surface that moves this is the only contradiction.
    fn compare(
        &mut self,
        pixel: Pixel,
        prepared: &Prepared<'_>,
        config: &DepthConfig,
    ) -> PixelOutcome {
        let i = pixel.i;
        let Some(is_alike) = self.is_alike(pixel, prepared) else {
            return PixelOutcome::OutOfImage;
        };
        let validity = self.validity[i];
        if is_alike {
            let max_validity = validity.max(config.validity_max);
            self.validity[i] = validity.saturating_add(VALIDITY_GAIN).min(max_validity);
        } else if let Some(rest) = validity.checked_sub(CONTRADICTION_LOSS) {
            self.validity[i] = rest;
        } else {
            (self.var[i], self.validity[i], self.photo_px[i]) = (0.0, 0, 0.0);
            self.failures[i] = MAX_FAILURES;
            return PixelOutcome::Dropped;
        }
        PixelOutcome::NoGain
    }

    /// Whether the patch along the gradient of a pixel and that at its depth in the frame are alike
    /// but for their means, which a vignette changes; `None` at the border of either image.
    fn is_alike(&self, pixel: Pixel, prepared: &Prepared<'_>) -> Option<bool> {
        let (geometry, frame) = (&prepared.geometry, &prepared.frame);
        let [gx, gy] = pixel.gradient;
        let step = PATCH_STEP_PX / (gx * gx + gy * gy).sqrt().max(1e-3);
        let (mut own, mut other) = ([0.0f32; PATCH], [0.0f32; PATCH]);
        for k in 0..PATCH {
            let along = (k as f32 - (PATCH / 2) as f32) * step;
            let (x, y) = (pixel.x + along * gx, pixel.y + along * gy);
            own[k] = frame.gain * bilinear(&self.host.image, x, y)?;
            let [u, v] = geometry.project(x, y, self.idepth[pixel.i])?;
            other[k] = bilinear(frame.image, u, v)?;
        }
        let slopes = std::array::from_fn(|k| {
            let (before, after) = (k.saturating_sub(1), (k + 1).min(PATCH - 1));
            (own[after] - own[before]) / ((after - before) as f32 * PATCH_STEP_PX)
        });
        let difference = spread(std::array::from_fn(|k| other[k] - own[k]));
        let misplaced = MISPLACED_PX * MISPLACED_PX * spread(slopes);
        Some(difference <= MAX_NOISE * self.noise_var + MAX_MISPLACED * misplaced)
    }

    /// Looks for a pixel without hypothesis along the whole visible segment.
    pub(crate) fn create(
        &mut self,
        pixel: Pixel,
        frames: &[Prepared<'_>],
        config: &DepthConfig,
    ) -> PixelOutcome {
        let i = pixel.i;
        if self.waits(pixel, frames, 5, config) {
            return PixelOutcome::Waiting;
        }
        let choice = match self.choose_for_creation(pixel, frames, config) {
            Ok(choice) => choice,
            Err(outcome) => return outcome,
        };
        match self.observe_line(pixel, &choice, (1.0, (0.0, self.near_limit)), config) {
            Ok((observation, _)) if observation.var <= MAX_VAR => {
                self.idepth[i] = observation.idepth;
                self.var[i] = observation.var;
                self.prior_var[i] = f32::INFINITY;
                self.floor_var[i] = observation.shared_var;
                self.photo_px[i] = observation.photo_px;
                self.validity[i] = VALIDITY_CREATED;
                self.failures[i] = 0;
                PixelOutcome::Created
            }
            Ok(_) => PixelOutcome::BaselineTooShort,
            Err(outcome) => {
                self.failures[i] = self.failures[i].saturating_add(1).min(MAX_FAILURES);
                outcome
            }
        }
    }

    /// Product of the two Gaussians, unless they contradict each other.
    fn fuse(
        &mut self,
        pixel: Pixel,
        observation: &Observation,
        gains: bool,
        config: &DepthConfig,
    ) -> PixelOutcome {
        let i = pixel.i;
        let var = self.var[i] * config.success_inflation;
        let innovation = observation.idepth - self.idepth[i];
        let limit = config.max_disagreement_sigma * config.max_disagreement_sigma;
        if innovation * innovation > limit * (var + observation.var) {
            return self.doubt(pixel, PixelOutcome::Inconsistent, config);
        }
        let gradient = (self.host.max_gradient).at(pixel.x as usize, pixel.y as usize);
        let max_validity = f32::from(config.validity_max) + config.validity_per_gradient * gradient;
        let max_validity = self.validity[i].max(max_validity.min(255.0) as u8);
        let validity = self.validity[i].saturating_add(VALIDITY_GAIN);
        self.validity[i] = validity.min(max_validity);
        self.failures[i] = 0;
        self.photo_px[i] = observation.photo_px;
        // `[SDVO13]` equation 13
        let weight = var / (var + observation.var);
        self.idepth[i] += weight * innovation;
        let product = var * observation.var / (var + observation.var);
        // the keyframe's own patch is the same in all observations: they cannot average its noise
        self.floor_var[i] = self.floor_var[i].min(observation.shared_var);
        let (prior, floor) = (self.prior_var[i], self.floor_var[i]);
        let reachable = if prior.is_finite() {
            prior * floor / (prior + floor)
        } else {
            floor
        };
        self.var[i] = product.max(reachable).min(self.var[i]);
        if gains || config.frame_choice == FrameChoice::First {
            PixelOutcome::Updated
        } else {
            PixelOutcome::Verified
        }
    }

    /// A failed or contradicting observation.
    fn doubt(&mut self, pixel: Pixel, outcome: PixelOutcome, config: &DepthConfig) -> PixelOutcome {
        let i = pixel.i;
        match outcome {
            PixelOutcome::Ambiguous | PixelOutcome::AtIntervalEnd | PixelOutcome::Inconsistent => {}
            PixelOutcome::Dissimilar | PixelOutcome::NotConverged
                if config.frame_choice == FrameChoice::Predicted => {}
            _ => return outcome,
        }
        self.var[i] *= FAILURE_INFLATION;
        self.failures[i] = self.failures[i].saturating_add(1).min(MAX_FAILURES);
        // a contradiction is only counted against the hypothesis by LSD when it is also unlikely
        let loss = match (outcome, config.frame_choice) {
            (PixelOutcome::Inconsistent, FrameChoice::First) => 0,
            _ => VALIDITY_LOSS,
        };
        let exhausted = self.validity[i] < loss;
        self.validity[i] = self.validity[i].saturating_sub(loss);
        let drops_exhausted = config.frame_choice == FrameChoice::Predicted;
        if self.var[i] > MAX_VAR || (drops_exhausted && exhausted) {
            (self.var[i], self.validity[i], self.photo_px[i]) = (0.0, 0, 0.0);
            return PixelOutcome::Dropped;
        }
        outcome
    }
}

/// Sum of the squared deviations from the mean.
fn spread(values: [f32; PATCH]) -> f32 {
    let mean = values.iter().sum::<f32>() / PATCH as f32;
    values.iter().map(|value| (value - mean).powi(2)).sum()
}
