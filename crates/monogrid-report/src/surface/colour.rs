//! What the keyframes measured in a cell: its mean colour, and the mean place, which says where the
//! surface is more exactly than the evidence of cells does.

use super::Texture;
use crate::colours::Colours;
use crate::explorer::Look;
use monogrid_geometry::{Sim3, Vec2, Vec3};
use monogrid_mapping::{ImageOf, KeyframeScan, MeshConfig};
use monogrid_occupancy::{MapError, OccupancyMap, SurfaceMesh, VoxelKey};
use rayon::prelude::*;
use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};
use std::ops::RangeInclusive;

/// Measurements that are looked at, at most; of more, they are taken evenly.
const MAX_POINTS: usize = 3_000_000;

/// Measurements of a cell whose colours count: their sums fit 16 bits.
const MAX_PER_CELL: u16 = 255;

/// How far measurements may be from a vertex along its normal, and how far beside it they count,
/// cells.
const ALONG: f64 = 1.5;
const BESIDE: f64 = 0.75;
/// No measurement is surer than this, cells squared.
const LEAST_VARIANCE: f64 = 0.01;
/// Times that vertices are moved to what was measured.
const ROUNDS: usize = 2;

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

/// Mean colours of cells and places in them; only ever asked by key.
#[derive(Clone, Debug)]
pub struct CellColours {
    sums: HashMap<VoxelKey, Sums, BuildHasherDefault<CellHasher>>,
    /// Edge of a cell.
    edge: f64,
    /// Whether any of them was seen in colour, not only in grey.
    pub has_colour: bool,
}

/// What was measured in a cell.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    /// Red, green and blue, and their number, of which the first are enough.
    colours: [u16; 4],
    /// Places from the centre of the cell, in cells, each times its weight, and the weights.
    places: [f32; 4],
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
            edge: 1.0,
            has_colour: false,
        }
    }

    /// What keyframes measured, in cells of a map with this edge.
    pub fn new(scans: &[ColouredScan], colours: &Colours, resolution: f64) -> Self {
        let measured: usize = scans.iter().map(|shown| shown.scan.num_pixels).sum();
        let every = measured.div_ceil(MAX_POINTS).max(1);
        let mut found = Self {
            edge: resolution,
            ..Self::unknown()
        };
        for shown in scans {
            let camera = &shown.scan.camera;
            let look = Look::of(shown.scan.id, shown.image, colours);
            found.has_colour |= matches!(look, Look::Colour(_));
            for pixel in shown.scan.pixels().iter().step_by(every) {
                let at = Vec2::new(pixel.x.into(), pixel.y.into());
                let ray = camera.pinhole.unproject(&at);
                let depth = 1.0 / f64::from(pixel.idepth);
                let point = shown.map_from_keyframe * (ray * depth);
                let sigma =
                    shown.map_from_keyframe.scale * depth.powi(2) * f64::from(pixel.sigma_idepth)
                        / resolution;
                if let Some(key) = VoxelKey::from_point(point.into(), 1.0 / resolution) {
                    let sums = found.sums.entry(key).or_default();
                    sums.add_colour(look.at(pixel.x.into(), pixel.y.into()));
                    let centre = Vec3::from(key.center(resolution));
                    sums.add_place((point - centre) / resolution, sigma);
                }
            }
        }
        found
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
                let found = self.sums.get(&key).map_or([0; 4], |found| found.colours);
                for (sum, value) in sums.iter_mut().zip(found) {
                    *sum += u32::from(value);
                }
            }
            let [red, green, blue, count] = sums;
            if count > 0 {
                return [red, green, blue].map(|sum| ((sum + count / 2) / count) as u8);
            }
        }
        UNKNOWN
    }

    /// The surface of a map in these colours, where it was measured.
    pub fn mesh(&self, map: &OccupancyMap, config: &MeshConfig) -> Result<ColouredMesh, MapError> {
        let mut surface = map.surface_mesh(config.min_faces)?;
        for _ in 0..ROUNDS {
            let places = surface.vertices.par_iter().zip(&surface.normals);
            let places = places.zip(&surface.cubes);
            let moved = places.map(|((vertex, normal), cube)| self.measured(vertex, normal, *cube));
            surface.vertices = moved.collect();
            surface.turn_normals();
        }
        let colours = surface.cubes.iter().map(|cube| self.around(*cube));
        Ok(ColouredMesh {
            colours: colours.collect(),
            surface,
            texture: None,
        })
    }

    /// A vertex moved along its normal to the mean of what was measured around it.
    fn measured(&self, vertex: &[f32; 3], normal: &[f32; 3], cube: VoxelKey) -> [f32; 3] {
        let [place, normal] = [vertex, normal].map(|v| Vec3::from(v.map(f64::from)));
        let (mut sum, mut weights) = (0.0, 0.0);
        for (x, y, z) in offsets(-1..=2) {
            let key = VoxelKey::new(cube.x + x, cube.y + y, cube.z + z);
            let Some(found) = self.sums.get(&key) else {
                continue;
            };
            let [x, y, z, weight] = found.places.map(f64::from);
            let mean = Vec3::from(key.center(self.edge)) - place;
            let mean = mean / self.edge + Vec3::new(x, y, z) / weight;
            let along = mean.dot(&normal);
            if along.abs() < ALONG {
                let beside = (mean - normal * along).norm_squared();
                let weight = weight * (-0.5 * beside / (BESIDE * BESIDE)).exp();
                sum += weight * along;
                weights += weight;
            }
        }
        if weights == 0.0 {
            return *vertex;
        }
        (place + normal * (sum / weights * self.edge))
            .map(|v| v as f32)
            .into()
    }
}

impl Sums {
    fn add_colour(&mut self, colour: [u8; 3]) {
        if self.colours[3] < MAX_PER_CELL {
            for (sum, value) in self.colours.iter_mut().zip(colour.into_iter().chain([1])) {
                *sum += u16::from(value);
            }
        }
    }

    /// A place whose error along the ray is `sigma` cells.
    fn add_place(&mut self, place: Vec3, sigma: f64) {
        let weight = 1.0 / (sigma * sigma + LEAST_VARIANCE);
        let values = [place.x, place.y, place.z, 1.0];
        for (sum, value) in self.places.iter_mut().zip(values) {
            *sum += (weight * value) as f32;
        }
    }
}

fn offsets(reach: RangeInclusive<i32>) -> impl Iterator<Item = (i32, i32, i32)> {
    let (low, high) = (*reach.start(), *reach.end());
    reach.flat_map(move |x| (low..=high).flat_map(move |y| (low..=high).map(move |z| (x, y, z))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_occupancy::MapConfig;

    fn add(colours: &mut CellColours, [x, y, z]: [i32; 3], colour: [u8; 3]) {
        let sums = colours.sums.entry(VoxelKey::new(x, y, z)).or_default();
        sums.add_colour(colour);
    }

    /// A floor of cells of half a metre, measured 0.1 m below their centres.
    #[test]
    fn the_surface_is_where_it_was_measured() {
        let mut map = OccupancyMap::new(MapConfig::with_resolution(0.5)).unwrap();
        let mut measured = CellColours {
            edge: 0.5,
            ..CellColours::unknown()
        };
        for (x, y) in (0..8).flat_map(|x| (0..8).map(move |y| (x, y))) {
            for (z, log_odds) in [(0, 2.0), (1, -1.0)] {
                let key = VoxelKey::new(x, y, z);
                map.set_log_odds(key, Some(log_odds)).unwrap();
            }
            let sums = measured.sums.entry(VoxelKey::new(x, y, 0)).or_default();
            sums.add_place(Vec3::new(0.0, 0.0, -0.2), 0.1);
        }
        let config = MeshConfig {
            min_faces: 0,
            ..MeshConfig::default()
        };
        let heights = |of: &CellColours| -> Vec<f32> {
            let mesh = of.mesh(&map, &config).unwrap();
            mesh.surface.vertices.iter().map(|v| v[2]).collect()
        };
        let at = |height: f32| move |z: &f32| (z - height).abs() < 1e-3;
        assert!(heights(&CellColours::unknown()).iter().all(|z| *z > 0.5));
        assert!(
            heights(&measured).iter().all(at(0.15)),
            "{:?}",
            heights(&measured)
        );
    }

    #[test]
    fn a_vertex_has_the_mean_colour_of_the_cells_around() {
        let mut colours = CellColours::unknown();
        assert_eq!(colours.around(VoxelKey::new(0, 0, 0)), [128; 3]);
        add(&mut colours, [1, 1, 0], [10, 20, 30]);
        add(&mut colours, [1, 1, 0], [20, 20, 30]);
        add(&mut colours, [0, 0, 0], [30, 20, 255]);
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
