//! OctoMap's `.bt`: two bits per child (0 unknown, 1 free, 2 occupied, 3 inner; low bits first),
//! inner children depth first. The maximum-likelihood tree is pruned again before it is written.

use std::io::{BufRead, BufReader, BufWriter, Read, Write};

use super::header::{self, Cube, LEGACY_MAGIC, TREE_DEPTH, octomap_clamps, read_array};
use super::write_error;
use crate::error::MapError;
use crate::likelihood::FREE;
use crate::map::OccupancyMap;
use crate::octree::{Node, Octree, View};

const TITLE: &str = "# Octomap OcTree binary file";
const FORMAT: &str = ".bt";

/// Writes a map as OctoMap's `.bt`: occupied, free or unknown only. The map itself is
/// neither changed nor copied: memory beyond it is some bytes per brick.
///
/// # Errors
/// Writing fails, or a cell is beyond OctoMap's 16-bit keys.
pub fn write_bt(map: &OccupancyMap, out: &mut impl Write) -> Result<(), MapError> {
    let octree = Octree::new(map, View::Likely)?;
    let mut out = BufWriter::new(out);
    header::write(
        &mut out,
        [TITLE, header::OCTREE],
        octree.counts.nodes,
        map.resolution(),
    )?;
    let mut write = |children: &[Node; 8]| {
        let codes = children.map(|child| match child {
            Node::Unknown => 0,
            Node::Leaf(FREE) => 1,
            Node::Leaf(_) => 2,
            Node::Inner(_) => 3,
        });
        let bits = (0..8).fold(0_u16, |bits, octant| bits | codes[octant] << (2 * octant));
        out.write_all(&bits.to_le_bytes()).map_err(write_error)
    };
    if let Node::Leaf(value) = octree.root() {
        // The format has no bits for the root itself: a root of eight equal leaves.
        write(&[Node::Leaf(value); 8])?;
    } else {
        // Leaves are bits of their parents.
        octree.visit(&mut |_, children| children.map_or(Ok(()), &mut write))?;
    }
    out.flush().map_err(write_error)
}

/// Reads OctoMap's `.bt`, also those of versions before 1.4; free and occupied cells get OctoMap's
/// clamps -2 and 3.511.
///
/// A damaged or hostile file gives an error, never a panic or an allocation beyond the budget.
///
/// # Errors
/// The file is not a whole `.bt`, or its map does not fit into `memory_budget_bytes`.
pub fn read_bt(input: impl Read, memory_budget_bytes: usize) -> Result<OccupancyMap, MapError> {
    let mut input = BufReader::new(input);
    let start = input.fill_buf().map_err(MapError::io("reading a map"))?;
    let header = match start.starts_with(&LEGACY_MAGIC) {
        true => header::read_legacy(&mut input, FORMAT)?,
        false => header::read(&mut input, TITLE, FORMAT)?,
    };
    // leaves are bits of their parents, whatever a node has beside
    if header.extra_bytes().is_none() {
        return Err(header.unsupported(FORMAT));
    }
    let mut map = header::empty_map(header.resolution, memory_budget_bytes)?;
    if header.size > 0 {
        read_node(&mut input, Cube::ROOT, &mut map)?;
    }
    Ok(map)
}

fn read_node(input: &mut impl Read, cube: Cube, map: &mut OccupancyMap) -> Result<(), MapError> {
    let (free, occupied) = octomap_clamps();
    let bits = u16::from_le_bytes(read_array(input, FORMAT)?);
    let code = |octant: i32| bits >> (2 * octant) & 3;
    for octant in 0..8 {
        match code(octant) {
            1 => cube.child(octant).fill(map, free)?,
            2 => cube.child(octant).fill(map, occupied)?,
            _ => {}
        }
    }
    for octant in (0..8).filter(|&o| code(o) == 3) {
        let child = cube.child(octant);
        if child.depth == TREE_DEPTH {
            return Err(MapError::format(
                FORMAT,
                format!("a node at depth {TREE_DEPTH} has children"),
            ));
        }
        read_node(input, child, map)?;
    }
    Ok(())
}
