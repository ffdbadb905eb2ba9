//! Collision queries: does a box or a sphere touch an occupied cell?

use super::cast::UnknownCells;
use super::cells::key_of_clamped;
use crate::evidence::Occupancy;
use crate::key::{BRICK_EDGE, BrickKey, VoxelKey};
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
            BrickRef::Uniform(value) => stops(self.limits.occupancy(value), unknown),
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

fn stops(state: Occupancy, unknown: UnknownCells) -> bool {
    match state {
        Occupancy::Occupied => true,
        Occupancy::Unknown => unknown == UnknownCells::Stop,
        Occupancy::Free => false,
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
        let first = first.to_array();
        let distance_sq: f64 = (0..3)
            .map(|axis| {
                let near = f64::from(first[axis]) * map.cell_edge();
                let far = f64::from(first[axis] + edge_cells) * map.cell_edge();
                let gap = (near - center[axis]).max(center[axis] - far).max(0.0);
                gap * gap
            })
            .sum();
        distance_sq <= radius * radius
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
    let span = |a: i32, b: i32| (i64::from(b) - i64::from(a) + 1).max(0) as u128;
    let volume = span(low.x, high.x) * span(low.y, high.y) * span(low.z, high.z);
    let collides_in = |brick: BrickKey| {
        map.may_stop(brick, unknown)
            && touches(brick.first_cell(), BRICK_EDGE)
            && any_cell_in_brick(map, brick, (first, last), unknown, &touches)
    };
    // A box larger than the map is asked through the bricks that there are.
    if unknown == UnknownCells::PassThrough && volume > map.known_bricks() as u128 {
        return map.stopping_bricks().into_iter().any(|b| {
            (low.x..=high.x).contains(&b.x)
                && (low.y..=high.y).contains(&b.y)
                && (low.z..=high.z).contains(&b.z)
                && collides_in(b)
        });
    }
    (low.x..=high.x).any(|x| {
        (low.y..=high.y).any(|y| (low.z..=high.z).any(|z| collides_in(BrickKey::new(x, y, z))))
    })
}

fn any_cell_in_brick(
    map: &impl States,
    brick: BrickKey,
    (first, last): (VoxelKey, VoxelKey),
    unknown: UnknownCells,
    touches: &impl Fn(VoxelKey, i32) -> bool,
) -> bool {
    let (start, end) = (brick.first_cell(), brick.cell(crate::key::BRICK_CELLS - 1));
    (start.z.max(first.z)..=end.z.min(last.z)).any(|z| {
        (start.y.max(first.y)..=end.y.min(last.y)).any(|y| {
            (start.x.max(first.x)..=end.x.min(last.x)).any(|x| {
                let key = VoxelKey::new(x, y, z);
                stops(map.cell_state(key), unknown) && touches(key, 1)
            })
        })
    })
}
