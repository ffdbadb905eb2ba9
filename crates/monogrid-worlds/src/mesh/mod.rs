//! Meshes of others as worlds: `.obj` with `.mtl` and textures, `.ply` and `.glb` with vertex
//! colours; and clouds, `.ply` and `.pcd`.

mod glb;
mod light;
mod obj;
mod pcd;
mod ply;
mod stl;

use super::bvh::{Bvh, P3, Triangle};
use super::scene::Material;
use super::texture::Texture;
use super::triangle_mesh::TriangleMesh;
use super::world::{Light, Shading, Texels, World};
use light::vertex_light;
use monogrid_datasets::DatasetError;
use monogrid_image::{GrayImage, Resize, resize_area};
use std::path::Path;

pub use glb::read_picture;
pub use ply::read_ply;

/// A mesh with what it is covered with.
#[derive(Clone, Debug, Default)]
pub struct MeshModel {
    /// Geometry, and reflectance per vertex (empty: 1).
    pub mesh: TriangleMesh,
    /// Materials; empty: one grey material, or white where vertices have reflectance.
    pub materials: Vec<Material>,
    /// Material of each triangle; empty when there is at most one.
    pub material_of: Vec<u32>,
    /// Texture coordinates of the three corners of each triangle, in tiles, `v` running down; empty
    /// without textures.
    pub corner_uv: Vec<[[f32; 2]; 3]>,
    /// Vertices of the file that have no place (a coordinate is not finite) and were left out, with
    /// the faces at them.
    pub left_out: usize,
}

/// How a mesh is lit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum MeshLighting {
    /// By an even sky: directions matter, and corners are darker (ambient occlusion).
    #[default]
    Shaded,
    /// Not at all: colours are shown as they are (scans, which hold their light already).
    AsColoured,
}

/// Triangles that a ray may be compared with, on average. Rooms need a few dozen, however many
/// triangles they have; a small file of triangles in one another would take hours.
const MAX_TESTS_PER_RAY: f32 = 1000.0;

/// Reflectance of surfaces without any information.
const UNKNOWN_ALBEDO: f32 = 0.5;

impl World {
    /// A mesh as a world; `None` where so many of its triangles lie in one another that a ray would
    /// be compared with more than `max_tests` of them.
    pub(crate) fn from_model(
        name: &str,
        model: &MeshModel,
        lighting: MeshLighting,
        max_tests: f32,
    ) -> Option<Self> {
        let mesh = &model.mesh;
        let triangle = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|k| P3::from(mesh.vertices[k as usize]));
            Triangle::new(a, b, c)
        };
        let triangles = mesh.triangles.iter().map(triangle).enumerate();
        // triangles without area cannot be seen, and have no normal
        let (used, triangles): (Vec<usize>, Vec<Triangle>) = triangles
            .filter(|(_, triangle)| triangle.scaled_normal().norm() > 0.0)
            .unzip();
        let bvh = Bvh::new(&triangles);
        if bvh.tests_per_ray() > max_tests {
            return None;
        }
        let light = vertex_light(mesh, &bvh, lighting);
        let materials = model.all_materials();
        let shading = bvh.ids.iter().zip(&bvh.triangles).map(|(&id, triangle)| {
            mesh_shading(model, &materials, &light, used[id as usize], triangle)
        });
        let shading = shading.collect();
        Some(Self::unlit(name, bvh, shading, materials))
    }

    /// A mesh file as a world, by its extension (`.obj`, `.ply`, `.glb`).
    ///
    /// # Errors
    /// When the file, its materials or its textures cannot be read, or most of its triangles lie in
    /// one another.
    pub fn from_file(path: &Path, lighting: MeshLighting) -> Result<Self, DatasetError> {
        let model = MeshModel::read(path)?;
        let name = path
            .file_stem()
            .map_or_else(|| "mesh".into(), |s| s.to_string_lossy());
        let world = Self::from_model(&name, &model, lighting, MAX_TESTS_PER_RAY);
        world.ok_or_else(|| {
            let found = "triangles that lie in one another";
            DatasetError::content(path, found, "a surface, as scans and models have it")
        })
    }
}

/// Shading of one triangle of a mesh.
fn mesh_shading(
    model: &MeshModel,
    materials: &[Material],
    light: &[f32],
    index: usize,
    triangle: &Triangle,
) -> Shading {
    let corners = model.mesh.triangles[index];
    let material = model.material(index);
    let at = |values: &[f32]| corners.map(|k| values.get(k as usize).copied().unwrap_or(1.0));
    let scaled_normal = triangle.scaled_normal();
    let area2 = scaled_normal.norm();
    let mut shading = Shading {
        material,
        light: Light::Vertices(at(light)),
        texels: Texels::default(),
        texels_per_m: 0.0,
        normal: scaled_normal / area2,
        tint: at(&model.mesh.albedo),
    };
    let texture = materials[material as usize].texture.as_ref();
    if let (Some((texture, _)), Some(uv)) = (texture, model.corner_uv.get(index)) {
        let (width, height) = texture.size();
        let in_texels = |[u, v]: [f32; 2]| [u * width as f32, v * height as f32];
        shading.texels = Texels::of_corners(uv.map(in_texels));
        shading.texels_per_m = shading.texels.per_m(area2);
    }
    shading
}

impl MeshModel {
    /// Reads a mesh file or a cloud, by its extension (`.obj`, `.ply`, `.stl`,
    /// `.glb`, `.pcd`).
    ///
    /// # Errors
    /// When the file, its materials or its textures cannot be read.
    pub fn read(path: &Path) -> Result<Self, DatasetError> {
        let extension = path
            .extension()
            .map(|e| e.to_string_lossy().to_ascii_lowercase());
        match extension.as_deref() {
            Some("obj") => obj::read(path),
            Some("glb") => glb::read(path),
            Some(kind @ ("ply" | "pcd" | "stl")) => {
                let (mesh, left_out) = match kind {
                    "ply" => ply::read_counted(path)?,
                    "stl" => stl::read_counted(path)?,
                    _ => pcd::read_counted(path)?,
                };
                Ok(Self {
                    mesh,
                    left_out,
                    ..Self::default()
                })
            }
            _ => {
                let expected = "a mesh or a cloud: .obj, .ply, .stl, .glb or .pcd";
                Err(DatasetError::content(path, "another extension", expected))
            }
        }
    }

    /// The material of a triangle; the default one where none is given.
    pub(super) fn material(&self, triangle: usize) -> u32 {
        let id = self.material_of.get(triangle).copied().unwrap_or(0);
        id.min(self.materials.len().saturating_sub(1) as u32)
    }

    /// The materials, at least one.
    pub(super) fn all_materials(&self) -> Vec<Material> {
        if !self.materials.is_empty() {
            return self.materials.clone();
        }
        let has_colours = !self.mesh.albedo.is_empty();
        vec![Material::plain(if has_colours {
            1.0
        } else {
            UNKNOWN_ALBEDO
        })]
    }
}

impl TriangleMesh {
    /// The colour of the next vertex: red, green and blue in [0, 255], as displayed.
    fn add_colour(&mut self, colour: [f32; 3]) {
        let grey = luma(colour.map(f64::from));
        self.albedo.push(albedo_of_grey(grey as f32));
        self.colours.push(colour.map(|value| value.round() as u8));
    }
}

/// Reflectance of an 8-bit grey value (gamma 2.2).
fn albedo_of_grey(grey: f32) -> f32 {
    (grey / 255.0).clamp(0.0, 1.0).powf(2.2)
}

/// ITU-601 luma.
fn luma([r, g, b]: [f64; 3]) -> f64 {
    0.299 * r + 0.587 * g + 0.114 * b
}

/// Luma of linear light.
fn linear_luma(colour: [f32; 3]) -> f32 {
    luma(colour.map(f64::from)) as f32
}

/// Sides of textures at most, texels.
const MAX_TEXTURE_LOG2: u32 = 12;

/// A material covered with a picture that corner coordinates place: resampled to powers of two,
/// grey values to reflectance.
fn textured(image: &GrayImage) -> Material {
    let log2 = |n: usize| {
        let exponent = (n.max(1) as f32).log2().round();
        exponent.clamp(0.0, MAX_TEXTURE_LOG2 as f32) as u32
    };
    let (w, h) = (log2(image.width()), log2(image.height()));
    // area averaging only shrinks: enlarge by bilinear sampling in the texture's own function
    let size = Resize {
        width: image.width().min(1 << w),
        height: image.height().min(1 << h),
    };
    let small = resize_area(image, size);
    let (sw, sh) = (small.width() as f32, small.height() as f32);
    Material::fitted(Texture::from_fn(w, h, |u, v| {
        let x = (u * sw - 0.5).clamp(0.0, sw - 1.0);
        let y = (v * sh - 0.5).clamp(0.0, sh - 1.0);
        albedo_of_grey(monogrid_image::bilinear(&small, x, y).unwrap_or(0.0))
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{LightingConfig, write_ply};

    #[test]
    fn a_written_world_is_read_back_as_the_same_mesh() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("room.ply");
        let world = crate::World::by_name_with("living-room", &LightingConfig::quick()).unwrap();
        let mesh = world.mesh();
        write_ply(&path, &mesh).unwrap();
        let read = read_ply(&path).unwrap();
        assert_eq!(read.vertices, mesh.vertices);
        assert_eq!(read.triangles, mesh.triangles);
        for (a, b) in read.albedo.iter().zip(&mesh.albedo) {
            assert!((a - b).abs() < 0.02, "{a} {b}");
        }
    }

    #[test]
    fn obj_faces_of_all_forms_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("m.obj");
        std::fs::write(
            folder.path().join("m.mtl"),
            "newmtl a\nKd 0.5 0.5 0.5\nnewmtl b\nKd 1 0 0\n",
        )
        .unwrap();
        let text = "# test\nmtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 \
            1\nvn 0 0 1\nusemtl a\nf 1 2 3 4\nusemtl b\nf -4/1 -3/2 -2/3\nf 1/1/1 2/2/1 4/3/1\nf \
            1//1 3//1 4//1\n";
        std::fs::write(&path, text).unwrap();
        let model = MeshModel::read(&path).unwrap();
        let square = [
            [0.0, 0.0, 0.0],
            [1.0, 0.0, 0.0],
            [1.0, 1.0, 0.0],
            [0.0, 1.0, 0.0],
        ];
        let expected = [[0, 1, 2], [0, 2, 3], [0, 1, 2], [0, 1, 3], [0, 2, 3]];
        for (found, expected) in model.mesh.triangles.iter().zip(expected) {
            let corners = found.map(|corner| model.mesh.vertices[corner as usize]);
            assert_eq!(corners, expected.map(|corner: usize| square[corner]));
        }
        assert_eq!(model.mesh.triangles.len(), expected.len());
        assert_eq!(model.material_of, [0, 0, 1, 1, 1]);
        assert!((model.materials[0].albedo - 0.5).abs() < 1e-6);
        assert!((model.materials[1].albedo - 0.299).abs() < 1e-6);
        // v of OBJ runs up, ours down
        assert_eq!(model.corner_uv[2], [[0.0, 1.0], [1.0, 1.0], [1.0, 0.0]]);
    }

    #[test]
    fn damaged_meshes_are_refused_with_a_reason() {
        let folder = tempfile::tempdir().unwrap();
        let cases = [
            ("a.obj", "v 0 0\n"),
            ("b.obj", "v 0 0 0\nf 1 2 3\n"),
            ("c.obj", "v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n"),
            ("d.ply", "plx\n"),
            (
                "e.ply",
                "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\n\
                 property float z\nend_header\n0 0 0\n",
            ),
            (
                "f.ply",
                "ply\nformat ascii 1.0\nelement vertex 9999999999\nproperty float x\nproperty \
                 float y\nproperty float z\nend_header\n",
            ),
            (
                "g.ply",
                "ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\n\
                 property float y\nproperty float z\nend_header\nabc",
            ),
            ("h.stl", ""),
        ];
        for (name, text) in cases {
            let path = folder.path().join(name);
            std::fs::write(&path, text).unwrap();
            let error = MeshModel::read(&path).unwrap_err().to_string();
            assert!(error.contains(name), "{error}");
        }
    }

    #[test]
    fn files_without_an_end_are_not_read() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = |name: &str| {
            let path = folder.path().join(name);
            let made = std::process::Command::new("mkfifo").arg(&path).status();
            assert!(made.unwrap().success());
            path
        };
        for name in ["a.obj", "a.ply", "a.pcd", "a.glb"] {
            let error = MeshModel::read(&pipe(name)).unwrap_err().to_string();
            assert!(error.contains("pipe"), "{error}");
        }
        // a library of materials that cannot be is as good as none
        pipe("pipe.mtl");
        for library in ["pipe.mtl", "/dev/zero"] {
            let path = folder.path().join("b.obj");
            let text = format!("mtllib {library}\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
            std::fs::write(&path, text).unwrap();
            let mesh = MeshModel::read(&path).unwrap().mesh;
            assert_eq!(mesh.triangles.len(), 1);
        }
    }

    #[test]
    fn a_mesh_whose_triangles_lie_in_one_another_is_no_world() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.obj");
        let corner = |n: usize| format!("v {} {} {}\n", n % 300, n * 7 % 293, n * 11 % 17);
        let corners: String = (0..12_000).map(corner).collect();
        let one = |n: usize| format!(" {n}");
        let polygon: String = (1..=12_000).map(one).collect();
        std::fs::write(&path, format!("{corners}f{polygon}\n")).unwrap();
        let error = World::from_file(&path, MeshLighting::Shaded).err().unwrap();
        assert!(error.to_string().contains("in one another"), "{error}");
        // those of a room lie beside each other
        let room = crate::World::by_name_with("office", &LightingConfig::quick()).unwrap();
        let path = folder.path().join("room.ply");
        write_ply(&path, &room.mesh()).unwrap();
        let read = World::from_file(&path, MeshLighting::AsColoured);
        assert_eq!(read.err().map(|error| error.to_string()), None);
    }

    #[test]
    fn vertices_without_a_place_are_left_out_with_their_faces() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cloud.ply");
        let header = "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\n\
            property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n\
            element face 2\nproperty list uchar int vertex_indices\nend_header\n";
        let rows = "nan 0 0 9 9 9\n0 0 0 0 0 0\n1 0 0 255 255 255\n0 inf 0 9 9 9\n0 1 0 0 0 0\n3 0 \
            1 2\n3 1 2 4\n";
        std::fs::write(&path, [header, rows].concat()).unwrap();
        let model = MeshModel::read(&path).unwrap();
        assert_eq!(model.left_out, 2);
        let vertices = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        assert_eq!(model.mesh.vertices, vertices);
        assert_eq!(model.mesh.triangles, [[0, 1, 2]]);
        assert_eq!(model.mesh.albedo, [0.0, 1.0, 0.0]);
    }

    #[test]
    fn ascii_and_big_endian_ply_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let header = |format: &str| {
            format!(
                "ply\nformat {format} 1.0\ncomment x\nelement vertex 3\nproperty double x\n\
                 property float y\nproperty float z\nproperty uchar red\nproperty uchar green\n\
                 property uchar blue\nelement face 1\nproperty list uchar int vertex_index\n\
                 end_header\n"
            )
        };
        let ascii = folder.path().join("a.ply");
        std::fs::write(
            &ascii,
            header("ascii") + "0 0 0 255 255 255\n1 0 0 0 0 0\n0 1 0 255 255 255\n3 0 1 2\n",
        )
        .unwrap();
        let big = folder.path().join("b.ply");
        let mut bytes = header("binary_big_endian").into_bytes();
        for (x, y, grey) in [(0.0f64, 0.0f32, 255u8), (1.0, 0.0, 0), (0.0, 1.0, 255)] {
            bytes.extend(x.to_be_bytes());
            bytes.extend(y.to_be_bytes());
            bytes.extend(0f32.to_be_bytes());
            bytes.extend([grey; 3]);
        }
        bytes.push(3);
        for i in 0..3i32 {
            bytes.extend(i.to_be_bytes());
        }
        std::fs::write(&big, bytes).unwrap();
        let (a, b) = (read_ply(&ascii).unwrap(), read_ply(&big).unwrap());
        assert_eq!(a, b);
        assert_eq!(a.triangles, [[0, 1, 2]]);
        assert_eq!(a.vertices[1], [1.0, 0.0, 0.0]);
        assert!((a.albedo[0] - 1.0).abs() < 1e-6 && a.albedo[1].abs() < 1e-6);
    }
}
