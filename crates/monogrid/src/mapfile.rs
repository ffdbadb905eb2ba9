//! Reading and writing map files.

use crate::failure::{Classify, Failure};
use crate::output::OutputFile;
use monogrid_datasets::open_file;
use monogrid_occupancy::{MapFormat, OccupancyMap, read_map};
use std::io::BufReader;
use std::path::Path;

/// Writes a map; its size in bytes.
pub fn save(map: &OccupancyMap, file: &OutputFile, format: MapFormat) -> Result<u64, Failure> {
    file.write_with(|mut out| Ok(format.write(map, &mut out)?))?;
    Ok(std::fs::metadata(file.path()).map_or(0, |metadata| metadata.len()))
}

/// Reads an `.ot`, `.bt` or `.mgo` by its first bytes, whatever its name.
pub fn load(path: &Path) -> Result<(OccupancyMap, MapFormat), Failure> {
    let (file, bytes) = open_file(path).bad_input()?;
    read_map(BufReader::new(file), bytes).map_err(|error| {
        Failure::Input(anyhow::Error::from(error).context(format!("map {}", path.display())))
    })
}
