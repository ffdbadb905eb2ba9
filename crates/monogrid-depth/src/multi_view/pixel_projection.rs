//! How a source sees a pixel.

use super::{MultiViewConfig, SourceView};
use crate::projection::Projection;
use monogrid_geometry::{Pinhole, Vec3};
use monogrid_image::Image;
use monogrid_image::lanes::{Lanes, bilinear};

/// Largest disparity of a source, px: with far more, views differ too much.
const MAX_DISPARITY_PX: f64 = 80.0;

/// Samples that are looked up together.
const GROUP: usize = 6;
/// Samples of a patch: two groups, and three times four lanes.
pub(super) const SAMPLES: usize = 2 * GROUP;
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
/// Patches keep this distance from the borders of a source, px: twice the pattern (views that are
/// 1.7 times as large), half a pixel for derivatives, and one for the interpolation.
const MARGIN_PX: f64 = 6.0;
/// Sources that show a pixel smaller or larger than this are not compared.
const SIZE: std::ops::RangeInclusive<f64> = 0.6..=1.7;

/// A source and the way to it from a pixel and its inverse depth.
#[derive(Debug)]
pub(super) struct Projected<'a> {
    pub image: &'a Image<u8>,
    projection: Projection,
}

impl<'a> Projected<'a> {
    /// Of those that are of the size of `image`.
    pub fn of_sources(
        image: &Image<u8>,
        camera: &Pinhole,
        sources: &[SourceView<'a>],
    ) -> Vec<Self> {
        let same_size = sources.iter().filter(|s| s.image.same_size(image));
        same_size.map(|source| Self::new(source, camera)).collect()
    }

    pub fn new(source: &SourceView<'a>, camera: &Pinhole) -> Self {
        Self {
            image: source.image,
            projection: Projection::new(&source.source_from_keyframe, camera),
        }
    }
}

/// A source as one pixel sees it.
#[derive(Debug)]
pub(super) struct PixelProjection<'a> {
    image: &'a Image<u8>,
    /// K t / s.
    translation: Vec3,
    /// K R K^-1 (x, y, 1).
    ray: Vec3,
    /// Motion in the source per px of the keyframe, along x and y.
    axes: [[f64; 2]; 2],
    /// Offsets of the samples in the source along x and y, px: those of either group.
    offsets: [[[f32; 8]; 2]; 2],
    /// px that the match moves along the gradient, in the keyframe, per unit of ln(rho).
    pub disparity: f64,
}

impl<'a> PixelProjection<'a> {
    /// `None` where the source does not see the pixel, from too far or near, or without disparity.
    /// `direction` is the unit gradient.
    pub fn new(
        source: &Projected<'a>,
        pixel: [f64; 2],
        idepth: f64,
        direction: [f64; 2],
        config: &MultiViewConfig,
    ) -> Option<Self> {
        let (image, translation) = (source.image, source.projection.translation);
        let [column_x, column_y, _] = &source.projection.columns;
        let ray = source.projection.ray(pixel);
        let shift = translation * idepth;
        let p = ray + shift;
        if !SIZE.contains(&p.z) {
            return None;
        }
        let at = [p.x / p.z, p.y / p.z];
        if !is_inside(at, image) {
            return None;
        }
        // derivative of (p.x / p.z, p.y / p.z)
        let moved_by = |d: &Vec3| [(d.x - at[0] * d.z) / p.z, (d.y - at[1] * d.z) / p.z];
        let axes = [moved_by(column_x), moved_by(column_y)];
        let motion = moved_by(&shift);
        if motion[0] * motion[0] + motion[1] * motion[1] > MAX_DISPARITY_PX.powi(2) {
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
            image,
            translation,
            ray,
            axes,
            offsets: [[[0.0; 8]; 2]; 2],
            disparity,
        })
    }

    /// Makes the patch ready for [`PixelProjection::values`].
    pub fn lay_out_patch(&mut self) {
        let [ex, ey] = self.axes;
        for (offsets, pattern) in self.offsets.iter_mut().zip(PATTERN.chunks(GROUP)) {
            *offsets = [0, 1].map(|axis| {
                let mut lanes = [0.0; 8];
                for (lane, [dx, dy]) in lanes.iter_mut().zip(pattern) {
                    *lane = (ex[axis] * f64::from(*dx) + ey[axis] * f64::from(*dy)) as f32;
                }
                lanes
            });
        }
    }

    /// Where the pixel would be seen; `None` near the border and outside.
    #[inline]
    pub fn center(&self, idepth: f64) -> Option<[f64; 2]> {
        let p = self.ray + self.translation * idepth;
        let at = [p.x / p.z, p.y / p.z];
        (p.z > 0.0 && self.shows(at)).then_some(at)
    }

    /// Whether the source shows the patch around a point.
    pub fn shows(&self, at: [f64; 2]) -> bool {
        is_inside(at, self.image)
    }

    /// Motion of [`PixelProjection::center`] per unit of ln(rho), px.
    #[inline]
    pub fn motion(&self, idepth: f64) -> [f64; 2] {
        let shift = self.translation * idepth;
        let p = self.ray + shift;
        let (x, y) = (p.x / p.z, p.y / p.z);
        [(shift.x - x * shift.z) / p.z, (shift.y - y * shift.z) / p.z]
    }

    /// Grey values of the patch around a point that [`PixelProjection::shows`], or within a pixel
    /// of one.
    #[inline(always)]
    pub fn values<L: Lanes>(&self, lanes: L, [x, y]: [f64; 2]) -> [f32; SAMPLES] {
        let (x, y) = (x as f32, y as f32);
        let mut values = [0.0; SAMPLES];
        for (values, [dx, dy]) in values.chunks_exact_mut(GROUP).zip(&self.offsets) {
            let (x, y) = (lanes.f32s(dx) + x, lanes.f32s(dy) + y);
            values.copy_from_slice(&bilinear::<GROUP, _, L>(lanes, self.image, x, y));
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
