//! Shortest paths over cells with 26 neighbours.

use super::grid::DistanceGrid;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// A path and its length in cells.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Path {
    pub cells: Vec<usize>,
    pub length: f64,
}

/// Cells that searches have visited, of so many that they may.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Visits {
    done: u64,
    most: u64,
}

impl Visits {
    pub fn of_at_most(most: u64) -> Self {
        Self { done: 0, most }
    }

    pub fn most(&self) -> u64 {
        self.most
    }

    pub fn is_exceeded(&self) -> bool {
        self.done > self.most
    }
}

/// Planner with memory that is used again for every search.
pub(crate) struct Planner<'a> {
    grid: &'a DistanceGrid,
    /// Connected set of every cell, so that a search without an answer is not begun; 0: not free.
    component: Vec<u32>,
    steps: Vec<Step>,
    nodes: Vec<Node>,
    search: u32,
}

#[derive(Clone, Copy, Default)]
struct Node {
    cost: f32,
    parent: u32,
    /// The search that wrote this node.
    search: u32,
    is_closed: bool,
}

/// Entry of the queue: least estimate of the whole path first, then the one farther along (cost),
/// then by index. Both lengths are given by their bits, whose order is that of numbers that are not
/// negative.
type Open = (Reverse<u32>, u32, Reverse<u32>);

/// Cells next to a blocked one are never used: it spares every look beyond the border.
const MIN_CLEARANCE: f32 = 1.001;

impl<'a> Planner<'a> {
    /// Plans over the cells that are at least `clearance` cells from every blocked one, and more
    /// than one.
    pub fn new(grid: &'a DistanceGrid, clearance: f32) -> Self {
        let steps = steps(grid);
        Self {
            grid,
            component: components(grid, &steps, clearance.max(MIN_CLEARANCE)),
            steps,
            nodes: vec![Node::default(); grid.len()],
            search: 0,
        }
    }

    /// Number of the connected set of free cells that a cell belongs to, from 1; 0 when it is not
    /// free.
    pub fn component(&self, index: usize) -> u32 {
        self.component[index]
    }

    /// The shortest path, both ends included; `None` when there is none, an end is not free, or
    /// more cells were visited than may be.
    pub fn plan(&mut self, start: usize, goal: usize, visits: &mut Visits) -> Option<Path> {
        if self.component[start] == 0 || self.component[start] != self.component[goal] {
            return None;
        }
        self.search += 1;
        let goal_cell = self.grid.cell(goal);
        let mut open = BinaryHeap::new();
        self.nodes[start] = Node {
            parent: start as u32,
            search: self.search,
            ..Node::default()
        };
        open.push((Reverse(0), 0, Reverse(start as u32)));
        while let Some((_, cost, Reverse(index))) = open.pop() {
            let entry = (f32::from_bits(cost), index);
            let index = index as usize;
            if self.nodes[index].is_closed {
                continue;
            }
            self.nodes[index].is_closed = true;
            visits.done += 1;
            if visits.is_exceeded() {
                return None;
            }
            if index == goal {
                return Some(self.path_to(start, goal));
            }
            self.expand(&mut open, entry, goal_cell);
        }
        None
    }

    /// Queues the neighbours that are reached for less than before.
    fn expand(
        &mut self,
        open: &mut BinaryHeap<Open>,
        (cost, parent): (f32, u32),
        goal: [usize; 3],
    ) {
        let [x, y, z] = self.grid.cell(parent as usize);
        for step in &self.steps {
            let index = parent.wrapping_add_signed(step.offset);
            if self.component[index as usize] == 0 {
                continue;
            }
            let cost = cost + step.length;
            let node = &mut self.nodes[index as usize];
            if node.search == self.search && (node.is_closed || node.cost <= cost) {
                continue;
            }
            *node = Node {
                cost,
                parent,
                search: self.search,
                is_closed: false,
            };
            let cell = [
                x.wrapping_add_signed(step.axes[0]),
                y.wrapping_add_signed(step.axes[1]),
                z.wrapping_add_signed(step.axes[2]),
            ];
            let estimate = cost + distance_without_obstacles(cell, goal);
            open.push((Reverse(estimate.to_bits()), cost.to_bits(), Reverse(index)));
        }
    }

    fn path_to(&self, start: usize, goal: usize) -> Path {
        let mut cells = vec![goal];
        let mut index = goal;
        while index != start {
            index = self.nodes[index].parent as usize;
            cells.push(index);
        }
        cells.reverse();
        Path {
            length: f64::from(self.nodes[goal].cost),
            cells,
        }
    }
}

/// Length of the shortest way between two cells over 26 neighbours when nothing is blocked.
fn distance_without_obstacles(a: [usize; 3], b: [usize; 3]) -> f32 {
    let mut gaps: [usize; 3] = std::array::from_fn(|axis| a[axis].abs_diff(b[axis]));
    gaps.sort_unstable();
    let [least, middle, most] = gaps.map(|g| g as f32);
    // A little less than exact, so that rounding never makes it an overestimate.
    0.99999 * (STEP[3] * least + STEP[2] * (middle - least) + STEP[1] * (most - middle))
}

/// Length of a step along so many axes.
const STEP: [f32; 4] = [0.0, 1.0, std::f32::consts::SQRT_2, 1.732_050_8];

/// A step to one of the 26 neighbours.
#[derive(Clone, Copy, Default)]
struct Step {
    axes: [isize; 3],
    offset: i32,
    length: f32,
}

fn steps(grid: &DistanceGrid) -> Vec<Step> {
    let [nx, ny, nz] = grid.size.map(|side| side as isize);
    let codes = (0..27).map(|code| [code % 3 - 1, code / 3 % 3 - 1, code / 9 - 1]);
    // in one layer nothing leads up or down
    let codes = codes.filter(|axes| *axes != [0; 3] && (nz > 1 || axes[2] == 0));
    let step = |axes: [isize; 3]| Step {
        axes,
        offset: (axes[0] + nx * (axes[1] + ny * axes[2])) as i32,
        length: STEP[axes.iter().filter(|a| **a != 0).count()],
    };
    codes.map(step).collect()
}

/// Numbers the connected sets of cells with enough clearance from 1; 0 elsewhere.
fn components(grid: &DistanceGrid, steps: &[Step], clearance: f32) -> Vec<u32> {
    let mut component = vec![0; grid.len()];
    let mut last = 0;
    let mut stack = Vec::new();
    for seed in 0..grid.len() {
        if component[seed] != 0 || grid.at(seed) < clearance {
            continue;
        }
        last += 1;
        component[seed] = last;
        stack.push(seed);
        while let Some(index) = stack.pop() {
            for step in steps {
                let next = index.wrapping_add_signed(step.offset as isize);
                if component[next] == 0 && grid.at(next) >= clearance {
                    component[next] = last;
                    stack.push(next);
                }
            }
        }
    }
    component
}

#[cfg(test)]
mod tests {
    use super::*;

    fn any() -> Visits {
        Visits::of_at_most(u64::MAX)
    }

    /// All cells that differ by at most one along each axis, and how far away they are.
    fn neighbours(grid: &DistanceGrid, index: usize) -> Vec<(usize, f32)> {
        let cell = grid.cell(index);
        let gap_sq = |other: [usize; 3]| -> Option<usize> {
            let gaps = [0, 1, 2].map(|a| cell[a].abs_diff(other[a]));
            gaps.iter().all(|g| *g <= 1).then_some(gaps.iter().sum())
        };
        (0..grid.len())
            .filter(|j| *j != index)
            .filter_map(|j| gap_sq(grid.cell(j)).map(|sq| (j, (sq as f32).sqrt())))
            .collect()
    }

    /// Shortest distances by relaxing until nothing changes.
    fn bellman_ford(grid: &DistanceGrid, clearance: f32, start: usize) -> Vec<f32> {
        let free: Vec<usize> = (0..grid.len())
            .filter(|i| grid.at(*i) >= clearance)
            .collect();
        let all: Vec<_> = free.iter().map(|i| (*i, neighbours(grid, *i))).collect();
        let mut costs = vec![f32::INFINITY; grid.len()];
        costs[start] = 0.0;
        loop {
            let mut has_changed = false;
            for (i, neighbours) in &all {
                for (j, length) in neighbours {
                    if grid.at(*j) >= clearance && costs[*i] + length < costs[*j] - 1e-4 {
                        costs[*j] = costs[*i] + length;
                        has_changed = true;
                    }
                }
            }
            if !has_changed {
                return costs;
            }
        }
    }

    #[test]
    fn lengths_agree_with_exhaustive_relaxation_and_paths_are_valid() {
        let mut state = 9_u64;
        let blocked: Vec<bool> = (0..14 * 13 * 12)
            .map(|_| {
                state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(3);
                (state >> 33) % 100 < 8
            })
            .collect();
        let grid = DistanceGrid::new([14, 13, 12], |i| blocked[i]);
        let clearance = 1.2;
        let mut planner = Planner::new(&grid, clearance);
        let is_free = |i: usize| grid.at(i) >= clearance;
        let free: Vec<usize> = (0..grid.len()).filter(|i| is_free(*i)).collect();
        let start = free[30];
        let expected = bellman_ford(&grid, clearance, start);
        let mut reached = 0;
        for goal in free.into_iter().step_by(5) {
            let Some(path) = planner.plan(start, goal, &mut any()) else {
                assert!(expected[goal].is_infinite());
                continue;
            };
            reached += 1;
            assert!((path.length - f64::from(expected[goal])).abs() < 1e-2);
            let last = path.cells[path.cells.len() - 1];
            assert_eq!((path.cells[0], last), (start, goal));
            for pair in path.cells.windows(2) {
                assert!(is_free(pair[1]));
                assert!(neighbours(&grid, pair[0]).iter().any(|n| n.0 == pair[1]));
            }
        }
        assert!(reached > 40, "only {reached} goals can be reached");
    }

    #[test]
    fn without_obstacles_the_estimate_is_the_length() {
        let grid = DistanceGrid::new([22, 22, 22], |_| false);
        let mut planner = Planner::new(&grid, 1.0);
        let (a, b) = ([2, 3, 4], [18, 10, 5]);
        let path = planner
            .plan(grid.index(a), grid.index(b), &mut any())
            .expect("free");
        assert!((path.length - f64::from(distance_without_obstacles(a, b))).abs() < 1e-2);
        assert_eq!(path.cells.len(), 17);
    }
}
