//! A 2D projection of a map for navigation: `map.pgm` and `map.yaml` as nav2's map server reads them.

use monogrid_occupancy::{MapError, Occupancy, OccupancyMap};
use std::collections::BTreeMap;

/// What a robot would find in a column of cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Column {
    /// Nothing is known.
    Unknown,
    /// Something was seen to be free, nothing to be occupied.
    Free,
    /// Something is occupied.
    Occupied,
}

/// Columns seen from above: x to the right, y up, the origin at the lower left.
#[derive(Clone, Debug, PartialEq)]
pub struct GridMap {
    /// Cells along x.
    pub width: usize,
    /// Cells along y.
    pub height: usize,
    /// Edge of a cell.
    pub resolution: f64,
    /// Lower left corner of the first cell.
    pub origin: [f64; 2],
    /// Rows from below, each from the left.
    pub columns: Vec<Column>,
}

/// Grey levels of nav2's trinary mode.
const OCCUPIED_GREY: u8 = 0;
const FREE_GREY: u8 = 254;
const UNKNOWN_GREY: u8 = 205;
/// Largest side of the grid: larger ones would be stray cells, and gigabytes.
const MAX_SIDE: i64 = 16384;

/// Projects the cells whose centres lie in the given heights (z). One occupied cell decides a column.
pub fn project(map: &OccupancyMap, heights: [f64; 2]) -> Result<Option<GridMap>, MapError> {
    let resolution = map.resolution();
    let mut columns: BTreeMap<(i32, i32), Column> = BTreeMap::new();
    for leaf in map.octree_leaves()? {
        let state = match map.state_of(leaf.first) {
            Occupancy::Unknown => continue,
            Occupancy::Free => Column::Free,
            Occupancy::Occupied => Column::Occupied,
        };
        let edge = leaf.edge_cells as i32;
        let [x, y, z] = leaf.first.to_array();
        let in_band = (z..z + edge).any(|z| {
            let center = (f64::from(z) + 0.5) * resolution;
            (heights[0]..=heights[1]).contains(&center)
        });
        if !in_band {
            continue;
        }
        for y in y..y + edge {
            for x in x..x + edge {
                let column = columns.entry((y, x)).or_insert(state);
                if state == Column::Occupied {
                    *column = state;
                }
            }
        }
    }
    let Some(bounds) = bounds(&columns) else {
        return Ok(None);
    };
    let [x_min, y_min, x_max, y_max] = bounds;
    let (width, height) = ((x_max - x_min + 1) as usize, (y_max - y_min + 1) as usize);
    let mut grid = vec![Column::Unknown; width * height];
    for ((y, x), column) in columns {
        let (x, y) = (i64::from(x), i64::from(y));
        if (x_min..=x_max).contains(&x) && (y_min..=y_max).contains(&y) {
            grid[(y - y_min) as usize * width + (x - x_min) as usize] = column;
        }
    }
    Ok(Some(GridMap {
        width,
        height,
        resolution,
        origin: [x_min as f64 * resolution, y_min as f64 * resolution],
        columns: grid,
    }))
}

/// Smallest and largest x and y, at most [`MAX_SIDE`] apart.
fn bounds(columns: &BTreeMap<(i32, i32), Column>) -> Option<[i64; 4]> {
    let xs = || columns.keys().map(|&(_, x)| i64::from(x));
    let ys = || columns.keys().map(|&(y, _)| i64::from(y));
    let (x_min, y_min) = (xs().min()?, ys().min()?);
    Some([
        x_min,
        y_min,
        xs().max()?.min(x_min + MAX_SIDE - 1),
        ys().max()?.min(y_min + MAX_SIDE - 1),
    ])
}

impl GridMap {
    /// The image, rows from above.
    pub fn to_pgm(&self) -> Vec<u8> {
        let mut out = format!("P5\n{} {}\n255\n", self.width, self.height).into_bytes();
        for row in self.columns.chunks(self.width).rev() {
            out.extend(row.iter().map(|column| match column {
                Column::Unknown => UNKNOWN_GREY,
                Column::Free => FREE_GREY,
                Column::Occupied => OCCUPIED_GREY,
            }));
        }
        out
    }

    /// The description that goes with the image.
    pub fn to_yaml(&self, image: &str) -> String {
        format!(
            "image: {image}\nmode: trinary\nresolution: {}\norigin: [{}, {}, 0.0]\nnegate: 0\n\
             occupied_thresh: 0.65\nfree_thresh: 0.196\n",
            self.resolution, self.origin[0], self.origin[1]
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_occupancy::{MapConfig, VoxelKey};

    #[test]
    fn occupied_wins_and_rows_start_at_the_top() {
        let mut map = OccupancyMap::new(MapConfig::with_resolution(0.5)).unwrap();
        for (x, y, z, log_odds) in [
            (0, 0, 0, -1.0),
            (0, 0, 1, 1.0),
            (2, 1, 0, -1.0),
            (1, 0, 9, 1.0), // above the band
        ] {
            map.set_log_odds(VoxelKey::new(x, y, z), Some(log_odds))
                .unwrap();
        }
        let grid = project(&map, [0.0, 2.0]).unwrap().unwrap();
        assert_eq!((grid.width, grid.height), (3, 2));
        use Column::{Free, Occupied, Unknown};
        assert_eq!(
            grid.columns,
            [Occupied, Unknown, Unknown, Unknown, Unknown, Free]
        );
        let pgm = grid.to_pgm();
        assert!(pgm.starts_with(b"P5\n3 2\n255\n"));
        assert_eq!(pgm[pgm.len() - 6..], [205, 205, 254, 0, 205, 205]);
        assert!(grid.to_yaml("map.pgm").contains("resolution: 0.5"));
    }

    #[test]
    fn large_leaves_fill_their_columns() {
        let mut map = OccupancyMap::new(MapConfig::with_resolution(1.0)).unwrap();
        for x in 0..8 {
            for y in 0..8 {
                for z in 0..8 {
                    map.set_log_odds(VoxelKey::new(x, y, z), Some(-2.0))
                        .unwrap();
                }
            }
        }
        let grid = project(&map, [7.2, 7.8]).unwrap().unwrap();
        assert_eq!(grid.columns, vec![Column::Free; 64]);
        assert_eq!(project(&map, [8.2, 9.0]).unwrap(), None);
    }

    #[test]
    fn empty_maps_have_no_grid() {
        let map = OccupancyMap::new(MapConfig::default()).unwrap();
        assert_eq!(project(&map, [-1.0, 1.0]).unwrap(), None);
    }
}
