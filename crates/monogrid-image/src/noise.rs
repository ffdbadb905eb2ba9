//! Noise of an image, estimated from the image itself.

use crate::GrayImage;
use std::f64::consts::PI;

/// Side of a block, px.
const BLOCK: usize = 16;
/// Share of the blocks that show nothing but noise: texture makes all others look noisier.
const PLAIN_SHARE: f64 = 0.2;
/// Fewest blocks that say something.
const MIN_BLOCKS: usize = 20;
/// Grey levels that a sensor is sure to have clipped neither in the dark nor in the light; what it
/// clips has no noise.
const UNCLIPPED: std::ops::RangeInclusive<f32> = 3.0..=250.0;

/// Standard deviation of the noise, grey levels; `None` for an image that is too small or clipped
/// almost everywhere.
///
/// The difference of two Laplacians sees no plane and no edge along an axis, and has six times the
/// deviation of independent noise (`[IMMERKAER96]`). It is measured in blocks, and the plainest of
/// them count. Noise that a codec or a lens model smoothed is underestimated.
#[must_use]
pub fn noise_sigma(image: &GrayImage) -> Option<f64> {
    let blocks_of = |length: usize| length.saturating_sub(2) / BLOCK;
    let rows = 0..blocks_of(image.height());
    let blocks =
        rows.flat_map(|row| (0..blocks_of(image.width())).map(move |column| (column, row)));
    let means = blocks
        .filter_map(|(column, row)| mean_difference(image, 1 + column * BLOCK, 1 + row * BLOCK));
    let mut means: Vec<f64> = means.collect();
    if means.len() < MIN_BLOCKS {
        return None;
    }
    let plain = (PLAIN_SHARE * means.len() as f64) as usize;
    let (_, mean, _) = means.select_nth_unstable_by(plain, f64::total_cmp);
    // of the magnitude of a Gaussian value to its deviation
    Some(*mean * (0.5 * PI).sqrt() / 6.0)
}

/// Mean magnitude of the difference of two Laplacians in a block; `None` where it is clipped.
fn mean_difference(image: &GrayImage, x0: usize, y0: usize) -> Option<f64> {
    let mut sum = 0.0;
    for y in y0..y0 + BLOCK {
        let columns = x0 - 1..=x0 + BLOCK;
        let [above, here, below] = [y - 1, y, y + 1].map(|y| &image.row(y)[columns.clone()]);
        if !here.iter().all(|grey| UNCLIPPED.contains(grey)) {
            return None;
        }
        let second = |row: &[f32], x: usize| row[x] - 2.0 * row[x + 1] + row[x + 2];
        let difference = |x| second(above, x) - 2.0 * second(here, x) + second(below, x);
        let row: f32 = (0..BLOCK).map(|x| difference(x).abs()).sum();
        sum += f64::from(row);
    }
    Some(sum / (BLOCK * BLOCK) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Independent values whose sum is nearly Gaussian, of variance one.
    fn gaussian(state: &mut u64) -> f32 {
        let mut uniform = || {
            *state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (*state >> 40) as f32 / (1u64 << 24) as f32
        };
        (0..12).map(|_| uniform()).sum::<f32>() - 6.0
    }

    /// A slope with waves over its right half.
    fn noisy(sigma: f32, grey: f32) -> GrayImage {
        let mut state = 7;
        GrayImage::from_fn(320, 240, |x, y| {
            let waves = if x < 160 {
                0.0
            } else {
                30.0 * (0.9 * x as f32 + 0.4 * y as f32).sin()
            };
            grey + 0.1 * x as f32 + waves + sigma * gaussian(&mut state)
        })
    }

    #[test]
    fn noise_is_measured_beside_slopes_and_texture() {
        for sigma in [0.5, 2.0, 8.0] {
            let found = noise_sigma(&noisy(sigma, 100.0)).unwrap();
            assert!(
                (found / f64::from(sigma) - 1.0).abs() < 0.15,
                "{sigma}: {found}"
            );
        }
    }

    #[test]
    fn what_is_clipped_says_nothing() {
        let white = noisy(2.0, 300.0).map(|grey| grey.min(255.0));
        assert_eq!(noise_sigma(&white), None);
        assert_eq!(
            noise_sigma(&GrayImage::filled(30, 30, 100.0)),
            None,
            "few blocks"
        );
        assert_eq!(noise_sigma(&GrayImage::filled(320, 240, 100.0)), Some(0.0));
    }
}
