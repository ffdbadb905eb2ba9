//! How well a camera that only turns explains where corners went from one image to another.
//!
//! A camera that turns about its centre sees the same rays again: whatever their depth, pixels move
//! by a homography that its focal length and three angles determine (`[HARTLEY94]`). Where the
//! focal length is not known it is found with the angles, and so is a radial distortion (division
//! model, `[FITZGIBBON01]`).

use monogrid_features::Match;
use monogrid_geometry::median::median;
use monogrid_geometry::{Vec2, Vec3, rotation_exp};
use nalgebra::{SMatrix, SVector};

/// What is known of the lens.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Lens {
    /// Principal point, px.
    pub(crate) centre: Vec2,
    /// Half of the longer side of the image, px: the unit of everything below.
    pub(crate) half: f64,
    /// Focal lengths to begin with, in that unit.
    pub(crate) focals: Vec<f64>,
    /// Standard deviations of the logarithm of the focal length and of the distortion.
    pub(crate) sigma: [f64; 2],
}

/// Standard deviation of a corner, px.
const CORNER_PX: f64 = 0.5;
/// Residual beyond which a corner hardly counts, px.
const LOOSE_PX: f64 = 2.0;
/// Gauss-Newton steps.
const ROUNDS: usize = 16;
/// Strongest distortion.
const MAX_BEND: f64 = 0.6;
/// Three of the rotation, the logarithm of the focal length, the distortion.
type Parameters = SVector<f64, NUM>;
const NUM: usize = 5;
const FOCAL: usize = 3;
const BEND: usize = 4;

/// A rotation that explains how corners went from one image to another.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Turn {
    /// Distance of each corner from where it sends it, px.
    pub(crate) residuals: Vec<f64>,
    /// The focal length that belongs to it, in the unit of the lens.
    pub(crate) focal: f64,
}

impl Turn {
    /// How badly it explains the corners.
    fn cost(&self) -> f64 {
        let square = |r: &f64| r * r / (LOOSE_PX * LOOSE_PX);
        self.residuals.iter().map(|r| square(r).ln_1p()).sum()
    }

    /// Median distance of the corners from where it sends them, px.
    pub(crate) fn median(&self) -> f64 {
        median(&mut self.residuals.clone()).unwrap_or(f64::INFINITY)
    }
}

/// The rotation that explains most of the corners, begun with each focal length of the lens that is
/// no longer than `limit`, or else with those that are.
pub(crate) fn best_turn(matches: &[Match], lens: &Lens, limit: (f64, bool)) -> Option<Turn> {
    let (max_focal, is_within) = limit;
    let focals = lens.focals.iter();
    let begun = focals.filter(|focal| (**focal <= max_focal) == is_within);
    let most = if is_within { max_focal } else { f64::MAX };
    let found = begun.map(|focal| turn_near(matches, lens, *focal, most));
    found.min_by(|a, b| a.cost().total_cmp(&b.cost()))
}

/// The rotation that explains most with about this focal length, and none that is longer than
/// `max_focal`.
fn turn_near(matches: &[Match], lens: &Lens, focal: f64, max_focal: f64) -> Turn {
    let mut found = Parameters::zeros();
    found[FOCAL] = focal.ln();
    let start = found;
    for round in 0..ROUNDS {
        let Some(step) = step(matches, lens, (&found, &start), 2 * round >= ROUNDS) else {
            break;
        };
        found += step;
        found[FOCAL] = found[FOCAL].clamp(start[FOCAL] - 1.5, start[FOCAL] + 1.5);
        found[FOCAL] = found[FOCAL].min(max_focal.ln());
        found[BEND] = found[BEND].clamp(-MAX_BEND, MAX_BEND);
    }
    Turn {
        residuals: (matches.iter())
            .map(|pair| residual(pair, lens, &found))
            .collect(),
        focal: found[FOCAL].exp(),
    }
}

/// Where the second image shows a pixel of the first one.
fn seen_again(pixel: &Vec2, lens: &Lens, turn: &Parameters) -> Option<Vec2> {
    let (focal, bend) = (turn[FOCAL].exp(), turn[BEND]);
    let x = (pixel - lens.centre) / lens.half;
    let ray = Vec3::new(x.x, x.y, focal * (1.0 + bend * x.norm_squared()));
    let ray = rotation_exp(&Vec3::new(turn[0], turn[1], turn[2])) * ray;
    if ray.z <= 0.05 * ray.norm() {
        return None;
    }
    let ideal = ray.xy() * (focal / ray.z);
    // the root that is the ideal radius where nothing bends
    let squared = 4.0 * bend * ideal.norm_squared();
    let stretch = 2.0 / (1.0 + (1.0 - squared).max(0.0).sqrt());
    Some(ideal * (stretch * lens.half) + lens.centre)
}

fn residual(pair: &Match, lens: &Lens, turn: &Parameters) -> f64 {
    seen_again(&pair.a, lens, turn).map_or(f64::INFINITY, |seen| (seen - pair.b).norm())
}

/// A Gauss-Newton step; corners count by the inverse of their residuals first, those that fit alone
/// in the end.
fn step(
    matches: &[Match],
    lens: &Lens,
    (turn, start): (&Parameters, &Parameters),
    is_last: bool,
) -> Option<Parameters> {
    const SMALL: f64 = 1e-6;
    let mut information = SMatrix::<f64, NUM, NUM>::zeros();
    let mut right = Parameters::zeros();
    for pair in matches {
        let Some(seen) = seen_again(&pair.a, lens, turn) else {
            continue;
        };
        let error = pair.b - seen;
        let mut by = SMatrix::<f64, 2, NUM>::zeros();
        for k in 0..NUM {
            let mut moved = *turn;
            moved[k] += SMALL;
            let moved = seen_again(&pair.a, lens, &moved)?;
            by.set_column(k, &((moved - seen) / SMALL));
        }
        let norm = error.norm();
        let weight = match is_last {
            false => 1.0 / norm.max(1.0),
            true => 1.0 / (1.0 + norm * norm / (LOOSE_PX * LOOSE_PX)),
        } / (CORNER_PX * CORNER_PX);
        information += by.transpose() * by * weight;
        right += by.transpose() * error * weight;
    }
    for (k, sigma) in [(FOCAL, lens.sigma[0]), (BEND, lens.sigma[1])] {
        information[(k, k)] += 1.0 / (sigma * sigma);
        right[k] -= (turn[k] - start[k]) / (sigma * sigma);
    }
    for k in 0..FOCAL {
        information[(k, k)] += 1e-9;
    }
    let step = information.cholesky()?.solve(&right);
    step.iter().all(|s| s.is_finite()).then_some(step)
}
