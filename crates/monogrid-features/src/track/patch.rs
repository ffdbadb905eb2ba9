//! Patches anchored in a keyframe, warped to the current view and found again: the sparse layer.

use super::points::{TrackOutcome, finest_level, min_score, to_f32, to_vec2};
use super::template::{
    AlignLimits, LevelFailure, LevelFit, PatchFit, SIDE, Template, WIDE, centre_of_corner,
    integer_corner,
};
use crate::{finest_pixel, level_pixel};
use monogrid_geometry::nalgebra::Matrix2;
use monogrid_geometry::{Pinhole, Se3, Vec2};
use monogrid_image::lanes::{LANES, Lanes, bilinear};
use monogrid_image::{GrayImage, Pyramid, bilinear_inside, for_lanes};

/// Settings of the search for a patch.
#[derive(Clone, Debug, PartialEq)]
pub struct PatchSearchConfig {
    /// Radius of the coarse search around the predicted pixel, level-0 px. Default 20;
    /// 0 refines only.
    pub radius_px: f64,
    /// Level of the coarse search. Default 2.
    pub search_level: usize,
    /// Most candidates of the coarse search that are refined. Default 3.
    pub max_candidates: usize,
    /// Most iterations per level. Default 12.
    pub max_iterations: usize,
    /// A step shorter than this ends a level, px of the level. Default 0.01.
    pub min_step_px: f32,
    /// Smallest correlation of the finest patch. Default 0.8.
    pub min_correlation: f32,
    /// A second place whose `1 - correlation` is at most this many times that of the best makes
    /// the match ambiguous. Default 1.5.
    pub min_dissimilarity_ratio: f32,
    /// Weakest mean squared gradient of a patch on level 0, (grey levels / px)². Default 2. One
    /// that shows less there is found on the finest level on which it stands out of the noise.
    pub min_score: f32,
}

impl Default for PatchSearchConfig {
    fn default() -> Self {
        Self {
            radius_px: 20.0,
            search_level: 2,
            max_candidates: 3,
            max_iterations: 12,
            min_step_px: 0.01,
            min_correlation: 0.8,
            min_dissimilarity_ratio: 1.5,
            min_score: 2.0,
        }
    }
}

/// A patch of a reference image as a current view sees it on one pyramid level.
#[derive(Clone, Debug)]
pub struct ReferencePatch {
    template: Template,
    level: usize,
}

impl ReferencePatch {
    /// Samples the patch around `pixel` (level-0 px of `reference`) for level `level` of a current
    /// image. `reference_from_current` maps small offsets in the current image to offsets in the
    /// reference, see [`patch_warp`].
    ///
    /// The level of `reference` is chosen so that its pixels are about as large as those it is
    /// compared with.
    ///
    /// # Errors
    /// `OutOfImage` or `NoTexture`.
    pub fn new(
        reference: &Pyramid,
        pixel: &Vec2,
        reference_from_current: &Matrix2<f64>,
        level: usize,
        min_score: f32,
    ) -> Result<Self, TrackOutcome> {
        let wide = warped(reference, pixel, reference_from_current, level)
            .ok_or(TrackOutcome::OutOfImage)?;
        let template = Template::new(&wide, min_score).ok_or(TrackOutcome::NoTexture)?;
        Ok(Self { template, level })
    }
}

/// Finds the patch around `pixel` of `reference` in `current`, near `predicted`.
///
/// Coarse search by correlation on `config.search_level`, then the best few places are refined on
/// every finer level, and the best of them is taken unless another is about as good.
#[must_use]
pub fn find_patch(
    reference: &Pyramid,
    pixel: &Vec2,
    reference_from_current: &Matrix2<f64>,
    current: &Pyramid,
    predicted: &Vec2,
    config: &PatchSearchConfig,
) -> TrackOutcome {
    let coarsest = config
        .search_level
        .min(current.num_levels().saturating_sub(1));
    let mut patches: Vec<ReferencePatch> = Vec::with_capacity(coarsest + 1);
    for level in 0..=coarsest {
        let finest = patches.first().map_or(level, |patch| patch.level);
        let min_score = min_score(config.min_score, finest, level);
        let warp = reference_from_current;
        let patch = ReferencePatch::new(reference, pixel, warp, level, min_score);
        match patch {
            Ok(patch) => patches.push(patch),
            // nothing but noise on this level: the next one shows more
            Err(TrackOutcome::NoTexture) if patches.is_empty() && level < coarsest => {}
            Err(outcome) if patches.is_empty() => return outcome,
            // too close to the border or too smooth up there: search on the finer levels only
            Err(_) => break,
        }
    }
    let Some(last) = patches.last() else {
        return TrackOutcome::OutOfImage;
    };
    let starts = coarse_candidates(last, current.level(last.level), predicted, config);
    let mut fits: Vec<PatchFit> = Vec::new();
    let mut failure = TrackOutcome::OutOfImage;
    for start in &starts {
        match refine(&patches, current, start, config) {
            Ok(fit) => fits.push(fit),
            Err(outcome) => failure = outcome,
        }
    }
    fits.sort_by(|a, b| b.correlation.total_cmp(&a.correlation));
    let Some(best) = fits.first() else {
        return failure;
    };
    let limit = config.min_dissimilarity_ratio * (1.0 - best.correlation);
    for rival in &fits[1..] {
        let distance_px = (rival.pixel - best.pixel).norm();
        if distance_px > 1.0 && 1.0 - rival.correlation <= limit {
            return TrackOutcome::Ambiguous { distance_px };
        }
    }
    accept(*best, config)
}

/// The finest level on which the patch around `pixel` (level-0 px) stands out of the noise; the
/// coarsest level of the search where it stands out on none. [`find_patch`] finds it there, so that
/// a pixel of this level is how exactly it is found.
#[must_use]
pub fn patch_level(image: &Pyramid, pixel: &Vec2, config: &PatchSearchConfig) -> usize {
    let coarsest = config
        .search_level
        .min(image.num_levels().saturating_sub(1));
    let finest = finest_level(image, pixel, coarsest + 1, config.min_score);
    finest.map_or(coarsest, |(level, _)| level)
}

/// The warp `reference_from_current` of a small patch that faces the reference camera, from its
/// inverse depth (1/u, along the optical axis of the reference) and the relative pose.
///
/// `None` when the point lies behind the current camera or the warp is degenerate.
#[must_use]
pub fn patch_warp(
    pinhole: &Pinhole,
    pixel: &Vec2,
    idepth: f64,
    current_from_reference: &Se3,
) -> Option<Matrix2<f64>> {
    let project = |pixel: &Vec2| {
        // scaled by the inverse depth: points at infinity need no special case
        let ray = pinhole.unproject(pixel);
        let point =
            current_from_reference.rotation * ray + current_from_reference.translation * idepth;
        (point.z > Pinhole::MIN_DEPTH).then(|| pinhole.project(&point))
    };
    let (half, mut columns) = (SIDE as f64 / 2.0, [Vec2::zeros(); 2]);
    for (column, axis) in columns.iter_mut().zip([Vec2::x(), Vec2::y()]) {
        let ahead = project(&(pixel + axis * half))?;
        let behind = project(&(pixel - axis * half))?;
        *column = (ahead - behind) / (2.0 * half);
    }
    Matrix2::from_columns(&columns).try_inverse()
}

/// Refines on every level from that of the last patch down to that of the first.
fn refine(
    patches: &[ReferencePatch],
    current: &Pyramid,
    start: &Vec2,
    config: &PatchSearchConfig,
) -> Result<PatchFit, TrackOutcome> {
    let finest_level = patches.first().map_or(0, |patch| patch.level);
    let mut estimate = *start;
    let mut finest = None;
    for patch in patches.iter().rev() {
        let fit = align_level(patch, current.level(patch.level), &estimate, config);
        match fit {
            Ok(fit) => {
                let fit = finest_fit(&fit, patch.level);
                estimate = fit.pixel;
                finest = Some(fit);
            }
            // a finer level may still find it
            Err(_) if patch.level > finest_level => {}
            Err(failure) => return Err(failure.into()),
        }
    }
    finest.ok_or(TrackOutcome::Diverged)
}

fn align_level(
    patch: &ReferencePatch,
    image: &GrayImage,
    initial: &Vec2,
    config: &PatchSearchConfig,
) -> Result<LevelFit, LevelFailure> {
    let limits = AlignLimits {
        max_iterations: config.max_iterations,
        min_step: config.min_step_px,
        max_distance: MAX_LEVEL_MOVE_PX,
    };
    let start = to_f32(&level_pixel(initial, patch.level));
    patch.template.align(image, start, &limits)
}

/// Furthest move of a refinement, px of the level.
const MAX_LEVEL_MOVE_PX: f32 = 4.0;

fn accept(fit: PatchFit, config: &PatchSearchConfig) -> TrackOutcome {
    if fit.correlation < config.min_correlation {
        return TrackOutcome::Dissimilar {
            correlation: fit.correlation,
        };
    }
    TrackOutcome::Tracked(fit)
}

/// A fit of a level in pixels of the finest.
pub(super) fn finest_fit(fit: &LevelFit, level: usize) -> PatchFit {
    let inv_scale_sq = 1.0 / (1u64 << (2 * level)) as f32;
    PatchFit {
        pixel: finest_pixel(&to_vec2(fit.centre), level),
        correlation: fit.correlation,
        residual_rms: fit.residual_rms,
        gain: fit.gain,
        hessian: fit.hessian.map(|h| h * inv_scale_sq),
    }
}

/// The places of highest correlation within the radius, local maxima on the grid of the level,
/// level-0 px; the prediction itself when there is no radius.
fn coarse_candidates(
    patch: &ReferencePatch,
    image: &GrayImage,
    predicted: &Vec2,
    config: &PatchSearchConfig,
) -> Vec<Vec2> {
    let radius = (config.radius_px / (1u64 << patch.level) as f64).ceil() as i64;
    // NaN fails the comparison too
    let representable = predicted.amax() < 1e6;
    if radius <= 0 || !representable {
        return vec![*predicted];
    }
    let corner = integer_corner(to_f32(&level_pixel(predicted, patch.level)));
    let (left, top) = (corner[0] as i64, corner[1] as i64);
    let side = (2 * radius + 1) as usize;
    let last_left = image.width() as i64 - SIDE as i64;
    let last_top = image.height() as i64 - SIDE as i64;
    let mut scores = vec![f32::NEG_INFINITY; side * side];
    for (j, y) in (top - radius..=top + radius).enumerate() {
        for (i, x) in (left - radius..=left + radius).enumerate() {
            if x >= 0 && y >= 0 && x <= last_left && y <= last_top {
                scores[j * side + i] = patch.template.correlation_at(image, x as usize, y as usize);
            }
        }
    }
    let mut peaks = grid_peaks(&scores, side);
    peaks.truncate(config.max_candidates.max(1));
    peaks
        .iter()
        .map(|&(i, j)| {
            let x = (left - radius + i as i64) as usize;
            let y = (top - radius + j as i64) as usize;
            finest_pixel(&to_vec2(centre_of_corner(x, y)), patch.level)
        })
        .collect()
}

/// Local maxima of a square grid of scores, best first.
fn grid_peaks(scores: &[f32], side: usize) -> Vec<(usize, usize)> {
    let mut peaks = Vec::new();
    for j in 0..side {
        for i in 0..side {
            let value = scores[j * side + i];
            let neighbours = (j.saturating_sub(1)..(j + 2).min(side))
                .flat_map(|y| (i.saturating_sub(1)..(i + 2).min(side)).map(move |x| (x, y)));
            if value > 0.2
                && neighbours
                    .into_iter()
                    .all(|(x, y)| scores[y * side + x] <= value)
            {
                peaks.push((value, (i, j)));
            }
        }
    }
    peaks.sort_by(|a, b| b.0.total_cmp(&a.0));
    peaks.into_iter().map(|(_, at)| at).collect()
}

/// The patch with border around `pixel` (level-0 px of `reference`), as level `level` of an image
/// has it that is mapped there by `reference_from_current`, from the level of `reference` whose
/// pixels are about as large.
pub(super) fn warped(
    reference: &Pyramid,
    pixel: &Vec2,
    reference_from_current: &Matrix2<f64>,
    level: usize,
) -> Option<[[f32; WIDE]; WIDE]> {
    let warp = reference_from_current * (1u64 << level) as f64;
    let magnification = warp.determinant().abs().sqrt();
    if !magnification.is_finite() || reference.num_levels() == 0 {
        return None;
    }
    let reference_level =
        (magnification.max(1.0).log2().round() as usize).min(reference.num_levels() - 1);
    let warp = warp / (1u64 << reference_level) as f64;
    let image = reference.level(reference_level);
    sample_warped(image, &level_pixel(pixel, reference_level), &warp)
}

/// The patch with border whose sample at offset `u` is `image(centre + warp u)`; `None` where it is
/// not all inside.
fn sample_warped(
    image: &GrayImage,
    centre: &Vec2,
    warp: &Matrix2<f64>,
) -> Option<[[f32; WIDE]; WIDE]> {
    const HALF: f64 = (WIDE as f64 - 1.0) / 2.0;
    let offsets: [f64; WIDE] = std::array::from_fn(|k| k as f64 - HALF);
    let across = offsets.map(|offset| [warp.m11 * offset, warp.m21 * offset]);
    let down = offsets.map(|offset| [warp.m12 * offset, warp.m22 * offset]);
    let place = |across: [f64; 2], down: [f64; 2]| {
        [
            (centre.x + (across[0] + down[0])) as f32,
            (centre.y + (across[1] + down[1])) as f32,
        ]
    };
    // nothing lies beyond the corners
    let ends = [0, WIDE - 1];
    let (width, height) = (image.width(), image.height());
    let (right, bottom) = (width as f32 - 1.0, height as f32 - 1.0);
    let is_inside = |[x, y]: [f32; 2]| x >= 0.0 && y >= 0.0 && x <= right && y <= bottom;
    let corners = ends.map(|row| ends.map(|column| place(across[column], down[row])));
    if width < 2 || height < 2 || !corners.as_flattened().iter().all(|c| is_inside(*c)) {
        return None;
    }
    let mut places = [[[0.0f32; LANES]; 2]; EIGHTS];
    for (row, down) in down.into_iter().enumerate() {
        for (column, across) in across.into_iter().enumerate() {
            let (eight, lane) = ((row * WIDE + column) / LANES, (row * WIDE + column) % LANES);
            [places[eight][0][lane], places[eight][1][lane]] = place(across, down);
        }
    }
    let reaches_end = |[x, y]: &[f32; 2]| *x >= right || *y >= bottom;
    let mut values = [[0.0f32; LANES]; EIGHTS];
    if corners.as_flattened().iter().any(reaches_end) {
        for (values, [xs, ys]) in values.iter_mut().zip(&places) {
            *values = std::array::from_fn(|lane| bilinear_inside(image, xs[lane], ys[lane]));
        }
    } else {
        values = values_at(image, &places);
    }
    let mut out = [[0.0f32; WIDE]; WIDE];
    let whole = values.as_flattened().chunks_exact(WIDE);
    out.iter_mut()
        .zip(whole)
        .for_each(|(row, values)| row.copy_from_slice(values));
    Some(out)
}

/// Groups of places that are looked up together in a patch with border; those beyond it are the
/// first pixel.
const EIGHTS: usize = (WIDE * WIDE).div_ceil(LANES);

for_lanes! {
    fn values_at = values_with, (
        image: &GrayImage,
        places: &[[[f32; LANES]; 2]; EIGHTS],
    ) -> [[f32; LANES]; EIGHTS];
}

#[inline(always)]
fn values_with<L: Lanes>(
    lanes: L,
    image: &GrayImage,
    places: &[[[f32; LANES]; 2]; EIGHTS],
) -> [[f32; LANES]; EIGHTS] {
    let mut values = [[0.0; LANES]; EIGHTS];
    for (values, [xs, ys]) in values.iter_mut().zip(places) {
        *values = bilinear(lanes, image, lanes.f32s(xs), lanes.f32s(ys));
    }
    values
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_images::Texture;

    #[test]
    fn patches_are_looked_up_as_single_places_also_at_the_last_pixel() {
        let image = Texture::new(7).render(41, 33, |x, y| (x, y));
        let (sheared, straight) = (Matrix2::new(1.1, 0.2, -0.1, 0.9), Matrix2::identity());
        for (centre, warp) in [
            (Vec2::new(20.3, 16.8), sheared),
            (Vec2::new(20.5, 16.5), straight),
            // ends with the last column, and with the last row
            (Vec2::new(35.5, 16.5), straight),
            (Vec2::new(20.5, 27.5), straight),
        ] {
            let patch = sample_warped(&image, &centre, &warp).expect("inside");
            for (row, values) in patch.iter().enumerate() {
                for (column, value) in values.iter().enumerate() {
                    let place = centre + warp * Vec2::new(column as f64 - 4.5, row as f64 - 4.5);
                    let alone = bilinear_inside(&image, place.x as f32, place.y as f32);
                    assert!((value - alone).abs() < 1e-3, "{place}: {value} {alone}");
                }
            }
        }
        assert!(sample_warped(&image, &Vec2::new(35.6, 16.5), &straight).is_none());
    }
}
