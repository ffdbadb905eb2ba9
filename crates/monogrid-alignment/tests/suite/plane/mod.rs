//! A slanted plane with a smooth texture, seen by a pinhole camera: the world of the tests.

use monogrid_alignment::DepthPixel;
use monogrid_geometry::{Pinhole, Se3, Vec2, Vec3};
use monogrid_image::GrayImage;

pub const PINHOLE: Pinhole = Pinhole {
    fx: 260.0,
    fy: 255.0,
    cx: 159.5,
    cy: 119.5,
};

/// Texture of a slanted, wavy surface: smooth at every scale, so that derivatives exist.
fn texture(x: f64, y: f64) -> f64 {
    120.0
        + 40.0 * (7.0 * x + 1.3 * y).sin()
        + 30.0 * (9.0 * y - 2.0 * x + 0.5).cos()
        + 20.0 * (17.0 * x * 0.7 + 13.0 * y).sin()
        + 12.0 * (31.0 * x - 23.0 * y).sin()
}

/// z of the surface at lateral position x, y of the world.
fn intersect(origin: &Vec3, direction: &Vec3) -> Vec3 {
    // plane z = 2 + 0.3 x + 0.2 y
    let n = Vec3::new(-0.3, -0.2, 1.0);
    let t = (2.0 - n.dot(origin)) / n.dot(direction);
    origin + direction * t
}

/// Image and depth of the surface.
pub fn render(camera_from_world: &Se3, gain: f64, bias: f64) -> (GrayImage, GrayImage) {
    let world_from_camera = camera_from_world.inverse();
    let mut depth = GrayImage::filled(320, 240, 0.0);
    let image = GrayImage::from_fn(320, 240, |u, v| {
        let direction = PINHOLE.unproject(&Vec2::new(u as f64, v as f64));
        let point = intersect(
            &world_from_camera.translation,
            &(world_from_camera.rotation * direction),
        );
        depth.set(u, v, (*camera_from_world * point).z as f32);
        (gain * texture(point.x, point.y) + bias) as f32
    });
    (image, depth)
}

pub fn samples(depth: &GrayImage, step: usize, margin: usize) -> Vec<DepthPixel> {
    let mut out = Vec::new();
    for y in (margin..240 - margin).step_by(step) {
        for x in (margin..320 - margin).step_by(step) {
            out.push(DepthPixel {
                x: x as u16,
                y: y as u16,
                idepth: 1.0 / depth.at(x, y),
                idepth_var: 1e-6,
            });
        }
    }
    out
}
