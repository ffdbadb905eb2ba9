//! A world ready to be rendered: triangles in a hierarchy, their shading, their baked light.

use super::bvh::{Bounds, Bvh, Hit, P3};
use super::light_map::LightMap;
use super::scene::Material;
use super::triangle_mesh::TriangleMesh;

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
    pub(super) fn of_corners([a, b, c]: [[f32; 2]; 3]) -> Self {
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
    pub(super) fn per_m(&self, area2: f32) -> f32 {
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

impl World {
    pub(super) fn unlit(
        name: &str,
        bvh: Bvh,
        shading: Vec<Shading>,
        materials: Vec<Material>,
    ) -> Self {
        Self {
            name: name.to_owned(),
            bvh,
            shading,
            materials,
            light_maps: Vec::new(),
            exposure: 1.0,
        }
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
