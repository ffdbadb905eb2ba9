//! A dense grid of blocked cells for planning, with the distance of every cell to the nearest of
//! them.
//!
//! Reference: Felzenszwalb and Huttenlocher, *Distance transforms of sampled functions*, Theory of
//! Computing 2012: exact, one axis after the other.

/// Squared distance where nothing is blocked, cells².
const FAR_SQ: f32 = 1e12;

/// Distances between centres of cells, x fastest.
#[derive(Clone, Debug)]
pub(crate) struct DistanceGrid {
    pub size: [usize; 3],
    /// Distance of every cell to the nearest blocked one, in cells.
    cells: Vec<f32>,
}

impl DistanceGrid {
    /// Distances to the cells where `is_blocked`; everything outside the grid is blocked too.
    pub fn new(size: [usize; 3], is_blocked: impl Fn(usize) -> bool) -> Self {
        Self::along(3, size, is_blocked)
    }

    /// As [`Self::new`] for one layer of cells, above and below which nothing is.
    pub fn flat([width, height]: [usize; 2], is_blocked: impl Fn(usize) -> bool) -> Self {
        Self::along(2, [width, height, 1], is_blocked)
    }

    /// Distances along so many axes.
    fn along(axes: usize, size: [usize; 3], is_blocked: impl Fn(usize) -> bool) -> Self {
        let count = size[0] * size[1] * size[2];
        let mut cells: Vec<f32> = (0..count)
            .map(|i| if is_blocked(i) { 0.0 } else { FAR_SQ })
            .collect();
        let strides = [1, size[0], size[0] * size[1]];
        let mut line = Line::default();
        for axis in 0..axes {
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            for j in 0..size[v] {
                for i in 0..size[u] {
                    let first = i * strides[u] + j * strides[v];
                    line.transform(&mut cells, first, strides[axis], size[axis]);
                }
            }
        }
        for cell in &mut cells {
            *cell = cell.sqrt();
        }
        Self { size, cells }
    }

    /// Distance of a cell to the nearest blocked one, in cells.
    pub fn at(&self, index: usize) -> f32 {
        self.cells[index]
    }

    pub fn len(&self) -> usize {
        self.cells.len()
    }

    pub fn index(&self, cell: [usize; 3]) -> usize {
        index_in(self.size, cell)
    }

    pub fn cell(&self, index: usize) -> [usize; 3] {
        let row = index / self.size[0];
        [index % self.size[0], row % self.size[1], row / self.size[1]]
    }
}

/// Where a cell lies in a grid of this size: x fastest, then y, then z.
pub fn index_in(size: [usize; 3], [x, y, z]: [usize; 3]) -> usize {
    (z * size[1] + y) * size[0] + x
}

/// Scratch space of the one-dimensional transform.
#[derive(Default)]
struct Line {
    values: Vec<f32>,
    /// Positions of the parabolas of the lower envelope and where each begins.
    apex: Vec<usize>,
    begin: Vec<f32>,
}

impl Line {
    /// Replaces the values of a line by `min over q of (p - q)² + value(q)`, with a blocked cell
    /// beyond each end.
    fn transform(&mut self, cells: &mut [f32], first: usize, stride: usize, length: usize) {
        self.values.clear();
        self.values.push(0.0);
        let line = (0..length).map(|i| cells[first + i * stride]);
        self.values.extend(line.chain([0.0]));
        self.apex.clear();
        self.begin.clear();
        for q in 0..self.values.len() {
            let mut begin = f32::NEG_INFINITY;
            while let Some(&p) = self.apex.last() {
                begin = self.crossing(p, q);
                if self.begin.last().is_none_or(|b| begin > *b) {
                    break;
                }
                self.apex.pop();
                self.begin.pop();
                begin = f32::NEG_INFINITY;
            }
            self.apex.push(q);
            self.begin.push(begin);
        }
        let mut parabola = 0;
        for i in 0..length {
            let position = (i + 1) as f32;
            while self.begin.get(parabola + 1).is_some_and(|b| *b < position) {
                parabola += 1;
            }
            let offset = position - self.apex[parabola] as f32;
            cells[first + i * stride] = offset * offset + self.values[self.apex[parabola]];
        }
    }

    /// Where the parabola over `q` falls below that over `p < q`.
    fn crossing(&self, p: usize, q: usize) -> f32 {
        let (pf, qf) = (p as f64, q as f64);
        let rise = f64::from(self.values[q]) - f64::from(self.values[p]) + qf * qf - pf * pf;
        (rise / (2.0 * (qf - pf))) as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agrees_with_brute_force() {
        let mut state = 5_u64;
        for blocked_share in [0, 5, 60] {
            let size = [9, 7, 8];
            let blocked: Vec<bool> = (0..9 * 7 * 8)
                .map(|_| {
                    state = state
                        .wrapping_mul(6_364_136_223_846_793_005)
                        .wrapping_add(3);
                    (state >> 33) % 1000 < blocked_share
                })
                .collect();
            let grid = DistanceGrid::new(size, |i| blocked[i]);
            for i in 0..grid.len() {
                let cell = grid.cell(i);
                assert_eq!(grid.index(cell), i);
                let to_border = (0..3)
                    .map(|a| (cell[a] + 1).min(size[a] - cell[a]).pow(2))
                    .min()
                    .unwrap_or(0);
                let to_blocked = (0..grid.len()).filter(|j| blocked[*j]).map(|j| {
                    (0..3)
                        .map(|a| cell[a].abs_diff(grid.cell(j)[a]).pow(2))
                        .sum()
                });
                let expected = to_blocked.chain([to_border]).min().unwrap_or(0) as f32;
                assert!((grid.at(i) - expected.sqrt()).abs() < 1e-4, "{cell:?}");
            }
        }
    }
}
