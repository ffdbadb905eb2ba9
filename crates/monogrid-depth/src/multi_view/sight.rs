//! How a source sees a pixel.

use super::{MultiViewConfig, SourceView};
use monogrid_geometry::{Pinhole, Vec2, Vec3};
use monogrid_image::Image;

/// Samples of a patch: three times four lanes.
pub(super) const SAMPLES: usize = 12;
/// A diamond around the pixel (which itself adds little to its neighbours), offsets in px.
pub(super) const PATTERN: [[i32; 2]; SAMPLES] = [
    [0, -2],
    [-1, -1],
    [0, -1],
    [1, -1],
    [-2, 0],
    [-1, 0],
    [1, 0],
    [2, 0],
    [-1, 1],
    [0, 1],
    [1, 1],
    [0, 2],
];
/// Patches keep this distance from the borders of a source, px: twice the pattern (views that are 1.7 times as
/// large), half a pixel for derivatives, and one for the interpolation.
const MARGIN_PX: f64 = 6.0;
/// Sources that show a pixel smaller or larger than this are not compared.
const SIZE: std::ops::RangeInclusive<f64> = 0.6..=1.7;

/// The way from a pixel and its inverse depth to a source.
#[derive(Debug)]
pub(super) struct Projection<'a> {
    pub image: &'a Image<u8>,
    /// K R K^-1, by columns.
    columns: [Vec3; 3],
    /// K t / s.
    translation: Vec3,
}

impl<'a> Projection<'a> {
    pub fn new(source: &SourceView<'a>, camera: &Pinhole) -> Self {
        // in units of the keyframe: projections do not depend on those of the source, sizes shall not either
        let mut pose = source.source_from_keyframe;
        pose.translation /= pose.scale;
        let to_pixels = |p: Vec3| {
            Vec3::new(
                camera.fx * p.x + camera.cx * p.z,
                camera.fy * p.y + camera.cy * p.z,
                p.z,
            )
        };
        let of_ray = |ray: Vec3| to_pixels(pose.rotation * ray);
        Self {
            image: source.image,
            columns: [
                of_ray(Vec3::new(1.0 / camera.fx, 0.0, 0.0)),
                of_ray(Vec3::new(0.0, 1.0 / camera.fy, 0.0)),
                of_ray(camera.unproject(&Vec2::zeros())),
            ],
            translation: to_pixels(pose.translation),
        }
    }
}

/// A source as one pixel sees it.
#[derive(Debug)]
pub(super) struct Sight<'a> {
    projection: &'a Projection<'a>,
    /// K R K^-1 (x, y, 1).
    ray: Vec3,
    /// Motion in the source per px of the keyframe, along x and y.
    axes: [[f64; 2]; 2],
    /// Offsets of the samples in the source, px.
    offsets: [[f32; 2]; SAMPLES],
    /// px that the match moves along the gradient, in the keyframe, per unit of ln(rho).
    pub disparity: f64,
}

impl<'a> Sight<'a> {
    /// `None` where the source does not see the pixel, from too far or near, or without disparity.
    /// `direction` is the unit gradient.
    pub fn new(
        projection: &'a Projection<'a>,
        [x, y]: [f64; 2],
        idepth: f64,
        direction: [f64; 2],
        config: &MultiViewConfig,
    ) -> Option<Self> {
        let [column_x, column_y, column_1] = &projection.columns;
        let ray = column_x * x + column_y * y + column_1;
        let shift = projection.translation * idepth;
        let p = ray + shift;
        if !SIZE.contains(&p.z) {
            return None;
        }
        let at = [p.x / p.z, p.y / p.z];
        if !is_inside(at, projection.image) {
            return None;
        }
        // derivative of (p.x / p.z, p.y / p.z)
        let moved_by = |d: &Vec3| [(d.x - at[0] * d.z) / p.z, (d.y - at[1] * d.z) / p.z];
        let axes = [moved_by(column_x), moved_by(column_y)];
        let motion = moved_by(&shift);
        if motion[0] * motion[0] + motion[1] * motion[1] > config.max_disparity_px.powi(2) {
            return None;
        }
        let area = axes[0][0] * axes[1][1] - axes[0][1] * axes[1][0];
        if !(SIZE.start().powi(2)..=SIZE.end().powi(2)).contains(&area) {
            return None;
        }
        // the motion in px of the keyframe
        let in_keyframe = [
            (motion[0] * axes[1][1] - motion[1] * axes[1][0]) / area,
            (axes[0][0] * motion[1] - axes[0][1] * motion[0]) / area,
        ];
        let disparity = (in_keyframe[0] * direction[0] + in_keyframe[1] * direction[1]).abs();
        (disparity >= config.min_disparity_px).then_some(Self {
            projection,
            ray,
            axes,
            offsets: [[0.0; 2]; SAMPLES],
            disparity,
        })
    }

    /// Makes the patch ready for [`Sight::values`].
    pub fn lay_out_patch(&mut self) {
        let [ex, ey] = self.axes;
        for (offset, [dx, dy]) in self.offsets.iter_mut().zip(PATTERN) {
            let (dx, dy) = (f64::from(dx), f64::from(dy));
            *offset = [
                (ex[0] * dx + ey[0] * dy) as f32,
                (ex[1] * dx + ey[1] * dy) as f32,
            ];
        }
    }

    /// Where the pixel would be seen; `None` near the border and outside.
    pub fn center(&self, idepth: f64) -> Option<[f64; 2]> {
        let p = self.ray + self.projection.translation * idepth;
        let at = [p.x / p.z, p.y / p.z];
        (p.z > 0.0 && is_inside(at, self.projection.image)).then_some(at)
    }

    /// Motion of [`Sight::center`] per unit of ln(rho), px.
    pub fn motion(&self, idepth: f64) -> [f64; 2] {
        let shift = self.projection.translation * idepth;
        let p = self.ray + shift;
        let at = [p.x / p.z, p.y / p.z];
        [
            (shift.x - at[0] * shift.z) / p.z,
            (shift.y - at[1] * shift.z) / p.z,
        ]
    }

    /// Grey values of the patch around a point that [`Sight::center`] gave, or within a pixel of it.
    pub fn values(&self, [x, y]: [f64; 2]) -> [f32; SAMPLES] {
        let image = self.projection.image;
        let (x, y) = (x as f32, y as f32);
        // in two loops, of which the first vectorises
        let mut cells = [[0i32; 2]; SAMPLES];
        let mut shares = [[0.0f32; 2]; SAMPLES];
        for ((cell, share), [dx, dy]) in cells.iter_mut().zip(&mut shares).zip(&self.offsets) {
            let at = [x + dx, y + dy];
            *cell = [at[0] as i32, at[1] as i32];
            *share = [at[0] - cell[0] as f32, at[1] - cell[1] as f32];
        }
        let (grey, width) = (image.as_slice(), image.width());
        let mut values = [0.0; SAMPLES];
        for ((value, cell), share) in values.iter_mut().zip(&cells).zip(&shares) {
            *value = bilinear(grey, width, *cell, *share);
        }
        values
    }
}

fn is_inside([x, y]: [f64; 2], image: &Image<u8>) -> bool {
    x >= MARGIN_PX
        && y >= MARGIN_PX
        && x < image.width() as f64 - MARGIN_PX - 1.0
        && y < image.height() as f64 - MARGIN_PX - 1.0
}

/// The image between a pixel and its next ones; the caller keeps all of them inside.
#[inline]
fn bilinear(grey: &[u8], width: usize, [column, row]: [i32; 2], [fx, fy]: [f32; 2]) -> f32 {
    let first = row as usize * width + column as usize;
    let (Some(&[a, b]), Some(&[c, d])) = (
        grey.get(first..first + 2),
        grey.get(first + width..first + width + 2),
    ) else {
        return 0.0;
    };
    let (a, b, c, d) = (f32::from(a), f32::from(b), f32::from(c), f32::from(d));
    let (top, bottom) = (a + (b - a) * fx, c + (d - c) * fx);
    top + (bottom - top) * fy
}
