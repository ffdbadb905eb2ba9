//! Light that does not change: direct light of rectangular lamps with soft shadows, and one bounce
//! gathered over the hemisphere, stored per texel of each surface.
//!
//! The same sample directions serve every texel, so plain walls stay free of noise that a camera
//! could track.

use super::bvh::{Bvh, P3, Triangle};
use super::light_map::LightMap;
use super::packet::{Packet, set_lane};
use super::scene::{AreaLight, Patch, Scene};
use super::world::{Light, Shading, Texels, World};
use rayon::prelude::*;
use std::f32::consts::{PI, TAU};

/// Settings of the light computation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightingConfig {
    /// Size of the texels that store light, m. Default 0.05.
    pub texel_m: f32,
    /// Texels in the whole world at most; in large worlds they grow. Default 120 000.
    pub max_texels: usize,
    /// Sectors of the hemisphere, of four directions each, from which reflected light is gathered.
    /// Default 10.
    pub bounce_sectors: usize,
}

impl Default for LightingConfig {
    fn default() -> Self {
        Self {
            texel_m: 0.05,
            max_texels: 120_000,
            bounce_sectors: 10,
        }
    }
}

impl LightingConfig {
    /// Coarse and quick, for tests.
    #[must_use]
    pub fn quick() -> Self {
        Self {
            texel_m: 0.15,
            max_texels: 30_000,
            bounce_sectors: 4,
        }
    }

    /// The same with texels large enough for a scene.
    pub(super) fn fitted_to(self, scene: &Scene) -> Self {
        let area_m2: f32 = scene.patches.iter().map(Patch::area_m2).sum();
        let fitting_m = (area_m2 / self.max_texels.max(1) as f32).sqrt();
        Self {
            texel_m: self.texel_m.max(fitting_m),
            ..self
        }
    }
}

/// Rays per packet, and light samples per lamp (4 x 4).
const RAYS: usize = 16;
/// Start of secondary rays above the surface, m: more than the sag of tessellated round pieces.
const LIFT_M: f32 = 0.003;
/// Light that comes from everywhere, relative to the mean direct light (stands for the bounces
/// after the first).
const AMBIENT: f32 = 0.25;

/// Position and normal of a patch at the centre of a texel.
fn texel_point(patch: &Patch, u: f32, v: f32) -> (P3, P3) {
    let x = u * (patch.columns - 1) as f32;
    let y = v * (patch.rows - 1) as f32;
    let i = (x as usize).min(patch.columns - 2);
    let j = (y as usize).min(patch.rows - 2);
    let (fx, fy) = (x - i as f32, y - j as f32);
    let k = j * patch.columns + i;
    let mix = |list: &[P3]| {
        let top = list[k].lerp(&list[k + 1], fx);
        let bottom = list[k + patch.columns].lerp(&list[k + patch.columns + 1], fx);
        top.lerp(&bottom, fy)
    };
    let normal = mix(&patch.normals);
    let normal = normal.try_normalize(1e-6).unwrap_or(patch.normals[k]);
    (mix(&patch.points), normal)
}

/// Evaluates `value(position, normal)` at every texel of every patch.
fn fill(scene: &Scene, texel_m: f32, value: &(dyn Fn(&P3, &P3) -> f32 + Sync)) -> Vec<LightMap> {
    scene
        .patches
        .par_iter()
        .map(|patch| {
            let (width, height) = LightMap::layout(patch, texel_m);
            let values = (0..width * height)
                .into_par_iter()
                .with_min_len(64)
                .map(|k| {
                    let u = ((k % width) as f32 + 0.5) / width as f32;
                    let v = ((k / width) as f32 + 0.5) / height as f32;
                    let (point, normal) = texel_point(patch, u, v);
                    value(&point, &normal)
                })
                .collect();
            LightMap {
                width,
                height,
                values,
            }
        })
        .collect()
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

/// Computes the light maps and the exposure of a world whose triangles are in place.
fn bake(world: &mut World, scene: &Scene, config: &LightingConfig) {
    let direct = fill(scene, config.texel_m, &|point, normal| {
        direct_light(world, &scene.lights, point, normal)
    });
    world.light_maps = direct.iter().map(LightMap::smoothed).collect();
    let ambient = AMBIENT * mean_light(world);
    let hemisphere = hemisphere(config.bounce_sectors, 4);
    // reflected light varies slowly: four times coarser texels suffice
    let bounced = fill(scene, 4.0 * config.texel_m, &|point, normal| {
        gather(world, &hemisphere, ambient, point, normal)
    });
    for (map, bounce) in world.light_maps.iter_mut().zip(&bounced) {
        let bounce = bounce.smoothed();
        let scale_x = bounce.width as f32 / map.width as f32;
        let scale_y = bounce.height as f32 / map.height as f32;
        for k in 0..map.values.len() {
            let x = ((k % map.width) as f32 + 0.5) * scale_x - 0.5;
            let y = ((k / map.width) as f32 + 0.5) * scale_y - 0.5;
            map.values[k] += bounce.sample(x, y);
        }
    }
    // white paper in good light shall just not be white
    world.exposure = 0.9 / bright_light(world).max(1e-12);
}

/// Irradiance over pi of the lamps: sum of L cos cos' dA / (pi r²) over visible samples.
fn direct_light(world: &World, lights: &[AreaLight], point: &P3, normal: &P3) -> f32 {
    let origin = point + normal * LIFT_M;
    let strongest = lights.iter().map(AreaLight::intensity).fold(0.0, f32::max);
    let negligible = 2e-4 * strongest;
    let mut sum = 0.0;
    for light in lights {
        let light_normal = light.edge_u.cross(&light.edge_v);
        let area = light_normal.norm();
        let mut direction = [[0.0f32; RAYS]; 3];
        let mut weights = [0.0f32; RAYS];
        for (k, weight) in weights.iter_mut().enumerate() {
            let u = ((k % 4) as f32 + 0.5) / 4.0;
            let v = ((k / 4) as f32 + 0.5) / 4.0;
            let to_light = light.corner + light.edge_u * u + light.edge_v * v - origin;
            let r2 = to_light.norm_squared().max(1e-4);
            let cos = to_light.dot(normal) / r2.sqrt();
            let cos_light = -to_light.dot(&light_normal) / (r2.sqrt() * area);
            if cos > 0.0 && cos_light > 0.0 {
                // a lamp closer than its sample spacing would flare at single samples
                let floor = area / RAYS as f32;
                *weight = cos * cos_light * area / (RAYS as f32 * PI * r2.max(floor));
            }
            set_lane(&mut direction, k, &to_light);
        }
        // far lamps of a large building are not worth their rays
        let reach: f32 = weights.iter().sum();
        if reach * light.radiosity <= negligible {
            continue;
        }
        // t = 1 is the lamp itself
        let packet = Packet::traced(origin, direction, 0.995, &world.bvh);
        for (k, weight) in weights.iter().enumerate() {
            if packet.hit(k).is_none() {
                sum += weight * light.radiosity;
            }
        }
    }
    sum
}

/// Cosine-weighted directions about z, one per stratum of the disc below.
fn hemisphere(sectors: usize, rings: usize) -> Vec<P3> {
    (0..sectors * rings)
        .map(|k| {
            let ring = k % rings;
            // rings are turned against each other
            let turn = (k / rings) as f32 + (ring as f32 + 0.5) / rings as f32;
            let angle = TAU * turn / sectors as f32;
            let radius2 = (ring as f32 + 0.5) / rings as f32;
            let radius = radius2.sqrt();
            let (x, y) = (radius * angle.cos(), radius * angle.sin());
            P3::new(x, y, (1.0 - radius2).sqrt())
        })
        .collect()
}

/// Two directions that are orthogonal to a normal and to each other.
pub(crate) fn across(normal: &P3) -> [P3; 2] {
    let is_steep = normal.z.abs() < 0.7;
    let helper = if is_steep { P3::z() } else { P3::x() };
    let a = normal.cross(&helper).normalize();
    [a, normal.cross(&a)]
}

/// Mean of what the surfaces around reflect towards a point.
fn gather(world: &World, hemisphere: &[P3], ambient: f32, point: &P3, normal: &P3) -> f32 {
    let origin = point + normal * LIFT_M;
    let [a, b] = across(normal);
    let mut sum = 0.0;
    for local in hemisphere {
        let direction = a * local.x + b * local.y + normal * local.z;
        let Some(hit) = world.bvh.nearest(&origin, &direction, 0.0, f32::INFINITY) else {
            sum += ambient;
            continue;
        };
        let shading = &world.shading[hit.triangle as usize];
        // inside of closed pieces is dark
        if shading.normal.dot(&direction) < 0.0 {
            let material = &world.materials[shading.material as usize];
            sum += material.albedo * (world.irradiance(shading, hit.u, hit.v) + ambient);
        }
    }
    sum / hemisphere.len().max(1) as f32
}

/// Light and area of all triangles, at four points of each.
fn lit_areas(world: &World) -> Vec<(f32, f64)> {
    let points = [[1.0 / 3.0; 2], [0.1, 0.1], [0.8, 0.1], [0.1, 0.8]];
    let triangles = world.bvh.triangles.iter().zip(&world.shading);
    triangles
        .flat_map(|(triangle, shading)| {
            let area = f64::from(triangle.scaled_normal().norm());
            points.map(|[u, v]| (world.irradiance(shading, u, v), area))
        })
        .collect()
}

/// Area-weighted mean of the light on all surfaces.
fn mean_light(world: &World) -> f32 {
    let areas = lit_areas(world);
    let total: f64 = areas.iter().map(|a| a.1).sum();
    let sum: f64 = areas.iter().map(|a| f64::from(a.0) * a.1).sum();
    (sum / total.max(1e-12)) as f32
}

/// Light that is exceeded on a twentieth of the surfaces.
fn bright_light(world: &World) -> f32 {
    let mut areas = lit_areas(world);
    areas.sort_by(|a, b| b.0.total_cmp(&a.0));
    let total: f64 = areas.iter().map(|a| a.1).sum();
    let mut covered = 0.0;
    let exceeded = areas.iter().find(|(_, area)| {
        covered += area;
        covered >= 0.05 * total
    });
    exceeded.map_or(0.0, |(light, _)| *light)
}
