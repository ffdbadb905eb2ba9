//! A dense box of cells that are occupied, free or unknown, two bits each.

use super::TruthError;
use monogrid_occupancy::{BrickKey, MapConfig, MapError, Occupancy, OccupancyMap, VoxelKey};

/// Two-bit codes. `CLOSED` exists only while holes are closed.
pub(crate) const UNKNOWN: u8 = 0;
pub(crate) const FREE: u8 = 1;
pub(crate) const OCCUPIED: u8 = 2;
pub(crate) const CLOSED: u8 = 3;

/// A ground-truth map: a box of cells of edge `resolution`, cell `k` covering
/// `[k * resolution, (k + 1) * resolution)` on each axis. Outside the box everything is unknown.
#[derive(Clone, Debug, PartialEq)]
pub struct TruthGrid {
    resolution: f64,
    first: [i32; 3],
    size: [usize; 3],
    /// Four cells per byte, x fastest; every row of cells starts at a byte.
    bytes: Vec<u8>,
    row_bytes: usize,
}

/// How many cells are in which state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct CellCounts {
    /// Known to be free.
    pub free: u64,
    /// Known to be occupied.
    pub occupied: u64,
    /// Not known.
    pub unknown: u64,
}

impl CellCounts {
    /// All cells.
    #[must_use]
    pub fn total(&self) -> u64 {
        self.free + self.occupied + self.unknown
    }

    pub(crate) fn add(&mut self, state: Occupancy) {
        match state {
            Occupancy::Free => self.free += 1,
            Occupancy::Occupied => self.occupied += 1,
            Occupancy::Unknown => self.unknown += 1,
        }
    }

    pub(crate) fn sum<'a>(parts: impl IntoIterator<Item = &'a Self>) -> Self {
        let mut sum = Self::default();
        for part in parts {
            sum.free += part.free;
            sum.occupied += part.occupied;
            sum.unknown += part.unknown;
        }
        sum
    }
}

impl TruthGrid {
    /// A grid of unknown cells from `first` to `last`, both inclusive.
    ///
    /// # Errors
    /// A resolution that is not positive, an empty box, or more than `max_cells` cells.
    pub fn new(
        resolution: f64,
        first: [i32; 3],
        last: [i32; 3],
        max_cells: u64,
    ) -> Result<Self, TruthError> {
        if !(resolution.is_finite() && resolution > 0.0) {
            return Err(TruthError::Resolution(resolution));
        }
        let edges: [i64; 3] = std::array::from_fn(|a| i64::from(last[a]) - i64::from(first[a]) + 1);
        if edges.iter().any(|e| *e <= 0) {
            return Err(TruthError::EmptyBox { first, last });
        }
        let cells = edges.iter().fold(1_u64, |n, e| n.saturating_mul(*e as u64));
        if cells > max_cells {
            return Err(TruthError::TooManyCells { cells, max_cells });
        }
        let size = edges.map(|e| e as usize);
        let row_bytes = size[0].div_ceil(4);
        Ok(Self {
            resolution,
            first,
            size,
            bytes: vec![0; row_bytes * size[1] * size[2]],
            row_bytes,
        })
    }

    /// Edge of a cell.
    #[must_use]
    pub fn resolution(&self) -> f64 {
        self.resolution
    }

    /// Key of the first cell of the box.
    #[must_use]
    pub fn first_key(&self) -> [i32; 3] {
        self.first
    }

    /// Cells along x, y and z.
    #[must_use]
    pub fn size(&self) -> [usize; 3] {
        self.size
    }

    /// The cell that holds a point, whether it is in the box or not; `None` when it is not finite.
    #[must_use]
    pub fn key(&self, point_in_map: [f64; 3]) -> Option<[i32; 3]> {
        VoxelKey::from_point(point_in_map, 1.0 / self.resolution).map(VoxelKey::to_array)
    }

    /// Centre of a cell.
    #[must_use]
    pub fn center(&self, key: [i32; 3]) -> [f64; 3] {
        VoxelKey::from_array(key).center(self.resolution)
    }

    /// What is true of a cell; unknown outside the box.
    #[must_use]
    pub fn state(&self, key: [i32; 3]) -> Occupancy {
        self.local(key)
            .map_or(Occupancy::Unknown, |cell| self.state_at(cell))
    }

    /// As [`TruthGrid::state`], of a cell of the box counted from its first.
    #[inline]
    pub(crate) fn state_at(&self, cell: [usize; 3]) -> Occupancy {
        match self.code(cell) {
            FREE => Occupancy::Free,
            OCCUPIED => Occupancy::Occupied,
            _ => Occupancy::Unknown,
        }
    }

    /// Sets a cell; does nothing outside the box.
    pub fn set(&mut self, key: [i32; 3], state: Occupancy) {
        if let Some(cell) = self.local(key) {
            self.set_code(cell, code_of(state));
        }
    }

    /// Number of cells in each state.
    #[must_use]
    pub fn counts(&self) -> CellCounts {
        let layers: Vec<CellCounts> = (0..self.size[2]).map(|z| self.layer_counts(z)).collect();
        CellCounts::sum(&layers)
    }

    /// Number of cells in each state in one layer of constant z, counted from the first.
    #[must_use]
    pub(crate) fn layer_counts(&self, z: usize) -> CellCounts {
        let begin = z * self.size[1] * self.row_bytes;
        let layer = &self.bytes[begin..begin + self.size[1] * self.row_bytes];
        let (mut free, mut occupied) = (0_u64, 0_u64);
        for byte in layer {
            // Padding cells are unknown; closed cells never survive a fill.
            free += u64::from((byte & 0x55).count_ones());
            occupied += u64::from((byte & 0xaa).count_ones());
        }
        let cells = (self.size[0] * self.size[1]) as u64;
        CellCounts {
            free,
            occupied,
            unknown: cells - free - occupied,
        }
    }

    /// Keys of all cells in `state`, z slowest, x fastest.
    pub fn keys_in(&self, state: Occupancy) -> impl Iterator<Item = [i32; 3]> + '_ {
        let wanted = code_of(state);
        self.cells_with(wanted).map(|cell| self.global(cell))
    }

    /// The grid of cells `factor` times as large, aligned to multiples of their edge: occupied
    /// where any cell is, else free where any is.
    ///
    /// # Errors
    /// A factor of zero.
    pub fn coarsened(&self, factor: u32) -> Result<Self, TruthError> {
        let divisor = i32::try_from(factor).ok().filter(|f| *f > 0);
        let divisor = divisor.ok_or(TruthError::Factor(factor))?;
        let coarse_key = |cell| self.global(cell).map(|k| k.div_euclid(divisor));
        let first = coarse_key([0; 3]);
        let last = coarse_key(self.size.map(|edge| edge - 1));
        let resolution = self.resolution * f64::from(factor);
        let mut coarse = Self::new(resolution, first, last, u64::MAX)?;
        // occupied after free: what is both stays occupied
        for code in [FREE, OCCUPIED] {
            for cell in self.cells_with(code) {
                let key = coarse_key(cell);
                coarse.set_code([0, 1, 2].map(|a| (key[a] - first[a]) as usize), code);
            }
        }
        Ok(coarse)
    }

    /// The truth with cells as large as those of `map`, where a whole number of its own makes one;
    /// else as it is.
    ///
    /// # Errors
    /// A truth that is too large.
    pub fn with_cells_of(self, map: &OccupancyMap) -> Result<Self, TruthError> {
        match whole_ratio(map.resolution(), self.resolution) {
            Some(factor) if (2.0..f64::from(u32::MAX)).contains(&factor) => {
                self.coarsened(factor as u32)
            }
            _ => Ok(self),
        }
    }

    /// The same cells as an occupancy map: free and occupied at its clamps.
    ///
    /// # Errors
    /// The map does not fit its memory budget.
    pub fn to_map(&self) -> Result<OccupancyMap, MapError> {
        let config = MapConfig::with_resolution(self.resolution);
        let (free, occupied) = (config.clamp_min, config.clamp_max);
        let mut map = OccupancyMap::new(config)?;
        let log_odds = |key: VoxelKey| match self.local(key.to_array()).map(|cell| self.code(cell))
        {
            Some(FREE) => Some(free),
            Some(OCCUPIED) => Some(occupied),
            _ => None,
        };
        for brick in self.bricks() {
            map.set_brick_log_odds(brick, log_odds)?;
        }
        Ok(map)
    }

    /// The bricks that the box meets.
    fn bricks(&self) -> impl Iterator<Item = BrickKey> + use<> {
        let last = self.global(self.size.map(|edge| edge - 1));
        let first = VoxelKey::from_array(self.first).brick();
        let last = VoxelKey::from_array(last).brick();
        (first.z..=last.z).flat_map(move |z| {
            (first.y..=last.y)
                .flat_map(move |y| (first.x..=last.x).map(move |x| BrickKey::new(x, y, z)))
        })
    }

    /// The known cells of a map, by its own threshold.
    ///
    /// # Errors
    /// A map without known cells, or one whose box holds more than `max_cells`.
    pub fn from_map(map: &OccupancyMap, max_cells: u64) -> Result<Self, TruthError> {
        let (first, last) = map.key_bounds().ok_or(TruthError::NothingKnown)?;
        let [first, last] = [first, last].map(VoxelKey::to_array);
        let mut grid = Self::new(map.resolution(), first, last, max_cells)?;
        for cell in map.cells() {
            grid.set(cell.key.to_array(), cell.state);
        }
        Ok(grid)
    }

    pub(crate) fn local(&self, key: [i32; 3]) -> Option<[usize; 3]> {
        cell_in_box(self.first, self.size, key)
    }

    pub(crate) fn global(&self, cell: [usize; 3]) -> [i32; 3] {
        std::array::from_fn(|a| self.first[a] + cell[a] as i32)
    }

    /// All cells, z slowest, x fastest.
    pub(crate) fn cells(&self) -> impl Iterator<Item = [usize; 3]> + use<> {
        let [nx, ny, nz] = self.size;
        (0..nz).flat_map(move |z| (0..ny).flat_map(move |y| (0..nx).map(move |x| [x, y, z])))
    }

    /// Cells with a code, in the order of [`TruthGrid::cells`].
    pub(crate) fn cells_with(&self, code: u8) -> impl Iterator<Item = [usize; 3]> + '_ {
        (0..self.size[2]).flat_map(move |z| self.layer_with(z, code))
    }

    /// Those of them in one layer of constant z; four cells without the code are passed at once.
    pub(crate) fn layer_with(&self, z: usize, code: u8) -> impl Iterator<Item = [usize; 3]> + '_ {
        let begin = z * self.size[1] * self.row_bytes;
        let layer = &self.bytes[begin..begin + self.size[1] * self.row_bytes];
        let bytes = layer.iter().enumerate().filter(move |(_, byte)| {
            let differs = **byte ^ (code * 0x55);
            !(differs | (differs >> 1)) & 0x55 != 0
        });
        bytes.flat_map(move |(i, byte)| {
            let (first_x, y) = (4 * (i % self.row_bytes), i / self.row_bytes);
            (0..4)
                .filter(move |lane| (byte >> (2 * lane)) & 3 == code)
                .map(move |lane| [first_x + lane, y, z])
                // the padding of a row is no cell
                .filter(|cell| cell[0] < self.size[0])
        })
    }

    #[inline]
    pub(crate) fn code(&self, [x, y, z]: [usize; 3]) -> u8 {
        let byte = self.bytes[(z * self.size[1] + y) * self.row_bytes + (x >> 2)];
        (byte >> ((x & 3) * 2)) & 3
    }

    #[inline]
    pub(crate) fn set_code(&mut self, [x, y, z]: [usize; 3], code: u8) {
        let byte = &mut self.bytes[(z * self.size[1] + y) * self.row_bytes + (x >> 2)];
        let shift = (x & 3) * 2;
        *byte = (*byte & !(3 << shift)) | (code << shift);
    }
}

/// How many cells of an edge of `fine` make one of `coarse`, where that is a whole number.
#[must_use]
pub fn whole_ratio(coarse: f64, fine: f64) -> Option<f64> {
    let ratio = coarse / fine;
    let whole = ratio.round();
    (whole >= 1.0 && (ratio - whole).abs() <= 1e-6 * whole).then_some(whole)
}

/// The cell of a key in a box of cells from `first`, counted from it; `None` outside.
pub(crate) fn cell_in_box(first: [i32; 3], size: [usize; 3], key: [i32; 3]) -> Option<[usize; 3]> {
    let mut cell = [0; 3];
    for axis in 0..3 {
        let offset = i64::from(key[axis]) - i64::from(first[axis]);
        let offset = usize::try_from(offset).ok();
        cell[axis] = offset.filter(|offset| *offset < size[axis])?;
    }
    Some(cell)
}

fn code_of(state: Occupancy) -> u8 {
    match state {
        Occupancy::Unknown => UNKNOWN,
        Occupancy::Free => FREE,
        Occupancy::Occupied => OCCUPIED,
    }
}
