//! Semi-global aggregation of the costs [Hirschmüller, *Stereo Processing by Semiglobal Matching and Mutual
//! Information*, PAMI 2008].
//!
//! Along each of eight directions r, the cost of a plane k at a pixel p is that of the best way there,
//!
//! ```text
//! L(p, k) = C(p, k) + min(L(p-r, k), L(p-r, k±1) + P1, min_i L(p-r, i) + P2) - min_i L(p-r, i)
//! ```
//!
//! where P2 is smaller across edges of the image. What counts is the sum over the directions.

use super::DenseConfig;
use super::sweep::CostVolume;
use monogrid_image::GrayImage;

/// A cost that no sum reaches.
const WALL: i16 = i16::MAX / 4;

/// Sums over all directions, as [`CostVolume::costs`] lie.
pub(super) fn aggregate(volume: &CostVolume, image: &GrayImage, config: &DenseConfig) -> Vec<i16> {
    let mut sums = vec![0_i16; volume.costs.len()];
    for is_backward in [false, true] {
        let pass = Pass {
            volume,
            image,
            config,
            is_backward,
        };
        pass.run(&mut sums);
    }
    sums
}

/// The costs of the ways to one pixel along one direction, with a wall at both ends.
#[derive(Clone)]
struct Way {
    costs: Vec<i16>,
    least: i16,
}

impl Way {
    fn new(planes: usize) -> Self {
        Self {
            costs: vec![WALL; planes + 2],
            least: 0,
        }
    }
}

/// Four directions: from the left and from the three pixels of the row above, or all of that turned around.
struct Pass<'a> {
    volume: &'a CostVolume,
    image: &'a GrayImage,
    config: &'a DenseConfig,
    is_backward: bool,
}

/// Columns from where the ways of a row above come, in the order of the pass.
const ABOVE: [isize; 3] = [-1, 0, 1];
/// An edge of this many grey levels halves the cost of a jump.
const HALVING_GREY: f32 = 8.0;

impl Pass<'_> {
    /// The pixel that is the `column`th of the `row`th in the order of the pass.
    fn pixel(&self, column: usize, row: usize) -> usize {
        let index = row * self.volume.width + column;
        if self.is_backward {
            self.volume.width * self.volume.height - 1 - index
        } else {
            index
        }
    }

    /// Adds the costs of the ways along the four directions.
    fn run(&self, sums: &mut [i16]) {
        let (width, planes) = (self.volume.width, self.volume.idepths.len());
        let start = vec![Way::new(planes); width];
        let mut rows = ABOVE.map(|shift| (shift, start.clone(), start.clone()));
        let mut left = [Way::new(planes), Way::new(planes)];
        for row in 0..self.volume.height {
            for column in 0..width {
                let pixel = self.pixel(column, row);
                let sums = &mut sums[pixel * planes..(pixel + 1) * planes];
                let before = column.checked_sub(1).map(|c| self.pixel(c, row));
                let [from, next] = &mut left;
                self.step(pixel, before.map(|pixel| (pixel, &*from)), next, sums);
                left.swap(0, 1);
                for (shift, above, present) in &mut rows {
                    let from = column.checked_add_signed(*shift).filter(|c| *c < width);
                    let from = from.filter(|_| row > 0);
                    let before = from.map(|c| (self.pixel(c, row - 1), &above[c]));
                    self.step(pixel, before, &mut present[column], sums);
                }
            }
            for (_, above, present) in &mut rows {
                std::mem::swap(above, present);
            }
        }
    }

    /// From the pixel before to this one, or the first pixel of a way.
    fn step(&self, pixel: usize, before: Option<(usize, &Way)>, next: &mut Way, sums: &mut [i16]) {
        match before {
            Some((before, from)) => self.go_on(pixel, before, from, next, sums),
            None => self.begin(pixel, next, sums),
        }
    }

    /// The first pixel of a way.
    fn begin(&self, pixel: usize, next: &mut Way, sums: &mut [i16]) {
        let planes = sums.len();
        let costs = self.volume.at(pixel);
        let mut least = WALL;
        for ((to, cost), sum) in next.costs[1..=planes].iter_mut().zip(costs).zip(sums) {
            *to = i16::from(*cost);
            *sum += *to;
            least = least.min(*to);
        }
        next.least = least;
    }

    /// From one pixel to the next.
    fn go_on(&self, pixel: usize, before: usize, from: &Way, next: &mut Way, sums: &mut [i16]) {
        let planes = sums.len();
        let small = self.config.small_step_cost as i16;
        let grey = self.image.as_slice();
        let gradient = (grey[pixel] - grey[before]).abs();
        let jump = f32::from(self.config.jump_cost) / (1.0 + gradient / HALVING_GREY);
        let jump = from.least + (jump as i16).max(small);
        let costs = self.volume.at(pixel);
        let mut least = WALL;
        let same = &from.costs[1..=planes];
        let (lower, higher) = (&from.costs[..planes], &from.costs[2..planes + 2]);
        let to = &mut next.costs[1..=planes];
        for (((((to, cost), same), lower), higher), sum) in to
            .iter_mut()
            .zip(costs)
            .zip(same)
            .zip(lower)
            .zip(higher)
            .zip(sums)
        {
            let best = (*same).min(jump).min((*lower).min(*higher) + small);
            *to = i16::from(*cost) + best - from.least;
            *sum += *to;
            least = least.min(*to);
        }
        next.least = least;
    }
}
