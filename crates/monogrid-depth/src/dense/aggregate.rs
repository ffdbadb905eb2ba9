//! Semi-global aggregation of the costs, `[SGM08]`.
//!
//! Along each of eight directions r, the cost of a plane k at a pixel p is that of the best way
//! there,
//!
//! ```text
//! L(p, k) = C(p, k) + min(L(p-r, k), L(p-r, k±1) + P1, min_i L(p-r, i) + P2) - min_i L(p-r, i)
//! ```
//!
//! where P2 is smaller across edges of the image. What counts is the sum over the directions.

use super::DenseConfig;
use super::sweep::{CostVolume, MAX_COST};
use monogrid_image::GrayImage;

/// A cost that no way reaches.
const WALL: u8 = u8::MAX;

/// Most that a step may cost: what the ways of four directions cost beyond the pixels then fits a
/// byte.
pub(super) const MAX_STEP_COST: u16 = 63;
const _: () = assert!(MAX_COST as u16 + MAX_STEP_COST < WALL as u16 && 4 * MAX_STEP_COST < 256);

/// Tells of each pixel and its sums over all directions by plane, from the last one to the first.
pub(super) fn aggregate(
    volume: &CostVolume,
    image: &GrayImage,
    config: &DenseConfig,
    mut tell: impl FnMut(usize, &[i16]),
) {
    let pass = |is_backward| Pass {
        volume,
        image,
        config,
        is_backward,
    };
    let planes = volume.idepths.len();
    let mut steps_before = vec![0; volume.costs.len()];
    pass(false).run(|pixel, steps| {
        steps_before[pixel * planes..(pixel + 1) * planes].copy_from_slice(steps);
    });
    let mut sums = vec![0; planes];
    pass(true).run(|pixel, steps| {
        let before = &steps_before[pixel * planes..(pixel + 1) * planes];
        let steps = steps.iter().zip(before);
        for ((sum, cost), (steps, before)) in sums.iter_mut().zip(volume.at(pixel)).zip(steps) {
            *sum = 8 * i16::from(*cost) + i16::from(*steps) + i16::from(*before);
        }
        tell(pixel, &sums);
    });
}

/// The costs of the ways to one pixel along one direction, with a wall at both ends.
#[derive(Clone)]
struct Way {
    costs: Vec<u8>,
    least: u8,
}

/// Four directions: from the left and from the three pixels of the row above, or all of that turned
/// around.
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

    /// Tells of each pixel and what the steps of the ways along the four directions cost there, by
    /// plane.
    fn run(&self, mut tell: impl FnMut(usize, &[u8])) {
        let (width, planes) = (self.volume.width, self.volume.idepths.len());
        let way = Way {
            costs: vec![WALL; planes + 2],
            least: 0,
        };
        let start = vec![way.clone(); width];
        let mut rows = ABOVE.map(|shift| (shift, start.clone(), start.clone()));
        let mut left = [way.clone(), way];
        let mut steps = vec![0; planes];
        for row in 0..self.volume.height {
            for column in 0..width {
                let pixel = self.pixel(column, row);
                steps.fill(0);
                let before = column.checked_sub(1).map(|c| self.pixel(c, row));
                let [from, next] = &mut left;
                self.step(pixel, before.map(|pixel| (pixel, &*from)), next, &mut steps);
                left.swap(0, 1);
                for (shift, above, present) in &mut rows {
                    let from = column.checked_add_signed(*shift).filter(|c| *c < width);
                    let from = from.filter(|_| row > 0);
                    let before = from.map(|c| (self.pixel(c, row - 1), &above[c]));
                    self.step(pixel, before, &mut present[column], &mut steps);
                }
                tell(pixel, &steps);
            }
            for (_, above, present) in &mut rows {
                std::mem::swap(above, present);
            }
        }
    }

    /// From the pixel before to this one, or the first pixel of a way.
    fn step(&self, pixel: usize, before: Option<(usize, &Way)>, next: &mut Way, steps: &mut [u8]) {
        let planes = steps.len();
        let costs = self.volume.at(pixel);
        let to = &mut next.costs[1..=planes];
        let Some((before, from)) = before else {
            to.copy_from_slice(costs);
            next.least = costs.iter().copied().min().unwrap_or(WALL);
            return;
        };
        let small = self.config.small_step_cost.min(MAX_STEP_COST) as u8;
        let grey = self.image.as_slice();
        let gradient = (grey[pixel] - grey[before]).abs();
        let jump = self.config.jump_cost.min(MAX_STEP_COST);
        let jump = f32::from(jump) / (1.0 + gradient / HALVING_GREY);
        let jump = from.least + (jump as u8).max(small);
        let mut least = WALL;
        let (lower, higher) = (&from.costs[..planes], &from.costs[2..planes + 2]);
        let from_planes = from.costs[1..=planes].iter().zip(lower).zip(higher);
        let to = to.iter_mut().zip(costs).zip(steps);
        for (((to, cost), sum), ((same, lower), higher)) in to.zip(from_planes) {
            let beside = (*lower).min(*higher).saturating_add(small);
            let step = (*same).min(jump).min(beside) - from.least;
            *to = *cost + step;
            *sum += step;
            least = least.min(*to);
        }
        next.least = least;
    }
}
