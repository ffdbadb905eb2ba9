//! OctoMap's `.ot`: the full tree, every node an `f32` log-odds and a byte of children, children
//! depth first. Inner nodes hold the largest value below them.

use std::io::{BufReader, BufWriter, Read, Write};

use super::header::{self, Cube, TREE_DEPTH, read_array};
use super::write_error;
use crate::error::MapError;
use crate::map::OccupancyMap;
use crate::octree::{Node, Octree, View};

const TITLE: &str = "# Octomap OcTree file";
const FORMAT: &str = ".ot";

/// Writes a map as OctoMap's `.ot`, pruned. Streams: memory beyond the map is some bytes per
/// brick.
///
/// # Errors
/// Writing fails, or a cell is beyond OctoMap's 16-bit keys.
pub fn write_ot(map: &OccupancyMap, out: &mut impl Write) -> Result<(), MapError> {
    let octree = Octree::new(map, View::Evidence)?;
    let mut out = BufWriter::new(out);
    header::write(&mut out, TITLE, octree.counts.nodes, map.resolution())?;
    octree.visit(&mut |node, children| {
        let [a, b, c, d] = node.log_odds().to_le_bytes();
        let mask = (0..8).fold(0, |mask, octant| {
            let is_known = children.is_some_and(|children| children[octant] != Node::Unknown);
            mask | u8::from(is_known) << octant
        });
        out.write_all(&[a, b, c, d, mask]).map_err(write_error)
    })?;
    out.flush().map_err(write_error)
}

/// Reads OctoMap's `.ot` (ids `OcTree`, `OcTreeStamped` and `ColorOcTree`, whose colours are
/// dropped).
///
/// The map gets OctoMap's own clamps and the given memory budget; a damaged or hostile file
/// gives an error, never a panic or an allocation beyond the budget.
///
/// # Errors
/// The file is not a whole `.ot`, or its map does not fit into `memory_budget_bytes`.
pub fn read_ot(input: impl Read, memory_budget_bytes: usize) -> Result<OccupancyMap, MapError> {
    let mut input = BufReader::new(input);
    let header = header::read(&mut input, TITLE, FORMAT)?;
    let extra_bytes = header
        .extra_bytes()
        .ok_or_else(|| header.unsupported(FORMAT))?;
    let mut map = header::empty_map(header.resolution, memory_budget_bytes)?;
    if header.size > 0 {
        read_node(&mut input, Cube::ROOT, extra_bytes, &mut map)?;
    }
    Ok(map)
}

fn read_node(
    input: &mut impl Read,
    cube: Cube,
    extra_bytes: usize,
    map: &mut OccupancyMap,
) -> Result<(), MapError> {
    let log_odds = f32::from_le_bytes(read_array(input, FORMAT)?);
    for _ in 0..extra_bytes {
        read_array::<1>(input, FORMAT)?;
    }
    let [children] = read_array(input, FORMAT)?;
    if children == 0 {
        if log_odds.is_nan() {
            return Err(MapError::format(FORMAT, "a leaf has the value NaN"));
        }
        return cube.fill(map, log_odds);
    }
    if cube.depth == TREE_DEPTH {
        return Err(MapError::format(
            FORMAT,
            format!("a node at depth {TREE_DEPTH} has children"),
        ));
    }
    for octant in 0..8 {
        if children >> octant & 1 == 1 {
            read_node(input, cube.child(octant), extra_bytes, map)?;
        }
    }
    Ok(())
}
