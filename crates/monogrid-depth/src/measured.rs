//! Depth that a depth camera measured with a frame: one more observation of its pixels, with an
//! uncertainty of its own.

use crate::DepthPixel;
use crate::map::{DepthMap, Hypothesis};
use monogrid_geometry::{Pinhole, Se3, Vec2};
use monogrid_image::{GrayImage, Image, Mask};

/// Pixels this near to an edge of depth are not used: colours and depth of an edge are a pixel or
/// two apart, by registration and because the two cameras do not see at the same time.
const EDGE_RADIUS: usize = 2;
/// Depths within that radius of a pixel belong to one surface when the farthest is at most this
/// much above the nearest: a surface that is seen under 5 degrees at a focal length of 500 px.
const SAME_SURFACE_RATIO: f32 = 1.08;
/// A surface has moved where another was seen at this multiple of its depth: errors of the pose and
/// of matches at edges stay below it.
const MOVED_RATIO: f32 = 1.15;
/// Least distance of the two inverse depths, standard deviations of one measurement.
const MOVED_SIGMAS: f32 = 6.0;
/// How much larger the standard deviation of a pixel beside an edge is.
const EDGE_FACTOR: f32 = 10.0;
/// Confirmation of what was measured: as that of many observations.
const MEASURED_VALIDITY: u8 = 50;
/// A hypothesis and a measurement are of one surface within so many standard deviations.
const SAME_DEPTH_SIGMAS: f32 = 3.0;

/// What a depth camera measured in the image of a frame, in metres.
///
/// The standard deviation of a depth `z` is `sigma * z²`, as that of every camera that measures
/// disparities: the inverse depth has the same one everywhere.
#[derive(Clone, Debug)]
pub struct MeasuredDepth {
    /// 1/m, 0 where nothing was measured; negative beside an edge of depth; NaN where something
    /// moves.
    idepth: GrayImage,
    /// Standard deviation of all of it, 1/m.
    sigma: f32,
}

impl MeasuredDepth {
    /// From depths `z` (m; NaN, infinite or not positive = unknown) and their standard deviation at
    /// 1 m. Pixels beside an edge of depth count for the depth filter alone, where it knows nothing
    /// else, and with ten times the standard deviation: their texture may belong to either side.
    #[must_use]
    pub fn new(depth: &GrayImage, sigma: f32) -> Self {
        let inverse = |z: f32| {
            if z.is_finite() && z > 0.0 {
                1.0 / z
            } else {
                0.0
            }
        };
        let all = depth.map(inverse);
        let nearest = extremes(&all, f32::max);
        // a hole is no edge
        let known = all.map(|d| if d > 0.0 { d } else { f32::INFINITY });
        let farthest = extremes(&known, f32::min);
        let idepth = Image::from_fn(all.width(), all.height(), |x, y| {
            let (near, far) = (nearest.at(x, y), farthest.at(x, y));
            let limit = (SAME_SURFACE_RATIO * far).max(far + 6.0 * sigma);
            if near <= limit {
                all.at(x, y)
            } else {
                -all.at(x, y)
            }
        });
        Self { idepth, sigma }
    }

    /// From what [`Self::idepth`] and [`Self::sigma`] say.
    #[must_use]
    pub fn of_inverse(idepth: GrayImage, sigma: f32) -> Self {
        Self { idepth, sigma }
    }

    /// Inverse depths, 1/m, 0 where nothing was measured, negative beside an edge of depth, NaN
    /// where something moves.
    #[must_use]
    pub fn idepth(&self) -> &GrayImage {
        &self.idepth
    }

    /// Standard deviation of all inverse depths, 1/m.
    #[must_use]
    pub fn sigma(&self) -> f32 {
        self.sigma
    }

    /// Width and height, px.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        (self.idepth.width(), self.idepth.height())
    }

    /// The inverse depth (1/m) of a pixel and its standard deviation; `None` where it was not
    /// measured, beside an edge of depth, and outside of the image.
    #[must_use]
    pub fn at(&self, x: usize, y: usize) -> Option<(f32, f32)> {
        let is_inside = x < self.idepth.width() && y < self.idepth.height();
        let idepth = if is_inside { self.idepth.at(x, y) } else { 0.0 };
        (idepth > 0.0).then_some((idepth, self.sigma))
    }

    /// What [`Self::at`] says of the pixel nearest to a place in the image.
    #[must_use]
    pub fn near(&self, x: f64, y: f64) -> Option<(f32, f32)> {
        self.at((x + 0.5) as usize, (y + 0.5) as usize)
    }

    /// All that was measured, row-major, in units of so many metres.
    pub fn pixels(&self, unit: f32) -> impl Iterator<Item = DepthPixel> + '_ {
        let width = self.idepth.width();
        let all = self.idepth.as_slice().iter().enumerate();
        let known = all.filter(|(_, idepth)| **idepth > 0.0);
        known.map(move |(index, idepth)| DepthPixel {
            x: (index % width) as u16,
            y: (index / width) as u16,
            idepth: idepth * unit,
            idepth_var: (self.sigma * unit).powi(2),
        })
    }

    /// Leaves out what stands where something farther away was seen before: it has moved there.
    pub fn leave_out_moving(&mut self, before: &Self) {
        if before.size() != self.size() {
            return;
        }
        let noise = MOVED_SIGMAS * self.sigma;
        let all = self.idepth.as_mut_slice().iter_mut();
        for (now, then) in all.zip(before.idepth.as_slice()) {
            let limit = (MOVED_RATIO * then.abs()).max(then.abs() + noise);
            if *then != 0.0 && now.abs() > limit {
                *now = f32::NAN;
            }
        }
    }

    /// The pixels of `mask` without those where something moves.
    #[must_use]
    pub fn still(&self, mask: &Mask) -> Mask {
        if !mask.same_size(&self.idepth) {
            return mask.clone();
        }
        Image::from_fn(mask.width(), mask.height(), |x, y| {
            if self.idepth.at(x, y).is_nan() {
                0
            } else {
                mask.at(x, y)
            }
        })
    }

    /// These depths as another frame of this camera sees them: the nearest surface in front, and of
    /// that what is seen nearest to the centre of a pixel. `other_from_frame` has its translation
    /// in metres.
    #[must_use]
    pub fn seen_from(&self, other_from_frame: &Se3, pinhole: &Pinhole) -> Self {
        let (width, height) = self.size();
        let mut idepth = Image::filled(width, height, 0.0f32);
        let mut offsets = Image::filled(width, height, 0.0f64);
        let rotation = other_from_frame.rotation_matrix();
        for pixel in self.pixels(1.0) {
            let at = Vec2::new(pixel.x.into(), pixel.y.into());
            let ray = rotation * pinhole.unproject(&at);
            let point = ray + other_from_frame.translation * f64::from(pixel.idepth);
            if point.z < 0.1 {
                continue;
            }
            let seen = pinhole.project(&point);
            let (x, y) = (seen.x + 0.5, seen.y + 0.5);
            if x < 0.0 || y < 0.0 || x >= width as f64 || y >= height as f64 {
                continue;
            }
            let (x, y) = (x as usize, y as usize);
            let offset = (seen - Vec2::new(x as f64, y as f64)).norm_squared();
            let moved = (f64::from(pixel.idepth) / point.z) as f32;
            let before = idepth.at(x, y);
            let is_behind = moved * SAME_SURFACE_RATIO < before;
            let is_before = moved > before * SAME_SURFACE_RATIO;
            if is_before || (!is_behind && offset < offsets.at(x, y)) {
                idepth.set(x, y, moved);
                offsets.set(x, y, offset);
            }
        }
        Self {
            idepth,
            sigma: self.sigma,
        }
    }
}

/// Of every pixel the extreme value within [`EDGE_RADIUS`] of it, along rows and then columns.
fn extremes(image: &GrayImage, extreme: fn(f32, f32) -> f32) -> GrayImage {
    let (width, height) = (image.width(), image.height());
    let around =
        |at: usize, size: usize| at.saturating_sub(EDGE_RADIUS)..(at + EDGE_RADIUS + 1).min(size);
    let in_rows = Image::from_fn(width, height, |x, y| {
        let row = &image.row(y)[around(x, width)];
        row.iter().copied().fold(image.at(x, y), extreme)
    });
    Image::from_fn(width, height, |x, y| {
        let column = around(y, height).map(|y| in_rows.at(x, y));
        column.fold(in_rows.at(x, y), extreme)
    })
}

impl DepthMap {
    /// Takes what a depth camera measured in this keyframe, whose unit is so many metres: fused
    /// with the hypotheses that agree, in place of others, and where there is none. Returns how
    /// many pixels were measured; none when the image has another size.
    pub fn fuse_measured(&mut self, measured: &MeasuredDepth, unit: f32) -> usize {
        if measured.size() != (self.host.width(), self.host.height()) {
            return 0;
        }
        let candidates: Vec<_> = self.all_candidates().collect();
        self.is_measured = true;
        let mut num_measured = 0;
        for (x, y, i) in candidates {
            let known = (self.arrays.idepth[i], self.arrays.var[i]);
            let idepth = measured.idepth.at(x, y);
            let sigma = if idepth > 0.0 {
                measured.sigma
            } else if idepth < 0.0 && known.1 <= 0.0 {
                EDGE_FACTOR * measured.sigma
            } else {
                continue;
            };
            num_measured += 1;
            let (idepth, var) = (idepth.abs() * unit, (sigma * unit).powi(2));
            let (idepth, var) = fused(known, (idepth, var));
            let validity = self.arrays.validity[i].max(MEASURED_VALIDITY);
            let hypothesis = Hypothesis {
                idepth,
                var,
                prior_var: var,
                validity,
            };
            self.set(i, hypothesis);
        }
        num_measured
    }
}

/// A hypothesis (a variance of 0 = none) with a measurement: the product of both where they agree,
/// else the measurement.
fn fused((before, before_var): (f32, f32), (idepth, var): (f32, f32)) -> (f32, f32) {
    let gap = idepth - before;
    let limit = SAME_DEPTH_SIGMAS * SAME_DEPTH_SIGMAS * (before_var + var);
    if before_var <= 0.0 || gap * gap > limit {
        return (idepth, var);
    }
    let sum = before_var + var;
    (
        (idepth * before_var + before * var) / sum,
        before_var * var / sum,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{DepthConfig, HostFrame, PixelFilter};
    use monogrid_geometry::{Rotation, Vec3};
    use std::sync::Arc;

    const PINHOLE: Pinhole = Pinhole {
        fx: 60.0,
        fy: 60.0,
        cx: 31.5,
        cy: 23.5,
    };

    fn stripes() -> DepthMap {
        let image = GrayImage::from_fn(64, 48, |x, _| if x / 8 % 2 == 0 { 50.0 } else { 150.0 });
        let host = HostFrame::new(image, Mask::filled(64, 48, 255), PINHOLE).unwrap();
        DepthMap::empty(Arc::new(host), &DepthConfig::default())
    }

    #[test]
    fn a_measurement_is_fused_with_what_agrees_and_replaces_what_does_not() {
        // in units of 2 m: 0.5/m is 1/u, and 0.01/m is 0.02/u
        let measured = MeasuredDepth::new(&GrayImage::filled(64, 48, 2.0), 0.01);
        let mut map = stripes();
        let seed = |x, idepth| DepthPixel {
            x,
            y: 20,
            idepth,
            idepth_var: 0.04f32.powi(2),
        };
        assert!(map.seed_pixel(&seed(15, 1.1), 20) && map.seed_pixel(&seed(23, 1.4), 20));
        let num = map.fuse_measured(&measured, 2.0);
        assert_eq!((num, map.num_known()), (map.num_candidates(), num));
        // weights 1 and 4: (1.1 + 4 * 1.0) / 5, and 1 / (1/0.0016 + 1/0.0004)
        let fused = map.at(15, 20).unwrap();
        assert!((fused.idepth - 1.02).abs() < 1e-6 && (fused.idepth_var - 0.00032).abs() < 1e-8);
        for (x, y) in [(23, 20), (15, 21)] {
            let replaced = map.at(x, y).unwrap();
            assert!((replaced.idepth - 1.0).abs() < 1e-6);
            assert!((replaced.idepth_var - 0.0004).abs() < 1e-8);
        }
        let confirmed = PixelFilter {
            min_validity: MEASURED_VALIDITY,
            ..PixelFilter::default()
        };
        assert_eq!(map.pixels(confirmed).count(), num);
        let small = MeasuredDepth::new(&GrayImage::filled(8, 8, 2.0), 0.01);
        assert_eq!(map.fuse_measured(&small, 2.0), 0);
    }

    #[test]
    fn beside_an_edge_the_filter_keeps_what_it_knows_and_begins_uncertain() {
        let depth = GrayImage::from_fn(64, 48, |x, _| if x < 16 { 1.0 } else { 2.0 });
        let measured = MeasuredDepth::new(&depth, 0.01);
        assert!(measured.at(15, 20).is_none() && measured.at(16, 20).is_none());
        let mut map = stripes();
        let known = DepthPixel {
            x: 15,
            y: 20,
            idepth: 0.4,
            idepth_var: 0.1,
        };
        assert!(map.seed_pixel(&known, 20));
        map.fuse_measured(&measured, 1.0);
        assert_eq!(map.at(15, 20), Some(known));
        let begun = map.at(15, 21).unwrap();
        assert!(begun.idepth == 1.0 && (begun.idepth_var - 0.01).abs() < 1e-7);
        let away = map.at(23, 21).unwrap();
        assert!(away.idepth == 0.5 && (away.idepth_var - 1e-4).abs() < 1e-9);
    }

    #[test]
    fn edges_of_depth_are_left_out_and_holes_and_slopes_are_none() {
        let depth = GrayImage::from_fn(64, 48, |x, y| match (x, y) {
            (40, 10) => f32::NAN,
            (50, 10) => 0.0,
            (x, _) if x < 20 => 1.0 + 0.005 * x as f32,
            _ => 2.0,
        });
        let measured = MeasuredDepth::new(&depth, 0.002);
        let is_known = |x, y| measured.at(x, y).is_some();
        assert!((0..18).chain(22..40).all(|x| is_known(x, 10)));
        assert!(!(18..22).any(|x| is_known(x, 10)));
        assert!(!is_known(40, 10) && !is_known(50, 10) && !is_known(64, 10) && !is_known(3, 48));
        let (idepth, sigma) = measured.at(30, 5).unwrap();
        assert_eq!((idepth, sigma), (0.5, 0.002));
        // as far as noise reaches, 1.4 m and 1.7 m may be one surface
        let noisy = GrayImage::from_fn(64, 48, |x, _| if x < 20 { 5.0 } else { 5.5 });
        assert!(MeasuredDepth::new(&noisy, 0.002).at(20, 5).is_none());
        assert!(MeasuredDepth::new(&noisy, 0.004).at(20, 5).is_some());
    }

    #[test]
    fn what_stands_before_a_surface_that_was_seen_moves() {
        // 0.5 and 0.58 /m: 1.16 times nearer, and 8 standard deviations of 0.01
        let seen = |depth: fn(usize) -> f32, sigma| {
            MeasuredDepth::new(&GrayImage::from_fn(64, 48, |x, _| depth(x / 16)), sigma)
        };
        let before = seen(|part| [2.0, 2.0, f32::NAN, 1.0][part], 0.01);
        let now = |sigma| {
            let mut now = seen(|part| [2.0, 1.0 / 0.58, 1.0, 2.0][part], sigma);
            now.leave_out_moving(&before);
            now
        };
        let mask = Mask::from_fn(64, 48, |_, y| if y < 4 { 0 } else { 255 });
        let still = now(0.01).still(&mask);
        let at = |x| (now(0.01).at(x, 20).is_some(), still.at(x, 20));
        // the same, nearer, unknown before, farther
        let parts = [8, 24, 40, 56].map(at);
        assert_eq!(parts, [(true, 255), (false, 0), (true, 255), (true, 255)]);
        assert_eq!(still.at(8, 3), 0);
        assert!(now(0.014).at(24, 20).is_some());
        let mut map = stripes();
        map.fuse_measured(&now(0.01), 1.0);
        assert!(map.at(24, 20).is_none() && map.at(40, 20).is_some());
    }

    #[test]
    fn another_frame_sees_the_nearest_surface_where_it_is() {
        // a wall at 2 m, and 1 m before it a square
        let depth = GrayImage::from_fn(64, 48, |x, y| {
            if (20..32).contains(&x) && (10..22).contains(&y) {
                1.0
            } else {
                2.0
            }
        });
        let measured = MeasuredDepth::new(&depth, 0.002);
        // the other one stands 0.1 m to the left and 0.5 m behind
        let other_from_frame = Se3::new(Rotation::identity(), Vec3::new(0.1, 0.0, 0.5));
        let seen = measured.seen_from(&other_from_frame, &PINHOLE);
        let at = |x: f64, y: f64, z: f64| {
            let point = PINHOLE.unproject(&Vec2::new(x, y)) * z + other_from_frame.translation;
            let pixel = PINHOLE.project(&point);
            seen.at((pixel.x + 0.5) as usize, (pixel.y + 0.5) as usize)
        };
        assert!((at(26.0, 16.0, 1.0).unwrap().0 - 1.0 / 1.5).abs() < 1e-6);
        assert!((at(8.0, 40.0, 2.0).unwrap().0 - 1.0 / 2.5).abs() < 1e-6);
        // a floor that falls away: several of its pixels are seen in one, and none is preferred
        let floor = GrayImage::from_fn(64, 48, |_, y| 1.0 / (0.2 + 0.01 * y as f32));
        let seen_floor = MeasuredDepth::new(&floor, 0.002).seen_from(&other_from_frame, &PINHOLE);
        let errors = seen_floor.pixels(1.0).map(|pixel| {
            // 0.2 + 0.01 y is a plane, whose inverse depth there follows from that of the pixel
            let ray = PINHOLE.unproject(&Vec2::new(pixel.x.into(), pixel.y.into()));
            let (a, b) = (0.01 * PINHOLE.fy, 0.2 + 0.01 * PINHOLE.cy);
            let offset = other_from_frame.translation;
            let expected = (a * ray.y + b) / (1.0 + a * offset.y + b * offset.z);
            f64::from(pixel.idepth) / expected - 1.0
        });
        let errors: Vec<f64> = errors.collect();
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        assert!(errors.len() > 500 && mean.abs() < 0.002, "{mean}");
        // what the square hides there is not seen through it
        let nearer = seen.pixels(1.0).filter(|p| p.idepth > 0.6).count();
        assert!((20..64).contains(&nearer), "{nearer}");
    }
}
