//! A textured wall two units before the first of some cameras that stand beside each other, for
//! tests.

use crate::{KeyframeCamera, KeyframeScan};
use monogrid_geometry::{Pinhole, Vec2};
use monogrid_image::Image;
use monogrid_slam::DepthPixel;

pub(super) const CAMERA: KeyframeCamera = KeyframeCamera {
    pinhole: Pinhole {
        fx: 140.0,
        fy: 140.0,
        cx: 79.5,
        cy: 59.5,
    },
    width: 160,
    height: 120,
};

/// The wall, as a camera at that place sees it.
pub(super) fn wall(x: f64) -> Image<u8> {
    Image::from_fn(CAMERA.width, CAMERA.height, |u, v| {
        let ray = CAMERA.pinhole.unproject(&Vec2::new(u as f64, v as f64));
        let (a, b) = (2.0 * ray.x + x, 2.0 * ray.y);
        let grey = 128.0 + 50.0 * (31.0 * a + 9.0 * b).sin() + 50.0 * (23.0 * a - 17.0 * b).cos();
        grey as u8
    })
}

/// Depths that are all 4 % too large, in a keyframe whose unit is `scale`.
pub(super) fn depths(scale: f64) -> Vec<DepthPixel> {
    let idepth = (0.96 * scale / 2.0) as f32;
    (0..CAMERA.height as u16)
        .flat_map(|y| (0..CAMERA.width as u16).map(move |x| (x, y)))
        .map(|(x, y)| DepthPixel {
            x,
            y,
            idepth,
            idepth_var: (0.03 * idepth).powi(2),
        })
        .collect()
}

/// Share of the mapped depths of a keyframe of that unit that are right to within 2 %.
pub(super) fn share_right(scan: &KeyframeScan, scale: f64) -> f64 {
    let is_right = |idepth: f32| (f64::from(idepth) * 2.0 / scale - 1.0).abs() < 0.02;
    let num_right = scan.pixels().iter().filter(|p| is_right(p.idepth)).count();
    num_right as f64 / scan.num_pixels as f64
}
