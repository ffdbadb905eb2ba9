//! The image that is aligned: intensity and gradient per level, interleaved for sampling.

use monogrid_geometry::Pinhole;
use monogrid_image::lanes::{F32x8, I32x8, Lanes};
use monogrid_image::{GrayImage, Pyramid, pyramid_intrinsics};
use wide::f32x4;

/// One level: intensity and halved central differences side by side, so that one bilinear look-up
/// touches two cache lines.
#[derive(Clone, Debug, Default)]
pub struct TargetLevel {
    /// Width, px.
    pub width: usize,
    /// Height, px.
    pub height: usize,
    /// Focal lengths and principal point `[fx, fy, cx, cy]`, px.
    pub intrinsics: [f32; 4],
    /// `[intensity, d/dx, d/dy, 0]` per pixel, row-major.
    samples: Vec<[f32; 4]>,
}

impl TargetLevel {
    /// Bilinear `[intensity, d/dx, d/dy, 0]` between a pixel and the next ones; the caller has
    /// checked [`Self::contains_lanes`].
    #[inline(always)]
    fn sample(&self, (x, fx): (i32, f32), (y, fy): (i32, f32)) -> f32x4 {
        let i = y as usize * self.width + x as usize;
        let (Some(top), Some(bottom)) = (
            self.samples.get(i..i + 2),
            self.samples.get(i + self.width..i + self.width + 2),
        ) else {
            return f32x4::ZERO;
        };
        let [a, b, c, d] = [top[0], top[1], bottom[0], bottom[1]].map(f32x4::new);
        let (top, bottom) = (a + fx * (b - a), c + fx * (d - c));
        top + fy * (bottom - top)
    }

    /// Bilinear `[intensity, d/dx, d/dy]` at the places that the mask says; 0 at the others.
    #[inline(always)]
    pub(crate) fn sample_lanes<L: Lanes>(
        &self,
        lanes: L,
        u: L::F32,
        v: L::F32,
        mask: L::F32,
    ) -> [L::F32; 3] {
        // those that do not count are read from a corner, so that there is no branch for each
        let (u, v) = (mask & u, mask & v);
        let (x, y) = (u.truncated(), v.truncated());
        let (fx, fy) = (u - x.to_f32(), v - y.to_f32());
        let (x, y, fx, fy) = (x.to_array(), y.to_array(), fx.to_array(), fy.to_array());
        let mut by_place = [f32x4::ZERO; 8];
        for (l, place) in by_place.iter_mut().enumerate() {
            *place = self.sample((x[l], fx[l]), (y[l], fy[l]));
        }
        let [intensity, du, dv, _] = by_kind(lanes, by_place);
        [mask & intensity, mask & du, mask & dv]
    }

    /// Which pixels are far enough inside for value and gradient, as a mask; not those that are no
    /// numbers.
    #[inline(always)]
    pub(crate) fn contains_lanes<L: Lanes>(&self, lanes: L, u: L::F32, v: L::F32) -> L::F32 {
        let one = lanes.splat(1.0);
        let right = lanes.splat(self.width as f32 - 2.0);
        let bottom = lanes.splat(self.height as f32 - 2.0);
        u.gt(one) & v.gt(one) & u.lt(right) & v.lt(bottom)
    }
}

/// Intensity and gradient of each pixel; 0 at the border.
fn samples(image: &GrayImage) -> Vec<[f32; 4]> {
    let (width, height) = (image.width(), image.height());
    let mut samples = Vec::with_capacity(width * height);
    samples.resize(width, [0.0; 4]);
    for y in 1..height - 1 {
        samples.push([0.0; 4]);
        let vertical = image.row(y - 1)[1..].iter().zip(&image.row(y + 1)[1..]);
        let pixels = image.row(y).windows(3).zip(vertical);
        samples.extend(pixels.map(|(beside, (above, below))| {
            let [left, at, right] = [beside[0], beside[1], beside[2]];
            [at, 0.5 * (right - left), 0.5 * (below - above), 0.0]
        }));
        samples.push([0.0; 4]);
    }
    samples.resize(width * height, [0.0; 4]);
    samples
}

/// Four numbers of eight points, point by point, as those of all points, kind by kind.
#[inline(always)]
pub(crate) fn by_kind<L: Lanes>(lanes: L, points: [f32x4; 8]) -> [L::F32; 4] {
    let [a, b, c, d, e, f, g, h] = points;
    let (first, last) = (
        f32x4::transpose([a, b, c, d]),
        f32x4::transpose([e, f, g, h]),
    );
    let kind = |kind: usize| {
        let ([a, b, c, d], [e, f, g, h]) = (first[kind].to_array(), last[kind].to_array());
        lanes.f32s(&[a, b, c, d, e, f, g, h])
    };
    [kind(0), kind(1), kind(2), kind(3)]
}

/// And back.
#[inline(always)]
pub(crate) fn by_point<V: F32x8>([a, b, c, d]: [V; 4]) -> [f32x4; 8] {
    let kinds = [a.to_array(), b.to_array(), c.to_array(), d.to_array()];
    let half = |from: usize| {
        f32x4::transpose(
            kinds.map(|k| f32x4::new([k[from], k[from + 1], k[from + 2], k[from + 3]])),
        )
    };
    let ([a, b, c, d], [e, f, g, h]) = (half(0), half(4));
    [a, b, c, d, e, f, g, h]
}

/// A frame prepared as the target of an alignment.
#[derive(Clone, Debug, Default)]
pub struct Target {
    /// Levels, finest (full resolution) first; level 0 is empty unless it was asked for.
    pub levels: Vec<TargetLevel>,
}

impl Target {
    /// Prepares the levels `finest..=coarsest` (as far as the pyramid has them).
    #[must_use]
    pub fn new(pyramid: &Pyramid, pinhole: &Pinhole, finest: usize, coarsest: usize) -> Self {
        let intrinsics = pyramid_intrinsics(pinhole, pyramid.num_levels());
        let levels = intrinsics
            .iter()
            .enumerate()
            .map(|(level, k)| {
                if level < finest || level > coarsest {
                    return TargetLevel::default();
                }
                let image = pyramid.level(level);
                let (width, height) = (image.width(), image.height());
                TargetLevel {
                    width,
                    height,
                    intrinsics: [k.fx as f32, k.fy as f32, k.cx as f32, k.cy as f32],
                    samples: samples(image),
                }
            })
            .collect();
        Self { levels }
    }

    /// The coarsest prepared level.
    #[must_use]
    pub fn coarsest_level(&self) -> usize {
        self.levels
            .iter()
            .rposition(|level| level.width > 0)
            .unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_image::lanes::Baseline;
    use wide::f32x8;

    #[test]
    fn eight_places_are_what_each_of_them_is_alone() {
        let image = GrayImage::from_fn(40, 30, |x, y| ((37 * x + 101 * y + x * y) % 251) as f32);
        let pinhole = Pinhole::new(30.0, 30.0, 19.5, 14.5);
        let target = Target::new(&Pyramid::new(image.clone(), 1), &pinhole, 0, 0);
        let level = &target.levels[0];
        let u = [1.5, 20.25, 37.9, 3.0, f32::NAN, -4.0, 1e9, 12.75];
        let v = [1.5, 9.125, 27.9, 20.5, 5.0, 5.0, 5.0, 27.0];
        let places = [u, v].map(|v| Baseline.f32s(&v));
        let mask = level.contains_lanes(Baseline, places[0], places[1]);
        assert_eq!(mask.to_bitmask(), 0b1000_1111);
        let found = level.sample_lanes(Baseline, places[0], places[1], mask);
        for l in 0..8 {
            let found = found.map(|kind| kind.to_array()[l]);
            if mask.to_bitmask() >> l & 1 == 0 {
                assert_eq!(found, [0.0; 3]);
                continue;
            }
            let grey = |x: f32, y: f32| monogrid_image::bilinear(&image, x, y).unwrap();
            let (x, y) = (u[l], v[l]);
            let expected = [
                grey(x, y),
                0.5 * (grey(x + 1.0, y) - grey(x - 1.0, y)),
                0.5 * (grey(x, y + 1.0) - grey(x, y - 1.0)),
            ];
            for (found, expected) in found.into_iter().zip(expected) {
                assert!((found - expected).abs() < 1e-3, "{l}: {found} {expected}");
            }
        }
    }

    #[test]
    fn kinds_and_points_change_places() {
        let kinds: [f32x8; 4] = std::array::from_fn(|kind| {
            Baseline.f32s(&std::array::from_fn(|point| (10 * kind + point) as f32))
        });
        let points = by_point(kinds);
        assert_eq!(points[5].to_array(), [5.0, 15.0, 25.0, 35.0]);
        assert_eq!(
            by_kind(Baseline, points).map(f32x8::to_array),
            kinds.map(f32x8::to_array)
        );
    }
}
