//! The cells around the sensor that hold the lowest value and will keep it.
//!
//! Cubes of cells so near are seen from everywhere, so that one cell that few beams cross would keep
//! all beams from being settled (see `settled`). Here each beam is asked about its own cells.

use super::beam::{Beam, Beams, Measured};
use super::ray::{NEAR_BITS, TIME_BITS};
use super::settled::NEAR_CELLS;
use crate::key::{BrickKey, VoxelKey};
use crate::map::OccupancyMap;
use crate::storage::BrickRef;

/// Time up to which a beam is near the sensor.
pub(crate) const NEAR_END: i64 = (NEAR_CELLS as i64) << TIME_BITS;
/// Cells along the edge of the cube, and before the sensor's own.
const EDGE: i32 = 1 << NEAR_BITS;
const BEFORE: i32 = EDGE / 2;
const CELLS: usize = 1 << (3 * NEAR_BITS);

/// The cells of a cube around the sensor that beams cross which see more than free space there, and
/// can raise them.
pub(crate) struct NearEnds {
    /// Cell of the map at the cube's first corner.
    first: [i32; 3],
    can_rise: Vec<bool>,
}

impl NearEnds {
    pub(crate) fn new(beams: &Beams) -> Self {
        let mut can_rise = vec![false; CELLS];
        let ends_here = |m: &&Measured| !m.is_free_until(NEAR_END);
        for measured in beams.measured.iter().filter(ends_here) {
            beams.beam(measured).ray.any_near_cell(NEAR_END, |index| {
                can_rise[index] = true;
                false
            });
        }
        Self {
            first: beams.origin.map(|c| c.floor() as i32 - BEFORE),
            can_rise,
        }
    }
}

/// A cube of cells around the sensor.
pub(crate) struct NearCells {
    /// Whether beams in free space leave the cell as it is, by its position, x fastest.
    keeps: Vec<bool>,
}

impl NearCells {
    /// Looks at a map into which measurements are still to be integrated.
    pub(crate) fn new(map: &OccupancyMap, ends: &NearEnds) -> Self {
        let first = ends.first;
        let lowest = map.limits.min;
        let mut keeps = vec![false; CELLS];
        // Bricks, and of each the cells in the cube.
        let bricks = first.map(|c| c >> 3..=(c + EDGE - 1) >> 3);
        let inside = |axis: usize, brick: i32| {
            let begin = (brick << 3).max(first[axis]);
            (begin..((brick + 1) << 3).min(first[axis] + EDGE)).map(move |c| (c, c - first[axis]))
        };
        for x in bricks[0].clone() {
            for y in bricks[1].clone() {
                for z in bricks[2].clone() {
                    let brick = BrickKey::new(x, y, z);
                    if matches!(map.brick(brick), BrickRef::Uniform(value) if value != lowest) {
                        continue;
                    }
                    let values = map.brick_values(brick);
                    for (cz, z) in inside(2, z) {
                        for (cy, y) in inside(1, y) {
                            for (cx, x) in inside(0, x) {
                                let value = values[VoxelKey::new(cx, cy, cz).index_in_brick()];
                                let at = position([x, y, z]);
                                keeps[at] = value == lowest && !ends.can_rise[at];
                            }
                        }
                    }
                }
            }
        }
        Self { keeps }
    }

    /// Whether a beam that is in free space up to [`NEAR_END`] changes no cell until then.
    #[inline]
    pub(crate) fn are_settled_for(&self, beam: &Beam) -> bool {
        !beam.ray.any_near_cell(NEAR_END, |index| !self.keeps[index])
    }
}

/// Position of a cell in the cube, as [`Ray::any_near_cell`](super::ray::Ray) counts.
fn position(at: [i32; 3]) -> usize {
    let [x, y, z] = at.map(|c| c as usize);
    x | y << NEAR_BITS | z << (2 * NEAR_BITS)
}
