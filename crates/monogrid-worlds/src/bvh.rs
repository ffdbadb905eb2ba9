//! Bounding volume hierarchy over triangles: built by the binned surface area heuristic (Wald
//! 2007).

use monogrid_geometry::nalgebra::Vector3;

/// Point or direction of the renderer, `f32`.
pub type P3 = Vector3<f32>;

/// Axis-aligned box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Smallest corner.
    pub min: [f32; 3],
    /// Largest corner.
    pub max: [f32; 3],
}

impl Bounds {
    /// The box that holds nothing.
    pub const EMPTY: Self = Self {
        min: [f32::INFINITY; 3],
        max: [f32::NEG_INFINITY; 3],
    };

    /// Grows to hold a point.
    pub fn grow(&mut self, point: &P3) {
        for axis in 0..3 {
            self.min[axis] = self.min[axis].min(point[axis]);
            self.max[axis] = self.max[axis].max(point[axis]);
        }
    }

    /// Grows to hold another box.
    pub fn merge(&mut self, other: &Self) {
        for axis in 0..3 {
            self.min[axis] = self.min[axis].min(other.min[axis]);
            self.max[axis] = self.max[axis].max(other.max[axis]);
        }
    }

    /// Edge lengths; negative infinity when empty.
    #[must_use]
    pub fn size(&self) -> [f32; 3] {
        std::array::from_fn(|axis| self.max[axis] - self.min[axis])
    }

    fn half_area(&self) -> f32 {
        let s = self.size();
        if s[0] < 0.0 {
            return 0.0;
        }
        s[0] * s[1] + s[1] * s[2] + s[2] * s[0]
    }
}

/// A triangle as the intersection test wants it.
#[derive(Clone, Copy, Debug)]
pub struct Triangle {
    /// First vertex.
    pub v0: P3,
    /// Second vertex minus first.
    pub e1: P3,
    /// Third vertex minus first.
    pub e2: P3,
}

impl Triangle {
    /// From three vertices.
    #[must_use]
    pub fn new(a: P3, b: P3, c: P3) -> Self {
        Self {
            v0: a,
            e1: b - a,
            e2: c - a,
        }
    }

    /// The three vertices.
    #[must_use]
    pub fn vertices(&self) -> [P3; 3] {
        [self.v0, self.v0 + self.e1, self.v0 + self.e2]
    }

    /// Normal whose length is twice the area.
    #[must_use]
    pub fn scaled_normal(&self) -> P3 {
        self.e1.cross(&self.e2)
    }

    fn bounds(&self) -> Bounds {
        let mut bounds = Bounds::EMPTY;
        self.vertices().iter().for_each(|v| bounds.grow(v));
        bounds
    }
}

/// Where a ray meets a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance in lengths of the direction vector.
    pub t: f32,
    /// Barycentric weight of the second vertex.
    pub u: f32,
    /// Barycentric weight of the third vertex.
    pub v: f32,
    /// Index of the triangle in the order of the leaves.
    pub triangle: u32,
}

/// Slack of the barycentric test: neighbours overlap by a hair, so that no ray slips between them.
pub(super) const EDGE_SLACK: f32 = 2e-6;

/// Node: an inner one has its children at `first` and `first + 1`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Node {
    pub bounds: Bounds,
    /// First child, or first triangle of a leaf.
    pub first: u32,
    /// Triangles of a leaf; 0 marks an inner node.
    pub count: u16,
    /// Axis along which the children were separated.
    pub axis: u16,
}

/// Hierarchy over the triangles of a scene, which it reorders.
#[derive(Clone, Debug)]
pub struct Bvh {
    pub(super) nodes: Vec<Node>,
    /// Triangles in the order of the leaves.
    pub(super) triangles: Vec<Triangle>,
    /// Index in the caller's list of each of them.
    pub(super) ids: Vec<u32>,
}

const BINS: usize = 16;
const MAX_LEAF: usize = 4;
/// Below this many triangles a subtree is built by one thread.
const PARALLEL_MIN: usize = 8192;

#[derive(Clone, Copy)]
struct Item {
    bounds: Bounds,
    centre: [f32; 3],
    id: u32,
}

enum Subtree {
    Leaf(Bounds, usize, usize),
    Inner(Bounds, u16, Box<Subtree>, Box<Subtree>),
}

impl Bvh {
    /// Builds the hierarchy.
    #[must_use]
    pub fn new(triangles: &[Triangle]) -> Self {
        let mut items: Vec<Item> = triangles
            .iter()
            .enumerate()
            .map(|(id, triangle)| {
                let bounds = triangle.bounds();
                let centre = std::array::from_fn(|a| 0.5 * (bounds.min[a] + bounds.max[a]));
                Item {
                    bounds,
                    centre,
                    id: id as u32,
                }
            })
            .collect();
        let mut nodes = Vec::with_capacity(2 * triangles.len() + 1);
        nodes.push(PLACEHOLDER);
        if !items.is_empty() {
            flatten(&split(&mut items, 0, 0), 0, &mut nodes);
        }
        Self {
            nodes,
            triangles: items.iter().map(|i| triangles[i.id as usize]).collect(),
            ids: items.iter().map(|i| i.id).collect(),
        }
    }

    /// Whether there is nothing in it.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.triangles.is_empty()
    }

    /// Box around everything.
    #[must_use]
    pub fn bounds(&self) -> Bounds {
        self.nodes[0].bounds
    }

    /// Triangles that a line through the scene is compared with, on average (the cost of the
    /// surface area heuristic).
    #[must_use]
    pub fn tests_per_ray(&self) -> f32 {
        let all = self.bounds().half_area().max(f32::MIN_POSITIVE);
        let tests = |node: &Node| node.bounds.half_area() / all * f32::from(node.count);
        self.nodes.iter().map(tests).sum()
    }

    /// Nearest hit with `t` in `(t_min, t_max)` of one ray.
    #[must_use]
    pub fn nearest(&self, origin: &P3, direction: &P3, t_min: f32, t_max: f32) -> Option<Hit> {
        if self.is_empty() {
            return None;
        }
        let inverse = direction.map(safe_reciprocal);
        let mut best: Option<Hit> = None;
        let mut limit = t_max;
        let mut stack = [0u32; 64];
        let mut depth = 1;
        while depth > 0 {
            depth -= 1;
            let node = &self.nodes[stack[depth] as usize];
            if !enters(&node.bounds, origin, &inverse, limit) {
                continue;
            }
            if node.count == 0 {
                let second = u32::from(direction[usize::from(node.axis)] >= 0.0);
                stack[depth] = node.first + second;
                stack[depth + 1] = node.first + 1 - second;
                depth += 2;
                continue;
            }
            let first = node.first as usize;
            for index in first..first + usize::from(node.count) {
                if let Some(hit) = self.intersect(index, origin, direction, t_min, limit) {
                    limit = hit.t;
                    best = Some(hit);
                }
            }
        }
        best
    }

    /// Möller and Trumbore 1997, two-sided.
    fn intersect(&self, index: usize, o: &P3, d: &P3, t_min: f32, t_max: f32) -> Option<Hit> {
        let triangle = &self.triangles[index];
        let p = d.cross(&triangle.e2);
        let inverse = 1.0 / triangle.e1.dot(&p);
        let s = o - triangle.v0;
        let u = s.dot(&p) * inverse;
        let q = s.cross(&triangle.e1);
        let v = d.dot(&q) * inverse;
        let t = triangle.e2.dot(&q) * inverse;
        let inside = u >= -EDGE_SLACK && v >= -EDGE_SLACK && u + v <= 1.0 + EDGE_SLACK;
        (inside && t > t_min && t < t_max).then_some(Hit {
            t,
            u,
            v,
            triangle: index as u32,
        })
    }
}

/// Reciprocal that is never infinite, so that 0 times it is 0 and not NaN.
#[inline]
pub(super) fn safe_reciprocal(d: f32) -> f32 {
    if d.abs() < 1e-20 {
        1e20f32.copysign(d)
    } else {
        1.0 / d
    }
}

/// Slab test.
#[inline]
fn enters(bounds: &Bounds, origin: &P3, inverse: &P3, limit: f32) -> bool {
    let (mut near, mut far) = (0.0f32, limit);
    for axis in 0..3 {
        let a = (bounds.min[axis] - origin[axis]) * inverse[axis];
        let b = (bounds.max[axis] - origin[axis]) * inverse[axis];
        let (entry, exit) = if a < b { (a, b) } else { (b, a) };
        near = if entry > near { entry } else { near };
        far = if exit < far { exit } else { far };
    }
    // rounding of the slabs must not lose a triangle that lies in the face of its box
    near <= far * (1.0 + 1e-6)
}

const PLACEHOLDER: Node = Node {
    bounds: Bounds::EMPTY,
    first: 0,
    count: 0,
    axis: 0,
};

fn flatten(tree: &Subtree, at: usize, nodes: &mut Vec<Node>) {
    let children = nodes.len();
    let (bounds, first, count, axis) = match *tree {
        Subtree::Leaf(bounds, first, count) => (bounds, first, count, 0),
        Subtree::Inner(bounds, axis, ..) => (bounds, children, 0, axis),
    };
    nodes[at] = Node {
        bounds,
        first: first as u32,
        count: count as u16,
        axis,
    };
    if let Subtree::Inner(_, _, left, right) = tree {
        nodes.extend([PLACEHOLDER; 2]);
        flatten(left, children, nodes);
        flatten(right, children + 1, nodes);
    }
}

/// Splits `items`, whose first has the final position `offset`.
fn split(items: &mut [Item], offset: usize, depth: u32) -> Subtree {
    let mut bounds = Bounds::EMPTY;
    let mut centres = Bounds::EMPTY;
    for item in items.iter() {
        bounds.merge(&item.bounds);
        centres.grow(&P3::from(item.centre));
    }
    let Some((axis, plane)) = best_split(items, &bounds, &centres, depth) else {
        return Subtree::Leaf(bounds, offset, items.len());
    };
    let middle = partition(items, axis, plane);
    let (left, right) = items.split_at_mut(middle);
    let build_left = |left| Box::new(split(left, offset, depth + 1));
    let build_right = |right| Box::new(split(right, offset + middle, depth + 1));
    let (left, right) = if left.len() + right.len() > PARALLEL_MIN {
        rayon::join(|| build_left(left), || build_right(right))
    } else {
        (build_left(left), build_right(right))
    };
    Subtree::Inner(bounds, axis as u16, left, right)
}

/// How to separate the items: along which axis, by centre below which plane; `None` puts half of
/// them to each side, where no plane separates them well.
type SplitAt = (usize, Option<f32>);

fn best_split(items: &[Item], bounds: &Bounds, centres: &Bounds, depth: u32) -> Option<SplitAt> {
    let size = centres.size();
    let longest = (0..3).fold(0, |best, a| if size[a] > size[best] { a } else { best });
    if items.len() <= 1 {
        return None;
    }
    // the traversal stack holds 64 entries: halve exactly once the tree gets deep
    if depth > 32 || size[longest] <= 0.0 {
        return (items.len() > MAX_LEAF).then_some((longest, None));
    }
    let mut best = (f32::INFINITY, longest, 0.0);
    for (axis, &extent) in size.iter().enumerate() {
        if extent <= 0.0 {
            continue;
        }
        let (cost, plane) = best_plane(items, axis, centres.min[axis], extent);
        if cost < best.0 {
            best = (cost, axis, plane);
        }
    }
    // costs in units of one triangle test; a visited node costs about as much as 1.2 of them
    let split_cost = 1.2 + best.0 / bounds.half_area().max(1e-20);
    if split_cost >= items.len() as f32 && items.len() <= MAX_LEAF {
        return None;
    }
    Some(if best.0.is_finite() {
        (best.1, Some(best.2))
    } else {
        (longest, None)
    })
}

/// Cheapest of the planes between the bins of one axis: (sum of area times count, plane).
fn best_plane(items: &[Item], axis: usize, min: f32, size: f32) -> (f32, f32) {
    let mut bins = [(Bounds::EMPTY, 0usize); BINS];
    let scale = BINS as f32 / size;
    for item in items {
        let bin = (((item.centre[axis] - min) * scale) as usize).min(BINS - 1);
        bins[bin].0.merge(&item.bounds);
        bins[bin].1 += 1;
    }
    let mut right_cost = [0.0f32; BINS];
    let (mut bounds, mut count) = (Bounds::EMPTY, 0);
    for i in (1..BINS).rev() {
        bounds.merge(&bins[i].0);
        count += bins[i].1;
        right_cost[i] = if count == 0 {
            f32::INFINITY
        } else {
            bounds.half_area() * count as f32
        };
    }
    let mut best = (f32::INFINITY, 0.0);
    (bounds, count) = (Bounds::EMPTY, 0);
    for i in 1..BINS {
        bounds.merge(&bins[i - 1].0);
        count += bins[i - 1].1;
        if count == 0 {
            continue;
        }
        let cost = bounds.half_area() * count as f32 + right_cost[i];
        if cost < best.0 {
            best = (cost, min + i as f32 / scale);
        }
    }
    best
}

/// Reorders stably and returns how many went left; never 0 nor all.
fn partition(items: &mut [Item], axis: usize, plane: Option<f32>) -> usize {
    if let Some(plane) = plane {
        let (left, right): (Vec<Item>, Vec<Item>) =
            items.iter().partition(|item| item.centre[axis] < plane);
        if !left.is_empty() && !right.is_empty() {
            items[..left.len()].copy_from_slice(&left);
            items[left.len()..].copy_from_slice(&right);
            return left.len();
        }
    }
    items.sort_by(|a, b| {
        a.centre[axis]
            .total_cmp(&b.centre[axis])
            .then(a.id.cmp(&b.id))
    });
    items.len() / 2
}

#[cfg(test)]
mod tests {
    use super::super::random::Random;
    use super::*;

    fn random_point(random: &mut Random, extent: f32) -> P3 {
        P3::new(
            random.range(-extent, extent),
            random.range(-extent, extent),
            random.range(-extent, extent),
        )
    }

    pub(crate) fn soup(count: usize, seed: u64) -> Vec<Triangle> {
        let mut random = Random::new(seed);
        (0..count)
            .map(|_| {
                let a = random_point(&mut random, 3.0);
                let size = random.range(0.02, 0.8);
                let b = a + random_point(&mut random, size);
                Triangle::new(a, b, a + random_point(&mut random, size))
            })
            .collect()
    }

    fn linear(bvh: &Bvh, origin: &P3, direction: &P3) -> Option<Hit> {
        (0..bvh.triangles.len())
            .filter_map(|i| bvh.intersect(i, origin, direction, 0.0, f32::INFINITY))
            .min_by(|a, b| a.t.total_cmp(&b.t))
    }

    #[test]
    fn nearest_hit_equals_that_of_a_linear_search() {
        let bvh = Bvh::new(&soup(700, 3));
        let mut random = Random::new(4);
        let mut hits = 0;
        for _ in 0..2000 {
            let origin = random_point(&mut random, 4.0);
            let direction = random_point(&mut random, 1.0);
            let expected = linear(&bvh, &origin, &direction);
            let found = bvh.nearest(&origin, &direction, 0.0, f32::INFINITY);
            assert_eq!(found.map(|h| h.t), expected.map(|h| h.t));
            hits += usize::from(expected.is_some());
        }
        assert!(hits > 300, "{hits}");
    }

    #[test]
    fn every_triangle_is_in_exactly_one_leaf() {
        // many copies of one triangle: no plane separates them
        let mut triangles = soup(300, 5);
        triangles.extend(std::iter::repeat_n(triangles[0], 100));
        let bvh = Bvh::new(&triangles);
        let mut seen = vec![0; triangles.len()];
        for node in &bvh.nodes {
            for i in node.first..node.first + u32::from(node.count) {
                seen[bvh.ids[i as usize] as usize] += 1;
            }
        }
        assert!(seen.iter().all(|&n| n == 1));
    }

    #[test]
    fn an_empty_scene_is_never_hit() {
        let bvh = Bvh::new(&[]);
        assert!(bvh.tests_per_ray().abs() < 1e-6);
        let hit = bvh.nearest(&P3::zeros(), &P3::new(0.0, 0.0, 1.0), 0.0, f32::INFINITY);
        assert_eq!(hit, None);
    }
}
