//! Least-squares similarity between two point sets.
//!
//! Reference: `[UMEYAMA91]` equations 40 to 42.

use crate::{Mat3, Rotation, Sim3, Vec3};

/// Why no similarity could be found.
#[derive(Debug, thiserror::Error, Clone, PartialEq)]
#[non_exhaustive]
pub enum AlignmentError {
    /// The sets differ in length.
    #[error("{source_len} source points for {target_len} target points, expected as many")]
    Length {
        /// Points in the source.
        source_len: usize,
        /// Points in the target.
        target_len: usize,
    },
    /// Too few points.
    #[error("{found} pairs of points, expected at least 3")]
    TooFew {
        /// Pairs given.
        found: usize,
    },
    /// All points on one spot or on one line, or a number that is not finite.
    #[error("the points lie on a line or a single spot: rotation and scale cannot be determined")]
    Degenerate,
}

/// A similarity and how well it fits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimilarityFit {
    /// The best similarity.
    pub target_from_source: Sim3,
    /// Root of the mean squared distance after alignment, in target units.
    pub rmse: f64,
}

/// The similarity (`with_scale`) or rigid transform that maps `source` onto `target` with the least
/// sum of squared distances.
///
/// # Errors
/// When the sets differ in length, have fewer than 3 points, or do not determine a rotation.
pub fn align_similarity(
    source: &[Vec3],
    target: &[Vec3],
    with_scale: bool,
) -> Result<SimilarityFit, AlignmentError> {
    if source.len() != target.len() {
        return Err(AlignmentError::Length {
            source_len: source.len(),
            target_len: target.len(),
        });
    }
    if source.len() < 3 {
        return Err(AlignmentError::TooFew {
            found: source.len(),
        });
    }
    let target_from_source =
        umeyama(source, target, with_scale).ok_or(AlignmentError::Degenerate)?;
    let squared = source.iter().zip(target);
    let sum_sq: f64 = squared
        .map(|(s, t)| (target_from_source * *s - t).norm_squared())
        .sum();
    Ok(SimilarityFit {
        target_from_source,
        rmse: (sum_sq / source.len() as f64).sqrt(),
    })
}

/// The closed form; `None` when the points do not determine a rotation.
fn umeyama(source: &[Vec3], target: &[Vec3], with_scale: bool) -> Option<Sim3> {
    let n = source.len() as f64;
    let mean_source = source.iter().sum::<Vec3>() / n;
    let mean_target = target.iter().sum::<Vec3>() / n;
    let mut covariance = Mat3::zeros();
    let mut var_source = 0.0;
    for (s, t) in source.iter().zip(target) {
        let (ds, dt) = (s - mean_source, t - mean_target);
        covariance += dt * ds.transpose() / n;
        var_source += ds.norm_squared() / n;
    }
    if !covariance.iter().all(|x| x.is_finite()) || var_source <= 0.0 {
        return None;
    }
    let svd = covariance.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    // nalgebra sorts singular values in descending order.
    if svd.singular_values[1] <= 1e-12 * svd.singular_values[0] {
        return None;
    }
    let sign = if u.determinant() * v_t.determinant() < 0.0 {
        -1.0
    } else {
        1.0
    };
    let s = Vec3::new(1.0, 1.0, sign);
    let rotation = u * Mat3::from_diagonal(&s) * v_t;
    let scale = if with_scale {
        svd.singular_values.dot(&s) / var_source
    } else {
        1.0
    };
    let rotation =
        Rotation::from_rotation_matrix(&nalgebra::Rotation3::from_matrix_unchecked(rotation));
    let translation = mean_target - rotation * mean_source * scale;
    Some(Sim3::new(scale, rotation, translation))
}
