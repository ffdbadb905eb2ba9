//! Parts of an image that must not be seen, made plain.

use crate::undistort::erode;
use crate::{GrayImage, Image, Mask};

/// Sweeps over what is filled on each level, from the coarsest to the finest: with what comes from
/// the coarser one they are enough for a surface without an edge.
const SWEEPS: usize = 8;
/// The part that is filled is wider than what the mask names by this share of the longer side:
/// masks end a little within what they cover, and motion blurs its outline.
const MARGIN: f64 = 1.0 / 160.0;

/// Fills what `mask` (of the size of the image, 0 = not to be used) names, and some pixels around
/// it, from what lies around: as smooth as it can be, so that it has neither corners nor edges. An
/// image of which nothing is left becomes black; one of another size than the mask stays as it is.
pub fn fill_masked(image: &mut GrayImage, mask: &Mask) {
    if !mask.same_size(image) || mask.as_slice().iter().all(|used| *used > 0) {
        return;
    }
    let margin = (MARGIN * image.width().max(image.height()) as f64).ceil();
    let known = erode(mask, margin as usize).map(|used| f32::from(u8::from(used > 0)));
    *image = filled(image, &known);
}

/// The image with all pixels of weight 0 filled.
fn filled(image: &GrayImage, known: &GrayImage) -> GrayImage {
    let mut filled = image.clone();
    let (width, height) = (image.width(), image.height());
    let unknown: Vec<usize> = (0..width * height)
        .filter(|at| known.as_slice()[*at] == 0.0)
        .collect();
    if (width, height) == (1, 1) {
        for at in unknown {
            filled.as_mut_slice()[at] = 0.0;
        }
        return filled;
    }
    if unknown.is_empty() {
        return filled;
    }
    let coarse = coarser(image, known);
    let coarse = self::filled(&coarse.0, &coarse.1);
    for at in &unknown {
        let (x, y) = (at % width, at / width);
        filled.as_mut_slice()[*at] = coarse.at(x / 2, y / 2);
    }
    for _ in 0..SWEEPS {
        for at in &unknown {
            let (x, y) = (at % width, at / width);
            let beside = [
                (x.saturating_sub(1), y),
                ((x + 1).min(width - 1), y),
                (x, y.saturating_sub(1)),
                (x, (y + 1).min(height - 1)),
            ];
            let sum: f32 = beside.iter().map(|(x, y)| filled.at(*x, *y)).sum();
            filled.as_mut_slice()[*at] = 0.25 * sum;
        }
    }
    filled
}

/// Means of what is known of two by two pixels, and how much that is.
fn coarser(image: &GrayImage, known: &GrayImage) -> (GrayImage, GrayImage) {
    let (width, height) = (image.width().div_ceil(2), image.height().div_ceil(2));
    let of_four = |x: usize, y: usize| {
        let xs = [2 * x, (2 * x + 1).min(image.width() - 1)];
        let ys = [2 * y, (2 * y + 1).min(image.height() - 1)];
        let (mut sum, mut weight) = (0.0, 0.0);
        for (x, y) in ys.into_iter().flat_map(|y| xs.map(|x| (x, y))) {
            sum += known.at(x, y) * image.at(x, y);
            weight += known.at(x, y);
        }
        (sum, weight)
    };
    let means = Image::from_fn(width, height, |x, y| {
        let (sum, weight) = of_four(x, y);
        if weight > 0.0 { sum / weight } else { 0.0 }
    });
    let weights = Image::from_fn(width, height, |x, y| 0.25 * of_four(x, y).1);
    (means, weights)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_masked_is_gone_and_leaves_no_edge() {
        let slope = |x: usize, y: usize| 40.0 + 0.5 * x as f32 + 0.25 * y as f32;
        let is_masked = |x: usize, y: usize| (50..110).contains(&x) && (30..100).contains(&y);
        let checks = |x: usize, y: usize| {
            if (x / 4 + y / 4).is_multiple_of(2) {
                250.0
            } else {
                5.0
            }
        };
        let mask = Mask::from_fn(161, 121, |x, y| if is_masked(x, y) { 0 } else { 255 });
        let mut image = GrayImage::from_fn(161, 121, |x, y| {
            if is_masked(x, y) {
                checks(x, y)
            } else {
                slope(x, y)
            }
        });
        fill_masked(&mut image, &mask);
        for y in 1..120 {
            for x in 1..160 {
                let error = (image.at(x, y) - slope(x, y)).abs();
                let near = if is_masked(x.min(155) + 4, y) {
                    12.0
                } else {
                    3.0
                };
                assert!(is_masked(x, y) || error < near, "{x} {y}: {error}");
                assert!(error < 12.0, "{x} {y}: {error}");
                let across = (image.at(x + 1, y) - image.at(x - 1, y)).abs() / 2.0;
                let down = (image.at(x, y + 1) - image.at(x, y - 1)).abs() / 2.0;
                assert!(across.max(down) < 4.0, "{x} {y}: {across} {down}");
            }
        }
        assert_eq!(image.at(20, 20), slope(20, 20));
    }

    #[test]
    fn an_image_without_anything_to_use_is_plain() {
        for (width, height) in [(1, 1), (7, 1), (40, 31)] {
            let mut image = GrayImage::from_fn(width, height, |x, y| (x * y % 200) as f32);
            fill_masked(&mut image, &Mask::filled(width, height, 0));
            assert!(image.as_slice().iter().all(|value| *value == 0.0));
        }
        let mut image = GrayImage::filled(4, 4, 9.0);
        fill_masked(&mut image, &Mask::filled(5, 4, 0));
        assert_eq!(image.at(2, 2), 9.0);
    }
}
