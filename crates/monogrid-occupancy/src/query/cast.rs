//! Ray casts: the first occupied cell on a line of sight.

use crate::evidence::{Occupancy, UNKNOWN};
use crate::integrate::ray::{MAX_CELLS, RANGE_BITS, Ray};
use crate::key::{BRICK_EDGE, BRICK_LIMIT, BrickKey, VoxelKey};
use crate::map::OccupancyMap;
use crate::storage::{BrickRef, hash, shard_of};

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
        let Some(ray) = ray_for_query(origin, direction, max_range, self.inv_resolution) else {
            return RayHit::Invalid;
        };
        let mut hit = RayHit::Nothing;
        ray.any_brick(|packed| {
            hit = self.hit_in_brick(&ray, packed, unknown);
            hit != RayHit::Nothing
        });
        hit
    }

    fn hit_in_brick(&self, ray: &Ray, packed: u64, unknown: UnknownCells) -> RayHit {
        let hash = hash(packed);
        let shard = &self.shards[shard_of(hash)];
        let contents = shard
            .find(packed, hash)
            .map_or(BrickRef::Uniform(UNKNOWN), |slot| shard.contents(slot));
        let stops = |value: i16| match self.limits.occupancy(value) {
            Occupancy::Occupied => true,
            Occupancy::Unknown => unknown == UnknownCells::Stop,
            Occupancy::Free => false,
        };
        let brick = BrickKey::unpack(packed);
        let found = match contents {
            BrickRef::Uniform(value) => stops(value).then(|| {
                let entry = ray.enter(brick);
                (entry.index, entry.range, value)
            }),
            BrickRef::Mixed(payload) => {
                let cells = shard.payload(payload);
                first_in_brick(ray, brick, |index| cells[index], stops)
            }
            BrickRef::Packed(word) => {
                let cells = shard.packed(word);
                first_in_brick(ray, brick, |index| cells.value(index), stops)
            }
        };
        let Some((index, range, value)) = found else {
            return RayHit::Nothing;
        };
        let state = self.limits.occupancy(value);
        hit_at(brick, index, range, state, self.resolution())
    }
}

/// The first cell of a brick along a ray that stops it: its index, range and evidence.
#[inline]
fn first_in_brick(
    ray: &Ray,
    brick: BrickKey,
    value_of: impl Fn(usize) -> i16,
    stops: impl Fn(i16) -> bool,
) -> Option<(usize, i64, i16)> {
    let mut found = None;
    ray.walk_until(ray.enter(brick), |index, range| {
        let value = value_of(index);
        let stop = stops(value);
        if stop {
            found = Some((index, range, value));
        }
        stop
    });
    found
}

/// The ray of a query, if it is usable.
pub(crate) fn ray_for_query(
    origin: [f64; 3],
    direction: [f64; 3],
    max_range: f64,
    inv_resolution: f64,
) -> Option<Ray> {
    let norm = direction.iter().map(|c| c * c).sum::<f64>().sqrt();
    let cells = origin.map(|c| c * inv_resolution);
    let limit = f64::from(BRICK_LIMIT * BRICK_EDGE) - 2.0 * MAX_CELLS;
    let is_usable = norm.is_normal()
        && norm.is_finite()
        && max_range >= 0.0
        && cells.iter().all(|c| c.abs() < limit);
    is_usable.then(|| {
        let direction = direction.map(|c| c / norm);
        Ray::new(cells, direction, max_range * inv_resolution)
    })
}

/// A stop at a cell of a brick, `range` in fixed point.
pub(crate) fn hit_at(
    brick: BrickKey,
    index: usize,
    range: i64,
    state: Occupancy,
    resolution: f64,
) -> RayHit {
    let key = brick.cell(index);
    let range = range as f64 / (1_u64 << RANGE_BITS) as f64 * resolution;
    if state == Occupancy::Unknown {
        RayHit::Unknown { key, range }
    } else {
        RayHit::Occupied { key, range }
    }
}
