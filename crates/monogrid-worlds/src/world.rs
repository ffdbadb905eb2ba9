//! A world ready to be rendered: triangles in a hierarchy, their shading, their baked light.

use super::bvh::{Bounds, Bvh, Hit, P3, Triangle};
use super::lighting::{LightMap, LightingConfig, bake};
use super::mesh::{MeshLighting, MeshModel, vertex_light};
use super::scene::{Material, Scene};
use super::texture::Texture;
use std::sync::Arc;

/// How bright a triangle is lit.
#[derive(Clone, Copy, Debug)]
pub(super) enum Light {
    /// By a light map, at an affine function of the barycentric coordinates (texels).
    Map {
        map: u32,
        base: [f32; 2],
        by_u: [f32; 2],
        by_v: [f32; 2],
    },
    /// By values at the three vertices.
    Vertices([f32; 3]),
}

/// What a triangle looks like.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shading {
    pub material: u32,
    pub light: Light,
    /// Texture coordinates, an affine function of the barycentric coordinates (texels).
    pub texel: [f32; 2],
    pub texel_by_u: [f32; 2],
    pub texel_by_v: [f32; 2],
    /// Linear texel density on the surface, texels per metre.
    pub texels_per_m: f32,
    /// Unit normal of the plane.
    pub normal: P3,
    /// Reflectance at the vertices where there is no texture, relative to the material's.
    pub tint: [f32; 3],
}

/// Reflectance and emission of a material as the inner loop wants them.
#[derive(Clone, Debug)]
pub(super) struct Surface {
    pub albedo: f32,
    pub texture: Option<Arc<Texture>>,
    pub emission: f32,
}

impl From<&Material> for Surface {
    fn from(material: &Material) -> Self {
        Self {
            albedo: material.albedo,
            texture: material.texture.as_ref().map(|(t, _)| t.clone()),
            emission: material.emission,
        }
    }
}

/// A closed or open place with everything in it, lit.
#[derive(Clone, Debug)]
pub struct World {
    name: String,
    objects: Vec<String>,
    pub(super) bvh: Bvh,
    /// Shading of the triangles, in the order of the hierarchy.
    pub(super) shading: Vec<Shading>,
    pub(super) surfaces: Vec<Surface>,
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
}

/// How the surface of a world is divided.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceShares {
    /// Area of all surfaces, m².
    pub area_m2: f64,
    /// Share of it that has no texture.
    pub plain: f64,
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
        let ids = bvh.source_ids().iter();
        let shading = ids.map(|&id| shading[id as usize]).collect();
        let surfaces = scene.materials.iter().map(Surface::from).collect();
        let mut world = Self {
            name: name.to_owned(),
            objects: scene.objects.clone(),
            bvh,
            shading,
            surfaces,
            light_maps: Vec::new(),
            exposure: 1.0,
        };
        bake(&mut world, scene, lighting);
        world
    }

    /// A mesh as a world.
    #[must_use]
    pub fn from_model(name: &str, model: &MeshModel, lighting: MeshLighting) -> Self {
        let mesh = &model.mesh;
        let corners = |t: &[u32; 3]| t.map(|k| P3::from(mesh.vertices[k as usize]));
        // triangles without area cannot be seen, and have no normal
        let used: Vec<usize> = (0..mesh.triangles.len())
            .filter(|&k| {
                let [a, b, c] = corners(&mesh.triangles[k]);
                Triangle::new(a, b, c).scaled_normal().norm() > 0.0
            })
            .collect();
        let triangles: Vec<Triangle> = used
            .iter()
            .map(|&k| {
                let [a, b, c] = corners(&mesh.triangles[k]);
                Triangle::new(a, b, c)
            })
            .collect();
        let bvh = Bvh::new(&triangles);
        let light = vertex_light(mesh, &bvh, lighting);
        let surfaces: Vec<Surface> = model.all_materials().iter().map(Surface::from).collect();
        let shading = bvh
            .source_ids()
            .iter()
            .map(|&id| {
                mesh_shading(
                    model,
                    &surfaces,
                    &light,
                    used[id as usize],
                    &triangles[id as usize],
                )
            })
            .collect();
        Self {
            name: name.to_owned(),
            objects: vec![name.to_owned()],
            bvh,
            shading,
            surfaces,
            light_maps: Vec::new(),
            exposure: 1.0,
        }
    }

    /// Its name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Names of the things in it.
    #[must_use]
    pub fn objects(&self) -> &[String] {
        &self.objects
    }

    /// Smallest and largest corner, m.
    #[must_use]
    pub fn bounds(&self) -> Bounds {
        self.bvh.bounds()
    }

    /// The triangle hierarchy.
    #[must_use]
    pub fn bvh(&self) -> &Bvh {
        &self.bvh
    }

    /// First surface along a ray: distance in lengths of `direction`; `None` when it leaves the world.
    #[must_use]
    pub fn cast(&self, origin: [f64; 3], direction: [f64; 3]) -> Option<f64> {
        let to_f32 = |v: [f64; 3]| P3::new(v[0] as f32, v[1] as f32, v[2] as f32);
        self.bvh
            .nearest(&to_f32(origin), &to_f32(direction), 0.0, f32::INFINITY)
            .map(|hit| f64::from(hit.t))
    }

    /// All triangles, for truth maps and files.
    #[must_use]
    pub fn mesh(&self) -> TriangleMesh {
        let mut mesh = TriangleMesh::default();
        for (triangle, shading) in self.bvh.triangles().iter().zip(&self.shading) {
            let first = mesh.vertices.len() as u32;
            for (k, vertex) in triangle.vertices().iter().enumerate() {
                mesh.vertices.push([vertex.x, vertex.y, vertex.z]);
                let surface = &self.surfaces[shading.material as usize];
                mesh.albedo.push(surface.albedo * shading.tint[k]);
            }
            mesh.triangles.push([first, first + 1, first + 2]);
        }
        mesh
    }

    /// Area of the surfaces and the share without texture.
    #[must_use]
    pub fn surface_shares(&self) -> SurfaceShares {
        let (mut area_m2, mut plain) = (0.0, 0.0);
        for (triangle, shading) in self.bvh.triangles().iter().zip(&self.shading) {
            let area = 0.5 * f64::from(triangle.scaled_normal().norm());
            area_m2 += area;
            if self.surfaces[shading.material as usize].texture.is_none() {
                plain += area;
            }
        }
        SurfaceShares {
            area_m2,
            plain: plain / f64::max(area_m2, 1e-12),
        }
    }

    /// Light that falls on a hit point, from the baked maps.
    #[inline]
    pub(super) fn irradiance(&self, shading: &Shading, hit: &Hit) -> f32 {
        match &shading.light {
            Light::Map {
                map,
                base,
                by_u,
                by_v,
            } => self.light_maps[*map as usize].sample(
                base[0] + hit.u * by_u[0] + hit.v * by_v[0],
                base[1] + hit.u * by_u[1] + hit.v * by_v[1],
            ),
            Light::Vertices([a, b, c]) => a + hit.u * (b - a) + hit.v * (c - a),
        }
    }

    /// Radiance leaving a hit point, before exposure. `footprint_m` is the width on the surface of
    /// what the sample averages.
    #[inline]
    pub(super) fn radiance(&self, hit: &Hit, footprint_m: f32) -> f32 {
        let shading = &self.shading[hit.triangle as usize];
        let surface = &self.surfaces[shading.material as usize];
        let albedo = match &surface.texture {
            Some(texture) => texture.sample(
                shading.texel[0] + hit.u * shading.texel_by_u[0] + hit.v * shading.texel_by_v[0],
                shading.texel[1] + hit.u * shading.texel_by_u[1] + hit.v * shading.texel_by_v[1],
                footprint_m * shading.texels_per_m,
            ),
            None => {
                let [a, b, c] = shading.tint;
                surface.albedo * (a + hit.u * (b - a) + hit.v * (c - a))
            }
        };
        if surface.emission > 0.0 {
            return albedo * surface.emission / self.exposure;
        }
        albedo * self.irradiance(shading, hit)
    }
}

/// Shading of one triangle of a mesh.
fn mesh_shading(
    model: &MeshModel,
    surfaces: &[Surface],
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
        texel: [0.0; 2],
        texel_by_u: [0.0; 2],
        texel_by_v: [0.0; 2],
        texels_per_m: 0.0,
        normal: scaled_normal / area2,
        tint: at(&model.mesh.albedo),
    };
    let texture = surfaces
        .get(material as usize)
        .and_then(|s| s.texture.as_ref());
    if let (Some(texture), Some(uv)) = (texture, model.corner_uv.get(index)) {
        let (width, height) = texture.size();
        let [a, b, c] = uv.map(|[u, v]| [u * width as f32, v * height as f32]);
        shading.texel = a;
        shading.texel_by_u = [b[0] - a[0], b[1] - a[1]];
        shading.texel_by_v = [c[0] - a[0], c[1] - a[1]];
        let [p, q] = [shading.texel_by_u, shading.texel_by_v];
        shading.texels_per_m = ((p[0] * q[1] - p[1] * q[0]).abs() / area2).sqrt();
    }
    shading
}

/// Two triangles of a cell of a patch's grid; those of no area (at poles) are left out.
fn add_cell(
    triangles: &mut Vec<Triangle>,
    shading: &mut Vec<Shading>,
    patch: &super::scene::Patch,
    map: usize,
    layout: (usize, usize),
    [i, j]: [usize; 2],
) {
    let corner = |a: usize, b: usize| (b * patch.columns + a, [a, b]);
    let corners = [
        corner(i, j),
        corner(i + 1, j),
        corner(i + 1, j + 1),
        corner(i, j + 1),
    ];
    for [a, b, c] in [[0, 1, 2], [0, 2, 3]] {
        let [a, b, c] = [corners[a], corners[b], corners[c]];
        let triangle = Triangle::new(patch.points[a.0], patch.points[b.0], patch.points[c.0]);
        let scaled_normal = triangle.scaled_normal();
        let area2 = scaled_normal.norm();
        if area2 < 1e-10 {
            continue;
        }
        let light_at = |[x, y]: [usize; 2]| {
            [
                x as f32 / (patch.columns - 1) as f32 * layout.0 as f32 - 0.5,
                y as f32 / (patch.rows - 1) as f32 * layout.1 as f32 - 0.5,
            ]
        };
        let minus = |p: [f32; 2], q: [f32; 2]| [p[0] - q[0], p[1] - q[1]];
        let base = light_at(a.1);
        let texel = patch.texels[a.0];
        let texel_by_u = minus(patch.texels[b.0], texel);
        let texel_by_v = minus(patch.texels[c.0], texel);
        let texel_area2 = (texel_by_u[0] * texel_by_v[1] - texel_by_u[1] * texel_by_v[0]).abs();
        let mut normal = scaled_normal / area2;
        if normal.dot(&patch.normals[a.0]) < 0.0 {
            normal = -normal;
        }
        shading.push(Shading {
            material: patch.material as u32,
            light: Light::Map {
                map: map as u32,
                base,
                by_u: minus(light_at(b.1), base),
                by_v: minus(light_at(c.1), base),
            },
            texel,
            texel_by_u,
            texel_by_v,
            texels_per_m: (texel_area2 / area2).sqrt(),
            normal,
            tint: [1.0; 3],
        });
        triangles.push(triangle);
    }
}
