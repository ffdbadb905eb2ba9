//! The inverse depth that the sources agree about.

use super::MultiViewConfig;
use super::pixel_projection::{PATTERN, PixelProjection, Projected, SAMPLES};
use crate::DepthPixel;
use monogrid_image::lanes::Lanes;
use monogrid_image::{Image, for_lanes};

/// Of the sources of a pixel, so many of the smallest disparity search.
const SEARCH_SOURCES: usize = 2;
/// The search reaches so many standard deviations of the inverse depth.
const SEARCH_SIGMAS: f64 = 3.0;
/// Least reach of the search, as a share of the inverse depth.
const MIN_SEARCH: f64 = 0.04;
/// Largest reach of the search, as a share of the inverse depth.
const MAX_SEARCH: f64 = 0.15;
/// Step of the search, px.
const SEARCH_STEP_PX: f64 = 1.0;
/// Iterations after the search.
const ITERATIONS: usize = 2;
/// Two sources must correlate by this at least.
const MIN_CORRELATION: f64 = 0.7;
/// Smallest deviation of the residuals of a source, grey levels.
const MIN_GREY_SIGMA: f64 = 2.0;
/// Residuals of a patch that count as one, since neighbours share their errors.
const CORRELATED_RESIDUALS: f64 = 10.0;
/// Relative standard deviation added for what all pixels share (poses).
const SHARED_SIGMA: f64 = 0.008;

/// Steps of the search to each side, at most.
const MAX_STEPS: usize = 15;
/// Sources below this correlation take no part in an iteration.
const MIN_USED_CORRELATION: f32 = 0.5;
/// How far the match of the widest source may move without a search, px.
const CONFIRMED_PX: f64 = 0.8;
/// Motion of that match that ends the iterations, px.
const CONVERGED_PX: f64 = 0.1;
/// Depths farther apart than this contradict each other, standard deviations.
const MAX_GAP_SIGMAS: f64 = 2.0;
/// What a source costs at most in the search: it may be occluded.
const MAX_COST: f32 = 0.7;
/// Patches of less contrast (root of the sum of squares, grey levels) have no depth to find.
const MIN_CONTRAST: f32 = 8.0;
/// Contrast below which a patch of a source counts as noise, grey levels.
pub(super) const NOISE_CONTRAST: f32 = 4.0;

/// Refines the pixels of one keyframe, one after the other.
pub(super) struct Search<'a> {
    image: &'a Image<u8>,
    sources: &'a [Projected<'a>],
    config: &'a MultiViewConfig,
    /// Of the present pixel, largest disparity first.
    pub projections: Vec<PixelProjection<'a>>,
}

/// The surroundings of a pixel in the keyframe: mean 0, norm 1.
pub(super) struct Patch([f32; SAMPLES]);

/// What one iteration found.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Normal {
    /// Sum of squares of the derivative of ln(rho), by the variance of the residuals.
    hessian: f64,
    gradient: f64,
    /// Sum over the sources of gradient² / hessian.
    gains: f64,
    /// Sources that took part.
    used: usize,
    /// Sources that agree.
    agreeing: usize,
}

impl<'a> Search<'a> {
    pub fn new(
        image: &'a Image<u8>,
        sources: &'a [Projected<'a>],
        config: &'a MultiViewConfig,
    ) -> Self {
        Self {
            image,
            sources,
            config,
            projections: Vec::with_capacity(sources.len()),
        }
    }

    /// A better depth of a pixel; `None` where fewer than two sources see it or agree.
    pub fn refine(&mut self, pixel: &DepthPixel) -> Option<DepthPixel> {
        let patch = Patch::around(self.image, pixel)?;
        self.find_projections(pixel)?;
        let (idepth, variance) = self.confirm(pixel, &patch).or_else(|| {
            let (start, step) = self.best_of_range(pixel, &patch)?;
            self.iterate(start, 1.5 * step, 2, &patch)
        })?;
        let variance = variance + SHARED_SIGMA.powi(2);
        Some(fused(pixel, idepth, variance * idepth * idepth))
    }

    /// Finds the sources that see the pixel with the largest disparity; `None` if there are not
    /// two.
    pub fn find_projections(&mut self, pixel: &DepthPixel) -> Option<()> {
        let direction = gradient_direction(self.image, pixel)?;
        let at = [f64::from(pixel.x), f64::from(pixel.y)];
        let idepth = f64::from(pixel.idepth);
        let projections = &mut self.projections;
        projections.clear();
        let seen = |source| PixelProjection::new(source, at, idepth, direction, self.config);
        projections.extend(self.sources.iter().filter_map(seen));
        // stable: equal ones in the order of the sources
        projections.sort_by(|a, b| b.disparity.total_cmp(&a.disparity));
        projections.truncate(self.config.max_sources);
        projections
            .iter_mut()
            .for_each(PixelProjection::lay_out_patch);
        (projections.len() >= 2).then_some(())
    }

    /// Most depths are right to within a pixel, and all sources say so: these need no search.
    fn confirm(&self, pixel: &DepthPixel, patch: &Patch) -> Option<(f64, f64)> {
        let reach = CONFIRMED_PX / self.projections.first()?.disparity;
        self.iterate(pixel.idepth.into(), reach, self.projections.len(), patch)
    }

    /// The best correlation around the present depth, over the sources of the smallest disparity:
    /// the inverse depth and the relative step of the search. `None` at the ends of the range.
    fn best_of_range(&self, pixel: &DepthPixel, patch: &Patch) -> Option<(f64, f64)> {
        let idepth = f64::from(pixel.idepth);
        let sigma = f64::from(pixel.idepth_var).sqrt() / idepth;
        let range = (SEARCH_SIGMAS * sigma).clamp(MIN_SEARCH, MAX_SEARCH);
        let first = self.projections.len().saturating_sub(SEARCH_SOURCES);
        let projections = &self.projections[first..];
        let step = (SEARCH_STEP_PX / projections.first()?.disparity).min(range / 2.0);
        let steps = ((range / step).ceil() as usize).min(MAX_STEPS);
        let at = |index: usize| idepth * (1.0 + step * (index as f64 - steps as f64));
        let mut costs = [f32::INFINITY; 2 * MAX_STEPS + 1];
        for (index, cost) in costs.iter_mut().enumerate().take(2 * steps + 1) {
            let costs = projections
                .iter()
                .map(|projection| cost_at(projection, at(index), patch));
            *cost = costs.sum();
        }
        let best = (0..=2 * steps).min_by(|a, b| costs[*a].total_cmp(&costs[*b]))?;
        if best == 0 || best == 2 * steps {
            return None;
        }
        let offset = parabola_minimum(&costs[best - 1..=best + 1]);
        Some((at(best) + idepth * step * offset, step))
    }

    /// Gauss-Newton from `start`: the inverse depth and the variance of its logarithm. `None` if it
    /// leads farther away than `reach` (relatively), or if fewer than `min_agreeing` sources agree.
    fn iterate(
        &self,
        start: f64,
        reach: f64,
        min_agreeing: usize,
        patch: &Patch,
    ) -> Option<(f64, f64)> {
        let converged = CONVERGED_PX / self.projections.first()?.disparity;
        let mut idepth = start;
        let mut variance = f64::INFINITY;
        for _ in 0..ITERATIONS {
            let normal = normal_equation(&self.projections, idepth, patch);
            if normal.agreeing < min_agreeing || normal.hessian <= 0.0 {
                return None;
            }
            variance = normal.variance(CORRELATED_RESIDUALS);
            let update = -(normal.gradient / normal.hessian).clamp(-reach, reach);
            idepth *= 1.0 + update;
            if (idepth / start - 1.0).abs() > reach {
                return None;
            }
            if update.abs() < converged {
                break;
            }
        }
        Some((idepth, variance))
    }
}

impl Normal {
    /// Variance of ln(rho): what the residuals leave open, times how much more the sources disagree
    /// than that explains (errors of their poses); never less than the former.
    fn variance(&self, correlated_residuals: f64) -> f64 {
        let from_residuals = correlated_residuals / self.hessian;
        // each source alone would move by -gradient / hessian; the weighted sum of squares around
        // the mean
        let scatter = self.gains - self.gradient * self.gradient / self.hessian;
        let freedom = self.used.saturating_sub(1).max(1) as f64;
        from_residuals * (scatter / (freedom * correlated_residuals)).max(1.0)
    }
}

impl Patch {
    /// `None` at the border of the image, without contrast, or without depth.
    pub fn around(image: &Image<u8>, pixel: &DepthPixel) -> Option<Self> {
        let (x, y) = (i32::from(pixel.x), i32::from(pixel.y));
        let (width, height) = (image.width() as i32, image.height() as i32);
        let is_inside = x >= 2 && y >= 2 && x < width - 2 && y < height - 2;
        let has_depth = pixel.idepth > 0.0 && pixel.idepth.is_finite() && pixel.idepth_var >= 0.0;
        if !is_inside || !has_depth {
            return None;
        }
        let mut values =
            PATTERN.map(|[dx, dy]| f32::from(image.row((y + dy) as usize)[(x + dx) as usize]));
        center(&mut values);
        let contrast = norm(&values);
        (contrast >= MIN_CONTRAST).then(|| Self(values.map(|v| v / contrast)))
    }

    #[inline(always)]
    pub fn dot(&self, values: &[f32; SAMPLES]) -> f32 {
        dot(&self.0, values)
    }

    /// What is left of values without so much of the patch.
    #[inline(always)]
    pub fn without(&self, gain: f32, mut values: [f32; SAMPLES]) -> [f32; SAMPLES] {
        for (value, patch) in values.iter_mut().zip(&self.0) {
            *value -= gain * patch;
        }
        values
    }
}

/// What was known before with what the sources say, or the latter alone where they contradict each
/// other.
fn fused(before: &DepthPixel, idepth: f64, variance: f64) -> DepthPixel {
    let (prior, prior_variance) = (f64::from(before.idepth), f64::from(before.idepth_var));
    let gap_sq = (prior - idepth).powi(2);
    let (idepth, variance) = if gap_sq <= MAX_GAP_SIGMAS.powi(2) * (prior_variance + variance) {
        let weight = variance / (prior_variance + variance);
        (idepth + weight * (prior - idepth), prior_variance * weight)
    } else {
        (idepth, variance)
    };
    DepthPixel {
        idepth: idepth as f32,
        idepth_var: variance as f32,
        ..*before
    }
}

for_lanes! {
    /// Residuals of all sources after gain and bias, and their derivative by ln(rho).
    pub(super) fn normal_equation = normal_equation_with, (
        projections: &[PixelProjection<'_>],
        idepth: f64,
        patch: &Patch,
    ) -> Normal;
    /// One less the normalised correlation, limited.
    fn cost_at = cost_at_with, (
        projection: &PixelProjection<'_>, idepth: f64, patch: &Patch
    ) -> f32;
}

#[inline(always)]
pub(super) fn normal_equation_with<L: Lanes>(
    lanes: L,
    projections: &[PixelProjection<'_>],
    idepth: f64,
    patch: &Patch,
) -> Normal {
    let mut normal = Normal::default();
    for projection in projections {
        let Some([x, y]) = projection.center(idepth) else {
            continue;
        };
        // one pixel along the epipolar line
        let motion = projection.motion(idepth);
        let length_sq: f64 = motion[0] * motion[0] + motion[1] * motion[1];
        let length = length_sq.sqrt().max(1e-3);
        let half = [0.5 * motion[0] / length, 0.5 * motion[1] / length];
        let before = projection.values(lanes, [x - half[0], y - half[1]]);
        let after = projection.values(lanes, [x + half[0], y + half[1]]);
        let (mut value, mut slope) = ([0.0; SAMPLES], [0.0; SAMPLES]);
        for (i, (b, a)) in before.iter().zip(&after).enumerate() {
            value[i] = 0.5 * (b + a);
            slope[i] = (a - b) * length as f32;
        }
        center(&mut value);
        center(&mut slope);
        let gain = patch.dot(&value);
        let correlation = gain / norm(&value).max(NOISE_CONTRAST);
        if correlation < MIN_USED_CORRELATION {
            continue;
        }
        normal.agreeing += usize::from(correlation > MIN_CORRELATION as f32);
        // what a gain explains is no residual
        let value = patch.without(gain, value);
        let slope = patch.without(patch.dot(&slope), slope);
        let (jr, jj) = (dot(&slope, &value), dot(&slope, &slope));
        let rr = f64::from(dot(&value, &value));
        let freedom = (SAMPLES - 3) as f64;
        let variance = (rr / freedom).max(MIN_GREY_SIGMA.powi(2));
        let (hessian, gradient) = (f64::from(jj) / variance, f64::from(jr) / variance);
        if hessian > 0.0 {
            normal.hessian += hessian;
            normal.gradient += gradient;
            normal.gains += gradient * gradient / hessian;
            normal.used += 1;
        }
    }
    normal
}

#[inline(always)]
fn cost_at_with<L: Lanes>(
    lanes: L,
    projection: &PixelProjection<'_>,
    idepth: f64,
    patch: &Patch,
) -> f32 {
    let Some(at) = projection.center(idepth) else {
        return MAX_COST;
    };
    let mut values = projection.values(lanes, at);
    center(&mut values);
    (1.0 - patch.dot(&values) / norm(&values).max(NOISE_CONTRAST)).min(MAX_COST)
}

/// Takes the mean away.
#[inline(always)]
pub(super) fn center(values: &mut [f32; SAMPLES]) {
    let mean = sum(values) / SAMPLES as f32;
    for value in values {
        *value -= mean;
    }
}

#[inline(always)]
pub(super) fn norm(values: &[f32; SAMPLES]) -> f32 {
    dot(values, values).sqrt()
}

/// In four lanes, which vectorises.
#[inline(always)]
fn sum(values: &[f32; SAMPLES]) -> f32 {
    let mut lanes = [0.0; 4];
    for four in values.chunks_exact(4) {
        for (lane, value) in lanes.iter_mut().zip(four) {
            *lane += value;
        }
    }
    (lanes[0] + lanes[2]) + (lanes[1] + lanes[3])
}

#[inline(always)]
pub(super) fn dot(a: &[f32; SAMPLES], b: &[f32; SAMPLES]) -> f32 {
    let mut products = [0.0; SAMPLES];
    for ((product, a), b) in products.iter_mut().zip(a).zip(b) {
        *product = a * b;
    }
    sum(&products)
}

/// Unit vector of the gradient at a pixel that is not at the border; `None` without one.
fn gradient_direction(image: &Image<u8>, pixel: &DepthPixel) -> Option<[f64; 2]> {
    let (x, y) = (usize::from(pixel.x), usize::from(pixel.y));
    let row = image.row(y);
    let dx = f64::from(row[x + 1]) - f64::from(row[x - 1]);
    let dy = f64::from(image.row(y + 1)[x]) - f64::from(image.row(y - 1)[x]);
    let length = (dx * dx + dy * dy).sqrt();
    (length > 0.0).then(|| [dx / length, dy / length])
}

/// Where a parabola through three equidistant costs is least, in steps from the middle.
fn parabola_minimum(costs: &[f32]) -> f64 {
    let [a, b, c] = [costs[0], costs[1], costs[2]].map(f64::from);
    let curvature = a - 2.0 * b + c;
    if curvature > 1e-6 {
        (0.5 * (a - c) / curvature).clamp(-0.5, 0.5)
    } else {
        0.0
    }
}
