//! Share of the true trajectory that the estimate covers.

use super::associate::{StampedPose, nearest_within, seconds};
use crate::statistics::median;

/// Time between two frames of the source as the estimate shows it, seconds: the median of the
/// intervals that are at most 1.5 times the shortest tenth of them. Intervals longer than that are
/// taken for frames without a pose, so that an estimate with many gaps is not thought to be slow.
/// Zero for fewer than two poses.
pub(crate) fn frame_interval_secs(sorted_estimate: &[StampedPose]) -> f64 {
    let pairs = sorted_estimate.windows(2);
    let intervals = pairs.map(|pair| seconds(pair[1].0) - seconds(pair[0].0));
    let mut intervals: Vec<f64> = intervals.filter(|interval| *interval > 0.0).collect();
    intervals.sort_by(f64::total_cmp);
    let Some(&short) = intervals.get(intervals.len() / 10) else {
        return 0.0;
    };
    intervals.retain(|interval| *interval <= 1.5 * short);
    median(&intervals).unwrap_or(0.0)
}

/// Times of the frames whose true pose is known: those with a true pose nearer than the next frame.
pub(crate) fn with_truth(
    frame_times_ns: &[i64],
    sorted_truth: &[StampedPose],
    frame_interval_secs: f64,
) -> Vec<i64> {
    let mut known = near(frame_times_ns, sorted_truth, frame_interval_secs + 1e-6);
    known.sort_unstable();
    known
}

/// The times that have a pose at most so far away.
fn near(times_ns: &[i64], sorted_poses: &[StampedPose], reach_secs: f64) -> Vec<i64> {
    let times: Vec<f64> = sorted_poses.iter().map(|p| seconds(p.0)).collect();
    let is_near = |time: &i64| nearest_within(&times, seconds(*time), reach_secs).is_some();
    times_ns.iter().copied().filter(is_near).collect()
}

/// Share of the given times that have an estimated pose within half a frame interval.
pub(crate) fn coverage(
    sorted_estimate: &[StampedPose],
    times_ns: &[i64],
    frame_interval_secs: f64,
) -> f64 {
    if times_ns.is_empty() {
        return 0.0;
    }
    // A microsecond more, so that a true pose halfway between two frames belongs to both.
    let covered = near(times_ns, sorted_estimate, 0.5 * frame_interval_secs + 1e-6);
    covered.len() as f64 / times_ns.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::Se3;

    fn times(poses: &[StampedPose]) -> Vec<i64> {
        poses.iter().map(|pose| pose.0).collect()
    }

    #[test]
    fn time_without_images_does_not_count() {
        // ten seconds of truth, images for the fifth and sixth of them, poses for the sixth
        let truth = stamps((0..10_000).step_by(10));
        let frames = times(&stamps((4_000..6_000).step_by(33)));
        let estimate = stamps((4_000..6_000).step_by(33).filter(|ms| *ms >= 5_000));
        let known = with_truth(&frames, &truth, 0.033);
        assert_eq!(known.len(), frames.len());
        let share = coverage(&estimate, &known, 0.033);
        assert!((share - 0.5).abs() < 0.01, "{share}");
        // and frames without truth cannot be judged
        let truth = stamps((5_500..10_000).step_by(10));
        let known = with_truth(&frames, &truth, 0.033);
        assert!((15..=17).contains(&known.len()), "{}", known.len());
    }

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
        assert_eq!(coverage(&estimate, &times(&truth), interval), 1.0);
    }

    #[test]
    fn lost_frames_are_not_covered_even_when_most_are_lost() {
        let truth = stamps((0..1000).step_by(10));
        // Two consecutive frames of every ten.
        let estimate = stamps((0..1000).step_by(10).filter(|ms| (ms / 10) % 10 < 2));
        let interval = frame_interval_secs(&estimate);
        assert!((interval - 0.01).abs() < 1e-9);
        let truth = times(&truth);
        assert!((coverage(&estimate, &truth, interval) - 0.2).abs() < 1e-12);
        assert_eq!(coverage(&[], &truth, 0.01), 0.0);
    }
}
