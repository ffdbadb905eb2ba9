//! Maps in the format that a name or the content of a file says.

use super::header::LEGACY_MAGIC;
use super::{
    MGO_MAGIC, read_bt, read_mgo, read_ot, write_bt, write_mgo, write_ot, write_pcd, write_ply,
};
use crate::error::MapError;
use crate::map::OccupancyMap;
use std::io::{BufRead, Write};
use std::path::Path;

/// Memory that a map read from any file may take, and for each byte of the file.
const READ_BUDGET_BYTES: u64 = 256 << 20;
const READ_BUDGET_PER_BYTE: u64 = 64;

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
    ///
    /// # Errors
    /// Any other name.
    pub fn from_name(path: &Path, allowed: &[Self]) -> Result<Self, MapError> {
        let extension = path.extension().unwrap_or_default().to_ascii_lowercase();
        let asked = |format: &&Self| *extension == format.extension()[1..];
        allowed.iter().find(asked).copied().ok_or_else(|| {
            let names: Vec<&str> = allowed.iter().map(|format| format.extension()).collect();
            MapError::Name {
                path: path.to_owned(),
                expected: names.join(", "),
            }
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
    #[must_use]
    pub fn description(self) -> &'static str {
        match self {
            Self::Ot => "OctoMap .ot (probabilities)",
            Self::Bt => "OctoMap .bt (occupied, free, unknown)",
            Self::Mgo => "monogrid .mgo (exact log-odds, checksums)",
            Self::Ply => "PLY point cloud",
            Self::Pcd => "PCD point cloud",
        }
    }

    /// Writes a map in this format.
    ///
    /// # Errors
    /// A map that the format cannot hold, or what `out` says.
    pub fn write(self, map: &OccupancyMap, out: &mut impl Write) -> Result<(), MapError> {
        match self {
            Self::Ot => write_ot(map, out),
            Self::Bt => write_bt(map, out),
            Self::Mgo => write_mgo(map, out),
            Self::Ply => write_ply(map, None, out),
            Self::Pcd => write_pcd(map, out),
        }
    }
}

/// Reads an `.ot`, `.bt` or `.mgo` of known length by its first bytes. A file may ask for 268 MB of
/// memory, and more the larger it is.
///
/// # Errors
/// What is none of them, or damaged.
pub fn read_map(
    mut input: impl BufRead,
    length_bytes: u64,
) -> Result<(OccupancyMap, MapFormat), MapError> {
    let budget =
        READ_BUDGET_BYTES.saturating_add(READ_BUDGET_PER_BYTE.saturating_mul(length_bytes));
    let budget = usize::try_from(budget).unwrap_or(usize::MAX);
    let start = input.fill_buf();
    let start = start.map_err(MapError::io("reading a map"))?;
    let is_bt =
        start.starts_with(b"# Octomap OcTree binary file") || start.starts_with(&LEGACY_MAGIC);
    let (map, format) = if is_bt {
        (read_bt(input, budget), MapFormat::Bt)
    } else if start.starts_with(b"# Octomap OcTree file") {
        (read_ot(input, budget), MapFormat::Ot)
    } else if start.starts_with(&MGO_MAGIC) {
        (read_mgo(input, budget), MapFormat::Mgo)
    } else {
        return Err(MapError::NotAMap);
    };
    Ok((map?, format))
}
