//! Measurements of a scan as range images: what the rule `fused` looks cells up in.
//!
//! A scan that looks one way becomes one pinhole image, any other the six faces of a cube. Pixels
//! are as fine as the measurements are dense, but no finer than half a typical cell.

pub(crate) mod chunks;
mod depth_image;
pub(crate) mod extremes;
pub(crate) mod range_image;
mod samples;
mod slope;
pub(crate) mod windows;

use crate::error::MapError;
use crate::integrate::IntegrationConfig;
use crate::integrate::image::depth_image::range_image;
use crate::integrate::image::range_image::{FORWARD, RangeImage};
use crate::integrate::image::samples::point_images;
use crate::integrate::image::slope::band_by_slope;
use crate::scan::Scan;
use crate::sensor::table::{KnownTables, TableSet};

/// A scan prepared for the rule `fused`.
#[derive(Clone, Debug)]
pub(crate) struct RangeImages {
    /// Place of the sensor in map units.
    pub origin: [f64; 3],
    pub images: Vec<RangeImage>,
    pub tables: TableSet,
    pub points: usize,
    /// How often a sample for an obstacle counts in addition.
    pub obstacle_weight: i32,
}

impl RangeImages {
    /// Prepares a scan for a map with cells of edge `resolution`.
    pub(crate) fn new(
        scan: &Scan,
        config: &IntegrationConfig,
        resolution: f64,
        threads: usize,
        known_tables: &KnownTables,
    ) -> Result<Self, MapError> {
        let mut tables = known_tables.set(config, resolution)?;
        let rotation = scan.world_from_sensor.rotation;
        // Columns of world_from_sensor are the sensor's axes in the world.
        let in_world = &|axes: [[f64; 3]; 3]| {
            axes.map(|axis| std::array::from_fn(|i| (0..3).map(|j| rotation[i][j] * axis[j]).sum()))
        };
        let found = range_image(scan, in_world(FORWARD), resolution, &mut tables);
        let (mut images, points) = match found {
            Some(found) => found,
            None => point_images(scan, config, resolution, threads, in_world, &mut tables),
        };
        if config.band_by_slope && tables.has_automatic_band() {
            for image in &mut images {
                band_by_slope(image, &mut tables, resolution);
            }
        }
        Ok(Self {
            origin: scan.world_from_sensor.translation,
            images,
            tables,
            points,
            obstacle_weight: i32::from(config.obstacle_weight),
        })
    }
}
