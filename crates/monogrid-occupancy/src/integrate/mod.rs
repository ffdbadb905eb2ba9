//! From scans to evidence: the integration rules.
//!
//! - [`IntegrationRule::Rays`]: every measurement updates every cell that its ray crosses, in the
//!   order of the pixels, of points by their directions; clamped at each write. The thesis' rule,
//!   exact, the reference.
//! - [`IntegrationRule::Fused`]: one update per cell and scan, from the measurements in the
//!   cell's footprint.
//!
//! Both are split over shards of bricks that no two threads share, so the result is the same,
//! bit for bit, for any number of threads.

mod config;
mod cost;
pub(crate) mod fused;
pub(crate) mod image;
pub(crate) mod kernel;
pub(crate) mod octants;
pub(crate) mod parallel;
pub(crate) mod rays;

pub use self::config::{IntegrationConfig, IntegrationReport, IntegrationRule};

use self::cost::affordable;
use crate::error::MapError;
use crate::key::BrickFilter;
use crate::map::OccupancyMap;
use crate::scan::Scan;
use crate::sensor::SensorModel;

/// Adds one scan to a map, using `threads` threads (at least one).
///
/// The result does not depend on `threads`. On an error the map is as before.
///
/// A map that could exceed its memory budget is packed first ([`OccupancyMap::pack`]) if an eighth
/// of the budget or more is in bricks that are not packed; with less to gain, every scan would pack
/// again.
///
/// # Errors
/// An invalid scan or configuration, or the memory budget could be exceeded.
pub fn integrate(
    map: &mut OccupancyMap,
    scan: &Scan,
    config: &IntegrationConfig,
    threads: usize,
) -> Result<IntegrationReport, MapError> {
    config.validate()?;
    scan.validate()?;
    let threads = threads.max(1);
    integrate_where(map, scan, config, threads, None).or_else(|error| {
        map.pack_for_budget(error, threads)?;
        integrate_where(map, scan, config, threads, None)
    })
}

/// Adds scans one after the other: the map of [`integrate`] for each of them, the same bytes, but
/// several threads share the work better, because they prepare scans while others are written.
///
/// Needs memory for four prepared scans per thread (about 6 MB for one of 100,000 measurements), so
/// hand it all there are only if they are few. The report is the sum of all scans.
///
/// # Errors
/// As [`integrate`], of the first scan that fails; the map then holds those before it.
pub fn integrate_scans(
    map: &mut OccupancyMap,
    scans: &[Scan],
    config: &IntegrationConfig,
    threads: usize,
) -> Result<IntegrationReport, MapError> {
    config.validate()?;
    let invalid = scans.iter().position(|scan| scan.validate().is_err());
    let valid = &scans[..invalid.unwrap_or(scans.len())];
    let mut largest = 0.0_f64;
    if config.model != SensorModel::None {
        for scan in valid {
            largest = largest.max(affordable(map, scan, config)?.prepared_bytes());
        }
    }
    let mut report = IntegrationReport::default();
    match config.rule {
        IntegrationRule::Fused if threads > 1 && config.model != SensorModel::None => {
            report = fused::integrate_scans(map, valid, config, threads, largest)?;
        }
        IntegrationRule::Rays if threads > 1 && config.model != SensorModel::None => {
            report = rays::integrate_scans(map, valid, config, threads)?;
        }
        _ => {
            for scan in valid {
                report.add(&integrate(map, scan, config, threads)?);
            }
        }
    }
    match invalid {
        Some(invalid) => scans[invalid].validate().map(|()| report),
        None => Ok(report),
    }
}

/// Packed keys, sorted, of all bricks that a valid scan can change.
pub(crate) fn bricks_seen(
    map: &OccupancyMap,
    scan: &Scan,
    config: &IntegrationConfig,
    threads: usize,
) -> Result<Vec<u64>, MapError> {
    if config.model != SensorModel::None {
        affordable(map, scan, config)?;
    }
    let mut keys = match config.rule {
        _ if config.model == SensorModel::None => rays::end_point_bricks(map, scan, config),
        IntegrationRule::Rays => rays::bricks_seen(map, scan, config)?,
        IntegrationRule::Fused => fused::bricks_seen(map, scan, config, threads)?,
    };
    keys.sort_unstable();
    keys.dedup();
    Ok(keys)
}

/// [`integrate`] restricted to some bricks, for a valid scan and configuration.
pub(crate) fn integrate_where(
    map: &mut OccupancyMap,
    scan: &Scan,
    config: &IntegrationConfig,
    threads: usize,
    only: BrickFilter,
) -> Result<IntegrationReport, MapError> {
    if config.model != SensorModel::None && only.is_none() {
        affordable(map, scan, config)?;
    }
    match config.rule {
        // End points are the same for both rules: no free space, nothing to fuse.
        _ if config.model == SensorModel::None => {
            rays::integrate_end_points(map, scan, config, only)
        }
        IntegrationRule::Rays => rays::integrate_rays(map, scan, config, threads, only),
        IntegrationRule::Fused => fused::integrate_fused(map, scan, config, threads, only),
    }
}
