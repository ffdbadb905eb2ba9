//! A world ready to be rendered: triangles in a hierarchy, their shading, their baked light.

use super::bvh::{Bounds, Bvh, Hit, P3, Triangle};
use super::lighting::{LightMap, LightingConfig, bake};
use super::mesh::{MeshLighting, MeshModel, vertex_light};
use super::scene::{Material, Patch, Scene};

/// An affine function of the barycentric coordinates of a triangle, texels: its value at the first
/// corner and its changes with u and v.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Texels {
    base: [f32; 2],
    by_u: [f32; 2],
    by_v: [f32; 2],
}

impl Texels {
    /// By its values at the corners.
    fn of_corners([a, b, c]: [[f32; 2]; 3]) -> Self {
        Self {
            base: a,
            by_u: [b[0] - a[0], b[1] - a[1]],
            by_v: [c[0] - a[0], c[1] - a[1]],
        }
    }

    #[inline]
    fn at(&self, u: f32, v: f32, axis: usize) -> f32 {
        self.base[axis] + u * self.by_u[axis] + v * self.by_v[axis]
    }

    /// Linear density on a triangle of half this area, texels per metre.
    fn per_m(&self, area2: f32) -> f32 {
        let [p, q] = [self.by_u, self.by_v];
        ((p[0] * q[1] - p[1] * q[0]).abs() / area2).sqrt()
    }
}

/// How bright a triangle is lit.
#[derive(Clone, Copy, Debug)]
pub(super) enum Light {
    /// By a light map.
    Map(u32, Texels),
    /// By values at the three vertices.
    Vertices([f32; 3]),
}

/// What a triangle looks like.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shading {
    pub material: u32,
    pub light: Light,
    /// Texture coordinates.
    pub texels: Texels,
    /// Linear texel density on the surface, texels per metre.
    pub texels_per_m: f32,
    /// Unit normal of the plane.
    pub normal: P3,
    /// Reflectance at the vertices where there is no texture, relative to the material's.
    pub tint: [f32; 3],
}

/// A closed or open place with everything in it, lit.
#[derive(Clone, Debug)]
pub struct World {
    name: String,
    pub(super) bvh: Bvh,
    /// Shading of the triangles, in the order of the hierarchy.
    pub(super) shading: Vec<Shading>,
    pub(super) materials: Vec<Material>,
    pub(super) light_maps: Vec<LightMap>,
    /// Factor that brings the picture of an averagely lit place to a mean grey.
    pub(super) exposure: f32,
}

/// Triangles of a world or mesh, with the grey reflectance of each vertex.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TriangleMesh {
    /// Vertices in the world, m.
    pub vertices: Vec<[f32; 3]>,
    /// Indices of the vertices of each triangle.
    pub triangles: Vec<[u32; 3]>,
    /// Reflectance in [0, 1] per vertex; empty when unknown.
    pub albedo: Vec<f32>,
    /// Red, green and blue per vertex, as displayed; empty when unknown.
    pub colours: Vec<[u8; 3]>,
}

impl World {
    /// Lights a scene and prepares it for rendering.
    #[must_use]
    pub fn new(name: &str, scene: &Scene, lighting: &LightingConfig) -> Self {
        let lighting = &lighting.fitted_to(scene);
        let mut triangles = Vec::new();
        let mut shading = Vec::new();
        for (index, patch) in scene.patches.iter().enumerate() {
            let layout = LightMap::layout(patch, lighting.texel_m);
            for j in 0..patch.rows - 1 {
                for i in 0..patch.columns - 1 {
                    add_cell(&mut triangles, &mut shading, patch, index, layout, [i, j]);
                }
            }
        }
        let bvh = Bvh::new(&triangles);
        let shading = bvh.ids.iter().map(|&id| shading[id as usize]).collect();
        let mut world = Self::unlit(name, bvh, shading, scene.materials.clone());
        bake(&mut world, scene, lighting);
        world
    }

    fn unlit(name: &str, bvh: Bvh, shading: Vec<Shading>, materials: Vec<Material>) -> Self {
        Self {
            name: name.to_owned(),
            bvh,
            shading,
            materials,
            light_maps: Vec::new(),
            exposure: 1.0,
        }
    }

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

    /// Its name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Smallest and largest corner, m.
    #[must_use]
    pub fn bounds(&self) -> Bounds {
        self.bvh.bounds()
    }

    /// First surface along a ray: distance in lengths of `direction`; `None` when it leaves the
    /// world.
    #[must_use]
    pub fn cast(&self, origin: [f64; 3], direction: [f64; 3]) -> Option<f64> {
        let [origin, direction] = [origin, direction].map(|v| P3::from(v.map(|c| c as f32)));
        let hit = self.bvh.nearest(&origin, &direction, 0.0, f32::INFINITY);
        hit.map(|hit| f64::from(hit.t))
    }

    /// All triangles, for truth maps and files.
    #[must_use]
    pub fn mesh(&self) -> TriangleMesh {
        let mut mesh = TriangleMesh::default();
        for (triangle, shading) in self.bvh.triangles.iter().zip(&self.shading) {
            let first = mesh.vertices.len() as u32;
            mesh.vertices
                .extend(triangle.vertices().map(<[f32; 3]>::from));
            let albedo = self.materials[shading.material as usize].albedo;
            mesh.albedo.extend(shading.tint.map(|tint| albedo * tint));
            mesh.triangles.push([first, first + 1, first + 2]);
        }
        mesh
    }

    /// Light that falls on a point of a triangle, from the baked maps.
    #[inline]
    pub(super) fn irradiance(&self, shading: &Shading, u: f32, v: f32) -> f32 {
        match &shading.light {
            Light::Map(map, texels) => {
                self.light_maps[*map as usize].sample(texels.at(u, v, 0), texels.at(u, v, 1))
            }
            Light::Vertices([a, b, c]) => a + u * (b - a) + v * (c - a),
        }
    }

    /// Radiance leaving a hit point, before exposure. `footprint_m` is the width on the surface of
    /// what the sample averages.
    #[inline]
    pub(super) fn radiance(&self, hit: &Hit, footprint_m: f32) -> f32 {
        let shading = &self.shading[hit.triangle as usize];
        let material = &self.materials[shading.material as usize];
        let albedo = match &material.texture {
            Some((texture, _)) => {
                let along = |axis| shading.texels.at(hit.u, hit.v, axis);
                texture.sample(along(0), along(1), footprint_m * shading.texels_per_m)
            }
            None => {
                let [a, b, c] = shading.tint;
                material.albedo * (a + hit.u * (b - a) + hit.v * (c - a))
            }
        };
        if material.emission > 0.0 {
            return albedo * material.emission / self.exposure;
        }
        albedo * self.irradiance(shading, hit.u, hit.v)
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

/// Two triangles of a cell of a patch's grid; those of no area (at poles) are left out.
fn add_cell(
    triangles: &mut Vec<Triangle>,
    shading: &mut Vec<Shading>,
    patch: &Patch,
    map: usize,
    layout: (usize, usize),
    [i, j]: [usize; 2],
) {
    let light_at = |[x, y]: [usize; 2]| {
        [
            x as f32 / (patch.columns - 1) as f32 * layout.0 as f32 - 0.5,
            y as f32 / (patch.rows - 1) as f32 * layout.1 as f32 - 0.5,
        ]
    };
    for [second, third] in [[[i + 1, j], [i + 1, j + 1]], [[i + 1, j + 1], [i, j + 1]]] {
        let corners = [[i, j], second, third];
        let points = corners.map(|[x, y]| y * patch.columns + x);
        let [a, b, c] = points.map(|k| patch.points[k]);
        let triangle = Triangle::new(a, b, c);
        let scaled_normal = triangle.scaled_normal();
        let area2 = scaled_normal.norm();
        if area2 < 1e-10 {
            continue;
        }
        let texels = Texels::of_corners(points.map(|k| patch.texels[k]));
        let mut normal = scaled_normal / area2;
        if normal.dot(&patch.normals[points[0]]) < 0.0 {
            normal = -normal;
        }
        shading.push(Shading {
            material: patch.material as u32,
            light: Light::Map(map as u32, Texels::of_corners(corners.map(light_at))),
            texels,
            texels_per_m: texels.per_m(area2),
            normal,
            tint: [1.0; 3],
        });
        triangles.push(triangle);
    }
}
