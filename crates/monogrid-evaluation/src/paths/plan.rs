//! One path through a map, as a robot would plan it.

use super::astar::{Planner, Visits};
use super::grid::{DistanceGrid, index_in};
use super::{MAX_CELLS, coarse_states, least_distance};
use crate::truth::cell_in_box;
use monogrid_occupancy::{Occupancy, OccupancyMap};
use serde::Serialize;

/// A robot that plans.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanConfig {
    /// Radius of the robot, a ball, map units, positive.
    pub robot_radius: f64,
    /// Whether it may enter unknown cells. Default: it may not.
    pub through_unknown: bool,
    /// Most cells of the grid that is searched; larger maps are planned on larger cells. Default
    /// 20,000,000 (0.5 GB).
    pub max_cells: usize,
}

impl PlanConfig {
    /// A robot of this radius that keeps to what is known.
    #[must_use]
    pub fn with_radius(robot_radius: f64) -> Self {
        Self {
            robot_radius,
            through_unknown: false,
            max_cells: 20_000_000,
        }
    }
}

/// A path.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PlannedPath {
    /// Places of the robot's centre, map units: start, where it turns, goal.
    pub points: Vec<[f64; 3]>,
    /// Length, map units.
    pub length: f64,
    /// Least distance from the robot's centre to the surface of an obstacle, map units; at least
    /// the radius.
    pub clearance: f64,
    /// Edge of the cells that were planned on.
    pub planning_cell: f64,
}

/// Why there is no path.
#[derive(Debug, thiserror::Error, Clone, PartialEq)]
#[non_exhaustive]
pub enum PlanError {
    /// A radius that is none.
    #[error("robot radius is {0}, expected a positive number")]
    Radius(f64),
    /// Nothing is known.
    #[error("the map has no known cells")]
    Empty,
    /// A place that is not in the map.
    #[error("the {end} lies outside the map, which reaches from {low:?} to {high:?}")]
    Outside {
        /// Start or goal.
        end: &'static str,
        /// Lower corner of what is known.
        low: [f64; 3],
        /// Upper corner.
        high: [f64; 3],
    },
    /// The robot does not fit there.
    #[error(
        "the robot does not fit at the {end}: the nearest cell that blocks it is {distance:.3} \
         away, its radius is {radius}"
    )]
    NoRoom {
        /// Start or goal.
        end: &'static str,
        /// Distance to the centre of the nearest cell that is occupied, or unknown and not to be
        /// entered.
        distance: f64,
        /// Radius of the robot.
        radius: f64,
    },
    /// Both ends have room, but are not connected.
    #[error("no path of a robot of radius {0} leads from the start to the goal")]
    NotConnected(f64),
}

/// The shortest path between two places over the cells of a map, on which a ball of the robot's
/// radius touches no occupied cell and, unless it may, no unknown one.
///
/// # Errors
/// [`PlanError`]: why there is none.
pub fn plan_path(
    map: &OccupancyMap,
    from: [f64; 3],
    to: [f64; 3],
    config: &PlanConfig,
) -> Result<PlannedPath, PlanError> {
    let radius = config.robot_radius;
    if !(radius.is_finite() && radius > 0.0) {
        return Err(PlanError::Radius(radius));
    }
    let area = Area::new(map, config.max_cells.min(MAX_CELLS)).ok_or(PlanError::Empty)?;
    let cell = area.cell;
    let index_of = |end, point| {
        let (low, high) = map.bounds().unwrap_or_default();
        let index = area.index_of(point);
        index.ok_or(PlanError::Outside { end, low, high })
    };
    let (start, goal) = (index_of("start", from)?, index_of("goal", to)?);
    let states = coarse_states(map, |key| area.index(key), area.count(), area.factor);
    let grid = DistanceGrid::new(area.size, |i| match states[i] {
        Occupancy::Occupied => true,
        Occupancy::Unknown => !config.through_unknown,
        Occupancy::Free => false,
    });
    // a cell reaches half of its diagonal from its centre
    let half_diagonal = 0.5 * 3.0_f64.sqrt();
    let mut planner = Planner::new(&grid, (radius / cell + half_diagonal) as f32);
    for (end, index) in [("start", start), ("goal", goal)] {
        if planner.component(index) == 0 {
            let distance = f64::from(grid.at(index)) * cell;
            return Err(PlanError::NoRoom {
                end,
                distance,
                radius,
            });
        }
    }
    let path = planner.plan(start, goal, &mut Visits::of_at_most(u64::MAX));
    let path = path.ok_or(PlanError::NotConnected(radius))?;
    let least = least_distance(&grid, &path.cells);
    let turns = turns(&path.cells, &grid);
    Ok(PlannedPath {
        points: turns.map(|i| area.centre(grid.cell(i))).collect(),
        length: path.length * cell,
        clearance: (f64::from(least) - half_diagonal) * cell,
        planning_cell: cell,
    })
}

/// First and last cell of a path, and those at which its direction changes.
fn turns<'a>(cells: &'a [usize], grid: &'a DistanceGrid) -> impl Iterator<Item = usize> + 'a {
    let step = |k: usize| {
        let (a, b) = (grid.cell(cells[k]), grid.cell(cells[k + 1]));
        [0, 1, 2].map(|axis| b[axis] as i64 - a[axis] as i64)
    };
    let last = cells.len() - 1;
    let is_turn = move |k: &usize| *k == 0 || *k == last || step(*k - 1) != step(*k);
    (0..cells.len()).filter(is_turn).map(|k| cells[k])
}

/// What of a map is planned on: the box of its known cells, in cubes of `factor` cells.
struct Area {
    first: [i32; 3],
    size: [usize; 3],
    factor: u32,
    cell: f64,
}

impl Area {
    /// With the smallest cubes that are at most so many.
    fn new(map: &OccupancyMap, max_cells: usize) -> Option<Self> {
        let (low, high) = map.key_bounds()?;
        (1..=1 << 16).find_map(|factor| {
            let coarse = |key: i32| key.div_euclid(factor);
            let first = low.to_array().map(coarse);
            let last = high.to_array().map(coarse);
            let size = [0, 1, 2].map(|axis| (last[axis] - first[axis] + 1) as usize);
            let mut sides = size.iter();
            let count = sides.try_fold(1usize, |all, side| all.checked_mul(*side));
            let is_small = count.is_some_and(|count| count <= max_cells);
            is_small.then_some(Self {
                first,
                size,
                factor: factor as u32,
                cell: map.resolution() * f64::from(factor),
            })
        })
    }

    fn count(&self) -> usize {
        self.size.iter().product()
    }

    fn index(&self, key: [i32; 3]) -> Option<usize> {
        let cell = cell_in_box(self.first, self.size, key)?;
        Some(index_in(self.size, cell))
    }

    fn index_of(&self, point: [f64; 3]) -> Option<usize> {
        let key = point.map(|value| (value / self.cell).floor());
        let fits = key.iter().all(|value| value.abs() < f64::from(i32::MAX));
        fits.then(|| self.index(key.map(|value| value as i32)))?
    }

    fn centre(&self, at: [usize; 3]) -> [f64; 3] {
        [0, 1, 2].map(|axis| (f64::from(self.first[axis]) + at[axis] as f64 + 0.5) * self.cell)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_occupancy::{MapConfig, UnknownCells, VoxelKey};

    /// A room of 4 x 2 x 1.6 m, free inside, with a wall across it that has a door of 0.6 m.
    fn room() -> OccupancyMap {
        let mut map = OccupancyMap::new(MapConfig::with_resolution(0.1)).unwrap();
        for (x, y, z) in
            (0..40).flat_map(|x| (0..20).flat_map(move |y| (0..16).map(move |z| (x, y, z))))
        {
            let is_wall = x == 20 && !(12..18).contains(&y);
            let value = if is_wall { 2.0 } else { -1.0 };
            map.set_log_odds(VoxelKey::new(x, y, z), Some(value))
                .unwrap();
        }
        map
    }

    #[test]
    fn the_path_leads_through_the_door_and_the_robot_touches_nothing() {
        let map = room();
        let (from, to) = ([0.65, 0.65, 0.85], [3.35, 0.65, 0.85]);
        let plan = |radius| plan_path(&map, from, to, &PlanConfig::with_radius(radius));
        let path = plan(0.2).unwrap();
        assert!(
            path.clearance >= 0.2 && path.planning_cell <= 0.1,
            "{path:?}"
        );
        let (first, last) = (path.points[0], path.points[path.points.len() - 1]);
        for (found, wanted) in [(first, from), (last, to)] {
            assert!(
                (0..3).all(|axis| (found[axis] - wanted[axis]).abs() < 1e-9),
                "{found:?}"
            );
        }
        assert!(path.length > 3.0 && path.length < 4.5, "{}", path.length);
        let sum: f64 = path
            .points
            .windows(2)
            .map(|pair| {
                (0..3)
                    .map(|axis| (pair[1][axis] - pair[0][axis]).powi(2))
                    .sum::<f64>()
                    .sqrt()
            })
            .sum();
        assert!((sum - path.length).abs() < 1e-3);
        for pair in path.points.windows(2) {
            for k in 0..=20 {
                let place = [0, 1, 2].map(|axis| {
                    pair[0][axis] + (pair[1][axis] - pair[0][axis]) * f64::from(k) / 20.0
                });
                // between two cells the distance is less than at both by some of a cell
                assert!(
                    !map.sphere_collides(place, 0.17, UnknownCells::Stop),
                    "{place:?}"
                );
            }
        }
        assert!(matches!(plan(0.35), Err(PlanError::NotConnected(_))));
        let narrow = plan_path(&map, [0.15, 0.15, 0.15], to, &PlanConfig::with_radius(0.2));
        assert!(
            matches!(narrow, Err(PlanError::NoRoom { end: "start", .. })),
            "{narrow:?}"
        );
        let outside = plan_path(&map, from, [9.0, 0.0, 0.0], &PlanConfig::with_radius(0.2));
        assert!(matches!(
            outside,
            Err(PlanError::Outside { end: "goal", .. })
        ));
        assert!(matches!(plan(f64::NAN), Err(PlanError::Radius(_))));
    }

    #[test]
    fn large_maps_are_planned_on_larger_cells() {
        let config = PlanConfig {
            max_cells: 2000,
            ..PlanConfig::with_radius(0.1)
        };
        let path = plan_path(&room(), [0.9, 0.9, 0.9], [1.5, 1.0, 0.9], &config).unwrap();
        assert!(
            (path.planning_cell - 0.2).abs() < 1e-9,
            "{}",
            path.planning_cell
        );
    }
}
