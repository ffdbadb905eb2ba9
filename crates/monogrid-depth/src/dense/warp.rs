//! Sources projected onto planes parallel to the keyframe's image.

use crate::multi_view::SourceView;
use crate::projection::Projection;
use monogrid_geometry::Pinhole;
use monogrid_image::lanes::{F32x8, I32x8, LANES, Lanes, bilinear};
use monogrid_image::{Image, for_lanes};

/// Sources see a pixel that keeps this distance from their border, px.
const MARGIN_PX: f32 = 2.0;
/// Where all of eight pixels are further than this outside of a source, no window that it sees
/// reaches them, px.
const BESIDE_PX: f32 = 8.0;
/// Nothing nearer to a source than this share of the plane's distance is seen.
const NEAREST: f32 = 1e-3;

/// The length of rows that are worked on eight at a time, with room for what begins in the last
/// eight.
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
    /// Where the first pixel of the keyframe is seen, homogeneous, and how that moves from pixel to
    /// pixel and from row to row.
    first: [f32; 3],
    step: [f32; 3],
    row_step: [f32; 3],
}

for_lanes! {
    /// The pixels of a row, eight at a time: the source there in quarters of a grey level (where it
    /// does not see the pixel, at its border; 0 far from it), and 0, or infinity where it does not
    /// see them.
    pub(super) fn warp_row = warp_row_with, (
        warp: &WarpOfPlane<'_>,
        y: usize,
        grey: &mut [i16],
        unseen: &mut [f32],
    );
}

#[inline(always)]
pub(super) fn warp_row_with<L: Lanes>(
    eight: L,
    warp: &WarpOfPlane<'_>,
    y: usize,
    grey: &mut [i16],
    unseen: &mut [f32],
) {
    let last = [warp.image.width(), warp.image.height()]
        .map(|edge| eight.splat((edge as f32 - 1.001).max(0.0)));
    let (zero, nearest, infinite) = (
        eight.splat(0.0),
        eight.splat(NEAREST),
        eight.splat(f32::INFINITY),
    );
    let (margin, beside) = (eight.splat(MARGIN_PX), eight.splat(-BESIDE_PX));
    let start: [f32; 3] = std::array::from_fn(|i| warp.first[i] + y as f32 * warp.row_step[i]);
    let lanes = eight.f32s(&std::array::from_fn(|lane| lane as f32));
    let (grey, unseen) = (grey.as_chunks_mut().0, unseen.as_chunks_mut().0);
    for (index, (grey, unseen)) in grey.iter_mut().zip(unseen).enumerate() {
        let x = lanes + (index * LANES) as f32;
        let (px, py) = (x * warp.step[0] + start[0], x * warp.step[1] + start[1]);
        let pz = x * warp.step[2] + start[2];
        let inverse = eight.splat(1.0) / pz.max(nearest);
        let (u, v) = (px * inverse, py * inverse);
        let is_seen = pz.gt(nearest) & are_inside([u, v], last, margin);
        if is_seen.bits() == 0 && are_inside([u, v], last, beside).bits() == 0 {
            grey.fill(0);
            unseen.fill(f32::INFINITY);
            continue;
        }
        let (u, v) = (u.max(zero).min(last[0]), v.max(zero).min(last[1]));
        let sums: [f32; LANES] = bilinear(eight, warp.image, u, v);
        *grey = (eight.f32s(&sums) + 0.5).truncated().to_i16();
        *unseen = is_seen.select(zero, infinite).to_array();
    }
}

/// Which places are in an image, whose last pixels are given, and at least so far from its border.
#[inline(always)]
fn are_inside<V: F32x8>([u, v]: [V; 2], last: [V; 2], margin: V) -> V {
    u.ge(margin) & v.ge(margin) & u.le(last[0] - margin) & v.le(last[1] - margin)
}
