//! Surfaces that other keyframes have on the lines of sight of a keyframe, at half its size.

use super::brightness::smooth_at;
use crate::KeyframeCamera;
use crate::scene::{DepthImage, KeptDepths, Transfer};
use monogrid_image::Image;
use monogrid_occupancy::DepthPixel as Measurement;

/// How much less certain depth is where it was taken over than where it was measured: half of what
/// is wrong lies in rims of objects (`docs/studies.md`).
const TAKEN_OVER: f32 = 1.3;
/// Surfaces on a line of sight that are told apart.
const MAX_LAYERS: usize = 3;

/// One surface on a line of sight.
#[derive(Clone, Copy, Debug, Default)]
struct Layer {
    /// Of inverse depths by their weights.
    sum: f32,
    weights: f32,
    /// Keyframes that have it.
    support: u16,
}

impl Layer {
    fn idepth(&self) -> f32 {
        self.sum / self.weights
    }
}

/// The surfaces on the lines of sight of the pixels of half the image.
#[derive(Debug)]
pub(super) struct Layers {
    layers: Image<[Layer; MAX_LAYERS]>,
    /// The nearest that one keyframe has: inverse depth, 0 for none, and its relative standard
    /// deviation.
    nearest: Image<[f32; 2]>,
}

impl Layers {
    /// Without surfaces.
    pub fn new(camera: &KeyframeCamera) -> Self {
        let (width, height) = (camera.width / 2, camera.height / 2);
        Self {
            layers: Image::filled(width, height, [Layer::default(); MAX_LAYERS]),
            nearest: Image::filled(width, height, [0.0; 2]),
        }
    }

    /// Width and height of half the image, px.
    pub fn size(&self) -> (usize, usize) {
        (self.layers.width(), self.layers.height())
    }

    /// Adds the first surface that a keyframe has on each line of sight; inverse depths that differ
    /// by more than this share are of two.
    pub fn hear(&mut self, depths: &KeptDepths, this_from_other: &Transfer, tolerance: f32) {
        let (width, height) = self.size();
        self.nearest.as_mut_slice().fill([0.0; 2]);
        // at half the size two pixels of four are enough
        let is_even = |pixel: &&Measurement| (pixel.x + pixel.y).is_multiple_of(2);
        for kind in depths.kinds() {
            for pixel in kind.iter().filter(is_even) {
                let seen = this_from_other.of(pixel.x.into(), pixel.y.into(), pixel.idepth);
                let Some(seen) = seen else { continue };
                let (x, y) = seen.pixel();
                let (x, y) = (x / 2, y / 2);
                // the last row and column of an odd size have no pixel
                if x < width && y < height && seen.idepth > self.nearest.at(x, y)[0] {
                    let sigma = pixel.sigma_idepth / pixel.idepth;
                    self.nearest.set(x, y, [seen.idepth, sigma]);
                }
            }
        }
        let layers = self.layers.as_mut_slice().iter_mut();
        for (layers, [idepth, sigma]) in layers.zip(self.nearest.as_slice()) {
            if *idepth > 0.0 {
                join(layers, *idepth, 1.0 / (sigma * sigma), tolerance);
            }
        }
    }

    /// Those that so many keyframes have, where a pixel has no depth.
    pub fn candidates(
        self,
        mine: &DepthImage,
        image: &Image<u8>,
        min_support: u16,
    ) -> Vec<Candidate> {
        let mut candidates = Vec::new();
        for row in 0..self.layers.height() {
            for (column, layers) in self.layers.row(row).iter().enumerate() {
                let (x, y) = (2 * column, 2 * row);
                let of_four = [(x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)];
                if of_four.iter().all(|(x, y)| mine.at(*x, *y).is_some()) {
                    continue;
                }
                let has_support = |layer: &&Layer| layer.support >= min_support;
                candidates.extend(layers.iter().filter(has_support).map(|layer| Candidate {
                    column: column as u16,
                    row: row as u16,
                    idepth: layer.idepth(),
                    // that of a typical one, as in the fusion
                    relative_sigma: TAKEN_OVER * (f32::from(layer.support) / layer.weights).sqrt(),
                    grey: smooth_at(image, x as f32 + 0.5, y as f32 + 0.5),
                    same: 0,
                    alike: 0,
                    through: 0,
                }));
            }
        }
        candidates
    }
}

/// Adds a surface to the first layer that it is of; those that find no room are left out.
fn join(layers: &mut [Layer; MAX_LAYERS], idepth: f32, weight: f32, tolerance: f32) {
    let is_of = |layer: &&mut Layer| {
        layer.support == 0 || (layer.idepth() / idepth - 1.0).abs() <= tolerance
    };
    if let Some(layer) = layers.iter_mut().find(is_of) {
        layer.sum += weight * idepth;
        layer.weights += weight;
        layer.support += 1;
    }
}

/// A depth that a pixel of half the image may have.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidate {
    pub column: u16,
    pub row: u16,
    pub idepth: f32,
    pub relative_sigma: f32,
    /// Brightness there.
    pub grey: f32,
    /// Keyframes that have this depth.
    pub same: u16,
    /// Those of them to which it looks the same.
    pub alike: u16,
    /// Keyframes that see through it.
    pub through: u16,
}

impl Candidate {
    /// Its place in the full image.
    pub fn place(&self) -> [f32; 2] {
        [self.column, self.row].map(|at| 2.0 * f32::from(at) + 0.5)
    }
}
