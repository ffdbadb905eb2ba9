//! Both directions of an alignment must agree; then they are one constraint.

use super::{
    KeyframeView, SimilarityAlignment, SimilarityConfig, SimilarityState, align_similarity,
};
use monogrid_geometry::{Mat7, Sim3, Vec7};

/// Smallest share of the points that must be visible in the other keyframe.
const MIN_VISIBLE_SHARE: f32 = 0.25;
/// Smallest share of the visible points that meet a depth in the other keyframe.
const MIN_DEPTH_SHARE: f32 = 0.1;
/// Largest ratio of the units of both keyframes, relative to the expected one.
const MAX_SCALE_CHANGE: f64 = 2.0;

/// A similarity measured between two keyframes in both directions.
#[derive(Clone, Debug)]
pub struct SimilarityConstraint {
    /// Maps points of a (its units) to b (its units).
    pub b_from_a: Sim3,
    /// Information of a left update `[v, w, s]` of `b_from_a`.
    pub information: Mat7,
    /// Squared difference of the two directions in units of its covariance.
    pub reciprocal_chi_sq: f64,
    /// Smaller visible share of both directions.
    pub visible_share: f32,
}

/// Why two keyframes give no constraint.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Disagreement {
    /// They see too little of each other.
    Overlap(f32),
    /// Too few visible points have a good residual.
    Residual(f32),
    /// The grey values do not go together.
    Correlation(f64),
    /// Too few points meet a depth.
    Depth(f32),
    /// The scale differs too much from the expected one.
    Scale(f64),
    /// The equations do not determine all seven unknowns.
    Singular,
    /// Both directions differ by this much (squared, in units of the covariance).
    Reciprocal(f64),
}

/// Aligns a and b in both directions, coarse to fine with a check after the coarse levels and at
/// the end.
///
/// # Errors
/// Why the pair is refused.
pub fn align_reciprocally(
    a: &KeyframeView,
    b: &KeyframeView,
    initial: &SimilarityState,
    config: &SimilarityConfig,
) -> Result<SimilarityConstraint, Disagreement> {
    // The coarse levels cost little and refuse most of the pairs that do not belong together.
    let middle = config
        .coarsest_level
        .saturating_sub(1)
        .max(config.finest_level);
    let coarse = (config.coarsest_level, middle);
    let fine = (
        middle.saturating_sub(1).max(config.finest_level),
        config.finest_level,
    );
    let forward = align_similarity(a, b, initial, coarse, config);
    check(&forward, initial, 0.5, config)?;
    let forward = align_similarity(a, b, &forward.state, fine, config);
    check(&forward, initial, 1.0, config)?;
    let backward = align_similarity(b, a, &initial.inverse(), coarse, config);
    check(&backward, &initial.inverse(), 0.5, config)?;
    let backward = align_similarity(b, a, &backward.state, fine, config);
    check(&backward, &initial.inverse(), 1.0, config)?;
    fuse(&forward, &backward, config)
}

/// Whether one direction may be believed; `strictness` scales the limits on shares.
fn check(
    found: &SimilarityAlignment,
    initial: &SimilarityState,
    strictness: f32,
    config: &SimilarityConfig,
) -> Result<(), Disagreement> {
    if found.visible_share < strictness * MIN_VISIBLE_SHARE {
        return Err(Disagreement::Overlap(found.visible_share));
    }
    if found.good_of_visible < strictness * config.min_good_of_visible {
        return Err(Disagreement::Residual(found.good_of_visible));
    }
    let correlation = found.correlation.unwrap_or(0.0);
    if correlation < f64::from(strictness) * config.min_correlation {
        return Err(Disagreement::Correlation(correlation));
    }
    if found.depth_share < strictness * MIN_DEPTH_SHARE {
        return Err(Disagreement::Depth(found.depth_share));
    }
    let change = found.state.b_from_a.scale / initial.b_from_a.scale;
    if !(1.0 / MAX_SCALE_CHANGE..=MAX_SCALE_CHANGE).contains(&change) {
        return Err(Disagreement::Scale(change));
    }
    Ok(())
}

/// `e = d' (S_ab + Ad S_ba Ad')^-1 d` with `d = log(b_from_a a_from_b)` (`[LSD14]` equation 20),
/// and the mean of both weighted with their information.
///
/// The two directions see the same images: their information is averaged, not added.
fn fuse(
    forward: &SimilarityAlignment,
    backward: &SimilarityAlignment,
    config: &SimilarityConfig,
) -> Result<SimilarityConstraint, Disagreement> {
    let b_from_a = forward.state.b_from_a;
    let (information_ab, information_ba) = match (forward.information, backward.information) {
        (Some(ab), Some(ba)) => (ab, ba),
        _ => return Err(Disagreement::Singular),
    };
    let difference = (b_from_a * backward.state.b_from_a).log();
    // a left update e of a_from_b is a left update -Ad(b_from_a) e of its inverse
    let inverse_adjoint = b_from_a.inverse().adjoint();
    let information_back = inverse_adjoint.transpose() * information_ba * inverse_adjoint;
    let covariance = inverse(&information_ab)
        .zip(inverse(&information_back))
        .map(|(x, y)| x + y)
        .ok_or(Disagreement::Singular)?;
    let whitened = covariance
        .cholesky()
        .ok_or(Disagreement::Singular)?
        .solve(&difference);
    let chi_sq = difference.dot(&whitened);
    if !chi_sq.is_finite() || chi_sq > config.max_reciprocal_chi_sq {
        return Err(Disagreement::Reciprocal(chi_sq));
    }
    let total = information_ab + information_back;
    let step: Vec7 = total
        .cholesky()
        .ok_or(Disagreement::Singular)?
        .solve(&(information_back * -difference));
    Ok(SimilarityConstraint {
        b_from_a: Sim3::exp(&step) * b_from_a,
        information: (total + total.transpose()) * 0.25,
        reciprocal_chi_sq: chi_sq,
        visible_share: forward.visible_share.min(backward.visible_share),
    })
}

fn inverse(information: &Mat7) -> Option<Mat7> {
    information.cholesky().map(|c| c.inverse())
}
