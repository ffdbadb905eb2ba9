//! Cells of a map as a block of integers.

use crate::picture::base64;
use crate::surface::CellColours;
use monogrid_occupancy::{MapError, Occupancy, OccupancyMap, VoxelKey, probability_from_log_odds};
use serde::Serialize;
use std::collections::BTreeMap;

/// Cubes of each kind at most; a map with more is shown with larger ones.
const MAX_CUBES: usize = 400_000;

/// Cubes of a map: leaves of its pruned octree.
///
/// A block is base64 of four little-endian 16-bit integers per cube: its first cell relative to
/// `first` along x, y, z, and the logarithm of its edge in cells times 256 plus its probability of
/// occupancy in 1/255.
#[derive(Clone, Debug, Serialize)]
pub struct Cells {
    /// Edge of a cell.
    pub edge: f64,
    /// Key of the cell from which others are counted.
    pub first: [i32; 3],
    /// Number of cubes that are occupied, and that are free.
    pub count: [usize; 2],
    /// Edge of the smallest cubes that are shown, cells.
    pub smallest: u32,
    /// Occupied cubes.
    pub occupied: String,
    /// Red, green and blue of each occupied cube, bytes in base64.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub colours: Option<String>,
    /// Free cubes.
    pub free: String,
}

/// A cube of cells.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Cube {
    first: [i32; 3],
    level: u32,
    probability: f64,
}

impl Cells {
    /// The known cells of a map, in these colours.
    pub fn new(map: &OccupancyMap, colours: Option<&CellColours>) -> Result<Self, MapError> {
        let (mut occupied, mut free) = (Vec::new(), Vec::new());
        map.for_each_leaf(|leaf| {
            let cubes = match map.state_of(leaf.first) {
                Occupancy::Occupied => &mut occupied,
                Occupancy::Free => &mut free,
                Occupancy::Unknown => return,
            };
            cubes.push(Cube {
                first: leaf.first.to_array(),
                level: leaf.edge_cells.ilog2(),
                probability: probability_from_log_odds(f64::from(leaf.log_odds())),
            });
        })?;
        let mut level = 0;
        while occupied.len() > MAX_CUBES {
            level += 1;
            occupied = merged(&occupied, level);
        }
        let mut free_level = level;
        while free.len() > MAX_CUBES {
            free_level += 1;
            free.retain(|cube| cube.level >= free_level);
        }
        let mut cells = Self::pack(map, level, &occupied, &free);
        cells.colours = colours.map(|colours| {
            let shown = occupied.iter().filter(|cube| cells.holds(cube));
            let colours: Vec<[u8; 3]> = shown.map(|cube| colours.of(cube.middle())).collect();
            base64(colours.as_flattened())
        });
        Ok(cells)
    }

    /// Whether a cube is near enough to the first cell to have a place.
    fn holds(&self, cube: &Cube) -> bool {
        (0..3).all(|axis| within(cube.first[axis], self.first[axis]).is_some())
    }

    fn pack(map: &OccupancyMap, level: u32, occupied: &[Cube], free: &[Cube]) -> Self {
        let all = || occupied.iter().chain(free);
        let first =
            [0, 1, 2].map(|axis| all().map(|cube| cube.first[axis]).min().unwrap_or_default());
        let mut cells = Self {
            edge: map.resolution(),
            first,
            count: [0; 2],
            smallest: 1 << level,
            occupied: String::new(),
            colours: None,
            free: String::new(),
        };
        let block = |cubes: &[Cube]| {
            let mut bytes = Vec::with_capacity(cubes.len() * 8);
            // 65,536 cells along an axis are more than OctoMap files hold
            for cube in cubes.iter().filter(|cube| cells.holds(cube)) {
                for (cell, first) in cube.first.iter().zip(first) {
                    let cell = within(*cell, first).unwrap_or_default();
                    bytes.extend(cell.to_le_bytes());
                }
                let probability = (cube.probability * 255.0).round() as u8;
                bytes.extend([probability, cube.level as u8]);
            }
            (bytes.len() / 8, base64(&bytes))
        };
        let [(num_occupied, occupied), (num_free, free)] = [block(occupied), block(free)];
        cells.count = [num_occupied, num_free];
        (cells.occupied, cells.free) = (occupied, free);
        cells
    }
}

impl Cube {
    /// The cell in its middle.
    fn middle(&self) -> VoxelKey {
        let half = (1 << self.level) / 2;
        let [x, y, z] = self.first.map(|cell| cell + half);
        VoxelKey::new(x, y, z)
    }
}

fn within(cell: i32, first: i32) -> Option<u16> {
    u16::try_from(i64::from(cell) - i64::from(first)).ok()
}

/// Cubes of at least this level: smaller ones become the cube that they lie in, with the largest of
/// their probabilities.
fn merged(cubes: &[Cube], level: u32) -> Vec<Cube> {
    let mut large: BTreeMap<[i32; 3], Cube> = BTreeMap::new();
    for cube in cubes {
        let mut grown = *cube;
        if cube.level < level {
            grown.level = level;
            grown.first = cube.first.map(|c| (c >> level) << level);
        }
        let kept = large.entry(grown.first).or_insert(grown);
        kept.probability = kept.probability.max(grown.probability);
        kept.level = kept.level.max(grown.level);
    }
    large.into_values().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_occupancy::MapConfig;

    #[test]
    fn a_cube_is_its_place_its_size_and_its_probability() {
        let mut map = OccupancyMap::new(MapConfig::with_resolution(0.5)).unwrap();
        map.set_log_odds(VoxelKey::new(-3, 2, 7), Some(2.0))
            .unwrap();
        for cell in 0..8 {
            let key = VoxelKey::new(cell & 1, cell >> 1 & 1, cell >> 2);
            map.set_log_odds(key, Some(-1.0)).unwrap();
        }
        let cells = Cells::new(&map, Some(&CellColours::unknown())).unwrap();
        assert_eq!(
            cells.colours,
            Some(base64(&[128; 3])),
            "of one occupied cube"
        );
        assert_eq!(cells.first, [-3, 0, 0]);
        assert_eq!((cells.count, cells.smallest), ([1, 1], 1));
        // 0.88 of 255 and level 0 at (0, 2, 7); 0.27 and level 1 at (3, 0, 0)
        assert_eq!(cells.occupied, base64(&[0, 0, 2, 0, 7, 0, 225, 0]));
        assert_eq!(cells.free, base64(&[3, 0, 0, 0, 0, 0, 69, 1]));
    }

    #[test]
    fn small_cubes_merge_into_the_one_they_lie_in() {
        let cube = |x, probability| Cube {
            first: [x, -1, 0],
            level: 0,
            probability,
        };
        let large = merged(&[cube(0, 0.6), cube(1, 0.9), cube(2, 0.7)], 1);
        let expected = |x, probability| Cube {
            first: [x, -2, 0],
            level: 1,
            probability,
        };
        assert_eq!(large, [expected(0, 0.9), expected(2, 0.7)]);
    }
}
