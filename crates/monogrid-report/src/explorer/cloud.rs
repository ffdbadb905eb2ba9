//! Measured points as a block of integers, and what was measured in keyframes, without what was
//! filled in between.

use super::look::Look;
use crate::picture::base64;
use crate::picture::colour::quantile;
use monogrid_geometry::{Pinhole, Sim3, Vec2};
use monogrid_image::luma_of_rgb;
use monogrid_mapping::{KeyframeCamera, KeyframeScan};
use monogrid_occupancy::DepthPixel as Measurement;
use monogrid_slam::{DepthPixel, KeyframeId};
use serde::Serialize;

/// Points on a page at most.
const MAX_POINTS: usize = 500_000;
/// Relative uncertainty at which confidence is 0.
const WORST_RELATIVE_SIGMA: f32 = 0.05;
/// Points farther from the middle half than this many times its size are left out: they would make
/// the others coarse.
const FAR: f64 = 20.0;

/// A measured point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CloudPoint {
    /// Where it is.
    pub point: [f32; 3],
    /// Red, green and blue of its pixel.
    pub colour: [u8; 3],
    /// 1 for certain, 0 where the depth is known to 5 % only.
    pub confidence: f32,
}

impl CloudPoint {
    /// Confidence of a depth with a standard deviation relative to it.
    pub fn confidence(relative_sigma: f32) -> f32 {
        (1.0 - relative_sigma / WORST_RELATIVE_SIGMA).clamp(0.0, 1.0)
    }
}

/// The points of all keyframes, in the order of the keyframes.
///
/// The block is base64 of four little-endian 16-bit integers per point: x, y, z in steps from
/// `low`, and confidence in 1/255 times 256 plus grey level.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Cloud {
    /// Lower corner.
    pub low: [f64; 3],
    /// Length of a step along each axis.
    pub step: f64,
    /// Points shown, and points measured.
    pub count: [usize; 2],
    /// The points.
    pub points: String,
    /// Red, green and blue of each point, bytes in base64; left out where all are grey.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub colours: Option<String>,
}

impl Cloud {
    /// So that there are not too many, one of as many measured points is shown.
    pub fn keep_every(measured: usize) -> usize {
        measured.div_ceil(MAX_POINTS).max(1)
    }

    /// Of the points of each keyframe, which are some of all that were measured; the second value
    /// is the first point that is shown of each keyframe and their number.
    pub fn new(groups: &[Vec<CloudPoint>], measured: usize) -> (Self, Vec<[usize; 2]>) {
        let ranges = [0, 1, 2].map(|axis| {
            let along = groups.iter().flatten().map(|p| f64::from(p.point[axis]));
            range(along.collect())
        });
        let (low, step) = grid(ranges);
        let (mut bytes, mut colours) = (Vec::new(), Vec::new());
        let mut shown = Vec::with_capacity(groups.len());
        for group in groups {
            let first = bytes.len() / 8;
            for point in group {
                if let Some(place) = steps(point, &low, step) {
                    let confidence = (point.confidence * 255.0).round() as u8;
                    bytes.extend(place.into_iter().flat_map(u16::to_le_bytes));
                    bytes.extend([luma_of_rgb(point.colour), confidence]);
                    colours.push(point.colour);
                }
            }
            shown.push([first, bytes.len() / 8 - first]);
        }
        let has_colour = colours.iter().any(|[r, g, b]| r != g || g != b);
        let cloud = Self {
            low,
            step,
            count: [bytes.len() / 8, measured],
            points: base64(&bytes),
            colours: has_colour.then(|| base64(colours.as_flattened())),
        };
        (cloud, shown)
    }
}

/// Lower corner, and a step along each axis so that 16 bits reach over the largest range.
pub(super) fn grid(ranges: [[f64; 2]; 3]) -> ([f64; 3], f64) {
    let lengths = ranges.map(|[low, high]| high - low);
    let largest = lengths.into_iter().fold(0.0, f64::max).max(1e-6);
    (ranges.map(|[low, _]| low), largest / f64::from(u16::MAX))
}

/// Where most points lie, with much room around.
fn range(mut values: Vec<f64>) -> [f64; 2] {
    let least = quantile(&mut values, 0.0);
    let most = quantile(&mut values, 1.0);
    let (low, high) = (quantile(&mut values, 0.25), quantile(&mut values, 0.75));
    let room = FAR * (high - low).max(1e-6);
    [least.max(low - room), most.min(high + room)]
}

fn steps(point: &CloudPoint, low: &[f64; 3], step: f64) -> Option<[u16; 3]> {
    let along = |axis: usize| {
        let steps = ((f64::from(point.point[axis]) - low[axis]) / step).round();
        let fits = (0.0..=f64::from(u16::MAX)).contains(&steps);
        fits.then_some(steps as u16)
    };
    Some([along(0)?, along(1)?, along(2)?])
}

/// The measured pixels of a keyframe that pass the filter of the map. They lie where there is room.
#[derive(Clone, Debug, PartialEq)]
pub struct SemiDense(KeyframeScan);

impl SemiDense {
    /// What of a scan was measured in its keyframe. Both are row-major.
    pub fn new(measured: &[DepthPixel], scan: &KeyframeScan) -> Self {
        let place = |pixel: &DepthPixel| (pixel.y, pixel.x);
        let mut next = 0;
        Self(scan.only(|pixel| {
            let wanted = (pixel.y, pixel.x);
            next += measured[next..].partition_point(|m| place(m) < wanted);
            measured.get(next).is_some_and(|m| place(m) == wanted)
        }))
    }

    /// All that a recording has of a keyframe.
    pub fn recorded(id: KeyframeId, camera: KeyframeCamera, pixels: &[DepthPixel]) -> Self {
        let measured = |pixel: &DepthPixel| Measurement {
            x: pixel.x,
            y: pixel.y,
            idepth: pixel.idepth,
            sigma_idepth: pixel.idepth_var.sqrt(),
        };
        let pixels = pixels.iter().map(measured).collect();
        Self(KeyframeScan::of_measurements(id, camera, pixels, 0))
    }

    /// The keyframe.
    pub fn id(&self) -> KeyframeId {
        self.0.id
    }

    /// The number of its pixels.
    pub fn num_pixels(&self) -> usize {
        self.0.num_pixels
    }

    /// Its points in the frame of the results, in the colours of its image.
    pub fn points(
        &self,
        look: Look<'_>,
        pinhole: &Pinhole,
        map_from_keyframe: &Sim3,
    ) -> impl Iterator<Item = CloudPoint> {
        let pixels = self.0.pixels();
        (0..pixels.len()).map(move |index| {
            let measured = pixels[index];
            let depth = 1.0 / f64::from(measured.idepth);
            let ray = pinhole.unproject(&Vec2::new(measured.x.into(), measured.y.into()));
            let point = *map_from_keyframe * (ray * depth);
            CloudPoint {
                point: [point.x, point.y, point.z].map(|value| value as f32),
                colour: look.at(measured.x.into(), measured.y.into()),
                confidence: CloudPoint::confidence(measured.sigma_idepth / measured.idepth),
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::Vec3;
    use monogrid_image::Image;
    use std::borrow::Cow;

    fn point(x: f32) -> CloudPoint {
        CloudPoint {
            point: [x, 1.0, -2.0],
            colour: [7; 3],
            confidence: 0.5,
        }
    }

    #[test]
    fn points_keep_their_places_and_their_groups() {
        let groups = [vec![point(0.0)], vec![], vec![point(6.5535)]];
        let (cloud, shown) = Cloud::new(&groups, 9);
        assert_eq!(shown, [[0, 1], [1, 0], [1, 1]]);
        assert_eq!((cloud.count, cloud.low), ([2, 9], [0.0, 1.0, -2.0]));
        assert!((cloud.step - 1e-4).abs() < 1e-9);
        let expected = [0, 0, 0, 0, 0, 0, 7, 128, 255, 255, 0, 0, 0, 0, 7, 128];
        assert_eq!(cloud.points, base64(&expected));
        assert_eq!(cloud.colours, None, "all are grey");
        let red = CloudPoint {
            colour: [255, 0, 0],
            ..point(1.0)
        };
        let (cloud, _) = Cloud::new(&[vec![point(0.0), red]], 2);
        assert_eq!(cloud.colours, Some(base64(&[7, 7, 7, 255, 0, 0])));
    }

    #[test]
    fn many_points_are_thinned_and_far_ones_left_out() {
        assert_eq!(
            [0, MAX_POINTS, MAX_POINTS + 1].map(Cloud::keep_every),
            [1, 1, 2]
        );
        let near = (0..1000).map(|i| point(i as f32));
        let (cloud, shown) = Cloud::new(&[near.collect(), vec![point(1e9)]], 1001);
        assert_eq!(cloud.count, [1000, 1001]);
        assert_eq!(shown, [[0, 1000], [1000, 0]], "one is far away");
    }

    #[test]
    fn confidence_falls_with_uncertainty() {
        let of = |sigma| (CloudPoint::confidence(sigma) * 100.0).round() as i32;
        assert_eq!([of(0.0), of(0.01), of(0.05), of(1.0)], [100, 80, 0, 0]);
    }

    fn measured() -> [DepthPixel; 4] {
        let pixel = |(x, y)| DepthPixel {
            x,
            y,
            idepth: 1.0,
            idepth_var: 0.01,
        };
        [(1, 0), (3, 0), (0, 2), (2, 2)].map(pixel)
    }

    #[test]
    fn what_was_filled_in_is_left_out_and_points_are_where_they_were_measured() {
        let measurement = |x, y| Measurement {
            x,
            y,
            idepth: 0.5,
            sigma_idepth: 0.01,
        };
        let camera = KeyframeCamera::new(Pinhole::new(2.0, 2.0, 1.0, 1.0), (4, 3));
        let pixels = [(0, 0), (1, 0), (2, 0), (1, 1), (2, 2), (3, 2)];
        let pixels = pixels.map(|(x, y)| measurement(x, y)).to_vec();
        let scan = KeyframeScan::of_measurements(3, camera, pixels, 4);
        let cloud = SemiDense::new(&measured(), &scan);
        let pixels: Vec<_> = cloud.0.pixels().iter().map(|p| [p.x, p.y]).collect();
        assert_eq!((pixels, cloud.id()), (vec![[1, 0], [2, 2]], 3));
        let pinhole = Pinhole::new(2.0, 2.0, 1.0, 1.0);
        let twice = Sim3::new(2.0, monogrid_geometry::Rotation::identity(), Vec3::zeros());
        let image = Image::from_fn(4, 3, |x, y| (10 * y + x) as u8);
        let look = Look::Grey(Cow::Owned(image));
        let points: Vec<_> = cloud.points(look, &pinhole, &twice).collect();
        assert_eq!(points[1].point, [2.0, 2.0, 4.0]);
        assert_eq!([points[0].colour, points[1].colour], [[1; 3], [22; 3]]);
        assert!((points[0].confidence - 0.6).abs() < 1e-6);
    }
}
