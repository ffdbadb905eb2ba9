//! Points.

use monogrid_messages::sensor_msgs::{FLOAT32, PointCloud2, PointField};
use monogrid_messages::std_msgs::Header;
use monogrid_occupancy::{Occupancy, OccupancyMap};

/// Bytes of each of the numbers of a point.
pub const BYTES_PER_NUMBER: usize = 4;

/// Points of four numbers: x, y, z (m) and one of the given name, `intensity` or `rgb` (the bits of
/// which are a colour, see [`packed`]).
#[must_use]
pub fn cloud_of(
    header: Header,
    fourth: &str,
    points: impl Iterator<Item = [f32; 4]>,
) -> PointCloud2 {
    let names = ["x", "y", "z", fourth];
    let data: Vec<u8> = points.flatten().flat_map(f32::to_le_bytes).collect();
    let field = |(index, name): (usize, &&str)| PointField {
        name: (*name).to_owned(),
        offset: (index * BYTES_PER_NUMBER) as u32,
        datatype: FLOAT32,
        count: 1,
    };
    let point_step = names.len() * BYTES_PER_NUMBER;
    PointCloud2 {
        header,
        height: 1,
        width: (data.len() / point_step) as u32,
        fields: names.iter().enumerate().map(field).collect(),
        is_bigendian: false,
        point_step: point_step as u32,
        row_step: data.len() as u32,
        data,
        is_dense: true,
    }
}

/// The centres of the occupied cells of a map, and their probabilities.
pub fn points_of_cells(map: &OccupancyMap) -> impl Iterator<Item = [f32; 4]> {
    let occupied = map.cells().filter(|cell| cell.state == Occupancy::Occupied);
    occupied.map(|cell| {
        let [x, y, z] = cell.key.center(map.resolution()).map(|v| v as f32);
        let probability = 1.0 / (1.0 + (-cell.log_odds).exp());
        [x, y, z, probability]
    })
}

/// Red, green and blue as the number that viewers of clouds expect under the name `rgb`.
#[must_use]
pub fn packed([red, green, blue]: [u8; 3]) -> f32 {
    f32::from_bits(u32::from_be_bytes([0, red, green, blue]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_four_numbers_and_colours_keep_their_bits() {
        let colour = [200, 100, 50];
        let point = [1.0, 2.0, 3.0, packed(colour)];
        let cloud = cloud_of(Header::default(), "rgb", [point, point].into_iter());
        assert_eq!((cloud.width, cloud.point_step, cloud.row_step), (2, 16, 32));
        assert_eq!(
            (cloud.fields[3].name.as_str(), cloud.fields[3].offset),
            ("rgb", 12)
        );
        assert_eq!(cloud.data[12..16], [50, 100, 200, 0]);
    }
}
