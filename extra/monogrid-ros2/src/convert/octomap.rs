//! Maps as trees.

use super::{MAX_MESSAGE_BYTES, OVERHEAD_BYTES};
use monogrid_messages::octomap_msgs::Octomap;
use monogrid_messages::std_msgs::Header;
use monogrid_occupancy::{MapError, OccupancyMap, write_bt, write_ot};

/// Bytes of a tree that fit into one message.
pub const MAX_TREE_BYTES: usize = MAX_MESSAGE_BYTES - OVERHEAD_BYTES;

/// The last line of the header of OctoMap's files.
const END_OF_HEADER: &[u8] = b"\ndata\n";

/// A map whose lengths are metres as a tree: with free and occupied cells only (`binary`), or with log-odds.
///
/// # Errors
/// Cells beyond what OctoMap can address.
pub fn octomap_of(header: Header, map: &OccupancyMap, binary: bool) -> Result<Octomap, MapError> {
    let mut file = Vec::new();
    if binary {
        write_bt(map, &mut file)?;
    } else {
        write_ot(map, &mut file)?;
    }
    let end = file
        .windows(END_OF_HEADER.len())
        .position(|window| window == END_OF_HEADER)
        .map_or(0, |at| at + END_OF_HEADER.len());
    Ok(Octomap {
        header,
        binary,
        id: "OcTree".to_owned(),
        resolution: map.resolution(),
        data: file.split_off(end),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_occupancy::{MapConfig, VoxelKey};

    #[test]
    fn one_occupied_cell_is_a_branch_of_sixteen_nodes() {
        let mut map = OccupancyMap::new(MapConfig::with_resolution(0.25)).unwrap();
        // the lowest cell of the octant that is positive in all axes: octant 7, then 0 down to the leaf
        map.set_log_odds(VoxelKey::new(0, 0, 0), Some(1.0)).unwrap();
        let binary = octomap_of(Header::default(), &map, true).unwrap();
        assert_eq!((binary.id.as_str(), binary.binary), ("OcTree", true));
        assert_eq!(binary.resolution, 0.25);
        let mut expected = vec![0, 0b1100_0000]; // the eighth child is an inner node
        expected.extend([0b11, 0].repeat(14));
        expected.extend([0b10, 0]); // the first child is an occupied leaf
        assert_eq!(binary.data, expected);
        let full = octomap_of(Header::default(), &map, false).unwrap();
        assert_eq!(full.data.len(), 17 * 5);
        assert_eq!(full.data[..5], [0, 0, 128, 63, 0b1000_0000]);
        assert_eq!(full.data[80..], [0, 0, 128, 63, 0]);
    }
}
