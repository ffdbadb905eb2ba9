//! Maps and pictures of them as files.

use crate::output::OutputFolder;
use crate::process::failure::{Classify, Failure};
use crate::run::outputs::Paths;
use crate::run::summary::unit_name;
use monogrid_datasets::encode_png_rgb;
use monogrid_mapping::{Maps, MeshConfig, navigation_band};
use monogrid_occupancy::{MapFormat, OccupancyMap, Projection, VoxelKey, write_ply};
use monogrid_report::colours::Colours;
use monogrid_report::explorer::PagePlan;
use monogrid_report::picture::colour::quantile;
use monogrid_report::picture::plan::Plan;
use monogrid_report::picture::voxels::{
    Cube, View, dollhouse_cut, occupied_cubes, render, render_surface,
};
use monogrid_report::surface::{CellColours, ColouredMesh, MeshFormat, SurfaceView, Texture};

/// Pictures of the final maps, as PNG files.
#[derive(Debug)]
pub struct MapPictures {
    /// View of the global map.
    pub preview: Vec<u8>,
    /// The map before and after loops were closed, where there were loops.
    pub loops: Option<[Vec<u8>; 2]>,
    /// Height above which cells hide the room.
    pub cut: Option<f64>,
    /// Surface of the global map, where it was asked for.
    pub mesh: Option<ColouredMesh>,
    /// The map from above.
    pub plan: Option<PagePlan>,
}

/// Writes the maps in all formats, and pictures of them; those of what loops corrected where the
/// path before the corrections is given.
pub fn write_maps(
    folder: &OutputFolder,
    maps: &Maps,
    Paths { path, reported }: &Paths,
    ground: Ground,
    surface: Surface,
) -> Result<MapPictures, Failure> {
    let (written, large) = rayon::join(
        || write_global(folder, [&maps.global, &maps.local], path, ground, surface),
        || write_map(folder, "large.ot", &maps.large, MapFormat::Ot),
    );
    let (cubes, mut pictures) = written?;
    large?;
    if let Some(reported) = reported {
        let large = occupied_cubes(&maps.large).while_running("the maps cannot be drawn")?;
        pictures.loops = Some(write_loop_pictures(
            folder,
            (&large, reported),
            (&cubes, path),
        )?);
    }
    Ok(pictures)
}

/// Writes a map as a file of that name.
fn write_map(
    folder: &OutputFolder,
    name: &str,
    map: &OccupancyMap,
    format: MapFormat,
) -> Result<(), Failure> {
    folder.write_with(name, |mut out| Ok(format.write(map, &mut out)?))
}

/// How surfaces are written.
#[derive(Clone, Copy, Debug)]
pub struct Surface<'a> {
    /// Colours of the cells of the global map.
    pub colours: &'a CellColours,
    /// Settings.
    pub config: &'a MeshConfig,
    /// The keyframes that see it,
    pub views: &'a [SurfaceView<'a>],
    /// and their images in colour.
    pub images: &'a Colours,
}

/// Writes the global map and its part around the camera, its cells as points, its surface, it from
/// above, and a picture; its occupied cells, and pictures without those of loops.
pub fn write_global(
    folder: &OutputFolder,
    [global, local]: [&OccupancyMap; 2],
    path: &[[f64; 3]],
    ground: Ground,
    surface: Surface,
) -> Result<(Vec<Cube>, MapPictures), Failure> {
    let draw = || {
        let cubes = occupied_cubes(global).while_running("the map cannot be projected")?;
        let plan = write_grid(folder, global, &cubes, path, ground)?;
        let cut = dollhouse_cut(&cubes, path);
        Ok::<_, Failure>((cubes, cut, plan))
    };
    let rest = || {
        rayon::join(
            || write_mesh(folder, global, ground, surface),
            || write_cells(folder, [global, local], surface.colours),
        )
    };
    let (drawn, (mesh, written)) = rayon::join(draw, rest);
    written?;
    let ((cubes, cut, plan), mesh) = (drawn?, mesh?);
    // nobody waits for a picture of the surface where nobody waits for one on it
    let is_waited_for = !surface.views.is_empty();
    let shown = mesh.as_ref();
    let shown = shown.filter(|mesh| is_waited_for && !mesh.colours.is_empty());
    let seen = shown.and_then(|mesh| {
        render_surface(&mesh.surface, |t, shares| mesh.colour_at(t, shares), path)
    });
    let preview = seen.unwrap_or_else(|| render(&cubes, path, cut, &View::default()));
    let preview = encode_png_rgb(&preview);
    folder.write("preview.png", &preview)?;
    let pictures = MapPictures {
        preview,
        loops: None,
        cut,
        mesh,
        plan,
    };
    Ok((cubes, pictures))
}

/// Writes the cells of the global map and of its part around the camera.
fn write_cells(
    folder: &OutputFolder,
    [global, local]: [&OccupancyMap; 2],
    colours: &CellColours,
) -> Result<(), Failure> {
    write_map(folder, "global.ot", global, MapFormat::Ot)?;
    write_map(folder, "global.bt", global, MapFormat::Bt)?;
    write_map(folder, "local.ot", local, MapFormat::Ot)?;
    let colour = |key| colours.of(key);
    let colour = (colours.has_colour).then_some(&colour as &dyn Fn(VoxelKey) -> [u8; 3]);
    folder.write_with("cells.ply", |mut out| {
        Ok(write_ply(global, colour, &mut out)?)
    })
}

/// The surface of the map as PLY and glTF, where it is asked for and there is memory for it.
fn write_mesh(
    folder: &OutputFolder,
    map: &OccupancyMap,
    ground: Ground,
    surface: Surface,
) -> Result<Option<ColouredMesh>, Failure> {
    if !surface.config.enabled {
        return Ok(None);
    }
    let mut mesh = match surface.colours.mesh(map, surface.config) {
        Ok(mesh) => mesh,
        Err(error) => {
            eprintln!("warning: there is no mesh: {error}");
            return Ok(None);
        }
    };
    mesh.texture = Texture::new(&mesh, surface.views, surface.images);
    let unit = unit_name(ground.is_metric);
    for (name, format) in [("mesh.ply", MeshFormat::Ply), ("mesh.glb", MeshFormat::Glb)] {
        folder.write_with(name, |out| Ok(format.write(&mesh, (unit, "mesh"), out)?))?;
    }
    Ok(Some(mesh))
}

/// The map and the path before and after loops were closed, from above: every keyframe where it was
/// when it was finished, and where the graph has it in the end. The same piece of the world in
/// both.
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

/// What is known of the ground that a robot would drive on.
#[derive(Clone, Copy, Debug)]
pub struct Ground {
    /// Whether the floor was found: it is at z = 0 then.
    pub has_floor: bool,
    /// Whether a level surface is at z = 0 that is no floor.
    pub has_level_surface: bool,
    /// Whether up is certain: else there is no floor.
    pub is_up_certain: bool,
    /// Lowest and highest camera of all runs that made the map.
    pub cameras: [f64; 2],
    /// Whether lengths are metres.
    pub is_metric: bool,
}

/// The lowest and the highest of these places.
pub fn lowest_and_highest<'a>(places: impl Iterator<Item = &'a [f64; 3]>) -> [f64; 2] {
    let first = [f64::INFINITY, f64::NEG_INFINITY];
    places.fold(first, |[low, high], place| {
        [low.min(place[2]), high.max(place[2])]
    })
}

/// Writes the map seen from above for robots and for people.
fn write_grid(
    folder: &OutputFolder,
    map: &OccupancyMap,
    cubes: &[Cube],
    path: &[[f64; 3]],
    ground: Ground,
) -> Result<Option<PagePlan>, Failure> {
    let heights = cubes.iter().map(|cube| cube.center[2]);
    let Some((grid, band)) = seen_from_above(map, heights, ground) else {
        return Ok(None);
    };
    folder.write("map.pgm", grid.to_pgm())?;
    let note = grid_note(band, ground);
    folder.write("map.yaml", grid.to_yaml("map.pgm") + &note)?;
    let plan = Plan {
        grid: &grid,
        path,
        is_metric: ground.is_metric,
    };
    folder.write("plan.png", plan.png())?;
    folder.write("plan.svg", plan.svg())?;
    folder.write("plan.dxf", plan.dxf())?;
    Ok(Some(PagePlan::new(&plan, band)))
}

/// The map seen from above, of the heights that matter, and these; `heights` are those of its
/// occupied cells. `None` where nothing of them is known, or the map is too large for it, which is
/// said.
pub fn seen_from_above(
    map: &OccupancyMap,
    heights: impl Iterator<Item = f64>,
    ground: Ground,
) -> Option<(Projection, [f64; 2])> {
    let mut occupied: Vec<f64> = heights.collect();
    // none where nothing has a pose
    let cameras = ground.cameras.into_iter().filter(|z| z.is_finite());
    let cameras: Vec<f64> = cameras.collect();
    let band = navigation_band(&mut occupied, &cameras, ground.has_floor);
    match map.projected(band[0], band[1]) {
        Ok(grid) => grid.map(|grid| (grid, band)),
        Err(error) => {
            eprintln!("warning: there is no map.pgm: {error}");
            None
        }
    }
}

/// Comment of a grid whose lengths are not metres.
pub const UNKNOWN_SCALE_WARNING: &str = "# WARNING: the scale is unknown: resolution and origin \
    are map units, not metres as nav2 takes them\n";

/// What the description of the grid says to people, as comments.
fn grid_note([low, high]: [f64; 2], ground: Ground) -> String {
    let over = match (ground.has_floor, ground.has_level_surface) {
        (true, _) => "over the floor",
        _ if !ground.is_up_certain => "(up is uncertain: no floor is claimed, cells may be tilted)",
        (false, true) => {
            "(no floor was found: z = 0 is the largest level surface, perhaps a table)"
        }
        (false, false) => "(no floor was found)",
    };
    let unit = if ground.is_metric { "m" } else { "map units" };
    let mut note = format!("# cells from z = {low:.3} to {high:.3} {unit} {over}\n");
    if !ground.is_metric {
        note += UNKNOWN_SCALE_WARNING;
    }
    note
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_occupancy::MapConfig;

    #[test]
    fn the_band_is_that_of_the_cameras_of_all_runs() {
        let (earlier, path) = ([[0.0, 0.0, 2.0]], [[0.0, 0.0, 1.0], [0.0, 0.0, 0.5]]);
        let cameras = lowest_and_highest(earlier.iter().chain(&path));
        assert_eq!(cameras, [0.5, 2.0]);
        let ground = Ground {
            has_floor: true,
            has_level_surface: false,
            is_up_certain: true,
            cameras,
            is_metric: true,
        };
        let mut map = OccupancyMap::new(MapConfig::with_resolution(0.1)).unwrap();
        let key = VoxelKey::new(1, 2, 10);
        map.set_log_odds(key, Some(2.0)).unwrap();
        let (_, band) = seen_from_above(&map, std::iter::empty(), ground).unwrap();
        assert!((band[0] - 0.2).abs() < 1e-12 && (band[1] - 2.2).abs() < 1e-12);
    }

    #[test]
    fn a_grid_of_unknown_scale_warns_whoever_reads_it() {
        let unknown = Ground {
            has_floor: false,
            has_level_surface: false,
            is_up_certain: true,
            cameras: [0.1, 1.0],
            is_metric: false,
        };
        assert!(grid_note([0.1, 1.0], unknown).contains("WARNING"));
        let metric = Ground {
            has_floor: true,
            is_metric: true,
            ..unknown
        };
        let note = grid_note([0.1, 1.0], metric);
        assert!(!note.contains("WARNING") && note.contains("over the floor"));
        let over_table = Ground {
            has_level_surface: true,
            ..unknown
        };
        assert!(grid_note([0.1, 1.0], over_table).contains("table"));
        let tilted = Ground {
            is_up_certain: false,
            ..over_table
        };
        assert!(grid_note([0.1, 1.0], tilted).contains("up is uncertain"));
        // all of it is comments for a reader of YAML
        assert!(
            grid_note([0.1, 1.0], unknown)
                .lines()
                .all(|line| line.starts_with('#'))
        );
    }
}
