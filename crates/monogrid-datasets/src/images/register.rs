//! Depth images seen from the colour camera.

use super::DepthCalibration;
use monogrid_geometry::{Camera, Distortion, Pinhole, Se3, Vec2, Vec3};
use monogrid_image::Image;
use std::sync::OnceLock;

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
    /// Ideal coordinates of each depth pixel of a lens that distorts, NaN where its model has none.
    /// Made for the first image of the size that the calibration claims: one without images, or
    /// with others, may claim any.
    undistorted: OnceLock<Vec<Vec2>>,
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
        Self {
            calibration: *calibration,
            undistorted: OnceLock::new(),
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
        if self.is_registered() {
            let known = |z: f32| {
                if z.is_finite() && z > 0.0 {
                    z
                } else {
                    f32::NAN
                }
            };
            return Some(depth.map(known));
        }
        let mut nearest = Image::filled(self.width, self.height, 0.0f32);
        let mut points = nearest.clone();
        // two rows are projected at a time: of a large image all would take ten times its memory
        let (mut upper, mut lower) = (Vec::with_capacity(w), Vec::with_capacity(w));
        for y in 0..h {
            self.project_row(depth, y, &mut lower);
            draw_points(&mut points, &lower);
            if y > 0 {
                let rows = [(depth.row(y - 1), &*upper), (depth.row(y), &*lower)];
                draw_between(&mut nearest, rows, y - 1);
            }
            std::mem::swap(&mut upper, &mut lower);
        }
        // where no triangle is, the depth pixels: thin structures and the rims of objects
        let inv_depth = |(&mesh, &point): (&f32, &f32)| if mesh > 0.0 { mesh } else { point };
        let inv_depths = nearest.as_slice().iter().zip(points.as_slice());
        let depths = inv_depths.map(inv_depth);
        let depths = depths.map(|inv| if inv > 0.0 { 1.0 / inv } else { f32::NAN });
        Image::from_vec(self.width, self.height, depths.collect())
    }

    /// Whether depth images show just what the target does.
    fn is_registered(&self) -> bool {
        let camera = &self.calibration.camera;
        let size = (camera.width, camera.height);
        self.calibration.colour_from_depth == Se3::identity()
            && camera.distortion == Distortion::None
            && (camera.pinhole, size) == (self.target, (self.width, self.height))
    }

    /// Projects a row of depth pixels; NaN where there is none or it is behind the target.
    fn project_row(&self, depth: &Image<f32>, y: usize, vertices: &mut Vec<Vertex>) {
        let target_from_depth = self.calibration.colour_from_depth;
        let rotation = target_from_depth.rotation_matrix();
        vertices.clear();
        vertices.extend(depth.row(y).iter().enumerate().map(|(x, &z)| {
            let ray = self.ray(x, y);
            let point = rotation * (ray * f64::from(z)) + target_from_depth.translation;
            let pixel = self.target.project(&point);
            let is_ahead = point.z > 1e-6;
            Vertex {
                x: pixel.x,
                y: pixel.y,
                inv_depth: if is_ahead { 1.0 / point.z } else { f64::NAN },
            }
        }));
    }

    /// The ray with z = 1 of a depth pixel; NaN where the lens model has none.
    fn ray(&self, x: usize, y: usize) -> Vec3 {
        let camera = &self.calibration.camera;
        if camera.distortion == Distortion::None {
            return camera.pinhole.unproject(&Vec2::new(x as f64, y as f64));
        }
        let ideal = self.undistorted.get_or_init(|| undistorted(camera))[y * camera.width + x];
        Vec3::new(ideal.x, ideal.y, 1.0)
    }
}

/// Ideal coordinates of each pixel of a camera, NaN where its lens model has none.
fn undistorted(camera: &Camera) -> Vec<Vec2> {
    let pixels = (0..camera.height).flat_map(|y| (0..camera.width).map(move |x| (x, y)));
    let ideal = |(x, y)| camera.unproject(&Vec2::new(x as f64, y as f64));
    let or_none = |ray: Option<Vec3>| ray.map_or(Vec2::repeat(f64::NAN), |ray| ray.xy());
    pixels.map(ideal).map(or_none).collect()
}

/// Draws the mesh between two rows of depth pixels, the upper one of which is row `y`.
fn draw_between(nearest: &mut Image<f32>, [upper, lower]: [(&[f32], &[Vertex]); 2], y: usize) {
    for x in 1..upper.0.len() {
        let corner = |(depths, vertices): (&[f32], &[Vertex]), x: usize| (depths[x], vertices[x]);
        let [a, b] = [x - 1, x].map(|x| corner(upper, x));
        let [c, d] = [x - 1, x].map(|x| corner(lower, x));
        // the diagonal alternates, so that no direction is preferred
        let triangles = if (x - 1 + y).is_multiple_of(2) {
            [[a, b, d], [a, d, c]]
        } else {
            [[a, b, c], [b, d, c]]
        };
        for corners in triangles {
            if on_one_surface(corners.map(|(depth, _)| depth)) {
                draw_triangle(nearest, corners.map(|(_, vertex)| vertex));
            }
        }
    }
}

/// Whether three depth pixels are known and lie on one surface.
fn on_one_surface(depths: [f32; 3]) -> bool {
    let z = depths.map(f64::from);
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

/// Keeps the nearest of the depth pixels that fall on a pixel.
fn draw_points(points: &mut Image<f32>, vertices: &[Vertex]) {
    let (w, h) = (points.width() as f64, points.height() as f64);
    for v in vertices.iter().filter(|v| v.inv_depth.is_finite()) {
        let (x, y) = (v.x + 0.5, v.y + 0.5);
        if x >= 0.0 && y >= 0.0 && x < w && y < h {
            let (x, y, inv) = (x as usize, y as usize, v.inv_depth as f32);
            if inv > points.at(x, y) {
                points.set(x, y, inv);
            }
        }
    }
}
