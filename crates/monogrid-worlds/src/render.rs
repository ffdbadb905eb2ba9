//! The ray caster: world + camera + pose in, linear radiance and exact depth out.
//!
//! Rays of four samples of four neighbouring pixels travel as one packet; rows are independent, so
//! the picture does not depend on the number of threads.

use super::bvh::P3;
use super::packet::{Packet, set_lane};
use super::scene::{GREY, Tint};
use super::texture::between;
use super::world::World;
use monogrid_geometry::nalgebra::Matrix3;
use monogrid_geometry::{Camera, Se3, Vec2, Vec3};
use monogrid_image::{GrayImage, Image};
use rayon::prelude::*;

/// Samples per pixel and their offsets from its centre, px: a grid of 2x2, rotated so that edges
/// along rows and columns get four grey levels between their sides.
const SAMPLES: [[f32; 2]; 4] = [
    [-0.125, -0.375],
    [0.375, -0.125],
    [-0.375, 0.125],
    [0.125, 0.375],
];
/// Pixels per packet of colour rays.
const PIXELS: usize = 4;
/// Rays per packet.
const RAYS: usize = 16;
/// Width of what one sample averages of a texture, px.
const SAMPLE_WIDTH_PX: f32 = 0.6;

/// A rendered picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Rendered {
    /// Grey values in [0, 255] with the gamma of the renderer, not rounded.
    pub image: GrayImage,
    /// Depth (z along the optical axis) of the ray through the centre of each pixel, m; NaN where
    /// there is nothing.
    pub depth: GrayImage,
}

/// Something that moves through a world: a small world of its own and its pose.
#[derive(Clone, Copy, Debug)]
pub struct Mover<'a> {
    /// What moves, around its own origin.
    pub world: &'a World,
    /// Its pose in the world.
    pub world_from_mover: Se3,
}

/// A camera prepared for rendering.
#[derive(Clone, Debug)]
pub struct Renderer {
    camera: Camera,
    gamma: f32,
    /// Viewing direction (x, y at z = 1) of the centre of each pixel.
    centres: Vec<[f32; 2]>,
    /// The same for the corners of the pixels, one more per row and column.
    corners: Vec<[f32; 2]>,
    /// Angle covered by a pixel, rad (mean of both directions).
    pixel_rad: f32,
}

impl Renderer {
    /// Prepares a camera; `gamma` 2.2 gives pictures as cameras give them, 1 linear ones.
    #[must_use]
    pub fn new(camera: &Camera, gamma: f32) -> Self {
        let directions = |count_x: usize, count_y: usize, shift: f64| -> Vec<[f32; 2]> {
            let direction = |k: usize| {
                let (x, y) = ((k % count_x) as f64, (k / count_x) as f64);
                let ray = camera.unproject(&Vec2::new(x + shift, y + shift));
                ray.map_or([f32::NAN; 2], |d| [d.x as f32, d.y as f32])
            };
            let pixels = (0..count_x * count_y).into_par_iter();
            pixels.map(direction).collect()
        };
        Self {
            camera: *camera,
            gamma,
            centres: directions(camera.width, camera.height, 0.0),
            corners: directions(camera.width + 1, camera.height + 1, -0.5),
            pixel_rad: (1.0 / (camera.pinhole.fx * camera.pinhole.fy).sqrt()) as f32,
        }
    }

    /// The camera.
    #[must_use]
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// Picture and depth from a pose, without any effect.
    #[must_use]
    pub fn render(&self, world: &World, world_from_camera: &Se3) -> Rendered {
        let poses = &[*world_from_camera];
        let radiance = self.radiance(world, &[], poses);
        let inverse_gamma = 1.0 / self.gamma;
        Rendered {
            image: radiance.map(|v| 255.0 * v.clamp(0.0, 1.0).powf(inverse_gamma)),
            depth: self.depth(world, &[], poses),
        }
    }

    /// Mean linear radiance over each pixel; 1 is what the sensor can just hold at gain 1. `poses`
    /// (`world_from_camera`) has one for all rows, or one for each (rolling shutter).
    #[must_use]
    pub fn radiance(&self, world: &World, movers: &[Mover], poses: &[Se3]) -> GrayImage {
        self.image(movers, poses, PIXELS, |view, x, y, pixels| {
            self.shade_pixels(world, view, x, y, pixels);
        })
    }

    /// Exact depth (z, m) of the ray through the centre of each pixel, NaN where there is nothing;
    /// `poses` as in [`Self::radiance`].
    #[must_use]
    pub fn depth(&self, world: &World, movers: &[Mover], poses: &[Se3]) -> GrayImage {
        self.image(movers, poses, RAYS, |view, x, y, pixels| {
            self.look_up_pixels(world, view, [x, y], pixels, |nearest| {
                nearest.map_or(f32::NAN, |(world, origin, direction, triangle)| {
                    exact_depth(world, origin, &direction, triangle)
                })
            });
        })
    }

    /// Colour of what the ray through the centre of each pixel meets, as shares of its grey;
    /// `poses` as in [`Self::radiance`].
    #[must_use]
    pub fn tints(&self, world: &World, movers: &[Mover], poses: &[Se3]) -> Image<Tint> {
        self.image(movers, poses, RAYS, |view, x, y, pixels| {
            self.look_up_pixels(world, view, [x, y], pixels, |nearest| {
                nearest.map_or(GREY, |(world, _, _, triangle)| {
                    let material = world.shading[triangle as usize].material;
                    world.materials[material as usize].tint
                })
            });
        })
    }

    /// An image that is drawn so many neighbouring pixels of a row at a time, of which the first is
    /// at (x, y).
    fn image<T: Copy + Default + Send>(
        &self,
        movers: &[Mover],
        poses: &[Se3],
        count: usize,
        draw: impl Fn(&View, usize, usize, &mut [T]) + Sync,
    ) -> Image<T> {
        let mut image = Image::filled(self.camera.width, self.camera.height, T::default());
        let rows = image.as_mut_slice().par_chunks_mut(self.camera.width);
        rows.enumerate().for_each(|(y, row)| {
            let pose = poses.get(y).or(poses.first()).copied();
            let view = View::new(&pose.unwrap_or_default(), movers);
            for (k, pixels) in row.chunks_mut(count).enumerate() {
                draw(&view, k * count, y, pixels);
            }
        });
        image
    }

    /// Radiance of up to four neighbouring pixels of a row.
    fn shade_pixels(&self, world: &World, view: &View, x: usize, y: usize, out: &mut [f32]) {
        let mut direction = [[0.0f32; RAYS]; 3];
        for pixel in 0..PIXELS {
            let column = (x + pixel).min(self.camera.width - 1);
            let corners = self.corners(column, y);
            for (sample, offset) in SAMPLES.iter().enumerate() {
                // direction at an offset from the centre
                let place = offset.map(|along| along + 0.5);
                let at = |axis: usize| between(corners.map(|corner| corner[axis]), place);
                let ray = view.rotate([at(0), at(1)]);
                set_lane(&mut direction, pixel * SAMPLES.len() + sample, &ray);
            }
        }
        let packet = Packet::traced(view.origin, direction, f32::INFINITY, &world.bvh);
        let moved = view.trace_movers(&packet);
        for (pixel, value) in out.iter_mut().enumerate() {
            let lanes = pixel * SAMPLES.len()..(pixel + 1) * SAMPLES.len();
            let sum: f32 = lanes
                .map(|lane| self.sample(world, view, &packet, &moved, lane))
                .sum();
            // rays beyond the lens are NaN and hit nothing: black
            *value = sum * (1.0 / SAMPLES.len() as f32);
        }
    }

    /// Radiance along one ray of a traced packet.
    #[inline]
    fn sample(
        &self,
        world: &World,
        view: &View,
        packet: &Packet<RAYS>,
        moved: &[Packet<RAYS>],
        lane: usize,
    ) -> f32 {
        let mut best = packet.hit(lane).map(|hit| (world, packet, hit));
        for (mover, other) in view.movers.iter().zip(moved) {
            if let Some(hit) = other.hit(lane).filter(|h| best.is_none_or(|b| h.t < b.2.t)) {
                best = Some((mover.world, other, hit));
            }
        }
        let Some((surroundings, rays, hit)) = best else {
            return 0.0;
        };
        let direction = rays.direction(lane);
        let normal = surroundings.shading[hit.triangle as usize].normal;
        // a slanted surface is averaged over the geometric mean of its two widths
        let cos = (normal.dot(&direction).abs() / direction.norm()).max(0.02);
        let footprint_m = SAMPLE_WIDTH_PX * self.pixel_rad * hit.t / cos.sqrt();
        surroundings.radiance(&hit, footprint_m) * surroundings.exposure
    }

    /// Up to sixteen neighbouring pixels of a row by what their centres show: its world, the
    /// camera's place in it, the direction of the ray, and the triangle.
    fn look_up_pixels<T>(
        &self,
        world: &World,
        view: &View,
        [x, y]: [usize; 2],
        out: &mut [T],
        value_of: impl Fn(Option<(&World, &Vec3, P3, u32)>) -> T,
    ) {
        let mut direction = [[0.0f32; RAYS]; 3];
        for lane in 0..RAYS {
            let column = (x + lane).min(self.camera.width - 1);
            let ray = view.rotate(self.centres[y * self.camera.width + column]);
            set_lane(&mut direction, lane, &ray);
        }
        let packet = Packet::traced(view.origin, direction, f32::INFINITY, &world.bvh);
        let moved = view.trace_movers(&packet);
        for (lane, value) in out.iter_mut().enumerate() {
            let others = view.movers.iter().zip(&moved);
            let others = others.map(|(mover, rays)| (mover.world, rays, &mover.exact_origin));
            let nearest = std::iter::once((world, &packet, &view.exact_origin))
                .chain(others)
                .filter_map(|(world, rays, origin)| Some((rays.hit(lane)?, world, rays, origin)))
                .min_by(|a, b| a.0.t.total_cmp(&b.0.t));
            *value = value_of(nearest.map(|(hit, world, rays, origin)| {
                (world, origin, rays.direction(lane), hit.triangle)
            }));
        }
    }

    /// Viewing directions at the corners of a pixel.
    fn corners(&self, x: usize, y: usize) -> [[f32; 2]; 4] {
        let stride = self.camera.width + 1;
        let k = y * stride + x;
        [k, k + 1, k + stride, k + stride + 1].map(|k| self.corners[k])
    }
}

/// A pose in the precision of the renderer.
struct View<'a> {
    origin: P3,
    exact_origin: Vec3,
    right: P3,
    down: P3,
    forward: P3,
    movers: Vec<Seen<'a>>,
}

/// A mover and how rays come into its frame.
struct Seen<'a> {
    world: &'a World,
    rotation: Matrix3<f32>,
    origin: P3,
    exact_origin: Vec3,
}

impl<'a> Seen<'a> {
    fn new(mover: &Mover<'a>, origin: Vec3) -> Self {
        let mover_from_world = mover.world_from_mover.inverse();
        let exact_origin = mover_from_world * origin;
        Self {
            world: mover.world,
            rotation: mover_from_world.rotation_matrix().map(|v| v as f32),
            origin: exact_origin.map(|v| v as f32),
            exact_origin,
        }
    }
}

impl<'a> View<'a> {
    fn new(world_from_camera: &Se3, movers: &[Mover<'a>]) -> Self {
        let r = world_from_camera.rotation_matrix();
        let column = |k: usize| P3::new(r[(0, k)] as f32, r[(1, k)] as f32, r[(2, k)] as f32);
        Self {
            origin: world_from_camera.translation.map(|v| v as f32),
            exact_origin: world_from_camera.translation,
            right: column(0),
            down: column(1),
            forward: column(2),
            movers: movers
                .iter()
                .map(|mover| Seen::new(mover, world_from_camera.translation))
                .collect(),
        }
    }

    /// Direction in the world of a camera direction with z = 1.
    #[inline]
    fn rotate(&self, [x, y]: [f32; 2]) -> P3 {
        self.right * x + self.down * y + self.forward
    }

    /// The same rays through each mover, in its own frame.
    fn trace_movers(&self, packet: &Packet<RAYS>) -> Vec<Packet<RAYS>> {
        self.movers
            .iter()
            .map(|mover| {
                let mut local = [[0.0f32; RAYS]; 3];
                let mut farthest = 0.0f32;
                for lane in 0..RAYS {
                    set_lane(&mut local, lane, &(mover.rotation * packet.direction(lane)));
                    farthest = farthest.max(packet.distance(lane));
                }
                Packet::traced(mover.origin, local, farthest, &mover.world.bvh)
            })
            .collect()
    }
}

/// Depth by the plane of the triangle in double precision: directions have z = 1 in the camera, so
/// lengths of them are depths.
fn exact_depth(world: &World, origin: &Vec3, direction: &P3, triangle: u32) -> f32 {
    let triangle = &world.bvh.triangles[triangle as usize];
    let to_f64 = |p: P3| p.map(f64::from);
    let normal = to_f64(triangle.e1).cross(&to_f64(triangle.e2));
    let along = normal.dot(&to_f64(*direction));
    (normal.dot(&(to_f64(triangle.v0) - origin)) / along) as f32
}
