//! What a scan will cost, estimated from some of its measurements before anything is made for it.

use crate::error::MapError;
use crate::integrate::image::range_image::NARROWEST_SLOPES;
use crate::integrate::rays::beam::total_sigma;
use crate::integrate::{IntegrationConfig, IntegrationRule};
use crate::key::{BRICK_CELLS, BRICK_EDGE};
use crate::map::OccupancyMap;
use crate::scan::Scan;
use crate::sensor::table::KnownTables;

/// Measurements that are looked at: enough for a mean, few enough to cost nothing.
const SAMPLES: usize = 512;
/// Bytes per brick while a scan is prepared: its task in a list that grows, and again by shard.
const PREPARED_BYTES: f64 = 64.0;
/// Bytes per brick in a directory, at least.
const DIRECTORY_BYTES: f64 = 16.0;

/// Bricks that a ray meets per edge of a brick, at most.
const BRICKS_PER_EDGE: f64 = 1.733;

/// Bricks that a scan is about to change.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Cost {
    /// In front of the obstacles.
    free: f64,
    /// In the bands around them, where every cell gets its own value.
    band: f64,
}

impl Cost {
    /// The cost of a valid scan: the volume of the cones that its measurements stand for.
    pub(super) fn of(
        scan: &Scan,
        config: &IntegrationConfig,
        resolution: f64,
        known_tables: &KnownTables,
    ) -> Result<Self, MapError> {
        let mut tables = known_tables.set(config, resolution)?;
        let scale = scan.world_from_sensor.scale;
        let step = scan.len().div_ceil(SAMPLES).max(1);
        let sampled = (0..scan.len()).step_by(step);
        let samples: Vec<_> = sampled
            .filter_map(|index| scan.measurement(index, config.sigma_mode))
            .collect();
        let focal = scan.focal();
        let solid_angle = match focal {
            Some(_) => 0.0,
            None => angle_seen(samples.iter().map(|m| m.point)) / samples.len().max(1) as f64,
        };
        let mut cost = Self::default();
        for found in &samples {
            let range = found.range * scale;
            let sigma = total_sigma(found.sigma * scale, range, scan, resolution);
            let index = tables.prepare(range as f32, sigma as f32);
            let table = tables.table(index);
            let solid_angle = focal.map_or(solid_angle, |[fx, fy]| {
                step as f64 * (found.point[2] / found.range).powi(3) / (fx * fy).abs()
            });
            let edge = resolution * f64::from(BRICK_EDGE);
            let bricks_to = |range: f64| {
                let bricks = range.clamp(0.0, config.max_range) / edge;
                let cone = solid_angle * bricks.powi(3) / 3.0;
                match config.rule {
                    IntegrationRule::Fused => cone,
                    IntegrationRule::Rays => cone.min(step as f64 * bricks * BRICKS_PER_EDGE),
                }
            };
            let free = bricks_to(range + table.start);
            // a band meets one layer of bricks more than its thickness has
            let layer = solid_angle * (range.min(config.max_range) / edge).powi(2);
            cost.free += free;
            cost.band += bricks_to(range + table.end()) - free + layer.min(step as f64);
        }
        Ok(cost)
    }

    /// Bytes to prepare the scan.
    pub(super) fn prepared_bytes(&self) -> f64 {
        (self.free + self.band) * PREPARED_BYTES
    }

    /// Bytes of the scan, prepared and in the map.
    fn bytes(&self) -> f64 {
        let payloads = self.band * (BRICK_CELLS * size_of::<i16>()) as f64;
        self.prepared_bytes() + (self.free + self.band) * DIRECTORY_BYTES + payloads
    }
}

/// The cost of a valid scan.
///
/// # Errors
/// The scan alone would need more memory than the map may have.
pub(super) fn affordable(
    map: &OccupancyMap,
    scan: &Scan,
    config: &IntegrationConfig,
) -> Result<Cost, MapError> {
    let cell = map.resolution();
    let cost = Cost::of(scan, config, cell, &map.known_tables)?;
    let budget_bytes = map.config().memory_budget_bytes as f64;
    if cost.bytes() <= budget_bytes {
        return Ok(cost);
    }
    // a map has many scans, so that one should need a tenth at most
    let mut fitting_cell = cell;
    let of_cell = |cell| Cost::of(scan, config, cell, &KnownTables::default());
    while fitting_cell < 1e9 && 10.0 * of_cell(fitting_cell)?.bytes() > budget_bytes {
        fitting_cell *= 2.0;
    }
    Err(MapError::TooFine {
        needed_gb: cost.bytes() / 1e9,
        budget_gb: budget_bytes / 1e9,
        cell,
        fitting_cell: rounded_up(fitting_cell),
    })
}

/// Solid angle of the directions of some points: that of a pyramid around them where all lie ahead,
/// else of a pyramid in each face of a cube around the sensor that holds some.
fn angle_seen(points: impl Iterator<Item = [f64; 3]> + Clone) -> f64 {
    let mut ahead = Slopes::default();
    if points
        .clone()
        .all(|[x, y, z]| z > 0.0 && z * z > 0.04 * (x * x + y * y))
    {
        points.for_each(|[x, y, z]| ahead.add([x / z, y / z]));
        return ahead.solid_angle();
    }
    let mut faces = [Slopes::default(); 6];
    for point in points {
        let axis = (0..3).fold(0, |longest, axis| {
            if point[axis].abs() > point[longest].abs() {
                axis
            } else {
                longest
            }
        });
        let along = point[axis];
        let slopes = [1, 2].map(|next| point[(axis + next) % 3] / along.abs());
        faces[2 * axis + usize::from(along < 0.0)].add(slopes);
    }
    faces.iter().map(Slopes::solid_angle).sum()
}

/// Bounds of the slopes of some directions against one axis.
#[derive(Clone, Copy)]
struct Slopes {
    low: [f64; 2],
    high: [f64; 2],
}

impl Default for Slopes {
    fn default() -> Self {
        Self {
            low: [f64::INFINITY; 2],
            high: [f64::NEG_INFINITY; 2],
        }
    }
}

impl Slopes {
    fn add(&mut self, slopes: [f64; 2]) {
        for (axis, slope) in slopes.into_iter().enumerate() {
            self.low[axis] = self.low[axis].min(slope);
            self.high[axis] = self.high[axis].max(slope);
        }
    }

    /// Of the pyramid between the bounds, at least as wide as the image that is made of the
    /// measurements: a single one has a width too. Zero without directions.
    fn solid_angle(&self) -> f64 {
        let [width, height] = [0, 1].map(|axis| self.high[axis] - self.low[axis]);
        if !(width >= 0.0 && height >= 0.0) {
            return 0.0;
        }
        let [right, bottom] =
            [0, 1].map(|axis| self.high[axis].max(self.low[axis] + NARROWEST_SLOPES));
        // of a pyramid between the axis and these slopes
        let corner = |x: f64, y: f64| (x * y / (1.0 + x * x + y * y).sqrt()).atan();
        corner(right, bottom) - corner(self.low[0], bottom) - corner(right, self.low[1])
            + corner(self.low[0], self.low[1])
    }
}

/// The next number with one digit that counts: 0.0123 becomes 0.02.
fn rounded_up(value: f64) -> f64 {
    let digit = 10_f64.powi(value.log10().floor() as i32);
    (value / digit).ceil() * digit
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::map::MapConfig;
    use crate::scan::{DepthPixel, DepthScan, PointScan, PoseSigma, ScanData, Similarity};

    fn scan(data: ScanData) -> Scan {
        Scan {
            id: 0,
            world_from_sensor: Similarity::IDENTITY,
            pose_sigma: PoseSigma::default(),
            data,
        }
    }

    /// A wall two units away, as depth image and as points.
    fn wall() -> (Vec<DepthPixel>, Vec<[f32; 3]>) {
        let pixels: Vec<DepthPixel> = (0..160 * 120_u32)
            .map(|i| DepthPixel {
                x: (i % 160) as u16,
                y: (i / 160) as u16,
                idepth: 0.5,
                sigma_idepth: 0.0025,
            })
            .collect();
        let points = pixels
            .iter()
            .map(|p| [f32::from(p.x) - 79.5, f32::from(p.y) - 59.5, 140.0].map(|c| c / 70.0))
            .collect();
        (pixels, points)
    }

    fn camera(pixels: &[DepthPixel]) -> ScanData<'_> {
        ScanData::Depth(DepthScan {
            width: 160,
            height: 120,
            fx: 140.0,
            fy: 140.0,
            cx: 79.5,
            cy: 59.5,
            pixels,
        })
    }

    #[test]
    fn the_estimate_is_that_of_the_integration_at_fine_cells() {
        let (pixels, points) = wall();
        let config = IntegrationConfig::default();
        let cells = 0.005;
        for data in [
            camera(&pixels),
            ScanData::Points(PointScan {
                points: &points,
                sigmas: &[0.01],
            }),
        ] {
            let scan = scan(data);
            let cost = Cost::of(&scan, &config, cells, &KnownTables::default()).unwrap();
            let mut map = OccupancyMap::new(MapConfig::with_resolution(cells)).unwrap();
            let report = crate::integrate::integrate(&mut map, &scan, &config, 2).unwrap();
            let estimated = cost.free + cost.band;
            let ratio = estimated / report.brick_visits as f64;
            assert!(
                (0.6..1.1).contains(&ratio),
                "{cost:?} {}",
                report.brick_visits
            );
            let payloads = map.brick_counts().0 as f64;
            assert!(
                (0.3..1.5).contains(&(cost.band / payloads)),
                "{cost:?} {payloads}"
            );
        }
    }

    #[test]
    fn too_fine_cells_are_refused_at_once_and_the_sentence_says_what_fits() {
        let (pixels, _) = wall();
        let scan = scan(camera(&pixels));
        for rule in [
            crate::integrate::IntegrationRule::Fused,
            crate::integrate::IntegrationRule::Rays,
        ] {
            let config = IntegrationConfig {
                rule,
                ..IntegrationConfig::default()
            };
            let map_of = |cells: f64| {
                OccupancyMap::new(MapConfig {
                    memory_budget_bytes: 100 << 20,
                    ..MapConfig::with_resolution(cells)
                })
                .unwrap()
            };
            for cells in [1e-5, 1e-4, 1e-3] {
                let mut map = map_of(cells);
                let refused = crate::integrate::integrate(&mut map, &scan, &config, 2);
                let Err(MapError::TooFine { fitting_cell, .. }) = refused else {
                    panic!("{refused:?}");
                };
                let scans = [scan, scan];
                assert!(crate::integrate::integrate_scans(&mut map, &scans, &config, 2).is_err());
                assert!(crate::integrate::bricks_seen(&map, &scan, &config, 2).is_err());
                assert_eq!(map.bytes_in_memory(), map_of(cells).bytes_in_memory());
                let mut map = map_of(fitting_cell);
                crate::integrate::integrate(&mut map, &scan, &config, 2).unwrap();
            }
        }
    }

    #[test]
    fn a_band_that_never_ends_costs_what_it_covers() {
        let (pixels, _) = wall();
        let scan = scan(camera(&pixels));
        let config = IntegrationConfig {
            model: crate::SensorModel::Ideal {
                buffer: crate::Buffer::Fixed(1e6),
            },
            max_range: f64::INFINITY,
            ..IntegrationConfig::default()
        };
        let mut map = OccupancyMap::new(MapConfig::with_resolution(0.05)).unwrap();
        let refused = crate::integrate::integrate(&mut map, &scan, &config, 2);
        assert!(
            matches!(refused, Err(MapError::TooFine { .. })),
            "{refused:?}"
        );
    }

    #[test]
    fn single_measurements_that_reach_far_are_counted() {
        let config = IntegrationConfig {
            max_range: f64::INFINITY,
            ..IntegrationConfig::default()
        };
        for points in [
            vec![[1.0, 0.5, 0.3]],
            vec![[1.0, 0.5, 0.3], [-2.0, 0.0, -1.0]],
        ] {
            let uncertain = scan(ScanData::Points(PointScan {
                points: &points,
                sigmas: &[1e8],
            }));
            let mut map = OccupancyMap::new(MapConfig::with_resolution(0.05)).unwrap();
            let refused = crate::integrate::integrate(&mut map, &uncertain, &config, 2);
            assert!(
                matches!(refused, Err(MapError::TooFine { .. })),
                "{refused:?}"
            );
        }
    }

    #[test]
    fn a_sensor_that_sees_two_ways_costs_what_lies_in_these_directions() {
        let points: Vec<[f32; 3]> = (-20..=20)
            .flat_map(|i| [[20.0, 0.1 * i as f32, 0.2], [-20.0, 0.3, 0.1 * i as f32]])
            .collect();
        let scan = scan(ScanData::Points(PointScan {
            points: &points,
            sigmas: &[0.01],
        }));
        let config = IntegrationConfig::default();
        let cost = Cost::of(&scan, &config, 0.05, &KnownTables::default()).unwrap();
        let mut map = OccupancyMap::new(MapConfig::with_resolution(0.05)).unwrap();
        let report = crate::integrate::integrate(&mut map, &scan, &config, 2).unwrap();
        // a fan is as thin as a brick, a ball of this radius has half a million of them
        assert!(report.brick_visits < 4000, "{}", report.brick_visits);
        assert!(cost.free + cost.band < 4000.0, "{cost:?}");
    }

    #[test]
    fn solid_angles() {
        let cube_face = [[1.0, 1.0, 1.0], [-1.0, -1.0, 1.0]];
        let sixth = 4.0 * std::f64::consts::PI / 6.0;
        assert!((angle_seen(cube_face.into_iter()) - sixth).abs() < 1e-12);
        let single = NARROWEST_SLOPES * NARROWEST_SLOPES;
        for one in [[0.0, 0.0, 3.0], [0.0, 0.0, -1.0]] {
            let angle = angle_seen([one].into_iter());
            assert!((angle / single - 1.0).abs() < 1e-3, "{angle}");
        }
        let corners = (0..8).map(|i| [1, 2, 4].map(|bit| if i & bit == 0 { -1.0 } else { 1.001 }));
        let around = angle_seen(corners.flat_map(|[x, y, z]| {
            [
                [x, 0.999 * y, 0.999 * z],
                [0.999 * x, y, 0.999 * z],
                [0.999 * x, 0.999 * y, z],
            ]
        }));
        assert!((around / (6.0 * sixth) - 1.0).abs() < 0.01, "{around}");
        assert!(rounded_up(0.0123) - 0.02 < 1e-12 && rounded_up(3.0) - 3.0 < 1e-12);
    }
}
