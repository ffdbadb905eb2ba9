//! Tools on maps: `crop`, `merge`, `transform`, `diff`, `project`.

use super::print_json;
use crate::cli::{JsonArg, positive};
use crate::failure::{Classify, CommandResult, Failure, Outcome};
use crate::gridmap;
use crate::mapfile::{self, MapFormat};
use crate::output::write_atomically;
use clap::Args;
use monogrid_datasets::read_sim3;
use monogrid_geometry::{Sim3, Vec3};
use monogrid_occupancy::{MapConfig, MapError, Occupancy, OccupancyMap, VoxelKey};
use serde::Serialize;
use std::io::Write;
use std::path::{Path, PathBuf};

/// `monogrid crop`.
#[derive(Debug, Args)]
pub struct CropArgs {
    /// Map to read (.ot or .bt)
    pub input: PathBuf,
    /// Map to write (.ot or .bt)
    pub output: PathBuf,
    /// Lower corner of the box that is kept
    #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true)]
    pub min: [f64; 3],
    /// Upper corner of the box that is kept
    #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true)]
    pub max: [f64; 3],
    #[command(flatten)]
    pub json: JsonArg,
}

/// `monogrid merge`.
#[derive(Debug, Args)]
pub struct MergeArgs {
    /// Map to read (.ot or .bt)
    pub first: PathBuf,
    /// Map to add, of the same resolution and frame
    pub second: PathBuf,
    /// Map to write (.ot or .bt)
    #[arg(long, value_name = "MAP.{ot,bt}")]
    pub out: PathBuf,
    #[command(flatten)]
    pub json: JsonArg,
}

/// `monogrid transform`.
#[derive(Debug, Args)]
pub struct TransformArgs {
    /// Map to read (.ot or .bt)
    pub input: PathBuf,
    /// Map to write (.ot or .bt)
    pub output: PathBuf,
    /// Sim(3) file, target_from_source: scale tx ty tz qx qy qz qw
    #[arg(long, value_name = "FILE")]
    pub sim3: PathBuf,
    /// Edge of the cells that are written [default: that of the input, scaled]
    #[arg(long, value_name = "L", value_parser = positive)]
    pub resolution: Option<f64>,
    #[command(flatten)]
    pub json: JsonArg,
}

/// `monogrid diff`.
#[derive(Debug, Args)]
pub struct DiffArgs {
    /// Map before (.ot or .bt)
    pub before: PathBuf,
    /// Map after, of the same resolution and frame
    pub after: PathBuf,
    #[command(flatten)]
    pub json: JsonArg,
}

/// `monogrid project`.
#[derive(Debug, Args)]
pub struct ProjectArgs {
    /// Map to read (.ot or .bt)
    pub map: PathBuf,
    /// Image to write (.pgm); its description is written beside it (.yaml)
    pub output: PathBuf,
    /// Cells whose centres are lower are left out
    #[arg(long, value_name = "Z", allow_negative_numbers = true, default_value_t = f64::NEG_INFINITY, hide_default_value = true)]
    pub min_height: f64,
    /// Cells whose centres are higher are left out
    #[arg(long, value_name = "Z", allow_negative_numbers = true, default_value_t = f64::INFINITY, hide_default_value = true)]
    pub max_height: f64,
    #[command(flatten)]
    pub json: JsonArg,
}

fn point(text: &str) -> Result<[f64; 3], String> {
    let numbers: Option<Vec<f64>> = text
        .split(',')
        .map(|part| part.trim().parse().ok().filter(|v: &f64| v.is_finite()))
        .collect();
    numbers
        .and_then(|numbers| <[f64; 3]>::try_from(numbers).ok())
        .ok_or_else(|| "expected three numbers, e.g. -1,0,2.5".to_owned())
}

/// What was written, for people and programs.
fn report_written(map: &OccupancyMap, path: &Path, json: JsonArg) -> CommandResult {
    let counts = mapfile::count_cells(map).while_running("the cells cannot be counted")?;
    if json.json {
        print_json(&serde_json::json!({
            "resolution": map.resolution(),
            "leaves": map.leaf_count(),
            "cells_occupied": counts.occupied,
            "cells_free": counts.free,
        }))?;
    } else {
        println!(
            "{}: {} occupied and {} free cells of {}",
            path.display(),
            counts.occupied,
            counts.free,
            map.resolution()
        );
    }
    Ok(Outcome::Done)
}

const WRITTEN: [MapFormat; 2] = [MapFormat::Ot, MapFormat::Bt];

/// Keeps the cells that touch a box.
pub fn crop(args: &CropArgs) -> CommandResult {
    let format = MapFormat::from_name(&args.output, &WRITTEN)?;
    if (0..3).any(|axis| args.min[axis] >= args.max[axis]) {
        return Err(Failure::input(format!(
            "--min {:?} is not below --max {:?} in every direction",
            args.min, args.max
        )));
    }
    let (map, _) = mapfile::load(&args.input)?;
    let kept = cropped(&map, args.min, args.max).while_running("the map cannot be cropped")?;
    mapfile::save(&kept, &args.output, format)?;
    report_written(&kept, &args.output, args.json)
}

fn cropped(map: &OccupancyMap, low: [f64; 3], high: [f64; 3]) -> Result<OccupancyMap, MapError> {
    let mut kept = OccupancyMap::new(map.config().clone())?;
    for cell in map.cells_in_box(low, high) {
        kept.set_log_odds(cell.key, Some(cell.log_odds))?;
    }
    Ok(kept)
}

/// Adds the log-odds of two maps, as if both had been measured into one.
pub fn merge(args: &MergeArgs) -> CommandResult {
    let format = MapFormat::from_name(&args.out, &WRITTEN)?;
    let (mut map, _) = mapfile::load(&args.first)?;
    let (other, _) = mapfile::load(&args.second)?;
    check_same_resolution(&map, &other, [&args.first, &args.second])?;
    for cell in other.cells() {
        map.add_log_odds(cell.key, cell.log_odds)
            .while_running("the maps cannot be merged")?;
    }
    mapfile::save(&map, &args.out, format)?;
    report_written(&map, &args.out, args.json)
}

fn check_same_resolution(
    a: &OccupancyMap,
    b: &OccupancyMap,
    paths: [&PathBuf; 2],
) -> Result<(), Failure> {
    if (a.resolution() / b.resolution() - 1.0).abs() < 1e-6 {
        return Ok(());
    }
    Err(Failure::input(format!(
        "{} has cells of {}, {} of {}, expected the same",
        paths[0].display(),
        a.resolution(),
        paths[1].display(),
        b.resolution()
    )))
}

/// Moves a map; a map built with `--align` is better than one that was resampled.
pub fn transform(args: &TransformArgs) -> CommandResult {
    let format = MapFormat::from_name(&args.output, &WRITTEN)?;
    let (map, _) = mapfile::load(&args.input)?;
    let target_from_source = read_sim3(&args.sim3).bad_input()?;
    let resolution = args
        .resolution
        .unwrap_or(map.resolution() * target_from_source.scale);
    let moved = moved(&map, &target_from_source, resolution)
        .while_running("the map cannot be transformed")?;
    mapfile::save(&moved, &args.output, format)?;
    report_written(&moved, &args.output, args.json)
}

/// Every cell of the target takes the log-odds of the source cell that holds its centre.
///
/// Going back from the target leaves no holes. Candidates are the target cells around each known
/// source cell, as far as the corners of that cell reach.
pub fn moved(
    map: &OccupancyMap,
    target_from_source: &Sim3,
    resolution: f64,
) -> Result<OccupancyMap, MapError> {
    let source_from_target = target_from_source.inverse();
    let mut target = OccupancyMap::new(MapConfig {
        resolution,
        ..map.config().clone()
    })?;
    let half_diagonal = 0.5 * 3.0_f64.sqrt() * map.resolution() * target_from_source.scale;
    for cell in map.cells() {
        let center = *target_from_source * Vec3::from(cell.key.center(map.resolution()));
        let corner = |offset: f64| {
            let point = center.add_scalar(offset);
            VoxelKey::from_point(point.into(), 1.0 / resolution)
        };
        let (Some(first), Some(last)) = (corner(-half_diagonal), corner(half_diagonal)) else {
            continue;
        };
        for z in first.z..=last.z {
            for y in first.y..=last.y {
                for x in first.x..=last.x {
                    let key = VoxelKey::new(x, y, z);
                    let in_source = source_from_target * Vec3::from(key.center(resolution));
                    if map.key(in_source.into()) == Some(cell.key) {
                        target.set_log_odds(key, Some(cell.log_odds))?;
                    }
                }
            }
        }
    }
    Ok(target)
}

/// `diff --json`: cells by their state before and after.
#[derive(Debug, Default, Serialize, PartialEq)]
struct Difference {
    same: u64,
    free_to_occupied: u64,
    occupied_to_free: u64,
    only_before: u64,
    only_after: u64,
    /// Over the cells that both maps know.
    mean_log_odds_difference: f64,
}

/// Counts the cells whose state differs.
pub fn diff(args: &DiffArgs) -> CommandResult {
    let (before, _) = mapfile::load(&args.before)?;
    let (after, _) = mapfile::load(&args.after)?;
    check_same_resolution(&before, &after, [&args.before, &args.after])?;
    let difference = difference(&before, &after);
    if args.json.json {
        print_json(&difference)?;
        return Ok(Outcome::Done);
    }
    println!("{:>12} cells in the same state", difference.same);
    println!("{:>12} from free to occupied", difference.free_to_occupied);
    println!("{:>12} from occupied to free", difference.occupied_to_free);
    println!(
        "{:>12} known only in {}",
        difference.only_before,
        args.before.display()
    );
    println!(
        "{:>12} known only in {}",
        difference.only_after,
        args.after.display()
    );
    println!(
        "log-odds differ by {:.4} on average",
        difference.mean_log_odds_difference
    );
    Ok(Outcome::Done)
}

fn difference(before: &OccupancyMap, after: &OccupancyMap) -> Difference {
    let mut result = Difference::default();
    let (mut sum, mut both) = (0.0, 0_u64);
    for cell in before.cells() {
        let Some(log_odds) = after.log_odds_of(cell.key) else {
            result.only_before += 1;
            continue;
        };
        both += 1;
        sum += f64::from((log_odds - cell.log_odds).abs());
        match (cell.state, after.state_of(cell.key)) {
            (Occupancy::Free, Occupancy::Occupied) => result.free_to_occupied += 1,
            (Occupancy::Occupied, Occupancy::Free) => result.occupied_to_free += 1,
            _ => result.same += 1,
        }
    }
    let is_new = |key| before.log_odds_of(key).is_none();
    result.only_after = after.cells().filter(|cell| is_new(cell.key)).count() as u64;
    result.mean_log_odds_difference = sum / both.max(1) as f64;
    result
}

/// Writes the map seen from above, for nav2's map server.
pub fn project(args: &ProjectArgs) -> CommandResult {
    let is_pgm = args.output.extension().is_some_and(|e| e == "pgm");
    let (Some(name), true) = (args.output.file_name(), is_pgm) else {
        return Err(Failure::input(format!(
            "cannot write {}: expected a name that ends in .pgm",
            args.output.display()
        )));
    };
    let (map, _) = mapfile::load(&args.map)?;
    let heights = [args.min_height, args.max_height];
    let Some(grid) =
        gridmap::project(&map, heights).while_running("the map cannot be projected")?
    else {
        return Err(Failure::input(format!(
            "{} has no known cells between the heights {} and {}",
            args.map.display(),
            args.min_height,
            args.max_height
        )));
    };
    let yaml = args.output.with_extension("yaml");
    write_atomically(&args.output, |out| out.write_all(&grid.to_pgm()))?;
    write_atomically(&yaml, |out| {
        out.write_all(grid.to_yaml(&name.to_string_lossy()).as_bytes())
    })?;
    if args.json.json {
        print_json(&serde_json::json!({
            "width": grid.width,
            "height": grid.height,
            "resolution": grid.resolution,
            "origin": grid.origin,
        }))?;
    } else {
        println!(
            "{} and {}: {} x {} cells of {}",
            args.output.display(),
            yaml.display(),
            grid.width,
            grid.height,
            grid.resolution
        );
    }
    Ok(Outcome::Done)
}
