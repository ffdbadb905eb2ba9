//! Measured points as a block of integers.

use crate::picture::base64;
use crate::picture::colour::quantile;
use monogrid_image::luma_of_rgb;
use serde::Serialize;

/// Points on a page at most.
const MAX_POINTS: usize = 500_000;
/// Relative uncertainty at which confidence is 0.
const WORST_RELATIVE_SIGMA: f32 = 0.05;
/// Points farther from the middle half than this many times its size are left out: they would make the others coarse.
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
/// The block is base64 of four little-endian 16-bit integers per point: x, y, z in steps from `low`, and confidence in 1/255 times
/// 256 plus grey level.
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

    /// Of the points of each keyframe, which are some of all that were measured; the second value is the first point that is shown
    /// of each keyframe and their number.
    pub fn new(groups: &[Vec<CloudPoint>], measured: usize) -> (Self, Vec<[usize; 2]>) {
        let ranges = [0, 1, 2].map(|axis| {
            let along = groups.iter().flatten().map(|p| f64::from(p.point[axis]));
            range(along.collect())
        });
        let low = ranges.map(|[low, _]| low);
        let largest = ranges.map(|[low, high]| high - low);
        let step = largest.into_iter().fold(0.0, f64::max).max(1e-6) / f64::from(u16::MAX);
        let mut bytes = Vec::new();
        let mut colours = Vec::new();
        let mut shown = Vec::with_capacity(groups.len());
        for group in groups {
            let first = bytes.len() / 8;
            for point in group {
                if let Some(place) = steps(point, &low, step) {
                    bytes.extend(place.into_iter().flat_map(u16::to_le_bytes));
                    bytes.extend([
                        luma_of_rgb(point.colour),
                        (point.confidence * 255.0).round() as u8,
                    ]);
                    colours.push(point.colour);
                }
            }
            shown.push([first, bytes.len() / 8 - first]);
        }
        let cloud = Self {
            low,
            step,
            count: [bytes.len() / 8, measured],
            points: base64(&bytes),
            colours: colours
                .iter()
                .any(|[r, g, b]| r != g || g != b)
                .then(|| base64(colours.as_flattened())),
        };
        (cloud, shown)
    }
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
        (0.0..=f64::from(u16::MAX))
            .contains(&steps)
            .then_some(steps as u16)
    };
    Some([along(0)?, along(1)?, along(2)?])
}

#[cfg(test)]
mod tests {
    use super::*;

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
}
