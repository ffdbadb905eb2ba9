//! Share of the true trajectory that the estimate covers.

use super::associate::{StampedPose, nearest_within, seconds};
use crate::statistics::median;

/// Time between two frames of the source as the estimate shows it, seconds: the median of the
/// intervals that are at most 1.5 times the shortest tenth of them. Intervals longer than that are
/// taken for frames without a pose, so that an estimate with many gaps is not thought to be slow.
/// Zero for fewer than two poses.
pub(crate) fn frame_interval_secs(sorted_estimate: &[StampedPose]) -> f64 {
    let mut intervals: Vec<f64> = sorted_estimate
        .windows(2)
        .map(|w| seconds(w[1].0) - seconds(w[0].0))
        .filter(|interval| *interval > 0.0)
        .collect();
    intervals.sort_by(f64::total_cmp);
    let Some(&short) = intervals.get(intervals.len() / 10) else {
        return 0.0;
    };
    intervals.retain(|interval| *interval <= 1.5 * short);
    median(&intervals).unwrap_or(0.0)
}

/// Share of all true poses that have an estimated pose within half a frame interval.
pub(crate) fn coverage(
    sorted_estimate: &[StampedPose],
    truth: &[StampedPose],
    frame_interval_secs: f64,
) -> f64 {
    if truth.is_empty() {
        return 0.0;
    }
    let times: Vec<f64> = sorted_estimate.iter().map(|p| seconds(p.0)).collect();
    // A microsecond more, so that a true pose halfway between two frames belongs to both.
    let reach_secs = 0.5 * frame_interval_secs + 1e-6;
    let covered = truth
        .iter()
        .filter(|p| nearest_within(&times, seconds(p.0), reach_secs).is_some())
        .count();
    covered as f64 / truth.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::Se3;

    fn stamps(milliseconds: impl Iterator<Item = i64>) -> Vec<StampedPose> {
        milliseconds
            .map(|ms| (ms * 1_000_000, Se3::identity()))
            .collect()
    }

    #[test]
    fn a_fast_truth_is_covered_by_every_frame() {
        let truth = stamps((0..=1000).step_by(5));
        let estimate = stamps((0..=1000).step_by(50));
        let interval = frame_interval_secs(&estimate);
        assert!((interval - 0.05).abs() < 1e-9);
        assert_eq!(coverage(&estimate, &truth, interval), 1.0);
    }

    #[test]
    fn lost_frames_are_not_covered_even_when_most_are_lost() {
        let truth = stamps((0..1000).step_by(10));
        // Two consecutive frames of every ten.
        let estimate = stamps((0..1000).step_by(10).filter(|ms| (ms / 10) % 10 < 2));
        let interval = frame_interval_secs(&estimate);
        assert!((interval - 0.01).abs() < 1e-9);
        assert!((coverage(&estimate, &truth, interval) - 0.2).abs() < 1e-12);
        assert_eq!(coverage(&[], &truth, 0.01), 0.0);
    }
}
