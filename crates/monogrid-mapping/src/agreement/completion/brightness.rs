//! Whether two keyframes show the same.

use crate::scene::Seen;
use monogrid_geometry::median::median;
use monogrid_image::Image;

/// Every so many pixels in both directions tell how bright images are.
const STRIDE: usize = 5;
/// Fewest pixels that do.
const MIN_PAIRS: usize = 40;
/// Range of grey levels that tells a gain.
const MIN_RANGE: f32 = 5.0;
/// Largest gain that exposure makes, and its inverse.
const MAX_GAIN: f32 = 3.0;

/// What is grey in one image is `gain grey + bias` in another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Brightness {
    gain: f32,
    bias: f32,
}

impl Brightness {
    /// Of two images, by pixels of which it is known where the other one shows them; `None` where
    /// there are too few.
    pub fn between(
        mine: &Image<u8>,
        theirs: &Image<u8>,
        place: impl Fn(usize, usize) -> Option<Seen>,
    ) -> Option<Self> {
        let rows = (0..mine.height()).step_by(STRIDE);
        let pixels = rows.flat_map(|y| (0..mine.width()).step_by(STRIDE).map(move |x| (x, y)));
        let pairs = pixels.filter_map(|(x, y)| {
            let seen = place(x, y)?;
            let here = smooth_at(mine, x as f32, y as f32);
            Some([here, smooth_at(theirs, seen.x, seen.y)])
        });
        Self::of_pairs(pairs.collect())
    }

    /// The line through the medians of the darkest and the brightest third: what only one of them
    /// shows, moves neither.
    fn of_pairs(mut pairs: Vec<[f32; 2]>) -> Option<Self> {
        if pairs.len() < MIN_PAIRS {
            return None;
        }
        pairs.sort_by(|a, b| a[0].total_cmp(&b[0]));
        let third = pairs.len() / 3;
        let dark = medians(&pairs[..third]);
        let bright = medians(&pairs[pairs.len() - third..]);
        let range = bright[0] - dark[0];
        let gain = match range > MIN_RANGE {
            true => ((bright[1] - dark[1]) / range).clamp(MAX_GAIN.recip(), MAX_GAIN),
            false => 1.0,
        };
        Some(Self {
            gain,
            bias: 0.5 * (dark[1] + bright[1] - gain * (dark[0] + bright[0])),
        })
    }

    /// Difference of two pixels, grey levels between those of both images.
    pub fn difference(self, mine: f32, theirs: f32) -> f32 {
        (self.gain * mine + self.bias - theirs).abs() / self.gain.sqrt()
    }
}

fn medians(pairs: &[[f32; 2]]) -> [f32; 2] {
    [0, 1].map(|k| {
        let mut values: Vec<f32> = pairs.iter().map(|pair| pair[k]).collect();
        median(&mut values).unwrap_or(f32::NAN)
    })
}

/// Grey level at a place, the mean of those half a pixel to all sides: of 3x3 pixels, those on
/// either side as far as they belong to it.
#[inline]
pub(super) fn smooth_at(image: &Image<u8>, x: f32, y: f32) -> f32 {
    let (columns, across) = window(x, image.width());
    let (rows, down) = window(y, image.height());
    let of_row = |row: usize| -> f32 {
        let row = image.row(row);
        let greys = columns.map(|column| f32::from(row[column]));
        across[0] * greys[0] + across[1] * greys[1] + across[2] * greys[2]
    };
    down[0] * of_row(rows[0]) + down[1] * of_row(rows[1]) + down[2] * of_row(rows[2])
}

/// The three pixels around a place along one direction, those of the border again beyond it, and
/// their weights.
#[inline]
fn window(at: f32, size: usize) -> ([usize; 3], [f32; 3]) {
    let at = (at - 0.5).max(0.0);
    let first = at as usize;
    let share = at - first as f32;
    let pixels = [first, first + 1, first + 2].map(|pixel| pixel.min(size - 1));
    (pixels, [0.5 * (1.0 - share), 0.5, 0.5 * share])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_between_pixels_has_the_grey_between_theirs() {
        let slope = Image::from_fn(40, 30, |x, y| (3 * x + 2 * y) as u8);
        for (x, y) in [(10.0, 12.0), (10.5, 12.0), (10.25, 12.8), (38.0, 28.0)] {
            let found = smooth_at(&slope, x, y);
            assert!((found - 3.0 * x - 2.0 * y).abs() < 1e-4, "{x} {y}: {found}");
        }
        let plain = Image::filled(4, 3, 7_u8);
        for (x, y) in [(-0.5, -0.5), (3.49, 2.49)] {
            assert_eq!(smooth_at(&plain, x, y), 7.0);
        }
    }

    #[test]
    fn exposure_is_found_and_what_one_image_shows_alone_does_not_matter() {
        let line = |grey: f32| 1.5 * grey - 20.0;
        let pairs = (0..200).map(|i| {
            let grey = 30.0 + 0.5 * i as f32;
            let other = if i % 11 == 0 { 250.0 } else { line(grey) };
            [grey, other]
        });
        let brightness = Brightness::of_pairs(pairs.collect()).unwrap();
        assert!((brightness.gain - 1.5).abs() < 0.05, "{brightness:?}");
        let off = brightness.difference(60.0, line(60.0));
        assert!(off < 3.0, "{off}");
        assert!(brightness.difference(60.0, line(60.0) + 40.0) > 20.0);
        assert_eq!(Brightness::of_pairs(vec![[1.0; 2]; MIN_PAIRS - 1]), None);
        // one grey level tells no gain
        let plain = Brightness::of_pairs(vec![[100.0, 110.0]; 100]).unwrap();
        assert_eq!((plain.gain, plain.bias), (1.0, 10.0));
    }
}
