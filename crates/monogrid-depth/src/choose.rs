//! Which of the stereo frames a pixel is compared with, and whether at all.

use crate::config::{DepthConfig, FrameChoice};
use crate::epipolar::EpipolarLine;
use crate::map::MAX_VAR;
use crate::observe::{DepthBand, Pixel, Prepared, phase};
use crate::stats::PixelOutcome;

/// Smallest component of the gradient along the epipolar line, grey levels per px.
pub(crate) const MIN_LINE_GRADIENT: f32 = 1.0;
/// Smallest cosine of the angle between gradient and epipolar line.
const MIN_LINE_COSINE: f32 = 0.15;
/// Validity from which a pixel is observed only for gain; younger ones are confirmed with any
/// baseline.
pub const MATURE_VALIDITY: u8 = 20;

/// Pixels between a sampled place and the border of the frame.
pub(crate) const FRAME_BORDER: f32 = 4.0;

/// One way to observe a pixel: a frame, the line in it and what it promises.
pub(crate) struct Choice<'f, 'a> {
    pub(crate) prepared: &'f Prepared<'a>,
    pub(crate) line: EpipolarLine,
    /// Unit direction in the keyframe that moves the match forward.
    pub(crate) direction: [f32; 2],
    /// Px in the frame per px in the keyframe.
    pub(crate) stretch: f32,
    /// `1 / cos²` of the angle between gradient and line.
    pub(crate) inv_cos_sq: f32,
    /// Change of inverse depth per px at the prior.
    pub(crate) alpha: f32,
    /// Predicted variance of the observation, 1/u².
    pub(crate) predicted_var: f32,
}

/// The frame with the smallest predicted variance (or the first usable one), of those of which
/// `consider` says no reason why not; the last reason if there is none.
#[inline(always)]
fn best_of<'f, 'a>(
    frames: &'f [Prepared<'a>],
    config: &DepthConfig,
    consider: impl Fn(&'f Prepared<'a>) -> Result<Choice<'f, 'a>, PixelOutcome>,
) -> Result<Choice<'f, 'a>, PixelOutcome> {
    let mut best: Result<Choice<'f, 'a>, PixelOutcome> = Err(PixelOutcome::BaselineTooShort);
    for prepared in frames {
        match (consider(prepared), &best) {
            (Ok(choice), _) if config.frame_choice == FrameChoice::First => return Ok(choice),
            (Ok(choice), Ok(before)) if choice.predicted_var < before.predicted_var => {
                best = Ok(choice);
            }
            (considered, Err(_)) => best = considered,
            _ => {}
        }
    }
    best
}

impl DepthBand<'_> {
    /// Whether a pixel that failed is left alone in this frame; at most for `2^longest` frames.
    pub(crate) fn waits(
        &self,
        pixel: Pixel,
        frames: &[Prepared<'_>],
        longest: u32,
        config: &DepthConfig,
    ) -> bool {
        let failures = u32::from(self.failures[pixel.i]);
        config.backoff
            && failures > 0
            && !phase(pixel, frames[0].frame.id).is_multiple_of(1 << failures.min(longest))
    }

    /// An observation is made when its predicted variance is below this: when it would improve the
    /// hypothesis, or is due to confirm it.
    pub(crate) fn worthwhile_var(
        &self,
        pixel: Pixel,
        frames: &[Prepared<'_>],
        config: &DepthConfig,
    ) -> f32 {
        /// A much worse observation would confirm anything.
        const TELLING: f32 = 25.0;
        if config.frame_choice == FrameChoice::First {
            return f32::INFINITY;
        }
        let young = self.validity[pixel.i] < MATURE_VALIDITY;
        let due = config.verify_interval > 0
            && phase(pixel, frames[0].frame.id).is_multiple_of(config.verify_interval);
        let ratio = if young || due {
            TELLING
        } else {
            config.max_gain_ratio
        };
        ratio * self.var[pixel.i]
    }

    /// The frame with the smallest predicted variance (or the first usable one).
    // always, as what it calls: a result of this size is dear to hand over in memory
    #[inline(always)]
    pub(crate) fn choose_for_update<'f, 'a>(
        &self,
        pixel: Pixel,
        frames: &'f [Prepared<'a>],
        worth: f32,
        config: &DepthConfig,
    ) -> Result<Choice<'f, 'a>, PixelOutcome> {
        let (idepth, var) = (self.idepth[pixel.i], self.var[pixel.i]);
        // what an observation costs at least, whatever the direction of its line
        let least_px = self.photo_px[pixel.i] + config.floor_px * config.floor_px;
        best_of(frames, config, |prepared| {
            let alpha_sq = prepared.geometry.alpha_sq(pixel.x, pixel.y, idepth);
            if alpha_sq * least_px >= worth {
                return Err(PixelOutcome::NoGain);
            }
            let choice = self.consider(pixel, prepared, idepth, config)?;
            if choice.predicted_var >= worth {
                return Err(PixelOutcome::NoGain);
            }
            let place = choice.line.position(idepth);
            let clipped = (choice.line).clip((place, place), self.size(), FRAME_BORDER);
            clipped.ok_or(PixelOutcome::OutOfImage)?;
            let length = 2.0 * config.search_sigmas * var.sqrt() / choice.alpha;
            if length > config.max_update_search_px && !config.crop_to_far_end {
                return Err(PixelOutcome::SearchTooLong);
            }
            Ok(choice)
        })
    }

    /// The frame with the longest baseline whose whole segment is short enough to search.
    pub(crate) fn choose_for_creation<'f, 'a>(
        &self,
        pixel: Pixel,
        frames: &'f [Prepared<'a>],
        config: &DepthConfig,
    ) -> Result<Choice<'f, 'a>, PixelOutcome> {
        /// Inverse depth at which the geometry of an unknown pixel is judged: the keyframe's mean.
        const ASSUMED_IDEPTH: f32 = 1.0;
        best_of(frames, config, |prepared| {
            let choice = self.consider(pixel, prepared, ASSUMED_IDEPTH, config)?;
            if choice.predicted_var > MAX_VAR {
                return Err(PixelOutcome::BaselineTooShort);
            }
            let near = choice.line.limit_in_front(self.near_limit, 0.3);
            let all = (0.0, choice.line.position(near));
            let clipped = choice.line.clip(all, self.size(), FRAME_BORDER);
            let (from, to) = clipped.ok_or(PixelOutcome::OutOfImage)?;
            if to - from > config.max_create_search_px && !config.crop_to_far_end {
                return Err(PixelOutcome::SearchTooLong);
            }
            Ok(choice)
        })
    }

    /// Geometry of one frame for one pixel at the assumed inverse depth, or why it is of no use.
    #[inline(always)]
    fn consider<'f, 'a>(
        &self,
        pixel: Pixel,
        prepared: &'f Prepared<'a>,
        idepth: f32,
        config: &DepthConfig,
    ) -> Result<Choice<'f, 'a>, PixelOutcome> {
        let line = prepared.geometry.line(pixel.x, pixel.y);
        let line = line.ok_or(PixelOutcome::BaselineTooShort)?;
        let ratio = line.depth_ratio(idepth);
        if ratio < 1.0 / config.max_scale_change || ratio > config.max_scale_change {
            return Err(PixelOutcome::ScaleChange);
        }
        let [ex, ey] = prepared.geometry.keyframe_direction(pixel.x, pixel.y);
        let [gx, gy] = pixel.gradient;
        let norm_sq = ex * ex + ey * ey;
        let along = gx * ex + gy * ey;
        let along_sq = along * along / norm_sq.max(1e-20);
        let gradient_sq = gx * gx + gy * gy;
        if along_sq < MIN_LINE_GRADIENT * MIN_LINE_GRADIENT
            || along_sq < MIN_LINE_COSINE * MIN_LINE_COSINE * gradient_sq
        {
            return Err(PixelOutcome::GradientAcrossLine);
        }
        let inv_cos_sq = gradient_sq / along_sq;
        let alpha = line.alpha(idepth);
        let photo_px = match self.photo_px[pixel.i] {
            known if known > 0.0 => known,
            // the patch of five samples has about twice the information of its centre
            _ => config.photometric_factor * self.noise_var / (2.0 * along_sq),
        };
        let uncertainty = &prepared.uncertainty;
        let geometric = uncertainty.geometric(idepth, inv_cos_sq, config.variance);
        let floor = config.floor_px * config.floor_px;
        let predicted_var = alpha * alpha * (photo_px + geometric + floor);
        let inv_norm = 1.0 / norm_sq.sqrt();
        let mut direction = [ex * inv_norm, ey * inv_norm];
        let mut stretch = prepared.geometry.stretch(&line, idepth, direction);
        if stretch < 0.0 {
            direction = [-direction[0], -direction[1]];
            stretch = -stretch;
        }
        if stretch < 1.0 / config.max_scale_change || stretch > config.max_scale_change {
            return Err(PixelOutcome::ScaleChange);
        }
        Ok(Choice {
            prepared,
            line,
            direction,
            stretch,
            inv_cos_sq,
            alpha,
            predicted_var,
        })
    }
}
