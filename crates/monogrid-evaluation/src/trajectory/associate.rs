//! Pairs poses of two trajectories by time, the way `evo` does.

use monogrid_geometry::Se3;

/// Nanoseconds since any epoch and the pose of the camera then.
pub type StampedPose = (i64, Se3);

/// A pair of an estimated and a true pose of nearly the same time.
#[derive(Clone, Copy, Debug)]
pub struct PosePair {
    /// Time of the estimated pose, seconds.
    pub time_secs: f64,
    /// Estimated pose.
    pub est_from_camera: Se3,
    /// True pose.
    pub gt_from_camera: Se3,
}

/// The double that a reader of the decimal text gets, so that distances that tie in decimal are
/// decided as other tools decide them.
pub(crate) fn seconds(timestamp_ns: i64) -> f64 {
    let sign = if timestamp_ns < 0 { "-" } else { "" };
    let magnitude = timestamp_ns.unsigned_abs();
    let (whole, rest) = (magnitude / 1_000_000_000, magnitude % 1_000_000_000);
    let text = format!("{sign}{whole}.{rest:09}");
    // A decimal number always parses; the quotient is the same number to within one rounding.
    text.parse().unwrap_or(timestamp_ns as f64 / 1e9)
}

/// Index of the entry of `sorted` nearest to `time`, the earlier one of two equally near; `None`
/// when it is farther than `max_difference` or there are none.
pub(crate) fn nearest_within(sorted: &[f64], time: f64, max_difference: f64) -> Option<usize> {
    let after = sorted.partition_point(|&t| t <= time);
    let (earlier, later) = sorted.split_at(after);
    let gap_before = earlier.last().map_or(f64::INFINITY, |t| time - t);
    let gap_after = later.first().map_or(f64::INFINITY, |t| t - time);
    if gap_after < gap_before {
        (gap_after <= max_difference).then_some(after)
    } else {
        (gap_before <= max_difference).then(|| after - 1)
    }
}

/// Pairs of estimated and true poses at most `max_difference_secs` apart.
///
/// Every pose of the shorter trajectory (the estimate when both have the same length) takes the
/// nearest pose of the longer one. Both must be sorted by time.
pub(crate) fn associate(
    estimate: &[StampedPose],
    truth: &[StampedPose],
    max_difference_secs: f64,
) -> Vec<PosePair> {
    let times = |poses: &[StampedPose]| poses.iter().map(|p| seconds(p.0)).collect::<Vec<f64>>();
    let (estimate_times, truth_times) = (times(estimate), times(truth));
    let pair = |i: usize, j: usize| PosePair {
        time_secs: estimate_times[i],
        est_from_camera: estimate[i].1,
        gt_from_camera: truth[j].1,
    };
    let nearest = |times: &[f64], time: f64| nearest_within(times, time, max_difference_secs);
    if estimate.len() > truth.len() {
        let pairs = truth_times.iter().enumerate();
        let pairs = pairs.filter_map(|(j, time)| Some(pair(nearest(&estimate_times, *time)?, j)));
        pairs.collect()
    } else {
        let pairs = estimate_times.iter().enumerate();
        let pairs = pairs.filter_map(|(i, time)| Some(pair(i, nearest(&truth_times, *time)?)));
        pairs.collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nearest_agrees_with_a_linear_search() {
        let sorted = [0.0, 0.1, 0.1, 0.25, 0.5];
        for step in -10..70 {
            let time = f64::from(step) * 0.01;
            let best = sorted
                .iter()
                .map(|t| (t - time).abs())
                .fold(f64::INFINITY, f64::min);
            match nearest_within(&sorted, time, 0.04) {
                Some(i) => assert!((sorted[i] - time).abs() <= best && best <= 0.04),
                None => assert!(best > 0.04, "missed {time}"),
            }
        }
        assert_eq!(nearest_within(&[], 0.0, 1.0), None);
    }

    #[test]
    fn seconds_are_those_of_the_text() {
        assert_eq!(
            seconds(1_305_031_098_665_900_000),
            "1305031098.6659".parse().expect("a number")
        );
        assert_eq!(seconds(-33_333_000), -0.033_333);
        assert_eq!(seconds(0), 0.0);
    }

    #[test]
    fn the_shorter_trajectory_leads() {
        let at = |ms: i64| (ms * 1_000_000, Se3::identity());
        let dense: Vec<_> = (0..100).map(|i| at(i * 5)).collect();
        let sparse: Vec<_> = (0..9).map(|i| at(i * 50 + 2)).collect();
        assert_eq!(associate(&dense, &sparse, 0.01).len(), 9);
        assert_eq!(associate(&sparse, &dense, 0.01).len(), 9);
        assert_eq!(associate(&sparse, &dense, 0.001).len(), 0);
    }
}
