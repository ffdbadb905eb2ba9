//! What a world is made of: materials, surfaces as grids of points, lamps; and the builder for
//! them.
//!
//! Every surface, flat or curved, is a grid of quadrilaterals ("patch"), so that one code path
//! renders, lights, measures and exports everything. World axes: z up, metres.

use super::bvh::P3;
use super::texture::Texture;
use monogrid_geometry::nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use std::sync::Arc;

/// Index of a material in its scene.
pub type MaterialId = usize;

/// How a texture is laid on a patch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Laying {
    /// The tile spans this many metres along u and along v, and repeats.
    Metres([f32; 2]),
    /// The tile covers the whole patch once.
    Fit,
}

/// What reflects or emits light.
#[derive(Clone, Debug)]
pub struct Material {
    /// Reflectance when there is no texture, in [0, 1].
    pub albedo: f32,
    /// Texture of the reflectance.
    pub texture: Option<(Arc<Texture>, Laying)>,
    /// Radiance that it shows by itself (a lit lamp, a screen, the sky), times its reflectance;
    /// 0 for everything else. Such surfaces are shown without shading.
    pub emission: f32,
    /// Red, green and blue of its colour, as shares of its grey.
    pub tint: Tint,
}

/// Red, green and blue of a colour, as shares of its grey: what it looks like in a grey picture
/// does not depend on it.
pub type Tint = [f32; 3];

/// Grey.
pub const GREY: Tint = [1.0; 3];

impl Material {
    /// A surface of one tone.
    #[must_use]
    pub fn plain(albedo: f32) -> Self {
        Self {
            albedo,
            texture: None,
            emission: 0.0,
            tint: GREY,
        }
    }

    /// A textured surface whose tile spans `width` x `height` metres.
    #[must_use]
    pub fn tiled(texture: Texture, width: f32, height: f32) -> Self {
        Self::covered(texture, Laying::Metres([width, height]))
    }

    /// A picture that covers each patch once.
    #[must_use]
    pub fn fitted(texture: Texture) -> Self {
        Self::covered(texture, Laying::Fit)
    }

    fn covered(texture: Texture, laying: Laying) -> Self {
        let albedo = texture.mean();
        Self {
            texture: Some((Arc::new(texture), laying)),
            ..Self::plain(albedo)
        }
    }

    /// The same, shining by itself.
    #[must_use]
    pub fn glowing(mut self, emission: f32) -> Self {
        self.emission = emission;
        self
    }
}

/// A surface given by a grid of `columns` x `rows` points.
#[derive(Clone, Debug)]
pub struct Patch {
    /// Points per row.
    pub columns: usize,
    /// Rows of points.
    pub rows: usize,
    /// Points, row by row, in the world.
    pub points: Vec<P3>,
    /// Unit normals at the points, to the outside.
    pub normals: Vec<P3>,
    /// Texture coordinates at the points, texels of the finest level (0 without texture).
    pub texels: Vec<[f32; 2]>,
    /// What it is made of.
    pub material: MaterialId,
}

impl Patch {
    /// Area, m².
    #[must_use]
    pub fn area_m2(&self) -> f32 {
        let mut sum = 0.0;
        for j in 0..self.rows - 1 {
            for i in 0..self.columns - 1 {
                let k = j * self.columns + i;
                let diagonal = self.points[k + self.columns + 1] - self.points[k];
                let other = self.points[k + self.columns] - self.points[k + 1];
                // exact for flat cells, and for all others as good as their triangles
                sum += 0.5 * diagonal.cross(&other).norm();
            }
        }
        sum
    }
}

/// A rectangular lamp or window that sheds light.
#[derive(Clone, Copy, Debug)]
pub struct AreaLight {
    /// One corner.
    pub corner: P3,
    /// Edge from the corner.
    pub edge_u: P3,
    /// Other edge from the corner.
    pub edge_v: P3,
    /// Light leaving each square metre, arbitrary units (pictures are normalised afterwards).
    pub radiosity: f32,
}

impl AreaLight {
    /// Light that it sends straight ahead to a distance of a metre, were it small.
    #[must_use]
    pub fn intensity(&self) -> f32 {
        self.radiosity * self.edge_u.cross(&self.edge_v).norm() / std::f32::consts::PI
    }
}

/// A scene under construction.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    /// All materials.
    pub materials: Vec<Material>,
    /// All surfaces.
    pub patches: Vec<Patch>,
    /// All lamps.
    pub lights: Vec<AreaLight>,
    /// Names of the objects, in the order in which they were begun.
    pub objects: Vec<String>,
    /// Frame in which objects are placed, in the world.
    outer: Pose,
    /// Frame of what is added, in the world.
    current: Pose,
    texture_shift: u32,
}

/// Rigid placement of a piece in the world.
pub type Pose = Isometry3<f32>;

/// A pose on the floor: position and heading (rad, counter-clockwise seen from above).
#[must_use]
pub fn place(x: f32, y: f32, z: f32, heading_rad: f32) -> Pose {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading_rad);
    Isometry3::from_parts(Translation3::new(x, y, z), turn)
}

/// A pose with a rotation about any axis (rad).
#[must_use]
pub fn place_tilted(x: f32, y: f32, z: f32, rotation_rad: [f32; 3]) -> Pose {
    let [roll, pitch, yaw] = rotation_rad;
    let turn = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
    Isometry3::from_parts(Translation3::new(x, y, z), turn)
}

impl Scene {
    /// Adds a material.
    pub fn material(&mut self, material: Material) -> MaterialId {
        self.materials.push(material);
        self.materials.len() - 1
    }

    /// Adds a plain material.
    pub fn plain(&mut self, albedo: f32) -> MaterialId {
        self.material(Material::plain(albedo))
    }

    /// Adds a material that is covered with tiles of `width` times `height` metres.
    pub fn tiled(&mut self, texture: Texture, width: f32, height: f32) -> MaterialId {
        self.material(Material::tiled(texture, width, height))
    }

    /// Adds a material that is covered with one picture.
    pub fn fitted(&mut self, texture: Texture) -> MaterialId {
        self.material(Material::fitted(texture))
    }

    /// Gives a material a colour, red, green and blue; how bright it is stays.
    pub fn tinted(&mut self, id: MaterialId, [red, green, blue]: [f32; 3]) {
        let grey = 0.299 * red + 0.587 * green + 0.114 * blue;
        self.materials[id].tint = [red, green, blue].map(|value| value / grey);
    }

    /// Begins an object: what is added from now on belongs to it.
    pub fn object(&mut self, name: &str) {
        self.object_at(name, Pose::identity());
    }

    /// Begins an object placed at `pose`: what is added from now on belongs to it and is given in
    /// its frame.
    pub fn object_at(&mut self, name: &str, pose: Pose) {
        self.objects.push(name.to_owned());
        self.current = self.outer * pose;
    }

    /// Builds `parts` in a frame placed at `pose` of the current frame.
    pub fn at(&mut self, pose: Pose, parts: impl FnOnce(&mut Self)) {
        let around = (self.outer, self.current);
        self.current *= pose;
        self.outer = self.current;
        parts(self);
        (self.outer, self.current) = around;
    }

    /// Adds a lamp given in the current frame.
    pub fn light(&mut self, corner: P3, edge_u: P3, edge_v: P3, radiosity: f32) {
        let pose = self.current;
        self.lights.push(AreaLight {
            corner: pose.transform_point(&corner.into()).coords,
            edge_u: pose.rotation * edge_u,
            edge_v: pose.rotation * edge_v,
            radiosity,
        });
    }

    /// Adds the surface `point(u, v)` for u, v in [0, 1], as `columns` x `rows` quadrilaterals.
    ///
    /// Its outside is where the cross product of the derivatives by u and by v points; textures run
    /// along u and v, with v downwards in the picture.
    pub fn patch(
        &mut self,
        columns: usize,
        rows: usize,
        material: MaterialId,
        point: impl Fn(f32, f32) -> P3,
    ) {
        let pose = self.current;
        let (nu, nv) = (columns.max(1), rows.max(1));
        let at = |u: f32, v: f32| pose.transform_point(&point(u, v).into()).coords;
        let mut points = Vec::with_capacity((nu + 1) * (nv + 1));
        let mut normals = Vec::with_capacity(points.capacity());
        for j in 0..=nv {
            for i in 0..=nu {
                let (u, v) = (i as f32 / nu as f32, j as f32 / nv as f32);
                points.push(at(u, v));
                normals.push(normal_of(&at, u, v, nu, nv));
            }
        }
        let texels = self.texels_of(material, &points, nu + 1, nv + 1);
        self.patches.push(Patch {
            columns: nu + 1,
            rows: nv + 1,
            points,
            normals,
            texels,
            material,
        });
    }

    /// Flat parallelogram: `corner`, then along the two edges; outside where their product points.
    pub fn quad(&mut self, corner: P3, edge_u: P3, edge_v: P3, material: MaterialId) {
        self.patch(1, 1, material, |u, v| corner + edge_u * u + edge_v * v);
    }

    fn texels_of(
        &mut self,
        id: MaterialId,
        points: &[P3],
        columns: usize,
        rows: usize,
    ) -> Vec<[f32; 2]> {
        let Some((texture, laying)) = self.materials.get(id).and_then(|m| m.texture.clone()) else {
            return vec![[0.0; 2]; points.len()];
        };
        let (width, height) = texture.size();
        let (width, height) = (width as f32, height as f32);
        let fraction = |k: usize, n: usize| k as f32 / (n - 1) as f32;
        let cells = (0..rows).flat_map(|j| (0..columns).map(move |i| (i, j)));
        match laying {
            Laying::Fit => cells
                .map(|(i, j)| [fraction(i, columns) * width, fraction(j, rows) * height])
                .collect(),
            Laying::Metres([tile_u, tile_v]) => {
                // arc lengths along the middle row and column: exact on flat and rolled surfaces
                let along_u = arc_lengths(columns, |i| points[(rows / 2) * columns + i]);
                let along_v = arc_lengths(rows, |j| points[j * columns + columns / 2]);
                // every patch starts elsewhere in the tile, so that equal pieces differ
                self.texture_shift = self.texture_shift.wrapping_add(1);
                let shift = self.texture_shift as f32;
                let start = [(0.618 * shift).fract(), (0.414 * shift).fract()];
                let u = |i: usize| (along_u[i] / tile_u + start[0]) * width;
                let v = |j: usize| (along_v[j] / tile_v + start[1]) * height;
                cells.map(|(i, j)| [u(i), v(j)]).collect()
            }
        }
    }
}

/// Cumulated distances of consecutive points.
pub(super) fn arc_lengths(count: usize, point: impl Fn(usize) -> P3) -> Vec<f32> {
    let mut total = 0.0;
    let mut lengths = vec![0.0];
    for k in 1..count {
        total += (point(k) - point(k - 1)).norm();
        lengths.push(total);
    }
    lengths
}

/// Unit normal of a surface by finite differences, also at poles where one derivative vanishes.
fn normal_of(at: &impl Fn(f32, f32) -> P3, u: f32, v: f32, nu: usize, nv: usize) -> P3 {
    let (hu, hv) = (0.25 / nu as f32, 0.25 / nv as f32);
    let inside = |x: f32, h: f32| x.clamp(h, 1.0 - h);
    // away from degenerate borders the difference is taken at the point itself
    for (cu, cv) in [(u, v), (inside(u, hu), inside(v, hv))] {
        let (u0, u1) = ((cu - hu).max(0.0), (cu + hu).min(1.0));
        let (v0, v1) = ((cv - hv).max(0.0), (cv + hv).min(1.0));
        let (by_u, by_v) = (at(u1, cv) - at(u0, cv), at(cu, v1) - at(cu, v0));
        let normal = by_u.cross(&by_v);
        if normal.norm() > 1e-3 * (by_u.norm_squared() + by_v.norm_squared()) {
            return normal.normalize();
        }
    }
    P3::z()
}
