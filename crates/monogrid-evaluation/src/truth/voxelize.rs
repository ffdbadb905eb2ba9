//! Exact surface voxelisation: every cell that a triangle touches, and no other.
//!
//! Cells are half-open, `[k, k + 1)` in units of the resolution, so a wall that lies on a boundary
//! of cells fills one layer, not two, and a coarse grid equals the maximum over a fine one.
//! Reference: Akenine-Möller, *Fast 3D triangle-box overlap testing*, JGT 2001 (separating axes).

use super::grid::{OCCUPIED, TruthGrid};
use monogrid_geometry::Vec3;

/// A triangle of a surface, in map coordinates.
pub type Triangle = [[f64; 3]; 3];

/// Marks every cell of `grid` that `triangle` touches as occupied. The triangle must be finite.
pub(crate) fn mark_triangle(grid: &mut TruthGrid, triangle: &Triangle) {
    let inv_resolution = 1.0 / grid.resolution();
    let corners = triangle.map(|p| Vec3::from(p) * inv_resolution);
    let triangle = SeparatingAxes::new(&corners);
    let (first, size) = (grid.first_key(), grid.size());
    let floor = |corner: &Vec3, axis: usize| corner[axis].floor() as i32;
    let low = [0, 1, 2].map(|axis| floor(&triangle.low, axis).max(first[axis]));
    let high = [0, 1, 2].map(|axis| {
        let last = first[axis] + size[axis] as i32 - 1;
        floor(&triangle.high, axis).min(last)
    });
    if (0..3).all(|axis| low[axis] <= high[axis]) {
        mark_box(grid, &triangle, low, high);
    }
}

/// About how many cells a triangle touches: those along its area and along its edges.
pub(crate) fn touched_cells(triangle: &Triangle, resolution: f64) -> f64 {
    let [a, b, c] = triangle.map(|p| Vec3::from(p) / resolution);
    let edges = [b - a, c - b, a - c];
    let length: f64 = edges.iter().map(|edge| edge.norm()).sum();
    1.0 + length + 0.5 * edges[0].cross(&edges[1]).norm()
}

/// Halves the box along its longest edge until single cells remain; drops boxes that the triangle
/// does not touch.
fn mark_box(grid: &mut TruthGrid, triangle: &SeparatingAxes, low: [i32; 3], high: [i32; 3]) {
    if !triangle.touches(low, high) {
        return;
    }
    let longest = (0..3).max_by_key(|a| high[*a] - low[*a]).unwrap_or(0);
    if low[longest] == high[longest] {
        if let Some(cell) = grid.local(low) {
            grid.set_code(cell, OCCUPIED);
        }
        return;
    }
    let middle = low[longest] + (high[longest] - low[longest]) / 2;
    let (mut high_of_first, mut low_of_second) = (high, low);
    high_of_first[longest] = middle;
    low_of_second[longest] = middle + 1;
    mark_box(grid, triangle, low, high_of_first);
    mark_box(grid, triangle, low_of_second, high);
}

/// The 13 axes that can separate a triangle from a box, with the triangle's extent along each.
struct SeparatingAxes {
    low: Vec3,
    high: Vec3,
    /// Normal and the nine products of edges with the box's axes: axis, least and greatest.
    others: [(Vec3, f64, f64); 10],
}

impl SeparatingAxes {
    fn new(corners: &[Vec3; 3]) -> Self {
        let edges = [
            corners[1] - corners[0],
            corners[2] - corners[1],
            corners[0] - corners[2],
        ];
        let normal = edges[0].cross(&edges[1]);
        let units = [Vec3::x(), Vec3::y(), Vec3::z()];
        let others = std::array::from_fn(|i| {
            let axis = match i.checked_sub(1) {
                None => normal,
                Some(product) => units[product / 3].cross(&edges[product % 3]),
            };
            let along = corners.map(|c| c.dot(&axis));
            let least = along.into_iter().fold(f64::INFINITY, f64::min);
            let greatest = along.into_iter().fold(f64::NEG_INFINITY, f64::max);
            (axis, least, greatest)
        });
        Self {
            low: corners[0].inf(&corners[1]).inf(&corners[2]),
            high: corners[0].sup(&corners[1]).sup(&corners[2]),
            others,
        }
    }

    /// Whether the triangle meets the cells from `low` to `high`, both inclusive.
    fn touches(&self, low: [i32; 3], high: [i32; 3]) -> bool {
        let box_low = Vec3::from(low.map(f64::from));
        let box_high = Vec3::from(high.map(|k| f64::from(k) + 1.0));
        // Along the axes of the box its upper face does not belong to it.
        if (0..3).any(|a| self.high[a] < box_low[a] || self.low[a] >= box_high[a]) {
            return false;
        }
        let center = (box_low + box_high) * 0.5;
        let half = (box_high - box_low) * 0.5;
        self.others.iter().all(|(axis, least, greatest)| {
            let middle = axis.dot(&center);
            let reach = axis.abs().dot(&half);
            *least <= middle + reach && *greatest >= middle - reach
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_occupancy::Occupancy;

    fn grid() -> TruthGrid {
        TruthGrid::new(0.5, [-8; 3], [8; 3], 1 << 20).expect("a small grid")
    }

    fn occupied(triangle: &Triangle) -> Vec<[i32; 3]> {
        let mut grid = grid();
        mark_triangle(&mut grid, triangle);
        grid.keys_in(Occupancy::Occupied).collect()
    }

    /// Cells of points spread densely over the triangle, its corners and edges included.
    fn sampled(triangle: &Triangle, steps: u32) -> Vec<[i32; 3]> {
        let grid = grid();
        let corners = triangle.map(Vec3::from);
        let mut keys = Vec::new();
        for i in 0..=steps {
            for j in 0..=steps - i {
                let (u, v) = (
                    f64::from(i) / f64::from(steps),
                    f64::from(j) / f64::from(steps),
                );
                let point = corners[0] * (1.0 - u - v) + corners[1] * u + corners[2] * v;
                keys.push(grid.key(point.into()).expect("finite"));
            }
        }
        keys.sort_by_key(|k| (k[2], k[1], k[0]));
        keys.dedup();
        keys
    }

    #[test]
    fn finds_every_cell_that_samples_hit_and_hardly_any_more() {
        let mut state = 1_u64;
        let mut uniform = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(99);
            (state >> 11) as f64 / (1_u64 << 53) as f64 * 7.0 - 3.5
        };
        for _ in 0..30 {
            let triangle: Triangle = std::array::from_fn(|_| std::array::from_fn(|_| uniform()));
            let exact = occupied(&triangle);
            let samples = sampled(&triangle, 700);
            assert!(samples.iter().all(|k| exact.contains(k)), "{triangle:?}");
            // Cells that the triangle only grazes escape the samples.
            assert!(
                exact.len() <= samples.len() + 3 + samples.len() / 50,
                "{triangle:?}"
            );
        }
    }

    #[test]
    fn a_wall_on_a_boundary_is_one_cell_thick() {
        let wall = [[1.0, -2.0, -2.0], [1.0, 1.9, -2.0], [1.0, -2.0, 1.9]];
        let cells = occupied(&wall);
        assert!(
            !cells.is_empty() && cells.iter().all(|k| k[0] == 2),
            "{cells:?}"
        );
    }

    #[test]
    fn a_triangle_without_area_is_a_line_or_a_point() {
        let point = [[0.3, 0.3, 0.3]; 3];
        assert_eq!(occupied(&point), vec![[0, 0, 0]]);
        let line = [[0.1, 0.1, 0.1], [1.9, 0.1, 0.1], [1.0, 0.1, 0.1]];
        assert_eq!(occupied(&line).len(), 4);
    }
}
