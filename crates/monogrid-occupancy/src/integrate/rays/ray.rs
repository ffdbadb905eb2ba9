//! Exact traversal of cells by a ray, in integers.
//!
//! The time of the `j`-th crossing of a plane of axis `a` is `first[a] + j * step[a]`, in units
//! of 2^-40 cells: integers add without rounding, so a walk can begin at any brick on the way and
//! meets the same cells as one that began at the sensor. Times of different axes never tie: their
//! lowest two bits hold the axis, which orders corner crossings x before y before z.

use crate::key::{BRICK_CELLS, BRICK_EDGE, BrickKey};

/// Fraction bits of times.
pub(crate) const TIME_BITS: u32 = 40;
/// Fraction bits of ranges.
pub(crate) const RANGE_BITS: u32 = 32;
/// Longest ray in cells.
pub(crate) const MAX_CELLS: f64 = 131_072.0;
/// Time between planes that a ray as good as parallel to them never reaches.
const NEVER: f64 = (1_u64 << 58) as f64;

/// A ray from the sensor, ready to be walked.
#[derive(Clone, Debug)]
pub(crate) struct Ray {
    start: [i32; 3],
    sign: [i32; 3],
    first: [i64; 3],
    step: [i64; 3],
    /// Crossings in 2^64 units of time, rounded down: they give one crossing too few at most.
    inv_step: [u64; 3],
    /// Range of the start cell's centre along the ray.
    range_at_start: i64,
    /// Range gained by one step along each axis.
    range_step: [i64; 3],
    /// Time at which the ray ends.
    pub end: i64,
}

/// Where a ray is inside a brick.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Entry {
    /// Position in the brick, x fastest.
    pub index: usize,
    /// Times of the next crossings.
    next: [i64; 3],
    /// Range of the cell's centre.
    pub range: i64,
    /// Time at which the ray leaves the brick or ends.
    stop: i64,
}

/// Somebody who is told of the cells that a ray crosses.
pub(crate) trait CellVisitor {
    /// A cell: its position in the brick, and the range of its centre.
    fn cell(&mut self, index: usize, range: i64);
    /// The ray leaves the brick with this packed key, or ends in it.
    fn leave_brick(&mut self, key: u64);
}

/// Time or range in fixed point.
#[inline]
pub(crate) fn fixed(value: f64, bits: u32) -> i64 {
    let scaled = value * (1_u64 << bits) as f64;
    // Rounds without a call on processors whose baseline cannot.
    (scaled + 0.5_f64.copysign(scaled)) as i64
}

impl Ray {
    /// A ray from `origin` (in cells) along the unit vector `direction`, `length` cells long.
    ///
    /// The origin must be within the map's address range less [`MAX_CELLS`].
    pub(crate) fn new(origin: [f64; 3], direction: [f64; 3], length: f64) -> Self {
        // `floor` without a call on processors whose baseline cannot round.
        let start = origin.map(|o| o as i32 - i32::from(f64::from(o as i32) > o));
        let mut ray = Self {
            start,
            sign: [1; 3],
            first: [0; 3],
            step: [0; 3],
            inv_step: [0; 3],
            range_at_start: 0,
            range_step: [0; 3],
            end: fixed(length.clamp(0.0, MAX_CELLS), TIME_BITS),
        };
        let mut range = 0.0;
        for axis in 0..3 {
            let fraction = origin[axis] - f64::from(start[axis]);
            let speed = direction[axis].abs();
            // Without branches: nobody can predict the signs.
            let falls = i32::from(direction[axis] < 0.0);
            ray.sign[axis] = 1 - 2 * falls;
            let to_plane = (f64::from(1 - falls) - fraction).abs();
            let per_cell = (1_u64 << TIME_BITS) as f64 / speed;
            // `min` also turns the infinity of a parallel ray into NEVER.
            ray.step[axis] = per_cell.min(NEVER) as i64 & !3;
            let first = if to_plane == 0.0 {
                0.0
            } else {
                to_plane * per_cell
            };
            ray.first[axis] = (first.min(NEVER) as i64 & !3) | axis as i64;
            let per_time = speed * (1_u64 << (64 - TIME_BITS)) as f64;
            ray.inv_step[axis] = (per_time as u64).saturating_sub(1);
            ray.range_step[axis] = fixed(speed, RANGE_BITS);
            range += (0.5 - fraction) * direction[axis];
        }
        ray.range_at_start = fixed(range, RANGE_BITS);
        ray
    }

    /// Calls `visit(packed key, time at which the ray leaves the brick)` for every brick.
    #[inline]
    pub(crate) fn for_each_brick(&self, visit: impl FnMut(u64, i64)) {
        self.for_each_brick_from(0, visit);
    }

    /// Calls `visit(packed key, time at which the ray leaves the brick)` for every brick that the
    /// ray has not left at the time `from`.
    #[inline]
    pub(crate) fn for_each_brick_from(&self, from: i64, mut visit: impl FnMut(u64, i64)) {
        self.walk_bricks(from, |key, leaves| {
            visit(key, leaves);
            false
        });
    }

    /// Calls `stop(packed key)` for every brick until it says so.
    pub(crate) fn any_brick(&self, mut stop: impl FnMut(u64) -> bool) {
        self.walk_bricks(0, |key, _| stop(key));
    }

    #[inline]
    pub(crate) fn walk_bricks(&self, from: i64, mut visit: impl FnMut(u64, i64) -> bool) {
        let from = from.min(self.end - 1);
        let mut next = [0; 3];
        let mut cell = self.start;
        for axis in 0..3 {
            if from > 0 {
                cell[axis] += self.sign[axis] * self.crossings(axis, from, (0, i64::MAX)) as i32;
            }
            // Crossings until the ray leaves the brick of this cell.
            let brick_end = if self.sign[axis] > 0 {
                cell[axis] | (BRICK_EDGE - 1)
            } else {
                cell[axis] & -BRICK_EDGE
            };
            let crossings = (brick_end - self.start[axis]) * self.sign[axis];
            next[axis] = self.first[axis] + i64::from(crossings) * self.step[axis];
        }
        let mut key = BrickKey::new(cell[0] >> 3, cell[1] >> 3, cell[2] >> 3).pack();
        let key_step = [1_i64 << 42, 1 << 21, 1];
        loop {
            let leaves = next[0].min(next[1]).min(next[2]);
            if visit(key, leaves) || leaves >= self.end {
                return;
            }
            let axis = (leaves & 3) as usize;
            next[axis] += self.step[axis] * i64::from(BRICK_EDGE);
            key = key.wrapping_add_signed(key_step[axis] * i64::from(self.sign[axis]));
        }
    }

    /// Where the ray enters a brick that it crosses.
    #[inline]
    pub(crate) fn enter(&self, brick: BrickKey) -> Entry {
        self.enter_from(brick, 0)
    }

    /// Where the ray enters a brick that it crosses, or is at the time `from` if that is later.
    #[inline]
    pub(crate) fn enter_from(&self, brick: BrickKey, from: i64) -> Entry {
        let low = brick.first_cell().to_array();
        let mut before = [0_i64; 3];
        let mut enters = if from > 0 {
            from.min(self.end - 1)
        } else {
            i64::MIN
        };
        let mut stop = self.end;
        for axis in 0..3 {
            // Crossings on this axis before the ray is in the brick's layer.
            let cells = if self.sign[axis] > 0 {
                low[axis] - self.start[axis]
            } else {
                self.start[axis] - low[axis] - (BRICK_EDGE - 1)
            };
            before[axis] = i64::from(cells);
            let plane = self.first[axis] + (before[axis] - 1) * self.step[axis];
            if cells > 0 {
                enters = enters.max(plane);
            }
            stop = stop.min(plane + i64::from(BRICK_EDGE) * self.step[axis]);
        }
        let mut entry = Entry {
            index: 0,
            next: [0; 3],
            range: self.range_at_start,
            stop,
        };
        for (axis, &before) in before.iter().enumerate() {
            let window = (before.max(0), before + i64::from(BRICK_EDGE) - 1);
            let crossings = self.crossings(axis, enters, window);
            let cell = self.start[axis] + self.sign[axis] * crossings as i32;
            entry.index |= ((cell & 7) as usize) << (3 * axis);
            entry.next[axis] = self.first[axis] + crossings * self.step[axis];
            entry.range += crossings * self.range_step[axis];
        }
        entry
    }

    /// Crossings of `axis` up to and at `time`, known to lie in the window from `least` to `most`.
    #[inline]
    fn crossings(&self, axis: usize, time: i64, (least, most): (i64, i64)) -> i64 {
        if time < self.first[axis] {
            return least;
        }
        let elapsed = time - self.first[axis];
        let estimate = (u128::from(elapsed as u64) * u128::from(self.inv_step[axis])) >> 64;
        let mut crossings = (estimate as i64 + 1).clamp(least, most);
        if crossings < most && crossings * self.step[axis] <= elapsed {
            crossings += 1;
        }
        crossings
    }

    /// Calls `visit(position in the brick, range of the centre)` for every cell from `entry` on.
    #[inline]
    pub(crate) fn walk(&self, entry: Entry, mut visit: impl FnMut(usize, i64)) {
        self.walk_until(entry, |index, range| {
            visit(index, range);
            false
        });
    }

    /// Calls `stop(position in the brick, range of the centre)` for every cell from `entry` on
    /// until it says so.
    #[inline]
    pub(crate) fn walk_until(&self, entry: Entry, mut stop_at: impl FnMut(usize, i64) -> bool) {
        let Entry {
            mut index,
            next: [mut x, mut y, mut z],
            mut range,
            stop,
        } = entry;
        let index_step = self.index_step();
        let range_step = self.range_step_by_axis();
        loop {
            let time = x.min(y).min(z);
            if stop_at(index % BRICK_CELLS, range) || time >= stop {
                return;
            }
            self.advance(time, [&mut x, &mut y, &mut z]);
            let axis = (time & 3) as usize;
            range += range_step[axis];
            index = index.wrapping_add_signed(index_step[axis]);
        }
    }

    /// Exactly one axis has the time of the next crossing. Masks instead of branches: which axis
    /// comes next cannot be predicted.
    #[inline]
    fn advance(&self, time: i64, next: [&mut i64; 3]) {
        for (next, step) in next.into_iter().zip(self.step) {
            *next += step & -i64::from(*next == time);
        }
    }

    /// What a step along an axis adds to the position in the brick; nobody asks for the fourth.
    #[inline]
    fn index_step(&self) -> [isize; 4] {
        let [x, y, z] = self.sign.map(|sign| sign as isize);
        [x, y << 3, z << 6, 0]
    }

    #[inline]
    fn range_step_by_axis(&self) -> [i64; 4] {
        let [x, y, z] = self.range_step;
        [x, y, z, 0]
    }

    /// Visits every cell from the one in which the ray is at the time `from` to its end.
    #[inline]
    pub(crate) fn visit_cells_from(&self, from: i64, visitor: &mut impl CellVisitor) {
        let from = from.min(self.end - 1);
        let (mut cell, mut next, mut range) = (self.start, self.first, self.range_at_start);
        if from > 0 {
            for axis in 0..3 {
                let crossings = self.crossings(axis, from, (0, i64::MAX));
                cell[axis] += self.sign[axis] * crossings as i32;
                next[axis] += crossings * self.step[axis];
                range += crossings * self.range_step[axis];
            }
        }
        let mut key = BrickKey::new(cell[0] >> 3, cell[1] >> 3, cell[2] >> 3).pack();
        let key_step: [i64; 3] =
            std::array::from_fn(|axis| i64::from(self.sign[axis]) << (42 - 21 * axis));
        let (index_step, range_step) = (self.index_step(), self.range_step_by_axis());
        let mut index = (0..3).fold(0, |index, axis| {
            index | ((cell[axis] & 7) as usize) << (3 * axis)
        });
        // Times at which the ray leaves the brick along each axis.
        let mut leaves: [i64; 3] = std::array::from_fn(|axis| {
            let place = i64::from(cell[axis] & 7);
            let cells = if self.sign[axis] > 0 {
                7 - place
            } else {
                place
            };
            next[axis] + cells * self.step[axis]
        });
        let mut stop = leaves.into_iter().fold(self.end, i64::min);
        let [mut x, mut y, mut z] = next;
        loop {
            let time = x.min(y).min(z);
            visitor.cell(index % BRICK_CELLS, range);
            let axis = (time & 3) as usize;
            if time >= stop {
                visitor.leave_brick(key);
                if time >= self.end {
                    return;
                }
                key = key.wrapping_add_signed(key_step[axis]);
                leaves[axis] += i64::from(BRICK_EDGE) * self.step[axis];
                stop = leaves.into_iter().fold(self.end, i64::min);
                // Enters the next brick on its other side.
                index = index.wrapping_add_signed(-8 * index_step[axis]);
            }
            self.advance(time, [&mut x, &mut y, &mut z]);
            range += range_step[axis];
            index = index.wrapping_add_signed(index_step[axis]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::key::VoxelKey;
    use crate::test_random::Random;

    #[derive(Default)]
    struct Straight {
        in_brick: Vec<(usize, i64)>,
        cells: Vec<(VoxelKey, i64)>,
    }
    impl CellVisitor for Straight {
        fn cell(&mut self, index: usize, range: i64) {
            self.in_brick.push((index, range));
        }
        fn leave_brick(&mut self, key: u64) {
            let brick = BrickKey::unpack(key);
            let cells = self.in_brick.drain(..);
            self.cells
                .extend(cells.map(|(index, range)| (brick.cell(index), range)));
        }
    }

    fn cells_of(ray: &Ray) -> Vec<(VoxelKey, i64)> {
        let mut cells = Vec::new();
        ray.for_each_brick(|packed, _| {
            let brick = BrickKey::unpack(packed);
            ray.walk(ray.enter(brick), |index, range| {
                cells.push((brick.cell(index), range));
            });
        });
        cells
    }

    /// Origins and directions with all the corner cases: axis-parallel, diagonal, starting on a
    /// face, an edge or a corner, negative coordinates, tiny components, no length.
    fn rays() -> Vec<([f64; 3], [f64; 3], f64)> {
        let mut random = Random(5);
        let mut unit = move || random.bits(53) as f64 / (1_u64 << 53) as f64;
        let mut rays = Vec::new();
        for i in 0..3000 {
            let mut origin = [0; 3].map(|_| unit() * 40.0 - 20.0);
            let mut v = [0; 3].map(|_| unit() * 2.0 - 1.0);
            if i % 5 == 1 {
                origin = origin.map(f64::floor);
            }
            if i % 7 == 2 {
                v[i % 3] = 0.0;
            }
            if i % 11 == 3 {
                v[i % 3] *= 1e-9;
            }
            if i % 13 == 4 {
                v = v.map(f64::signum);
            }
            if i % 17 == 5 {
                v = [0.0; 3];
                v[i % 3] = if i % 2 == 0 { 1.0 } else { -1.0 };
            }
            let norm = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
            let length = if i % 19 == 6 { 0.0 } else { unit() * 60.0 };
            rays.push((origin, v.map(|c| c / norm), length));
        }
        rays
    }

    #[test]
    fn a_ray_visits_the_cells_that_dense_sampling_meets_and_only_cells_it_touches() {
        for (origin, direction, length) in rays() {
            let ray = Ray::new(origin, direction, length);
            let cells = cells_of(&ray);
            let at = |t: f64| -> [f64; 3] { std::array::from_fn(|a| origin[a] + t * direction[a]) };
            let key = |p: [f64; 3]| {
                VoxelKey::new(
                    p[0].floor() as i32,
                    p[1].floor() as i32,
                    p[2].floor() as i32,
                )
            };
            assert_eq!(cells[0].0, key(origin));
            for pair in cells.windows(2) {
                let (a, b) = (pair[0].0.to_array(), pair[1].0.to_array());
                let steps: i32 = (0..3).map(|i| (a[i] - b[i]).abs()).sum();
                assert_eq!(steps, 1, "6-connected");
            }
            // Each cell is within 1e-6 of the ray's segment: the interval of times inside the
            // cell grown by 1e-6 is not empty.
            for (cell, range) in &cells {
                let (mut enter, mut leave) = (-1e-6, length + 1e-6);
                for a in 0..3 {
                    let (low, high) = (
                        f64::from(cell.to_array()[a]) - 1e-6,
                        f64::from(cell.to_array()[a]) + 1.0 + 1e-6,
                    );
                    if direction[a].abs() < 1e-8 {
                        assert!((low..=high).contains(&at(length / 2.0)[a]));
                        continue;
                    }
                    let (s, t) = (
                        (low - origin[a]) / direction[a],
                        (high - origin[a]) / direction[a],
                    );
                    enter = f64::max(enter, s.min(t));
                    leave = f64::min(leave, s.max(t));
                }
                assert!(enter <= leave, "{cell:?} is off the ray");
                let center = cell.center(1.0);
                let projected: f64 = (0..3).map(|a| (center[a] - origin[a]) * direction[a]).sum();
                let range = *range as f64 / (1_u64 << RANGE_BITS) as f64;
                assert!((range - projected).abs() < 1e-6);
            }
            let visited: std::collections::BTreeSet<_> = cells.iter().map(|c| c.0).collect();
            assert_eq!(visited.len(), cells.len(), "no cell twice");
            for i in 0..(length * 50.0) as usize {
                let p = at(i as f64 / 50.0);
                let clear = p.iter().all(|c| (c - c.round()).abs() > 1e-6);
                assert!(!clear || visited.contains(&key(p)), "missed {p:?}");
            }
        }
    }

    #[test]
    fn a_walk_from_a_later_time_ends_with_the_same_cells() {
        for (index, (origin, direction, length)) in rays().into_iter().enumerate() {
            let ray = Ray::new(origin, direction, length);
            let whole = cells_of(&ray);
            let from = fixed(length * (index % 8) as f64 / 7.0, TIME_BITS);
            let mut rest = Vec::new();
            ray.for_each_brick_from(from, |packed, _| {
                let brick = BrickKey::unpack(packed);
                ray.walk(ray.enter_from(brick, from), |index, range| {
                    rest.push((brick.cell(index), range));
                });
            });
            assert!(whole.ends_with(&rest) && !rest.is_empty());
            let mut straight = Straight::default();
            ray.visit_cells_from(from, &mut straight);
            assert_eq!(straight.cells, rest);
            // What was left out lies wholly before that time: one cell is at most sqrt(3) long.
            let skipped = (whole.len() - rest.len()) as f64;
            let least = length * (index % 8) as f64 / 7.0 - 3_f64.sqrt();
            assert!(skipped >= least.floor(), "{skipped} cells of {least}");
        }
    }

    #[test]
    fn bricks_on_the_way_are_left_when_their_time_says() {
        for (origin, direction, length) in rays().into_iter().take(300) {
            let ray = Ray::new(origin, direction, length);
            let mut last = i64::MIN;
            ray.for_each_brick(|packed, leaves| {
                assert!(leaves > last);
                let entry = ray.enter(BrickKey::unpack(packed));
                assert_eq!(entry.stop, leaves.min(ray.end));
                last = leaves;
            });
        }
    }
}
