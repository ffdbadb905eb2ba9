//! Stereo observation of the pixels of a band of rows, and their update.
//!
//! Per pixel: choose the frame that promises most → search or refine along the epipolar line →
//! variance → create, fuse, confirm or doubt.

use crate::HostFrame;
use crate::config::{DepthConfig, FrameChoice};
use crate::epipolar::{EpipolarLine, FrameGeometry};
use crate::line_match::{LineMatch, NoMatch, PATCH, Patch, Walk, refine, search};
use crate::map::{Arrays, Candidates, DepthMap, MAX_FAILURES};
use crate::stats::{ObserveStats, PixelOutcome};
use crate::variance::{LineUncertainty, MatchEvidence, match_variance};
use monogrid_geometry::Se3;
use monogrid_image::GrayImage;

/// Pixels between a sampled place and the border of the frame.
const FRAME_BORDER: f32 = 4.0;
/// A search interval no longer than this is left to the refinement alone, px.
const REFINE_ONLY_PX: f32 = 2.5;
/// How far the refinement may move from the best whole pixel, px.
const MAX_REFINE_PX: f32 = 1.25;
/// The interval reaches this far beyond its ends, px, so that a match at an end has two sides.
const MARGIN_PX: f32 = 2.0;

/// A frame that the keyframe's pixels are compared with.
#[derive(Clone, Copy, Debug)]
pub struct StereoFrame<'a> {
    /// Grey image of the keyframe's size and intrinsics.
    pub image: &'a GrayImage,
    /// Pose; translation in the keyframe's unit.
    pub frame_from_keyframe: Se3,
    /// `I_frame = gain * I_keyframe + bias`.
    pub gain: f32,
    /// See `gain`, grey levels.
    pub bias: f32,
    /// Root mean square photometric residual of tracking this frame, grey levels.
    pub residual_rms: f32,
    /// Standard deviation of the translation along each axis, u.
    pub pose_sigma_trans: f32,
    /// Standard deviation of the rotation around each axis, rad.
    pub pose_sigma_rot: f32,
    /// Number of the frame; spreads repeated work over frames.
    pub id: u32,
}

/// A frame with what is precomputed for it.
struct Prepared<'a> {
    frame: StereoFrame<'a>,
    geometry: FrameGeometry,
    uncertainty: LineUncertainty,
}

/// Mutable rows of a [`DepthMap`]; bands are disjoint and may be processed on any thread.
#[derive(Debug)]
pub struct DepthBand<'a> {
    host: &'a HostFrame,
    candidates: &'a Candidates,
    noise_var: f32,
    near_limit: f32,
    first_row: usize,
    num_rows: usize,
    idepth: &'a mut [f32],
    var: &'a mut [f32],
    prior_var: &'a mut [f32],
    floor_var: &'a mut [f32],
    photo_px: &'a mut [f32],
    validity: &'a mut [u8],
    failures: &'a mut [u8],
}

impl DepthMap {
    /// Splits the map into bands of `rows_per_band` rows (the last may be smaller).
    pub fn bands(&mut self, rows_per_band: usize) -> Vec<DepthBand<'_>> {
        let rows = rows_per_band.max(1);
        let len = rows * self.host.width();
        let Arrays {
            idepth,
            var,
            prior_var,
            floor_var,
            photo_px,
            validity,
            failures,
        } = &mut self.arrays;
        let (host, candidates) = (&*self.host, &self.candidates);
        let mut floats = idepth
            .chunks_mut(len)
            .zip(var.chunks_mut(len))
            .zip(prior_var.chunks_mut(len))
            .zip(floor_var.chunks_mut(len))
            .zip(photo_px.chunks_mut(len));
        let mut bytes = validity.chunks_mut(len).zip(failures.chunks_mut(len));
        let mut bands = Vec::with_capacity(host.height().div_ceil(rows));
        let mut first_row = 0;
        while let (Some(f), Some((validity, failures))) = (floats.next(), bytes.next()) {
            let ((((idepth, var), prior_var), floor_var), photo_px) = f;
            let num_rows = rows.min(host.height() - first_row);
            bands.push(DepthBand {
                host,
                candidates,
                noise_var: self.noise_var,
                near_limit: self.near_limit,
                first_row,
                num_rows,
                idepth,
                var,
                prior_var,
                floor_var,
                photo_px,
                validity,
                failures,
            });
            first_row += num_rows;
        }
        bands
    }

    /// Observes all rows on the calling thread, and learns the noise from them.
    pub fn observe(&mut self, frames: &[StereoFrame<'_>], config: &DepthConfig) -> ObserveStats {
        let mut stats = ObserveStats::default();
        // the same bands as a parallel caller would use, so that sums agree bit for bit
        for mut band in self.bands(16) {
            stats.merge(&band.observe(frames, config));
        }
        self.finish_observation(&stats);
        stats
    }
}

/// One way to observe a pixel: a frame, the line in it and what it promises.
struct Choice<'f, 'a> {
    prepared: &'f Prepared<'a>,
    line: EpipolarLine,
    /// Unit direction in the keyframe that moves the match forward.
    direction: [f32; 2],
    /// Px in the frame per px in the keyframe.
    stretch: f32,
    /// `1 / cos²` of the angle between gradient and line.
    inv_cos_sq: f32,
    /// Change of inverse depth per px at the prior.
    alpha: f32,
    /// Predicted variance of the observation, 1/u².
    predicted_var: f32,
}

/// An accepted match.
struct Observation {
    idepth: f32,
    var: f32,
    shared_var: f32,
    photo_px: f32,
}

/// What a pixel looks like before observation.
#[derive(Clone, Copy)]
struct Pixel {
    /// Index inside the band.
    i: usize,
    x: f32,
    y: f32,
    gradient: [f32; 2],
}

impl DepthBand<'_> {
    /// First row of the band.
    #[must_use]
    pub fn first_row(&self) -> usize {
        self.first_row
    }

    /// Observes every candidate pixel of the band in one of `frames`, best given with the most
    /// promising first. Frames of another size than the keyframe are ignored.
    pub fn observe(&mut self, frames: &[StereoFrame<'_>], config: &DepthConfig) -> ObserveStats {
        let mut stats = ObserveStats::default();
        let prepared = prepare(frames, self.host, config);
        if prepared.is_empty() {
            return stats;
        }
        let w = self.host.width();
        let candidates = self.candidates;
        for row in 0..self.num_rows {
            let y = self.first_row + row;
            let (gx, gy) = (self.host.gradient.gx.row(y), self.host.gradient.gy.row(y));
            for &column in candidates.row(y) {
                let x = usize::from(column);
                let pixel = Pixel {
                    i: row * w + x,
                    x: f32::from(column),
                    y: y as f32,
                    gradient: [gx[x], gy[x]],
                };
                let outcome = if self.var[pixel.i] > 0.0 {
                    self.update(pixel, &prepared, config, &mut stats)
                } else {
                    self.create(pixel, &prepared, config)
                };
                stats.add(outcome);
            }
        }
        stats
    }

    /// Refines an existing hypothesis.
    fn update(
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

    /// Whether a pixel that failed is left alone in this frame; at most for `2^longest` frames.
    fn waits(
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
    fn worthwhile_var(&self, pixel: Pixel, frames: &[Prepared<'_>], config: &DepthConfig) -> f32 {
        /// A much worse observation would confirm anything.
        const TELLING: f32 = 25.0;
        if config.frame_choice == FrameChoice::First {
            return f32::INFINITY;
        }
        let young = self.validity[pixel.i] < config.mature_validity;
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
    fn choose_for_update<'f, 'a>(
        &self,
        pixel: Pixel,
        frames: &'f [Prepared<'a>],
        worth: f32,
        config: &DepthConfig,
    ) -> Result<Choice<'f, 'a>, PixelOutcome> {
        let (idepth, var) = (self.idepth[pixel.i], self.var[pixel.i]);
        // what an observation costs at least, whatever the direction of its line
        let least_px = self.photo_px[pixel.i] + config.floor_px * config.floor_px;
        let mut best: Option<Choice<'f, 'a>> = None;
        let mut reason = PixelOutcome::BaselineTooShort;
        for prepared in frames {
            let alpha_sq = prepared.geometry.alpha_sq(pixel.x, pixel.y, idepth);
            if alpha_sq * least_px >= worth {
                reason = PixelOutcome::NoGain;
                continue;
            }
            let choice = match self.consider(pixel, prepared, idepth, config) {
                Ok(choice) => choice,
                Err(why) => {
                    reason = why;
                    continue;
                }
            };
            if choice.predicted_var >= worth {
                reason = PixelOutcome::NoGain;
                continue;
            }
            let position = choice.line.position(idepth);
            if choice
                .line
                .clip((position, position), self.size(), FRAME_BORDER)
                .is_none()
            {
                reason = PixelOutcome::OutOfImage;
                continue;
            }
            let length = 2.0 * config.search_sigmas * var.sqrt() / choice.alpha;
            if length > config.max_update_search_px && !config.crop_to_far_end {
                reason = PixelOutcome::SearchTooLong;
                continue;
            }
            if config.frame_choice == FrameChoice::First {
                return Ok(choice);
            }
            if best
                .as_ref()
                .is_none_or(|b| choice.predicted_var < b.predicted_var)
            {
                best = Some(choice);
            }
        }
        best.ok_or(reason)
    }

    /// Geometry of one frame for one pixel at the assumed inverse depth, or why it is of no use.
    #[inline]
    fn consider<'f, 'a>(
        &self,
        pixel: Pixel,
        prepared: &'f Prepared<'a>,
        idepth: f32,
        config: &DepthConfig,
    ) -> Result<Choice<'f, 'a>, PixelOutcome> {
        let line = prepared
            .geometry
            .line(pixel.x, pixel.y)
            .ok_or(PixelOutcome::BaselineTooShort)?;
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
        if along_sq < config.min_line_gradient * config.min_line_gradient
            || along_sq < config.min_line_cosine * config.min_line_cosine * gradient_sq
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
        let geometric = prepared
            .uncertainty
            .geometric(idepth, inv_cos_sq, config.variance);
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

    /// Matches the pixel inside an interval of inverse depth and puts the observation together;
    /// returns it with the mean squared residual.
    fn observe_line(
        &self,
        pixel: Pixel,
        choice: &Choice<'_, '_>,
        (prior, interval): (f32, (f32, f32)),
        config: &DepthConfig,
    ) -> Result<(Observation, f32), PixelOutcome> {
        let image = &self.host.image;
        let step = 1.0 / choice.stretch;
        let centre = [pixel.x, pixel.y];
        let patch = Patch::new(image, centre, choice.direction, step, config.remove_mean);
        if patch.information < config.min_line_gradient * config.min_line_gradient {
            return Err(PixelOutcome::GradientAcrossLine);
        }
        let found = self.match_on_line(&patch, choice, (prior, interval), config)?;
        let residual = found.ssd / PATCH as f32;
        let noise = config.max_residual_sigmas * config.sensor_sigma;
        let limit = 2.0 * noise * noise
            + config.residual_gradient_share.powi(2) * patch.information / PATCH as f32;
        if residual > limit {
            return Err(PixelOutcome::Dissimilar);
        }
        let [u, v] = choice.line.pixel(found.position);
        if self.host.mask.at((u + 0.5) as usize, (v + 0.5) as usize) == 0 {
            return Err(PixelOutcome::OutOfImage);
        }
        let idepth = choice
            .line
            .idepth(found.position)
            .ok_or(PixelOutcome::NotConverged)?;
        // the texture that was matched lies `centroid` beside the pixel; on an oblique surface its
        // depth differs by slope * distance, in px of the line: times position (d / alpha)
        let offset_px = patch.centroid * step;
        let evidence = MatchEvidence {
            information: patch.information,
            ssd: found.ssd,
            noise_var: self.noise_var,
            geometric: choice.prepared.uncertainty.geometric(
                idepth.max(0.0),
                choice.inv_cos_sq,
                config.variance,
            ),
            slope_px: config.slope_per_px * offset_px * idepth / choice.alpha,
        };
        let variance = match_variance(&evidence, config);
        let alpha_sq = choice.alpha * choice.alpha;
        Ok((
            Observation {
                idepth,
                var: alpha_sq * variance.total,
                shared_var: alpha_sq * variance.shared,
                photo_px: variance.photometric,
            },
            residual,
        ))
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
            let longest = if config.crop_to_far_end {
                config.max_create_search_px
            } else {
                config.max_create_search_px.max(config.max_update_search_px)
            } + 2.0 * MARGIN_PX;
            segment.1 = segment.1.min(segment.0 + longest);
            let (from, to) = line
                .clip(segment, self.size(), FRAME_BORDER + 2.0)
                .ok_or(PixelOutcome::OutOfImage)?;
            let num_steps = (to - from).max(0.0) as usize;
            if num_steps < 2 {
                return Err(PixelOutcome::OutOfImage);
            }
            let noise_ssd = PATCH as f32 * self.noise_var;
            let ambiguity = (config.ambiguity_ratio, noise_ssd);
            let found = search(patch, &walk, from, num_steps, ambiguity).map_err(outcome_of)?;
            (found.position, MAX_REFINE_PX)
        };
        // the refinement may read `max_move` and the patch beyond the start
        let reach = (start - max_move, start + max_move);
        match line.clip(reach, self.size(), FRAME_BORDER - 0.5) {
            Some(inside) if inside == reach => {}
            _ => return Err(PixelOutcome::OutOfImage),
        }
        refine(patch, &walk, start, max_move).map_err(outcome_of)
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
        let max_validity = f32::from(config.validity_max)
            + config.validity_per_gradient
                * self
                    .host
                    .max_gradient
                    .at(pixel.x as usize, pixel.y as usize);
        let validity = self.validity[i].saturating_add(config.validity_gain);
        self.validity[i] = validity
            .min(max_validity.min(255.0) as u8)
            .max(self.validity[i]);
        self.failures[i] = 0;
        self.photo_px[i] = observation.photo_px;
        // [SDVO13] Eq. (13)
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
        self.var[i] *= config.failure_inflation;
        self.failures[i] = self.failures[i].saturating_add(1).min(MAX_FAILURES);
        // a contradiction is only counted against the hypothesis by LSD when it is also unlikely
        let loss =
            if outcome == PixelOutcome::Inconsistent && config.frame_choice == FrameChoice::First {
                0
            } else {
                config.validity_loss
            };
        let exhausted = self.validity[i] < loss;
        self.validity[i] = self.validity[i].saturating_sub(loss);
        let hopeless = match config.frame_choice {
            FrameChoice::First => self.var[i] > config.max_var,
            FrameChoice::Predicted => self.var[i] > config.max_var || exhausted,
        };
        if hopeless {
            self.var[i] = 0.0;
            self.validity[i] = 0;
            self.photo_px[i] = 0.0;
            return PixelOutcome::Dropped;
        }
        outcome
    }

    /// Looks for a pixel without hypothesis along the whole visible segment.
    fn create(
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
            Ok((observation, _)) if observation.var <= config.max_var => {
                self.idepth[i] = observation.idepth;
                self.var[i] = observation.var;
                self.prior_var[i] = f32::INFINITY;
                self.floor_var[i] = observation.shared_var;
                self.photo_px[i] = observation.photo_px;
                self.validity[i] = config.validity_created;
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

    /// The frame with the longest baseline whose whole segment is short enough to search.
    fn choose_for_creation<'f, 'a>(
        &self,
        pixel: Pixel,
        frames: &'f [Prepared<'a>],
        config: &DepthConfig,
    ) -> Result<Choice<'f, 'a>, PixelOutcome> {
        /// Inverse depth at which the geometry of an unknown pixel is judged: the keyframe's mean.
        const ASSUMED_IDEPTH: f32 = 1.0;
        let mut best: Option<Choice<'f, 'a>> = None;
        let mut reason = PixelOutcome::BaselineTooShort;
        for prepared in frames {
            let choice = match self.consider(pixel, prepared, ASSUMED_IDEPTH, config) {
                Ok(choice) => choice,
                Err(why) => {
                    reason = why;
                    continue;
                }
            };
            if choice.predicted_var > config.max_var {
                reason = PixelOutcome::BaselineTooShort;
                continue;
            }
            let near = choice.line.limit_in_front(self.near_limit, 0.3);
            let all = (0.0, choice.line.position(near));
            let Some((from, to)) = choice.line.clip(all, self.size(), FRAME_BORDER) else {
                reason = PixelOutcome::OutOfImage;
                continue;
            };
            if to - from > config.max_create_search_px && !config.crop_to_far_end {
                reason = PixelOutcome::SearchTooLong;
                continue;
            }
            if config.frame_choice == FrameChoice::First {
                return Ok(choice);
            }
            if best
                .as_ref()
                .is_none_or(|b| choice.predicted_var < b.predicted_var)
            {
                best = Some(choice);
            }
        }
        best.ok_or(reason)
    }

    fn size(&self) -> (usize, usize) {
        (self.host.width(), self.host.height())
    }
}

fn outcome_of(reason: NoMatch) -> PixelOutcome {
    match reason {
        NoMatch::AtIntervalEnd => PixelOutcome::AtIntervalEnd,
        NoMatch::Ambiguous => PixelOutcome::Ambiguous,
        NoMatch::NotConverged => PixelOutcome::NotConverged,
    }
}

/// A number that differs between neighbours and advances with the frames.
fn phase(pixel: Pixel, id: u32) -> u32 {
    (pixel.x as u32)
        .wrapping_mul(7)
        .wrapping_add((pixel.y as u32).wrapping_mul(13))
        .wrapping_add(id)
}

fn prepare<'a>(
    frames: &[StereoFrame<'a>],
    host: &HostFrame,
    config: &DepthConfig,
) -> Vec<Prepared<'a>> {
    let usable = |f: &&StereoFrame<'_>| {
        let gain_ok = f.gain.is_finite() && f.gain > 0.0 && f.bias.is_finite();
        f.image.same_size(&host.image) && gain_ok && f.frame_from_keyframe.is_finite()
    };
    frames
        .iter()
        .filter(usable)
        .map(|frame| {
            let geometry = FrameGeometry::new(frame, &host.pinhole);
            let rotation_px = geometry.focal() * frame.pose_sigma_rot;
            let uncertainty = LineUncertainty {
                constant_sq: rotation_px * rotation_px
                    + config.line_sigma_px * config.line_sigma_px,
                per_idepth: geometry.focal() * frame.pose_sigma_trans,
                residual_rms: frame.residual_rms,
            };
            Prepared {
                frame: *frame,
                geometry,
                uncertainty,
            }
        })
        .collect()
}
