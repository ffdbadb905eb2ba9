//! Maps seen from above.

use monogrid_messages::builtin_interfaces::Time;
use monogrid_messages::geometry_msgs::{Point, Pose};
use monogrid_messages::nav_msgs::{MapMetaData, OccupancyGrid};
use monogrid_messages::std_msgs::Header;
use monogrid_occupancy::{Occupancy, Projection};

/// A grid whose lengths are metres, made at some time.
#[must_use]
pub fn grid_of(header: Header, made: Time, grid: &Projection) -> OccupancyGrid {
    let [x, y] = grid.origin;
    OccupancyGrid {
        header,
        info: MapMetaData {
            map_load_time: made,
            resolution: grid.resolution as f32,
            width: grid.width as u32,
            height: grid.height as u32,
            origin: Pose {
                position: Point { x, y, z: 0.0 },
                ..Pose::default()
            },
        },
        data: grid.columns.iter().map(cell_of).collect(),
    }
}

/// A cell as messages have it, percent.
fn cell_of(state: &Occupancy) -> i8 {
    match state {
        Occupancy::Unknown => -1,
        Occupancy::Free => 0,
        Occupancy::Occupied => 100,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use Occupancy::{Free, Occupied, Unknown};

    #[test]
    fn cells_are_percent_from_below() {
        let stamp = Time { sec: 5, nanosec: 6 };
        let grid = Projection {
            width: 2,
            height: 3,
            resolution: 0.1,
            origin: [-0.3, 0.2],
            columns: vec![Free, Occupied, Unknown, Free, Occupied, Unknown],
        };
        let message = grid_of(Header::default(), stamp, &grid);
        assert_eq!(message.data, [0, 100, -1, 0, 100, -1]);
        assert_eq!((message.info.width, message.info.height), (2, 3));
        assert_eq!(message.info.map_load_time, stamp);
        let origin = message.info.origin;
        assert_eq!((origin.position.x, origin.position.y), (-0.3, 0.2));
        assert_eq!(origin.orientation.w, 1.0);
        assert_eq!(message.info.resolution, 0.1);
    }
}
