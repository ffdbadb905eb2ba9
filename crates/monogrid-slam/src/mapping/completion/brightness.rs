//! Whether two keyframes show the same.

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
    /// Of two images, by pixels of which it is known where the other one shows them; `None` where there are too few.
    pub fn between(
        mine: &Image<u8>,
        theirs: &Image<u8>,
        place: impl Fn(usize, usize) -> Option<(f32, f32)>,
    ) -> Option<Self> {
        let rows = (0..mine.height()).step_by(STRIDE);
        let pixels = rows.flat_map(|y| (0..mine.width()).step_by(STRIDE).map(move |x| (x, y)));
        let pairs = pixels.filter_map(|(x, y)| {
            let (column, row) = place(x, y)?;
            let there = ((column + 0.5) as usize, (row + 0.5) as usize);
            Some([mean_around(mine, (x, y)), mean_around(theirs, there)])
        });
        Self::of_pairs(pairs.collect())
    }

    /// The line through the medians of the darkest and the brightest third: what only one of them shows, moves neither.
    fn of_pairs(mut pairs: Vec<[f32; 2]>) -> Option<Self> {
        if pairs.len() < MIN_PAIRS {
            return None;
        }
        pairs.sort_by(|a, b| a[0].total_cmp(&b[0]));
        let third = pairs.len() / 3;
        let dark = medians(&pairs[..third]);
        let bright = medians(&pairs[pairs.len() - third..]);
        let middle = medians(&pairs);
        let range = bright[0] - dark[0];
        let gain = match range > MIN_RANGE {
            true => ((bright[1] - dark[1]) / range).clamp(MAX_GAIN.recip(), MAX_GAIN),
            false => 1.0,
        };
        Some(Self {
            gain,
            bias: middle[1] - gain * middle[0],
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
        let middle = values.len() / 2;
        *values.select_nth_unstable_by(middle, f32::total_cmp).1
    })
}

/// Mean of the up to 3x3 pixels around one.
#[inline]
pub(super) fn mean_around(image: &Image<u8>, (x, y): (usize, usize)) -> f32 {
    let (first, last) = (x.saturating_sub(1), (x + 2).min(image.width()));
    let (mut sum, mut count) = (0_u32, 0_u32);
    for row in y.saturating_sub(1)..(y + 2).min(image.height()) {
        for grey in &image.row(row)[first..last] {
            sum += u32::from(*grey);
            count += 1;
        }
    }
    sum as f32 / count as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exposure_is_found_and_what_one_image_shows_alone_does_not_matter() {
        let line = |grey: f32| 1.5 * grey - 20.0;
        let pairs = (0..200).map(|i| {
            let grey = 30.0 + 0.5 * i as f32;
            let other = if i % 7 == 0 { 250.0 } else { line(grey) };
            [grey, other]
        });
        let brightness = Brightness::of_pairs(pairs.collect()).unwrap();
        assert!((brightness.gain - 1.5).abs() < 0.05, "{brightness:?}");
        assert!(brightness.difference(100.0, line(100.0)) < 3.0);
        assert!(brightness.difference(100.0, line(100.0) + 30.0) > 20.0);
        assert_eq!(Brightness::of_pairs(vec![[1.0; 2]; MIN_PAIRS - 1]), None);
        // one grey level tells no gain
        let plain = Brightness::of_pairs(vec![[100.0, 110.0]; 100]).unwrap();
        assert_eq!((plain.gain, plain.bias), (1.0, 10.0));
    }
}
