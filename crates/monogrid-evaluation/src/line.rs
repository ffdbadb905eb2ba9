//! Cells along a straight line.
//!
//! Reference: `[AW87]`; steps are counted, so it always ends.

/// Visits every cell that the segment from `start` to `end` crosses, the first one included and the
/// last one too, until `visit` returns false. Cell `k` covers `[k, k + 1) * resolution`.
pub(crate) fn cells_on_segment(
    start: [f64; 3],
    end: [f64; 3],
    resolution: f64,
    mut visit: impl FnMut([i32; 3]) -> bool,
) {
    let from = start.map(|c| c / resolution);
    let to = end.map(|c| c / resolution);
    if !from.iter().chain(&to).all(|c| c.abs() < 1e9) {
        return;
    }
    let mut key = from.map(|c| c.floor() as i32);
    let last = to.map(|c| c.floor() as i32);
    let mut steps = [0_i64; 3];
    let mut next = [f64::INFINITY; 3];
    let mut per_cell = [f64::INFINITY; 3];
    let mut direction = [0_i32; 3];
    for axis in 0..3 {
        steps[axis] = (i64::from(last[axis]) - i64::from(key[axis])).abs();
        if steps[axis] == 0 {
            continue;
        }
        let length = to[axis] - from[axis];
        direction[axis] = if length > 0.0 { 1 } else { -1 };
        let boundary = f64::from(key[axis]) + if length > 0.0 { 1.0 } else { 0.0 };
        next[axis] = (boundary - from[axis]) / length;
        per_cell[axis] = 1.0 / length.abs();
    }
    loop {
        if !visit(key) {
            return;
        }
        // The axis whose next boundary comes first, among those not yet at their last cell.
        let axis = (0..3)
            .filter(|a| steps[*a] > 0)
            .min_by(|a, b| next[*a].total_cmp(&next[*b]));
        let Some(axis) = axis else {
            return;
        };
        key[axis] += direction[axis];
        next[axis] += per_cell[axis];
        steps[axis] -= 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agrees_with_dense_sampling_and_is_connected() {
        let mut state = 3_u64;
        let mut uniform = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(7);
            (state >> 11) as f64 / (1_u64 << 53) as f64 * 2.0 - 1.0
        };
        for _ in 0..200 {
            let start: [f64; 3] = std::array::from_fn(|_| uniform());
            let end: [f64; 3] = std::array::from_fn(|_| uniform());
            let mut cells = Vec::new();
            cells_on_segment(start, end, 0.1, |key| {
                cells.push(key);
                true
            });
            for pair in cells.windows(2) {
                let moved: i32 = (0..3).map(|a| (pair[0][a] - pair[1][a]).abs()).sum();
                assert_eq!(moved, 1);
            }
            for step in 0..=2000 {
                let t = f64::from(step) / 2000.0;
                let key: [i32; 3] = std::array::from_fn(|a| {
                    ((start[a] + t * (end[a] - start[a])) / 0.1).floor() as i32
                });
                assert!(cells.contains(&key), "{start:?} {end:?} {t}");
            }
        }
    }

    #[test]
    fn axis_aligned_and_empty_segments_end() {
        let mut cells = Vec::new();
        cells_on_segment([0.0; 3], [0.0, 0.0, -0.25], 0.1, |key| {
            cells.push(key);
            true
        });
        assert_eq!(cells, [[0, 0, 0], [0, 0, -1], [0, 0, -2], [0, 0, -3]]);
        let mut count = 0;
        cells_on_segment([0.3; 3], [0.3; 3], 0.1, |_| {
            count += 1;
            true
        });
        assert_eq!(count, 1);
        cells_on_segment([f64::NAN; 3], [0.3; 3], 0.1, |_| unreachable!());
    }
}
