//! Colour scales.

/// Anchors from near/low (dark blue) to far/high (red).
const RAINBOW: [[f64; 3]; 6] = [
    [46.0, 42.0, 120.0],
    [36.0, 110.0, 180.0],
    [40.0, 165.0, 140.0],
    [140.0, 200.0, 80.0],
    [250.0, 205.0, 70.0],
    [205.0, 65.0, 45.0],
];

/// Colour of `fraction`, clamped to [0, 1].
pub fn rainbow(fraction: f64) -> [u8; 3] {
    between(&RAINBOW, fraction)
}

/// Green (certain) over yellow to red (uncertain), `fraction` clamped to [0, 1].
pub fn certainty(fraction: f64) -> [u8; 3] {
    const ANCHORS: [[f64; 3]; 3] = [
        [40.0, 160.0, 70.0],
        [245.0, 205.0, 70.0],
        [200.0, 50.0, 40.0],
    ];
    between(&ANCHORS, fraction)
}

fn between(anchors: &[[f64; 3]], fraction: f64) -> [u8; 3] {
    let position = fraction.clamp(0.0, 1.0) * (anchors.len() - 1) as f64;
    let index = (position as usize).min(anchors.len() - 2);
    let (a, b, t) = (anchors[index], anchors[index + 1], position - index as f64);
    std::array::from_fn(|i| (a[i] + t * (b[i] - a[i])).round() as u8)
}

/// The colour made darker by `factor` in [0, 1].
pub fn shade(colour: [u8; 3], factor: f64) -> [u8; 3] {
    colour.map(|value| (f64::from(value) * factor.clamp(0.0, 1.0)).round() as u8)
}

/// The value at `fraction` of the sorted values; 0 for none.
pub fn quantile(values: &mut [f64], fraction: f64) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let index = ((values.len() - 1) as f64 * fraction.clamp(0.0, 1.0)).round() as usize;
    *values.select_nth_unstable_by(index, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scales_start_and_end_at_their_anchors() {
        assert_eq!(rainbow(-1.0), [46, 42, 120]);
        assert_eq!(rainbow(2.0), [205, 65, 45]);
        assert_eq!(certainty(0.5), [245, 205, 70]);
    }

    #[test]
    fn quantiles_are_order_statistics() {
        let mut values = [5.0, 1.0, 3.0, 2.0, 4.0];
        assert_eq!(quantile(&mut values, 0.0).to_bits(), 1.0f64.to_bits());
        assert_eq!(quantile(&mut values, 0.5).to_bits(), 3.0f64.to_bits());
        assert_eq!(quantile(&mut values, 1.0).to_bits(), 5.0f64.to_bits());
    }
}
