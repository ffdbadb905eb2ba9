//! Where the outline of a region holds its plane: inside of the convex hull of the points that lie
//! on it.

/// How far beyond the hull a plane still holds, px: outlines are measured beside a region, and not
/// everywhere.
const MARGIN_PX: f64 = 8.0;

/// A convex polygon.
#[derive(Clone, Debug, Default)]
pub(super) struct Hull {
    /// Anticlockwise (x right, y down: clockwise to look at).
    corners: Vec<[f64; 2]>,
}

impl Hull {
    /// The hull of some points (Andrew's monotone chain).
    pub fn new(mut points: Vec<[f64; 2]>) -> Self {
        points.sort_unstable_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
        points.dedup();
        if points.len() < 3 {
            return Self { corners: points };
        }
        let mut corners = chain(points.iter());
        corners.pop();
        corners.extend(chain(points.iter().rev()));
        corners.pop();
        Self { corners }
    }

    /// First and last column of a row inside of the hull and its margin; `None` for rows outside.
    pub fn columns(&self, row: f64) -> Option<(f64, f64)> {
        let mut span: Option<(f64, f64)> = None;
        let mut widen = |x: f64| {
            let (low, high) = span.unwrap_or((x, x));
            span = Some((low.min(x), high.max(x)));
        };
        let next = self.corners.iter().cycle().skip(1);
        for ([ax, ay], [bx, by]) in self.corners.iter().zip(next) {
            if (ay - row).abs() <= MARGIN_PX {
                widen(*ax);
            }
            if (ay - row) * (by - row) < 0.0 {
                widen(ax + (row - ay) / (by - ay) * (bx - ax));
            }
        }
        span.map(|(low, high)| (low - MARGIN_PX, high + MARGIN_PX))
    }
}

/// The lower half of the hull of points in the order of x, or the upper half of points in reverse
/// order.
fn chain<'a>(points: impl Iterator<Item = &'a [f64; 2]>) -> Vec<[f64; 2]> {
    let mut corners: Vec<[f64; 2]> = Vec::new();
    for point in points {
        while let [.., a, b] = corners[..]
            && (b[0] - a[0]) * (point[1] - a[1]) <= (b[1] - a[1]) * (point[0] - a[0])
        {
            corners.pop();
        }
        corners.push(*point);
    }
    corners
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_inside_have_the_columns_of_the_polygon_and_a_margin() {
        let inner = (0..50).map(|i| [20.0 + f64::from(i % 7), 30.0 + f64::from(i % 5)]);
        let corners = [[0.0, 0.0], [100.0, 0.0], [50.0, 100.0]];
        let hull = Hull::new(corners.into_iter().chain(inner).collect());
        assert_eq!(hull.corners.len(), 3);
        let (low, high) = hull.columns(50.0).unwrap();
        assert!(
            (low - (25.0 - MARGIN_PX)).abs() < 1e-9 && (high - (75.0 + MARGIN_PX)).abs() < 1e-9
        );
        assert!(
            hull.columns(-MARGIN_PX - 0.1).is_none() && hull.columns(-MARGIN_PX + 0.1).is_some()
        );
        assert!(hull.columns(100.0 + MARGIN_PX + 0.1).is_none());
        assert!(Hull::new(Vec::new()).columns(0.0).is_none());
        assert!(Hull::new(vec![[3.0, 4.0]]).columns(4.0).is_some());
    }
}
