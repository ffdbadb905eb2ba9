//! Evidence of bricks as bits: a cell mostly equals one of its neighbours, and if not, its
//! difference to them is small. The same code encodes and decodes.

use super::coder::{Bit, Coder};
use crate::evidence::UNKNOWN;
use crate::key::BRICK_CELLS;

/// Values that a map clamps at are as frequent as "unknown" and get words of their own.
#[derive(Clone, Copy, Debug)]
pub(super) struct Clamps {
    pub min: i16,
    pub max: i16,
}

impl Clamps {
    /// 0 unknown, 1 and 2 the clamps, 3 anything else.
    #[inline]
    fn class(self, value: i16) -> usize {
        match value {
            UNKNOWN => 0,
            _ if value == self.min => 1,
            _ if value == self.max => 2,
            _ => 3,
        }
    }
}

/// What was learned from the bricks of a chunk.
pub(super) struct Model {
    clamps: Clamps,
    uniform: Bit,
    /// Equal to the neighbour in x; by its class and which of the other two equal it.
    same_x: [Bit; 16],
    /// Equal to the neighbour in y; by its class and whether that in z equals it.
    same_y: [Bit; 8],
    /// Equal to the neighbour in z; by its class.
    same_z: [Bit; 4],
    /// A tree of two bits: the class; by the class of the neighbour in x.
    class: [[Bit; 4]; 4],
    /// Trees of eight bits: upper and lower half of the difference to the neighbours' mean.
    upper: [Bit; 256],
    lower: [[Bit; 256]; 3],
}

impl Model {
    pub(super) fn new(clamps: Clamps) -> Self {
        Self {
            clamps,
            uniform: Bit::NEW,
            same_x: [Bit::NEW; 16],
            same_y: [Bit::NEW; 8],
            same_z: [Bit::NEW; 4],
            class: [[Bit::NEW; 4]; 4],
            upper: [Bit::NEW; 256],
            lower: [[Bit::NEW; 256]; 3],
        }
    }

    /// Encodes `cells`, or decodes into them. `below` is the brick below in z, if it was the last
    /// one coded.
    pub(super) fn brick(
        &mut self,
        coder: &mut impl Coder,
        cells: &mut [i16; BRICK_CELLS],
        below: Option<&[i16; BRICK_CELLS]>,
    ) {
        let is_uniform = cells.iter().all(|c| *c == cells[0]);
        let under = |index: usize| below.map_or(UNKNOWN, |b| b[index + BRICK_CELLS - 64]);
        if coder.bit(&mut self.uniform, is_uniform) {
            let z = under(0);
            cells[0] = self.value(coder, cells[0], [z; 3]);
            *cells = [cells[0]; BRICK_CELLS];
            return;
        }
        for index in 0..BRICK_CELLS {
            let z = if index >= 64 {
                cells[index - 64]
            } else {
                under(index)
            };
            // At the sides of the brick the neighbour in z stands in.
            let y = if index & 56 != 0 { cells[index - 8] } else { z };
            let x = if index & 7 != 0 { cells[index - 1] } else { y };
            cells[index] = self.value(coder, cells[index], [x, y, z]);
        }
    }

    #[inline]
    fn value(&mut self, coder: &mut impl Coder, value: i16, [x, y, z]: [i16; 3]) -> i16 {
        let class_x = self.clamps.class(x);
        let context = class_x << 2 | usize::from(x == y) << 1 | usize::from(x == z);
        if coder.bit(&mut self.same_x[context], value == x) {
            return x;
        }
        if y != x {
            let context = self.clamps.class(y) << 1 | usize::from(y == z);
            if coder.bit(&mut self.same_y[context], value == y) {
                return y;
            }
        }
        if z != x && z != y {
            let context = self.clamps.class(z);
            if coder.bit(&mut self.same_z[context], value == z) {
                return z;
            }
        }
        self.new_value(coder, value, class_x, [x, y, z])
    }

    /// A value that no neighbour has.
    fn new_value(
        &mut self,
        coder: &mut impl Coder,
        value: i16,
        class_x: usize,
        neighbours: [i16; 3],
    ) -> i16 {
        let wanted = self.clamps.class(value);
        match tree(coder, &mut self.class[class_x], 2, wanted) {
            0 => return UNKNOWN,
            1 => return self.clamps.min,
            2 => return self.clamps.max,
            _ => {}
        }
        let known = neighbours.iter().filter(|n| **n != UNKNOWN);
        let sum: i32 = known.clone().map(|n| i32::from(*n)).sum();
        let mean = (sum / known.count().max(1) as i32) as i16;
        // The sign goes to the lowest bit, so that small differences are small numbers.
        let difference = value.wrapping_sub(mean);
        let zigzag = (difference << 1 ^ difference >> 15) as u16;
        let upper = tree(coder, &mut self.upper, 8, usize::from(zigzag >> 8));
        let lower = tree(
            coder,
            &mut self.lower[upper.min(2)],
            8,
            usize::from(zigzag & 255),
        );
        let zigzag = (upper << 8 | lower) as u16;
        let difference = (zigzag >> 1) as i16 ^ -((zigzag & 1) as i16);
        mean.wrapping_add(difference)
    }
}

/// A number of some bits, highest first; every bit has the context of those before it.
#[inline]
fn tree(coder: &mut impl Coder, contexts: &mut [Bit], bits: u32, value: usize) -> usize {
    let mut node = 1;
    for bit in (0..bits).rev() {
        node = node << 1 | usize::from(coder.bit(&mut contexts[node], value >> bit & 1 == 1));
    }
    node - (1 << bits)
}
