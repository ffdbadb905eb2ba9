//! Occupied cells as point clouds: binary little-endian PLY and PCD, one point per cell centre.

use std::io::{BufWriter, Write};

use crate::error::MapError;
use crate::evidence::{Occupancy, log_odds_from_evidence, probability_from_log_odds};
use crate::map::OccupancyMap;

fn write_error(source: std::io::Error) -> MapError {
    MapError::Io {
        action: "writing the point cloud",
        source,
    }
}

fn occupied_points(map: &OccupancyMap) -> impl Iterator<Item = [f32; 4]> + '_ {
    map.bricks().into_iter().flat_map(move |brick| {
        let values = map.brick_values(brick);
        (0..values.len())
            .filter(move |&i| map.limits.occupancy(values[i]) == Occupancy::Occupied)
            .map(move |i| {
                let [x, y, z] = brick.cell(i).center(map.resolution());
                let log_odds = f64::from(log_odds_from_evidence(values[i]));
                [x, y, z, probability_from_log_odds(log_odds)].map(|v| v as f32)
            })
    })
}

fn write_points(map: &OccupancyMap, out: &mut impl Write) -> Result<(), MapError> {
    for point in occupied_points(map) {
        for value in point {
            out.write_all(&value.to_le_bytes()).map_err(write_error)?;
        }
    }
    out.flush().map_err(write_error)
}

/// Writes the centres of the occupied cells, with their probability, as binary PLY.
///
/// # Errors
/// Writing fails.
pub fn write_ply(map: &OccupancyMap, out: &mut impl Write) -> Result<(), MapError> {
    let mut out = BufWriter::new(out);
    let count = occupied_points(map).count();
    write!(
        out,
        "ply\nformat binary_little_endian 1.0\ncomment cell {}\nelement vertex {count}\n\
         property float x\nproperty float y\nproperty float z\nproperty float probability\n\
         end_header\n",
        map.resolution()
    )
    .map_err(write_error)?;
    write_points(map, &mut out)
}

/// Writes the centres of the occupied cells, with their probability, as binary PCD 0.7.
///
/// # Errors
/// Writing fails.
pub fn write_pcd(map: &OccupancyMap, out: &mut impl Write) -> Result<(), MapError> {
    let mut out = BufWriter::new(out);
    let count = occupied_points(map).count();
    write!(
        out,
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z probability\n\
         SIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\nWIDTH {count}\nHEIGHT 1\n\
         VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {count}\nDATA binary\n"
    )
    .map_err(write_error)?;
    write_points(map, &mut out)
}
