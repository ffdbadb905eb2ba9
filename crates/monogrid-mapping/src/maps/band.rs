//! The heights that matter to what moves where the camera moved.

/// From somewhat above the floor to somewhat above the camera. `occupied` and `cameras` are heights
/// of occupied cells and of the camera; with a floor that was found it is at 0, without it what is
/// lowest below the camera is taken for it.
///
/// Reorders `occupied`.
#[must_use]
pub fn navigation_band(occupied: &mut [f64], cameras: &[f64], has_floor: bool) -> [f64; 2] {
    /// Lower ones are false.
    const LOWEST_SHARE: f64 = 0.02;
    let highest = cameras.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let lowest = cameras.iter().copied().fold(f64::INFINITY, f64::min);
    let floor = if has_floor && lowest > 0.0 {
        0.0
    } else {
        let last = occupied.len().saturating_sub(1);
        occupied.sort_unstable_by(f64::total_cmp);
        let low = occupied.get((last as f64 * LOWEST_SHARE).round() as usize);
        low.map_or(lowest, |low| low.min(lowest))
    };
    let height = highest - floor;
    [floor + 0.1 * height, highest + 0.1 * height]
}

#[cfg(test)]
mod tests {
    use super::navigation_band;

    #[test]
    fn the_band_of_a_robot_begins_over_the_floor_where_there_is_one() {
        let mut heights: Vec<f64> = (-5..40).map(|k| 0.1 * f64::from(k)).collect();
        let cameras = [1.4, 1.5];
        let [low, high] = navigation_band(&mut heights, &cameras, true);
        assert!((low - 0.15).abs() < 1e-12 && (high - 1.65).abs() < 1e-12);
        // the lowest of what was mapped, without
        let [low, _] = navigation_band(&mut heights, &cameras, false);
        assert!(low < 0.0, "{low}");
        // a camera below what was taken for the floor
        let [low, high] = navigation_band(&mut heights, &[-0.2], true);
        assert!(low < -0.2 && high > -0.2);
        // nothing was mapped
        assert_eq!(navigation_band(&mut [], &[1.0], false), [1.0, 1.0]);
    }
}
