//! Sources projected onto planes parallel to the keyframe's image.

use crate::bilinear::bilinear;
use crate::multi_view::SourceView;
use crate::projection::Projection;
use monogrid_geometry::Pinhole;
use monogrid_image::Image;
use wide::{f32x8, i16x8};

/// Pixels that are looked up together.
pub(super) const LANES: usize = 8;

/// Sources see a pixel that keeps this distance from their border, px.
const MARGIN_PX: f32 = 2.0;
/// Where all of eight pixels are further than this outside of a source, no window that it sees reaches them, px.
const BESIDE_PX: f32 = 8.0;
/// Nothing nearer to a source than this share of the plane's distance is seen.
const NEAREST: f32 = 1e-3;

/// The length of rows that are worked on eight at a time, with room for what begins in the last eight.
pub(super) fn padded(width: usize) -> usize {
    width.next_multiple_of(LANES) + LANES
}

/// A source at the size of the sweep.
#[derive(Debug)]
pub(super) struct Source {
    /// Sums of 2x2 pixels: as exact as means, and half as long to look up.
    image: Image<u16>,
    projection: Projection,
}

impl Source {
    /// Of a full image, with the camera of the half one.
    pub fn new(source: &SourceView, camera: &Pinhole) -> Self {
        Self {
            image: sums_of_four(source.image),
            projection: Projection::new(&source.source_from_keyframe, camera),
        }
    }

    /// Where a pixel of that inverse depth is seen, px; `None` behind the source.
    pub fn project(&self, pixel: [f64; 2], idepth: f64) -> Option<[f64; 2]> {
        let p = self.projection.ray(pixel) + self.projection.translation * idepth;
        (p.z > f64::from(NEAREST)).then(|| [p.x / p.z, p.y / p.z])
    }

    /// The source as it would look from the keyframe if all of it had that inverse depth.
    pub fn at(&self, idepth: f32) -> WarpOfPlane<'_> {
        let [step, row_step, column_1] = self.projection.columns;
        let first = column_1 + self.projection.translation * f64::from(idepth);
        let [step, row_step, first] =
            [step, row_step, first].map(|v| [v.x as f32, v.y as f32, v.z as f32]);
        WarpOfPlane {
            image: &self.image,
            first,
            step,
            row_step,
        }
    }
}

/// The sums of 2x2 pixels, where [`monogrid_image::half_size`] has their means.
pub(super) fn sums_of_four(image: &Image<u8>) -> Image<u16> {
    Image::from_fn(image.width() / 2, image.height() / 2, |x, y| {
        let of_row = |y: usize| {
            let row = image.row(y);
            u16::from(row[2 * x]) + u16::from(row[2 * x + 1])
        };
        of_row(2 * y) + of_row(2 * y + 1)
    })
}

/// A source, projected onto a plane.
#[derive(Debug)]
pub(super) struct WarpOfPlane<'a> {
    image: &'a Image<u16>,
    /// Where the first pixel of the keyframe is seen, homogeneous, and how that moves from pixel to pixel and from row to row.
    first: [f32; 3],
    step: [f32; 3],
    row_step: [f32; 3],
}

impl WarpOfPlane<'_> {
    /// The pixels of a row, eight at a time: the source there in quarters of a grey level (where it does not see the pixel, at its
    /// border; 0 far from it), and 0, or infinity where it does not see them.
    pub fn row(&self, y: usize, grey: &mut [i16], unseen: &mut [f32]) {
        let last = [self.image.width(), self.image.height()]
            .map(|edge| f32x8::splat((edge as f32 - 1.001).max(0.0)));
        let [margin, beside, nearest] = [MARGIN_PX, -BESIDE_PX, NEAREST].map(f32x8::splat);
        let start = std::array::from_fn(|i| self.first[i] + y as f32 * self.row_step[i]);
        let start: [f32x8; 3] = start.map(f32x8::splat);
        let step = self.step.map(f32x8::splat);
        let lanes = f32x8::new(std::array::from_fn(|lane| lane as f32));
        let (grey, unseen) = (grey.as_chunks_mut().0, unseen.as_chunks_mut().0);
        for (eight, (grey, unseen)) in grey.iter_mut().zip(unseen).enumerate() {
            let x = lanes + f32x8::splat((eight * LANES) as f32);
            let [px, py, pz]: [f32x8; 3] = std::array::from_fn(|i| start[i] + x * step[i]);
            let inverse = f32x8::ONE / pz.fast_max(nearest);
            let (u, v) = (px * inverse, py * inverse);
            let is_seen = pz.simd_gt(nearest) & are_inside([u, v], last, margin);
            let inside = |at: f32x8, last: f32x8| at.fast_max(f32x8::ZERO).fast_min(last);
            if is_seen.none() && are_inside([u, v], last, beside).none() {
                grey.fill(0);
                unseen.fill(f32::INFINITY);
                continue;
            }
            let sums: [f32; LANES] = bilinear(self.image, inside(u, last[0]), inside(v, last[1]));
            let rounded = (f32x8::new(sums) + f32x8::HALF).fast_trunc_int();
            *grey = i16x8::from_i32x8_truncate(rounded).to_array();
            let infinite = f32x8::splat(f32::INFINITY);
            *unseen = is_seen.select(f32x8::ZERO, infinite).to_array();
        }
    }
}

/// Which places are in an image, whose last pixels are given, and at least so far from its border.
#[inline]
fn are_inside([u, v]: [f32x8; 2], last: [f32x8; 2], margin: f32x8) -> f32x8 {
    u.simd_ge(margin)
        & v.simd_ge(margin)
        & u.simd_le(last[0] - margin)
        & v.simd_le(last[1] - margin)
}
