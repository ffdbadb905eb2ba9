//! Collision queries: does a box or a sphere touch an occupied cell?

use crate::evidence::Occupancy;
use crate::map::OccupancyMap;
use crate::query::cast::UnknownCells;
use crate::storage::BrickRef;

impl OccupancyMap {
    /// Whether a sphere touches an occupied cell (or an unknown one, if those stop).
    ///
    /// A cell touches if its cube comes closer to `center` than `radius`.
    #[must_use]
    pub fn sphere_collides(&self, center: [f64; 3], radius: f64, unknown: UnknownCells) -> bool {
        if !(radius >= 0.0 && center.iter().all(|c| c.is_finite())) {
            return unknown == UnknownCells::Stop;
        }
        let low = center.map(|c| c - radius);
        let high = center.map(|c| c + radius);
        let resolution = self.resolution();
        self.any_cell(low, high, unknown, |cell_low| {
            let distance_sq: f64 = (0..3)
                .map(|axis| {
                    let cell_high = cell_low[axis] + resolution;
                    let gap = (cell_low[axis] - center[axis])
                        .max(center[axis] - cell_high)
                        .max(0.0);
                    gap * gap
                })
                .sum();
            distance_sq <= radius * radius
        })
    }

    /// Whether an axis-parallel box touches an occupied cell (or an unknown one, if those stop).
    #[must_use]
    pub fn box_collides(&self, low: [f64; 3], high: [f64; 3], unknown: UnknownCells) -> bool {
        if !low.iter().chain(&high).all(|c| c.is_finite()) {
            return unknown == UnknownCells::Stop;
        }
        self.any_cell(low, high, unknown, |_| true)
    }

    /// Whether any stopping cell of a box satisfies `touches(low corner of the cell)`.
    fn any_cell(
        &self,
        low: [f64; 3],
        high: [f64; 3],
        unknown: UnknownCells,
        touches: impl Fn([f64; 3]) -> bool,
    ) -> bool {
        let stops = |state: Occupancy| match state {
            Occupancy::Occupied => true,
            Occupancy::Unknown => unknown == UnknownCells::Stop,
            Occupancy::Free => false,
        };
        let (first, last) = (self.clamped_key(low), self.clamped_key(high));
        let corner = |x: i32, y: i32, z: i32| [x, y, z].map(|c| f64::from(c) * self.resolution());
        let (low_brick, high_brick) = (first.brick(), last.brick());
        for bx in low_brick.x..=high_brick.x {
            for by in low_brick.y..=high_brick.y {
                for bz in low_brick.z..=high_brick.z {
                    let brick = crate::key::BrickKey::new(bx, by, bz);
                    let contents = self.brick(brick);
                    if let BrickRef::Uniform(value) = contents
                        && !stops(self.limits.occupancy(value))
                    {
                        continue;
                    }
                    let start = brick.first_cell();
                    for x in start.x.max(first.x)..=(start.x + 7).min(last.x) {
                        for y in start.y.max(first.y)..=(start.y + 7).min(last.y) {
                            for z in start.z.max(first.z)..=(start.z + 7).min(last.z) {
                                let key = crate::key::VoxelKey::new(x, y, z);
                                if stops(self.state_of(key)) && touches(corner(x, y, z)) {
                                    return true;
                                }
                            }
                        }
                    }
                }
            }
        }
        false
    }
}
