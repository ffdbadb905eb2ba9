//! Which colour a cell has: the mean of what the keyframes saw in it.

use super::Texture;
use crate::colours::Colours;
use crate::explorer::Look;
use monogrid_geometry::{Sim3, Vec2};
use monogrid_mapping::{ImageOf, KeyframeScan, MeshConfig};
use monogrid_occupancy::{MapError, OccupancyMap, SurfaceMesh, VoxelKey};
use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};
use std::ops::RangeInclusive;

/// Measurements that are looked at, at most; of more, they are taken evenly.
const MAX_POINTS: usize = 3_000_000;

/// Measurements of a cell that count: their sums fit 16 bits.
const MAX_PER_CELL: u16 = 255;

/// The colour of what nobody has seen.
const UNKNOWN: [u8; 3] = [128; 3];

/// A keyframe whose measurements have colours.
#[derive(Clone, Copy, Debug)]
pub struct ColouredScan<'a> {
    /// What of it is mapped.
    pub scan: &'a KeyframeScan,
    /// Its grey image.
    pub image: Option<ImageOf<'a>>,
    /// Pose in the frame of the map.
    pub map_from_keyframe: Sim3,
}

/// Mean colours of cells; only ever asked by key.
#[derive(Clone, Debug)]
pub struct CellColours {
    /// Sums of red, green and blue, and the number of measurements, of which the first are enough.
    sums: HashMap<VoxelKey, [u16; 4], BuildHasherDefault<CellHasher>>,
    /// Whether any of them was seen in colour, not only in grey.
    pub has_colour: bool,
}

/// Nobody chooses cells so that they collide, and each vertex asks for eight of them and more.
#[derive(Clone, Copy, Debug, Default)]
struct CellHasher(u64);

impl Hasher for CellHasher {
    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|byte| self.write_i32((*byte).into()));
    }

    fn write_i32(&mut self, index: i32) {
        let mixed = self.0.rotate_left(29) ^ u64::from(index as u32);
        self.0 = mixed.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    }

    fn finish(&self) -> u64 {
        self.0 ^ self.0 >> 32
    }
}

/// The surface of a map with a colour for every vertex.
#[derive(Clone, Debug)]
pub struct ColouredMesh {
    /// Vertices and triangles.
    pub surface: SurfaceMesh,
    /// Red, green and blue of each vertex.
    pub colours: Vec<[u8; 3]>,
    /// What it looks like in more detail, where that is known.
    pub texture: Option<Texture>,
}

impl ColouredMesh {
    /// The colour of a place in a triangle, given by the shares of its corners.
    pub fn colour_at(&self, triangle: usize, shares: [f64; 3]) -> [u8; 3] {
        let mix = |values: [[f64; 3]; 3]| {
            [0, 1, 2].map(|k| {
                (0..3)
                    .map(|corner| shares[corner] * values[corner][k])
                    .sum::<f64>()
            })
        };
        let corners = self.surface.triangles[triangle];
        match &self.texture {
            Some(texture) => {
                let [a, b, c, d] = texture.corners(triangle / 2).map(|[u, v]| [u, v, 0.0]);
                let second = triangle % 2 == 1;
                let [u, v, _] = mix(if second { [a, c, d] } else { [a, b, c] });
                let image = &texture.image;
                let pixel =
                    |share: f64, side: usize| ((share * side as f64) as usize).min(side - 1);
                image.at(pixel(u, image.width()), pixel(v, image.height()))
            }
            None => {
                let colour = |i: u32| self.colours.get(i as usize).copied().unwrap_or(UNKNOWN);
                mix(corners.map(|i| colour(i).map(f64::from))).map(|value| value.round() as u8)
            }
        }
    }
}

impl CellColours {
    /// Nothing is known: all is of a middle grey.
    pub fn unknown() -> Self {
        Self {
            sums: HashMap::default(),
            has_colour: false,
        }
    }

    /// What keyframes measured, in cells of a map with this edge.
    pub fn new(scans: &[ColouredScan], colours: &Colours, resolution: f64) -> Self {
        let measured: usize = scans.iter().map(|shown| shown.scan.num_pixels).sum();
        let every = measured.div_ceil(MAX_POINTS).max(1);
        let mut found = Self::unknown();
        for shown in scans {
            let camera = &shown.scan.camera;
            let look = Look::of(shown.scan.id, shown.image, colours);
            found.has_colour |= matches!(look, Look::Colour(_));
            for pixel in shown.scan.pixels().iter().step_by(every) {
                let at = Vec2::new(pixel.x.into(), pixel.y.into());
                let ray = camera.pinhole.unproject(&at);
                let point = shown.map_from_keyframe * (ray / f64::from(pixel.idepth));
                if let Some(key) = VoxelKey::from_point(point.into(), 1.0 / resolution) {
                    found.add(key, look.at(pixel.x.into(), pixel.y.into()));
                }
            }
        }
        found
    }

    fn add(&mut self, key: VoxelKey, colour: [u8; 3]) {
        let sums = self.sums.entry(key).or_default();
        if sums[3] == MAX_PER_CELL {
            return;
        }
        for (sum, value) in sums.iter_mut().zip(colour.into_iter().chain([1])) {
            *sum += u16::from(value);
        }
    }

    /// The mean colour of a cell; where nothing was measured in it, of those beside it.
    pub fn of(&self, cell: VoxelKey) -> [u8; 3] {
        self.mean(cell, [0..=0, -1..=1])
    }

    /// The mean colour of the eight cells that begin with this one; where nothing was measured in
    /// them, of those around.
    fn around(&self, cube: VoxelKey) -> [u8; 3] {
        self.mean(cube, [0..=1, -1..=2])
    }

    /// The mean of what was measured in the cells so far away along each axis, of the first reach
    /// in which something was.
    fn mean(&self, cell: VoxelKey, reaches: [RangeInclusive<i32>; 2]) -> [u8; 3] {
        for reach in reaches {
            let mut sums = [0_u32; 4];
            for (x, y, z) in offsets(reach) {
                let key = VoxelKey::new(cell.x + x, cell.y + y, cell.z + z);
                for (sum, value) in sums.iter_mut().zip(self.sums.get(&key).unwrap_or(&[0; 4])) {
                    *sum += u32::from(*value);
                }
            }
            let [red, green, blue, count] = sums;
            if count > 0 {
                return [red, green, blue].map(|sum| ((sum + count / 2) / count) as u8);
            }
        }
        UNKNOWN
    }

    /// The surface of a map in these colours.
    pub fn mesh(&self, map: &OccupancyMap, config: &MeshConfig) -> Result<ColouredMesh, MapError> {
        let surface = map.surface_mesh(config.min_faces)?;
        let colours = surface.cubes.iter().map(|cube| self.around(*cube));
        Ok(ColouredMesh {
            colours: colours.collect(),
            surface,
            texture: None,
        })
    }
}

fn offsets(reach: RangeInclusive<i32>) -> impl Iterator<Item = (i32, i32, i32)> {
    let (low, high) = (*reach.start(), *reach.end());
    reach.flat_map(move |x| (low..=high).flat_map(move |y| (low..=high).map(move |z| (x, y, z))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_vertex_has_the_mean_colour_of_the_cells_around() {
        let mut colours = CellColours::unknown();
        assert_eq!(colours.around(VoxelKey::new(0, 0, 0)), [128; 3]);
        colours.add(VoxelKey::new(1, 1, 0), [10, 20, 30]);
        colours.add(VoxelKey::new(1, 1, 0), [20, 20, 30]);
        colours.add(VoxelKey::new(0, 0, 0), [30, 20, 255]);
        assert_eq!(colours.around(VoxelKey::new(0, 0, 0)), [20, 20, 105]);
        assert_eq!(
            colours.around(VoxelKey::new(2, 1, 0)),
            [15, 20, 30],
            "beside it"
        );
        assert_eq!(colours.around(VoxelKey::new(9, 1, 0)), [128; 3]);
        assert_eq!(colours.of(VoxelKey::new(1, 1, 0)), [15, 20, 30]);
        assert_eq!(
            colours.of(VoxelKey::new(2, 2, 0)),
            [15, 20, 30],
            "beside it"
        );
    }
}
