//! The semi-dense cloud: what was measured in keyframes, without what was filled in between.

use super::{CloudPoint, Look};
use monogrid_geometry::{Pinhole, Sim3, Vec2};
use monogrid_slam::mapping::KeyframeScan;
use monogrid_slam::{DepthPixel, Keyframe, KeyframeId};

/// A measured pixel with its final depth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredPixel {
    /// Column and row, px.
    pub pixel: [u16; 2],
    /// Inverse depth, 1 / keyframe units.
    pub idepth: f32,
    /// Standard deviation of the inverse depth over the inverse depth.
    pub relative_sigma: f32,
}

/// The measured pixels of a keyframe that pass the filter of the map.
#[derive(Clone, Debug, PartialEq)]
pub struct SemiDense {
    /// The keyframe.
    pub id: KeyframeId,
    /// Its pixels, row-major.
    pub pixels: Vec<MeasuredPixel>,
}

impl SemiDense {
    /// What of a scan was measured in its keyframe. Both are row-major.
    pub fn new(keyframe: &Keyframe, scan: &KeyframeScan) -> Self {
        let place = |pixel: &DepthPixel| (pixel.y, pixel.x);
        let measured = &keyframe.pixels;
        let mut next = 0;
        let pixels = scan
            .pixels()
            .iter()
            .filter(|pixel| {
                let wanted = (pixel.y, pixel.x);
                next += measured[next..].partition_point(|m| place(m) < wanted);
                measured.get(next).is_some_and(|m| place(m) == wanted)
            })
            .map(|pixel| MeasuredPixel {
                pixel: [pixel.x, pixel.y],
                idepth: pixel.idepth,
                relative_sigma: pixel.sigma_idepth / pixel.idepth,
            })
            .collect();
        Self {
            id: scan.id,
            pixels,
        }
    }

    /// All that a recording has of a keyframe.
    pub fn recorded(id: KeyframeId, pixels: &[DepthPixel]) -> Self {
        let measured = |pixel: &DepthPixel| MeasuredPixel {
            pixel: [pixel.x, pixel.y],
            idepth: pixel.idepth,
            relative_sigma: pixel.idepth_var.sqrt() / pixel.idepth,
        };
        Self {
            id,
            pixels: pixels.iter().map(measured).collect(),
        }
    }

    /// Its points in the frame of the results, in the colours of its image.
    pub fn points(
        &self,
        look: Look<'_>,
        pinhole: &Pinhole,
        map_from_keyframe: &Sim3,
    ) -> impl Iterator<Item = CloudPoint> {
        self.pixels.iter().map(move |measured| {
            let [x, y] = measured.pixel.map(f64::from);
            let depth = 1.0 / f64::from(measured.idepth);
            let ray = pinhole.unproject(&Vec2::new(x, y));
            let point = *map_from_keyframe * (ray * depth);
            let [x, y] = measured.pixel.map(usize::from);
            CloudPoint {
                point: [point.x, point.y, point.z].map(|value| value as f32),
                colour: look.at(x, y),
                confidence: CloudPoint::confidence(measured.relative_sigma),
            }
        })
    }
}

/// Points of all keyframes together.
pub fn num_measured<'a>(clouds: impl IntoIterator<Item = &'a SemiDense>) -> usize {
    clouds.into_iter().map(|cloud| cloud.pixels.len()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::Vec3;
    use monogrid_image::Image;
    use monogrid_occupancy::DepthPixel as Measurement;
    use monogrid_slam::mapping::KeyframeCamera;

    fn keyframe() -> Keyframe {
        let pixel = |x, y| DepthPixel {
            x,
            y,
            idepth: 1.0,
            idepth_var: 0.01,
        };
        Keyframe {
            id: 3,
            frame_index: 0,
            timestamp_ns: 0,
            revision: 0,
            image: Image::from_fn(4, 3, |x, y| (10 * y + x) as u8),
            pixels: vec![pixel(1, 0), pixel(3, 0), pixel(0, 2), pixel(2, 2)],
        }
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
        let cloud = SemiDense::new(&keyframe(), &scan);
        let pixels: Vec<_> = cloud.pixels.iter().map(|p| p.pixel).collect();
        assert_eq!(pixels, [[1, 0], [2, 2]]);
        let pinhole = Pinhole::new(2.0, 2.0, 1.0, 1.0);
        let twice = Sim3::new(2.0, monogrid_geometry::Rotation::identity(), Vec3::zeros());
        let image = keyframe().image;
        let points: Vec<_> = cloud.points(Look::Grey(&image), &pinhole, &twice).collect();
        assert_eq!(points[1].point, [2.0, 2.0, 4.0]);
        assert_eq!([points[0].colour, points[1].colour], [[1; 3], [22; 3]]);
        assert!((points[0].confidence - 0.6).abs() < 1e-6);
    }
}
