//! A tiny renderer for tests: the inside of a textured room with boxes, exact depth and pose.

use monogrid_depth::{DepthMap, DepthPixel, HostFrame, PixelFilter, StereoFrame};
use monogrid_geometry::{Pinhole, Rotation, Se3, Vec2, Vec3};
use monogrid_image::{GrayImage, Mask};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Metres per unit of length: the typical depth of the room, so that inverse depths are about 1.
pub const UNIT: f64 = 2.7;

pub struct World {
    /// Axis-aligned boxes (low corner, high corner); the first is the room, seen from inside.
    boxes: Vec<(Vec3, Vec3)>,
    /// Samples per pixel and axis.
    pub supersampling: usize,
}

pub struct View {
    pub image: GrayImage,
    /// z of each pixel centre.
    pub depth: GrayImage,
    pub world_from_camera: Se3,
}

impl World {
    pub fn room() -> Self {
        let b = |a: [f64; 3], c: [f64; 3]| (Vec3::from(a) / UNIT, Vec3::from(c) / UNIT);
        Self {
            boxes: vec![
                b([-3.0, -1.5, -2.0], [3.0, 1.3, 4.0]),
                b([-1.2, 0.2, 1.8], [-0.4, 1.3, 2.4]),
                b([0.5, -0.3, 2.4], [1.4, 1.3, 3.2]),
                b([-2.6, -0.9, 3.0], [-1.6, 0.1, 4.0]),
                b([-0.2, 0.9, 1.2], [0.3, 1.3, 1.6]),
                b([-0.5, -1.1, 3.6], [0.3, -0.4, 4.0]),
            ],
            supersampling: 2,
        }
    }

    /// Distance, box number and face of the nearest hit.
    fn hit(&self, origin: &Vec3, ray: &Vec3) -> (f64, usize, usize) {
        let mut best = (f64::INFINITY, 0, 0);
        for (index, (low, high)) in self.boxes.iter().enumerate() {
            let (mut near, mut far) = ((f64::NEG_INFINITY, 0), (f64::INFINITY, 0));
            for axis in 0..3 {
                let (a, b) = (
                    (low[axis] - origin[axis]) / ray[axis],
                    (high[axis] - origin[axis]) / ray[axis],
                );
                if a.min(b) > near.0 {
                    near = (a.min(b), axis);
                }
                if a.max(b) < far.0 {
                    far = (a.max(b), axis);
                }
            }
            if near.0 > far.0 {
                continue;
            }
            let (t, axis) = if index == 0 { far } else { near };
            if t > 1e-6 && t < best.0 {
                best = (t, index, axis);
            }
        }
        best
    }

    fn shade(&self, point: &Vec3, index: usize, axis: usize) -> f64 {
        let (u, v) = match axis {
            0 => (point.y, point.z),
            1 => (point.x, point.z),
            _ => (point.x, point.y),
        };
        let seed = (index * 3 + axis) as u64 + 1;
        let mut value = 70.0 + 25.0 * ((seed * 7919 % 5) as f64);
        for (k, wavelength) in [0.6, 0.3, 0.15, 0.075, 0.04].into_iter().enumerate() {
            let amplitude = [70.0, 60.0, 45.0, 35.0, 24.0][k];
            let wavelength = wavelength / UNIT;
            value +=
                amplitude * (noise(u / wavelength, v / wavelength, seed * 31 + k as u64) - 0.5);
        }
        value.clamp(0.0, 255.0)
    }

    pub fn render(&self, pinhole: &Pinhole, size: (usize, usize), world_from_camera: &Se3) -> View {
        let n = self.supersampling;
        let rotation = world_from_camera.rotation_matrix();
        let origin = world_from_camera.translation;
        let trace = |x: f64, y: f64| {
            let ray = rotation * pinhole.unproject(&Vec2::new(x, y));
            let (t, index, axis) = self.hit(&origin, &ray);
            (t, self.shade(&(origin + ray * t), index, axis))
        };
        let mut depth = GrayImage::filled(size.0, size.1, 0.0);
        let image = GrayImage::from_fn(size.0, size.1, |x, y| {
            depth.set(x, y, trace(x as f64, y as f64).0 as f32);
            let mut sum = 0.0;
            for i in 0..n * n {
                let offset = |k: usize| (k as f64 + 0.5) / n as f64 - 0.5;
                sum += trace(x as f64 + offset(i % n), y as f64 + offset(i / n)).1;
            }
            (sum / (n * n) as f64) as f32
        });
        View {
            image,
            depth,
            world_from_camera: *world_from_camera,
        }
    }
}

fn hash(x: i64, y: i64, seed: u64) -> f64 {
    let mut z = (x as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15)
        ^ (y as u64).wrapping_mul(0xC2B2_AE3D_27D4_EB4F)
        ^ seed.wrapping_mul(0x1656_67B1_9E37_79F9);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    (z >> 11) as f64 / (1u64 << 53) as f64
}

/// Smooth value noise in [0, 1].
fn noise(x: f64, y: f64, seed: u64) -> f64 {
    let (ix, iy) = (x.floor(), y.floor());
    let fade = |t: f64| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
    let (fx, fy) = (fade(x - ix), fade(y - iy));
    let (ix, iy) = (ix as i64, iy as i64);
    let top = hash(ix, iy, seed) * (1.0 - fx) + hash(ix + 1, iy, seed) * fx;
    let bottom = hash(ix, iy + 1, seed) * (1.0 - fx) + hash(ix + 1, iy + 1, seed) * fx;
    top * (1.0 - fy) + bottom * fy
}

/// Deterministic standard normal numbers.
pub struct Normal(pub u64);

impl Normal {
    pub fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(1);
        hash(self.0 as i64, 17, 99).max(1e-12)
    }
    pub fn next(&mut self) -> f64 {
        let (a, b) = (self.uniform(), self.uniform());
        (-2.0 * a.ln()).sqrt() * (std::f64::consts::TAU * b).cos()
    }
}

/// Adds sensor noise and rounds to whole grey levels as a camera does.
pub fn sensor(image: &GrayImage, sigma: f32, seed: u64) -> GrayImage {
    let mut normal = Normal(seed << 32);
    image.map(|v| (v + sigma * normal.next() as f32).round().clamp(0.0, 255.0))
}

pub fn pinhole_of(size: (usize, usize)) -> Pinhole {
    let f = 0.82 * size.0 as f64;
    Pinhole::new(f, f, size.0 as f64 / 2.0 - 0.5, size.1 as f64 / 2.0 - 0.5)
}

/// A frame whose pose is exact.
pub fn frame(image: &GrayImage, frame_from_keyframe: Se3) -> StereoFrame<'_> {
    StereoFrame {
        image,
        frame_from_keyframe,
        gain: 1.0,
        bias: 0.0,
        residual_rms: 3.0,
        pose_sigma_trans: 0.0,
        pose_sigma_rot: 0.0,
        id: 1,
    }
}

pub fn host(image: GrayImage, pinhole: Pinhole) -> Arc<HostFrame> {
    let mask = Mask::filled(image.width(), image.height(), 255);
    Arc::new(HostFrame::new(image, mask, pinhole).expect("valid test images"))
}

/// A hand-held camera `time` seconds into its way: an arc with some forward motion and turning.
pub fn handheld(time: f64) -> Se3 {
    let t = time;
    let position = Vec3::new(
        0.35 * (0.9 * t).sin() + 0.03 * (5.0 * t).sin(),
        0.12 * (1.3 * t + 0.4).sin() + 0.01 * (7.0 * t).cos(),
        0.25 * (0.6 * t).sin(),
    );
    let rotation = Rotation::from_euler_angles(
        0.05 * (1.1 * t).sin(),
        0.12 * (0.7 * t + 0.2).sin(),
        0.03 * (1.7 * t).sin(),
    );
    Se3::new(rotation, position / UNIT)
}

pub fn disturbed(pose: &Se3, sigma_trans: f64, sigma_rot: f64, normal: &mut Normal) -> Se3 {
    let mut n = |s: f64| s * normal.next();
    let twist = monogrid_geometry::Vec6::new(
        n(sigma_trans),
        n(sigma_trans),
        n(sigma_trans),
        n(sigma_rot),
        n(sigma_rot),
        n(sigma_rot),
    );
    Se3::exp(&twist) * *pose
}

/// Errors of a depth map against the truth.
#[derive(Debug)]
#[allow(dead_code, reason = "all of it is printed where a test fails")]
pub struct Quality {
    /// Pixels with own gradient of at least 5 away from the border.
    pub textured: usize,
    /// Share of them with a confirmed depth.
    pub dense: f64,
    /// Share of them within 3 % (of inverse depth).
    pub within_3: f64,
    /// Share of the known within 3 %.
    pub precise: f64,
    /// Share of the known wrong by more than 20 %.
    pub gross: f64,
    /// Median relative error of the known.
    pub bias: f64,
    /// Median, robust deviation and mean of the normalised error.
    pub normal_median: f64,
    pub normal_deviation: f64,
    pub normal_std: f64,
    pub within_2_sigma: f64,
}

pub fn median(values: &mut [f64]) -> f64 {
    if values.is_empty() {
        return f64::NAN;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

pub fn quality(map: &DepthMap, depth: &GrayImage, min_validity: u8) -> Quality {
    let (w, h) = (depth.width(), depth.height());
    let gradient = map.host().gradient.magnitude();
    let filter = PixelFilter {
        min_validity,
        ..PixelFilter::default()
    };
    let place = |p: DepthPixel| ((usize::from(p.x), usize::from(p.y)), p);
    let known: BTreeMap<(usize, usize), DepthPixel> = map.pixels(filter).map(place).collect();
    let (mut textured, mut close, mut gross) = (0usize, 0usize, 0usize);
    let (mut relative, mut normal) = (Vec::new(), Vec::new());
    for y in 0..h {
        for x in 0..w {
            if gradient.at(x, y) < 5.0 {
                continue;
            }
            textured += 1;
            let Some(&DepthPixel {
                idepth, idepth_var, ..
            }) = known.get(&(x, y))
            else {
                continue;
            };
            let truth = 1.0 / f64::from(depth.at(x, y));
            let error = f64::from(idepth) - truth;
            relative.push(error / truth);
            normal.push(error / f64::from(idepth_var).sqrt());
            close += usize::from((error / truth).abs() < 0.03);
            gross += usize::from((error / truth).abs() > 0.2);
        }
    }
    let known = relative.len().max(1) as f64;
    let middle = median(&mut normal.clone());
    let mut spread: Vec<f64> = normal.iter().map(|e| (e - middle).abs()).collect();
    let mean = normal.iter().sum::<f64>() / known;
    Quality {
        textured,
        dense: relative.len() as f64 / textured.max(1) as f64,
        within_3: close as f64 / textured.max(1) as f64,
        precise: close as f64 / known,
        gross: gross as f64 / known,
        bias: median(&mut relative.clone()),
        normal_median: middle,
        normal_deviation: 1.4826 * median(&mut spread),
        normal_std: (normal.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / known).sqrt(),
        within_2_sigma: normal.iter().filter(|e| e.abs() <= 2.0).count() as f64 / known,
    }
}
