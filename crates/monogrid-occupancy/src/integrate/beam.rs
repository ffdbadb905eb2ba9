//! Measurements as rays with their evidence, and where they begin.

use super::IntegrationConfig;
use super::parallel::for_each;
use super::ray::{MAX_CELLS, RANGE_BITS, Ray, TIME_BITS, fixed};
use super::settled::{BeamTiles, Settled};
use crate::error::MapError;
use crate::key::BRICK_LIMIT;
use crate::map::OccupancyMap;
use crate::scan::Scan;
use crate::sensor::table::{EvidenceTable, TableSet};

/// The measurements of a scan in cell units, as small as they can be: beams are made of them when
/// they are walked.
pub(crate) struct Beams {
    /// Place of the sensor.
    pub origin: [f64; 3],
    pub measured: Vec<Measured>,
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
    pub settled_until: i64,
    pub table: u16,
    /// Range in fixed point at which the first entry of the table begins.
    table_start: i64,
    /// Entries per unit of fixed-point range.
    entries_per_range: f64,
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
        let mut measured = Vec::with_capacity(scan.len());
        measured.extend((0..scan.len()).filter_map(|index| {
            let found = scan.measurement(index, config.sigma_mode)?;
            let range = found.range * pose.scale;
            let sigma = total_sigma(found.sigma * pose.scale, range, scan, resolution);
            let table = tables.prepare(range as f32, sigma as f32);
            let evidence = tables.table(table);
            let table_start = (range + evidence.start) / resolution;
            let length = (range + evidence.end()).min(config.max_range) / resolution;
            let measured = Measured {
                direction: pose.rotate(found.point.map(|c| c / found.range)),
                table_start,
                length,
                // Certain free space is what takes cells down.
                free: if evidence.free < 0 {
                    (table_start - HALF_DIAGONAL).clamp(0.0, MAX_CELLS)
                } else {
                    0.0
                },
                slopes: [0, 1].map(|i| (found.point[i] / found.point[2]) as f32),
                table,
            };
            extent.add(&measured, found.point[2] > 0.0);
            Some(measured)
        }));
        Ok(Self {
            origin: origin_in_cells(map, scan)?,
            measured,
            extent,
            tables,
            resolution,
        })
    }

    /// The beam of a measurement, from the sensor on.
    #[inline]
    pub(crate) fn beam(&self, measured: &Measured) -> Beam {
        let table = self.tables.table(measured.table);
        let per_range = self.resolution / (1_u64 << RANGE_BITS) as f64;
        Beam {
            ray: Ray::new(self.origin, measured.direction, measured.length),
            settled_until: 0,
            table: measured.table,
            table_start: fixed(measured.table_start, RANGE_BITS),
            entries_per_range: table.inv_step * per_range,
            free_until: fixed(measured.free, TIME_BITS),
        }
    }
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
        let at = (behind_start as f64 * self.entries_per_range) as usize;
        table.entries.get(at).copied().unwrap_or(0)
    }
}

/// Where beams can begin, as found when a part of the scan was in the map.
pub(crate) struct Beginnings<'a> {
    pub tiles: &'a BeamTiles,
    pub settled: Settled,
}

impl<'a> Beginnings<'a> {
    /// Looks at a map into which measurements are still to be integrated.
    pub(crate) fn find(map: &OccupancyMap, tiles: &'a BeamTiles, threads: usize) -> Self {
        let mut parts = Settled::parts(map, tiles, threads);
        for_each(&mut parts, threads, |_, part| part.run());
        Self {
            tiles,
            settled: Settled::join(&parts),
        }
    }

    /// Lets a beam begin where the first cell lies that it could change.
    #[inline]
    pub(crate) fn settle(&self, beam: &mut Beam, measured: &Measured) {
        let cells = self.settled.until(self.tiles.tile_of(measured.slopes));
        let until = fixed(cells.min(MAX_CELLS), TIME_BITS).min(beam.free_until);
        beam.settled_until = until.min(beam.ray.end);
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
    (sigma * sigma + pose.translation * pose.translation + rotation * rotation)
        .sqrt()
        .max(0.01 * resolution)
}
