//! Relative pose and inverse depths from matches between two images.
//!
//! Sampling proposes several essential matrices (five points) and a homography (four points); every
//! motion they allow is refined by bundle adjustment and compared on the same robust cost. The best
//! is believed only if it is clearly better than any other, if the matches have parallax that no
//! rotation explains, and if the direction of translation is well determined.

mod five_point;
mod homography;
mod problem;
mod ranking;
mod refine;
mod sampling;
#[cfg(test)]
mod tests;
mod types;

use crate::Rng;
use homography::decompose;
use monogrid_geometry::nalgebra::{Matrix3, Rotation3};
use monogrid_geometry::{Mat3, Pinhole, Rotation, Se3, Vec2, Vec3};
use problem::{Problem, median};
use ranking::{rank, summarise};
use refine::{Refined, midpoint_idepth, refine};
pub use types::{Match, TriangulatedPoint, TwoView, TwoViewConfig, TwoViewOutcome};

use sampling::{best_homography, best_rotation, essential_hypotheses};

/// Estimates the motion between two views and the inverse depth of every match.
///
/// Deterministic for a given seed. About 10 ms for 400 matches.
#[must_use]
pub fn two_view(matches: &[Match], pinhole: &Pinhole, config: &TwoViewConfig) -> TwoViewOutcome {
    let finite = |v: &Vec2| v.iter().all(|c| c.is_finite());
    let usable: Vec<usize> = (0..matches.len())
        .filter(|&i| finite(&matches[i].a) && finite(&matches[i].b))
        .collect();
    // eight: below it nothing is over-determined
    let needed = config.min_matches.max(8);
    if usable.len() < needed {
        return TwoViewOutcome::TooFewMatches {
            found: usable.len(),
            needed,
        };
    }
    let kept: Vec<Match> = usable.iter().map(|&i| matches[i]).collect();
    let problem = Problem::new(&kept, pinhole);
    let mut rng = Rng::new(config.seed);
    let rotation = best_rotation(&problem, config.sigma_px, &mut rng);
    let rotation_errors: Vec<f64> = (0..problem.len())
        .map(|i| problem.rotation_sq_px(&rotation, i).sqrt())
        .collect();
    let rotation_residual_px = median(rotation_errors.clone());
    if rotation_residual_px < config.min_rotation_residual_px {
        return TwoViewOutcome::NotEnoughParallax {
            parallax_deg: 0.0,
            rotation_residual_px,
        };
    }
    let (motions, homography_share) = candidate_motions(&problem, config, &mut rng);
    let mut refined: Vec<Refined> = motions
        .iter()
        .filter_map(|motion| refine(&problem, motion, config.sigma_px))
        .collect();
    let ranked = rank(&problem, &mut refined, config);
    let mut solutions: Vec<TwoView> = ranked
        .iter()
        .map(|r| summarise(&problem, r, &rotation_errors, homography_share))
        .collect();
    for solution in &mut solutions {
        scatter(solution, &usable, matches.len());
    }
    judge(solutions, kept.len(), config)
}

/// Decides what to make of the best solutions, best first.
fn judge(solutions: Vec<TwoView>, num: usize, config: &TwoViewConfig) -> TwoViewOutcome {
    let Some(best) = solutions.first() else {
        return TwoViewOutcome::NoMotion { inlier_ratio: 0.0 };
    };
    let inlier_ratio = best.num_inliers as f64 / num as f64;
    if inlier_ratio < config.min_inlier_ratio {
        return TwoViewOutcome::NoMotion { inlier_ratio };
    }
    // written so that NaN refuses
    let has_parallax = best.parallax_deg >= config.min_parallax_deg
        && best.rotation_residual_px >= config.min_rotation_residual_px;
    if !has_parallax {
        return TwoViewOutcome::NotEnoughParallax {
            parallax_deg: best.parallax_deg,
            rotation_residual_px: best.rotation_residual_px,
        };
    }
    let is_certain = best.direction_sigma_deg <= config.max_direction_sigma_deg
        && best.relative_idepth_sigma <= config.max_relative_idepth_sigma;
    if !is_certain {
        return TwoViewOutcome::Uncertain {
            direction_sigma_deg: best.direction_sigma_deg,
            relative_idepth_sigma: best.relative_idepth_sigma,
        };
    }
    if solutions.len() > 1 {
        return TwoViewOutcome::Ambiguous {
            candidates: solutions,
        };
    }
    match solutions.into_iter().next() {
        Some(best) => TwoViewOutcome::Accepted(Box::new(best)),
        None => TwoViewOutcome::NoMotion { inlier_ratio: 0.0 },
    }
}

/// Every motion that the sampled models allow, and R_H.
fn candidate_motions(problem: &Problem, config: &TwoViewConfig, rng: &mut Rng) -> (Vec<Se3>, f64) {
    let sigma_sq = config.sigma_px * config.sigma_px;
    // 95 % of the errors of inliers: one degree of freedom for a line, two for a point
    let (limit_e, limit_h) = (3.84 * sigma_sq, 5.99 * sigma_sq);
    let essentials = essential_hypotheses(problem, limit_e, config.iterations, rng);
    let homography = best_homography(problem, limit_h, config.iterations, rng);
    let mut motions = Vec::new();
    let score = |cost: f64| limit_e * problem.len() as f64 - cost;
    let best_score = essentials.first().map_or(0.0, |e| score(e.cost));
    for essential in &essentials {
        if score(essential.cost) < MIN_SCORE_RATIO * best_score {
            break;
        }
        motions.extend(essential_motions(problem, &essential.model, limit_e));
    }
    let num = problem.len() as f64;
    let mut share = 0.0;
    if let Some(h) = &homography {
        // scores on a common scale: what an outlier of the homography loses
        let score_h = limit_h * num - h.cost;
        let score_e = essentials.first().map_or(0.0, |e| {
            (limit_e * num - e.cost)
                + (limit_h - limit_e) * inlier_count(problem, &e.model, limit_e)
        });
        share = score_h / (score_h + score_e).max(1e-12);
        let backward = h.model.try_inverse().unwrap_or_else(Mat3::identity);
        let (a, b): (Vec<Vec3>, Vec<Vec3>) = (0..problem.len())
            .filter(|&i| problem.transfer_sq_px(&h.model, &backward, i) < limit_h)
            .map(|i| (problem.a[i], problem.b[i]))
            .unzip();
        motions.extend(decompose(&h.model, &a, &b));
    }
    (motions, share)
}

/// A hypothesis with less than this share of the best score cannot win by refinement.
const MIN_SCORE_RATIO: f64 = 0.75;

fn inlier_count(problem: &Problem, essential: &Mat3, limit: f64) -> f64 {
    (0..problem.len())
        .filter(|&i| problem.sampson_sq_px(essential, i) < limit)
        .count() as f64
}

/// The motions of an essential matrix that put most inliers in front of both cameras.
fn essential_motions(problem: &Problem, essential: &Mat3, limit_sq_px: f64) -> Vec<Se3> {
    let svd = essential.svd(true, true);
    let (Some(mut u), Some(mut v_t)) = (svd.u, svd.v_t) else {
        return Vec::new();
    };
    if u.determinant() < 0.0 {
        u = -u;
    }
    if v_t.determinant() < 0.0 {
        v_t = -v_t;
    }
    let w: Mat3 = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
    let direction: Vec3 = u.column(2).into_owned();
    let mut motions = Vec::with_capacity(4);
    for rotation in [u * w * v_t, u * w.transpose() * v_t] {
        let rotation = Rotation::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
        motions.push(Se3::new(rotation, direction));
        motions.push(Se3::new(rotation, -direction));
    }
    let inliers: Vec<usize> = (0..problem.len())
        .filter(|&i| problem.sampson_sq_px(essential, i) < limit_sq_px)
        .collect();
    let counts: Vec<usize> = motions
        .iter()
        .map(|motion| {
            let in_front = |i: usize| {
                let idepth = midpoint_idepth(problem, motion, i);
                let depth_ratio =
                    (motion.rotation * problem.a[i]).z + motion.translation.z * idepth;
                idepth > 0.0 && depth_ratio > 0.0
            };
            inliers.iter().filter(|&&i| in_front(i)).count()
        })
        .collect();
    let most = counts.iter().copied().max().unwrap_or(0);
    motions
        .into_iter()
        .zip(counts)
        // one that puts nearly as many in front is not excluded yet
        .filter(|(_, count)| *count > 0 && 10 * count >= 7 * most)
        .map(|(motion, _)| motion)
        .collect()
}

/// Puts the points back to the indices of the matches that were given.
fn scatter(solution: &mut TwoView, usable: &[usize], num: usize) {
    let mut points = vec![None; num];
    for (point, &index) in solution.points.iter().zip(usable) {
        points[index] = *point;
    }
    solution.points = points;
}
