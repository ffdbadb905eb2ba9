//! Free space: everything that the camera could have flown to without crossing a surface.

use super::grid::{CLOSED, FREE, OCCUPIED, TruthGrid, UNKNOWN};

/// What the fill found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct FillOutcome {
    /// Seeds that lie in free space.
    pub good_seeds: usize,
    /// The fill reached the border of the box: the surface has holes or is open.
    pub reaches_border: bool,
}

/// Fills the unknown cells that are 6-connected to a seed.
///
/// Holes up to `2 * hole_cells` wide are closed for the fill: surfaces are thickened by a cube of
/// that many cells, and what was filled is thickened by the same cube afterwards. No cell of the
/// filled space is within `hole_cells` of a surface, so the second step cannot cross one.
pub(crate) fn fill_free(
    grid: &mut TruthGrid,
    seeds: &[[i32; 3]],
    hole_cells: usize,
) -> FillOutcome {
    if hole_cells > 0 {
        thicken_surfaces(grid, hole_cells);
    }
    let mut outcome = FillOutcome::default();
    for seed in seeds {
        let Some(cell) = grid.local(*seed) else {
            continue;
        };
        let code = grid.code(cell);
        if code == UNKNOWN {
            outcome.reaches_border |= flood(grid, cell);
        }
        outcome.good_seeds += usize::from(code == UNKNOWN || code == FREE);
    }
    if hole_cells > 0 {
        thicken_free_space(grid, hole_cells);
    }
    outcome
}

fn thicken_surfaces(grid: &mut TruthGrid, radius: usize) {
    let size = grid.size();
    // layer by layer: what is closed meanwhile is no surface, so that it makes no difference when
    // it is looked at
    for z in 0..size[2] {
        let surface: Vec<[usize; 3]> = grid.layer_with(z, OCCUPIED).collect();
        for cell in surface {
            for neighbour in cube(cell, radius, size) {
                if grid.code(neighbour) == UNKNOWN {
                    grid.set_code(neighbour, CLOSED);
                }
            }
        }
    }
}

fn thicken_free_space(grid: &mut TruthGrid, radius: usize) {
    let size = grid.size();
    // of each closed cell in their order, before any is changed: one that becomes free must not
    // free the next
    let freed: Vec<bool> = grid
        .cells_with(CLOSED)
        .map(|cell| cube(cell, radius, size).any(|n| grid.code(n) == FREE))
        .collect();
    let mut freed = freed.into_iter();
    for z in 0..size[2] {
        let closed: Vec<[usize; 3]> = grid.layer_with(z, CLOSED).collect();
        for (cell, is_free) in closed.into_iter().zip(&mut freed) {
            grid.set_code(cell, if is_free { FREE } else { UNKNOWN });
        }
    }
}

/// Cells of the cube of `radius` around `cell` that lie in the box.
fn cube(
    cell: [usize; 3],
    radius: usize,
    size: [usize; 3],
) -> impl Iterator<Item = [usize; 3]> + use<> {
    let first = cell.map(|at| at.saturating_sub(radius));
    let last: [usize; 3] = std::array::from_fn(|a| (cell[a] + radius).min(size[a] - 1));
    let range = move |axis: usize| first[axis]..=last[axis];
    range(2).flat_map(move |z| range(1).flat_map(move |y| range(0).map(move |x| [x, y, z])))
}

/// Fills row by row; returns whether a cell at the border was filled.
fn flood(grid: &mut TruthGrid, seed: [usize; 3]) -> bool {
    let [nx, ny, nz] = grid.size();
    let mut reaches_border = false;
    let mut stack = vec![seed];
    while let Some([seed_x, y, z]) = stack.pop() {
        if grid.code([seed_x, y, z]) != UNKNOWN {
            continue;
        }
        let mut begin = seed_x;
        while begin > 0 && grid.code([begin - 1, y, z]) == UNKNOWN {
            begin -= 1;
        }
        let mut end = seed_x + 1;
        while end < nx && grid.code([end, y, z]) == UNKNOWN {
            end += 1;
        }
        for x in begin..end {
            grid.set_code([x, y, z], FREE);
        }
        reaches_border |= begin == 0 || end == nx;
        reaches_border |= y == 0 || y + 1 == ny || z == 0 || z + 1 == nz;
        let (below, before) = (y.wrapping_sub(1), z.wrapping_sub(1));
        for (row_y, row_z) in [(below, z), (y + 1, z), (y, before), (y, z + 1)] {
            if row_y < ny && row_z < nz {
                push_runs(grid, begin..end, row_y, row_z, &mut stack);
            }
        }
    }
    reaches_border
}

/// One seed for every run of unknown cells in a part of a row.
fn push_runs(
    grid: &TruthGrid,
    range: std::ops::Range<usize>,
    y: usize,
    z: usize,
    stack: &mut Vec<[usize; 3]>,
) {
    let mut is_inside = false;
    for x in range {
        let is_unknown = grid.code([x, y, z]) == UNKNOWN;
        if is_unknown && !is_inside {
            stack.push([x, y, z]);
        }
        is_inside = is_unknown;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_occupancy::Occupancy;
    use std::collections::{BTreeSet, VecDeque};

    fn random_grid(seed: u64, share_occupied: f64) -> TruthGrid {
        let mut grid = TruthGrid::new(1.0, [-3; 3], [9, 10, 11], 1 << 20).expect("small");
        let mut state = seed;
        let cells: Vec<_> = grid.cells().collect();
        for cell in cells {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            if ((state >> 33) as f64 / f64::from(1_u32 << 31)) < share_occupied {
                grid.set_code(cell, OCCUPIED);
            }
        }
        grid
    }

    /// Breadth first, one cell at a time.
    fn brute_force(grid: &TruthGrid, seed: [i32; 3]) -> BTreeSet<[i32; 3]> {
        let mut reached = BTreeSet::new();
        let mut queue = VecDeque::from([seed]);
        while let Some(key) = queue.pop_front() {
            if grid.local(key).is_none()
                || grid.state(key) == Occupancy::Occupied
                || !reached.insert(key)
            {
                continue;
            }
            for axis in 0..3 {
                for step in [-1, 1] {
                    let mut next = key;
                    next[axis] += step;
                    queue.push_back(next);
                }
            }
        }
        reached
    }

    #[test]
    fn fills_what_a_breadth_first_search_reaches() {
        for seed in 0..20 {
            let mut grid = random_grid(seed, 0.55);
            let start = [0, 0, 0];
            grid.set(start, Occupancy::Unknown);
            let expected = brute_force(&grid, start);
            fill_free(&mut grid, &[start], 0);
            let filled: BTreeSet<_> = grid.keys_in(Occupancy::Free).collect();
            assert_eq!(filled, expected);
        }
    }

    fn room_with_hole(width: i32) -> TruthGrid {
        let mut grid = TruthGrid::new(1.0, [-2; 3], [12; 3], 1 << 20).expect("small");
        let keys: Vec<_> = grid.cells().map(|c| grid.global(c)).collect();
        for key in keys {
            let is_inside = key.iter().all(|k| (0..=10).contains(k));
            let is_shell = is_inside && key.iter().any(|k| *k == 0 || *k == 10);
            let is_hole = key[0] == 0 && (5..5 + width).contains(&key[1]) && key[2] == 5;
            if is_shell && !is_hole {
                grid.set(key, Occupancy::Occupied);
            }
        }
        grid
    }

    #[test]
    fn a_small_hole_leaks_unless_it_is_closed_and_the_room_stays_whole() {
        let mut leaking = room_with_hole(1);
        assert!(fill_free(&mut leaking, &[[5, 5, 5]], 0).reaches_border);
        let mut closed = room_with_hole(2);
        let outcome = fill_free(&mut closed, &[[5, 5, 5]], 1);
        assert!(!outcome.reaches_border && outcome.good_seeds == 1);
        // All of the room up to its corners, and nothing in the hole or outside.
        assert_eq!(closed.counts().free, 9 * 9 * 9);
        assert_eq!(closed.state([1, 1, 1]), Occupancy::Free);
        assert_eq!(closed.state([0, 5, 5]), Occupancy::Unknown);
    }
}
