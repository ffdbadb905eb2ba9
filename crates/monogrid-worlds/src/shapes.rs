//! Shapes of furniture, each a few patches: boxes, rounded cushions, turned and folded pieces.

use super::bvh::P3;
use super::scene::{Laying, MaterialId, Scene, place};
use std::f32::consts::{FRAC_PI_2, PI, TAU};

/// Which faces of a box get which material.
#[derive(Clone, Copy, Debug)]
pub struct BoxFaces {
    /// The four sides.
    pub sides: MaterialId,
    /// The face towards -y (the front of furniture).
    pub front: MaterialId,
    /// The top.
    pub top: MaterialId,
}

impl From<MaterialId> for BoxFaces {
    fn from(id: MaterialId) -> Self {
        Self {
            sides: id,
            front: id,
            top: id,
        }
    }
}

/// A point or vector.
pub(crate) fn p(x: f32, y: f32, z: f32) -> P3 {
    P3::new(x, y, z)
}

impl Scene {
    /// Rectangle of `x` times `y` at a height that is seen from above; `corner` has the smallest
    /// coordinates.
    pub fn floor(&mut self, corner: [f32; 3], [x, y]: [f32; 2], material: MaterialId) {
        self.quad(corner.into(), p(x, 0.0, 0.0), p(0.0, y, 0.0), material);
    }

    /// The same, seen from below.
    pub fn ceiling(&mut self, corner: [f32; 3], [x, y]: [f32; 2], material: MaterialId) {
        self.quad(corner.into(), p(0.0, y, 0.0), p(x, 0.0, 0.0), material);
    }

    /// A lamp of this shape that sheds its light downwards.
    pub fn light_below(&mut self, corner: [f32; 3], [x, y]: [f32; 2], radiosity: f32) {
        self.light(corner.into(), p(0.0, y, 0.0), p(x, 0.0, 0.0), radiosity);
    }

    /// A room from the origin to `size`: floor, ceiling and the walls at small x, large x, small y
    /// and large y.
    pub fn room(
        &mut self,
        [x, y, z]: [f32; 3],
        [floor, ceiling]: [MaterialId; 2],
        [low_x, high_x, low_y, high_y]: [MaterialId; 4],
    ) {
        let (dx, dy, dz) = (p(x, 0.0, 0.0), p(0.0, y, 0.0), p(0.0, 0.0, z));
        self.quad(P3::zeros(), dx, dy, floor);
        self.quad(dz, dy, dx, ceiling);
        self.quad(P3::zeros(), dy, dz, low_x);
        self.quad(dx, dz, dy, high_x);
        self.quad(P3::zeros(), dz, dx, low_y);
        self.quad(dy, dx, dz, high_y);
    }

    /// Upright post around a place, as wide as twice `half`, between two heights.
    pub fn post(&mut self, [x, y]: [f32; 2], half: f32, [z0, z1]: [f32; 2], material: MaterialId) {
        let (min, max) = ([x - half, y - half, z0], [x + half, y + half, z1]);
        self.cuboid(min, max, material);
    }

    /// Box from `min` to `max` of the current frame.
    pub fn cuboid(&mut self, min: [f32; 3], max: [f32; 3], faces: impl Into<BoxFaces>) {
        let faces = faces.into();
        let [x0, y0, z0] = min;
        let [x1, y1, z1] = max;
        let dx = p(x1 - x0, 0.0, 0.0);
        let dy = p(0.0, y1 - y0, 0.0);
        let dz = p(0.0, 0.0, z1 - z0);
        // pictures upright: v runs down
        self.quad(p(x0, y0, z1), -dz, dx, faces.front);
        self.transpose_last();
        self.quad(p(x1, y1, z1), -dz, -dx, faces.sides);
        self.transpose_last();
        self.quad(p(x0, y1, z1), -dz, -dy, faces.sides);
        self.transpose_last();
        self.quad(p(x1, y0, z1), -dz, dy, faces.sides);
        self.transpose_last();
        self.quad(p(x0, y0, z1), dx, dy, faces.top);
        self.quad(p(x0, y1, z0), dx, -dy, faces.sides);
    }

    /// Swaps u and v of the texture of the patch added last, keeping its outside.
    fn transpose_last(&mut self) {
        let Some(patch) = self.patches.last_mut() else {
            return;
        };
        let Some((texture, laying)) = self.materials[patch.material].texture.clone() else {
            return;
        };
        let (width, height) = texture.size();
        let (tile_u, tile_v) = match laying {
            Laying::Metres([u, v]) => (u, v),
            Laying::Fit => (1.0, 1.0),
        };
        // texels per unit differ between the axes: rescale while swapping
        let ratio_u = width as f32 / tile_u * tile_v / height as f32;
        for t in &mut patch.texels {
            *t = [t[1] * ratio_u, t[0] / ratio_u];
        }
    }

    /// Vertical picture of `width` x `height` that is seen from -y, with the middle of its lower
    /// edge at this place.
    pub fn panel(&mut self, [x, y, z]: [f32; 3], width: f32, height: f32, material: MaterialId) {
        self.at(place(x, y, z, 0.0), |s| {
            let corner = p(-0.5 * width, 0.0, height);
            s.quad(corner, p(0.0, 0.0, -height), p(width, 0.0, 0.0), material);
            s.transpose_last();
        });
    }

    /// Box around a centre whose edges are rounded by `radius`.
    pub fn rounded_box(
        &mut self,
        [x, y, z]: [f32; 3],
        size: [f32; 3],
        radius: f32,
        material: MaterialId,
    ) {
        let half = P3::from(size.map(|side| 0.5 * side));
        let radius = radius.min(half.min());
        let core = half - P3::repeat(radius);
        // the outer parts of the parameter range bend by 45 degrees, the middle is flat
        let along = move |x: f32, axis: usize| {
            let s = 2.0 * x - 1.0;
            let bent = ((s.abs() - 0.2) / 0.8).max(0.0) * (0.25 * PI);
            if bent > 0.0 {
                s.signum() * (core[axis] + radius * bent.tan())
            } else {
                s / 0.2 * core[axis]
            }
        };
        self.at(place(x, y, z, 0.0), |s| {
            for (axis, sign) in (0..3).flat_map(|axis| [(axis, -1.0f32), (axis, 1.0)]) {
                let (next, last) = ((axis + 1) % 3, (axis + 2) % 3);
                let (first, second) = if sign > 0.0 {
                    (next, last)
                } else {
                    (last, next)
                };
                s.patch(10, 10, material, |u, v| {
                    let mut on_box = P3::zeros();
                    on_box[axis] = sign * half[axis];
                    on_box[first] = along(u, first);
                    on_box[second] = along(v, second);
                    round_off(&on_box, &core, radius)
                });
            }
        });
    }

    /// Ellipsoid or, with `power` below 1, a body between ellipsoid and box (superquadric).
    pub fn cushion(&mut self, half_size: [f32; 3], power: f32, material: MaterialId) {
        let bend = move |x: f32| x.signum() * x.abs().powf(power);
        let [a, b, c] = half_size;
        self.patch(28, 14, material, move |u, v| {
            let (longitude, latitude) = (TAU * u, FRAC_PI_2 - PI * v);
            let ring = bend(latitude.cos());
            let (x, y) = (
                a * ring * bend(longitude.cos()),
                b * ring * bend(longitude.sin()),
            );
            p(x, y, c * bend(latitude.sin()))
        });
        self.flip_last();
    }

    /// Sphere around a centre.
    pub fn sphere(&mut self, [x, y, z]: [f32; 3], radius: f32, material: MaterialId) {
        self.at(place(x, y, z, 0.0), |s| {
            s.patch(40, 20, material, move |u, v| {
                let latitude = FRAC_PI_2 - PI * v;
                on_ring(latitude.cos(), u, latitude.sin()) * radius
            });
        });
        self.flip_last();
    }

    /// Turned body: a profile, given by the radii and heights of its points, rotated about z; from
    /// top to bottom its outside is the outside.
    pub fn lathe(&mut self, radii: &[f32], heights: &[f32], segments: usize, material: MaterialId) {
        let Some(last) = radii.len().checked_sub(1).filter(|&n| n > 0) else {
            return;
        };
        self.patch(segments, last, material, |u, v| {
            let position = v * last as f32;
            let k = (position as usize).min(last - 1);
            let f = position - k as f32;
            let at = |of: &[f32]| of[k] + f * (of[k + 1] - of[k]);
            on_ring(at(radii), u, at(heights))
        });
        self.flip_last();
    }

    /// Upright cylinder on the origin, with lids.
    pub fn cylinder(&mut self, radius: f32, height: f32, material: MaterialId) {
        let segments = if radius < 0.05 { 12 } else { 32 };
        self.lathe(&[radius; 2], &[height, 0.0], segments, material);
        self.disc(radius, height, material);
        self.disc(radius, 0.0, material);
        self.flip_last();
    }

    /// Horizontal disc at a height, seen from above.
    pub fn disc(&mut self, radius: f32, z: f32, material: MaterialId) {
        let segments = if radius < 0.05 { 12 } else { 32 };
        self.patch(segments, 1, material, move |u, v| on_ring(v * radius, u, z));
        self.flip_last();
    }

    /// Ring around z at a height with a round cross-section.
    pub fn torus(&mut self, height: f32, radius: f32, thickness: f32, material: MaterialId) {
        self.at(place(0.0, 0.0, height, 0.0), |s| {
            s.patch(36, 12, material, move |u, v| {
                let ring = radius + thickness * (TAU * v).cos();
                on_ring(ring, u, thickness * (TAU * v).sin())
            });
        });
    }

    /// Round bar from one point to another.
    pub fn bar(&mut self, from: P3, to: P3, radius: f32, material: MaterialId) {
        let axis = (to - from).normalize();
        let helper = if axis.z.abs() < 0.9 { P3::z() } else { P3::x() };
        let a = axis.cross(&helper).normalize();
        let b = axis.cross(&a);
        self.patch(12, 1, material, move |u, v| {
            from + (to - from) * v + (a * (TAU * u).cos() + b * (TAU * u).sin()) * radius
        });
    }

    /// Hanging cloth in the plane y = 0, `width` x `height` below the origin, with `folds` waves.
    pub fn curtain(
        &mut self,
        width: f32,
        height: f32,
        folds: f32,
        depth: f32,
        material: MaterialId,
    ) {
        self.patch((10.0 * folds) as usize, 6, material, move |u, v| {
            let wave = (TAU * folds * u + 0.8 * (3.0 * TAU * u).sin()).sin();
            let y = depth * wave * (0.6 + 0.4 * v);
            p((u - 0.5) * width * (1.0 - 0.04 * v), y, -height * v)
        });
        self.flip_last();
    }

    /// Turns the patch added last inside out.
    pub fn flip_last(&mut self) {
        if let Some(patch) = self.patches.last_mut() {
            for normal in &mut patch.normals {
                *normal = -*normal;
            }
        }
    }
}

/// The point of a ring around z after so much of a turn.
fn on_ring(radius: f32, turn: f32, z: f32) -> P3 {
    p(radius * (TAU * turn).cos(), radius * (TAU * turn).sin(), z)
}

/// Moves a point on the surface of a box onto the rounded surface around its core.
fn round_off(on_box: &P3, core: &P3, radius: f32) -> P3 {
    let inner = P3::from_fn(|i, _| on_box[i].clamp(-core[i], core[i]));
    let offset = on_box - inner;
    let length = offset.norm();
    if length < 1e-9 {
        return *on_box;
    }
    inner + offset * (radius / length)
}
