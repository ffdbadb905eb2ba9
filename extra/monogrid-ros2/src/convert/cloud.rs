//! Points.

use super::{MAX_MESSAGE_BYTES, OVERHEAD_BYTES};
use monogrid_bags::convert::{BYTES_PER_NUMBER, cloud_of, points_of_cells};
use monogrid_geometry::{Pinhole, Sim3, Vec2};
use monogrid_messages::sensor_msgs::PointCloud2;
use monogrid_messages::std_msgs::Header;
use monogrid_occupancy::OccupancyMap;
use monogrid_slam::Keyframe;

/// Points that fit into one message.
pub const MAX_POINTS: usize = (MAX_MESSAGE_BYTES - OVERHEAD_BYTES) / (4 * BYTES_PER_NUMBER);

/// Depths that are less certain are not sent.
const MAX_RELATIVE_SIGMA: f32 = 0.05;

/// The centres of the occupied cells of a map whose lengths are metres; the intensity is their probability.
#[must_use]
pub fn cloud_of_cells(header: Header, map: &OccupancyMap) -> PointCloud2 {
    cut(header, points_of_cells(map))
}

/// The points of a keyframe, of which depth is known well enough, in the frame given by `frame_from_keyframe` (m); the
/// intensity is the grey value, 0 to 255.
#[must_use]
pub fn cloud_of_keyframe(
    header: Header,
    keyframe: &Keyframe,
    pinhole: &Pinhole,
    frame_from_keyframe: &Sim3,
) -> PointCloud2 {
    let certain = keyframe
        .pixels
        .iter()
        .filter(|p| p.idepth > 0.0 && p.idepth_var.sqrt() <= MAX_RELATIVE_SIGMA * p.idepth);
    let points = certain.map(|pixel| {
        let at = Vec2::new(f64::from(pixel.x), f64::from(pixel.y));
        let in_keyframe = pinhole.unproject(&at) / f64::from(pixel.idepth);
        let point = *frame_from_keyframe * in_keyframe;
        let grey = keyframe.image.at(pixel.x.into(), pixel.y.into());
        [point.x as f32, point.y as f32, point.z as f32, grey.into()]
    });
    cut(header, points)
}

/// As many of the points as fit into one message.
fn cut(header: Header, points: impl Iterator<Item = [f32; 4]>) -> PointCloud2 {
    cloud_of(header, "intensity", points.take(MAX_POINTS))
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::{Rotation, Vec3};
    use monogrid_image::Image;
    use monogrid_occupancy::{MapConfig, VoxelKey};
    use monogrid_slam::DepthPixel;

    fn numbers(cloud: &PointCloud2) -> Vec<f32> {
        let (numbers, rest) = cloud.data.as_chunks::<4>();
        assert!(rest.is_empty());
        numbers.iter().map(|b| f32::from_le_bytes(*b)).collect()
    }

    #[test]
    fn centres_of_occupied_cells() {
        let mut map = OccupancyMap::new(MapConfig::with_resolution(0.5)).unwrap();
        map.set_log_odds(VoxelKey::new(1, -1, 0), Some(0.0 + 1.0))
            .unwrap();
        map.set_log_odds(VoxelKey::new(5, 5, 5), Some(-1.0))
            .unwrap();
        let cloud = cloud_of_cells(Header::default(), &map);
        let names: Vec<&str> = cloud.fields.iter().map(|f| f.name.as_str()).collect();
        assert_eq!(names, ["x", "y", "z", "intensity"]);
        assert_eq!((cloud.height, cloud.width, cloud.row_step), (1, 1, 16));
        let [x, y, z, probability] = numbers(&cloud)[..] else {
            panic!("one point of four numbers");
        };
        assert_eq!([x, y, z], [0.75, -0.25, 0.25]);
        assert!((probability - 0.731).abs() < 1e-3);
    }

    #[test]
    fn certain_points_of_a_keyframe() {
        let pixel = |x, idepth, idepth_var| DepthPixel {
            x,
            y: 0,
            idepth,
            idepth_var,
        };
        let keyframe = Keyframe {
            id: 0,
            frame_index: 0,
            timestamp_ns: 0,
            revision: 0,
            image: Image::filled(4, 2, 77),
            pixels: vec![
                pixel(3, 0.5, 1e-6),
                pixel(1, 0.5, 1.0),
                pixel(2, -1.0, 1e-6),
            ],
        };
        let pinhole = Pinhole::new(2.0, 2.0, 1.0, 0.0);
        let moved = Sim3::new(3.0, Rotation::identity(), Vec3::new(0.0, 10.0, 0.0));
        let cloud = cloud_of_keyframe(Header::default(), &keyframe, &pinhole, &moved);
        // the pixel is one focal length to the right: (2, 0, 2) in the keyframe
        assert_eq!(numbers(&cloud), [6.0, 10.0, 6.0, 77.0]);
    }

    #[test]
    fn more_points_than_a_message_holds_are_cut() {
        let cloud = cut(
            Header::default(),
            std::iter::repeat_n([1.0; 4], MAX_POINTS + 5),
        );
        assert_eq!(cloud.width as usize, MAX_POINTS);
        assert!(cloud.data.len() < MAX_MESSAGE_BYTES);
    }
}
