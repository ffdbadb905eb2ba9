//! Ground-truth maps: what is occupied, free and unknown in a world whose surface is known.
//!
//! Flow: surface → **voxelise** (exact) → **fill** free space from the camera's path → coarser
//! grids by [`TruthGrid::coarsened`], so that all resolutions agree. Posed depth images have no
//! closed surface: there, free is what their rays cross ([`truth_from_depth_images`]).

mod depth_images;
mod fill;
mod grid;
mod view;
mod voxelize;

pub use depth_images::{PosedDepth, truth_from_depth_images};
pub(crate) use grid::cell_in_box;
pub use grid::{CellCounts, TruthGrid, whole_ratio};
pub use view::{View, cells_in_view};
pub use voxelize::Triangle;

use grid::OCCUPIED;

/// Settings of [`truth_from_triangles`] and [`truth_from_points`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TruthConfig {
    /// Edge of a cell, in units of the surface. Build the finest that is needed and derive the
    /// rest.
    pub resolution: f64,
    /// Holes of the surface up to twice this many cells wide are closed while free space is filled;
    /// gaps that narrow become unknown. Default 1.
    pub hole_cells: usize,
    /// Points of a cloud mark all cells within this distance, in units of the cloud; at least half
    /// their spacing, or the surface has holes. Default 0: only the cell of the point.
    pub splat_radius: f64,
    /// Most cells of the box, two bits each. Default 4e9 (1 GB).
    pub max_cells: u64,
}

impl TruthConfig {
    /// The defaults with cells of edge `resolution`.
    #[must_use]
    pub fn with_resolution(resolution: f64) -> Self {
        Self {
            resolution,
            hole_cells: 1,
            splat_radius: 0.0,
            max_cells: 4_000_000_000,
        }
    }
}

/// Why no ground truth could be made.
#[derive(Debug, thiserror::Error, Clone, PartialEq)]
#[non_exhaustive]
pub enum TruthError {
    /// The resolution is not a positive number.
    #[error("resolution is {0}, expected a positive length")]
    Resolution(f64),
    /// A factor between resolutions that is not positive.
    #[error("coarsening by a factor of {0}, expected 1 or more")]
    Factor(u32),
    /// A box without cells.
    #[error("the box from cell {first:?} to cell {last:?} is empty")]
    EmptyBox {
        /// First cell.
        first: [i32; 3],
        /// Last cell.
        last: [i32; 3],
    },
    /// The box is too large for dense cells.
    #[error(
        "the map would have {cells} cells, allowed are {max_cells}; choose a larger resolution"
    )]
    TooManyCells {
        /// Cells needed.
        cells: u64,
        /// Cells allowed.
        max_cells: u64,
    },
    /// Triangles that lie in one another: marking them would take far longer than the box they lie
    /// in.
    #[error(
        "the triangles of the surface touch about {cells} cells, one after the other, allowed are \
         {max_cells}; do they lie in one another? Choose a larger resolution"
    )]
    TooMuchSurface {
        /// Cells that all triangles touch together.
        cells: u64,
        /// Cells allowed.
        max_cells: u64,
    },
    /// A surface without triangles or points, or a map without known cells.
    #[error("there is nothing known to make ground truth of: no surface, or only unknown cells")]
    NothingKnown,
    /// A corner or point that is not finite, or too far away to address.
    #[error("point {index} of the surface, {point:?}, is not finite or too far from the origin")]
    Point {
        /// Position in the input.
        index: usize,
        /// What was found.
        point: [f64; 3],
    },
    /// No camera position lies in free space.
    #[error(
        "none of the {cameras} camera positions lies in free space: {in_surface} are in cells that \
         the surface or the balls around its points fill, {near_surface} in cells so near to such \
         that they count as closed holes; are the trajectory and the surface in the same frame and \
         unit? Smaller cells, fewer hole cells, or a smaller splat radius leave more space free"
    )]
    NoFreeCamera {
        /// All of them.
        cameras: usize,
        /// Those in cells of the surface.
        in_surface: usize,
        /// Those in cells that are closed with its holes.
        near_surface: usize,
    },
    /// A depth image whose size does not match its camera.
    #[error("depth image {index} has {found} pixels, expected {width}x{height}")]
    ImageSize {
        /// Position in the input.
        index: usize,
        /// Pixels found.
        found: usize,
        /// Columns expected.
        width: usize,
        /// Rows expected.
        height: usize,
    },
}

/// A ground-truth map and how sound it is.
#[derive(Clone, Debug, PartialEq)]
pub struct Truth {
    /// The map.
    pub grid: TruthGrid,
    /// Camera positions that lie in its free space.
    pub cameras_in_free_space: usize,
    /// Free space reaches the border of the box: the surface is open or has holes wider than
    /// `2 * hole_cells` cells, and "free" then includes the outside.
    pub reaches_border: bool,
}

/// Cells of the box for each one that triangles touch: a surface has far fewer, however it is
/// folded.
const CELLS_PER_SURFACE_CELL: u64 = 8;

/// Ground truth of a surface made of triangles: occupied where a triangle touches a cell, free
/// where a camera could have flown, else unknown. `cameras` are positions of the camera, all in the
/// frame and unit of the surface.
///
/// # Errors
/// No triangle, one that is not finite, a box of too many cells, triangles that touch far more, or
/// no camera in free space.
pub fn truth_from_triangles(
    triangles: &[Triangle],
    cameras: &[[f64; 3]],
    config: &TruthConfig,
) -> Result<Truth, TruthError> {
    let corners = || triangles.iter().flatten().copied();
    let mut grid = grid_around(corners(), cameras, config)?;
    let touched = triangles
        .iter()
        .map(|t| voxelize::touched_cells(t, config.resolution));
    let cells = touched.sum::<f64>() as u64;
    let max_cells = config.max_cells / CELLS_PER_SURFACE_CELL;
    if cells > max_cells {
        return Err(TruthError::TooMuchSurface { cells, max_cells });
    }
    for triangle in triangles {
        voxelize::mark_triangle(&mut grid, triangle);
    }
    filled(grid, cameras, config)
}

/// As [`truth_from_triangles`], from a dense point cloud of the surface.
///
/// # Errors
/// No point, one that is not finite, a box of too many cells, or no camera in free space.
pub fn truth_from_points(
    points: &[[f64; 3]],
    cameras: &[[f64; 3]],
    config: &TruthConfig,
) -> Result<Truth, TruthError> {
    let mut grid = grid_around(points.iter().copied(), cameras, config)?;
    for point in points {
        mark_ball(&mut grid, *point, config.splat_radius);
    }
    filled(grid, cameras, config)
}

/// A grid around all points and cameras, two cells wider than them on each side.
fn grid_around(
    points: impl Iterator<Item = [f64; 3]>,
    cameras: &[[f64; 3]],
    config: &TruthConfig,
) -> Result<TruthGrid, TruthError> {
    if !(config.resolution.is_finite() && config.resolution > 0.0) {
        return Err(TruthError::Resolution(config.resolution));
    }
    let mut low = [i32::MAX; 3];
    let mut high = [i32::MIN; 3];
    let mut is_empty = true;
    let inv_resolution = 1.0 / config.resolution;
    let reach = (config.splat_radius.max(0.0) * inv_resolution).ceil() as i32;
    let margin = 2 + config.hole_cells as i32 + reach;
    let surface = points.map(|p| (p, true));
    let all = surface.chain(cameras.iter().map(|c| (*c, false)));
    for (index, (point, is_surface)) in all.enumerate() {
        let key = monogrid_occupancy::VoxelKey::from_point(point, inv_resolution)
            .ok_or(TruthError::Point { index, point })?
            .to_array();
        is_empty &= !is_surface;
        low = [0, 1, 2].map(|axis| low[axis].min(key[axis] - margin));
        high = [0, 1, 2].map(|axis| high[axis].max(key[axis] + margin));
    }
    if is_empty {
        return Err(TruthError::NothingKnown);
    }
    TruthGrid::new(config.resolution, low, high, config.max_cells)
}

fn mark_ball(grid: &mut TruthGrid, point: [f64; 3], radius: f64) {
    let Some(middle) = grid.key(point) else {
        return;
    };
    let reach = (radius.max(0.0) / grid.resolution()).ceil() as i32;
    for z in -reach..=reach {
        for y in -reach..=reach {
            for x in -reach..=reach {
                let key = [middle[0] + x, middle[1] + y, middle[2] + z];
                let is_touched = key == middle || distance_to_cell(grid, key, point) <= radius;
                if let Some(cell) = grid.local(key).filter(|_| is_touched) {
                    grid.set_code(cell, OCCUPIED);
                }
            }
        }
    }
}

fn distance_to_cell(grid: &TruthGrid, key: [i32; 3], point: [f64; 3]) -> f64 {
    let center = grid.center(key);
    let half = 0.5 * grid.resolution();
    let gap_sq = |a: usize| ((point[a] - center[a]).abs() - half).max(0.0).powi(2);
    (gap_sq(0) + gap_sq(1) + gap_sq(2)).sqrt()
}

fn filled(
    mut grid: TruthGrid,
    cameras: &[[f64; 3]],
    config: &TruthConfig,
) -> Result<Truth, TruthError> {
    let seeds: Vec<[i32; 3]> = cameras.iter().filter_map(|c| grid.key(*c)).collect();
    let outcome = fill::fill_free(&mut grid, &seeds, config.hole_cells);
    if outcome.good_seeds == 0 {
        let cells = seeds.iter().filter_map(|seed| grid.local(*seed));
        let in_surface = cells.filter(|cell| grid.code(*cell) == OCCUPIED).count();
        return Err(TruthError::NoFreeCamera {
            cameras: cameras.len(),
            in_surface,
            near_surface: seeds.len() - in_surface,
        });
    }
    Ok(Truth {
        grid,
        cameras_in_free_space: outcome.good_seeds,
        reaches_border: outcome.reaches_border,
    })
}
