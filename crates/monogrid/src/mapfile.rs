//! Reading and writing maps in the format that their name or content says.

use crate::failure::{Classify, Failure};
use crate::output::OutputFile;
use monogrid_datasets::open_file;
use monogrid_occupancy::{
    MGO_MAGIC, MapError, OccupancyMap, read_bt, read_mgo, read_ot, write_bt, write_mgo, write_ot,
    write_pcd, write_ply,
};
use std::io::{BufRead, BufReader, Write};
use std::path::Path;

/// Memory that a map read from any file may take, and for each byte of the file.
const READ_BUDGET_BYTES: usize = 1 << 30;
const READ_BUDGET_PER_BYTE: usize = 64;

/// Formats that maps are written in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MapFormat {
    /// OctoMap with probabilities.
    Ot,
    /// OctoMap, binary.
    Bt,
    /// Exact, with checksums, and small.
    Mgo,
    /// Point cloud of occupied cells.
    Ply,
    /// Point cloud of occupied cells.
    Pcd,
}

impl MapFormat {
    /// What a map can be read from again.
    pub const MAPS: [Self; 3] = [Self::Ot, Self::Bt, Self::Mgo];
    /// All that can be written.
    pub const ALL: [Self; 5] = [Self::Ot, Self::Bt, Self::Mgo, Self::Ply, Self::Pcd];

    /// The format that a file name asks for, if it is one of `allowed`.
    pub fn from_name(path: &Path, allowed: &[Self]) -> Result<Self, Failure> {
        let extension = path
            .extension()
            .map(|e| e.to_string_lossy().to_ascii_lowercase());
        let format = match extension.as_deref() {
            Some("ot") => Some(Self::Ot),
            Some("bt") => Some(Self::Bt),
            Some("mgo") => Some(Self::Mgo),
            Some("ply") => Some(Self::Ply),
            Some("pcd") => Some(Self::Pcd),
            _ => None,
        };
        format
            .filter(|format| allowed.contains(format))
            .ok_or_else(|| {
                let names: Vec<&str> = allowed.iter().map(|format| format.extension()).collect();
                Failure::input(format!(
                    "cannot tell the map format from {}: expected a name that ends in {}",
                    path.display(),
                    names.join(", ")
                ))
            })
    }

    fn extension(self) -> &'static str {
        match self {
            Self::Ot => ".ot",
            Self::Bt => ".bt",
            Self::Mgo => ".mgo",
            Self::Ply => ".ply",
            Self::Pcd => ".pcd",
        }
    }

    /// For people.
    pub fn description(self) -> &'static str {
        match self {
            Self::Ot => "OctoMap .ot (probabilities)",
            Self::Bt => "OctoMap .bt (occupied, free, unknown)",
            Self::Mgo => "monogrid .mgo (exact log-odds, checksums)",
            Self::Ply => "PLY point cloud",
            Self::Pcd => "PCD point cloud",
        }
    }
}

/// Writes a map; its size in bytes.
pub fn save(map: &OccupancyMap, file: &OutputFile, format: MapFormat) -> Result<u64, Failure> {
    file.write_with(|out| write(map, out, format))?;
    Ok(std::fs::metadata(file.path()).map_or(0, |metadata| metadata.len()))
}

/// A map in a format.
pub fn write(map: &OccupancyMap, mut out: &mut dyn Write, format: MapFormat) -> anyhow::Result<()> {
    match format {
        MapFormat::Ot => write_ot(map, &mut out),
        MapFormat::Bt => write_bt(map, &mut out),
        MapFormat::Mgo => write_mgo(map, &mut out),
        MapFormat::Ply => write_ply(map, None, &mut out),
        MapFormat::Pcd => write_pcd(map, &mut out),
    }?;
    Ok(())
}

/// Reads an `.ot`, `.bt` or `.mgo` by its first bytes, whatever its name.
pub fn load(path: &Path) -> Result<(OccupancyMap, MapFormat), Failure> {
    let (file, bytes) = open_file(path).bad_input()?;
    let budget =
        READ_BUDGET_BYTES.saturating_add(READ_BUDGET_PER_BYTE.saturating_mul(bytes as usize));
    let mut input = BufReader::new(file);
    let start = input.fill_buf().map_err(|error| {
        Failure::input(format!("map {} cannot be read: {error}", path.display()))
    })?;
    let format = if start.starts_with(b"# Octomap OcTree binary file") {
        MapFormat::Bt
    } else if start.starts_with(b"# Octomap OcTree file") {
        MapFormat::Ot
    } else if start.starts_with(&MGO_MAGIC) {
        MapFormat::Mgo
    } else {
        return Err(Failure::input(format!(
            "{} is not a map: it begins neither as an OctoMap .ot or .bt file nor as a .mgo file",
            path.display()
        )));
    };
    let map = match format {
        MapFormat::Bt => read_bt(input, budget),
        MapFormat::Mgo => read_mgo(input, budget),
        _ => read_ot(input, budget),
    };
    map.map(|map| (map, format)).map_err(|error: MapError| {
        Failure::Input(anyhow::Error::from(error).context(format!("map {}", path.display())))
    })
}
