//! Packed bricks: a palette of the values that occur, and per cell the index of its value.
//!
//! In a finished map most bricks that are not uniform hold few values: unknown, the limits, and
//! what one or two scans add to free space. A palette needs a quarter of the memory of 512 values
//! and loses nothing. Indices lie in bit planes, so that any number of bits can be read without
//! crossing words, and the planes of 64 cells lie side by side in one cache line.
//!
//! A brick is a run of 64-bit words: 16-bit lanes (the number of planes and of values, the values)
//! filled up to whole words, then per 64 cells one word for each plane, lowest bit first.

use crate::key::BRICK_CELLS;

/// Cells that share the words of their planes.
const GROUP: usize = 64;
const LANES: usize = 4;
/// Words of a brick that is not packed: a packed one must be smaller.
const UNPACKED_WORDS: usize = BRICK_CELLS * size_of::<i16>() / size_of::<u64>();
/// Most values of a palette: more would need as much memory as the brick itself.
const MAX_VALUES: usize = 256;
const PLANES_BITS: u32 = 4;

/// The values that occur in a brick in the order of their first cells, and the index per cell;
/// `None` if there are too many values.
fn palette(cells: &[i16; BRICK_CELLS]) -> Option<(Vec<i16>, [u8; BRICK_CELLS])> {
    const SLOTS: usize = 1024;
    // Open addressing: index plus one.
    let mut slots = [0_u16; SLOTS];
    let mut values: Vec<i16> = Vec::with_capacity(16);
    let mut index_of_cell = [0; BRICK_CELLS];
    for (cell, &value) in index_of_cell.iter_mut().zip(cells) {
        let mut slot = (value as u16).wrapping_mul(0x9e37) as usize >> 6;
        *cell = loop {
            match usize::from(slots[slot]) {
                0 if values.len() == MAX_VALUES => return None,
                0 => {
                    values.push(value);
                    slots[slot] = values.len() as u16;
                    break (values.len() - 1) as u8;
                }
                found if values[found - 1] == value => break (found - 1) as u8,
                _ => slot = (slot + 1) % SLOTS,
            }
        };
    }
    Some((values, index_of_cell))
}

/// Appends a brick to `words`; `false`, and nothing appended, if it would not become smaller.
pub(crate) fn pack(cells: &[i16; BRICK_CELLS], words: &mut Vec<u64>) -> bool {
    let Some((values, index_of_cell)) = palette(cells) else {
        return false;
    };
    // Bits of an index.
    let planes = (values.len().max(2) - 1).ilog2() as usize + 1;
    let head = (values.len() + 1).div_ceil(LANES);
    if head + planes * (BRICK_CELLS / GROUP) >= UNPACKED_WORDS {
        return false;
    }
    let first = words.len();
    words.resize(first + head, 0);
    let sizes = (values.len() << PLANES_BITS | planes) as u16;
    let values = values.into_iter().map(|value| value as u16);
    for (lane, bits) in std::iter::once(sizes).chain(values).enumerate() {
        words[first + lane / LANES] |= u64::from(bits) << (lane % LANES * 16);
    }
    for group in index_of_cell.chunks_exact(GROUP) {
        for plane in 0..planes {
            let bits = group.iter().enumerate();
            words.push(bits.fold(0, |word, (cell, index)| {
                word | u64::from(index >> plane & 1) << cell
            }));
        }
    }
    true
}

/// One packed brick.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PackedBrick<'a> {
    /// From its first word on; what follows it is not read.
    words: &'a [u64],
    planes: usize,
    head: usize,
}

impl<'a> PackedBrick<'a> {
    /// The brick that [`pack`] appended when `words` began here.
    #[inline]
    pub(crate) fn new(words: &'a [u64]) -> Self {
        let sizes = words[0] as u16 as usize;
        Self {
            words,
            planes: sizes & ((1 << PLANES_BITS) - 1),
            head: ((sizes >> PLANES_BITS) + 1).div_ceil(LANES),
        }
    }

    /// Number of words.
    pub(crate) fn len(self) -> usize {
        self.head + self.planes * (BRICK_CELLS / GROUP)
    }

    /// Its words.
    pub(crate) fn words(self) -> &'a [u64] {
        &self.words[..self.len()]
    }

    #[inline]
    fn planes_of(self, group: usize) -> &'a [u64] {
        let first = self.head + group * self.planes;
        &self.words[first..first + self.planes]
    }

    /// Evidence of one cell.
    #[inline]
    pub(crate) fn value(self, cell: usize) -> i16 {
        let planes = self.planes_of(cell / GROUP).iter().enumerate();
        let bit = cell % GROUP;
        let index = planes.fold(0, |index, (plane, word)| {
            index | ((word >> bit & 1) as usize) << plane
        });
        let lane = index + 1;
        (self.words[lane / LANES] >> (lane % LANES * 16)) as i16
    }

    /// Evidence of all cells.
    pub(crate) fn values(self) -> [i16; BRICK_CELLS] {
        let mut indices = [0_u8; BRICK_CELLS];
        for (group, indices) in indices.chunks_exact_mut(GROUP).enumerate() {
            for (plane, word) in self.planes_of(group).iter().enumerate() {
                for (bit, index) in indices.iter_mut().enumerate() {
                    *index |= ((word >> bit & 1) as u8) << plane;
                }
            }
        }
        indices.map(|index| {
            let lane = usize::from(index) + 1;
            (self.words[lane / LANES] >> (lane % LANES * 16)) as i16
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::UNKNOWN;
    use crate::test_random::Random;

    #[test]
    fn bricks_of_any_number_of_values_come_back_as_they_were() {
        let mut random = Random(3);
        let mut random = move || random.bits(24) as usize;
        let mut words = vec![7; 3];
        let mut packed = Vec::new();
        let mut refused = 0;
        for count in (1..140).chain([200, 255, 256, 257, 512]) {
            let values: Vec<i16> = (0..count)
                .map(|i| if i == 1 { UNKNOWN } else { random() as i16 })
                .collect();
            let cells: [i16; BRICK_CELLS] =
                std::array::from_fn(|i| values[if i < count { i } else { random() % count }]);
            let first = words.len();
            if pack(&cells, &mut words) {
                assert!(words.len() - first < UNPACKED_WORDS, "{count} values");
                packed.push((first, words.len(), cells));
            } else {
                assert_eq!(words.len(), first);
                refused += 1;
            }
        }
        assert!(refused >= 2 && packed.len() > 138, "{refused} refused");
        for (first, end, cells) in packed {
            let brick = PackedBrick::new(&words[first..]);
            assert_eq!(brick.words(), &words[first..end]);
            assert_eq!(brick.values(), cells);
            assert!((0..BRICK_CELLS).all(|i| brick.value(i) == cells[i]));
        }
    }

    #[test]
    fn two_values_need_nine_words() {
        let mut words = Vec::new();
        assert!(pack(
            &std::array::from_fn(|i| if i < 100 { -8192 } else { UNKNOWN }),
            &mut words
        ));
        assert_eq!(words.len(), 9);
    }
}
