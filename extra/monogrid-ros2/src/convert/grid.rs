//! Maps seen from above.

use super::{MAX_MESSAGE_BYTES, OVERHEAD_BYTES};
use monogrid_messages::builtin_interfaces::Time;
use monogrid_messages::geometry_msgs::{Point, Pose};
use monogrid_messages::map_msgs::OccupancyGridUpdate;
use monogrid_messages::nav_msgs::{MapMetaData, OccupancyGrid};
use monogrid_messages::std_msgs::Header;
use monogrid_occupancy::{Occupancy, Projection};

/// Cells of a grid that fit into one message.
pub const MAX_GRID_CELLS: usize = MAX_MESSAGE_BYTES - OVERHEAD_BYTES;

/// Cells as messages have them, percent.
const UNKNOWN: i8 = -1;
const FREE: i8 = 0;
const OCCUPIED: i8 = 100;

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
        data: grid.columns.iter().map(|column| cell_of(*column)).collect(),
    }
}

fn cell_of(state: Occupancy) -> i8 {
    match state {
        Occupancy::Unknown => UNKNOWN,
        Occupancy::Free => FREE,
        Occupancy::Occupied => OCCUPIED,
    }
}

/// The smallest rectangle of `now` that holds all cells that differ from `before`; `None` where none does. The two are of
/// one size and place, else all of `now` must be sent.
#[must_use]
pub fn changed_part(before: &OccupancyGrid, now: &OccupancyGrid) -> Option<OccupancyGridUpdate> {
    let width = now.info.width as usize;
    let changed = before.data.iter().zip(&now.data).enumerate();
    let changed = changed.filter(|(_, (before, now))| before != now);
    let cells = changed.map(|(index, _)| (index % width, index / width));
    let bounds = cells.fold(None, |bounds: Option<[usize; 4]>, (x, y)| {
        let [left, low, right, high] = bounds.unwrap_or([x, y, x, y]);
        Some([left.min(x), low.min(y), right.max(x), high.max(y)])
    });
    let [left, low, right, high] = bounds?;
    let rows = now.data.chunks(width).skip(low).take(high - low + 1);
    Some(OccupancyGridUpdate {
        header: now.header.clone(),
        x: left as i32,
        y: low as i32,
        width: (right - left + 1) as u32,
        height: (high - low + 1) as u32,
        data: rows.flat_map(|row| &row[left..=right]).copied().collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn projection(width: usize, columns: &[Occupancy]) -> Projection {
        Projection {
            width,
            height: columns.len() / width,
            resolution: 0.1,
            origin: [-0.3, 0.2],
            columns: columns.to_vec(),
        }
    }

    use Occupancy::{Free, Occupied, Unknown};

    #[test]
    fn cells_are_percent_from_below() {
        let stamp = Time { sec: 5, nanosec: 6 };
        let grid = projection(2, &[Free, Occupied, Unknown, Free, Occupied, Unknown]);
        let message = grid_of(Header::default(), stamp, &grid);
        assert_eq!(message.data, [0, 100, -1, 0, 100, -1]);
        assert_eq!((message.info.width, message.info.height), (2, 3));
        assert_eq!(message.info.map_load_time, stamp);
        let origin = message.info.origin;
        assert_eq!((origin.position.x, origin.position.y), (-0.3, 0.2));
        assert_eq!(origin.orientation.w, 1.0);
        assert_eq!(message.info.resolution, 0.1);
    }

    #[test]
    fn a_change_is_the_rectangle_around_it() {
        let before = projection(4, &[Unknown; 12]);
        let mut after = before.clone();
        (after.columns[5], after.columns[10]) = (Free, Occupied);
        let message = |grid| grid_of(Header::default(), Time::default(), grid);
        let (before, after) = (message(&before), message(&after));
        assert_eq!(changed_part(&before, &before), None);
        let update = changed_part(&before, &after).unwrap();
        let place = (update.x, update.y, update.width, update.height);
        assert_eq!(place, (1, 1, 2, 2));
        assert_eq!(update.data, [0, -1, -1, 100]);
    }
}
