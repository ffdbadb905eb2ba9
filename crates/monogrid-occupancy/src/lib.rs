//! Probabilistic voxel map compatible with OctoMap, with inverse sensor models and queries.
//!
//! An [`OccupancyMap`] holds log-odds per cell in sparse bricks of 8 x 8 x 8 cells; space that is
//! equal all over a brick costs 16 bytes. [`integrate`] adds range measurements with an inverse
//! [`SensorModel`]; [`write_ot`] and [`write_bt`] write OctoMap's files. Usable without any SLAM:
//!
//! ```
//! use monogrid_occupancy::*;
//!
//! # fn main() -> Result<(), MapError> {
//! let mut map = OccupancyMap::new(MapConfig::with_resolution(0.05))?;
//! let points = [[0.0_f32, 0.0, 2.0], [0.1, 0.0, 2.0]]; // in the sensor frame, metres
//! let scan = Scan {
//!     id: 0,
//!     world_from_sensor: Similarity::IDENTITY,
//!     pose_sigma: PoseSigma::default(),
//!     data: ScanData::Points(PointScan { points: &points, sigmas: &[0.02] }),
//! };
//! let config = IntegrationConfig { rule: IntegrationRule::Rays, ..IntegrationConfig::default() };
//! integrate(&mut map, &scan, &config, 2)?;
//! assert_eq!(map.state([0.0, 0.0, 1.0]), Occupancy::Free);
//! assert_eq!(map.state([0.0, 0.0, 2.0]), Occupancy::Occupied);
//! assert_eq!(map.state([0.0, 0.0, 3.0]), Occupancy::Unknown);
//! let mut file = Vec::new();
//! write_bt(&map, &mut file)?;
//! # Ok(())
//! # }
//! ```
//!
//! Conventions: cell boundaries lie on multiples of the resolution, as in OctoMap; all lengths
//! are in map units (metres, if the poses and measurements are); sensors look along +z.

mod combine;
mod error;
mod evidence;
mod integrate;
mod io;
mod key;
mod keyframes;
mod likelihood;
mod map;
mod octree;
mod query;
mod scan;
mod scans_file;
mod sensor;
mod storage;

pub use combine::{CellCounts, MapDifference};
pub use error::MapError;
pub use evidence::{Occupancy, log_odds_from_probability, probability_from_log_odds};
pub use integrate::{IntegrationConfig, IntegrationReport, IntegrationRule, integrate};
pub use io::{
    MGO_MAGIC, read_bt, read_mgo, read_ot, save_atomically, write_bt, write_mgo, write_ot,
    write_pcd, write_ply,
};
pub use key::{BRICK_CELLS, BRICK_EDGE, BrickKey, VoxelKey};
pub use keyframes::{KeyframeChange, KeyframeMap};
pub use map::{MapConfig, OccupancyMap};
pub use octree::Leaf;
pub use query::cast::{RayHit, UnknownCells};
pub use query::cells::Cell;
pub use query::distance::{DistanceConfig, DistanceField};
pub use query::project::Projection;
pub use query::snapshot::Snapshot;
pub use scan::{
    DepthPixel, DepthScan, PointScan, PoseSigma, Scan, ScanData, SigmaMode, Similarity,
};
pub use scans_file::{ScansReader, StoredScan};
pub use sensor::{AndertForm, Buffer, SensorModel, Significance, ThrunForm, normal_cdf};
