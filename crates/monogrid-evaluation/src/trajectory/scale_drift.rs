//! Scale of short windows, each aligned alone, and how much it wanders.

use super::associate::PosePair;
use crate::statistics::median;
use monogrid_geometry::{Mat3, Vec3};
use serde::Serialize;

/// Scale of one window of a trajectory.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct WindowScale {
    /// Seconds from the first matched pose to the start of the window.
    pub start_secs: f64,
    /// True length per estimated length (as Umeyama's scale). Infinite (`null` in JSON) when the
    /// estimate stands still while the truth moves.
    pub scale: f64,
}

/// Length of a window, seconds.
const LENGTH_SECS: f64 = 3.0;
/// From the start of one window to the start of the next, seconds.
const STRIDE_SECS: f64 = 2.0;
/// A window counts with at least so many matched poses.
const MIN_POSES: usize = 10;
/// The last window may be cut by the end of the data; it counts when its poses span at least this
/// share of its length.
const MIN_SPAN_RATIO: f64 = 1.0 / 3.0;
/// A window in which the true camera hardly moves does not tell a scale. It counts when the root
/// mean square distance of its true positions from their mean is at least this share of the median
/// of that spread over all windows.
const MIN_SPREAD_RATIO: f64 = 0.2;

/// Scale of every window that counts, in the order of time.
pub(crate) fn window_scales(pairs: &[PosePair]) -> Vec<WindowScale> {
    let windows = cut(pairs);
    let spreads: Vec<f64> = windows.iter().map(|(_, w)| truth_spread(w)).collect();
    let Some(typical) = median(&spreads) else {
        return Vec::new();
    };
    let min_spread = MIN_SPREAD_RATIO * typical;
    windows
        .iter()
        .zip(&spreads)
        .filter(|(_, spread)| **spread > 0.0 && **spread >= min_spread)
        .map(|((start_secs, window), _)| WindowScale {
            start_secs: *start_secs,
            scale: umeyama_scale(window),
        })
        .collect()
}

/// Largest over smallest scale; 1 when fewer than two windows count, infinite when one collapsed.
pub(crate) fn scale_drift(scales: &[WindowScale]) -> f64 {
    if scales.len() < 2 {
        return 1.0;
    }
    let largest = scales.iter().map(|w| w.scale).fold(0.0, f64::max);
    let smallest = scales.iter().map(|w| w.scale).fold(f64::INFINITY, f64::min);
    let ratio = largest / smallest;
    // Infinity over infinity: every window collapsed.
    let is_finite = smallest > 0.0 && !ratio.is_nan();
    if is_finite { ratio } else { f64::INFINITY }
}

/// Windows with enough poses over enough time, each with its start in seconds after the first pose.
fn cut(pairs: &[PosePair]) -> Vec<(f64, &[PosePair])> {
    let Some(first) = pairs.first() else {
        return Vec::new();
    };
    let mut windows = Vec::new();
    let mut index = 0.0;
    loop {
        let start_secs = index * STRIDE_SECS;
        let since_first = |p: &PosePair| p.time_secs - first.time_secs;
        let begin = pairs.partition_point(|p| since_first(p) < start_secs);
        let end = pairs.partition_point(|p| since_first(p) <= start_secs + LENGTH_SECS);
        let Some(next) = pairs.get(begin) else {
            return windows;
        };
        let window = &pairs[begin..end];
        if is_counted(window) {
            windows.push((start_secs, window));
        }
        // A gap in the data holds no windows: go on with the first one that reaches past it.
        let after_gap = ((since_first(next) - LENGTH_SECS) / STRIDE_SECS).floor();
        index = f64::max(index + 1.0, after_gap);
    }
}

fn is_counted(window: &[PosePair]) -> bool {
    let (Some(first), Some(last)) = (window.first(), window.last()) else {
        return false;
    };
    let span_secs = last.time_secs - first.time_secs;
    window.len() >= MIN_POSES && span_secs >= MIN_SPAN_RATIO * LENGTH_SECS
}

fn mean(window: &[PosePair], point: fn(&PosePair) -> Vec3) -> Vec3 {
    window.iter().map(point).sum::<Vec3>() / window.len() as f64
}

/// Root mean square distance of the true positions from their mean.
fn truth_spread(window: &[PosePair]) -> f64 {
    let centre = mean(window, |p| p.gt_from_camera.translation);
    let distance_sq = |p: &PosePair| (p.gt_from_camera.translation - centre).norm_squared();
    let sum_sq: f64 = window.iter().map(distance_sq).sum();
    (sum_sq / window.len() as f64).sqrt()
}

/// `[UMEYAMA91]` equation 42: tr(D S) / var(estimate). Unlike the rotation it is also defined for
/// motion along a line.
fn umeyama_scale(window: &[PosePair]) -> f64 {
    let mean_estimate = mean(window, |p| p.est_from_camera.translation);
    let mean_truth = mean(window, |p| p.gt_from_camera.translation);
    let mut covariance = Mat3::zeros();
    let mut var_estimate = 0.0;
    for pair in window {
        let de = pair.est_from_camera.translation - mean_estimate;
        let dt = pair.gt_from_camera.translation - mean_truth;
        covariance += dt * de.transpose();
        var_estimate += de.norm_squared();
    }
    if var_estimate <= 0.0 || !covariance.iter().all(|x| x.is_finite()) {
        return f64::INFINITY;
    }
    let is_mirrored = covariance.determinant() < 0.0;
    let sign = if is_mirrored { -1.0 } else { 1.0 };
    // Sorted in descending order, so the last one takes the sign.
    let singular = covariance.svd(false, false).singular_values;
    (singular[0] + singular[1] + sign * singular[2]) / var_estimate
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::{Rotation, Se3, align_similarity};

    fn pairs(count: usize, scale_at: impl Fn(f64) -> f64) -> Vec<PosePair> {
        let mut estimate = Vec3::zeros();
        let path = |t: f64| Vec3::new(t.sin(), (1.7 * t).cos(), 0.3 * t);
        (0..count)
            .map(|i| {
                let time_secs = i as f64 / 30.0;
                let step = path(time_secs) - path(time_secs - 1.0 / 30.0);
                estimate += step / scale_at(time_secs);
                PosePair {
                    time_secs,
                    est_from_camera: Se3::new(Rotation::identity(), estimate),
                    gt_from_camera: Se3::new(
                        Rotation::from_euler_angles(0.2, 0.3, 0.4),
                        Rotation::from_euler_angles(0.2, 0.3, 0.4) * path(time_secs),
                    ),
                }
            })
            .collect()
    }

    #[test]
    fn a_constant_scale_does_not_drift() {
        let scales = window_scales(&pairs(700, |_| 2.5));
        assert_eq!(scales.len(), 12, "windows start every 2 s, the last is cut");
        assert!(scales.iter().all(|w| (w.scale - 2.5).abs() < 1e-9));
        assert!((scale_drift(&scales) - 1.0).abs() < 1e-9);
    }

    #[test]
    fn a_step_of_the_scale_is_seen_in_full() {
        let pairs = pairs(700, |t| if t < 11.0 { 1.0 } else { 3.0 });
        let drift = scale_drift(&window_scales(&pairs));
        assert!((drift - 3.0).abs() < 1e-9, "{drift}");
    }

    #[test]
    fn scale_agrees_with_the_full_alignment() {
        let mut pairs = pairs(90, |t| 1.0 + t);
        for (i, pair) in pairs.iter_mut().enumerate() {
            pair.est_from_camera.translation.z =
                -pair.est_from_camera.translation.z + 0.1 * ((i * i) as f64).sin();
        }
        let estimate: Vec<_> = pairs
            .iter()
            .map(|p| p.est_from_camera.translation)
            .collect();
        let truth: Vec<_> = pairs.iter().map(|p| p.gt_from_camera.translation).collect();
        let fit = align_similarity(&estimate, &truth, true).expect("not degenerate");
        assert!((umeyama_scale(&pairs) - fit.target_from_source.scale).abs() < 1e-12);
    }

    #[test]
    fn a_window_without_motion_does_not_count_and_a_collapsed_one_is_infinite() {
        let mut still = pairs(600, |_| 1.0);
        let all = window_scales(&still).len();
        let hold = still[300];
        for pair in &mut still[240..360] {
            pair.gt_from_camera = hold.gt_from_camera;
        }
        assert!(window_scales(&still).len() < all);
        let mut collapsed = pairs(600, |_| 1.0);
        for pair in &mut collapsed[240..360] {
            pair.est_from_camera = Se3::identity();
        }
        let scales = window_scales(&collapsed);
        assert_eq!(scale_drift(&scales), f64::INFINITY);
    }

    #[test]
    fn a_gap_of_thirty_years_takes_no_time() {
        let mut gap = pairs(300, |_| 2.0);
        for pair in &mut gap[150..] {
            pair.time_secs += 1e9;
        }
        let scales = window_scales(&gap);
        assert!(scales.len() >= 4, "{scales:?}");
        assert!(scales.iter().all(|w| (w.scale - 2.0).abs() < 1e-6));
    }
}
