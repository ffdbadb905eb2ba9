//! Shortest paths over cells with 26 neighbours.

use super::grid::DistanceGrid;
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// A path and its length in cells.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Path {
    pub cells: Vec<usize>,
    pub length: f64,
}

/// Planner with memory that is used again for every search.
pub(crate) struct Planner<'a> {
    grid: &'a DistanceGrid,
    /// Cells at least this far from every blocked one are free to use, in cells.
    clearance: f32,
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

/// Entry of the queue: least estimate of the whole path first, then the one farther along.
#[derive(Clone, Copy, PartialEq)]
struct Open {
    estimate: f32,
    cost: f32,
    index: u32,
}

impl Eq for Open {}

impl Ord for Open {
    fn cmp(&self, other: &Self) -> Ordering {
        let by_estimate = other.estimate.total_cmp(&self.estimate);
        let by_cost = self.cost.total_cmp(&other.cost);
        by_estimate.then(by_cost).then(other.index.cmp(&self.index))
    }
}

impl PartialOrd for Open {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl<'a> Planner<'a> {
    pub fn new(grid: &'a DistanceGrid, clearance: f32) -> Self {
        Self {
            grid,
            clearance,
            nodes: vec![Node::default(); grid.len()],
            search: 0,
        }
    }

    fn is_free(&self, index: usize) -> bool {
        self.grid.at(index) >= self.clearance
    }

    /// The shortest path, both ends included; `None` when there is none or an end is not free.
    pub fn plan(&mut self, start: usize, goal: usize) -> Option<Path> {
        if !self.is_free(start) || !self.is_free(goal) {
            return None;
        }
        self.search += 1;
        let goal_cell = self.grid.cell(goal);
        let mut open = BinaryHeap::new();
        self.improve(&mut open, start, start, 0.0, goal_cell);
        while let Some(entry) = open.pop() {
            let index = entry.index as usize;
            if self.nodes[index].is_closed {
                continue;
            }
            self.nodes[index].is_closed = true;
            if index == goal {
                return Some(self.path_to(start, goal));
            }
            for (neighbour, length) in neighbours(self.grid, index) {
                if self.is_free(neighbour) {
                    self.improve(&mut open, index, neighbour, entry.cost + length, goal_cell);
                }
            }
        }
        None
    }

    /// Queues `index` when it is reached for less than before.
    fn improve(
        &mut self,
        open: &mut BinaryHeap<Open>,
        parent: usize,
        index: usize,
        cost: f32,
        goal: [usize; 3],
    ) {
        let node = &mut self.nodes[index];
        if node.search == self.search && (node.is_closed || node.cost <= cost) {
            return;
        }
        *node = Node {
            cost,
            parent: parent as u32,
            search: self.search,
            is_closed: false,
        };
        open.push(Open {
            estimate: cost + distance_without_obstacles(self.grid.cell(index), goal),
            cost,
            index: index as u32,
        });
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

/// The neighbours of a cell and the length of the step to each.
pub(crate) fn neighbours(
    grid: &DistanceGrid,
    index: usize,
) -> impl Iterator<Item = (usize, f32)> + use<'_> {
    let [x, y, z] = grid.cell(index);
    (0..27_usize)
        .filter(|code| *code != 13)
        .filter_map(move |code| {
            let step = [code % 3, code / 3 % 3, code / 9];
            let mut cell = [x, y, z];
            let mut axes = 0;
            for axis in 0..3 {
                // Shifted by one, so that stepping below zero shows as out of the grid.
                let moved = cell[axis] + step[axis];
                if moved == 0 || moved > grid.size[axis] {
                    return None;
                }
                cell[axis] = moved - 1;
                axes += usize::from(step[axis] != 1);
            }
            Some((grid.index(cell), STEP[axes]))
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Shortest distances by relaxing until nothing changes.
    fn bellman_ford(grid: &DistanceGrid, clearance: f32, start: usize) -> Vec<f32> {
        let mut costs = vec![f32::INFINITY; grid.len()];
        costs[start] = 0.0;
        loop {
            let mut has_changed = false;
            for i in (0..grid.len()).filter(|i| grid.at(*i) >= clearance) {
                for (j, length) in neighbours(grid, i) {
                    if grid.at(j) >= clearance && costs[i] + length < costs[j] - 1e-4 {
                        costs[j] = costs[i] + length;
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
        let blocked: Vec<bool> = (0..12 * 11 * 10)
            .map(|_| {
                state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(3);
                (state >> 33) % 100 < 35
            })
            .collect();
        let grid = DistanceGrid::new([12, 11, 10], |i| blocked[i]);
        let mut planner = Planner::new(&grid, 1.0);
        let free: Vec<usize> = (0..grid.len()).filter(|i| !blocked[*i]).collect();
        let start = free[3];
        let expected = bellman_ford(&grid, 1.0, start);
        let mut reached = 0;
        for goal in free.into_iter().step_by(7) {
            let Some(path) = planner.plan(start, goal) else {
                assert!(expected[goal].is_infinite());
                continue;
            };
            reached += 1;
            assert!((path.length - f64::from(expected[goal])).abs() < 1e-2);
            assert_eq!(
                (path.cells[0], path.cells[path.cells.len() - 1]),
                (start, goal)
            );
            for pair in path.cells.windows(2) {
                assert!(!blocked[pair[1]] && neighbours(&grid, pair[0]).any(|n| n.0 == pair[1]));
            }
        }
        assert!(reached > 20, "only {reached} goals can be reached");
    }

    #[test]
    fn without_obstacles_the_estimate_is_the_length() {
        let grid = DistanceGrid::new([20, 20, 20], |_| false);
        let mut planner = Planner::new(&grid, 1.0);
        let (a, b) = ([1, 2, 3], [17, 9, 4]);
        let path = planner.plan(grid.index(a), grid.index(b)).expect("free");
        assert!((path.length - f64::from(distance_without_obstacles(a, b))).abs() < 1e-2);
        assert_eq!(path.cells.len(), 17);
    }
}
