//! OctoMap's `.ot`: the full tree, every node an `f32` log-odds and a byte of children, children
//! depth first. Inner nodes hold the largest value below them. A `ColorOcTree` has red, green and
//! blue behind the log-odds.

use std::collections::BTreeMap;
use std::io::{BufReader, BufWriter, Read, Write};

use super::header::{self, Cube, TREE_DEPTH, read_array};
use super::write_error;
use crate::error::MapError;
use crate::key::VoxelKey;
use crate::map::OccupancyMap;
use crate::octree::{Leaf, Node, Octree, View};

const TITLE: &str = "# Octomap OcTree file";
const FORMAT: &str = ".ot";

/// Writes a map as OctoMap's `.ot`, pruned. Streams: memory beyond the map is some bytes per
/// brick.
///
/// # Errors
/// Writing fails, or a cell is beyond OctoMap's 16-bit keys.
pub fn write_ot(map: &OccupancyMap, out: &mut impl Write) -> Result<(), MapError> {
    write_tree(map, header::OCTREE, |_| [], out)
}

/// Writes a map as a `ColorOcTree`, pruned: cells have the colours (red, green, blue) that are
/// given, nodes above them the mean of the colours below, and all others are white, as OctoMap
/// leaves what has no colour.
///
/// # Errors
/// Writing fails, or a cell is beyond OctoMap's 16-bit keys.
pub fn write_colour_ot(
    map: &OccupancyMap,
    colours: impl IntoIterator<Item = (VoxelKey, [u8; 3])>,
    out: &mut impl Write,
) -> Result<(), MapError> {
    // of the cubes of each edge that hold coloured cells
    let mut means: BTreeMap<(u32, VoxelKey), Mean> = BTreeMap::new();
    for (cell, colour) in colours {
        for depth in 0..=TREE_DEPTH {
            let edge = 1 << (TREE_DEPTH - depth);
            means.entry(cube_of(cell, edge)).or_default().add(colour);
        }
    }
    let colour = |node: &Leaf| {
        let mean = means.get(&(node.edge_cells, node.first));
        mean.map_or([u8::MAX; 3], Mean::colour)
    };
    write_tree(map, header::COLOUR_OCTREE, colour, out)
}

/// The cube of OctoMap's tree with this edge that holds a cell.
fn cube_of(cell: VoxelKey, edge: i32) -> (u32, VoxelKey) {
    let origin = Cube::ROOT.first.to_array();
    let mut first = cell.to_array();
    for (value, origin) in first.iter_mut().zip(origin) {
        *value -= (*value - origin).rem_euclid(edge);
    }
    (edge as u32, VoxelKey::from_array(first))
}

/// The mean of colours.
#[derive(Default)]
struct Mean {
    sum: [u64; 3],
    count: u64,
}

impl Mean {
    fn add(&mut self, colour: [u8; 3]) {
        for (sum, value) in self.sum.iter_mut().zip(colour) {
            *sum += u64::from(value);
        }
        self.count += 1;
    }

    fn colour(&self) -> [u8; 3] {
        let count = self.count.max(1);
        self.sum.map(|sum| ((sum + count / 2) / count) as u8)
    }
}

/// Writes a tree whose nodes have `N` bytes more behind their log-odds.
fn write_tree<const N: usize>(
    map: &OccupancyMap,
    id: &str,
    more: impl Fn(&Leaf) -> [u8; N],
    out: &mut impl Write,
) -> Result<(), MapError> {
    let octree = Octree::new(map, View::Evidence)?;
    let mut out = BufWriter::new(out);
    header::write(&mut out, [TITLE, id], octree.counts.nodes, map.resolution())?;
    octree.visit(&mut |node, children| {
        let mask = (0..8).fold(0, |mask, octant| {
            let is_known = children.is_some_and(|children| children[octant] != Node::Unknown);
            mask | u8::from(is_known) << octant
        });
        let node_bytes = [&node.log_odds().to_le_bytes(), &more(&node)[..], &[mask]];
        let mut parts = node_bytes.into_iter();
        parts.try_for_each(|part| out.write_all(part).map_err(write_error))
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
