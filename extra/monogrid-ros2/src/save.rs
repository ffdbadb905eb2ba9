//! The map in files, in a new folder each time.

use crate::shown::Shown;
use monogrid_app::run::sessions::{MAP_FROM_WORLD, RECORDING};
use monogrid_app::run::tracking::recorder::MapNow;
use monogrid_datasets::{TimedPose, format_sim3, write_tum};
use monogrid_geometry::{Se3, Sim3};
use monogrid_messages::builtin_interfaces::Time;
use monogrid_occupancy::{save_atomically, write_bt, write_ot};
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// Writes `global.ot`, `global.bt`, `map.pgm` with `map.yaml`, and `trajectory.txt`
/// (map_from_camera) into a new folder in `parent`. Nothing that exists is touched. `is_metric`:
/// whether somebody has said how long a unit is.
///
/// # Errors
/// A folder that cannot be made or written to.
pub fn save(
    parent: &Path,
    shown: &Shown,
    path: &[(Time, Se3)],
    is_metric: bool,
) -> anyhow::Result<PathBuf> {
    let folder = new_folder(parent)?;
    save_atomically(&folder.join("global.ot"), |file| write_ot(&shown.map, file))?;
    save_atomically(&folder.join("global.bt"), |file| write_bt(&shown.map, file))?;
    if let Some(grid) = &shown.grid {
        fs::write(folder.join("map.pgm"), grid.to_pgm())?;
        let yaml = grid.to_yaml("map.pgm") + &note(shown.band, is_metric);
        fs::write(folder.join("map.yaml"), yaml)?;
    }
    let poses = path.iter().map(|(stamp, pose)| TimedPose {
        timestamp_ns: stamp.nanoseconds(),
        world_from_camera: *pose,
    });
    write_tum(&folder.join("trajectory.txt"), &poses.collect::<Vec<_>>())?;
    Ok(folder)
}

/// Writes what the service `load` and `monogrid run --continue` go on with: `recording.mgk`, and
/// the frame of the other files.
///
/// # Errors
/// A folder that cannot be written to, or a keyframe that cannot be read back.
pub fn save_to_load(
    folder: &Path,
    map: MapNow,
    map_from_world: &Sim3,
    is_metric: bool,
) -> anyhow::Result<()> {
    let written = map.write(&folder.join(RECORDING));
    written.map_err(|failure| anyhow::Error::from_boxed(failure.into_error()))?;
    fs::write(folder.join(MAP_FROM_WORLD), format_sim3(map_from_world))?;
    let scale = if is_metric { "metric" } else { "arbitrary" };
    let summary = format!("{{\"scale\": \"{scale}\", \"frame\": \"the map of a robot\"}}\n");
    fs::write(folder.join("summary.json"), summary)?;
    Ok(())
}

/// What the description of the grid says to people, as comments.
fn note([low, high]: [f64; 2], is_metric: bool) -> String {
    let heights = format!("# cells from z = {low:.3} to {high:.3}\n");
    if is_metric {
        return heights;
    }
    heights
        + "# WARNING: nobody has said how long a unit is: lengths are not metres (parameter \
            metres_per_unit)\n"
}

/// The first of `monogrid-1`, `monogrid-2`, ... that does not exist.
fn new_folder(parent: &Path) -> std::io::Result<PathBuf> {
    fs::create_dir_all(parent)?;
    let mut number = 1u64;
    loop {
        let folder = parent.join(format!("monogrid-{number}"));
        match fs::create_dir(&folder) {
            Ok(()) => return Ok(folder),
            Err(error) if error.kind() == ErrorKind::AlreadyExists => number += 1,
            Err(error) => return Err(error),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shown::Seen;
    use monogrid_occupancy::{MapConfig, OccupancyMap, VoxelKey, read_ot};

    #[test]
    fn every_save_has_a_folder_of_its_own() {
        let parent = tempfile::tempdir().unwrap();
        let mut map = OccupancyMap::new(MapConfig::with_resolution(0.1)).unwrap();
        map.set_log_odds(VoxelKey::new(1, 2, 0), Some(1.0)).unwrap();
        let path = [(Time { sec: 1, nanosec: 0 }, Se3::identity())];
        let seen = Seen {
            stamp: path[0].0,
            metres_per_unit: 3.0,
            band_over_base: Some([-1.0, 1.0]),
            origin_over_base: 0.0,
            path: &path,
        };
        let shown = Shown::new(&map, &seen).unwrap();
        let first = save(parent.path(), &shown, &path, false).unwrap();
        let second = save(parent.path(), &shown, &path, true).unwrap();
        assert_ne!(first, second);
        let file = fs::File::open(first.join("global.ot")).unwrap();
        assert!((read_ot(file, 1 << 20).unwrap().resolution() - 0.3).abs() < 1e-12);
        let yaml = |folder: &Path| fs::read_to_string(folder.join("map.yaml")).unwrap();
        assert!(yaml(&first).contains("WARNING") && !yaml(&second).contains("WARNING"));
        assert!(yaml(&first).contains("resolution: 0.3"));
        let trajectory = fs::read_to_string(first.join("trajectory.txt")).unwrap();
        assert!(
            trajectory.lines().any(|line| line.starts_with("1.0")),
            "{trajectory}"
        );
        assert!(first.join("global.bt").exists() && first.join("map.pgm").exists());
    }
}
