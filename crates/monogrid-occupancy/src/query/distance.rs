//! Distance to the nearest obstacle everywhere, up to a bound, kept up to date brick by brick.
//!
//! The squared Euclidean distance is a sum over axes, so its minimum over all obstacles is taken
//! axis by axis: along x, of that along y, of that along z (Felzenszwalb and Huttenlocher 2012).
//! All three layers are kept. A change of the map enters as the bricks whose obstacles changed;
//! each layer recomputes the bricks that those can reach along its axis, and hands on only what
//! came out different. The result is exact, and the same as that of a field made anew.

use std::collections::{BTreeSet, HashMap};
use std::hash::{BuildHasherDefault, Hasher};

use super::cast::UnknownCells;
use crate::error::MapError;
use crate::integrate::parallel;
use crate::key::{BRICK_CELLS, BRICK_EDGE, BrickKey, VoxelKey};
use crate::map::OccupancyMap;
use crate::storage::{BrickRef, hash};

/// No obstacle within reach.
const FAR: i16 = i16::MAX;
/// Farthest reach in cells: its square must be below [`FAR`].
const MAX_REACH: f64 = 181.0;
/// Lines of cells along one axis of a brick.
const LINES: usize = 64;

/// Settings of a [`DistanceField`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DistanceConfig {
    /// Farthest distance that is told apart, in map units: positive, at most 181 cells. Time and
    /// memory grow with it. Default 1.
    pub max_distance: f64,
    /// Whether unknown cells are obstacles too (`Stop`). Default: they are not.
    pub unknown: UnknownCells,
}

impl Default for DistanceConfig {
    fn default() -> Self {
        Self {
            max_distance: 1.0,
            unknown: UnknownCells::PassThrough,
        }
    }
}

/// Keys are mixed already.
#[derive(Clone, Copy, Debug, Default)]
struct PackedHasher(u64);

impl Hasher for PackedHasher {
    fn write(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.0 = self.0 << 8 ^ self.0 >> 56 ^ u64::from(*byte);
        }
    }

    fn write_u64(&mut self, packed: u64) {
        self.0 = hash(packed);
    }

    fn finish(&self) -> u64 {
        self.0
    }
}

/// Bricks of the layers together for each brick of a map that need no room in the budget of the
/// map: distances reach beyond what is known, and far beyond it where that is scattered.
const FIELDS_PER_BRICK: usize = 4;

/// Something per brick, by packed key; only ever asked by key, never walked.
type PerBrick<T> = HashMap<u64, T, BuildHasherDefault<PackedHasher>>;
type Squares = [i16; BRICK_CELLS];

/// Distances between the centres of cells and those of the nearest obstacles' cells.
#[derive(Clone, Debug)]
pub struct DistanceField {
    resolution: f64,
    inv_resolution: f64,
    /// In cells.
    reach: i32,
    unknown: UnknownCells,
    revision: u32,
    /// One bit per cell; absent where a brick is as [`DistanceField::untouched_obstacles`].
    obstacles: PerBrick<[u64; 8]>,
    /// Squared distances in cells, along x, along x and y, along all axes; absent where a brick
    /// is as [`DistanceField::untouched`] all over.
    layers: [PerBrick<Box<Squares>>; 3],
}

impl DistanceField {
    /// The distances of a map, computed on up to `threads` threads; they do not depend on their
    /// number.
    ///
    /// # Errors
    /// A reach that is not positive or more than 181 cells, or a field far larger than what is
    /// known of its map.
    pub fn new(
        map: &OccupancyMap,
        config: DistanceConfig,
        threads: usize,
    ) -> Result<Self, MapError> {
        let reach = (config.max_distance * map.inv_resolution).floor();
        let (is_allowed, distance) = ((1.0..=MAX_REACH).contains(&reach), config.max_distance);
        MapError::unless(is_allowed, "max_distance", distance, "1 to 181 cells")?;
        let mut field = Self {
            resolution: map.resolution(),
            inv_resolution: map.inv_resolution,
            reach: reach as i32,
            unknown: config.unknown,
            revision: map.revision(),
            obstacles: PerBrick::default(),
            layers: Default::default(),
        };
        let bricks = map.bricks();
        let of_bricks = FIELDS_PER_BRICK * bricks.len() * size_of::<Squares>();
        let budget = map.config().memory_budget_bytes.saturating_add(of_bricks);
        field.follow(map, bricks, threads, budget)?;
        Ok(field)
    }

    /// Follows the map that this field was made of. Returns the number of bricks in which a
    /// distance changed.
    pub fn update(&mut self, map: &OccupancyMap, threads: usize) -> usize {
        let changed = map.bricks_changed_since(self.revision);
        self.revision = map.revision();
        // where there is no limit nothing is refused
        let changed = self.follow(map, changed, threads, usize::MAX);
        changed.unwrap_or_default()
    }

    /// The revision of the map that this shows.
    #[must_use]
    pub fn revision(&self) -> u32 {
        self.revision
    }

    /// Distance in map units from the centre of the cell that holds a point to the centre of the
    /// nearest obstacle's cell: 0 inside an obstacle; `None` if there is none up to the largest
    /// distance (or the point cannot be addressed).
    #[must_use]
    pub fn distance(&self, point_in_map: [f64; 3]) -> Option<f64> {
        self.distance_of(VoxelKey::from_point(point_in_map, self.inv_resolution)?)
    }

    /// As [`DistanceField::distance`], of a cell.
    #[must_use]
    #[inline]
    pub fn distance_of(&self, key: VoxelKey) -> Option<f64> {
        let squares = self.layers[2].get(&key.brick().pack());
        let square = squares.map_or(self.untouched(), |s| s[key.index_in_brick()]);
        (square != FAR).then(|| f64::from(square).sqrt() * self.resolution)
    }

    /// Direction in which the distance grows, per unit of length; `None` where a neighbouring cell
    /// is beyond the largest distance.
    #[must_use]
    pub fn gradient(&self, point_in_map: [f64; 3]) -> Option<[f64; 3]> {
        let mut gradient = [0.0; 3];
        for (axis, slope) in gradient.iter_mut().enumerate() {
            let beside = |sign: f64| {
                let mut point = point_in_map;
                point[axis] += sign * self.resolution;
                self.distance(point)
            };
            *slope = (beside(1.0)? - beside(-1.0)?) / (2.0 * self.resolution);
        }
        Some(gradient)
    }

    /// Bytes of the three layers and the obstacles, directories excluded.
    #[must_use]
    pub fn bytes_in_memory(&self) -> usize {
        let squares: usize = self.layers.iter().map(HashMap::len).sum();
        squares * size_of::<Squares>() + self.obstacles.len() * size_of::<[u64; 8]>()
    }

    /// The obstacles of a brick of which nothing is known.
    fn untouched_obstacles(&self) -> [u64; 8] {
        match self.unknown {
            UnknownCells::PassThrough => [0; 8],
            UnknownCells::Stop => [!0; 8],
        }
    }

    /// The squared distance of a cell far from everything that is known.
    fn untouched(&self) -> i16 {
        match self.unknown {
            UnknownCells::PassThrough => FAR,
            UnknownCells::Stop => 0,
        }
    }

    fn follow(
        &mut self,
        map: &OccupancyMap,
        changed: Vec<BrickKey>,
        threads: usize,
        budget_bytes: usize,
    ) -> Result<usize, MapError> {
        let mut dirty = Vec::new();
        for key in changed {
            let new = self.obstacles_of(map, key);
            let untouched = self.untouched_obstacles();
            let old = if new == untouched {
                self.obstacles.remove(&key.pack())
            } else {
                self.obstacles.insert(key.pack(), new)
            };
            if old.unwrap_or(untouched) != new {
                dirty.push(key);
            }
        }
        for axis in 0..3 {
            let reached = self.reached(axis, &dirty);
            let more_bytes = reached.len() * size_of::<Squares>();
            let needed_bytes = self.bytes_in_memory() + more_bytes;
            if needed_bytes > budget_bytes {
                return Err(MapError::MemoryBudget {
                    needed_bytes,
                    budget_bytes,
                });
            }
            dirty = self.follow_axis(map, axis, reached, threads);
        }
        Ok(dirty.len())
    }

    /// The bricks of a layer in which `dirty` bricks of the layer before can be felt.
    fn reached(&self, axis: usize, dirty: &[BrickKey]) -> BTreeSet<BrickKey> {
        let bricks = (self.reach + BRICK_EDGE - 1) / BRICK_EDGE;
        let along = |key: &BrickKey| {
            let key = *key;
            (-bricks..=bricks).map(move |offset| shifted(key, axis, offset))
        };
        let reached = dirty.iter().flat_map(along);
        reached.filter(|key| key.is_addressable()).collect()
    }

    fn obstacles_of(&self, map: &OccupancyMap, key: BrickKey) -> [u64; 8] {
        let is_obstacle = |value| self.unknown.stop_at(map.limits.occupancy(value));
        match map.brick(key) {
            BrickRef::Uniform(value) if is_obstacle(value) => [!0; 8],
            BrickRef::Uniform(_) => [0; 8],
            BrickRef::Mixed(_) | BrickRef::Packed(_) => {
                let values = map.brick_values(key);
                std::array::from_fn(|word| {
                    let cells = &values[64 * word..64 * word + 64];
                    let bit = |bits, (i, v): (usize, &i16)| bits | u64::from(is_obstacle(*v)) << i;
                    cells.iter().enumerate().fold(0, bit)
                })
            }
        }
    }

    /// Recomputes one layer in these bricks; returns those that came out different.
    fn follow_axis(
        &mut self,
        map: &OccupancyMap,
        axis: usize,
        reached: BTreeSet<BrickKey>,
        threads: usize,
    ) -> Vec<BrickKey> {
        let mut results: Vec<(BrickKey, Option<Box<Squares>>)> =
            reached.into_iter().map(|key| (key, None)).collect();
        parallel::for_each(&mut results, threads, |_, (key, squares)| {
            // Where unknown cells are obstacles, bricks without a known cell keep the distance 0.
            let is_open = self.unknown == UnknownCells::PassThrough
                || self.obstacles.contains_key(&key.pack())
                || map.brick(*key) != BrickRef::UNKNOWN;
            if is_open {
                *squares = self.squares(axis, *key);
            }
        });
        let mut changed = Vec::new();
        for (key, squares) in results {
            let layer = &mut self.layers[axis];
            if layer.get(&key.pack()) != squares.as_ref() {
                changed.push(key);
                match squares {
                    Some(squares) => layer.insert(key.pack(), squares),
                    None => layer.remove(&key.pack()),
                };
            }
        }
        changed
    }

    /// The layer of an axis in one brick: `min over k of before(cell + k along axis) + k^2`.
    fn squares(&self, axis: usize, key: BrickKey) -> Option<Box<Squares>> {
        let reach = self.reach as usize;
        let window = self.window(axis, key);
        let mut squares = Box::new([FAR; BRICK_CELLS]);
        for position in 0..BRICK_EDGE as usize {
            let mut best = [FAR; LINES];
            for (row, before) in window[position..=position + 2 * reach].iter().enumerate() {
                let Some(before) = before else { continue };
                let offset = row as i32 - self.reach;
                let square = (offset * offset) as i16;
                // Sixty-four lines side by side: this compiles to wide operations.
                for (best, before) in best.iter_mut().zip(before) {
                    *best = (*best).min(before.saturating_add(square));
                }
            }
            for (line, best) in best.into_iter().enumerate() {
                let is_near = i32::from(best) <= self.reach * self.reach;
                squares[index_of(axis, position, line)] = if is_near { best } else { FAR };
            }
        }
        let untouched = self.untouched();
        squares.iter().any(|s| *s != untouched).then_some(squares)
    }

    /// Rows of the layer before across `axis`, from `reach` cells before the brick to `reach`
    /// behind it; `None` where all is far.
    fn window(&self, axis: usize, key: BrickKey) -> Vec<Option<[i16; LINES]>> {
        let mut rows = Vec::with_capacity((2 * self.reach + BRICK_EDGE) as usize);
        let mut brick = (i32::MIN, None);
        for position in -self.reach..self.reach + BRICK_EDGE {
            let offset = position.div_euclid(BRICK_EDGE);
            if brick.0 != offset {
                brick = (offset, self.before(axis, shifted(key, axis, offset)));
            }
            let inside = position.rem_euclid(BRICK_EDGE) as usize;
            let of_lines = |squares: &Squares| {
                std::array::from_fn(|line| squares[index_of(axis, inside, line)])
            };
            let row = brick.1.as_ref().map(of_lines);
            rows.push(row.filter(|row| *row != [FAR; LINES]));
        }
        rows
    }

    /// The layer before `axis` in one brick; `None` where all is far.
    fn before(&self, axis: usize, key: BrickKey) -> Option<Squares> {
        if axis > 0 {
            let squares = self.layers[axis - 1].get(&key.pack());
            let untouched = self.untouched();
            let untouched = || (untouched != FAR).then_some([untouched; BRICK_CELLS]);
            return squares.map(|squares| **squares).or_else(untouched);
        }
        let obstacles = self.obstacles.get(&key.pack());
        let obstacles = obstacles.copied().unwrap_or(self.untouched_obstacles());
        (obstacles != [0; 8]).then(|| {
            std::array::from_fn(|cell| match obstacles[cell / 64] >> (cell % 64) & 1 {
                1 => 0,
                _ => FAR,
            })
        })
    }
}

fn shifted(mut key: BrickKey, axis: usize, offset: i32) -> BrickKey {
    match axis {
        0 => key.x += offset,
        1 => key.y += offset,
        _ => key.z += offset,
    }
    key
}

/// The cell at a position along an axis, on one of the 64 lines across it.
fn index_of(axis: usize, position: usize, line: usize) -> usize {
    match axis {
        0 => position + 8 * line,
        1 => (line & 7) + 8 * position + 64 * (line >> 3),
        _ => line + 64 * position,
    }
}
