//! Where a plane was measured, and how far other places are from there.

use monogrid_image::Image;

/// Cells along the longer side of what was measured.
const CELLS: f64 = 40.0;
/// Room around it, as a share of that side.
const MARGIN: f64 = 0.5;
/// Fewest points in the 3x3 cells around one that count as measured.
const MIN_POINTS: u16 = 2;

/// Distances from where a plane was measured, in a grid.
#[derive(Clone, Debug, Default)]
pub(super) struct Extent {
    first: [f64; 2],
    cell: f64,
    distances: Image<f32>,
}

impl Extent {
    /// Of points in a plane.
    pub fn of(points: &[[f64; 2]]) -> Self {
        let bound = |start: f64, pick: fn(f64, f64) -> f64| {
            [0, 1].map(|k| points.iter().map(|p| p[k]).fold(start, pick))
        };
        let (low, high) = (
            bound(f64::INFINITY, f64::min),
            bound(f64::NEG_INFINITY, f64::max),
        );
        let side = f64::max(high[0] - low[0], high[1] - low[1]);
        if !(side > 0.0 && side.is_finite()) {
            return Self::default();
        }
        let cell = side / CELLS;
        let margin = MARGIN * side;
        let cells = |k: usize| ((high[k] - low[k] + 2.0 * margin) / cell).ceil() as usize + 1;
        let mut this = Self {
            first: low.map(|low| low - margin),
            cell,
            distances: Image::filled(cells(0), cells(1), f32::INFINITY),
        };
        this.start(points);
        this.spread();
        this
    }

    /// Distance of a place from the nearest cell that was measured; infinite far beyond.
    pub fn distance(&self, place: [f64; 2]) -> f64 {
        let found = self.cell_at(place).map(|(x, y)| self.distances.at(x, y));
        f64::from(found.unwrap_or(f32::INFINITY))
    }

    fn cell_at(&self, place: [f64; 2]) -> Option<(usize, usize)> {
        let [x, y] = [0, 1].map(|k| (place[k] - self.first[k]) / self.cell);
        let size = [self.distances.width(), self.distances.height()].map(|cells| cells as f64);
        let is_inside = x >= 0.0 && y >= 0.0 && x < size[0] && y < size[1];
        is_inside.then_some((x as usize, y as usize))
    }

    /// 0 in the cells that were measured.
    fn start(&mut self, points: &[[f64; 2]]) {
        let mut counts = self.distances.map(|_| 0_u16);
        for (x, y) in points.iter().filter_map(|point| self.cell_at(*point)) {
            counts.set(x, y, counts.at(x, y).saturating_add(1));
        }
        for y in 0..counts.height() {
            for x in (0..counts.width()).filter(|x| counts.at(*x, y) > 0) {
                let columns = x.saturating_sub(1)..(x + 2).min(counts.width());
                let rows = y.saturating_sub(1)..(y + 2).min(counts.height());
                let around = rows.flat_map(|y| &counts.row(y)[columns.clone()]);
                if around.fold(0_u16, |sum, n| sum.saturating_add(*n)) >= MIN_POINTS {
                    self.distances.set(x, y, 0.0);
                }
            }
        }
    }

    /// Distances by steps to the eight neighbours (`[ROSENFELD68]`): once from the first cell to
    /// the last, once back.
    fn spread(&mut self) {
        let size = (self.distances.width(), self.distances.height());
        let (columns, rows) = (size.0 as isize, size.1 as isize);
        let distances = self.distances.as_mut_slice();
        let steps = [(-1, 0), (-1, -1), (0, -1), (1, -1)];
        let length =
            |(dx, dy): (isize, isize)| (self.cell * ((dx * dx + dy * dy) as f64).sqrt()) as f32;
        let lengths = steps.map(length);
        for (sign, order) in [(1, false), (-1, true)] {
            for at in 0..columns * rows {
                let at = if order { columns * rows - 1 - at } else { at };
                let (x, y) = (at % columns, at / columns);
                for ((dx, dy), length) in steps.iter().zip(lengths) {
                    let (x, y) = (x + sign * dx, y + sign * dy);
                    if (0..columns).contains(&x) && (0..rows).contains(&y) {
                        let beside = distances[(y * columns + x) as usize] + length;
                        let own = &mut distances[at as usize];
                        *own = own.min(beside);
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_are_those_of_the_nearest_measured_place() {
        // a square of four by four, and one point by itself
        let square =
            (0..81).flat_map(|x| (0..81).map(move |y| [x, y].map(|k| 0.05 * f64::from(k))));
        let mut points: Vec<[f64; 2]> = square.collect();
        points.push([5.5, 2.0]);
        let extent = Extent::of(&points);
        let near = |place, expected: f64| {
            let found = extent.distance(place);
            assert!(
                (found - expected).abs() < 0.2 + 0.08 * expected,
                "{place:?}: {found}"
            );
        };
        near([2.0, 2.0], 0.0);
        near([5.0, 2.0], 1.0);
        near([5.0, 5.0], std::f64::consts::SQRT_2);
        near([2.0, -2.0], 2.0);
        assert!(extent.distance([100.0, 0.0]).is_infinite());
        assert!(Extent::of(&[[1.0, 1.0]]).distance([1.0, 1.0]).is_infinite());
        assert!(Extent::of(&[]).distance([0.0, 0.0]).is_infinite());
    }
}
