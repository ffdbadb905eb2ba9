//! The part of `tests/octomap/verify.sh` that is ours: makes a map, copies maps, counts leaves.
//!
//! `octomap_check make DIR` writes `ours.ot`, `ours.bt`, the text list `cells.txt` (centre and
//! log-odds of every known cell) and `expected.txt` (points with what must be found there);
//! `copy IN OUT` reads and writes a map; `leaves MAP` prints the number of its leaves.
#![allow(clippy::print_stdout, reason = "an example program talks to its user")]

use std::error::Error;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

use monogrid_occupancy::*;

fn read(path: &str) -> Result<OccupancyMap, MapError> {
    let file = File::open(path).map_err(|source| MapError::File {
        action: "opening",
        path: path.into(),
        source,
    })?;
    if path.ends_with(".bt") {
        read_bt(file, 4 << 30)
    } else {
        read_ot(file, 4 << 30)
    }
}

/// Three walls at different distances seen from one place off the origin: no symmetry.
fn make_map() -> Result<OccupancyMap, MapError> {
    let mut map = OccupancyMap::new(MapConfig::with_resolution(0.05))?;
    let mut points = Vec::new();
    for i in -40..=40_i16 {
        for j in -30..=30_i16 {
            let ray = [f32::from(i) / 50.0, f32::from(j) / 50.0, 1.0];
            let depth = match (i, j) {
                (..=-10, _) => 1.5,
                (_, ..=0) => 2.0,
                _ => 2.8,
            };
            points.push(ray.map(|c| c * depth));
        }
    }
    let scan = Scan {
        id: 0,
        world_from_sensor: Similarity {
            translation: [0.37, -0.21, -0.6],
            ..Similarity::IDENTITY
        },
        pose_sigma: PoseSigma::default(),
        data: ScanData::Points(PointScan {
            points: &points,
            sigmas: &[0.03],
        }),
    };
    for rule in [IntegrationRule::Rays, IntegrationRule::Fused] {
        let config = IntegrationConfig {
            rule,
            ..IntegrationConfig::default()
        };
        integrate(&mut map, &scan, &config, 2)?;
    }
    Ok(map)
}

fn name(state: Occupancy) -> &'static str {
    match state {
        Occupancy::Unknown => "unknown",
        Occupancy::Free => "free",
        Occupancy::Occupied => "occupied",
    }
}

fn make(folder: &Path) -> Result<(), Box<dyn Error>> {
    let map = make_map()?;
    save_atomically(&folder.join("ours.ot"), |file| write_ot(&map, file))?;
    save_atomically(&folder.join("ours.bt"), |file| write_bt(&map, file))?;
    let mut list = BufWriter::new(File::create(folder.join("cells.txt"))?);
    for cell in map.cells() {
        let [x, y, z] = cell.key.center(map.resolution());
        writeln!(list, "{x} {y} {z} {}", cell.log_odds)?;
    }
    let mut expected = BufWriter::new(File::create(folder.join("expected.txt"))?);
    // What the scene says, not what the map says: each axis has its own answer on each side.
    for (point, state) in [
        ([0.375, -0.225, 0.025], Occupancy::Free),
        ([0.375, -0.225, 1.425], Occupancy::Occupied),
        ([0.375, -0.225, -1.025], Occupancy::Unknown),
        ([-0.325, -0.225, 0.925], Occupancy::Occupied),
        ([1.075, -0.225, 0.925], Occupancy::Free),
        ([0.375, 0.325, 2.225], Occupancy::Occupied),
        ([0.375, -0.625, 2.225], Occupancy::Unknown),
        ([0.375, 0.325, 1.425], Occupancy::Free),
    ] {
        let found = map.state(point);
        if found != state {
            return Err(
                format!("{point:?} is {found:?} in the map, the scene has {state:?}").into(),
            );
        }
        let [x, y, z] = point;
        writeln!(expected, "{x} {y} {z} {}", name(state))?;
    }
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match words[..] {
        ["make", folder] => make(folder.as_ref()),
        ["copy", from, to] => {
            let map = read(from)?;
            Ok(save_atomically(to.as_ref(), |file| write_ot(&map, file))?)
        }
        ["leaves", path] => {
            println!("{}", read(path)?.octree_leaf_count()?);
            Ok(())
        }
        _ => Err("usage: octomap_check make DIR | copy IN OUT | leaves MAP".into()),
    }
}
