//! A map seen from above, as ground robots plan on it.

use crate::error::MapError;
use crate::evidence::{Occupancy, UNKNOWN};
use crate::key::BRICK_EDGE;
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
/// Most columns of a grid, of any shape: ten kilometres of 1 m in both directions. More would be
/// stray cells, and gigabytes.
const MAX_COLUMNS: i64 = 1 << 27;

impl OccupancyMap {
    /// Projects the cells whose centres lie between two heights (z, both inclusive). `None` if none
    /// of them is known.
    ///
    /// # Errors
    /// More than 134 million columns: nothing is cut off.
    pub fn projected(&self, low: f64, high: f64) -> Result<Option<Projection>, MapError> {
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
            return Ok(None);
        }
        let (width, height) = (x_max - x_min + 1, y_max - y_min + 1);
        if width.saturating_mul(height) > MAX_COLUMNS {
            return Err(MapError::GridSize {
                width,
                height,
                most: MAX_COLUMNS,
            });
        }
        let mut columns = vec![Occupancy::Unknown; (width * height) as usize];
        self.for_each_column(in_band, |x, y, state| {
            let (x, y) = (i64::from(x) - x_min, i64::from(y) - y_min);
            let column = &mut columns[(y * width + x) as usize];
            if *column != Occupancy::Occupied {
                *column = state;
            }
        });
        Ok(Some(Projection {
            width: width as usize,
            height: height as usize,
            resolution: self.resolution(),
            origin: [x_min, y_min].map(|index| index as f64 * self.resolution()),
            columns,
        }))
    }

    /// Calls `visit(x, y, state)` for the known columns of each brick, within the heights of
    /// `in_band`; a column of the map may come several times.
    fn for_each_column(
        &self,
        in_band: impl Fn(i32) -> bool,
        mut visit: impl FnMut(i32, i32, Occupancy),
    ) {
        for brick in self.bricks() {
            let first = brick.first_cell().z;
            let layers: Vec<i32> = (0..BRICK_EDGE).filter(|z| in_band(first + z)).collect();
            if layers.is_empty() {
                continue;
            }
            let values = self.brick_values(brick);
            for column in 0..64 {
                let of_column = layers.iter().map(|z| values[column + 64 * *z as usize]);
                if let Some(largest) = of_column.max().filter(|v| *v != UNKNOWN) {
                    let cell = brick.cell(column);
                    visit(cell.x, cell.y, self.limits.occupancy(largest));
                }
            }
        }
    }
}

impl Projection {
    /// The same columns in a grid whose sides lie at multiples of `cells`: a map that grows a
    /// little keeps its size and place.
    #[must_use]
    pub fn aligned(&self, cells: usize) -> Self {
        let cells = (cells as i64).max(1);
        let [x, y] = self.first_column();
        let begin = [x, y].map(|first| first.div_euclid(cells) * cells);
        let end = [x + self.width as i64, y + self.height as i64];
        let [width, height] = [0, 1].map(|axis| {
            let end = (end[axis] + cells - 1).div_euclid(cells) * cells;
            (end - begin[axis]) as usize
        });
        self.window(begin, width, height)
    }

    /// The part around a point that has at most so many columns, as square as it can be; all of it
    /// where that is few enough.
    #[must_use]
    pub fn around(&self, center: [f64; 2], max_columns: usize) -> Self {
        if self.columns.len() <= max_columns {
            return self.clone();
        }
        // a narrow grid is cut along its long side only
        let side = max_columns.isqrt().max(1);
        let width = self.width.min(side.max(max_columns / self.height));
        let height = self.height.min((max_columns / width).max(1));
        let begin = |axis: usize, all: usize, part: usize| {
            let first = self.first_column()[axis];
            let wanted = (center[axis] / self.resolution).floor() as i64 - part as i64 / 2;
            wanted.clamp(first, first + (all - part) as i64)
        };
        let begin = [begin(0, self.width, width), begin(1, self.height, height)];
        self.window(begin, width, height)
    }

    /// Index of the first column along both axes, counted from the origin of the map.
    fn first_column(&self) -> [i64; 2] {
        self.origin.map(|at| (at / self.resolution).round() as i64)
    }

    /// The columns of another rectangle of the same grid; unknown where this one has none.
    fn window(&self, begin: [i64; 2], width: usize, height: usize) -> Self {
        let first = self.first_column();
        let shift = [begin[0] - first[0], begin[1] - first[1]];
        let column = |x: i64, y: i64| {
            let (own_width, own_height) = (self.width as i64, self.height as i64);
            if !(0..own_width).contains(&x) || !(0..own_height).contains(&y) {
                return Occupancy::Unknown;
            }
            self.columns[(y * own_width + x) as usize]
        };
        let row = |y: i64| (0..width as i64).map(move |x| column(x + shift[0], y + shift[1]));
        let columns = (0..height as i64).flat_map(row);
        Self {
            width,
            height,
            resolution: self.resolution,
            origin: begin.map(|index| index as f64 * self.resolution),
            columns: columns.collect(),
        }
    }

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
    use crate::BrickKey;
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
        let grid = map.projected(0.0, 2.0).unwrap().unwrap();
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

    /// Three columns to the right, two up, from (-2, 3) on.
    fn small() -> Projection {
        use Occupancy::{Free, Occupied, Unknown};
        Projection {
            width: 3,
            height: 2,
            resolution: 0.5,
            origin: [-1.0, 1.5],
            columns: vec![Occupied, Free, Unknown, Free, Occupied, Occupied],
        }
    }

    /// The known columns by their index in the map.
    fn known(grid: &Projection) -> Vec<(i64, i64, Occupancy)> {
        let [x, y] = grid.first_column();
        let columns = grid.columns.iter().enumerate();
        let known = columns.filter(|(_, state)| **state != Occupancy::Unknown);
        let (width, at) = (grid.width as i64, |k: usize| k as i64);
        known
            .map(|(k, state)| (x + at(k) % width, y + at(k) / width, *state))
            .collect()
    }

    #[test]
    fn an_aligned_grid_shows_the_same_columns() {
        let aligned = small().aligned(4);
        assert_eq!((aligned.width, aligned.height), (8, 8));
        assert_eq!(aligned.origin, [-2.0, 0.0]);
        assert_eq!(known(&aligned), known(&small()));
        assert_eq!(aligned.aligned(4), aligned);
    }

    #[test]
    fn the_part_around_a_point_is_as_large_as_it_may_be() {
        assert_eq!(small().around([0.0, 0.0], 6), small());
        let grid = small().aligned(8);
        assert_eq!((grid.width, grid.height), (16, 8));
        // the column (-1, 4) in the middle
        let part = grid.around([-0.3, 2.2], 10);
        assert_eq!((part.width, part.height), (3, 3));
        assert_eq!(part.first_column(), [-2, 3]);
        assert_eq!(known(&part).len(), 5);
        // the border is not left
        assert_eq!(grid.around([99.0, -99.0], 9).first_column(), [5, 0]);
        let narrow = small().around([0.4, 0.0], 4);
        assert_eq!((narrow.width, narrow.height), (2, 2));
        let mut right = known(&small());
        right.retain(|(x, _, _)| *x > -2);
        assert_eq!(known(&narrow), right);
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
        let grid = map.projected(low, high).unwrap().unwrap();
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
        let grid = map.projected(7.2, 7.8).unwrap().unwrap();
        assert_eq!(grid.columns, vec![Occupancy::Free; 64]);
        assert_eq!(map.projected(8.2, 9.0).unwrap(), None);
        let empty = OccupancyMap::new(MapConfig::default()).unwrap();
        assert_eq!(empty.projected(-1.0, 1.0).unwrap(), None);
    }

    #[test]
    fn a_grid_of_any_length_is_whole_and_one_that_is_too_large_is_refused() {
        let wall = |at: &[[i32; 2]]| {
            let mut map = OccupancyMap::new(MapConfig::with_resolution(0.05)).unwrap();
            for [x, y] in at {
                map.set_log_odds(VoxelKey::new(*x, *y, 0), Some(1.0))
                    .unwrap();
            }
            map
        };
        for (end, width, height) in [([20_000, 0], 20_001, 1), ([0, -90_000], 1, 90_001)] {
            let map = wall(&[[0, 0], end]);
            let grid = map.projected(-1.0, 1.0).unwrap().unwrap();
            assert_eq!((grid.width, grid.height), (width, height));
            assert_eq!(grid.columns.first(), Some(&Occupancy::Occupied));
            assert_eq!(grid.columns.last(), Some(&Occupancy::Occupied));
        }
        // of what is high up nothing is asked
        let mut map = wall(&[[0, 0], [20_000, 20_000]]);
        let refused = map.projected(-1.0, 1.0).unwrap_err().to_string();
        assert!(refused.contains("20001 x 20001"), "{refused}");
        map.set_log_odds(VoxelKey::new(3, 3, 90), Some(1.0))
            .unwrap();
        let grid = map.projected(4.0, 5.0).unwrap().unwrap();
        assert_eq!((grid.width, grid.height), (1, 1));
    }
}
