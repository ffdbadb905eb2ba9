//! Probabilistic voxel map compatible with OctoMap, with inverse sensor models and queries.
//!
//! An [`OccupancyMap`] holds log-odds per cell in sparse bricks of 8 x 8 x 8 cells; space that is
//! equal all over a brick costs 16 bytes. [`integrate`] adds range measurements with an inverse
//! [`SensorModel`]. Usable without any SLAM; ten lines from a lidar to a map:
//!
//! ```
//! use monogrid_occupancy::*;
//!
//! # fn main() -> Result<(), MapError> {
//! let mut map = OccupancyMap::new(MapConfig::with_resolution(0.05))?;
//! let row = |y: i16| (-50_i16..=50).map(move |x| [0.01 * f32::from(x), 0.01 * f32::from(y), 2.0]);
//! let points: Vec<[f32; 3]> = (-50..=50).flat_map(row).collect(); // in the sensor frame, metres
//! let world_from_sensor = Similarity::IDENTITY; // from your odometry
//! let scan = Scan::of_points(0, world_from_sensor, &points, &[0.02]);
//! integrate(&mut map, &scan, &IntegrationConfig::default(), 2)?;
//! assert_eq!(map.state([0.0, 0.0, 2.0]), Occupancy::Occupied);
//! write_bt(&map, &mut std::io::sink())?; // or save_atomically(path, |file| write_ot(&map, file))
//! # Ok(())
//! # }
//! ```
//!
//! Depth images are [`ScanData::Image`] as they come, holes included, [`ScanData::Depth`] if few
//! pixels have a depth. The examples `lidar` and `depth_camera` are whole programs, `own_sensor`
//! has a model of its own. Scans of a few
//! lone points are for [`IntegrationRule::Rays`]: the default rule may miss a point with no others
//! in the directions around it.
//!
//! # Questions
//!
//! | question | of the map | many of them, or on another thread |
//! |---|---|---|
//! | what is here? | [`OccupancyMap::state`] | [`Snapshot::state`], [`Snapshot::states`] |
//! | how certain is that? | [`OccupancyMap::log_odds`] | |
//! | and in a larger cell? | [`OccupancyMap::state_at_level`] | |
//! | what does a ray hit first? | [`OccupancyMap::cast_ray`] | [`Snapshot::cast_ray`] |
//! | does a ball fit here? | [`OccupancyMap::sphere_collides`] | [`Snapshot::sphere_collides`] |
//! | does a box fit here? | [`OccupancyMap::box_collides`] | [`Snapshot::box_collides`] |
//! | how far is the nearest obstacle? | | [`DistanceField::distance`] |
//! | what is in this box? | [`OccupancyMap::cells_in_box`], [`OccupancyMap::keys_in_key_box`] | |
//! | what changed? | [`OccupancyMap::bricks_changed_since`], [`OccupancyMap::difference`] | |
//! | what does it look like from above? | [`OccupancyMap::projected`] | |
//! | where are its surfaces? | [`OccupancyMap::surface_mesh`] | |
//!
//! A [`Snapshot`] and a [`DistanceField`] follow their map by reading the bricks that changed:
//!
//! ```
//! # use monogrid_occupancy::*;
//! # fn main() -> Result<(), MapError> {
//! let mut map = OccupancyMap::new(MapConfig::with_resolution(0.1))?;
//! let mut snapshot = Snapshot::new(&map);
//! let mut distances = DistanceField::new(&map, DistanceConfig::default(), 1)?;
//! map.add_log_odds(VoxelKey::new(5, 0, 0), 2.0)?;
//! for brick in map.bricks_changed_since(snapshot.revision()) {
//!     // publish `map.cells_in_key_box(brick.first_cell(), brick.cell(BRICK_CELLS - 1))`
//! #   assert_eq!(brick, BrickKey::new(0, 0, 0));
//! }
//! snapshot.update(&map);
//! distances.update(&map, 1);
//! assert!(snapshot.sphere_collides([0.3, 0.0, 0.0], 0.25, UnknownCells::PassThrough));
//! assert_eq!(distances.distance([0.15, 0.05, 0.05]), Some(0.4));
//! # Ok(())
//! # }
//! ```
//!
//! # Maps from maps, and files
//!
//! [`OccupancyMap::merge`], [`OccupancyMap::cropped`], [`OccupancyMap::within`] and
//! [`OccupancyMap::transformed`] make maps from maps. Files are OctoMap's `.ot` ([`read_ot`],
//! [`write_ot`], in colour [`write_colour_ot`]) and `.bt` ([`read_bt`], [`write_bt`]), the exact
//! and small `.mgo` ([`read_mgo`], [`write_mgo`]; [`read_map`] tells them apart), and point clouds
//! ([`write_ply`], [`write_pcd`]).
//! Writers stream; readers are given a memory budget and take any bytes without a panic.
//! [`save_atomically`] keeps the old file until the new one is on disk.
//!
//! [`OccupancyMap::pack`] makes a finished map two thirds smaller in memory without changing a
//! cell.
//!
//! Free rays clear what is gone; [`Decay`] forgets what is never looked at again, down to the map
//! that was loaded.
//!
//! Conventions: cell boundaries lie on multiples of the resolution, as in OctoMap; all lengths
//! are in map units (metres, if the poses and measurements are); sensors look along +z.

mod body;
mod combine;
mod decay;
mod error;
mod evidence;
mod for_avx2;
mod integrate;
mod io;
mod key;
mod keyframes;
mod likelihood;
mod map;
mod octree;
mod query;
mod scan;
mod sensor;
mod storage;
#[cfg(test)]
mod test_random;

pub use combine::{CellCounts, MapDifference};
pub use decay::{Decay, DecayConfig};
pub use error::MapError;
pub use evidence::{Occupancy, log_odds_from_probability, probability_from_log_odds};
pub use integrate::{
    IntegrationConfig, IntegrationReport, IntegrationRule, integrate, integrate_scans,
};
pub use io::{
    MGO_MAGIC, MapFormat, read_bt, read_map, read_mgo, read_ot, save_atomically, write_bt,
    write_colour_ot, write_mgo, write_ot, write_pcd, write_ply,
};
pub use key::{BRICK_CELLS, BRICK_EDGE, BrickKey, VoxelKey};
pub use keyframes::{KeyframeChange, KeyframeMap};
pub use map::{MapConfig, OccupancyMap};
pub use octree::Leaf;
pub use query::cast::{RayHit, UnknownCells};
pub use query::cells::Cell;
pub use query::distance::{DistanceConfig, DistanceField};
pub use query::mesh::SurfaceMesh;
pub use query::project::Projection;
pub use query::snapshot::Snapshot;
pub use scan::{
    DepthImage, DepthPixel, DepthScan, PointScan, PoseSigma, Scan, ScanData, SigmaMode, Similarity,
};
pub use sensor::{
    AndertForm, Buffer, SensorCurve, SensorModel, Significance, ThrunForm, normal_cdf,
};
