//! Maps and pictures of them as files.

use crate::failure::{Classify, Failure};
use crate::mapfile::{self, MapFormat};
use crate::output::OutputFolder;
use crate::picture::colour::quantile;
use crate::picture::voxels::{Cube, View, dollhouse_cut, occupied_cubes, render};
use monogrid_datasets::encode_png_rgb;
use monogrid_occupancy::OccupancyMap;
use monogrid_slam::mapping::Maps;

/// Pictures of the final maps, as PNG files.
#[derive(Debug)]
pub struct MapPictures {
    /// View of the global map.
    pub preview: Vec<u8>,
    /// The map before and after loops were closed, where there were loops.
    pub loops: Option<[Vec<u8>; 2]>,
    /// Height above which cells hide the room.
    pub cut: Option<f64>,
}

/// Writes the maps in all formats, and pictures of them; those of what loops corrected where `reported_path`,
/// the path before the corrections, is given.
pub fn write_maps(
    folder: &OutputFolder,
    maps: &Maps,
    path: &[[f64; 3]],
    reported_path: Option<&[[f64; 3]]>,
    unit: &str,
) -> Result<MapPictures, Failure> {
    for (name, map, format) in [
        ("global.ot", &maps.global, MapFormat::Ot),
        ("global.bt", &maps.global, MapFormat::Bt),
        ("local.ot", &maps.local, MapFormat::Ot),
        ("large.ot", &maps.large, MapFormat::Ot),
        ("cells.ply", &maps.global, MapFormat::Ply),
    ] {
        folder.write_with(name, |out| mapfile::write(map, out, format))?;
    }
    let cubes = occupied_cubes(&maps.global).while_running("the map cannot be projected")?;
    write_grid(folder, &maps.global, &cubes, path, unit)?;
    let cut = dollhouse_cut(&cubes, path);
    let preview = write_preview(folder, &cubes, path, cut)?;
    let loops = match reported_path {
        Some(reported_path) => Some(write_loop_pictures(
            folder,
            (
                &occupied_cubes(&maps.large).while_running("the maps cannot be drawn")?,
                reported_path,
            ),
            (&cubes, path),
        )?),
        None => None,
    };
    Ok(MapPictures {
        preview,
        loops,
        cut,
    })
}

fn write_preview(
    folder: &OutputFolder,
    cubes: &[Cube],
    path: &[[f64; 3]],
    cut: Option<f64>,
) -> Result<Vec<u8>, Failure> {
    let picture = render(cubes, path, cut, &View::default());
    let preview = encode_png_rgb(&picture);
    folder.write("preview.png", &preview)?;
    Ok(preview)
}

/// The map and the path before and after loops were closed, from above: every keyframe where it was when it
/// was finished, and where the graph has it in the end. The same piece of the world in both.
fn write_loop_pictures(
    folder: &OutputFolder,
    before: (&[Cube], &[[f64; 3]]),
    after: (&[Cube], &[[f64; 3]]),
) -> Result<[Vec<u8>; 2], Failure> {
    let cut = dollhouse_cut(after.0, after.1);
    let view = View {
        elevation: std::f64::consts::FRAC_PI_2,
        frame: extent(after.0),
        ..View::default()
    };
    let drawn = |(cubes, path)| encode_png_rgb(&render(cubes, path, cut, &view));
    let (before, after) = (drawn(before), drawn(after));
    folder.write("loops_before.png", &before)?;
    folder.write("loops_after.png", &after)?;
    Ok([before, after])
}

/// Box of what is there, but for a few cells far away, with some room around it.
fn extent(cubes: &[Cube]) -> Option<[[f64; 3]; 2]> {
    if cubes.is_empty() {
        return None;
    }
    let ranges = [0, 1, 2].map(|axis| {
        let mut values: Vec<f64> = cubes.iter().map(|cube| cube.center[axis]).collect();
        let low = quantile(&mut values, 0.005);
        let high = quantile(&mut values, 0.995);
        let room = 0.05 * (high - low);
        [low - room, high + room]
    });
    Some([0, 1].map(|end| ranges.map(|range| range[end])))
}

/// Heights that matter to what moves where the camera moved: from somewhat above the floor (where
/// there is one below the camera) to somewhat above the camera.
fn navigation_band(cubes: &[Cube], path: &[[f64; 3]]) -> [f64; 2] {
    let heights = || path.iter().map(|p| p[2]);
    let highest = heights().fold(f64::NEG_INFINITY, f64::max);
    let lowest = heights().fold(f64::INFINITY, f64::min);
    let mut occupied: Vec<f64> = cubes.iter().map(|cube| cube.center[2]).collect();
    let floor = quantile(&mut occupied, 0.02).min(lowest);
    let height = highest - floor;
    [floor + 0.1 * height, highest + 0.1 * height]
}

/// The map seen from above, of the heights that matter.
fn write_grid(
    folder: &OutputFolder,
    map: &OccupancyMap,
    cubes: &[Cube],
    path: &[[f64; 3]],
    unit: &str,
) -> Result<(), Failure> {
    let band = navigation_band(cubes, path);
    if let Some(grid) = map.projected(band[0], band[1]) {
        folder.write("map.pgm", grid.to_pgm())?;
        let note = format!(
            "# cells from z = {:.3} to {:.3}; lengths in {unit}\n",
            band[0], band[1]
        );
        folder.write("map.yaml", grid.to_yaml("map.pgm") + &note)?;
    }
    Ok(())
}
