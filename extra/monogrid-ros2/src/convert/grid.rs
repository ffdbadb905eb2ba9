//! What of a map seen from above is sent.

use super::{MAX_MESSAGE_BYTES, OVERHEAD_BYTES};
use monogrid_messages::map_msgs::OccupancyGridUpdate;
use monogrid_messages::nav_msgs::OccupancyGrid;

/// Cells of a grid that fit into one message.
pub const MAX_GRID_CELLS: usize = MAX_MESSAGE_BYTES - OVERHEAD_BYTES;

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
    use monogrid_messages::nav_msgs::MapMetaData;

    fn grid(width: u32, data: &[i8]) -> OccupancyGrid {
        OccupancyGrid {
            info: MapMetaData {
                width,
                height: data.len() as u32 / width,
                ..MapMetaData::default()
            },
            data: data.to_vec(),
            ..OccupancyGrid::default()
        }
    }

    #[test]
    fn a_change_is_the_rectangle_around_it() {
        let before = grid(4, &[-1; 12]);
        let mut after = before.clone();
        (after.data[5], after.data[10]) = (0, 100);
        assert_eq!(changed_part(&before, &before), None);
        let update = changed_part(&before, &after).unwrap();
        let place = (update.x, update.y, update.width, update.height);
        assert_eq!(place, (1, 1, 2, 2));
        assert_eq!(update.data, [0, -1, -1, 100]);
    }
}
