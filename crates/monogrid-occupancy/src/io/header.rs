//! The text header that OctoMap's two formats share, and the cube writer of their readers.

use std::io::{Read, Write};

use super::read_error;
use crate::error::MapError;
use crate::evidence::{evidence_from_log_odds, log_odds_from_probability};
use crate::key::{BRICK_EDGE, VoxelKey};
use crate::map::{MapConfig, OccupancyMap};

/// OctoMap's names of its trees: with occupancy alone, and with a colour in each node.
pub(crate) const OCTREE: &str = "OcTree";
pub(crate) const COLOUR_OCTREE: &str = "ColorOcTree";
/// Depth of OctoMap's trees.
pub(crate) const TREE_DEPTH: u32 = 16;
/// Longest header that is believed: a file without one must not be read to its end in search.
const MAX_HEADER_BYTES: usize = 64 << 10;

/// Edge of cubes that no map has room for, in cells: those that OctoMap prunes to octants of its
/// whole space.
const ENDLESS_CELLS: i32 = 1 << 11;

/// OctoMap's own clamps: logit(0.1192) and logit(0.971).
pub(crate) fn octomap_clamps() -> (f32, f32) {
    let clamp = |probability| log_odds_from_probability(probability) as f32;
    (clamp(0.1192), clamp(0.971))
}

/// Fields of a header that matter.
#[derive(Default)]
pub(crate) struct Header {
    pub id: String,
    pub size: u64,
    pub resolution: f64,
}

/// Writes the header with the first line `title`, of a kind of tree.
pub(crate) fn write(
    out: &mut impl Write,
    [title, id]: [&str; 2],
    nodes: usize,
    resolution: f64,
) -> Result<(), MapError> {
    write!(
        out,
        "{title}\n# (feel free to add / change comments, but leave the first line as it is!)\n#\n\
         id {id}\nsize {nodes}\nres {resolution}\ndata\n"
    )
    .map_err(MapError::io("writing the map header"))
}

/// Reads up to and including the line `data`.
pub(crate) fn read(
    input: &mut impl Read,
    title: &str,
    format: &'static str,
) -> Result<Header, MapError> {
    let mut budget = MAX_HEADER_BYTES;
    let first = read_line(input, format, &mut budget)?;
    if first.trim_end() != title {
        return Err(MapError::format(
            format,
            format!("the first line is {first:?}, expected {title:?}"),
        ));
    }
    let mut header = Header::default();
    loop {
        let line = read_line(input, format, &mut budget)?;
        let mut words = line.split_whitespace();
        let (key, value) = (words.next().unwrap_or("#"), words.next().unwrap_or(""));
        let bad = || MapError::format(format, format!("header line {line:?} has no usable value"));
        match key {
            "data" => break,
            "id" => value.clone_into(&mut header.id),
            "size" => header.size = value.parse().map_err(|_| bad())?,
            "res" => header.resolution = value.parse().map_err(|_| bad())?,
            // Comments and fields of later versions.
            _ => {}
        }
    }
    header.checked(format)
}

impl Header {
    fn checked(self, format: &'static str) -> Result<Self, MapError> {
        if !(self.resolution.is_finite() && self.resolution > 0.0) {
            return Err(MapError::format(
                format,
                format!("resolution {} is not positive", self.resolution),
            ));
        }
        Ok(self)
    }

    /// Bytes of each node behind its log-odds in a `.ot`; `None` for a tree whose nodes are
    /// something else. Times of nodes are not written.
    pub(crate) fn extra_bytes(&self) -> Option<usize> {
        match self.id.as_str() {
            // `1` before trees had names
            "OcTree" | "OcTreeStamped" | "1" => Some(0),
            COLOUR_OCTREE => Some(3),
            _ => None,
        }
    }

    pub(crate) fn unsupported(&self, format: &'static str) -> MapError {
        let id = &self.id;
        MapError::format(
            format,
            format!(
                "tree id {id:?} is not supported, expected OcTree, OcTreeStamped or ColorOcTree"
            ),
        )
    }
}

/// What the binary files of OctoMap before 1.4 begin with, in the place of a text: the kind of the
/// tree.
pub(crate) const LEGACY_MAGIC: [u8; 4] = [3, 0, 0, 0];

/// Reads that header: kind, resolution (f64), number of nodes (u32).
pub(crate) fn read_legacy(input: &mut impl Read, format: &'static str) -> Result<Header, MapError> {
    let kind = read_array::<4>(input, format)?;
    if kind != LEGACY_MAGIC {
        return Err(MapError::NotAMap);
    }
    let resolution = f64::from_le_bytes(read_array(input, format)?);
    let size = u32::from_le_bytes(read_array(input, format)?);
    let header = Header {
        id: OCTREE.to_owned(),
        size: size.into(),
        resolution,
    };
    header.checked(format)
}

fn read_line(
    input: &mut impl Read,
    format: &'static str,
    budget: &mut usize,
) -> Result<String, MapError> {
    let mut line = Vec::new();
    loop {
        let [byte] = read_array::<1>(input, format)?;
        if byte == b'\n' {
            return Ok(String::from_utf8_lossy(&line).into_owned());
        }
        if *budget == 0 {
            return Err(MapError::format(format, "the header has no line \"data\""));
        }
        *budget -= 1;
        line.push(byte);
    }
}

/// Exactly `N` bytes; a short file is a format error, not an I/O error.
pub(crate) fn read_array<const N: usize>(
    input: &mut impl Read,
    format: &'static str,
) -> Result<[u8; N], MapError> {
    let mut bytes = [0; N];
    let cut = || MapError::format(format, "the file ends in the middle of the tree");
    let read = input.read_exact(&mut bytes);
    read.map_err(|error| read_error(error, cut))?;
    Ok(bytes)
}

/// An empty map with OctoMap's clamps for a file of the given resolution.
pub(crate) fn empty_map(
    resolution: f64,
    memory_budget_bytes: usize,
) -> Result<OccupancyMap, MapError> {
    let (clamp_min, clamp_max) = octomap_clamps();
    let mut map = OccupancyMap::new(MapConfig {
        resolution,
        clamp_min,
        clamp_max,
        memory_budget_bytes,
        ..MapConfig::default()
    })?;
    // All that is read has changed since revision 0.
    map.revision = 1;
    Ok(map)
}

/// A node of a tree that is being read: its first cell and its depth.
#[derive(Clone, Copy)]
pub(crate) struct Cube {
    pub first: VoxelKey,
    pub depth: u32,
}

impl Cube {
    pub(crate) const ROOT: Self = Self {
        first: VoxelKey::new(-32768, -32768, -32768),
        depth: 0,
    };

    pub(crate) fn edge_cells(self) -> i32 {
        1 << (TREE_DEPTH - self.depth)
    }

    pub(crate) fn child(self, octant: i32) -> Self {
        Self {
            first: self.first.of_octant(octant, self.edge_cells() / 2),
            depth: self.depth + 1,
        }
    }

    /// Writes a leaf into the map. Of free space that no map has room for, only that it was there.
    pub(crate) fn fill(self, map: &mut OccupancyMap, log_odds: f32) -> Result<(), MapError> {
        let value = evidence_from_log_odds(f64::from(log_odds));
        let edge = self.edge_cells();
        if edge >= ENDLESS_CELLS && log_odds < 0.0 {
            map.endless_free += 1;
            return Ok(());
        }
        if edge < BRICK_EDGE {
            return map.fill_cells(self.first, edge, value);
        }
        let bricks = (edge / BRICK_EDGE) as usize;
        map.check_budget(bricks.pow(3), 0)?;
        let last = self.first.moved([edge - 1; 3]);
        for key in self.first.brick().to(last.brick()) {
            map.set_brick_uniform(key, value);
        }
        Ok(())
    }
}
