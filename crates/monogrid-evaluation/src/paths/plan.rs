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
    /// Radius of the robot, map units, positive: a ball, or a disc on the floor.
    pub robot_radius: f64,
    /// On the floor: cells between these heights are in its way. Default: in the air.
    pub heights: Option<[f64; 2]>,
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
            heights: None,
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
    /// How far start and goal are from where they were wanted: the nearest places where the robot
    /// fits and which are connected.
    pub moved: [f64; 2],
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
    /// The robot does not fit anywhere.
    #[error("a robot of radius {0} fits nowhere in the free space of the map")]
    NoRoom(f64),
    /// The robot does not fit at an end, nor near it.
    #[error(
        "a robot of radius {radius} does not fit at the {end}; the nearest place where it does and \
         from where the other end can be reached is {place:.3?}, {distance:.3} away: expected at \
         most {MAX_MOVED} radii; give that place, or a smaller radius"
    )]
    TooFar {
        /// Start or goal.
        end: &'static str,
        /// Radius of the robot.
        radius: f64,
        /// Where it fits.
        place: [f64; 3],
        /// How far away that is.
        distance: f64,
    },
    /// Both ends have room, but are not connected.
    #[error("no path of a robot of radius {0} leads from the start to the goal")]
    NotConnected(f64),
}

/// Start and goal are moved by at most so many radii, twice the width of the robot: farther away it
/// is another place than the one that was meant.
const MAX_MOVED: f64 = 4.0;

/// The shortest path between two places over the cells of a map, on which the robot touches no
/// occupied cell and, unless it may, no unknown one. Where it does not fit at an end, the path
/// begins or ends at the nearest place where it does, at most four radii away.
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
    let area = Area::new(map, config).ok_or(PlanError::Empty)?;
    let cell = area.cell;
    let check = |end, point| {
        let (low, high) = map.bounds().unwrap_or_default();
        let is_inside = area.index_of(point).is_some();
        is_inside
            .then_some(())
            .ok_or(PlanError::Outside { end, low, high })
    };
    check("start", from)?;
    check("goal", to)?;
    let grid = area.distances(map, config.through_unknown);
    // a cell reaches half of its diagonal from its centre
    let half_diagonal = 0.5 * area.axes().sqrt();
    let mut planner = Planner::new(&grid, (radius / cell + half_diagonal) as f32);
    let component_at = |point| area.index_of(point).map_or(0, |i| planner.component(i));
    let nearest = |end, point: [f64; 3], component: u32| {
        let fits = |i: &usize| match component {
            0 => planner.component(*i) != 0,
            wanted => planner.component(*i) == wanted,
        };
        let distance = |i: usize| area.distance(area.centre(grid.cell(i), point), point);
        let free = (0..grid.len()).filter(fits).map(|i| (distance(i), i));
        let (distance, i) = free
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .ok_or(PlanError::NoRoom(radius))?;
        let place = area.centre(grid.cell(i), point);
        match distance <= MAX_MOVED * radius {
            true => Ok((distance, i)),
            false => Err(PlanError::TooFar {
                end,
                radius,
                place,
                distance,
            }),
        }
    };
    let end = |name, point, other: u32| match component_at(point) {
        0 => nearest(name, point, other),
        _ => Ok((0.0, area.index_of(point).unwrap_or_default())),
    };
    let (start_moved, start) = end("start", from, component_at(to))?;
    let (goal_moved, goal) = end("goal", to, planner.component(start))?;
    let path = planner.plan(start, goal, &mut Visits::of_at_most(u64::MAX));
    let path = path.ok_or(PlanError::NotConnected(radius))?;
    let least = least_distance(&grid, &path.cells);
    let turns = turns(&path.cells, &grid);
    Ok(PlannedPath {
        points: turns.map(|i| area.centre(grid.cell(i), from)).collect(),
        length: path.length * cell,
        clearance: (f64::from(least) - half_diagonal) * cell,
        planning_cell: cell,
        moved: [start_moved, goal_moved],
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

/// What of a map is planned on: the box of its known cells, in cubes of `factor` cells; on the
/// floor one layer of all cells between two heights.
struct Area {
    first: [i32; 3],
    size: [usize; 3],
    factor: u32,
    cell: f64,
    heights: Option<[f64; 2]>,
}

impl Area {
    /// With the smallest cubes that are at most so many.
    fn new(map: &OccupancyMap, config: &PlanConfig) -> Option<Self> {
        let (low, high) = map.key_bounds()?;
        let max_cells = config.max_cells.min(MAX_CELLS);
        (1..=1 << 16).find_map(|factor| {
            let coarse = |key: i32| key.div_euclid(factor);
            let mut first = low.to_array().map(coarse);
            let mut last = high.to_array().map(coarse);
            if config.heights.is_some() {
                (first[2], last[2]) = (0, 0);
            }
            let size = [0, 1, 2].map(|axis| (last[axis] - first[axis] + 1) as usize);
            let mut sides = size.iter();
            let count = sides.try_fold(1usize, |all, side| all.checked_mul(*side));
            let is_small = count.is_some_and(|count| count <= max_cells);
            is_small.then_some(Self {
                first,
                size,
                factor: factor as u32,
                cell: map.resolution() * f64::from(factor),
                heights: config.heights,
            })
        })
    }

    /// Axes along which the robot moves.
    fn axes(&self) -> f64 {
        if self.heights.is_some() { 2.0 } else { 3.0 }
    }

    /// Distances to what blocks the robot.
    fn distances(&self, map: &OccupancyMap, through_unknown: bool) -> DistanceGrid {
        let least_free = match self.heights {
            Some(_) => 1,
            None => self.factor.pow(3).div_ceil(2),
        };
        let count = self.size.iter().product();
        let index = |key| self.index(self.on_floor(key)?);
        let states = coarse_states(map, index, count, (self.factor, least_free));
        let is_blocked = |i: usize| match states[i] {
            Occupancy::Occupied => true,
            Occupancy::Unknown => !through_unknown,
            Occupancy::Free => false,
        };
        match self.heights {
            Some(_) => DistanceGrid::flat([self.size[0], self.size[1]], is_blocked),
            None => DistanceGrid::new(self.size, is_blocked),
        }
    }

    /// A cube in the only layer of the floor; `None` above and below what is in the way.
    fn on_floor(&self, [x, y, z]: [i32; 3]) -> Option<[i32; 3]> {
        let Some([low, high]) = self.heights else {
            return Some([x, y, z]);
        };
        let height = (f64::from(z) + 0.5) * self.cell;
        (low..=high).contains(&height).then_some([x, y, 0])
    }

    fn index(&self, key: [i32; 3]) -> Option<usize> {
        let cell = cell_in_box(self.first, self.size, key)?;
        Some(index_in(self.size, cell))
    }

    fn index_of(&self, mut point: [f64; 3]) -> Option<usize> {
        if self.heights.is_some() {
            point[2] = 0.0;
        }
        let key = point.map(|value| (value / self.cell).floor());
        let fits = key.iter().all(|value| value.abs() < f64::from(i32::MAX));
        fits.then(|| self.index(key.map(|value| value as i32)))?
    }

    /// The centre of a cube; on the floor as high as `start`.
    fn centre(&self, at: [usize; 3], start: [f64; 3]) -> [f64; 3] {
        let centre =
            |axis: usize| (f64::from(self.first[axis]) + at[axis] as f64 + 0.5) * self.cell;
        let z = self.heights.map_or_else(|| centre(2), |_| start[2]);
        [centre(0), centre(1), z]
    }

    fn distance(&self, from: [f64; 3], to: [f64; 3]) -> f64 {
        let axes = self.axes() as usize;
        let parts = (0..axes).map(|axis| (to[axis] - from[axis]).powi(2));
        parts.sum::<f64>().sqrt()
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
        // too near to the border: the nearest place where it fits
        let narrow = plan_path(&map, [0.15, 0.65, 0.85], to, &PlanConfig::with_radius(0.2));
        let narrow = narrow.unwrap();
        assert!((narrow.moved[0] - 0.1).abs() < 1e-9 && narrow.moved[1] == 0.0);
        assert!((narrow.points[0][0] - 0.25).abs() < 1e-9, "{narrow:?}");
        assert!(matches!(plan(3.0), Err(PlanError::NoRoom(_))));
        let outside = plan_path(&map, from, [9.0, 0.0, 0.0], &PlanConfig::with_radius(0.2));
        assert!(matches!(
            outside,
            Err(PlanError::Outside { end: "goal", .. })
        ));
        assert!(matches!(plan(f64::NAN), Err(PlanError::Radius(_))));
    }

    #[test]
    fn a_place_too_far_from_where_the_robot_fits_is_another_place() {
        let (map, to) = (room(), [3.35, 0.65, 0.85]);
        // in the corner of the door only a small robot fits near where it was wanted
        let inside_wall = [2.05, 0.05, 0.85];
        let near = |radius| plan_path(&map, inside_wall, to, &PlanConfig::with_radius(radius));
        let moved = near(0.15).unwrap().moved[0];
        assert!(moved > 0.15 && moved <= MAX_MOVED * 0.15, "{moved}");
        let Err(PlanError::TooFar {
            end,
            place,
            distance,
            ..
        }) = near(0.02)
        else {
            panic!("{:?}", near(0.02));
        };
        assert!(end == "start" && distance > MAX_MOVED * 0.02, "{distance}");
        assert_eq!(
            plan_path(&map, place, to, &PlanConfig::with_radius(0.02))
                .unwrap()
                .moved[0],
            0.0
        );
    }

    #[test]
    fn a_robot_on_the_floor_drives_below_what_it_fits_under() {
        let mut map = room();
        // a table top over the door, and a step in it
        let mut fill = |z: i32| {
            for (x, y) in (18..23).flat_map(|x| (0..20).map(move |y| (x, y))) {
                map.set_log_odds(VoxelKey::new(x, y, z), Some(2.0)).unwrap();
            }
            map.clone()
        };
        let below = fill(9);
        let step = fill(1);
        let plan = |map: &OccupancyMap, heights| {
            let config = PlanConfig {
                heights: Some(heights),
                ..PlanConfig::with_radius(0.2)
            };
            plan_path(map, [0.65, 0.65, 0.0], [3.35, 0.65, 0.0], &config)
        };
        let path = plan(&below, [0.0, 0.8]).unwrap();
        assert!(path.clearance >= 0.2 && path.points.iter().all(|p| p[2] == 0.0));
        let blocked = Err(PlanError::NotConnected(0.2));
        assert_eq!(plan(&below, [0.0, 1.2]), blocked);
        assert_eq!(plan(&step, [0.0, 0.8]), blocked);
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
