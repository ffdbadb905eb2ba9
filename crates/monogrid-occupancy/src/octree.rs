//! The map seen as OctoMap's pruned octree, without ever building one.
//!
//! A brick is the subtree of 8 x 8 x 8 cells at OctoMap's level 3. Above bricks, nodes are kept
//! as sorted lists of Morton codes, one list per level: some bytes per brick, nothing per cell.
//! Eight known leaves of equal value under one parent are one leaf (pruning); the value of an
//! inner node is the largest value below it.

use crate::error::MapError;
use crate::evidence::UNKNOWN;
use crate::key::{BRICK_CELLS, BrickKey, VoxelKey};
use crate::likelihood::classified;
use crate::map::OccupancyMap;
use crate::storage::BrickRef;

/// Levels above bricks in OctoMap's tree of 16-bit keys: 13, of 16 in all.
pub(crate) const LEVELS_ABOVE_BRICKS: usize = 13;
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
    /// The parent of eight children.
    fn parent(children: [Node; 8]) -> Node {
        let mut largest = None;
        let mut prunable = true;
        for child in children {
            let value = match child {
                Node::Unknown => None,
                Node::Leaf(value) | Node::Inner(value) => Some(value),
            };
            prunable &= matches!(child, Node::Leaf(_)) && child == children[0];
            largest = largest.max(value);
        }
        match largest {
            None => Node::Unknown,
            Some(value) if prunable => Node::Leaf(value),
            Some(value) => Node::Inner(value),
        }
    }

    pub(crate) fn value(self) -> Option<i16> {
        match self {
            Node::Unknown => None,
            Node::Leaf(value) | Node::Inner(value) => Some(value),
        }
    }
}

/// The subtree of one brick: nodes of 4, of 2 and of 1 cells' edge below the root, each level
/// stored with x fastest.
pub(crate) struct BrickTree {
    pub root: Node,
    pub fours: [Node; 8],
    pub twos: [Node; 64],
    pub cells: [i16; BRICK_CELLS],
}

/// Child `octant` (bit 0 x, bit 1 y, bit 2 z, as OctoMap) of node `(x, y, z)`, in a level of
/// `2^edge_bits` nodes per axis.
#[inline]
pub(crate) fn child_index(parent: [usize; 3], octant: usize, edge_bits: u32) -> usize {
    (parent[0] * 2 + (octant & 1))
        | ((parent[1] * 2 + ((octant >> 1) & 1)) << edge_bits)
        | ((parent[2] * 2 + (octant >> 2)) << (2 * edge_bits))
}

#[inline]
fn cell_node(value: i16) -> Node {
    match value {
        UNKNOWN => Node::Unknown,
        _ => Node::Leaf(value),
    }
}

impl BrickTree {
    pub(crate) fn new(cells: [i16; BRICK_CELLS]) -> Self {
        let twos = std::array::from_fn(|i| {
            let at = [i & 3, (i >> 2) & 3, i >> 4];
            Node::parent(std::array::from_fn(|o| {
                cell_node(cells[child_index(at, o, 3)])
            }))
        });
        let fours: [Node; 8] = std::array::from_fn(|i| {
            let at = [i & 1, (i >> 1) & 1, i >> 2];
            Node::parent(std::array::from_fn(|o| twos[child_index(at, o, 2)]))
        });
        Self {
            root: Node::parent(fours),
            fours,
            twos,
            cells,
        }
    }

    /// Nodes and leaves of the subtree, the root included.
    fn counts(&self) -> TreeCounts {
        let mut counts = TreeCounts::default();
        counts.add(self.root);
        if !matches!(self.root, Node::Inner(_)) {
            return counts;
        }
        for (i, &four) in self.fours.iter().enumerate() {
            counts.add(four);
            if !matches!(four, Node::Inner(_)) {
                continue;
            }
            let at = [i & 1, (i >> 1) & 1, i >> 2];
            for octant in 0..8 {
                let j = child_index(at, octant, 2);
                counts.add(self.twos[j]);
                if matches!(self.twos[j], Node::Inner(_)) {
                    let at = [j & 3, (j >> 2) & 3, j >> 4];
                    for octant in 0..8 {
                        counts.add(cell_node(self.cells[child_index(at, octant, 3)]));
                    }
                }
            }
        }
        counts
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
        self.first
            .to_array()
            .map(|c| (f64::from(c) + half) * resolution)
    }

    /// Log-odds of the cells.
    #[must_use]
    pub fn log_odds(&self) -> f32 {
        crate::evidence::log_odds_from_evidence(self.evidence)
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

/// The inverse of [`morton`].
fn brick_of_morton(code: u64) -> BrickKey {
    let gather = |axis: usize| {
        let bits = (0..LEVELS_ABOVE_BRICKS).fold(0, |c, b| c | ((code >> (3 * b + axis) & 1) << b));
        bits as i32 - OCTOMAP_BRICK_LIMIT
    };
    BrickKey::new(gather(0), gather(1), gather(2))
}

/// What a walk over the pruned tree meets, in OctoMap's depth-first order.
pub(crate) trait TreeVisitor {
    /// A node with its eight children; called for inner nodes before their children.
    fn inner(&mut self, value: i16, children: &[Node; 8]) -> Result<(), MapError>;
    /// A leaf.
    fn leaf(&mut self, leaf: Leaf) -> Result<(), MapError>;
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

    fn brick(self, map: &OccupancyMap, key: BrickKey) -> BrickTree {
        BrickTree::new(map.brick_values(key).map(|value| self.of(map, value)))
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
        let mut counts = TreeCounts::default();
        let mut bricks = Vec::new();
        for key in map.bricks() {
            if [key.x, key.y, key.z]
                .iter()
                .any(|c| !(-OCTOMAP_BRICK_LIMIT..OCTOMAP_BRICK_LIMIT).contains(c))
            {
                return Err(MapError::OutOfOctomapRange {
                    cell: key.first_cell().to_array(),
                });
            }
            let root = match map.brick(key) {
                BrickRef::Uniform(value) => cell_node(view.of(map, value)),
                BrickRef::Mixed(_) | BrickRef::Packed(_) => {
                    let tree = view.brick(map, key);
                    if let Node::Inner(_) = tree.root {
                        let inside = tree.counts();
                        counts.nodes += inside.nodes;
                        counts.leaves += inside.leaves;
                    }
                    tree.root
                }
            };
            if root != Node::Unknown {
                bricks.push((morton(key), root));
            }
        }
        bricks.sort_unstable_by_key(|(code, _)| *code);
        let mut levels = vec![bricks];
        for _ in 0..LEVELS_ABOVE_BRICKS {
            let below = levels.last().map_or(&[][..], Vec::as_slice);
            levels.push(parents(below));
        }
        let mut octree = Self {
            map,
            view,
            levels,
            counts,
        };
        octree.count_above_bricks();
        Ok(octree)
    }

    /// Adds the nodes that are not inside mixed bricks: all whose parent is inner.
    fn count_above_bricks(&mut self) {
        for level in 0..=LEVELS_ABOVE_BRICKS {
            for (i, &(code, node)) in self.levels[level].iter().enumerate() {
                let is_mixed_brick = level == 0 && matches!(node, Node::Inner(_));
                let exists = level == LEVELS_ABOVE_BRICKS || {
                    let above = &self.levels[level + 1];
                    above
                        .binary_search_by_key(&(code >> 3), |(c, _)| *c)
                        .is_ok_and(|p| matches!(above[p].1, Node::Inner(_)))
                };
                debug_assert!(i < self.levels[level].len());
                if exists && !is_mixed_brick {
                    self.counts.add(node);
                }
            }
        }
    }

    /// The node at the top, unknown for an empty map.
    pub(crate) fn root(&self) -> Node {
        self.levels[LEVELS_ABOVE_BRICKS]
            .first()
            .map_or(Node::Unknown, |(_, node)| *node)
    }

    /// Walks the tree depth first, children in OctoMap's order.
    pub(crate) fn visit(&self, visitor: &mut impl TreeVisitor) -> Result<(), MapError> {
        self.visit_node(LEVELS_ABOVE_BRICKS, 0, self.root(), visitor)
    }

    fn visit_node(
        &self,
        level: usize,
        code: u64,
        node: Node,
        visitor: &mut impl TreeVisitor,
    ) -> Result<(), MapError> {
        match node {
            Node::Unknown => Ok(()),
            Node::Leaf(evidence) => visitor.leaf(Leaf {
                first: brick_of_morton(code << (3 * level)).first_cell(),
                edge_cells: 8 << level,
                evidence,
            }),
            Node::Inner(_) if level == 0 => {
                let key = brick_of_morton(code);
                visit_brick(key, &self.view.brick(self.map, key), visitor)
            }
            Node::Inner(value) => {
                let below = &self.levels[level - 1];
                let start = below.partition_point(|(c, _)| *c < code << 3);
                let mut children = [Node::Unknown; 8];
                for &(c, child) in below[start..].iter().take_while(|(c, _)| c >> 3 == code) {
                    children[(c & 7) as usize] = child;
                }
                visitor.inner(value, &children)?;
                for (octant, &child) in children.iter().enumerate() {
                    self.visit_node(level - 1, code << 3 | octant as u64, child, visitor)?;
                }
                Ok(())
            }
        }
    }
}

/// The level above a sorted level.
fn parents(below: &[(u64, Node)]) -> Vec<(u64, Node)> {
    let families = below.chunk_by(|a, b| a.0 >> 3 == b.0 >> 3);
    let parent = |siblings: &[(u64, Node)]| {
        let mut children = [Node::Unknown; 8];
        for &(code, node) in siblings {
            children[(code & 7) as usize] = node;
        }
        (siblings[0].0 >> 3, Node::parent(children))
    };
    families.map(parent).collect()
}

fn visit_brick(
    key: BrickKey,
    tree: &BrickTree,
    visitor: &mut impl TreeVisitor,
) -> Result<(), MapError> {
    let first = key.first_cell();
    let leaf = |at: [usize; 3], edge: u32, evidence: i16| Leaf {
        first: VoxelKey::new(
            first.x + at[0] as i32 * edge as i32,
            first.y + at[1] as i32 * edge as i32,
            first.z + at[2] as i32 * edge as i32,
        ),
        edge_cells: edge,
        evidence,
    };
    let Some(value) = tree.root.value() else {
        return Ok(());
    };
    visitor.inner(value, &tree.fours)?;
    for (i, &four) in tree.fours.iter().enumerate() {
        let at = [i & 1, (i >> 1) & 1, i >> 2];
        match four {
            Node::Unknown => {}
            Node::Leaf(evidence) => visitor.leaf(leaf(at, 4, evidence))?,
            Node::Inner(value) => {
                let children = std::array::from_fn(|o| tree.twos[child_index(at, o, 2)]);
                visitor.inner(value, &children)?;
                for (octant, &two) in children.iter().enumerate() {
                    let j = child_index(at, octant, 2);
                    let at = [j & 3, (j >> 2) & 3, j >> 4];
                    match two {
                        Node::Unknown => {}
                        Node::Leaf(evidence) => visitor.leaf(leaf(at, 2, evidence))?,
                        Node::Inner(value) => {
                            let cells: [Node; 8] = std::array::from_fn(|o| {
                                cell_node(tree.cells[child_index(at, o, 3)])
                            });
                            visitor.inner(value, &cells)?;
                            for (octant, &cell) in cells.iter().enumerate() {
                                if let Node::Leaf(evidence) = cell {
                                    let k = child_index(at, octant, 3);
                                    let at = [k & 7, (k >> 3) & 7, k >> 6];
                                    visitor.leaf(leaf(at, 1, evidence))?;
                                }
                            }
                        }
                    }
                }
            }
        }
    }
    Ok(())
}

struct EachLeaf<F>(F);

impl<F: FnMut(Leaf)> TreeVisitor for EachLeaf<F> {
    fn inner(&mut self, _: i16, _: &[Node; 8]) -> Result<(), MapError> {
        Ok(())
    }

    fn leaf(&mut self, leaf: Leaf) -> Result<(), MapError> {
        (self.0)(leaf);
        Ok(())
    }
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
        self.octree_leaf_count().unwrap_or_else(|_| {
            self.bricks()
                .into_iter()
                .map(|key| match self.brick(key) {
                    BrickRef::Uniform(_) => 1,
                    BrickRef::Mixed(_) | BrickRef::Packed(_) => {
                        let values = self.brick_values(key);
                        values.iter().filter(|v| **v != UNKNOWN).count()
                    }
                })
                .sum()
        })
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
    pub fn for_each_leaf(&self, tell: impl FnMut(Leaf)) -> Result<(), MapError> {
        Octree::new(self, View::Evidence)?.visit(&mut EachLeaf(tell))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::map::MapConfig;

    #[test]
    fn morton_codes_round_trip_and_sort_as_octomap_walks() {
        for key in [
            BrickKey::new(0, 0, 0),
            BrickKey::new(-1, 4095, -4096),
            BrickKey::new(17, -300, 2),
        ] {
            assert_eq!(brick_of_morton(morton(key)), key);
        }
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
