//! One stereo measurement: patch, match along the line, variance.

use crate::choose::{Choice, FRAME_BORDER, MIN_LINE_GRADIENT};
use crate::config::{DepthConfig, FrameChoice};
use crate::line_match::{LineMatch, PATCH, Patch, Walk, refine, search};
use crate::observe::{DepthBand, Pixel};
use crate::stats::PixelOutcome;
use crate::variance::match_variance;

/// Share of the patch's own gradient that is added to the accepted difference.
const RESIDUAL_GRADIENT_SHARE: f32 = 0.2;
/// A match is ambiguous when a minimum elsewhere costs less than this multiple.
const AMBIGUITY_RATIO: f32 = 1.5;

/// A search interval no longer than this is left to the refinement alone, px.
const REFINE_ONLY_PX: f32 = 2.5;
/// How far the refinement may move from the best whole pixel, px.
const MAX_REFINE_PX: f32 = 1.25;
/// The interval reaches this far beyond its ends, px, so that a match at an end has two sides.
const MARGIN_PX: f32 = 2.0;

/// An accepted match.
pub(crate) struct Observation {
    pub(crate) idepth: f32,
    pub(crate) var: f32,
    pub(crate) shared_var: f32,
    pub(crate) photo_px: f32,
}

impl DepthBand<'_> {
    /// Matches the pixel inside an interval of inverse depth and puts the observation together;
    /// returns it with the mean squared residual.
    #[inline(always)]
    pub(crate) fn observe_line(
        &self,
        pixel: Pixel,
        choice: &Choice<'_, '_>,
        (prior, interval): (f32, (f32, f32)),
        config: &DepthConfig,
    ) -> Result<(Observation, f32), PixelOutcome> {
        let image = &self.host.image;
        let step = 1.0 / choice.stretch;
        let centre = [pixel.x, pixel.y];
        let patch = Patch::new(image, centre, choice.direction, step);
        if patch.information < MIN_LINE_GRADIENT * MIN_LINE_GRADIENT {
            return Err(PixelOutcome::GradientAcrossLine);
        }
        let found = self.match_on_line(&patch, choice, (prior, interval), config)?;
        let residual = found.ssd / PATCH as f32;
        let noise = config.max_residual_sigmas * config.sensor_sigma;
        let limit = 2.0 * noise * noise
            + RESIDUAL_GRADIENT_SHARE.powi(2) * patch.information / PATCH as f32;
        if residual > limit {
            return Err(PixelOutcome::Dissimilar);
        }
        let [u, v] = choice.line.pixel(found.position);
        if self.host.mask.at((u + 0.5) as usize, (v + 0.5) as usize) == 0 {
            return Err(PixelOutcome::OutOfImage);
        }
        let idepth = choice.line.idepth(found.position);
        let idepth = idepth.ok_or(PixelOutcome::NotConverged)?;
        // the texture that was matched lies `centroid` beside the pixel; on an oblique surface its
        // depth differs by slope * distance, in px of the line: times position (d / alpha)
        let offset_px = patch.centroid * step;
        let slope_px = config.slope_per_px * offset_px * idepth / choice.alpha;
        let (inv_cos_sq, model) = (choice.inv_cos_sq, config.variance);
        let uncertainty = &choice.prepared.uncertainty;
        let geometric = uncertainty.geometric(idepth.max(0.0), inv_cos_sq, model);
        let differences = (found.ssd, self.noise_var);
        let variance = match_variance(patch.information, differences, geometric, slope_px, config);
        let alpha_sq = choice.alpha * choice.alpha;
        let observation = Observation {
            idepth,
            var: alpha_sq * variance.total,
            shared_var: alpha_sq * variance.shared,
            photo_px: variance.photometric,
        };
        Ok((observation, residual))
    }

    /// Search (when the interval is long) and refinement.
    fn match_on_line(
        &self,
        patch: &Patch,
        choice: &Choice<'_, '_>,
        (prior, interval): (f32, (f32, f32)),
        config: &DepthConfig,
    ) -> Result<LineMatch, PixelOutcome> {
        let frame = &choice.prepared.frame;
        let line = &choice.line;
        let walk = Walk {
            image: frame.image,
            origin: line.infinity,
            direction: line.direction,
            inv_gain: 1.0 / frame.gain,
            bias: frame.bias,
        };
        let near = line.limit_in_front(interval.1.min(config.max_idepth), 0.3);
        let wanted = (line.position(interval.0), line.position(near));
        let refine_only =
            config.frame_choice == FrameChoice::Predicted && wanted.1 - wanted.0 <= REFINE_ONLY_PX;
        let (start, max_move) = if refine_only {
            let half = 0.5 * (wanted.1 - wanted.0);
            (line.position(prior), half.max(1.0))
        } else {
            let mut segment = (wanted.0 - MARGIN_PX, wanted.1 + MARGIN_PX);
            let mut longest = config.max_create_search_px;
            if !config.crop_to_far_end {
                longest = longest.max(config.max_update_search_px);
            }
            segment.1 = segment.1.min(segment.0 + (longest + 2.0 * MARGIN_PX));
            let clipped = line.clip(segment, self.size(), FRAME_BORDER + 2.0);
            let (from, to) = clipped.ok_or(PixelOutcome::OutOfImage)?;
            let num_steps = (to - from).max(0.0) as usize;
            if num_steps < 2 {
                return Err(PixelOutcome::OutOfImage);
            }
            let noise_ssd = PATCH as f32 * self.noise_var;
            let ambiguity = (AMBIGUITY_RATIO, noise_ssd);
            let found = search(patch, &walk, from, num_steps, ambiguity)?;
            (found.position, MAX_REFINE_PX)
        };
        // the refinement may read `max_move` and the patch beyond the start
        let reach = (start - max_move, start + max_move);
        if line.clip(reach, self.size(), FRAME_BORDER - 0.5) != Some(reach) {
            return Err(PixelOutcome::OutOfImage);
        }
        refine(patch, &walk, start, max_move)
    }
}
