//! How many cells thick walls are.
//!
//! Through each truly occupied cell beside free space runs a line of cells across its surface:
//! along the axis on which the true surface is thinnest. The thickness there is the number of cells
//! in a row that a map holds occupied on that line, at the true surface or at most [`REACH`] cells
//! before or behind it. What the truth has itself, measured in the same way, stands beside it:
//! voxels of a slanted wall are two in a row.

use crate::statistics::median;
use crate::truth::TruthGrid;
use monogrid_occupancy::{Occupancy, OccupancyMap, VoxelKey};
use serde::Serialize;

/// A surface in the map belongs to a true one at most so many cells away.
const REACH: i32 = 2;
/// True surfaces with more cells in a row are no walls, but lie along the line.
const MAX_TRUE: i32 = 4;
/// Most cells in a row that are counted.
const MAX_RUN: i32 = 64;
const AXES: [[i32; 3]; 3] = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];

/// Cells in a row across surfaces.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Thickness {
    /// Median over the places where the map has the surface; `None` where it has none.
    pub thickness_cells: Option<f64>,
    /// Median of the truth at these places.
    pub true_thickness_cells: Option<f64>,
}

impl Thickness {
    /// At those of the truly occupied `cells` that lie beside free space.
    pub fn at(cells: &[[i32; 3]], estimate: &OccupancyMap, truth: &TruthGrid) -> Self {
        let runs = cells.iter().filter_map(|cell| {
            let crossing = Crossing::of(*cell, truth)?;
            let run = f64::from(crossing.run_in(estimate)?);
            Some((run, f64::from(crossing.last - crossing.first + 1)))
        });
        let (thick, true_thick): (Vec<f64>, Vec<f64>) = runs.unzip();
        Self {
            thickness_cells: median(&thick),
            true_thickness_cells: median(&true_thick),
        }
    }
}

/// A line of cells across a true surface.
struct Crossing {
    origin: [i32; 3],
    axis: [i32; 3],
    /// The true surface, in cells from the origin.
    first: i32,
    last: i32,
}

impl Crossing {
    /// Along the axis on which fewest cells are occupied in a row, with free space at one end of
    /// them at least.
    fn of(origin: [i32; 3], truth: &TruthGrid) -> Option<Self> {
        let of_axis = |axis: [i32; 3]| {
            let state = |at: i32| truth.state(along(origin, axis, at));
            let is_occupied = |at: i32| state(at) == Occupancy::Occupied;
            let last = (0..MAX_TRUE).take_while(|at| is_occupied(*at)).last()?;
            let first = -(0..MAX_TRUE).take_while(|at| is_occupied(-*at)).last()?;
            let is_beside_free = [first - 1, last + 1]
                .iter()
                .any(|at| state(*at) == Occupancy::Free);
            (is_beside_free && last - first < MAX_TRUE).then_some(Self {
                origin,
                axis,
                first,
                last,
            })
        };
        let crossings = AXES.into_iter().filter_map(of_axis);
        crossings.min_by_key(|crossing| crossing.last - crossing.first)
    }

    /// Cells in a row that the map holds occupied, of the row that is nearest to the true surface.
    fn run_in(&self, map: &OccupancyMap) -> Option<i32> {
        let is_occupied = |at: i32| {
            let key = VoxelKey::from_array(along(self.origin, self.axis, at));
            map.log_odds_of(key).is_some_and(|l| l > 0.0)
        };
        let within = self.first..=self.last;
        let beside = (1..=REACH).flat_map(|step| [self.first - step, self.last + step]);
        let start = within.chain(beside).find(|at| is_occupied(*at))?;
        let ahead = (1..MAX_RUN).take_while(|step| is_occupied(start + step));
        let back = (1..MAX_RUN).take_while(|step| is_occupied(start - step));
        Some(1 + ahead.count() as i32 + back.count() as i32)
    }
}

fn along(origin: [i32; 3], axis: [i32; 3], at: i32) -> [i32; 3] {
    std::array::from_fn(|a| origin[a] + at * axis[a])
}
