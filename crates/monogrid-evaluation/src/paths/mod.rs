//! What matters to a robot: are there paths through the map, and are they safe in the world?
//!
//! Flow: coarsen map and truth to planning cells → distance of every cell to what blocks → seeded
//! pairs of start and goal in true free space → A* in the truth and in the map → each path checked
//! in the other. The robot is a ball; a path is planned with a margin and collides without it, so
//! that maps that differ by the rounding of a cell are not called wrong.

mod astar;
mod grid;
mod plan;

pub use plan::{PlanConfig, PlanError, PlannedPath, plan_path};

use crate::statistics::median;
use crate::truth::{TruthError, TruthGrid};
use astar::{Path, Planner, Visits};
use grid::DistanceGrid;
use monogrid_geometry::Rng;
use monogrid_occupancy::{Occupancy, OccupancyMap};
use serde::Serialize;

/// Settings of [`evaluate_paths`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathConfig {
    /// Radius of the robot, map units, positive. Default 0.15.
    pub robot_radius: f64,
    /// Paths keep this much more distance than the robot needs, map units. Default: the diagonal of
    /// a planning cell.
    pub planning_margin: Option<f64>,
    /// Pairs of start and goal. Default 1000.
    pub pairs: usize,
    /// Start and goal are at least this far apart, map units. Default 1.
    pub min_distance: f64,
    /// Edge of the cells to plan on, map units; rounded to a whole number of cells of the map.
    /// Default 0.064.
    pub planning_cell: f64,
    /// Seed of the pairs. Default 0.
    pub seed: u64,
    /// Most cells of the planning grid. Default 200,000,000: nodes take 20 bytes each.
    pub max_cells: usize,
    /// Most cells that all searches together may visit. Default: any number.
    pub max_visits: u64,
}

impl Default for PathConfig {
    fn default() -> Self {
        Self {
            robot_radius: 0.15,
            planning_margin: None,
            pairs: 1000,
            min_distance: 1.0,
            planning_cell: 0.064,
            seed: 0,
            max_cells: MAX_CELLS,
            max_visits: u64::MAX,
        }
    }
}

/// Why paths cannot be evaluated.
#[derive(Debug, thiserror::Error, Clone, PartialEq)]
#[non_exhaustive]
pub enum PathError {
    /// A setting outside its range.
    #[error("path evaluation: {field} is {value}, expected a positive number")]
    Config {
        /// Name of the field.
        field: &'static str,
        /// What it was.
        value: f64,
    },
    /// Cells of different size.
    #[error(
        "the estimated map has cells of {estimate}, the true one of {truth}, expected the same"
    )]
    Resolution {
        /// Edge of a cell of the estimate.
        estimate: f64,
        /// Edge of a cell of the truth.
        truth: f64,
    },
    /// The planning grid would be too large to search.
    #[error(
        "planning needs {cells} cells, at most {max} can be searched; choose larger planning cells"
    )]
    TooManyCells {
        /// Cells needed.
        cells: usize,
        /// Cells allowed.
        max: usize,
    },
    /// The searches would take too long.
    #[error(
        "the searches visit more than {max} cells; choose fewer pairs or larger planning cells"
    )]
    TooManyVisits {
        /// Visits allowed.
        max: u64,
    },
    /// No pair of connected cells that far apart in the truth.
    #[error(
        "the truth has no two connected places {min_distance} apart that a robot of radius \
         {robot_radius} fits into ({free} cells are wide enough)"
    )]
    NoPairs {
        /// Cells with enough clearance.
        free: usize,
        /// The distance asked for.
        min_distance: f64,
        /// The radius asked for.
        robot_radius: f64,
    },
    /// The truth could not be coarsened.
    #[error(transparent)]
    Truth(#[from] TruthError),
}

/// Results over a set of pairs. Shares are in [0, 1], lengths in map units.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct PathStats {
    /// Pairs looked at.
    pub pairs: usize,
    /// Share of the pairs whose shortest path in the truth is blocked in the map.
    pub false_positive: f64,
    /// Share of the pairs between which the map has no path at all, though the truth has.
    pub unreachable: f64,
    /// Pairs between which a path was planned on the map.
    pub planned: usize,
    /// Share of these paths that collide in the truth.
    pub false_negative: f64,
    /// Median length of the path on the map over that of the shortest one in the truth.
    pub length_ratio: Option<f64>,
    /// Median over these paths of the least distance to a true obstacle.
    pub clearance_median: Option<f64>,
    /// Least of these distances.
    pub clearance_min: Option<f64>,
}

/// Results under one rule for unknown cells.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PathReport {
    /// Over all pairs.
    pub all: PathStats,
    /// Over the pairs inside the observed space: around start and goal the map knows every cell
    /// that the robot fills.
    pub observed: PathStats,
    /// Over the pairs whose shortest path in the truth runs through the observed space: all along
    /// it the map knows every cell that the robot fills. What blocks these are false obstacles
    /// alone.
    pub path_observed: PathStats,
}

/// Results of [`evaluate_paths`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PathsReport {
    /// The robot keeps out of unknown cells.
    pub unknown_blocked: PathReport,
    /// The robot may enter unknown cells.
    pub unknown_free: PathReport,
    /// Share of the free space of the truth of which the map knows anything.
    pub known_share: f64,
    /// Edge of the cells that were planned on.
    pub planning_cell: f64,
    /// Radius of the robot.
    pub robot_radius: f64,
    /// Distance beyond it that paths were planned with.
    pub planning_margin: f64,
}

/// Most cells of the planning grid: nodes are numbered with 32 bits and take 20 bytes each.
const MAX_CELLS: usize = 200_000_000;

/// Plans between random places in the truth and in the map and checks each path in the other.
///
/// In the truth everything that is not free is an obstacle. A planning cell is occupied when any of
/// its cells is; else free when at least half are; else unknown.
///
/// # Errors
/// Settings out of range, cells of different size, a grid too large, or a truth without room.
pub fn evaluate_paths(
    estimate: &OccupancyMap,
    truth: &TruthGrid,
    config: &PathConfig,
) -> Result<PathsReport, PathError> {
    validate(config)?;
    if (estimate.resolution() / truth.resolution() - 1.0).abs() > 1e-6 {
        return Err(PathError::Resolution {
            estimate: estimate.resolution(),
            truth: truth.resolution(),
        });
    }
    let factor = (config.planning_cell / truth.resolution()).round().max(1.0) as u32;
    let coarse_truth = truth.coarsened(factor)?;
    let cell = coarse_truth.resolution();
    let count = coarse_truth.size().iter().product();
    let max = config.max_cells.min(MAX_CELLS);
    if count > max {
        return Err(PathError::TooManyCells { cells: count, max });
    }
    let diagonal = 3.0_f64.sqrt() * cell;
    let margin = config.planning_margin.unwrap_or(diagonal);
    let clearances = Clearances {
        plan: ((config.robot_radius + margin) / cell + 0.5) as f32,
        collide: (config.robot_radius / cell + 0.5) as f32,
    };
    let [nx, ny, _] = coarse_truth.size();
    let in_truth = DistanceGrid::new(coarse_truth.size(), |i| {
        coarse_truth.state_at([i % nx, i / nx % ny, i / nx / ny]) != Occupancy::Free
    });
    let mut truth_planner = Planner::new(&in_truth, clearances.plan);
    let pairs = sample_pairs(&in_truth, &truth_planner, config, cell)?;
    let index = |key| Some(in_truth.index(coarse_truth.local(key)?));
    let least_free = factor.pow(3).div_ceil(2);
    let states = coarse_states(estimate, index, in_truth.len(), (factor, least_free));
    let to_unobserved = DistanceGrid::new(in_truth.size, |i| states[i] == Occupancy::Unknown);
    let is_inside = |cells: &[usize]| least_distance(&to_unobserved, cells) >= clearances.collide;
    let mut visits = Visits::of_at_most(config.max_visits);
    let mut routes = Vec::with_capacity(pairs.len());
    for (start, goal) in pairs {
        let path = truth_planner.plan(start, goal, &mut visits);
        visits.check()?;
        routes.extend(path.map(|path| Route {
            are_ends_observed: is_inside(&[start, goal]),
            is_path_observed: is_inside(&path.cells),
            path,
        }));
    }
    drop(truth_planner);
    let mut report = |is_blocked: &dyn Fn(Occupancy) -> bool| {
        let in_map = DistanceGrid::new(in_truth.size, |i| is_blocked(states[i]));
        compare(&routes, &in_truth, &in_map, &clearances, cell, &mut visits)
    };
    Ok(PathsReport {
        unknown_blocked: report(&|state| state != Occupancy::Free)?,
        unknown_free: report(&|state| state == Occupancy::Occupied)?,
        known_share: known_share(&in_truth, &states),
        planning_cell: cell,
        robot_radius: config.robot_radius,
        planning_margin: margin,
    })
}

/// Share of the free cells of the truth of which a map knows something.
fn known_share(in_truth: &DistanceGrid, states: &[Occupancy]) -> f64 {
    let free = (0..states.len()).filter(|i| in_truth.at(*i) > 0.0);
    let free: Vec<usize> = free.collect();
    let known = free.iter().filter(|i| states[**i] != Occupancy::Unknown);
    known.count() as f64 / free.len().max(1) as f64
}

/// Least distances between centres of cells, in cells: half a cell belongs to the obstacle.
struct Clearances {
    plan: f32,
    collide: f32,
}

/// The shortest path of a pair in the truth.
struct Route {
    path: Path,
    /// Whether the map knows what the robot fills at start and goal.
    are_ends_observed: bool,
    /// Whether it does all along the path.
    is_path_observed: bool,
}

/// What became of one route on the map.
struct Outcome {
    is_optimal_blocked: bool,
    plan: Option<PlanOnMap>,
}

struct PlanOnMap {
    length_ratio: f64,
    /// Least distance from the surface of an obstacle to the centre of the robot, map units.
    clearance: f64,
    collides: bool,
}

fn validate(config: &PathConfig) -> Result<(), PathError> {
    let positive = |field, value: f64| (field, value, value > 0.0);
    let not_negative = |field, value: f64| (field, value, value >= 0.0);
    let fields = [
        positive("robot_radius", config.robot_radius),
        positive("planning_cell", config.planning_cell),
        not_negative("planning_margin", config.planning_margin.unwrap_or(1.0)),
        not_negative("min_distance", config.min_distance),
        positive("pairs", config.pairs as f64),
    ];
    let is_wrong = |(_, value, is_good): &(_, f64, bool)| !(*is_good && value.is_finite());
    match fields.into_iter().find(is_wrong) {
        Some((field, value, _)) => Err(PathError::Config { field, value }),
        None => Ok(()),
    }
}

/// States of cubes of `factor` cells along each axis: occupied when any of them is, else free when
/// at least `least_free` are; `index` says where a cube lies among `count`.
fn coarse_states(
    map: &OccupancyMap,
    index: impl Fn([i32; 3]) -> Option<usize>,
    count: usize,
    (factor, least_free): (u32, u32),
) -> Vec<Occupancy> {
    let mut free = vec![0_u32; count];
    let mut is_occupied = vec![false; count];
    for cell in map.cells() {
        let key = cell.key.to_array().map(|k| k.div_euclid(factor as i32));
        if let Some(index) = index(key) {
            if cell.log_odds > 0.0 {
                is_occupied[index] = true;
            } else {
                free[index] += 1;
            }
        }
    }
    let state = |(free, is_occupied): (u32, bool)| match is_occupied {
        true => Occupancy::Occupied,
        false if free >= least_free => Occupancy::Free,
        false => Occupancy::Unknown,
    };
    free.into_iter().zip(is_occupied).map(state).collect()
}

/// Random pairs of places that are connected in the truth and far enough apart.
fn sample_pairs(
    grid: &DistanceGrid,
    planner: &Planner,
    config: &PathConfig,
    cell: f64,
) -> Result<Vec<(usize, usize)>, PathError> {
    let is_free = |i: &usize| planner.component(*i) != 0;
    let free: Vec<usize> = (0..grid.len()).filter(is_free).collect();
    let min_distance_sq = (config.min_distance / cell).powi(2);
    let mut rng = Rng::new(config.seed);
    let mut draw = || free[rng.below(free.len())];
    let mut pairs = Vec::with_capacity(config.pairs);
    // A cramped truth may hold few such pairs; do not look for them forever.
    for _ in 0..config.pairs.saturating_mul(200) {
        if free.is_empty() || pairs.len() == config.pairs {
            break;
        }
        let (start, goal) = (draw(), draw());
        let (a, b) = (grid.cell(start), grid.cell(goal));
        let distance_sq: usize = (0..3).map(|axis| a[axis].abs_diff(b[axis]).pow(2)).sum();
        let is_connected = planner.component(start) == planner.component(goal);
        if is_connected && distance_sq as f64 >= min_distance_sq {
            pairs.push((start, goal));
        }
    }
    if pairs.is_empty() {
        return Err(PathError::NoPairs {
            free: free.len(),
            min_distance: config.min_distance,
            robot_radius: config.robot_radius,
        });
    }
    Ok(pairs)
}

fn compare(
    routes: &[Route],
    in_truth: &DistanceGrid,
    in_map: &DistanceGrid,
    clearances: &Clearances,
    cell: f64,
    visits: &mut Visits,
) -> Result<PathReport, PathError> {
    let mut planner = Planner::new(in_map, clearances.plan);
    let outcome = |route: &Route| {
        let cells = &route.path.cells;
        let plan = planner.plan(cells[0], cells[cells.len() - 1], visits);
        visits.check()?;
        Ok(Outcome {
            is_optimal_blocked: least_distance(in_map, cells) < clearances.collide,
            plan: plan.map(|plan| {
                let distance = least_distance(in_truth, &plan.cells);
                PlanOnMap {
                    length_ratio: plan.length / route.path.length,
                    clearance: (f64::from(distance) - 0.5) * cell,
                    collides: distance < clearances.collide,
                }
            }),
        })
    };
    let outcomes: Result<Vec<Outcome>, PathError> = routes.iter().map(outcome).collect();
    let outcomes = outcomes?;
    let of = |is_counted: fn(&Route) -> bool| {
        let pairs = routes.iter().zip(&outcomes);
        stats(pairs.filter_map(|(route, outcome)| is_counted(route).then_some(outcome)))
    };
    Ok(PathReport {
        all: of(|_| true),
        observed: of(|route| route.are_ends_observed),
        path_observed: of(|route| route.is_path_observed),
    })
}

impl Visits {
    fn check(&self) -> Result<(), PathError> {
        match self.is_exceeded() {
            true => Err(PathError::TooManyVisits { max: self.most() }),
            false => Ok(()),
        }
    }
}

fn least_distance(grid: &DistanceGrid, cells: &[usize]) -> f32 {
    let distances = cells.iter().map(|i| grid.at(*i));
    distances.fold(f32::INFINITY, f32::min)
}

fn stats<'a>(outcomes: impl Iterator<Item = &'a Outcome>) -> PathStats {
    let outcomes: Vec<&Outcome> = outcomes.collect();
    let plans: Vec<&PlanOnMap> = outcomes.iter().filter_map(|o| o.plan.as_ref()).collect();
    let share = |part: usize, whole: usize| part as f64 / whole.max(1) as f64;
    let blocked = outcomes.iter().filter(|o| o.is_optimal_blocked).count();
    let ratios: Vec<f64> = plans.iter().map(|p| p.length_ratio).collect();
    let clearances: Vec<f64> = plans.iter().map(|p| p.clearance).collect();
    PathStats {
        pairs: outcomes.len(),
        false_positive: share(blocked, outcomes.len()),
        unreachable: share(outcomes.len() - plans.len(), outcomes.len()),
        planned: plans.len(),
        false_negative: share(plans.iter().filter(|p| p.collides).count(), plans.len()),
        length_ratio: median(&ratios),
        clearance_median: median(&clearances),
        clearance_min: clearances.into_iter().min_by(f64::total_cmp),
    }
}
