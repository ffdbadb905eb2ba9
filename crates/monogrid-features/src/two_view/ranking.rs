//! Comparison of refined motions on one robust cost, and what is reported of them.

use super::problem::{Problem, median};
use super::refine::{Refined, uncertainty};
use super::types::{TriangulatedPoint, TwoView, TwoViewConfig};
use monogrid_geometry::median::SIGMA_OF_MEDIAN;

/// A refined motion with its cost on the common scale.
pub(super) struct Ranked<'a> {
    refined: &'a Refined,
    inliers: Vec<bool>,
    sigma_px: f64,
    cost_per_match: f64,
    /// Standard deviation of each inverse depth for a pixel noise of one.
    unit_idepth_sigmas: Vec<f64>,
    unit_direction_sigma: f64,
}

/// Truncation of the squared normalised error: three standard deviations.
const OUTLIER_CHI_SQ: f64 = 9.0;
/// A point is behind a camera when its inverse depth is below zero by this many deviations.
const BEHIND_SIGMAS: f64 = 3.0;
/// Motions closer than this are one (rotation, direction of translation, radians).
const SAME_MOTION: (f64, f64) = (0.02, 0.2);

/// The best motion and its rivals, best first, without duplicates.
pub(super) fn rank<'a>(
    problem: &Problem,
    refined: &'a mut [Refined],
    config: &TwoViewConfig,
) -> Vec<Ranked<'a>> {
    let refined: &'a [Refined] = refined;
    let evaluate = |sigma_px: f64| -> Vec<Ranked<'a>> {
        let evaluate = |r| evaluate_motion(problem, r, sigma_px);
        let mut ranked: Vec<Ranked<'a>> = refined.iter().map(evaluate).collect();
        ranked.sort_by(|a, b| a.cost_per_match.total_cmp(&b.cost_per_match));
        ranked
    };
    let first = evaluate(config.sigma_px);
    let Some(best) = first.first() else {
        return first;
    };
    // the noise as the best motion sees it decides how much worse a rival may be
    let errors = (0..problem.len()).filter(|&i| best.inliers[i]);
    let spread =
        SIGMA_OF_MEDIAN * median(errors.map(|i| best.refined.errors_sq[i].sqrt()).collect());
    let sigma_px = spread.clamp(0.15 * config.sigma_px, config.sigma_px);
    let mut out: Vec<Ranked<'a>> = Vec::new();
    for candidate in evaluate(sigma_px) {
        let is_rival = out.first().is_none_or(|best: &Ranked| {
            let margin = (config.rival_margin * best.cost_per_match)
                .max(MIN_RIVAL_CHI_SQ / problem.len() as f64);
            candidate.cost_per_match < best.cost_per_match + margin
        });
        let is_new = out.iter().all(|other| !same_motion(other, &candidate));
        if is_rival && is_new && out.len() < MAX_RIVALS {
            out.push(candidate);
        }
    }
    out
}

/// A difference in chi squared below this says nothing.
const MIN_RIVAL_CHI_SQ: f64 = 15.0;
/// Most motions that are returned.
const MAX_RIVALS: usize = 4;

fn same_motion(a: &Ranked, b: &Ranked) -> bool {
    let (a, b) = (&a.refined.b_from_a, &b.refined.b_from_a);
    a.rotation.angle_to(&b.rotation) < SAME_MOTION.0
        && a.translation.angle(&b.translation) < SAME_MOTION.1
}

fn evaluate_motion<'a>(problem: &Problem, refined: &'a Refined, sigma_px: f64) -> Ranked<'a> {
    let limit = OUTLIER_CHI_SQ * sigma_px * sigma_px;
    let close: Vec<bool> = refined.errors_sq.iter().map(|e| *e < limit).collect();
    let uncertainty = uncertainty(problem, refined, &close);
    let unit_idepth_sigmas: Vec<f64> = uncertainty.idepth_vars.iter().map(|v| v.sqrt()).collect();
    let mut cost = 0.0;
    let mut inliers = close;
    for (i, inlier) in inliers.iter_mut().enumerate() {
        let sigma = unit_idepth_sigmas[i] * sigma_px;
        *inlier &= refined.idepths[i] > -BEHIND_SIGMAS * sigma;
        cost += if *inlier {
            refined.errors_sq[i] / (sigma_px * sigma_px)
        } else {
            OUTLIER_CHI_SQ
        };
    }
    let unit_direction_sigma = uncertainty.pose.map_or(f64::INFINITY, |covariance| {
        let direction = covariance.fixed_view::<2, 2>(3, 3).into_owned();
        direction.symmetric_eigenvalues().max().max(0.0).sqrt()
    });
    Ranked {
        refined,
        inliers,
        sigma_px,
        cost_per_match: cost / problem.len() as f64,
        unit_idepth_sigmas,
        unit_direction_sigma,
    }
}

/// The public description of a ranked motion.
pub(super) fn summarise(
    problem: &Problem,
    ranked: &Ranked,
    rotation_errors: &[f64],
    homography_share: f64,
) -> TwoView {
    let pose = &ranked.refined.b_from_a;
    let mut points = vec![None; problem.len()];
    let (mut parallaxes, mut relative_sigmas) = (Vec::new(), Vec::new());
    let mut inlier_rotation_errors = Vec::new();
    for (i, &is_inlier) in ranked.inliers.iter().enumerate() {
        if !is_inlier {
            continue;
        }
        let idepth = ranked.refined.idepths[i];
        let idepth_sigma = ranked.unit_idepth_sigmas[i] * ranked.sigma_px;
        points[i] = Some(TriangulatedPoint {
            idepth,
            idepth_sigma,
        });
        let ray = pose.rotation * problem.a[i];
        parallaxes.push(ray.angle(&(ray + pose.translation * idepth)).to_degrees());
        relative_sigmas.push(idepth_sigma / idepth.max(1e-9));
        inlier_rotation_errors.push(rotation_errors[i]);
    }
    TwoView {
        b_from_a: *pose,
        num_inliers: parallaxes.len(),
        parallax_deg: median(parallaxes),
        rotation_residual_px: median(inlier_rotation_errors),
        direction_sigma_deg: (ranked.unit_direction_sigma * ranked.sigma_px).to_degrees(),
        relative_idepth_sigma: median(relative_sigmas),
        residual_px: ranked.sigma_px,
        cost_per_match: ranked.cost_per_match,
        homography_share,
        points,
    }
}
