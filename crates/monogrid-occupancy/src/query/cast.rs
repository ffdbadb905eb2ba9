//! Ray casts: the first occupied cell on a line of sight.

use crate::evidence::{Occupancy, UNKNOWN};
use crate::integrate::rays::ray::{MAX_CELLS, RANGE_BITS, Ray};
use crate::key::{BRICK_EDGE, BRICK_LIMIT, BrickKey, VoxelKey};
use crate::map::OccupancyMap;
use crate::storage::BrickRef;

/// Where a ray cast ended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RayHit {
    /// The first occupied cell.
    Occupied {
        /// The cell.
        key: VoxelKey,
        /// Range of its centre along the ray, in map units.
        range: f64,
    },
    /// The first unknown cell, where unknown cells stop the ray.
    Unknown {
        /// The cell.
        key: VoxelKey,
        /// Range of its centre along the ray, in map units.
        range: f64,
    },
    /// Nothing up to the longest range asked for.
    Nothing,
    /// The origin, direction or range is not finite, too far away, or has no length.
    Invalid,
}

/// What a ray cast does at unknown cells.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum UnknownCells {
    /// They are looked through.
    #[default]
    PassThrough,
    /// They stop the ray.
    Stop,
}

impl OccupancyMap {
    /// The first occupied (or unknown) cell on the ray from `origin` along `direction` (of any
    /// length), up to `max_range` map units (at most 131072 cells). The cell of the origin counts.
    #[must_use]
    pub fn cast_ray(
        &self,
        origin: [f64; 3],
        direction: [f64; 3],
        max_range: f64,
        unknown: UnknownCells,
    ) -> RayHit {
        let way = [origin, direction];
        first_hit(way, max_range, self.inv_resolution, |ray, packed| {
            self.hit_in_brick(ray, packed, unknown)
        })
    }

    fn hit_in_brick(&self, ray: &Ray, packed: u64, unknown: UnknownCells) -> RayHit {
        let way = (ray, BrickKey::unpack(packed), self.resolution());
        let state = |value| self.limits.occupancy(value);
        let stops = |value| unknown.stop_at(state(value));
        let of_uniform = |value| {
            if !stops(value) {
                return RayHit::Nothing;
            }
            first_in_brick(way, |_| true, |_| state(value))
        };
        let Some((shard, slot)) = self.slot(packed) else {
            return of_uniform(UNKNOWN);
        };
        match shard.contents(slot) {
            BrickRef::Uniform(value) => of_uniform(value),
            BrickRef::Mixed(payload) => {
                let cells = shard.payload(payload);
                first_in_brick(way, |i| stops(cells[i]), |i| state(cells[i]))
            }
            BrickRef::Packed(word) => {
                let cells = shard.packed(word);
                first_in_brick(way, |i| stops(cells.value(i)), |i| state(cells.value(i)))
            }
        }
    }
}

impl UnknownCells {
    /// Whether a cell is an obstacle, or stops a ray.
    #[inline]
    pub(crate) fn stop_at(self, state: Occupancy) -> bool {
        match state {
            Occupancy::Occupied => true,
            Occupancy::Unknown => self == Self::Stop,
            Occupancy::Free => false,
        }
    }
}

/// The stop at the first cell of a brick, by its index, that stops a ray, of the state that is
/// said.
#[inline]
pub(crate) fn first_in_brick(
    (ray, brick, resolution): (&Ray, BrickKey, f64),
    stops: impl Fn(usize) -> bool,
    state: impl Fn(usize) -> Occupancy,
) -> RayHit {
    let mut hit = RayHit::Nothing;
    ray.walk_until(ray.enter(brick), |index, range| {
        let stop = stops(index);
        if stop {
            let key = brick.cell(index);
            let range = range as f64 / (1_u64 << RANGE_BITS) as f64 * resolution;
            hit = match state(index) {
                Occupancy::Unknown => RayHit::Unknown { key, range },
                _ => RayHit::Occupied { key, range },
            };
        }
        stop
    });
    hit
}

/// What `hit_in_brick` says of the first brick, by its packed key, that stops the ray from an
/// origin along a direction.
pub(crate) fn first_hit(
    [origin, direction]: [[f64; 3]; 2],
    max_range: f64,
    inv_resolution: f64,
    mut hit_in_brick: impl FnMut(&Ray, u64) -> RayHit,
) -> RayHit {
    let norm = direction.iter().map(|c| c * c).sum::<f64>().sqrt();
    let cells = origin.map(|c| c * inv_resolution);
    let limit = f64::from(BRICK_LIMIT * BRICK_EDGE) - 2.0 * MAX_CELLS;
    let is_usable = norm.is_normal()
        && norm.is_finite()
        && max_range >= 0.0
        && cells.iter().all(|c| c.abs() < limit);
    if !is_usable {
        return RayHit::Invalid;
    }
    let direction = direction.map(|c| c / norm);
    let ray = Ray::new(cells, direction, max_range * inv_resolution);
    let mut hit = RayHit::Nothing;
    ray.any_brick(|packed| {
        hit = hit_in_brick(&ray, packed);
        hit != RayHit::Nothing
    });
    hit
}
