//! The surface between occupied and free cells as triangles.
//!
//! Surface nets (Gibson, *Constrained elastic surface nets*, MICCAI 1998) over the centres of
//! cells: a vertex for every cube of eight centres that the surface passes through, in the middle
//! of the places where log-odds cross the threshold on its edges, and two triangles around every
//! edge that is crossed. What lies behind a surface is unknown, so the back of a wall that nobody
//! has seen is no surface.

use std::collections::HashMap;

use crate::error::MapError;
use crate::evidence::{Occupancy, log_odds_from_probability};
use crate::key::VoxelKey;
use crate::map::OccupancyMap;

/// Triangles with the vertices that they share; seen from free space they are counter-clockwise.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SurfaceMesh {
    /// Places in map units, each within a cell of the surface that it stands for.
    pub vertices: Vec<[f32; 3]>,
    /// Unit normals of the vertices, towards free space.
    pub normals: Vec<[f32; 3]>,
    /// Of the cube of eight cells that each vertex lies in, the one with the smallest key.
    pub cubes: Vec<VoxelKey>,
    /// Indices of vertices.
    pub triangles: Vec<[u32; 3]>,
}

/// Memory of a face while a surface is made: its vertex (there are about as many) twice, with its
/// place among them, and its corners.
const BYTES_PER_FACE: usize = 200;

impl OccupancyMap {
    /// The surface between occupied and free cells, without pieces that hang together by fewer than
    /// `min_faces` faces of cells: these are mostly false measurements in free space. 0 keeps all.
    ///
    /// # Errors
    /// Map and surface together need more than the memory budget of the map.
    pub fn surface_mesh(&self, min_faces: usize) -> Result<SurfaceMesh, MapError> {
        let map_bytes = self.bytes_in_memory();
        let mut net = Net {
            map: self,
            threshold: log_odds_from_probability(self.config().occupancy_threshold) as f32,
            index: HashMap::new(),
            mesh: SurfaceMesh::default(),
        };
        let mut quads = Vec::new();
        for cell in self.cells() {
            if cell.state == Occupancy::Occupied {
                net.faces_of(cell.key, &mut quads);
                self.check_bytes(map_bytes + BYTES_PER_FACE * quads.len())?;
            }
        }
        let kept = large_pieces(net.mesh.vertices.len(), &quads, min_faces);
        Ok(net.mesh.with_faces(&kept))
    }
}

/// The vertices that were made so far.
struct Net<'a> {
    map: &'a OccupancyMap,
    threshold: f32,
    index: HashMap<VoxelKey, u32>,
    mesh: SurfaceMesh,
}

impl Net<'_> {
    /// The faces between an occupied cell and free ones, as four vertices each.
    fn faces_of(&mut self, cell: VoxelKey, quads: &mut Vec<[u32; 4]>) {
        for axis in 0..3 {
            for side in [-1, 1] {
                let beside = cell.along(axis, side);
                if self.map.state_of(beside) != Occupancy::Free {
                    continue;
                }
                let low = if side < 0 { beside } else { cell };
                let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                // once around the edge between the two centres
                let mut around = [[-1, -1], [0, -1], [0, 0], [-1, 0]];
                if side < 0 {
                    around.reverse();
                }
                quads.push(around.map(|[du, dv]| self.vertex(low.along(u, du).along(v, dv))));
            }
        }
    }

    /// The vertex in the cube of eight cells that begins with this one.
    fn vertex(&mut self, cube: VoxelKey) -> u32 {
        if let Some(index) = self.index.get(&cube) {
            return *index;
        }
        let index = self.mesh.vertices.len() as u32;
        self.index.insert(cube, index);
        let middle = self.middle_of_crossings(cube);
        let first = cube.center(self.map.resolution());
        self.mesh.vertices.push(std::array::from_fn(|axis| {
            (first[axis] + middle[axis] * self.map.resolution()) as f32
        }));
        self.mesh.cubes.push(cube);
        index
    }

    /// Where the edges of a cube between occupied and free centres are crossed, on average, in
    /// cells from its first centre.
    fn middle_of_crossings(&self, cube: VoxelKey) -> [f64; 3] {
        let corner = |i: usize| [i & 1, i >> 1 & 1, i >> 2].map(|bit| bit as i32);
        let values: [Option<f32>; 8] = std::array::from_fn(|i| {
            let log_odds = self.map.log_odds_of(cube.moved(corner(i)));
            log_odds.map(|value| value - self.threshold)
        });
        let (mut sum, mut count) = ([0.0; 3], 0.0);
        for (i, axis) in (0..8).flat_map(|i| (0..3).map(move |axis| (i, axis))) {
            let j = i | 1 << axis;
            let (Some(a), Some(b)) = (values[i], values[j]) else {
                continue;
            };
            // the threshold itself is occupied
            if i == j || (a >= 0.0) == (b >= 0.0) {
                continue;
            }
            let mut crossing = corner(i).map(f64::from);
            crossing[axis] += f64::from(a / (a - b));
            for (sum, value) in sum.iter_mut().zip(crossing) {
                *sum += value;
            }
            count += 1.0;
        }
        sum.map(|sum| sum / f64::max(count, 1.0))
    }
}

impl SurfaceMesh {
    /// Only the vertices of these faces, with two triangles for each of them.
    fn with_faces(&self, quads: &[[u32; 4]]) -> Self {
        let mut mesh = Self::default();
        let mut new_of = vec![u32::MAX; self.vertices.len()];
        for quad in quads {
            let [a, b, c, d] = quad.map(|old| {
                let new = &mut new_of[old as usize];
                if *new == u32::MAX {
                    *new = mesh.vertices.len() as u32;
                    mesh.vertices.push(self.vertices[old as usize]);
                    mesh.cubes.push(self.cubes[old as usize]);
                }
                *new
            });
            mesh.triangles.extend([[a, b, c], [a, c, d]]);
        }
        mesh.turn_normals();
        mesh
    }

    /// Makes the normals those of the triangles again, after vertices have moved.
    pub fn turn_normals(&mut self) {
        self.normals = self.vertex_normals();
    }

    /// Means of the normals of the triangles around each vertex, weighted by their areas.
    fn vertex_normals(&self) -> Vec<[f32; 3]> {
        let mut sums = vec![[0.0f32; 3]; self.vertices.len()];
        for triangle in &self.triangles {
            let [a, b, c] = triangle.map(|i| self.vertices[i as usize]);
            let edge = |to: [f32; 3]| -> [f32; 3] { std::array::from_fn(|k| to[k] - a[k]) };
            let normal = cross(edge(b), edge(c));
            for &vertex in triangle {
                for (sum, part) in sums[vertex as usize].iter_mut().zip(normal) {
                    *sum += part;
                }
            }
        }
        let unit = |sum: [f32; 3]| {
            let length = sum.iter().map(|v| v * v).sum::<f32>().sqrt();
            if length > 0.0 {
                sum.map(|v| v / length)
            } else {
                [0.0, 0.0, 1.0]
            }
        };
        sums.into_iter().map(unit).collect()
    }
}

/// The faces of pieces with at least so many.
fn large_pieces(num_vertices: usize, quads: &[[u32; 4]], min_faces: usize) -> Vec<[u32; 4]> {
    let mut pieces = Pieces((0..num_vertices as u32).collect());
    for quad in quads {
        quad.iter().for_each(|vertex| pieces.join(quad[0], *vertex));
    }
    let mut faces = vec![0usize; num_vertices];
    for quad in quads {
        faces[pieces.root(quad[0]) as usize] += 1;
    }
    let is_large = |quad: &&[u32; 4]| faces[pieces.root(quad[0]) as usize] >= min_faces;
    quads.iter().filter(is_large).copied().collect()
}

/// Disjoint sets of vertices: each points towards the first of its set.
struct Pieces(Vec<u32>);

impl Pieces {
    fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.0[a.max(b) as usize] = a.min(b);
    }

    /// The root; the way there becomes half as long.
    fn root(&mut self, mut vertex: u32) -> u32 {
        while self.0[vertex as usize] != vertex {
            let next = self.0[vertex as usize];
            self.0[vertex as usize] = self.0[next as usize];
            vertex = next;
        }
        vertex
    }
}

fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}
