//! Image pyramids: level 0 is the finest, each level halves the size.

use crate::{GrayImage, Image};
use monogrid_geometry::Pinhole;

/// A grey image at halving resolutions; level 0 is the input.
#[derive(Clone, Debug, Default)]
pub struct Pyramid {
    /// The images, finest first.
    pub levels: Vec<GrayImage>,
}

impl Pyramid {
    /// Memory of the images, bytes.
    #[must_use]
    pub fn bytes(&self) -> usize {
        let bytes = |level: &GrayImage| size_of_val(level.as_slice());
        self.levels.iter().map(bytes).sum()
    }

    /// Builds at most `num_levels` levels, stopping before a side falls below 16 pixels.
    #[must_use]
    pub fn new(image: GrayImage, num_levels: usize) -> Self {
        let mut levels = vec![image];
        while levels.len() < num_levels {
            let last = &levels[levels.len() - 1];
            if last.width() < 32 || last.height() < 32 {
                break;
            }
            let next = half_size(last);
            levels.push(next);
        }
        Self { levels }
    }

    /// The image of a level.
    #[must_use]
    pub fn level(&self, level: usize) -> &GrayImage {
        &self.levels[level]
    }

    /// Number of levels.
    #[must_use]
    pub fn num_levels(&self) -> usize {
        self.levels.len()
    }
}

/// Averages 2x2 blocks; an odd last row or column is dropped, so that the half-pixel rule of
/// [`Pinhole::half`] holds for every size.
#[must_use]
pub fn half_size(image: &GrayImage) -> GrayImage {
    let (w, h) = (image.width() / 2, image.height() / 2);
    let mut output = Vec::with_capacity(w * h);
    for y in 0..h {
        let (top, bottom) = (image.row(2 * y), image.row(2 * y + 1));
        let pairs = top.as_chunks().0.iter().zip(bottom.as_chunks().0);
        output.extend(pairs.map(|([a, b], [c, d])| 0.25 * (a + b + c + d)));
    }
    Image::from_vec(w, h, output).unwrap_or_default()
}

/// Intrinsics of each level of a pyramid.
#[must_use]
pub fn pyramid_intrinsics(finest: &Pinhole, num_levels: usize) -> Vec<Pinhole> {
    std::iter::successors(Some(*finest), |pinhole| Some(pinhole.half()))
        .take(num_levels)
        .collect()
}
