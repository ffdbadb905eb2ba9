//! Space that is free because something has moved through it.

use crate::error::MapError;
use crate::map::OccupancyMap;
use crate::scan::dot;

impl OccupancyMap {
    /// Makes the cells whose centres lie within `radius` of a path, and those that the path's
    /// points lie in, as free as cells can be, whatever was measured: where a body was there is no
    /// obstacle. The points are joined by straight lines.
    ///
    /// # Errors
    /// The memory budget is exhausted.
    pub fn free_along(&mut self, path: &[[f64; 3]], radius: f64) -> Result<(), MapError> {
        let free = Some(self.config().clamp_min);
        for (index, end) in path.iter().enumerate() {
            let start = path[index.saturating_sub(1)];
            if !start.iter().chain(end).all(|c| c.is_finite()) {
                continue;
            }
            let low = self.clamped_key(std::array::from_fn(|i| start[i].min(end[i]) - radius));
            let high = self.clamped_key(std::array::from_fn(|i| start[i].max(end[i]) + radius));
            for key in low.to(high) {
                let centre = key.center(self.resolution());
                if distance_to_line(&centre, &start, end) <= radius {
                    self.set_log_odds(key, free)?;
                }
            }
            if let Some(key) = self.key(*end) {
                self.set_log_odds(key, free)?;
            }
        }
        Ok(())
    }
}

/// Distance from a point to the straight line between two others.
fn distance_to_line(point: &[f64; 3], start: &[f64; 3], end: &[f64; 3]) -> f64 {
    let along: [f64; 3] = std::array::from_fn(|i| end[i] - start[i]);
    let from_start: [f64; 3] = std::array::from_fn(|i| point[i] - start[i]);
    let length_sq = dot(along, along);
    let share = if length_sq > 0.0 {
        (dot(along, from_start) / length_sq).clamp(0.0, 1.0)
    } else {
        0.0
    };
    let offset: [f64; 3] = std::array::from_fn(|i| from_start[i] - share * along[i]);
    dot(offset, offset).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::Occupancy;
    use crate::map::MapConfig;

    #[test]
    fn the_way_of_a_body_is_free_and_nothing_else() {
        let mut map = OccupancyMap::new(MapConfig::with_resolution(0.1)).unwrap();
        let wall = |k: i32| [0.55, 0.05, 0.1 * f64::from(k) + 0.05];
        for k in -10..10 {
            let key = map.key(wall(k)).unwrap();
            map.set_log_odds(key, Some(3.0)).unwrap();
        }
        map.free_along(&[[0.05, 0.05, 0.05], [1.05, 0.05, 0.05]], 0.12)
            .unwrap();
        for k in -10..10 {
            let expected = if (-1..=1).contains(&k) {
                Occupancy::Free
            } else {
                Occupancy::Occupied
            };
            assert_eq!(map.state(wall(k)), expected, "{k}");
        }
        for x in 0..=10 {
            let on_the_way = [0.1 * f64::from(x) + 0.05, 0.05, 0.05];
            assert_eq!(map.log_odds(on_the_way), Some(-2.0));
        }
        // beyond the ends, and beside the way
        assert_eq!(map.state([1.25, 0.05, 0.05]), Occupancy::Unknown);
        assert_eq!(map.state([0.25, 0.35, 0.05]), Occupancy::Unknown);
        // a ball that is smaller than a cell: the cell alone; places that are none change nothing
        let cells = map.cells().count();
        map.free_along(&[[5.01, 5.01, 5.01], [f64::NAN, 0.0, 0.0]], 0.0)
            .unwrap();
        assert_eq!(map.cells().count(), cells + 1);
        assert_eq!(map.state([5.05, 5.05, 5.05]), Occupancy::Free);
    }
}
