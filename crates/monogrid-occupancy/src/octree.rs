//! The map seen as OctoMap's pruned octree, without ever building one.
//!
//! The Morton code of a node is that of its parent and three bits for the octant (bit 0 x, bit 1 y,
//! bit 2 z, as OctoMap). A brick is the subtree of 8 x 8 x 8 cells at OctoMap's level 3. Above
//! bricks, nodes are kept as lists sorted by their codes, one list per level: some bytes per brick,
//! nothing per cell. Eight known leaves of equal value under one parent are one leaf (pruning); the
//! value of an inner node is the largest value below it.

use crate::error::MapError;
use crate::evidence::{UNKNOWN, log_odds_from_evidence};
use crate::io::header::Cube;
use crate::key::{BRICK_CELLS, BRICK_EDGE, BrickKey, VoxelKey};
use crate::likelihood::classified;
use crate::map::OccupancyMap;
use crate::storage::BrickRef;

/// Levels above bricks in OctoMap's tree of 16-bit keys: 13, of 16 in all.
const LEVELS_ABOVE_BRICKS: usize = 13;
/// Bricks of an OctoMap tree have indices in `-4096..4096`.
const OCTOMAP_BRICK_LIMIT: i32 = 4096;

/// A node of the pruned tree.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Node {
    Unknown,
    Leaf(i16),
    /// Has children; the value is the largest below.
    Inner(i16),
}

impl Node {
    fn of_cell(value: i16) -> Self {
        match value {
            UNKNOWN => Self::Unknown,
            _ => Self::Leaf(value),
        }
    }

    /// The parent of eight children, which count if it has any.
    fn parent(children: &[Self; 8], counts: &mut TreeCounts) -> Self {
        let is_leaf = matches!(children[0], Self::Leaf(_)) && children == &[children[0]; 8];
        match children.iter().filter_map(|child| child.value()).max() {
            None => Self::Unknown,
            Some(value) if is_leaf => Self::Leaf(value),
            Some(value) => {
                children.iter().for_each(|child| counts.add(*child));
                Self::Inner(value)
            }
        }
    }

    fn value(self) -> Option<i16> {
        match self {
            Self::Unknown => None,
            Self::Leaf(value) | Self::Inner(value) => Some(value),
        }
    }
}

/// Places in a brick of cells in the order of their Morton codes.
const CELL_OF_CODE: [usize; BRICK_CELLS] = {
    let mut cells = [0; BRICK_CELLS];
    let mut code = 0;
    while code < BRICK_CELLS as i32 {
        let four = VoxelKey::new(0, 0, 0).of_octant(code >> 6, 4);
        let cell = four.of_octant(code >> 3 & 7, 2).of_octant(code & 7, 1);
        cells[code as usize] = cell.index_in_brick();
        code += 1;
    }
    cells
};

/// The subtree of one brick: nodes of 4, of 2 and of 1 cells' edge below the root, in the order of
/// their codes.
struct BrickTree {
    root: Node,
    fours: [Node; 8],
    twos: [Node; 64],
    cells: [Node; BRICK_CELLS],
}

impl BrickTree {
    /// Counts the nodes below the root.
    fn new(cells: &[i16; BRICK_CELLS], counts: &mut TreeCounts) -> Self {
        let cells = CELL_OF_CODE.map(|cell| Node::of_cell(cells[cell]));
        let parent = |children: &[Node], i: usize, counts: &mut TreeCounts| {
            Node::parent(&children.as_chunks().0[i], counts)
        };
        let twos = std::array::from_fn(|i| parent(&cells, i, counts));
        let fours = std::array::from_fn(|i| parent(&twos, i, counts));
        Self {
            root: Node::parent(&fours, counts),
            fours,
            twos,
            cells,
        }
    }

    /// The children of a node of 8, 4 or 2 cells' edge.
    fn children(&self, edge_cells: i32, code: u64) -> [Node; 8] {
        let code = code as usize;
        match edge_cells {
            2 => self.cells.as_chunks().0[code % 64],
            4 => self.twos.as_chunks().0[code % 8],
            _ => self.fours,
        }
    }
}

/// Size of a pruned tree.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct TreeCounts {
    pub nodes: usize,
    pub leaves: usize,
}

impl TreeCounts {
    fn add(&mut self, node: Node) {
        self.nodes += usize::from(node != Node::Unknown);
        self.leaves += usize::from(matches!(node, Node::Leaf(_)));
    }
}

/// One leaf of the pruned tree: a cube of equal, known cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Leaf {
    /// The cell of the cube with the smallest indices.
    pub first: VoxelKey,
    /// Edge of the cube in cells, a power of two.
    pub edge_cells: u32,
    /// Evidence in 1/4096 log-odds.
    pub evidence: i16,
}

impl Leaf {
    /// Centre of the cube in map coordinates.
    #[must_use]
    pub fn center(&self, resolution: f64) -> [f64; 3] {
        let half = f64::from(self.edge_cells) * 0.5;
        let first = self.first.to_array();
        first.map(|c| (f64::from(c) + half) * resolution)
    }

    /// Log-odds of the cells.
    #[must_use]
    pub fn log_odds(&self) -> f32 {
        log_odds_from_evidence(self.evidence)
    }
}

/// Interleaves the low 13 bits of a brick's biased indices, x lowest.
fn morton(key: BrickKey) -> u64 {
    let spread = |c: i32| {
        let bits = (c + OCTOMAP_BRICK_LIMIT) as u64;
        (0..LEVELS_ABOVE_BRICKS).fold(0, |m, b| m | ((bits >> b & 1) << (3 * b)))
    };
    spread(key.x) | (spread(key.y) << 1) | (spread(key.z) << 2)
}

/// What a walk shows of the evidence of a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum View {
    /// As it is stored.
    Evidence,
    /// Only free or occupied: the maximum-likelihood tree of `.bt`.
    Likely,
}

impl View {
    fn of(self, map: &OccupancyMap, value: i16) -> i16 {
        match self {
            Self::Evidence => value,
            Self::Likely => classified(map.limits, value),
        }
    }

    fn brick(self, map: &OccupancyMap, key: BrickKey, counts: &mut TreeCounts) -> BrickTree {
        let cells = map.brick_values(key).map(|value| self.of(map, value));
        BrickTree::new(&cells, counts)
    }
}

/// The levels of the tree from bricks (0) up to the root (13).
pub(crate) struct Octree<'a> {
    map: &'a OccupancyMap,
    view: View,
    levels: Vec<Vec<(u64, Node)>>,
    pub counts: TreeCounts,
}

impl<'a> Octree<'a> {
    /// Collects the levels above the bricks of `map`.
    ///
    /// # Errors
    /// A brick beyond OctoMap's 16-bit keys.
    pub(crate) fn new(map: &'a OccupancyMap, view: View) -> Result<Self, MapError> {
        let mut octree = Self {
            map,
            view,
            levels: Vec::new(),
            counts: TreeCounts::default(),
        };
        let counts = &mut octree.counts;
        let mut nodes = Vec::new();
        for key in map.bricks() {
            let range = -OCTOMAP_BRICK_LIMIT..OCTOMAP_BRICK_LIMIT;
            if ![key.x, key.y, key.z].iter().all(|c| range.contains(c)) {
                return Err(MapError::OutOfOctomapRange {
                    cell: key.first_cell().to_array(),
                });
            }
            let root = match map.brick(key) {
                BrickRef::Uniform(value) => Node::of_cell(view.of(map, value)),
                BrickRef::Mixed(_) | BrickRef::Packed(_) => view.brick(map, key, counts).root,
            };
            if root != Node::Unknown {
                nodes.push((morton(key), root));
            }
        }
        nodes.sort_unstable_by_key(|(code, _)| *code);
        for _ in 0..LEVELS_ABOVE_BRICKS {
            let parent = |siblings: &[(u64, Node)]| {
                let node = Node::parent(&family(siblings), counts);
                (siblings[0].0 >> 3, node)
            };
            let parents = nodes.chunk_by(are_siblings).map(parent).collect();
            octree.levels.push(std::mem::replace(&mut nodes, parents));
        }
        octree.levels.push(nodes);
        let root = octree.root();
        octree.counts.add(root);
        Ok(octree)
    }

    /// The node at the top, unknown for an empty map.
    pub(crate) fn root(&self) -> Node {
        let top = self.levels[LEVELS_ABOVE_BRICKS].first();
        top.map_or(Node::Unknown, |(_, node)| *node)
    }

    /// Walks the tree depth first, children in OctoMap's order: tells of each node, and before its
    /// children of those that an inner one has.
    pub(crate) fn visit<F>(&self, tell: &mut F) -> Result<(), MapError>
    where
        F: FnMut(Leaf, Option<&[Node; 8]>) -> Result<(), MapError>,
    {
        self.visit_node(Cube::ROOT, 0, self.root(), None, tell)
    }

    /// `brick` is the one that holds the node, if that is smaller than one.
    fn visit_node<F>(
        &self,
        cube: Cube,
        code: u64,
        node: Node,
        brick: Option<&BrickTree>,
        tell: &mut F,
    ) -> Result<(), MapError>
    where
        F: FnMut(Leaf, Option<&[Node; 8]>) -> Result<(), MapError>,
    {
        let Some(evidence) = node.value() else {
            return Ok(());
        };
        let edge = cube.edge_cells();
        let leaf = Leaf {
            first: cube.first,
            edge_cells: edge as u32,
            evidence,
        };
        if let Node::Leaf(_) = node {
            return tell(leaf, None);
        }
        let own = (edge == BRICK_EDGE).then(|| {
            let key = cube.first.brick();
            self.view.brick(self.map, key, &mut TreeCounts::default())
        });
        let brick = own.as_ref().or(brick);
        let children = match brick {
            Some(brick) => brick.children(edge, code),
            None => self.children(LEVELS_ABOVE_BRICKS - cube.depth as usize, code),
        };
        tell(leaf, Some(&children))?;
        for (octant, child) in (0..).zip(children) {
            let code = code << 3 | octant as u64;
            self.visit_node(cube.child(octant), code, child, brick, tell)?;
        }
        Ok(())
    }

    /// The children of an inner node above bricks.
    fn children(&self, level: usize, code: u64) -> [Node; 8] {
        let below = &self.levels[level - 1];
        let start = below.partition_point(|(c, _)| *c < code << 3);
        family(below[start..].chunk_by(are_siblings).next().unwrap_or(&[]))
    }
}

fn are_siblings(a: &(u64, Node), b: &(u64, Node)) -> bool {
    a.0 >> 3 == b.0 >> 3
}

/// Eight children by octant, of which some are known.
fn family(siblings: &[(u64, Node)]) -> [Node; 8] {
    let mut children = [Node::Unknown; 8];
    for &(code, node) in siblings {
        children[(code & 7) as usize] = node;
    }
    children
}

impl OccupancyMap {
    /// Leaves of the pruned octree, as OctoMap would count them.
    ///
    /// # Errors
    /// A cell beyond OctoMap's 16-bit keys.
    pub fn octree_leaf_count(&self) -> Result<usize, MapError> {
        Ok(Octree::new(self, View::Evidence)?.counts.leaves)
    }

    /// Nodes of the pruned octree, leaves included, as OctoMap would count them.
    ///
    /// # Errors
    /// A cell beyond OctoMap's 16-bit keys.
    pub fn octree_node_count(&self) -> Result<usize, MapError> {
        Ok(Octree::new(self, View::Evidence)?.counts.nodes)
    }

    /// Leaves of the pruned octree; of a map beyond OctoMap's keys, the number of uniform
    /// bricks plus that of known cells in mixed ones. Visits every brick.
    #[must_use]
    pub fn leaf_count(&self) -> usize {
        let leaves = |key| match self.brick(key) {
            BrickRef::Uniform(_) => 1,
            BrickRef::Mixed(_) | BrickRef::Packed(_) => {
                let values = self.brick_values(key);
                values.iter().filter(|v| **v != UNKNOWN).count()
            }
        };
        let exact = self.octree_leaf_count();
        exact.unwrap_or_else(|_| self.bricks().into_iter().map(leaves).sum())
    }

    /// All leaves of the pruned octree in OctoMap's depth-first order.
    ///
    /// # Errors
    /// A cell beyond OctoMap's 16-bit keys.
    pub fn octree_leaves(&self) -> Result<Vec<Leaf>, MapError> {
        let mut leaves = Vec::new();
        self.for_each_leaf(|leaf| leaves.push(leaf))?;
        Ok(leaves)
    }

    /// Tells of each leaf of the pruned octree, in OctoMap's depth-first order.
    ///
    /// # Errors
    /// A cell beyond OctoMap's 16-bit keys.
    pub fn for_each_leaf(&self, mut tell: impl FnMut(Leaf)) -> Result<(), MapError> {
        Octree::new(self, View::Evidence)?.visit(&mut |node, children| {
            if children.is_none() {
                tell(node);
            }
            Ok(())
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::map::MapConfig;

    #[test]
    fn morton_codes_sort_as_octomap_walks() {
        let origin = morton(BrickKey::new(0, 0, 0));
        assert_eq!(morton(BrickKey::new(1, 0, 0)), origin + 1);
        assert_eq!(morton(BrickKey::new(0, 1, 0)), origin + 2);
        assert_eq!(morton(BrickKey::new(0, 0, 1)), origin + 4);
    }

    #[test]
    fn equal_neighbours_are_pruned_across_bricks_and_nothing_else_is() {
        let mut map = OccupancyMap::new(MapConfig::default()).unwrap();
        for x in 0..16 {
            for y in 0..16 {
                for z in 0..16 {
                    map.set_log_odds(VoxelKey::new(x, y, z), Some(-1.0))
                        .unwrap();
                }
            }
        }
        let leaves = map.octree_leaves().unwrap();
        assert_eq!(leaves.len(), 1);
        assert_eq!(leaves[0].edge_cells, 16);
        map.set_log_odds(VoxelKey::new(3, 0, 0), Some(1.0)).unwrap();
        // One of 8 bricks breaks up: 7 bricks, 7 fours, 7 twos, 8 cells.
        assert_eq!(map.leaf_count(), 7 + 7 + 7 + 8);
        let leaves = map.octree_leaves().unwrap();
        assert_eq!(leaves.len(), map.leaf_count());
        let cells: u64 = leaves.iter().map(|l| u64::from(l.edge_cells).pow(3)).sum();
        assert_eq!(cells, 16 * 16 * 16);
        // Nodes: root and 11 inner levels down to edge 16, then 8 bricks, 8, 8, 8.
        let octree = Octree::new(&map, View::Evidence).unwrap();
        assert_eq!(octree.counts.nodes, 13 + 8 + 8 + 8 + 8);
        assert_eq!(map.octree_node_count().unwrap(), octree.counts.nodes);
    }
}
