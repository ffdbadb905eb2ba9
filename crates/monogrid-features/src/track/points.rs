//! Pyramidal Lucas-Kanade tracking of many points from one image to another.

use super::patch::finest_fit;
use super::template::{AlignLimits, LevelFailure, PatchFit, Template, WIDE, sample};
use crate::{finest_pixel, level_pixel, noise_share};
use monogrid_geometry::Vec2;
use monogrid_image::Pyramid;

/// Settings of the point tracker.
#[derive(Clone, Debug, PartialEq)]
pub struct TrackConfig {
    /// Pyramid levels used, from `num_levels - 1` down to 0. Default 4: moves of about 20 px.
    pub num_levels: usize,
    /// Most iterations per level. Default 12.
    pub max_iterations: usize,
    /// A step shorter than this ends a level, px of the level. Default 0.01.
    pub min_step_px: f32,
    /// Furthest move on one level, px of the level. Default 6.
    pub max_level_move_px: f32,
    /// Smallest correlation of the finest patch. Default 0.8.
    pub min_correlation: f32,
    /// Weakest mean squared gradient of a patch on level 0, (grey levels / px)². Default 2. One
    /// that shows less there is found on the finest level on which it stands out of the noise.
    pub min_score: f32,
    /// Largest distance between a point and where tracking back from its match leads, px of the
    /// finest level on which it was found; `None` does not track back. Default 1.
    pub max_back_distance_px: Option<f64>,
}

impl Default for TrackConfig {
    fn default() -> Self {
        Self {
            num_levels: 4,
            max_iterations: 12,
            min_step_px: 0.01,
            max_level_move_px: 6.0,
            min_correlation: 0.8,
            min_score: 2.0,
            max_back_distance_px: Some(1.0),
        }
    }
}

/// What became of a patch that was looked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TrackOutcome {
    /// Found.
    Tracked(PatchFit),
    /// The patch leaves one of the images.
    OutOfImage,
    /// The reference patch has no texture in some direction.
    NoTexture,
    /// Alignment went too far.
    Diverged,
    /// Found something that does not look alike.
    Dissimilar {
        /// Its correlation.
        correlation: f32,
    },
    /// Tracking back from the match leads elsewhere.
    Inconsistent {
        /// How far from the point, px.
        distance_px: f64,
    },
    /// Two places look equally alike.
    Ambiguous {
        /// Distance between them, px.
        distance_px: f64,
    },
}

impl TrackOutcome {
    /// The match, if it was found.
    #[must_use]
    pub fn fit(&self) -> Option<&PatchFit> {
        match self {
            Self::Tracked(fit) => Some(fit),
            _ => None,
        }
    }

    /// The pixel of the match, if it was found, level-0 px.
    #[must_use]
    pub fn pixel(&self) -> Option<Vec2> {
        self.fit().map(|fit| fit.pixel)
    }
}

impl From<LevelFailure> for TrackOutcome {
    fn from(failure: LevelFailure) -> Self {
        match failure {
            LevelFailure::OutOfImage => Self::OutOfImage,
            LevelFailure::Diverged => Self::Diverged,
        }
    }
}

/// Finds each of `points` (level-0 px of `reference`) in `current`, from the expected positions
/// `initial` (same length; `points` themselves where nothing is known).
///
/// One outcome per point, in order; points without an initial position are `OutOfImage`. Cost:
/// about 2 microseconds per point and level.
#[must_use]
pub fn track_points(
    reference: &Pyramid,
    current: &Pyramid,
    points: &[Vec2],
    initial: &[Vec2],
    config: &TrackConfig,
) -> Vec<TrackOutcome> {
    points
        .iter()
        .enumerate()
        .map(|(i, point)| match initial.get(i) {
            None => TrackOutcome::OutOfImage,
            Some(start) => track_point(reference, current, point, start, config),
        })
        .collect()
}

/// Tracks one point there and, if asked for, back.
fn track_point(
    reference: &Pyramid,
    current: &Pyramid,
    point: &Vec2,
    start: &Vec2,
    config: &TrackConfig,
) -> TrackOutcome {
    let found = coarse_to_fine(reference, current, point, start, config.num_levels, config);
    let (fit, level) = match found {
        Ok(found) => found,
        Err(outcome) => return outcome,
    };
    if fit.correlation < config.min_correlation {
        return TrackOutcome::Dissimilar {
            correlation: fit.correlation,
        };
    }
    if let Some(limit) = config.max_back_distance_px {
        // from the next coarser level: enough to slide away from a wrong match, cheap
        let levels = config.num_levels.min(level + 2);
        match coarse_to_fine(current, reference, &fit.pixel, point, levels, config) {
            Err(outcome) => return outcome,
            Ok((back, _)) => {
                let distance_px = (back.pixel - point).norm();
                if distance_px > limit * (1u64 << level) as f64 {
                    return TrackOutcome::Inconsistent { distance_px };
                }
            }
        }
    }
    TrackOutcome::Tracked(fit)
}

/// Aligns on `num_levels` levels, down to the finest on which the patch stands out of the noise,
/// which is returned beside the fit. A coarse level on which the patch does not fit into the images
/// or has no texture is skipped.
fn coarse_to_fine(
    reference: &Pyramid,
    current: &Pyramid,
    point: &Vec2,
    start: &Vec2,
    num_levels: usize,
    config: &TrackConfig,
) -> Result<(PatchFit, usize), TrackOutcome> {
    let limits = AlignLimits {
        max_iterations: config.max_iterations,
        min_step: config.min_step_px,
        max_distance: config.max_level_move_px,
    };
    let levels = num_levels
        .min(reference.num_levels())
        .min(current.num_levels());
    let (finest, own) = finest_level(
        reference,
        point,
        levels.min(COARSEST_FINEST + 1),
        config.min_score,
    )?;
    let mut estimate = *start;
    for level in (finest + 1..levels).rev() {
        let centre = to_f32(&level_pixel(point, level));
        let min_score = min_score(config.min_score, finest, level);
        let Some(template) = Template::sampled(reference.level(level), centre, min_score) else {
            continue;
        };
        let guess = to_f32(&level_pixel(&estimate, level));
        if let Ok(fit) = template.align(current.level(level), guess, &limits)
            && fit.correlation > COARSE_CORRELATION
        {
            estimate = finest_pixel(&to_vec2(fit.centre), level);
        }
    }
    let guess = to_f32(&level_pixel(&estimate, finest));
    let fit = own.align(current.level(finest), guess, &limits)?;
    Ok((finest_fit(&fit, finest), finest))
}

/// The finest of so many levels on which a patch stands out of the noise, and what it looks like
/// there; `least` is the weakest score on level 0.
pub(super) fn finest_level(
    reference: &Pyramid,
    point: &Vec2,
    num_levels: usize,
    least: f32,
) -> Result<(usize, Template), TrackOutcome> {
    for level in 0..num_levels {
        let centre = to_f32(&level_pixel(point, level));
        let patch = sample::<WIDE, _>(reference.level(level), centre);
        let patch = patch.ok_or(TrackOutcome::OutOfImage)?;
        let min_score = min_score(least, level, level);
        if let Some(template) = Template::new(&patch, min_score) {
            return Ok((level, template));
        }
    }
    Err(TrackOutcome::NoTexture)
}

/// Weakest score on a level of a patch that stands out of the noise on `finest` first, where
/// `least` is that on level 0. A strong patch needs as much on every level. A faint one needs less
/// on coarser ones, as there is less noise.
pub(super) fn min_score(least: f32, finest: usize, level: usize) -> f32 {
    if finest == 0 {
        least
    } else {
        least * noise_share(level)
    }
}

/// A coarse result less alike than this is not followed.
const COARSE_CORRELATION: f32 = 0.5;

/// A patch that stands out of the noise on coarser levels only is not found exactly enough.
const COARSEST_FINEST: usize = 2;

pub(super) fn to_f32(pixel: &Vec2) -> [f32; 2] {
    [pixel.x as f32, pixel.y as f32]
}

pub(super) fn to_vec2(pixel: [f32; 2]) -> Vec2 {
    Vec2::new(f64::from(pixel[0]), f64::from(pixel[1]))
}
