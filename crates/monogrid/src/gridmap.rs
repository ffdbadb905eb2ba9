//! A 2D projection of a map for navigation: `map.pgm` and `map.yaml` as nav2's map server reads them.

use monogrid_occupancy::{MapError, OccupancyMap, Projection};

/// Projects the cells whose centres lie in the given heights (z). One occupied cell decides a column.
pub fn project(map: &OccupancyMap, heights: [f64; 2]) -> Result<Option<Projection>, MapError> {
    Ok(map.projected(heights[0], heights[1]))
}
