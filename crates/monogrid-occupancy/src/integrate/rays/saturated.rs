//! Saturated space: where the rays of a scan cannot change anything any more.
//!
//! Most visits of the rule `rays` meet cells that hold the lowest value already and take it down
//! once more. A cube is saturated if all its cells hold the lowest value and every beam that could
//! cross it is there still far enough before its obstacle to take them down. The search splits
//! cubes around the sensor and notes, per tile of directions, the range of the nearest cube that is
//! not saturated: rays begin there. It only leaves out updates that change nothing, so the map is
//! that of every ray walked from the sensor.

use crate::integrate::rays::beam::Beams;
use crate::integrate::rays::pyramid::{Bounds, Pyramid};
use crate::key::{BRICK_CELLS, VoxelKey};
use crate::map::OccupancyMap;
use crate::scan::Scan;
use crate::storage::BrickRef;

/// Directions within this slope of the forward axis have tiles.
const WIDEST_SLOPE: f32 = 3.0;
/// Most tiles along an edge.
const MOST_TILES: f64 = 96.0;
/// Beams that are longer on average do without.
const MOST_CELLS: f64 = 160.0;
/// Beyond this range, bricks without a lowest cell are not split.
const FAR_CELLS: f64 = 24.0;
/// Least extent of all tiles together, as slope: tiles are much wider than the margin.
const LEAST_EXTENT: f64 = 0.01;
/// Cubes of this level are split until they are small enough to be shared among threads.
const FIRST_LEVEL: u32 = 7;
/// Edge of the cubes that are handed out to the threads: 2^5 cells.
const ROOT_LEVEL: u32 = 5;
/// Parts of the search per thread.
const PARTS: usize = 4;
/// Level of a brick.
const BRICK_LEVEL: u32 = 3;
/// Guard against the rounding of slopes.
const MARGIN: f64 = 1e-4;
/// Guard against the rounding of ranges, in cells.
const RANGE_MARGIN: f64 = 1e-2;

/// The beams of a scan, by tiles of their directions.
pub(crate) struct BeamTiles {
    /// Rows: right, down and forward of the sensor in the map.
    axes: [[f64; 3]; 3],
    /// Place of the sensor in cells.
    origin: [f64; 3],
    /// A bit for each octant into which beams go.
    octants: u8,
    /// Cell of the sensor.
    start: [i32; 3],
    low: [f64; 2],
    tiles_per_slope: [f64; 2],
    size: [usize; 2],
    /// Per tile, the least range at which a beam raises cells, and the greatest of free space.
    ranges: Pyramid,
    /// Farthest end of free space.
    reach: f64,
    /// Cubes of this level are not split further.
    leaf_level: u32,
}

/// A cube of cells as the sensor sees it.
struct View {
    nearest: f64,
    /// Range of the farthest centre of a cell.
    farthest_center: f64,
    first_tile: [usize; 2],
    last_tile: [usize; 2],
}

impl BeamTiles {
    /// Sorts beams into tiles; `None` if there are none or some look too far aside.
    pub(crate) fn new(scan: &Scan, beams: &Beams) -> Option<Self> {
        let (origin, extent) = (beams.origin, &beams.extent);
        let beams = &beams.measured[..];
        let [low, high] = extent.slopes;
        // Written so that NaN fails. The slopes of a backward beam are mirrored.
        let narrow = (0..2).all(|i| low[i] > -WIDEST_SLOPE && high[i] < WIDEST_SLOPE);
        if beams.is_empty() || !narrow || !extent.looks_forward {
            return None;
        }
        let mean = extent.free / beams.len() as f64;
        // Fine cells are crossed by few beams each: looking for them costs more than it saves.
        if mean > MOST_CELLS {
            return None;
        }
        // A tile is about a third as large as a cell at the mean range.
        let size = [0, 1].map(|i| {
            let width = f64::from(high[i] - low[i]);
            (3.0 * width * mean).clamp(1.0, MOST_TILES).ceil() as usize
        });
        let rotation = scan.world_from_sensor.rotation;
        let mut tiles = Self {
            axes: std::array::from_fn(|a| std::array::from_fn(|i| rotation[i][a])),
            origin,
            start: origin.map(|c| c.floor() as i32),
            octants: extent.octants,
            low: low.map(f64::from),
            tiles_per_slope: std::array::from_fn(|i| {
                size[i] as f64 / f64::from(high[i] - low[i]).max(LEAST_EXTENT)
            }),
            size,
            ranges: Pyramid::from_bounds(1, 1, vec![NO_BEAM]),
            reach: 0.0,
            leaf_level: u32::from(mean > 64.0),
        };
        let mut ranges = vec![NO_BEAM; size[0] * size[1]];
        for beam in beams {
            let range = &mut ranges[tiles.tile_of(beam.slopes)];
            let free = beam.free_cells();
            tiles.reach = tiles.reach.max(free);
            range.raised_from = range.raised_from.min(beam.raises_from() as f32);
            range.free_until = range.free_until.max(free as f32);
        }
        tiles.ranges = Pyramid::from_bounds(size[0], size[1], ranges);
        // Ranges of beams are compared with those of cubes, which other units would falsify.
        let is_rigid = stretch(&rotation) * tiles.reach.max(1000.0) < RANGE_MARGIN;
        is_rigid.then_some(tiles)
    }

    /// Whether a beam goes into the octants around the sensor's cell in which a cube lies.
    ///
    /// Exact, as beams never turn round: cubes that touch the sensor's place are seen from all
    /// tiles, though few beams or none may cross them.
    #[inline]
    fn is_reached(&self, first: VoxelKey, level: u32) -> bool {
        const FALLING: [u8; 3] = [0b1010_1010, 0b1100_1100, 0b1111_0000];
        let first = first.to_array();
        let mut octants = self.octants;
        for axis in 0..3 {
            let start = self.start[axis];
            if start < first[axis] {
                octants &= !FALLING[axis];
            } else if start >= first[axis] + (1 << level) {
                octants &= FALLING[axis];
            }
        }
        octants != 0
    }

    /// The tile of a beam.
    #[inline]
    pub(crate) fn tile_of(&self, slopes: [f32; 2]) -> usize {
        let at = |i: usize| {
            let tile = (f64::from(slopes[i]) - self.low[i]) * self.tiles_per_slope[i];
            (tile as usize).min(self.size[i] - 1)
        };
        at(1) * self.size[0] + at(0)
    }

    /// How the cube of `2^level` cells that begins at `first` is seen; `None` if no tile sees it.
    fn view(&self, first: VoxelKey, level: u32) -> Option<View> {
        let half = 0.5 * f64::from(1_u32 << level);
        let first = first.to_array();
        let center: [f64; 3] = std::array::from_fn(|i| f64::from(first[i]) + half - self.origin[i]);
        let (mut near_sq, mut far_sq) = (0.0, 0.0);
        for c in center {
            let near = (c.abs() - half).max(0.0);
            near_sq += near * near;
            let far = c.abs() + half - 0.5;
            far_sq += far * far;
        }
        let middle = self
            .axes
            .map(|a| a[0] * center[0] + a[1] * center[1] + a[2] * center[2]);
        let extent = self
            .axes
            .map(|a| (a[0].abs() + a[1].abs() + a[2].abs()) * half);
        if middle[2] + extent[2] <= 0.0 {
            return None;
        }
        let (mut first_tile, mut last_tile) = ([0; 2], [0; 2]);
        for axis in 0..2 {
            let (low, high) = if middle[2] - extent[2] > 0.5 * half {
                self.slope_span(axis, middle, extent)
            } else {
                self.slope_span_of_near_cube(axis, center, half)?
            };
            let tile = |slope: f64| (slope - self.low[axis]) * self.tiles_per_slope[axis];
            let (low, high) = (tile(low - MARGIN), tile(high + MARGIN));
            if high < 0.0 || low >= self.size[axis] as f64 {
                return None;
            }
            first_tile[axis] = low.max(0.0) as usize;
            last_tile[axis] = (high as usize).min(self.size[axis] - 1);
        }
        Some(View {
            nearest: near_sq.sqrt(),
            farthest_center: far_sq.sqrt(),
            first_tile,
            last_tile,
        })
    }

    /// Slopes of a cube that lies wholly before the sensor.
    #[inline]
    fn slope_span(&self, axis: usize, middle: [f64; 3], extent: [f64; 3]) -> (f64, f64) {
        let (near, far) = (middle[2] - extent[2], middle[2] + extent[2]);
        let (low, high) = (middle[axis] - extent[axis], middle[axis] + extent[axis]);
        (
            low / if low < 0.0 { near } else { far },
            high / if high > 0.0 { near } else { far },
        )
    }

    /// Slopes between the tile borders that have the cube on both sides of them: for cubes so
    /// near that their slopes have no bound. `None` if the cube is outside of all tiles.
    fn slope_span_of_near_cube(
        &self,
        axis: usize,
        center: [f64; 3],
        half: f64,
    ) -> Option<(f64, f64)> {
        // Least and greatest x - slope * z over the cube.
        let span_at = |slope: f64| {
            let normal: [f64; 3] =
                std::array::from_fn(|i| self.axes[axis][i] - slope * self.axes[2][i]);
            let middle: f64 = (0..3).map(|i| normal[i] * center[i]).sum();
            let extent: f64 = normal.iter().map(|n| n.abs()).sum::<f64>() * half;
            (middle - extent - MARGIN, middle + extent + MARGIN)
        };
        let border = |i: usize| self.low[axis] + i as f64 / self.tiles_per_slope[axis];
        let sees = |i: usize| {
            let (left, right) = (border(i) - MARGIN, border(i + 1) + MARGIN);
            span_at(left).1 >= 0.0 && span_at(right).0 <= 0.0
        };
        let first = (0..self.size[axis]).find(|&i| sees(i))?;
        let last = (first..self.size[axis]).rev().find(|&i| sees(i))?;
        // The middles of the tiles: margins then do not reach the next.
        let middle = |i: usize| self.low[axis] + (i as f64 + 0.5) / self.tiles_per_slope[axis];
        Some((middle(first), middle(last)))
    }

    /// Where the search begins: cubes of [`ROOT_LEVEL`] that beams cross.
    fn roots(&self) -> Vec<VoxelKey> {
        let edge = f64::from(1_u32 << FIRST_LEVEL);
        let first = self
            .origin
            .map(|c| ((c - self.reach) / edge).floor() as i32);
        let last = self
            .origin
            .map(|c| ((c + self.reach) / edge).floor() as i32);
        let mut roots = Vec::new();
        for x in first[0]..=last[0] {
            for y in first[1]..=last[1] {
                for z in first[2]..=last[2] {
                    let at = |c: i32| c << FIRST_LEVEL;
                    self.split(VoxelKey::new(at(x), at(y), at(z)), FIRST_LEVEL, &mut roots);
                }
            }
        }
        roots
    }

    fn split(&self, first: VoxelKey, level: u32, roots: &mut Vec<VoxelKey>) {
        if self.view(first, level).is_none() {
            return;
        }
        if level == ROOT_LEVEL {
            roots.push(first);
        } else {
            for_octants(first, level, |child| self.split(child, level - 1, roots));
        }
    }
}

/// How much a rotation can change lengths, as a share.
fn stretch(rotation: &[[f64; 3]; 3]) -> f64 {
    let dot = |i: usize, j: usize| (0..3).map(|k| rotation[k][i] * rotation[k][j]).sum::<f64>();
    let off = |i: usize, j: usize| (dot(i, j) - f64::from(u8::from(i == j))).abs();
    (0..3).flat_map(|i| (0..3).map(move |j| off(i, j))).sum()
}

const NO_BEAM: Bounds = Bounds {
    raised_from: f32::INFINITY,
    free_until: f32::NEG_INFINITY,
};

/// Per tile, the range in cells before which nothing can change.
pub(crate) struct Saturated {
    until: Vec<f32>,
}

impl Saturated {
    /// The parts of a search through all space that the beams cross freely, to be done in any order
    /// and joined.
    pub(crate) fn parts<'a>(
        map: &'a OccupancyMap,
        tiles: &'a BeamTiles,
        threads: usize,
    ) -> Vec<Search<'a>> {
        let roots = tiles.roots();
        let parts = if threads == 1 { 1 } else { PARTS * threads };
        // Neighbours take about the same time: they are dealt out in turn.
        let part = |first| Search {
            map,
            tiles,
            roots: roots.iter().skip(first).step_by(parts).copied().collect(),
            until: vec![f32::INFINITY; tiles.size[0] * tiles.size[1]],
        };
        (0..parts).map(part).collect()
    }

    /// Joins the parts of a search.
    pub(crate) fn join(parts: &[Search]) -> Self {
        let mut until = Vec::new();
        for part in parts {
            if until.is_empty() {
                until.clone_from(&part.until);
            }
            for (least, found) in until.iter_mut().zip(&part.until) {
                *least = least.min(*found);
            }
        }
        Self { until }
    }

    /// Range in cells up to which a beam of the tile changes nothing, if it is free until there.
    #[inline]
    pub(crate) fn until(&self, tile: usize) -> f64 {
        (f64::from(self.until[tile]) - RANGE_MARGIN).max(0.0)
    }
}

/// A part of the search.
pub(crate) struct Search<'a> {
    map: &'a OccupancyMap,
    tiles: &'a BeamTiles,
    roots: Vec<VoxelKey>,
    until: Vec<f32>,
}

impl Search<'_> {
    /// Does this part.
    pub(crate) fn run(&mut self) {
        for root in std::mem::take(&mut self.roots) {
            self.visit(root, ROOT_LEVEL);
        }
    }

    /// Cubes of bricks.
    fn visit(&mut self, first: VoxelKey, level: u32) {
        let Some((view, passes)) = self.look(first, level) else {
            return;
        };
        if level > BRICK_LEVEL {
            for_octants(first, level, |child| self.visit(child, level - 1));
            return;
        }
        let brick = first.brick();
        let lowest = self.map.limits.min;
        let cells = match self.map.brick(brick) {
            BrickRef::Uniform(value) if value == lowest && passes => return,
            BrickRef::Uniform(value) if value == lowest => Contents::Lowest,
            // Far away, a brick is small enough as it is.
            BrickRef::Uniform(_) if view.nearest > FAR_CELLS => return self.block(&view),
            BrickRef::Uniform(_) => Contents::Other,
            BrickRef::Mixed(_) => self
                .map
                .payload(brick)
                .map_or(Contents::Other, |cells| Contents::mixed(cells, lowest)),
            BrickRef::Packed(_) => Contents::mixed(&self.map.brick_values(brick), lowest),
        };
        self.split(first, level, &view, &cells);
    }

    /// Cubes inside a brick.
    fn visit_cells(&mut self, first: VoxelKey, level: u32, cells: &Contents) {
        let Some((view, passes)) = self.look(first, level) else {
            return;
        };
        if passes && cells.are_lowest(first, level) {
            return;
        }
        self.split(first, level, &view, cells);
    }

    fn split(&mut self, first: VoxelKey, level: u32, view: &View, cells: &Contents) {
        if level <= self.tiles.leaf_level {
            self.block(view);
        } else {
            for_octants(first, level, |child| {
                self.visit_cells(child, level - 1, cells);
            });
        }
    }

    /// A cube that beams cross in free space, and whether none of them can raise a cell of it.
    #[inline]
    fn look(&self, first: VoxelKey, level: u32) -> Option<(View, bool)> {
        if !self.tiles.is_reached(first, level) {
            return None;
        }
        let view = self.tiles.view(first, level)?;
        let ranges = self
            .tiles
            .ranges
            .block_bounds(view.first_tile, view.last_tile);
        if view.nearest > f64::from(ranges.free_until) + RANGE_MARGIN {
            return None;
        }
        let passes = view.farthest_center + RANGE_MARGIN <= f64::from(ranges.raised_from);
        Some((view, passes))
    }

    /// Beams through this cube begin there at the latest.
    fn block(&mut self, view: &View) {
        let nearest = view.nearest as f32;
        for row in view.first_tile[1]..=view.last_tile[1] {
            let start = row * self.tiles.size[0];
            for until in &mut self.until[start + view.first_tile[0]..=start + view.last_tile[0]] {
                *until = until.min(nearest);
            }
        }
    }
}

/// What the cells of a brick hold.
enum Contents {
    /// The lowest value.
    Lowest,
    /// One other value, or unknown.
    Other,
    /// A bit for each cell that holds another value than the lowest, by layers.
    Mixed([u64; 8]),
}

impl Contents {
    fn mixed(cells: &[i16; BRICK_CELLS], lowest: i16) -> Self {
        let mut others = [0; 8];
        for (others, layer) in others.iter_mut().zip(cells.chunks_exact(64)) {
            for (row, cells) in layer.chunks_exact(8).enumerate() {
                let bits = (0..8).fold(0, |bits, x| bits | u64::from(cells[x] != lowest) << x);
                *others |= bits << (8 * row);
            }
        }
        Self::Mixed(others)
    }

    /// Whether a cube inside the brick holds the lowest value.
    #[inline]
    fn are_lowest(&self, first: VoxelKey, level: u32) -> bool {
        /// The squares of `2^level` cells at the beginning of a layer.
        const SQUARES: [u64; 4] = [1, 0x0303, 0x0f0f_0f0f, u64::MAX];
        match self {
            Self::Lowest => true,
            Self::Other => false,
            Self::Mixed(others) => {
                let start = first.index_in_brick();
                let square = SQUARES[level as usize] << (start % 64);
                let layers = start / 64..start / 64 + (1 << level);
                others[layers].iter().all(|others| others & square == 0)
            }
        }
    }
}

/// The eight halves of a cube.
fn for_octants(first: VoxelKey, level: u32, visit: impl FnMut(VoxelKey)) {
    let half = 1 << (level - 1);
    let octants = (0..8).map(|octant| first.of_octant(octant, half));
    octants.for_each(visit);
}
