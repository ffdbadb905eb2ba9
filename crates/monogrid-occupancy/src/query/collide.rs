//! Collision queries: does a box or a sphere touch an occupied cell?

use super::cast::UnknownCells;
use super::cells::key_of_clamped;
use crate::evidence::Occupancy;
use crate::key::{BRICK_CELLS, BRICK_EDGE, BrickKey, VoxelKey};
use crate::map::OccupancyMap;
use crate::storage::BrickRef;

/// What collision queries ask a map or a snapshot.
pub(crate) trait States {
    fn cell_edge(&self) -> f64;
    /// Whether a brick can hold a cell that stops.
    fn may_stop(&self, brick: BrickKey, unknown: UnknownCells) -> bool;
    fn cell_state(&self, key: VoxelKey) -> Occupancy;
    /// About how many bricks [`States::stopping_bricks`] looks at.
    fn known_bricks(&self) -> usize;
    /// All bricks that can hold an occupied cell, in the order of their keys.
    fn stopping_bricks(&self) -> Vec<BrickKey>;
}

impl States for OccupancyMap {
    fn cell_edge(&self) -> f64 {
        self.resolution()
    }

    fn may_stop(&self, brick: BrickKey, unknown: UnknownCells) -> bool {
        match self.brick(brick) {
            BrickRef::Uniform(value) => unknown.stop_at(self.limits.occupancy(value)),
            BrickRef::Mixed(_) | BrickRef::Packed(_) => true,
        }
    }

    fn cell_state(&self, key: VoxelKey) -> Occupancy {
        self.state_of(key)
    }

    fn known_bricks(&self) -> usize {
        self.brick_counts().1
    }

    fn stopping_bricks(&self) -> Vec<BrickKey> {
        self.bricks()
    }
}

impl OccupancyMap {
    /// Whether a sphere touches an occupied cell (or an unknown one, if those stop).
    ///
    /// A cell touches if its cube comes closer to `center` than `radius`.
    #[must_use]
    pub fn sphere_collides(&self, center: [f64; 3], radius: f64, unknown: UnknownCells) -> bool {
        sphere(self, center, radius, unknown)
    }

    /// Whether an axis-parallel box touches an occupied cell (or an unknown one, if those stop).
    #[must_use]
    pub fn box_collides(&self, low: [f64; 3], high: [f64; 3], unknown: UnknownCells) -> bool {
        axis_box(self, low, high, unknown)
    }
}

pub(crate) fn sphere(
    map: &impl States,
    center: [f64; 3],
    radius: f64,
    unknown: UnknownCells,
) -> bool {
    if !(radius >= 0.0 && radius.is_finite() && center.iter().all(|c| c.is_finite())) {
        return unknown == UnknownCells::Stop;
    }
    let low = center.map(|c| c - radius);
    let high = center.map(|c| c + radius);
    // Distance of the centre to a cube, squared.
    let touches = |first: VoxelKey, edge_cells: i32| {
        let axes = first.to_array().into_iter().zip(center);
        let gaps_sq = axes.map(|(first, center)| {
            let near = f64::from(first) * map.cell_edge();
            let far = f64::from(first + edge_cells) * map.cell_edge();
            let gap = (near - center).max(center - far).max(0.0);
            gap * gap
        });
        gaps_sq.sum::<f64>() <= radius * radius
    };
    any_cell(map, low, high, unknown, touches)
}

pub(crate) fn axis_box(
    map: &impl States,
    low: [f64; 3],
    high: [f64; 3],
    unknown: UnknownCells,
) -> bool {
    if !low.iter().chain(&high).all(|c| c.is_finite()) {
        return unknown == UnknownCells::Stop;
    }
    any_cell(map, low, high, unknown, |_, _| true)
}

/// Whether any stopping cell of a box satisfies `touches(first cell, edge of the cube)`.
fn any_cell(
    map: &impl States,
    low: [f64; 3],
    high: [f64; 3],
    unknown: UnknownCells,
    touches: impl Fn(VoxelKey, i32) -> bool,
) -> bool {
    let inv_edge = 1.0 / map.cell_edge();
    let [first, last] = [low, high].map(|corner| key_of_clamped(corner, inv_edge));
    let (low, high) = (first.brick(), last.brick());
    let collides_in = |brick: BrickKey| {
        map.may_stop(brick, unknown)
            && touches(brick.first_cell(), BRICK_EDGE)
            && any_cell_in_brick(map, brick, (first, last), unknown, &touches)
    };
    // A box larger than the map is asked through the bricks that there are.
    let is_large = low.num_to(high) > map.known_bricks() as u128;
    if unknown == UnknownCells::PassThrough && is_large {
        let mut bricks = map.stopping_bricks().into_iter();
        return bricks.any(|brick| brick.is_within(low, high) && collides_in(brick));
    }
    low.to(high).any(collides_in)
}

fn any_cell_in_brick(
    map: &impl States,
    brick: BrickKey,
    (first, last): (VoxelKey, VoxelKey),
    unknown: UnknownCells,
    touches: &impl Fn(VoxelKey, i32) -> bool,
) -> bool {
    let (start, end) = (brick.first_cell(), brick.cell(BRICK_CELLS - 1));
    let start = VoxelKey::new(
        start.x.max(first.x),
        start.y.max(first.y),
        start.z.max(first.z),
    );
    let end = VoxelKey::new(end.x.min(last.x), end.y.min(last.y), end.z.min(last.z));
    let mut cells = start.to(end);
    cells.any(|key| unknown.stop_at(map.cell_state(key)) && touches(key, 1))
}
