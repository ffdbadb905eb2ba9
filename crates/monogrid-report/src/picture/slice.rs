//! Horizontal slices of a map as grey pictures: black occupied, white free (as `map.pgm`), mid grey
//! unknown.

use monogrid_image::Image;
use monogrid_occupancy::{Leaf, OccupancyMap, VoxelKey, probability_from_log_odds};

/// Grey level of unknown cells.
pub const UNKNOWN_GREY: u8 = 128;
/// Grey level of the borders of cells.
const BORDER_GREY: u8 = 90;
/// Most pixels along a side of a slice.
const MAX_SIDE: usize = 8192;

/// The part of a layer of cells that is drawn: x to the right, y upwards.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    /// Smallest indices of the cells.
    pub first: [i32; 2],
    /// Cells along x and y.
    pub size: [usize; 2],
    /// Pixels per cell and axis.
    pub scale: usize,
}

impl Window {
    /// The cells between two corners (inclusive), each as large as fits into about `side` pixels.
    pub fn new(first: [i32; 2], last: [i32; 2], side: usize) -> Self {
        let size: [usize; 2] = std::array::from_fn(|axis| {
            let cells = i64::from(last[axis]) - i64::from(first[axis]) + 1;
            cells.clamp(1, MAX_SIDE as i64) as usize
        });
        let scale = (side / size[0].max(size[1])).max(1);
        Self { first, size, scale }
    }

    /// A picture of the cells, by their grey levels.
    pub fn picture(&self, grey_of: impl Fn([i32; 2]) -> u8) -> Image<u8> {
        let [width, height] = self.size;
        let [first_x, first_y] = self.first;
        let greys = Image::from_fn(width, height, |column, row| {
            grey_of([first_x + column as i32, first_y + (height - 1 - row) as i32])
        });
        Image::from_fn(width * self.scale, height * self.scale, |x, y| {
            greys.at(x / self.scale, y / self.scale)
        })
    }

    /// Pixel columns `[from, to)` and rows `[from, to)` of a square of cells, cut at the window.
    fn pixels_of(&self, first: [i32; 2], edge: i32) -> Option<[[usize; 2]; 2]> {
        let along = |axis: usize| -> Option<[usize; 2]> {
            let from = i64::from(first[axis]) - i64::from(self.first[axis]);
            let to = from + i64::from(edge);
            let cells = self.size[axis] as i64;
            (to > 0 && from < cells)
                .then(|| [from.max(0) as usize, to.min(cells) as usize].map(|c| c * self.scale))
        };
        let height = self.size[1] * self.scale;
        let [low, high] = along(1)?;
        Some([along(0)?, [height - high, height - low]])
    }
}

/// Grey level of a probability of occupancy.
pub fn grey(probability: f64) -> u8 {
    ((1.0 - probability) * 255.0).round().clamp(0.0, 255.0) as u8
}

/// Grey level of what a map knows about a cell.
pub fn grey_of_cell(map: &OccupancyMap, key: VoxelKey) -> u8 {
    map.log_odds_of(key).map_or(UNKNOWN_GREY, |log_odds| {
        grey(probability_from_log_odds(f64::from(log_odds)))
    })
}

/// One layer of a map.
pub fn slice(map: &OccupancyMap, window: &Window, z: i32) -> Image<u8> {
    window.picture(|[x, y]| grey_of_cell(map, VoxelKey::new(x, y, z)))
}

/// Draws the borders of the pruned octree's leaves that a layer cuts: the adaptive size of cells.
pub fn draw_borders(picture: &mut Image<u8>, leaves: &[Leaf], window: &Window, z: i32) {
    for leaf in leaves {
        let edge = leaf.edge_cells as i32;
        let first = leaf.first.to_array();
        if !(first[2]..first[2] + edge).contains(&z) {
            continue;
        }
        let Some([columns, rows]) = window.pixels_of([first[0], first[1]], edge) else {
            continue;
        };
        // one line per border: that on the left and that on top
        for y in rows[0]..rows[1] {
            picture.set(columns[0], y, BORDER_GREY);
        }
        for x in columns[0]..columns[1] {
            picture.set(x, rows[0], BORDER_GREY);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_occupancy::MapConfig;

    fn map() -> OccupancyMap {
        let mut map = OccupancyMap::new(MapConfig::with_resolution(1.0)).unwrap();
        for x in 0..4 {
            for y in 0..4 {
                for z in 0..4 {
                    map.set_log_odds(VoxelKey::new(x, y, z), Some(-2.0))
                        .unwrap();
                }
            }
        }
        map.set_log_odds(VoxelKey::new(5, 0, 1), Some(3.5)).unwrap();
        map
    }

    #[test]
    fn occupied_is_black_free_white_unknown_grey_and_y_points_up() {
        let window = Window::new([0, -1], [5, 4], 12);
        assert_eq!((window.size, window.scale), ([6, 6], 2));
        let picture = slice(&map(), &window, 1);
        assert_eq!((picture.width(), picture.height()), (12, 12));
        // cell (5, 0): columns 10 and 11, second row from below
        assert_eq!(picture.at(11, 9), 7);
        assert_eq!(picture.at(11, 11), UNKNOWN_GREY);
        assert_eq!(picture.at(0, 9), 225);
        assert_eq!(picture.at(0, 0), UNKNOWN_GREY);
        let above = slice(&map(), &window, 4);
        assert!(above.as_slice().iter().all(|g| *g == UNKNOWN_GREY));
    }

    #[test]
    fn borders_enclose_merged_cells() {
        let map = map();
        let leaves = map.octree_leaves().unwrap();
        assert_eq!(leaves.len(), 2);
        let window = Window::new([0, 0], [5, 5], 24);
        let plain = slice(&map, &window, 1);
        let mut bordered = plain.clone();
        draw_borders(&mut bordered, &leaves, &window, 1);
        let changed = plain
            .as_slice()
            .iter()
            .zip(bordered.as_slice())
            .filter(|(a, b)| a != b)
            .count();
        // left and top border of a square of 16 pixels and of one of 4
        assert_eq!(changed, 31 + 7);
    }
}
