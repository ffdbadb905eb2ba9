//! Reading and writing map files.

use crate::output::{MAP, OutputFile, map_at};
use crate::process::failure::{Classify, Failure};
use monogrid_datasets::open_file;
use monogrid_occupancy::{BRICK_CELLS, MapError, MapFormat, OccupancyMap, read_map};
use std::io::BufReader;
use std::path::Path;

/// Writes a map; its size in bytes.
pub fn save(map: &OccupancyMap, file: &OutputFile, format: MapFormat) -> Result<u64, Failure> {
    file.write_with(|mut out| Ok(format.write(map, &mut out)?))?;
    Ok(std::fs::metadata(file.path()).map_or(0, |metadata| metadata.len()))
}

/// Blocks of 8x8x8 cells that any map file may describe: fifteen hundred cubic metres of cells of 5
/// cm. What commands do with a map takes memory and time for each, and a few bytes can describe
/// billions.
const SMALL_FILE_BRICKS: u64 = 3 << 13;

/// Bytes of a small file, and bytes of a larger one for each block more. Those at surfaces take
/// more of them, those of free space hardly any.
const SMALL_FILE_BYTES: u64 = 1 << 20;
const BYTES_PER_BRICK: u64 = 8;

/// Set in the environment by who trusts a map that is large for its file.
const LARGE_MAPS: &str = "MONOGRID_LARGE_MAPS";

/// Reads an `.ot`, `.bt` or `.mgo` by its first bytes, whatever its name, or the map of a run.
pub fn load(path: &Path) -> Result<(OccupancyMap, MapFormat), Failure> {
    let path = &map_at(path);
    if path.is_dir() {
        return Err(Failure::input(format!(
            "{} holds no {MAP}: expected a map, or the folder of a run that came to one",
            path.display()
        )));
    }
    let (file, bytes) = open_file(path).bad_input()?;
    let is_trusted = is_trusted();
    // what a file may ask for grows with its length
    let length = if is_trusted { u64::MAX } else { bytes };
    let read = read_map(BufReader::new(file), length).map_err(|error| {
        let context = match error {
            MapError::MemoryBudget { .. } => {
                format!("map {}: {}", path.display(), too_large(bytes))
            }
            _ => format!("map {}", path.display()),
        };
        Failure::Input(anyhow::Error::from(error).context(context))
    })?;
    let endless = read.0.endless_free();
    if endless > 0 {
        eprintln!(
            "warning: map {}: {endless} cubes of free space of 2048 cells and more along an edge \
             are left out: they are unknown here",
            path.display()
        );
    }
    let bricks = read.0.brick_counts().1 as u64;
    if !is_trusted && bricks > max_bricks(bytes) {
        return Err(Failure::input(format!(
            "map {}: it has {} cells; {}",
            path.display(),
            bricks * BRICK_CELLS as u64,
            too_large(bytes)
        )));
    }
    Ok(read)
}

/// The most that a command may spend on map files of so many bytes: `small` on small ones,
/// `per_byte` more for each byte of larger ones. Anything where the user trusts them.
#[must_use]
pub fn allowance(file_bytes: u64, small: u64, per_byte: u64) -> u64 {
    if is_trusted() {
        return u64::MAX;
    }
    let more = file_bytes.saturating_sub(SMALL_FILE_BYTES);
    small.saturating_add(more.saturating_mul(per_byte))
}

fn is_trusted() -> bool {
    std::env::var_os(LARGE_MAPS).is_some()
}

fn max_bricks(file_bytes: u64) -> u64 {
    SMALL_FILE_BRICKS + file_bytes.saturating_sub(SMALL_FILE_BYTES) / BYTES_PER_BRICK
}

fn too_large(file_bytes: u64) -> String {
    format!(
        "a file of {file_bytes} bytes may describe {} cells; set {LARGE_MAPS}=1 in the environment \
         if you trust it and have the memory",
        max_bricks(file_bytes) * BRICK_CELLS as u64
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_occupancy::{MapConfig, VoxelKey};

    /// A binary tree of OctoMap: inner nodes with one child, below them full ones, and below those
    /// occupied and free leaves.
    fn tree(single: usize, depth: u32) -> Vec<u8> {
        fn node(depth: u32, out: &mut Vec<u8>) {
            if depth == 0 {
                out.extend([0x66, 0x66]);
                return;
            }
            out.extend([0xff, 0xff]);
            (0..8).for_each(|_| node(depth - 1, out));
        }
        let mut out = b"# Octomap OcTree binary file\nid OcTree\nsize 1\nres 0.05\ndata\n".to_vec();
        out.extend([3, 0].repeat(single));
        node(depth, &mut out);
        out
    }

    #[test]
    fn a_small_file_of_a_huge_map_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bomb.bt");
        // eighths of all space, which would not fit into memory, and cubes of 16 cells, which would
        for (single, depth) in [(0, 0), (7, 4)] {
            std::fs::write(&path, tree(single, depth)).unwrap();
            let Err(Failure::Input(error)) = load(&path) else {
                panic!("{single}, {depth}: it was read");
            };
            let error = format!("{error:#}");
            assert!(error.contains("may describe 12582912 cells"), "{error}");
            assert!(error.contains("MONOGRID_LARGE_MAPS=1"), "{error}");
        }
    }

    #[test]
    fn the_folder_of_a_run_is_its_map() {
        let folder = tempfile::tempdir().unwrap();
        let Err(Failure::Input(error)) = load(folder.path()) else {
            panic!("an empty folder was read");
        };
        assert!(error.to_string().contains("holds no global.ot"), "{error}");
        let mut map = OccupancyMap::new(MapConfig::with_resolution(0.25)).unwrap();
        map.set_log_odds(VoxelKey::new(1, 2, 3), Some(2.0)).unwrap();
        let mut bytes = Vec::new();
        MapFormat::Ot.write(&map, &mut bytes).unwrap();
        std::fs::write(folder.path().join(MAP), bytes).unwrap();
        let (map, _) = load(folder.path()).unwrap();
        assert_eq!((map.resolution(), map.leaf_count()), (0.25, 1));
    }

    #[test]
    fn what_a_file_may_describe_grows_with_it() {
        assert_eq!(max_bricks(20), max_bricks(1 << 20));
        assert_eq!(max_bricks(9 << 20), max_bricks(20) + (1 << 20));
    }
}
