//! A map seen from above, as ground robots plan on it.

use crate::evidence::{Occupancy, UNKNOWN};
use crate::key::{BRICK_EDGE, BrickKey};
use crate::map::OccupancyMap;

/// Columns of cells seen from above: x to the right, y up, the origin at the lower left.
#[derive(Clone, Debug, PartialEq)]
pub struct Projection {
    /// Cells along x.
    pub width: usize,
    /// Cells along y.
    pub height: usize,
    /// Edge of a cell.
    pub resolution: f64,
    /// Lower left corner of the first cell.
    pub origin: [f64; 2],
    /// Rows from below, each from the left: occupied if a cell of the column is, else free if one
    /// is known, else unknown.
    pub columns: Vec<Occupancy>,
}

/// Grey levels of nav2's trinary mode.
const OCCUPIED_GREY: u8 = 0;
const FREE_GREY: u8 = 254;
const UNKNOWN_GREY: u8 = 205;
/// Largest side of the grid: larger ones would be stray cells, and gigabytes.
const MAX_SIDE: i64 = 16384;

impl OccupancyMap {
    /// Projects the cells whose centres lie between two heights (z, both inclusive), at most 16384
    /// cells from the smallest x and y on. `None` if none of them is known.
    #[must_use]
    pub fn projected(&self, low: f64, high: f64) -> Option<Projection> {
        let in_band = |z: i32| {
            let center = (f64::from(z) + 0.5) * self.resolution();
            (low..=high).contains(&center)
        };
        let mut bounds = [i64::MAX, i64::MAX, i64::MIN, i64::MIN];
        // Two passes over the bricks, so that nothing but the grid itself is kept.
        self.for_each_column(in_band, |x, y, _| {
            let (x, y) = (i64::from(x), i64::from(y));
            let [x_min, y_min, x_max, y_max] = bounds;
            bounds = [x_min.min(x), y_min.min(y), x_max.max(x), y_max.max(y)];
        });
        let [x_min, y_min, x_max, y_max] = bounds;
        if x_min > x_max {
            return None;
        }
        let side = |min: i64, max: i64| (max - min + 1).min(MAX_SIDE);
        let (width, height) = (side(x_min, x_max), side(y_min, y_max));
        let mut columns = vec![Occupancy::Unknown; (width * height) as usize];
        self.for_each_column(in_band, |x, y, state| {
            let (x, y) = (i64::from(x) - x_min, i64::from(y) - y_min);
            if x < width && y < height {
                let column = &mut columns[(y * width + x) as usize];
                if *column != Occupancy::Occupied {
                    *column = state;
                }
            }
        });
        Some(Projection {
            width: width as usize,
            height: height as usize,
            resolution: self.resolution(),
            origin: [
                x_min as f64 * self.resolution(),
                y_min as f64 * self.resolution(),
            ],
            columns,
        })
    }

    /// Calls `visit(x, y, state)` for the known columns of each brick, within the heights of
    /// `in_band`; a column of the map may come several times.
    fn for_each_column(
        &self,
        in_band: impl Fn(i32) -> bool,
        mut visit: impl FnMut(i32, i32, Occupancy),
    ) {
        let layers = |brick: &BrickKey| {
            let first = brick.first_cell().z;
            (0..BRICK_EDGE)
                .filter(|z| in_band(first + z))
                .collect::<Vec<i32>>()
        };
        for brick in self.bricks() {
            let layers = layers(&brick);
            if layers.is_empty() {
                continue;
            }
            let values = self.brick_values(brick);
            for column in 0..64 {
                let largest = layers
                    .iter()
                    .map(|z| values[column + 64 * *z as usize])
                    .max();
                if let Some(largest) = largest.filter(|v| *v != UNKNOWN) {
                    let cell = brick.cell(column);
                    visit(cell.x, cell.y, self.limits.occupancy(largest));
                }
            }
        }
    }
}

impl Projection {
    /// The image for nav2's map server, binary PGM, rows from above.
    #[must_use]
    pub fn to_pgm(&self) -> Vec<u8> {
        let mut out = format!("P5\n{} {}\n255\n", self.width, self.height).into_bytes();
        for row in self.columns.chunks(self.width).rev() {
            out.extend(row.iter().map(|column| match column {
                Occupancy::Unknown => UNKNOWN_GREY,
                Occupancy::Free => FREE_GREY,
                Occupancy::Occupied => OCCUPIED_GREY,
            }));
        }
        out
    }

    /// The description that goes with the image of the given name.
    #[must_use]
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
    use crate::key::VoxelKey;
    use crate::map::MapConfig;

    #[test]
    fn occupied_wins_and_rows_start_at_the_top() {
        let mut map = OccupancyMap::new(MapConfig::with_resolution(0.5)).unwrap();
        for (x, y, z, log_odds) in [
            (0, 0, 0, -1.0),
            (0, 0, 1, 1.0),
            (0, 0, 3, -1.0),
            (2, 1, 0, -1.0),
            (1, 0, 9, 1.0), // above the band
        ] {
            map.set_log_odds(VoxelKey::new(x, y, z), Some(log_odds))
                .unwrap();
        }
        let grid = map.projected(0.0, 2.0).unwrap();
        assert_eq!((grid.width, grid.height), (3, 2));
        use Occupancy::{Free, Occupied, Unknown};
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
    fn columns_are_those_that_a_search_over_all_cells_finds() {
        let mut map = OccupancyMap::new(MapConfig::with_resolution(1.0)).unwrap();
        let mut state = 3_u32;
        let mut random = |below: u32| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            ((state >> 8) % below) as i32
        };
        for _ in 0..400 {
            let key = VoxelKey::new(random(30) - 15, random(20) - 10, random(20) - 10);
            map.set_log_odds(key, Some(if random(3) == 0 { 1.0 } else { -1.0 }))
                .unwrap();
        }
        let (low, high) = (-3.5, 6.0);
        let grid = map.projected(low, high).unwrap();
        for row in 0..grid.height {
            for column in 0..grid.width {
                let x = grid.origin[0] as i32 + column as i32;
                let y = grid.origin[1] as i32 + row as i32;
                // Centres -3.5 to 5.5.
                let states = (-4..=5).map(|z| map.state_of(VoxelKey::new(x, y, z)));
                let expected = states.fold(Occupancy::Unknown, |most, s| match (most, s) {
                    (Occupancy::Occupied, _) | (_, Occupancy::Unknown) => most,
                    _ => s,
                });
                assert_eq!(grid.columns[row * grid.width + column], expected, "{x} {y}");
            }
        }
    }

    #[test]
    fn uniform_bricks_fill_their_columns_and_empty_bands_are_none() {
        let mut map = OccupancyMap::new(MapConfig::with_resolution(1.0)).unwrap();
        for index in 0..512 {
            let key = BrickKey::new(0, 0, 0).cell(index);
            map.set_log_odds(key, Some(-2.0)).unwrap();
        }
        let grid = map.projected(7.2, 7.8).unwrap();
        assert_eq!(grid.columns, vec![Occupancy::Free; 64]);
        assert_eq!(map.projected(8.2, 9.0), None);
        let empty = OccupancyMap::new(MapConfig::default()).unwrap();
        assert_eq!(empty.projected(-1.0, 1.0), None);
    }
}
