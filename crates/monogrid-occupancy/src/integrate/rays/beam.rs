//! Measurements as rays with their evidence, and where they begin.

use crate::error::MapError;
use crate::integrate::IntegrationConfig;
use crate::integrate::parallel::for_each;
use crate::integrate::rays::ray::{MAX_CELLS, RANGE_BITS, Ray, TIME_BITS, fixed};
use crate::integrate::rays::saturated::{BeamTiles, Saturated};
use crate::key::BRICK_LIMIT;
use crate::map::OccupancyMap;
use crate::scan::{PointScan, Scan, ScanData};
use crate::sensor::table::{EvidenceTable, TableSet};

/// The measurements of a scan in cell units, as small as they can be: beams are made of them when
/// they are walked.
pub(crate) struct Beams {
    /// Place of the sensor.
    pub origin: [f64; 3],
    /// In the order in which they are integrated, see [`order_of_points`].
    pub measured: Vec<Measured>,
    /// So many of them come first.
    pub first_share: usize,
    pub extent: Extent,
    pub tables: TableSet,
    resolution: f64,
}

/// Where the measurements of a scan lie, taken while they are made.
pub(crate) struct Extent {
    /// Least and greatest slopes.
    pub slopes: [[f32; 2]; 2],
    /// Whether all look along the sensor's z axis rather than against it.
    pub looks_forward: bool,
    /// A bit for each octant into which beams go.
    pub octants: u8,
    /// Sums over the beams: lengths, and ranges of free space.
    pub length: f64,
    pub free: f64,
}

/// One measurement; ranges in cells.
pub(crate) struct Measured {
    direction: [f64; 3],
    /// Where the first entry of the table begins.
    table_start: f64,
    /// Where the ray ends.
    pub length: f64,
    /// Up to here the beam sees nothing but free space.
    pub free: f64,
    /// Slopes of the direction in the sensor frame, along x and y over z.
    pub slopes: [f32; 2],
    table: u16,
}

/// A measurement as a ray with its evidence.
pub(crate) struct Beam {
    pub ray: Ray,
    /// Time up to which no cell can change any more.
    pub saturated_until: i64,
    pub table: u16,
    /// Range in fixed point at which the first entry of the table begins.
    table_start: i64,
    /// Entries in 2^64 units of fixed-point range.
    entries_per_range: u64,
    /// Bricks that the ray leaves before this time lie wholly in free space.
    pub free_until: i64,
}

/// A centre is projected at most half a diagonal beyond the end of its cell's piece.
const HALF_DIAGONAL: f64 = 0.87;

impl Beams {
    /// Takes the usable measurements of a scan.
    pub(crate) fn new(
        map: &OccupancyMap,
        scan: &Scan,
        config: &IntegrationConfig,
    ) -> Result<Self, MapError> {
        let resolution = map.resolution();
        let mut tables = map.known_tables.set(config, resolution)?;
        let pose = &scan.world_from_sensor;
        let mut extent = Extent::EMPTY;
        let order = order_of_points(scan);
        let first_share = scan.len().div_ceil(SHARES);
        let mut measured = Vec::with_capacity(scan.len());
        let per_metre = 1.0 / resolution;
        let mut num_first = 0;
        for place in 0..scan.len() {
            let index = order.as_ref().map_or(place, |order| order[place] as usize);
            let Some(found) = scan.measurement(index, config.sigma_mode) else {
                continue;
            };
            num_first += usize::from(place < first_share);
            let range = found.range * pose.scale;
            let sigma = total_sigma(found.sigma * pose.scale, range, scan, resolution);
            let table = tables.prepare(range as f32, sigma as f32);
            let evidence = tables.table(table);
            let table_start = (range + evidence.start) * per_metre;
            let length = (range + evidence.end()).min(config.max_range) * per_metre;
            let ([x, y, z], per_range) = (found.point, 1.0 / found.range);
            let per_depth = 1.0 / z;
            let beam = Measured {
                direction: pose.rotate(found.point.map(|c| c * per_range)),
                table_start,
                length,
                // Certain free space is what takes cells down.
                free: if evidence.free < 0 {
                    (table_start - HALF_DIAGONAL).clamp(0.0, MAX_CELLS)
                } else {
                    0.0
                },
                slopes: [x, y].map(|c| (c * per_depth) as f32),
                table,
            };
            extent.add(&beam, z > 0.0);
            measured.push(beam);
        }
        Ok(Self {
            origin: origin_in_cells(map, scan)?,
            measured,
            first_share: num_first,
            extent,
            tables,
            resolution,
        })
    }

    /// The beam of a measurement, from the sensor on.
    #[inline]
    pub(crate) fn beam(&self, measured: &Measured) -> Beam {
        let table = self.tables.table(measured.table);
        let per_range = self.resolution * 2_f64.powi(64 - RANGE_BITS as i32);
        Beam {
            ray: Ray::new(self.origin, measured.direction, measured.length),
            saturated_until: 0,
            table: measured.table,
            table_start: fixed(measured.table_start, RANGE_BITS),
            entries_per_range: (table.inv_step * per_range) as u64,
            free_until: fixed(measured.free, TIME_BITS),
        }
    }
}

/// Shares of a scan. After the first, saturated space is looked for again: it has saturated most of
/// it.
const SHARES: usize = 8;
/// Tiles of directions along an edge of the square onto which they are mapped.
const DIRECTION_TILES: usize = 64;

/// The points of a cloud in the order of their integration; `None` for pixels, which are taken as
/// they come.
///
/// Points have no order of their own: every eighth is of one share, which so has points of all
/// directions, and in a share neighbours follow one another, row by row of tiles, so that a beam
/// finds in the cache what the last ones changed. With all of them in one share, many misses in a
/// row would undo the hits of coarse cells.
fn order_of_points(scan: &Scan) -> Option<Vec<u32>> {
    let ScanData::Points(PointScan { points, .. }) = scan.data else {
        return None;
    };
    let tiles: Vec<_> = points.iter().map(|p| direction_tile(*p) as u16).collect();
    let bucket = |(index, tile): (usize, &u16)| {
        (index % SHARES) * DIRECTION_TILES * DIRECTION_TILES + usize::from(*tile)
    };
    let mut places = vec![0_u32; SHARES * DIRECTION_TILES * DIRECTION_TILES];
    for tile in tiles.iter().enumerate() {
        places[bucket(tile)] += 1;
    }
    let mut next = 0;
    for count in &mut places {
        next += std::mem::replace(count, next);
    }
    let mut order = vec![0; points.len()];
    for tile in tiles.iter().enumerate() {
        let place = &mut places[bucket(tile)];
        order[*place as usize] = tile.0 as u32;
        *place += 1;
    }
    Some(order)
}

/// The tile of a direction: the octahedron around the sensor, unfolded to a square. Any tile, if it
/// is none.
#[inline]
fn direction_tile([x, y, z]: [f32; 3]) -> usize {
    let scale = 1.0 / (x.abs() + y.abs() + z.abs());
    let (u, v) = (x * scale, y * scale);
    let (u, v) = if z < 0.0 {
        ((1.0 - v.abs()).copysign(u), (1.0 - u.abs()).copysign(v))
    } else {
        (u, v)
    };
    let tile = |c: f32| ((c + 1.0) * (0.5 * DIRECTION_TILES as f32)) as usize;
    tile(v).min(DIRECTION_TILES - 1) * DIRECTION_TILES + tile(u).min(DIRECTION_TILES - 1)
}

impl Extent {
    const EMPTY: Self = Self {
        slopes: [[f32::MAX; 2], [f32::MIN; 2]],
        looks_forward: true,
        octants: 0,
        length: 0.0,
        free: 0.0,
    };

    #[inline]
    fn add(&mut self, measured: &Measured, looks_forward: bool) {
        let [low, high] = &mut self.slopes;
        for axis in 0..2 {
            low[axis] = low[axis].min(measured.slopes[axis]);
            high[axis] = high[axis].max(measured.slopes[axis]);
        }
        self.looks_forward &= looks_forward;
        let falls = measured.direction.map(|c| u8::from(c < 0.0));
        self.octants |= 1 << (falls[0] | falls[1] << 1 | falls[2] << 2);
        self.length += measured.length;
        self.free += measured.free_cells();
    }
}

impl Measured {
    /// Range up to which its beam exists and sees nothing but free space.
    pub(crate) fn free_cells(&self) -> f64 {
        self.free.min(self.length)
    }

    /// Its beam takes down every cell whose centre is nearer than this range.
    pub(crate) fn raises_from(&self) -> f64 {
        if self.free > 0.0 {
            self.table_start
        } else {
            0.0
        }
    }
}

impl Beam {
    /// Evidence for a cell whose centre has this range; 0 behind the obstacle.
    #[inline]
    pub(crate) fn evidence_at(&self, range: i64, table: &EvidenceTable) -> i16 {
        let behind_start = range - self.table_start;
        if behind_start < 0 {
            return table.free;
        }
        let at = (u128::from(behind_start as u64) * u128::from(self.entries_per_range)) >> 64;
        table.entries.get(at as usize).copied().unwrap_or(0)
    }
}

/// Where beams can begin, as found when a part of the scan was in the map.
pub(crate) struct Beginnings<'a> {
    pub tiles: &'a BeamTiles,
    pub saturated: Saturated,
}

impl<'a> Beginnings<'a> {
    /// Looks at a map into which measurements are still to be integrated.
    pub(crate) fn find(map: &OccupancyMap, tiles: &'a BeamTiles, threads: usize) -> Self {
        let mut parts = Saturated::parts(map, tiles, threads);
        for_each(&mut parts, threads, |_, part| part.run());
        Self {
            tiles,
            saturated: Saturated::join(&parts),
        }
    }

    /// Lets a beam begin where the first cell lies that it could change.
    #[inline]
    pub(crate) fn settle(&self, beam: &mut Beam, measured: &Measured) {
        let cells = self.saturated.until(self.tiles.tile_of(measured.slopes));
        let until = fixed(cells.min(MAX_CELLS), TIME_BITS).min(beam.free_until);
        beam.saturated_until = until.min(beam.ray.end);
    }
}

/// The sensor's place in cells; rays from it stay within the map's range of addresses.
pub(crate) fn origin_in_cells(map: &OccupancyMap, scan: &Scan) -> Result<[f64; 3], MapError> {
    let limit = f64::from(BRICK_LIMIT) * 8.0 - 2.0 * MAX_CELLS;
    let origin = scan
        .world_from_sensor
        .translation
        .map(|c| c * map.inv_resolution);
    if origin.iter().any(|c| c.abs() > limit) {
        return Err(MapError::Scan {
            id: scan.id,
            reason: format!("its origin lies more than {limit} cells from the map's origin"),
        });
    }
    Ok(origin)
}

/// Range and pose uncertainty together; at least a hundredth of a cell, to which the tables of
/// an all too certain sensor are limited.
pub(crate) fn total_sigma(sigma: f64, range: f64, scan: &Scan, resolution: f64) -> f64 {
    let pose = scan.pose_sigma;
    let rotation = range * pose.rotation_rad;
    let of_pose_sq = pose.translation * pose.translation + rotation * rotation;
    let total = if of_pose_sq > 0.0 {
        (sigma * sigma + of_pose_sq).sqrt()
    } else {
        sigma
    };
    total.max(0.01 * resolution)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::Similarity;
    use crate::test_random::Random;

    #[test]
    fn points_are_taken_in_eight_shares_of_all_directions_each_by_direction() {
        let mut random = Random(7);
        let mut unit = move || 2.0 * random.unit() - 1.0;
        let mut points: Vec<[f32; 3]> = (0..20_003).map(|_| [unit(), unit(), unit()]).collect();
        points[77] = [0.0; 3];
        points[78] = [f32::NAN, 1.0, f32::INFINITY];
        let scan = Scan::of_points(0, Similarity::IDENTITY, &points, &[0.01]);
        let order = order_of_points(&scan).unwrap();
        let num_first = points.len().div_ceil(SHARES);
        let mut all = order.clone();
        all.sort_unstable();
        assert!(all.into_iter().eq(0..points.len() as u32));
        assert_eq!(num_first, 2501);
        let share_of = |index: &u32| index % 8;
        let place = |index: &u32| {
            (
                share_of(index),
                direction_tile(points[*index as usize]),
                *index,
            )
        };
        assert!(order.is_sorted_by_key(place));
        assert_eq!(share_of(&order[num_first - 1]), 0);
        assert_eq!(share_of(&order[num_first]), 1);
        // Neighbours in the order are neighbours on the sphere.
        let cos_between = |a: u32, b: u32| {
            let [a, b] = [a, b].map(|index| points[index as usize]);
            let dot = |p: [f32; 3], q: [f32; 3]| p[0] * q[0] + p[1] * q[1] + p[2] * q[2];
            dot(a, b) / (dot(a, a) * dot(b, b)).sqrt()
        };
        let is_near = |pair: &&[u32]| cos_between(pair[0], pair[1]) > 0.95;
        let near = order.windows(2).filter(is_near).count();
        assert!(near > order.len() * 9 / 10, "{near} of {}", order.len());
    }
}
