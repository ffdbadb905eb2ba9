//! The semi-dense cloud: what was measured in keyframes, without what was filled in between.

use super::{CloudPoint, Look};
use monogrid_geometry::{Pinhole, Sim3, Vec2};
use monogrid_occupancy::DepthPixel as Measurement;
use monogrid_slam::mapping::{KeyframeCamera, KeyframeScan};
use monogrid_slam::{DepthPixel, KeyframeId};

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

/// Points of all keyframes together.
pub fn num_measured<'a>(clouds: impl IntoIterator<Item = &'a SemiDense>) -> usize {
    clouds.into_iter().map(SemiDense::num_pixels).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::Vec3;
    use monogrid_image::Image;
    use std::borrow::Cow;

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
