//! Pyramidal Lucas-Kanade tracking of many points from one image to another.

use super::patch::finest_fit;
use super::template::{AlignLimits, LevelFailure, PatchFit, Template, WIDE, sample};
use crate::level_pixel;
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
    /// Smallest mean squared gradient of a patch in its weakest direction over the variance of the
    /// noise of its level. A patch is not refined on levels that show less. Default 0.4.
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
            min_score: 0.4,
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
/// which is told with the fit. Coarser levels on which it does not fit into the images are skipped.
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
    let mut estimate = *start;
    let mut finest = Err(TrackOutcome::NoTexture);
    for level in (0..levels).rev() {
        let centre = to_f32(&level_pixel(point, level));
        let Some(patch) = sample::<WIDE, _>(reference.level(level), centre) else {
            finest = Err(TrackOutcome::OutOfImage);
            continue;
        };
        let min_score = config.min_score * reference.noise_sigma(level).powi(2);
        let Some(template) = Template::new(&patch, min_score) else {
            continue;
        };
        let guess = to_f32(&level_pixel(&estimate, level));
        let found = template.align(current.level(level), guess, &limits);
        match found {
            Ok(fit) if level == 0 || fit.correlation > COARSE_CORRELATION => {
                let fit = finest_fit(&fit, level);
                estimate = fit.pixel;
                finest = Ok((fit, level));
            }
            Ok(fit) => {
                finest = Err(TrackOutcome::Dissimilar {
                    correlation: fit.correlation,
                });
            }
            Err(failure) => finest = Err(failure.into()),
        }
    }
    match finest {
        Ok((_, level)) if level > COARSEST_RESULT => Err(TrackOutcome::NoTexture),
        finest => finest,
    }
}

/// A coarse result less alike than this is not followed.
const COARSE_CORRELATION: f32 = 0.5;

/// A patch that stands out of the noise only on coarser levels than this is not found exactly.
const COARSEST_RESULT: usize = 2;

pub(super) fn to_f32(pixel: &Vec2) -> [f32; 2] {
    [pixel.x as f32, pixel.y as f32]
}

pub(super) fn to_vec2(pixel: [f32; 2]) -> Vec2 {
    Vec2::new(f64::from(pixel[0]), f64::from(pixel[1]))
}
