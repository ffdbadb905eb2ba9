//! Occupied cells as point clouds: binary little-endian PLY and PCD, one point per cell centre.

use std::io::{BufWriter, Write};

use crate::error::MapError;
use crate::evidence::{Occupancy, probability_from_log_odds};
use crate::key::VoxelKey;
use crate::map::OccupancyMap;

fn write_error(source: std::io::Error) -> MapError {
    MapError::io("writing the point cloud")(source)
}

fn occupied_points(map: &OccupancyMap) -> impl Iterator<Item = (VoxelKey, [f32; 4])> + '_ {
    let occupied = map.cells().filter(|cell| cell.state == Occupancy::Occupied);
    occupied.map(move |cell| {
        let [x, y, z] = cell.key.center(map.resolution());
        let point = [x, y, z, probability_from_log_odds(cell.log_odds.into())];
        (cell.key, point.map(|v| v as f32))
    })
}

/// Red, green and blue of a cell.
type ColourOf<'a> = &'a dyn Fn(VoxelKey) -> [u8; 3];

fn write_points(
    map: &OccupancyMap,
    colour: Option<ColourOf>,
    out: &mut impl Write,
) -> Result<(), MapError> {
    for (key, point) in occupied_points(map) {
        for value in point {
            out.write_all(&value.to_le_bytes()).map_err(write_error)?;
        }
        if let Some(colour) = colour {
            out.write_all(&colour(key)).map_err(write_error)?;
        }
    }
    out.flush().map_err(write_error)
}

/// Writes the centres of the occupied cells, with their probability and, where it is given, their
/// colour (red, green, blue), as binary PLY.
///
/// # Errors
/// Writing fails.
pub fn write_ply(
    map: &OccupancyMap,
    colour: Option<ColourOf>,
    out: &mut impl Write,
) -> Result<(), MapError> {
    let colours = match colour {
        Some(_) => "property uchar red\nproperty uchar green\nproperty uchar blue\n",
        None => "",
    };
    let mut out = BufWriter::new(out);
    let count = occupied_points(map).count();
    write!(
        out,
        "ply\nformat binary_little_endian 1.0\ncomment cell {}\nelement vertex {count}\n\
         property float x\nproperty float y\nproperty float z\nproperty float probability\n\
         {colours}end_header\n",
        map.resolution()
    )
    .map_err(write_error)?;
    write_points(map, colour, &mut out)
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
    write_points(map, None, &mut out)
}
