//! A mesh as blocks of integers.

use crate::picture::base64;
use crate::surface::ColouredMesh;
use serde::Serialize;
use std::collections::{BTreeMap, HashMap};

/// Triangles on a page at most; of a mesh with more, vertices that lie close together become one.
const MAX_TRIANGLES: usize = 100_000;

/// A mesh with a colour for every vertex.
#[derive(Clone, Debug, Default, Serialize)]
pub struct PageMesh {
    /// Lower corner.
    pub low: [f64; 3],
    /// Length of a step along each axis.
    pub step: f64,
    /// Vertices and triangles.
    pub count: [usize; 2],
    /// Base64 of four little-endian 16-bit integers per vertex: x, y, z in steps from `low`, and nothing.
    pub vertices: String,
    /// Red, green and blue of each vertex, bytes in base64.
    pub colours: String,
    /// Base64 of three little-endian 32-bit indices per triangle.
    pub triangles: String,
}

impl PageMesh {
    /// A mesh of a map with cells of this edge; `None` where there is no surface.
    pub fn new(mesh: &ColouredMesh, edge: f64) -> Option<Self> {
        if mesh.surface.triangles.is_empty() {
            return None;
        }
        let mut shown = Shown::all(mesh);
        let mut grid = 2.0 * edge;
        while shown.triangles.len() > MAX_TRIANGLES {
            shown = shown.clustered(grid);
            grid *= 1.5;
        }
        Some(shown.packed())
    }
}

/// What is shown of a mesh.
struct Shown {
    vertices: Vec<[f32; 3]>,
    colours: Vec<[u8; 3]>,
    triangles: Vec<[u32; 3]>,
}

impl Shown {
    fn all(mesh: &ColouredMesh) -> Self {
        Self {
            vertices: mesh.surface.vertices.clone(),
            colours: mesh.colours.clone(),
            triangles: mesh.surface.triangles.clone(),
        }
    }

    /// One vertex for each cube of this edge, in the middle of those that lie in it (Rossignac and Borrel, *Multi-resolution 3D
    /// approximations for rendering complex scenes*, 1993); triangles within a cube are gone.
    fn clustered(&self, edge: f64) -> Self {
        let cube = |vertex: &[f32; 3]| vertex.map(|v| (f64::from(v) / edge).floor() as i64);
        let mut new_of_cube: HashMap<[i64; 3], u32> = HashMap::new();
        let mut sums: Vec<[f64; 7]> = Vec::new();
        let mut new_of = Vec::with_capacity(self.vertices.len());
        for (vertex, colour) in self.vertices.iter().zip(&self.colours) {
            let new = *new_of_cube.entry(cube(vertex)).or_insert_with(|| {
                sums.push([0.0; 7]);
                sums.len() as u32 - 1
            });
            let parts = vertex.iter().map(|v| f64::from(*v));
            let parts = parts
                .chain(colour.iter().map(|v| f64::from(*v)))
                .chain([1.0]);
            for (sum, part) in sums[new as usize].iter_mut().zip(parts) {
                *sum += part;
            }
            new_of.push(new);
        }
        let new = |triangle: &[u32; 3]| triangle.map(|vertex| new_of[vertex as usize]);
        let is_one = |[a, b, c]: &[u32; 3]| a != b && b != c && c != a;
        let triangles = self.triangles.iter().map(new).filter(is_one);
        // two walls of a thin one may fall together
        let unique: BTreeMap<[u32; 3], [u32; 3]> = triangles.map(|t| (sorted(t), t)).collect();
        let vertices = sums.iter().map(|s| [0, 1, 2].map(|k| (s[k] / s[6]) as f32));
        let colours = sums
            .iter()
            .map(|s| [3, 4, 5].map(|k| (s[k] / s[6]).round() as u8));
        Self {
            vertices: vertices.collect(),
            colours: colours.collect(),
            triangles: unique.into_values().collect(),
        }
    }

    fn packed(&self) -> PageMesh {
        let along = |axis: usize| self.vertices.iter().map(move |v| f64::from(v[axis]));
        let low = [0, 1, 2].map(|axis| along(axis).fold(f64::INFINITY, f64::min));
        let high = [0, 1, 2].map(|axis| along(axis).fold(f64::NEG_INFINITY, f64::max));
        let largest = (0..3)
            .map(|axis| high[axis] - low[axis])
            .fold(0.0, f64::max);
        let step = largest.max(1e-6) / f64::from(u16::MAX);
        let mut vertices = Vec::with_capacity(8 * self.vertices.len());
        for vertex in &self.vertices {
            for (value, low) in vertex.iter().zip(low) {
                let steps = ((f64::from(*value) - low) / step).round() as u16;
                vertices.extend(steps.to_le_bytes());
            }
            vertices.extend([0, 0]);
        }
        let indices = self.triangles.iter().flatten();
        let triangles: Vec<u8> = indices.flat_map(|i| i.to_le_bytes()).collect();
        PageMesh {
            low,
            step,
            count: [self.vertices.len(), self.triangles.len()],
            vertices: base64(&vertices),
            colours: base64(self.colours.as_flattened()),
            triangles: base64(&triangles),
        }
    }
}

fn sorted(mut triangle: [u32; 3]) -> [u32; 3] {
    triangle.sort_unstable();
    triangle
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_occupancy::{SurfaceMesh, VoxelKey};

    /// A square of so many vertices along a side, one unit apart.
    fn square(side: u32) -> ColouredMesh {
        let vertices = (0..side * side).map(|i| [(i % side) as f32, (i / side) as f32, 0.0]);
        let vertices: Vec<[f32; 3]> = vertices.collect();
        let first = (0..side - 1).flat_map(|y| (0..side - 1).map(move |x| y * side + x));
        ColouredMesh {
            colours: vec![[1, 2, 3]; vertices.len()],
            surface: SurfaceMesh {
                normals: vec![[0.0, 0.0, 1.0]; vertices.len()],
                cubes: vec![VoxelKey::new(0, 0, 0); vertices.len()],
                triangles: first
                    .flat_map(|i| [[i, i + 1, i + side], [i + 1, i + side + 1, i + side]])
                    .collect(),
                vertices,
            },
        }
    }

    #[test]
    fn vertices_keep_their_places_and_large_meshes_become_coarser() {
        let page = PageMesh::new(&square(2), 1.0).unwrap();
        assert_eq!((page.count, page.low), ([4, 2], [0.0; 3]));
        let corner = [255, 255, 255, 255, 0, 0, 0, 0];
        let expected = [
            [0; 8],
            [255, 255, 0, 0, 0, 0, 0, 0],
            [0, 0, 255, 255, 0, 0, 0, 0],
            corner,
        ];
        assert_eq!(page.vertices, base64(expected.as_flattened()));
        let large = PageMesh::new(&square(400), 1.0).unwrap();
        let [vertices, triangles] = large.count;
        assert_eq!(vertices, 200 * 200);
        assert!(
            triangles > 70_000 && triangles <= MAX_TRIANGLES,
            "{triangles}"
        );
        let empty = ColouredMesh {
            surface: SurfaceMesh::default(),
            colours: Vec::new(),
        };
        assert!(PageMesh::new(&empty, 1.0).is_none());
    }
}
