//! Depth where a keyframe has none, from keyframes that see the same.
//!
//! A table top that is too plain for stereo from here may have been measured from there. What the
//! first surface on the line of sight of a pixel is, other keyframes tell ([`layers`]), if
//!
//! - enough of them have it, and few see through it: depth spreads beyond the edges of objects, and
//!   from one side only;
//! - the pixel looks there as they do ([`brightness`]): else something is before it that none of
//!   them has measured.

mod brightness;
mod layers;
#[cfg(test)]
mod tests;

use crate::scene::{DepthImage, Scene, Seen, Transfer, measurement};
use crate::stereo::at_full_size;
use brightness::{Brightness, smooth_at};
use layers::{Candidate, Layers};
use monogrid_image::Image;
use monogrid_occupancy::DepthPixel as Measurement;

/// Depths that differ by this share of them are of two surfaces.
const TOLERANCE: f64 = 0.03;

/// What is believed of others.
struct Rules {
    /// Keyframes that must have a depth.
    min_support: u16,
    /// Keyframes that see through it, for each that has it, at most.
    max_against: f64,
    /// Largest difference of brightness to most of them, grey levels. Measured: what is taken over
    /// in office is right to 3 % in 89 % of the pixels without this limit and in 93 % with it.
    max_difference: f32,
}

const RULES: Rules = Rules {
    min_support: 2,
    max_against: 0.25,
    max_difference: 10.0,
};

/// Depth of the pixels of a keyframe that have none, as far as others have it, row-major. None
/// without pose or image.
pub(crate) fn completed(scene: &Scene, index: usize) -> Vec<Measurement> {
    completed_by(&RULES, scene, index)
}

fn completed_by(rules: &Rules, scene: &Scene, index: usize) -> Vec<Measurement> {
    let camera = scene.camera;
    let image_of = |index: usize| scene.keyframes[index].image();
    let (Some(this), Some(image)) = (&scene.views[index], image_of(index)) else {
        return Vec::new();
    };
    let others = scene.witnesses(index, scene.config.quality.effort().max_witnesses);
    let tolerance = TOLERANCE as f32;
    let mut layers = Layers::new(camera);
    for (_, view) in &others {
        layers.hear(&view.depths, &view.transfer_to(this, camera), tolerance);
    }
    let mine = DepthImage::of(&this.depths, camera);
    let size = layers.size();
    let mut candidates = layers.candidates(&mine, &image, rules.min_support);
    for (other, view) in others {
        let Some(their_image) = image_of(other) else {
            continue;
        };
        let theirs = DepthImage::of(&view.depths, camera);
        let witness = Witness {
            depth: &theirs,
            other_from_this: this.transfer_to(view, camera),
            tolerance,
        };
        let brightness = Brightness::between(&image, &their_image, |x, y| {
            let [idepth, _] = mine.at(x, y)?;
            witness.confirmed(x, y, idepth)
        });
        let is_alike = |candidate: &Candidate, seen: &Seen| {
            let grey = smooth_at(&their_image, seen.x, seen.y);
            brightness.is_some_and(|brightness| {
                brightness.difference(candidate.grey, grey) < rules.max_difference
            })
        };
        for candidate in &mut candidates {
            witness.judge(candidate, is_alike);
        }
    }
    candidates.retain(|candidate| is_believed(candidate, rules));
    at_pixels_without(&mine, candidates, size)
}

/// Whether enough keyframes have that depth.
fn is_believed(candidate: &Candidate, rules: &Rules) -> bool {
    candidate.same >= rules.min_support
        && 2 * candidate.alike >= candidate.same
        && f64::from(candidate.through) <= rules.max_against * f64::from(candidate.same)
}

/// A keyframe that says what it has of the points of another.
struct Witness<'a> {
    depth: &'a DepthImage,
    other_from_this: Transfer,
    /// Inverse depths that differ by this share of them are of two surfaces.
    tolerance: f32,
}

impl Witness<'_> {
    /// Where it shows a pixel, and its inverse depth there over that of the pixel's point; `None`
    /// where it has none.
    fn ratio(&self, x: f32, y: f32, idepth: f32) -> Option<(Seen, f32)> {
        let seen = self.other_from_this.of(x, y, idepth)?;
        let (column, row) = seen.pixel();
        let [idepth, _] = self.depth.at(column, row)?;
        Some((seen, idepth / seen.idepth))
    }

    /// Where it shows a pixel whose inverse depth it has as well.
    fn confirmed(&self, x: usize, y: usize, idepth: f32) -> Option<Seen> {
        let (seen, ratio) = self.ratio(x as f32, y as f32, idepth)?;
        ((ratio - 1.0).abs() <= self.tolerance).then_some(seen)
    }

    /// Its voice on a candidate.
    fn judge(&self, candidate: &mut Candidate, is_alike: impl Fn(&Candidate, &Seen) -> bool) {
        let [x, y] = candidate.place();
        let Some((seen, ratio)) = self.ratio(x, y, candidate.idepth) else {
            return;
        };
        if ratio < 1.0 - self.tolerance {
            candidate.through += 1;
        } else if ratio <= 1.0 + self.tolerance {
            candidate.same += 1;
            candidate.alike += u16::from(is_alike(candidate, &seen));
        }
    }
}

/// The first of the surfaces on each line of sight, at the pixels that have no depth.
fn at_pixels_without(
    mine: &DepthImage,
    candidates: Vec<Candidate>,
    (width, height): (usize, usize),
) -> Vec<Measurement> {
    let mut idepths = Image::filled(width, height, 0.0_f32);
    let mut sigmas = Image::filled(width, height, 0.0_f32);
    for candidate in candidates {
        let (x, y) = (candidate.column.into(), candidate.row.into());
        if candidate.idepth > idepths.at(x, y) {
            idepths.set(x, y, candidate.idepth);
            sigmas.set(x, y, candidate.relative_sigma);
        }
    }
    let pixels = (0..2 * height).flat_map(|y| (0..2 * width).map(move |x| (x, y)));
    pixels
        .filter(|(x, y)| mine.at(*x, *y).is_none())
        .filter_map(|(x, y)| {
            let idepth = at_full_size(&idepths, x, y)?;
            let sigma = sigmas.at(x / 2, y / 2) * idepth;
            Some(measurement((x, y), idepth, sigma))
        })
        .collect()
}
