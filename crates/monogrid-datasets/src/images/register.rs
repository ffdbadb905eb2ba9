//! Depth images seen from the colour camera.

use super::DepthCalibration;
use monogrid_geometry::{Pinhole, Vec2, Vec3};
use monogrid_image::Image;

/// Two depths belong to one surface when the larger is at most this much above the smaller.
const SAME_SURFACE_RATIO: f64 = 1.05;

/// A depth pixel projected into the target.
#[derive(Clone, Copy)]
struct Vertex {
    x: f64,
    y: f64,
    inv_depth: f64,
}

/// Warps depth images into the (undistorted) colour camera; prepared once per sequence.
///
/// The depth image is a mesh: neighbouring pixels on one surface span triangles, in which the
/// inverse depth is interpolated linearly (exact for planes), with the nearest surface in front. So
/// the target is covered densely whatever the two resolutions are, and nothing is invented across
/// the edges of objects.
#[derive(Clone, Debug)]
pub struct DepthRegistration {
    calibration: DepthCalibration,
    /// Ray with z = 1 of each depth pixel; NaN where the lens model has none.
    rays_in_depth: Vec<Vec3>,
    target: Pinhole,
    width: usize,
    height: usize,
}

impl DepthRegistration {
    /// Prepares the warp into a pinhole camera of the given size.
    #[must_use]
    pub fn new(
        calibration: &DepthCalibration,
        target: &Pinhole,
        width: usize,
        height: usize,
    ) -> Self {
        let camera = calibration.camera;
        let mut rays_in_depth = Vec::with_capacity(camera.width * camera.height);
        for y in 0..camera.height {
            for x in 0..camera.width {
                let ray = camera.unproject(&Vec2::new(x as f64, y as f64));
                rays_in_depth.push(ray.unwrap_or(Vec3::repeat(f64::NAN)));
            }
        }
        Self {
            calibration: *calibration,
            rays_in_depth,
            target: *target,
            width,
            height,
        }
    }

    /// Depth in metres along the optical axis of the target, NaN where unknown; `None` when the
    /// depth image has another size than its calibration.
    #[must_use]
    pub fn register(&self, depth: &Image<f32>) -> Option<Image<f32>> {
        let camera = &self.calibration.camera;
        let (w, h) = (camera.width, camera.height);
        if depth.width() != w || depth.height() != h {
            return None;
        }
        let vertices = self.project(depth);
        let mut nearest = Image::filled(self.width, self.height, 0.0f32);
        for y in 0..h.saturating_sub(1) {
            for x in 0..w.saturating_sub(1) {
                let i = y * w + x;
                // the diagonal alternates, so that no direction is preferred
                let triangles = if (x + y) % 2 == 0 {
                    [[i, i + 1, i + w + 1], [i, i + w + 1, i + w]]
                } else {
                    [[i, i + 1, i + w], [i + 1, i + w + 1, i + w]]
                };
                for corners in triangles {
                    if on_one_surface(depth.as_slice(), corners) {
                        draw_triangle(&mut nearest, corners.map(|c| vertices[c]));
                    }
                }
            }
        }
        draw_points(&mut nearest, &vertices);
        Some(nearest.map(|inv| if inv > 0.0 { 1.0 / inv } else { f32::NAN }))
    }

    /// Projects every depth pixel; NaN where there is none or it is behind the target.
    fn project(&self, depth: &Image<f32>) -> Vec<Vertex> {
        let target_from_depth = self.calibration.colour_from_depth;
        let rotation = target_from_depth.rotation_matrix();
        self.rays_in_depth
            .iter()
            .zip(depth.as_slice())
            .map(|(ray, &z)| {
                let point = rotation * (ray * f64::from(z)) + target_from_depth.translation;
                let pixel = self.target.project(&point);
                let is_ahead = point.z > 1e-6;
                Vertex {
                    x: pixel.x,
                    y: pixel.y,
                    inv_depth: if is_ahead { 1.0 / point.z } else { f64::NAN },
                }
            })
            .collect()
    }
}

/// Whether three depth pixels are known and lie on one surface.
fn on_one_surface(depth: &[f32], corners: [usize; 3]) -> bool {
    let z = corners.map(|c| f64::from(depth[c]));
    let (min, max) = (z[0].min(z[1]).min(z[2]), z[0].max(z[1]).max(z[2]));
    // `min` and `max` skip NaN, so it has to be asked for
    z.iter().all(|v| v.is_finite()) && min > 0.0 && max <= min * SAME_SURFACE_RATIO
}

/// Rasterises a triangle with linear inverse depth, keeping the nearest.
fn draw_triangle(nearest: &mut Image<f32>, [a, b, c]: [Vertex; 3]) {
    let area = (b.x - a.x) * (c.y - a.y) - (c.x - a.x) * (b.y - a.y);
    let sum = area + a.inv_depth + b.inv_depth + c.inv_depth;
    // a triangle that faces away is the back of a surface
    if !sum.is_finite() || area <= 1e-12 {
        return;
    }
    let columns = pixel_range(a.x, b.x, c.x, nearest.width());
    let rows = pixel_range(a.y, b.y, c.y, nearest.height());
    let (Some((x0, x1)), Some((y0, y1))) = (columns, rows) else {
        return;
    };
    const EDGE: f64 = -1e-9;
    let inv_area = 1.0 / area;
    for y in y0..=y1 {
        for x in x0..=x1 {
            let (px, py) = (x as f64, y as f64);
            let weight_b = ((px - a.x) * (c.y - a.y) - (c.x - a.x) * (py - a.y)) * inv_area;
            let weight_c = ((b.x - a.x) * (py - a.y) - (px - a.x) * (b.y - a.y)) * inv_area;
            let weight_a = 1.0 - weight_b - weight_c;
            if weight_a >= EDGE && weight_b >= EDGE && weight_c >= EDGE {
                let inv = weight_a * a.inv_depth + weight_b * b.inv_depth + weight_c * c.inv_depth;
                if inv as f32 > nearest.at(x, y) {
                    nearest.set(x, y, inv as f32);
                }
            }
        }
    }
}

/// Inclusive range of pixel centres between the smallest and the largest coordinate.
///
/// Casts instead of `ceil` and `floor`, which are calls into the C library on plain x86-64.
fn pixel_range(a: f64, b: f64, c: f64, size: usize) -> Option<(usize, usize)> {
    let (low, high) = (a.min(b).min(c).max(0.0), a.max(b).max(c));
    if high < 0.0 {
        return None;
    }
    let truncated = low as usize;
    let first = truncated + usize::from((truncated as f64) < low);
    let last = (high as usize).min(size.checked_sub(1)?);
    (first <= last).then_some((first, last))
}

/// Fills pixels that no triangle covers with the nearest depth pixel that falls on them: thin
/// structures and the rims of objects.
fn draw_points(nearest: &mut Image<f32>, vertices: &[Vertex]) {
    let (w, h) = (nearest.width() as f64, nearest.height() as f64);
    let mut points: Image<f32> = nearest.map(|_| 0.0);
    for v in vertices.iter().filter(|v| v.inv_depth.is_finite()) {
        let (x, y) = (v.x + 0.5, v.y + 0.5);
        if x >= 0.0 && y >= 0.0 && x < w && y < h {
            let (x, y, inv) = (x as usize, y as usize, v.inv_depth as f32);
            if nearest.at(x, y) == 0.0 && inv > points.at(x, y) {
                points.set(x, y, inv);
            }
        }
    }
    for (n, p) in nearest.as_mut_slice().iter_mut().zip(points.as_slice()) {
        *n = n.max(*p);
    }
}
