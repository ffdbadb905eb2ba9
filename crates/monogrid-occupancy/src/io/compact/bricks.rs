//! Evidence of bricks as bits: a cell mostly equals one of its neighbours, and if not, its
//! difference to them is small. The same code encodes and decodes.

use super::coder::{Bit, Coder};
use crate::evidence::{Limits, UNKNOWN};
use crate::key::BRICK_CELLS;

/// What was learned from the bricks of a chunk.
pub(super) struct Model {
    limits: Limits,
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
    /// The last brick: its packed key and its cells.
    last: Option<(u64, [i16; BRICK_CELLS])>,
}

impl Model {
    pub(super) fn new(limits: Limits) -> Self {
        Self {
            limits,
            uniform: Bit::NEW,
            same_x: [Bit::NEW; 16],
            same_y: [Bit::NEW; 8],
            same_z: [Bit::NEW; 4],
            class: [[Bit::NEW; 4]; 4],
            upper: [Bit::NEW; 256],
            lower: [[Bit::NEW; 256]; 3],
            last: None,
        }
    }

    /// Encodes the cells of a brick, or decodes into them.
    pub(super) fn brick(
        &mut self,
        coder: &mut impl Coder,
        packed: u64,
        cells: &mut [i16; BRICK_CELLS],
    ) {
        self.cells(coder, packed, cells);
        self.last = Some((packed, *cells));
    }

    fn cells(&mut self, coder: &mut impl Coder, packed: u64, cells: &mut [i16; BRICK_CELLS]) {
        let is_uniform = cells.iter().all(|c| *c == cells[0]);
        // Keys ascend in z.
        let below = self.last.take().filter(|(key, _)| key + 1 == packed);
        let under = |index: usize| {
            let below = below.as_ref();
            below.map_or(UNKNOWN, |(_, b)| b[index + BRICK_CELLS - 64])
        };
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

    /// 0 unknown, 1 and 2 the values that a map clamps at, which are as frequent and get words of
    /// their own, 3 anything else.
    #[inline]
    fn class(&self, value: i16) -> usize {
        match value {
            UNKNOWN => 0,
            _ if value == self.limits.min => 1,
            _ if value == self.limits.max => 2,
            _ => 3,
        }
    }

    #[inline]
    fn value(&mut self, coder: &mut impl Coder, value: i16, [x, y, z]: [i16; 3]) -> i16 {
        let class_x = self.class(x);
        let context = class_x << 2 | usize::from(x == y) << 1 | usize::from(x == z);
        if coder.bit(&mut self.same_x[context], value == x) {
            return x;
        }
        if y != x {
            let context = self.class(y) << 1 | usize::from(y == z);
            if coder.bit(&mut self.same_y[context], value == y) {
                return y;
            }
        }
        if z != x && z != y {
            let context = self.class(z);
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
        let wanted = self.class(value);
        match tree(coder, &mut self.class[class_x], 2, wanted) {
            0 => return UNKNOWN,
            1 => return self.limits.min,
            2 => return self.limits.max,
            _ => {}
        }
        let known = neighbours.iter().filter(|n| **n != UNKNOWN);
        let sum: i32 = known.clone().map(|n| i32::from(*n)).sum();
        let mean = (sum / known.count().max(1) as i32) as i16;
        // The sign goes to the lowest bit, so that small differences are small numbers.
        let difference = value.wrapping_sub(mean);
        let zigzag = (difference << 1 ^ difference >> 15) as u16;
        let upper = tree(coder, &mut self.upper, 8, usize::from(zigzag >> 8));
        let contexts = &mut self.lower[upper.min(2)];
        let lower = tree(coder, contexts, 8, usize::from(zigzag & 255));
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
