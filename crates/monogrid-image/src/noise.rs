//! How noisy an image is.

use crate::GrayImage;

/// Responses are counted in bins of this width, grey levels.
const BIN: f32 = 0.25;
const NUM_BINS: usize = 1024;
/// Rows from one that is looked at to the next: every fourth says as much.
const ROW_STEP: usize = 4;
/// A quarter of the values of a normal distribution lie within so many standard deviations.
const QUARTILE: f32 = 0.3186;
/// Norm of the mask: its response to noise of standard deviation 1.
const MASK_NORM: f32 = 6.0;

/// Standard deviation of the noise of an image, grey levels; zero for one without pixels enough.
///
/// The mask of Immerkaer (*Fast noise variance estimation*, 1996), the difference of two Laplacians,
/// does not answer to flat or evenly shaded surfaces nor to straight edges along its axes. Where it
/// answers least there is little else than noise: the lower quartile of its responses is taken
/// instead of their mean, since texture fills more than half of many images.
#[must_use]
pub fn noise_sigma(image: &GrayImage) -> f32 {
    let (width, height) = (image.width(), image.height());
    if width < 3 || height < 3 {
        return 0.0;
    }
    let mut counts = [0u32; NUM_BINS];
    let mut total = 0;
    for y in (1..height - 1).step_by(ROW_STEP) {
        let rows = [image.row(y - 1), image.row(y), image.row(y + 1)];
        for x in 1..width - 1 {
            let bin = (mask_response(rows, x).abs() / BIN) as usize;
            counts[bin.min(NUM_BINS - 1)] += 1;
            total += 1;
        }
    }
    quartile(&counts, total) / (QUARTILE * MASK_NORM)
}

/// `[1 -2 1; -2 4 -2; 1 -2 1]` at a pixel of the middle row.
fn mask_response([above, row, below]: [&[f32]; 3], x: usize) -> f32 {
    let corners = above[x - 1] + above[x + 1] + below[x - 1] + below[x + 1];
    let edges = above[x] + below[x] + row[x - 1] + row[x + 1];
    corners - 2.0 * edges + 4.0 * row[x]
}

/// The response that a quarter of all do not reach, as if those of a bin were spread evenly in it.
fn quartile(counts: &[u32], total: u32) -> f32 {
    let wanted = total as f32 / 4.0;
    let mut below = 0.0;
    for (bin, count) in counts.iter().enumerate() {
        let count = *count as f32;
        if below + count >= wanted {
            return (bin as f32 + (wanted - below) / count.max(1.0)) * BIN;
        }
        below += count;
    }
    0.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Image;
    use monogrid_geometry::Rng;

    /// Noise on what `clean` shows.
    fn noisy(sigma: f64, clean: impl Fn(usize, usize) -> f32) -> GrayImage {
        let mut rng = Rng::new(7);
        Image::from_fn(320, 240, |x, y| clean(x, y) + (sigma * rng.normal()) as f32)
    }

    #[test]
    fn noise_is_found_on_flat_shaded_and_striped_images() {
        let flat = |_, _| 128.0;
        let shaded = |x: usize, y: usize| 0.2 * x as f32 + 0.1 * y as f32;
        let striped = |x: usize, _| if x % 16 < 8 { 60.0 } else { 190.0 };
        for sigma in [0.5, 1.0, 2.0, 5.0] {
            let images = [
                noisy(sigma, flat),
                noisy(sigma, shaded),
                noisy(sigma, striped),
            ];
            for found in images.iter().map(noise_sigma) {
                let ratio = f64::from(found) / sigma;
                assert!((0.9..1.1).contains(&ratio), "{found} of {sigma}");
            }
        }
    }

    #[test]
    fn texture_on_half_of_the_image_is_not_noise() {
        let half = |x: usize, y: usize| {
            let blotch = (x as f32 * 0.9).sin() * (y as f32 * 0.7).sin();
            if x < 160 {
                128.0 + 40.0 * blotch
            } else {
                128.0
            }
        };
        let found = noise_sigma(&noisy(1.0, half));
        assert!(found > 0.9 && found < 2.5, "{found}");
    }

    #[test]
    fn images_without_noise_or_pixels_have_none() {
        assert!(noise_sigma(&GrayImage::filled(100, 80, 9.0)) < 0.05);
        assert_eq!(noise_sigma(&GrayImage::filled(2, 80, 9.0)), 0.0);
        assert_eq!(noise_sigma(&GrayImage::default()), 0.0);
    }
}
