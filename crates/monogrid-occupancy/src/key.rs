//! Addresses of cells and bricks.
//!
//! Cell `k` covers `[k * resolution, (k + 1) * resolution)` on each axis, negative indices
//! included, exactly as in OctoMap. A brick is a cube of 8 x 8 x 8 cells.

/// Cells along one edge of a brick.
pub const BRICK_EDGE: i32 = 8;
/// Cells in a brick.
pub const BRICK_CELLS: usize = 512;
/// Bricks exist for indices in `-BRICK_LIMIT..BRICK_LIMIT` on each axis.
pub const BRICK_LIMIT: i32 = 1 << 20;

/// Integer address of a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct VoxelKey {
    /// Index along x.
    pub x: i32,
    /// Index along y.
    pub y: i32,
    /// Index along z.
    pub z: i32,
}

impl VoxelKey {
    /// A key from its three indices.
    #[must_use]
    pub const fn new(x: i32, y: i32, z: i32) -> Self {
        Self { x, y, z }
    }

    /// The first cell of an octant of the cube that begins here; the octants have edges of `half`
    /// cells.
    #[inline]
    pub(crate) const fn of_octant(self, octant: i32, half: i32) -> Self {
        self.moved([
            (octant & 1) * half,
            (octant >> 1 & 1) * half,
            (octant >> 2) * half,
        ])
    }

    /// The cell so many cells away.
    #[inline]
    pub(crate) const fn moved(self, [x, y, z]: [i32; 3]) -> Self {
        Self::new(self.x + x, self.y + y, self.z + z)
    }

    /// The cell so many cells away along an axis.
    #[inline]
    pub(crate) fn along(self, axis: usize, by: i32) -> Self {
        let mut way = [0; 3];
        way[axis] = by;
        self.moved(way)
    }

    /// The cells of the box up to `last`, both inclusive: x fastest, then y, then z.
    #[inline]
    pub(crate) fn to(self, last: Self) -> impl Iterator<Item = Self> {
        let row = move |y, z| (self.x..=last.x).map(move |x| Self::new(x, y, z));
        (self.z..=last.z).flat_map(move |z| (self.y..=last.y).flat_map(move |y| row(y, z)))
    }

    /// Whether the cell is in a box, its first and last cell inclusive.
    #[inline]
    pub(crate) fn is_within(self, first: Self, last: Self) -> bool {
        (first.x..=last.x).contains(&self.x)
            && (first.y..=last.y).contains(&self.y)
            && (first.z..=last.z).contains(&self.z)
    }

    /// The cell that holds `point_in_map`; `None` for a point that is not finite or lies beyond
    /// the addressable range of 8.4 million cells from the origin.
    #[must_use]
    #[inline]
    pub fn from_point(point_in_map: [f64; 3], inv_resolution: f64) -> Option<Self> {
        let limit = f64::from(BRICK_LIMIT * BRICK_EDGE);
        let mut cell = [0; 3];
        let mut inside = true;
        for (cell, coordinate) in cell.iter_mut().zip(point_in_map) {
            let scaled = coordinate * inv_resolution;
            // Rounding towards zero and stepping back is `floor` without a call on processors
            // whose baseline cannot round. Written so that NaN fails.
            inside &= scaled >= -limit && scaled < limit;
            let truncated = scaled as i32;
            *cell = truncated.wrapping_sub(i32::from(f64::from(truncated) > scaled));
        }
        inside.then(|| Self::from_array(cell))
    }

    /// Centre of the cell in map coordinates.
    #[must_use]
    #[inline]
    pub fn center(self, resolution: f64) -> [f64; 3] {
        [self.x, self.y, self.z].map(|i| (f64::from(i) + 0.5) * resolution)
    }

    /// The brick that holds this cell.
    #[must_use]
    #[inline]
    pub const fn brick(self) -> BrickKey {
        BrickKey::new(self.x >> 3, self.y >> 3, self.z >> 3)
    }

    /// Position inside the brick: x fastest, then y, then z.
    #[must_use]
    #[inline]
    pub const fn index_in_brick(self) -> usize {
        ((self.x & 7) | ((self.y & 7) << 3) | ((self.z & 7) << 6)) as usize
    }

    /// The indices as an array.
    #[must_use]
    pub const fn to_array(self) -> [i32; 3] {
        [self.x, self.y, self.z]
    }

    /// A key from an array of indices.
    #[must_use]
    pub const fn from_array(indices: [i32; 3]) -> Self {
        Self::new(indices[0], indices[1], indices[2])
    }
}

/// Bricks to which something is restricted: packed keys, sorted.
pub(crate) type BrickFilter<'a> = Option<&'a [u64]>;

/// Integer address of a brick: the address of its cells divided by 8, rounded down.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct BrickKey {
    /// Index along x.
    pub x: i32,
    /// Index along y.
    pub y: i32,
    /// Index along z.
    pub z: i32,
}

impl BrickKey {
    /// A key from its three indices.
    #[must_use]
    pub const fn new(x: i32, y: i32, z: i32) -> Self {
        Self { x, y, z }
    }

    /// The cell of the brick with the smallest indices.
    #[must_use]
    #[inline]
    pub const fn first_cell(self) -> VoxelKey {
        let Self { x, y, z } = self;
        VoxelKey::new(x * BRICK_EDGE, y * BRICK_EDGE, z * BRICK_EDGE)
    }

    /// The cell at position `index` (see [`VoxelKey::index_in_brick`]).
    #[must_use]
    #[inline]
    pub const fn cell(self, index: usize) -> VoxelKey {
        let index = index as i32;
        let inside = [index & 7, (index >> 3) & 7, index >> 6];
        self.first_cell().moved(inside)
    }

    /// The bricks of the box up to `last`, both inclusive, in the order of their keys.
    pub(crate) fn to(self, last: Self) -> impl Iterator<Item = Self> {
        let column = move |x, y| (self.z..=last.z).map(move |z| Self::new(x, y, z));
        (self.x..=last.x).flat_map(move |x| (self.y..=last.y).flat_map(move |y| column(x, y)))
    }

    /// The number of bricks of that box.
    pub(crate) fn num_to(self, last: Self) -> u128 {
        let span = |a: i32, b: i32| (i64::from(b) - i64::from(a) + 1).max(0) as u128;
        span(self.x, last.x) * span(self.y, last.y) * span(self.z, last.z)
    }

    /// Whether the brick is in a box, its first and last brick inclusive.
    pub(crate) fn is_within(self, first: Self, last: Self) -> bool {
        let cell = self.first_cell();
        cell.is_within(first.first_cell(), last.first_cell())
    }

    /// Whether the brick can be addressed at all.
    #[must_use]
    pub fn is_addressable(self) -> bool {
        let range = -BRICK_LIMIT..BRICK_LIMIT;
        [self.x, self.y, self.z].iter().all(|c| range.contains(c))
    }

    /// 21 bits per axis, x highest: the order of packed keys is that of `(x, y, z)`.
    #[must_use]
    #[inline]
    pub fn pack(self) -> u64 {
        let biased = |c: i32| (c + BRICK_LIMIT) as u64 & 0x1f_ffff;
        (biased(self.x) << 42) | (biased(self.y) << 21) | biased(self.z)
    }

    /// The inverse of [`BrickKey::pack`].
    #[must_use]
    #[inline]
    pub const fn unpack(packed: u64) -> Self {
        Self {
            x: ((packed >> 42) & 0x1f_ffff) as i32 - BRICK_LIMIT,
            y: ((packed >> 21) & 0x1f_ffff) as i32 - BRICK_LIMIT,
            z: (packed & 0x1f_ffff) as i32 - BRICK_LIMIT,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_lie_on_multiples_of_the_resolution_on_both_sides_of_zero() {
        let key = |x: f64| VoxelKey::from_point([x, 0.0, 0.0], 10.0).map(|k| k.x);
        assert_eq!(key(0.05), Some(0));
        assert_eq!(key(-0.05), Some(-1));
        assert_eq!(key(-0.1), Some(-1));
        assert_eq!(key(0.1), Some(1));
        assert_eq!(key(f64::NAN), None);
        assert_eq!(key(1e9), None);
    }

    #[test]
    fn packing_keeps_key_and_order_for_negative_indices() {
        let keys = [
            BrickKey::new(-BRICK_LIMIT, 0, BRICK_LIMIT - 1),
            BrickKey::new(-1, -1, -1),
            BrickKey::new(-1, 0, -5),
            BrickKey::new(0, -7, 3),
            BrickKey::new(0, 0, 0),
            BrickKey::new(5, -2, BRICK_LIMIT - 1),
        ];
        for pair in keys.windows(2) {
            assert!(pair[0].pack() < pair[1].pack(), "{pair:?}");
        }
        for key in keys {
            assert_eq!(BrickKey::unpack(key.pack()), key);
            for index in [0, 1, 8, 64, 511] {
                let cell = key.cell(index);
                assert_eq!((cell.brick(), cell.index_in_brick()), (key, index));
            }
        }
    }
}
