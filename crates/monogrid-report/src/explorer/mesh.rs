//! A mesh as blocks of integers.

use super::cloud::grid;
use crate::picture::base64;
use crate::surface::{ColouredMesh, Texture, extent};
use monogrid_datasets::encode_jpeg_rgb;
use monogrid_occupancy::SurfaceMesh;
use serde::Serialize;
use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};

/// Triangles on a page at most; of a mesh with more, vertices that lie close together become one.
const MAX_TRIANGLES: usize = 100_000;

/// Quality of the picture as JPEG.
const QUALITY: u8 = 80;

/// Cells along the longest side of a mesh of others, where it is made coarser.
const CELLS_OF_MODEL: f64 = 600.0;

/// A mesh with a colour for every vertex.
#[derive(Clone, Debug, Default, Serialize)]
pub struct PageMesh {
    /// Lower corner.
    pub low: [f64; 3],
    /// Length of a step along each axis.
    pub step: f64,
    /// Whether it is seen from behind too: a surface of ours has only the side that was filmed.
    pub both_sides: bool,
    /// Vertices and triangles.
    pub count: [usize; 2],
    /// Base64 of four little-endian 16-bit integers per vertex: x, y, z in steps from `low`, and
    /// nothing.
    pub vertices: String,
    /// Red, green and blue of each vertex, bytes in base64.
    pub colours: String,
    /// Base64 of three little-endian 32-bit indices per triangle.
    pub triangles: String,
    /// What its faces look like in more detail.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub texture: Option<PageTexture>,
}

/// A picture with a block of pixels for each pair of triangles, row by row.
#[derive(Clone, Debug, Serialize)]
pub struct PageTexture {
    /// Side of a block, px.
    pub block: usize,
    /// Blocks in a row.
    pub columns: usize,
    /// Width and height of the picture, px.
    pub size: [usize; 2],
    /// The picture, JPEG in base64.
    pub image: String,
}

impl PageTexture {
    fn new(texture: &Texture) -> Self {
        Self {
            block: texture.block,
            columns: texture.columns,
            size: [texture.image.width(), texture.image.height()],
            image: base64(&encode_jpeg_rgb(&texture.image, QUALITY)),
        }
    }
}

impl PageMesh {
    /// A mesh of a map with cells of this edge; `None` where there is no surface.
    pub fn new(mesh: &ColouredMesh, edge: f64) -> Option<Self> {
        if mesh.surface.triangles.is_empty() {
            return None;
        }
        let (mut shown, mut grid) = (Cow::Borrowed(mesh), 2.0 * edge);
        while shown.surface.triangles.len() > MAX_TRIANGLES {
            shown = Cow::Owned(clustered(&shown, grid));
            grid *= 1.5;
        }
        Some(packed(&shown))
    }

    /// A mesh of others, of any size and turned either way.
    pub fn of_model(mesh: &ColouredMesh) -> Option<Self> {
        let [low, high] = extent(&mesh.surface.vertices);
        let sides = low.into_iter().zip(high).map(|(low, high)| high - low);
        let longest = f64::from(sides.fold(f32::MIN_POSITIVE, f32::max));
        let shown = Self::new(mesh, longest / CELLS_OF_MODEL)?;
        Some(Self {
            both_sides: true,
            ..shown
        })
    }
}

/// One vertex for each cube of this edge, in the middle of those that lie in it (`[ROSSIGNAC93]`),
/// without normals; triangles within a cube are gone.
fn clustered(mesh: &ColouredMesh, edge: f64) -> ColouredMesh {
    let cube = |vertex: &[f32; 3]| vertex.map(|v| (f64::from(v) / edge).floor() as i64);
    let mut new_of_cube: HashMap<[i64; 3], u32> = HashMap::new();
    let mut sums: Vec<[f64; 7]> = Vec::new();
    let mut new_of = Vec::with_capacity(mesh.colours.len());
    for (vertex, colour) in mesh.surface.vertices.iter().zip(&mesh.colours) {
        let new = *new_of_cube.entry(cube(vertex)).or_insert_with(|| {
            sums.push([0.0; 7]);
            sums.len() as u32 - 1
        });
        let [x, y, z] = vertex.map(f64::from);
        let [red, green, blue] = colour.map(f64::from);
        let parts = [x, y, z, red, green, blue, 1.0];
        for (sum, part) in sums[new as usize].iter_mut().zip(parts) {
            *sum += part;
        }
        new_of.push(new);
    }
    let new = |triangle: &[u32; 3]| triangle.map(|vertex| new_of[vertex as usize]);
    let is_one = |[a, b, c]: &[u32; 3]| a != b && b != c && c != a;
    let triangles = mesh.surface.triangles.iter().map(new).filter(is_one);
    // two walls of a thin one may fall together
    let unique: BTreeMap<[u32; 3], [u32; 3]> = triangles.map(|t| (sorted(t), t)).collect();
    let vertices = sums.iter().map(|s| [0, 1, 2].map(|k| (s[k] / s[6]) as f32));
    let colours = sums.iter();
    let colours = colours.map(|s| [3, 4, 5].map(|k| (s[k] / s[6]).round() as u8));
    ColouredMesh {
        texture: None,
        surface: SurfaceMesh {
            vertices: vertices.collect(),
            triangles: unique.into_values().collect(),
            ..SurfaceMesh::default()
        },
        colours: colours.collect(),
    }
}

fn packed(mesh: &ColouredMesh) -> PageMesh {
    let surface = &mesh.surface;
    let (low, step) = grid([0, 1, 2].map(|axis| {
        let along = surface.vertices.iter().map(|v| f64::from(v[axis]));
        let low = along.clone().fold(f64::INFINITY, f64::min);
        [low, along.fold(f64::NEG_INFINITY, f64::max)]
    }));
    let mut vertices = Vec::with_capacity(8 * surface.vertices.len());
    for vertex in &surface.vertices {
        for (value, low) in vertex.iter().zip(low) {
            let steps = ((f64::from(*value) - low) / step).round() as u16;
            vertices.extend(steps.to_le_bytes());
        }
        vertices.extend([0, 0]);
    }
    let indices = surface.triangles.iter().flatten();
    let triangles: Vec<u8> = indices.flat_map(|i| i.to_le_bytes()).collect();
    PageMesh {
        low,
        step,
        both_sides: false,
        count: [surface.vertices.len(), surface.triangles.len()],
        vertices: base64(&vertices),
        colours: base64(mesh.colours.as_flattened()),
        texture: mesh.texture.as_ref().map(PageTexture::new),
        triangles: base64(&triangles),
    }
}

fn sorted(mut triangle: [u32; 3]) -> [u32; 3] {
    triangle.sort_unstable();
    triangle
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_occupancy::VoxelKey;

    /// A square of so many vertices along a side, one unit apart.
    fn square(side: u32) -> ColouredMesh {
        let vertices = (0..side * side).map(|i| [(i % side) as f32, (i / side) as f32, 0.0]);
        let vertices: Vec<[f32; 3]> = vertices.collect();
        let first = (0..side - 1).flat_map(|y| (0..side - 1).map(move |x| y * side + x));
        ColouredMesh {
            texture: None,
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
        let model = PageMesh::of_model(&square(2)).unwrap();
        assert_eq!((model.both_sides, page.both_sides), (true, false));
        let empty = ColouredMesh {
            texture: None,
            surface: SurfaceMesh::default(),
            colours: Vec::new(),
        };
        assert!(PageMesh::new(&empty, 1.0).is_none());
    }
}
