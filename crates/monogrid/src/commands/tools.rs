//! Tools on maps: `crop`, `merge`, `transform`, `diff`, `project`.

use super::print_json;
use crate::args::{ForceArg, JsonArg, positive};
use crate::failure::{Classify, CommandResult, Failure, Outcome};
use crate::mapfile;
use crate::output::{Inputs, OutputFile};
use crate::run::outputs::UNKNOWN_SCALE_WARNING;
use clap::Args;
use monogrid_datasets::read_sim3;
use monogrid_geometry::Sim3;
use monogrid_occupancy::{MapDifference, MapFormat, OccupancyMap, Similarity};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// `monogrid crop`.
#[derive(Debug, Args)]
pub struct CropArgs {
    /// Map to read (.ot, .bt or .mgo)
    pub input: PathBuf,
    /// Map to write (.ot, .bt or .mgo)
    pub output: PathBuf,
    /// Lower corner of the box that is kept
    #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true)]
    pub min: [f64; 3],
    /// Upper corner of the box that is kept
    #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true)]
    pub max: [f64; 3],
    #[command(flatten)]
    pub force: ForceArg,
    #[command(flatten)]
    pub json: JsonArg,
}

/// `monogrid merge`.
#[derive(Debug, Args)]
pub struct MergeArgs {
    /// Map to read (.ot, .bt or .mgo)
    pub first: PathBuf,
    /// Map to add, of the same resolution and frame
    pub second: PathBuf,
    /// Map to write (.ot, .bt or .mgo)
    #[arg(long, value_name = "MAP.{ot,bt,mgo}")]
    pub out: PathBuf,
    #[command(flatten)]
    pub force: ForceArg,
    #[command(flatten)]
    pub json: JsonArg,
}

/// `monogrid transform`.
#[derive(Debug, Args)]
pub struct TransformArgs {
    /// Map to read (.ot, .bt or .mgo)
    pub input: PathBuf,
    /// Map to write (.ot, .bt or .mgo)
    pub output: PathBuf,
    /// Sim(3) file, target_from_source: scale tx ty tz qx qy qz qw
    #[arg(long, value_name = "FILE")]
    pub sim3: PathBuf,
    /// Edge of the cells that are written [default: that of the input, scaled]
    #[arg(long, value_name = "L", value_parser = positive)]
    pub resolution: Option<f64>,
    #[command(flatten)]
    pub force: ForceArg,
    #[command(flatten)]
    pub json: JsonArg,
}

/// `monogrid diff`.
#[derive(Debug, Args)]
pub struct DiffArgs {
    /// Map before (.ot, .bt or .mgo)
    pub before: PathBuf,
    /// Map after, of the same resolution and frame
    pub after: PathBuf,
    #[command(flatten)]
    pub json: JsonArg,
}

/// `monogrid project`.
#[derive(Debug, Args)]
pub struct ProjectArgs {
    /// Map to read (.ot, .bt or .mgo)
    pub map: PathBuf,
    /// Image to write (.pgm); its description is written beside it (.yaml)
    pub output: PathBuf,
    /// Cells whose centres are lower are left out [default: beside a run that found the floor a tenth of the camera's height over it]
    #[arg(long, value_name = "Z")]
    pub min_height: Option<f64>,
    /// Cells whose centres are higher are left out [default: beside such a run somewhat over the camera]
    #[arg(long, value_name = "Z")]
    pub max_height: Option<f64>,
    #[command(flatten)]
    pub force: ForceArg,
    #[command(flatten)]
    pub json: JsonArg,
}

pub fn point(text: &str) -> Result<[f64; 3], String> {
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
    let counts = map.cell_counts();
    if json.json {
        print_json(&serde_json::json!({
            "resolution": map.resolution(),
            "leaves": map.leaf_count(),
            "cells_occupied": counts.occupied,
            "cells_free": counts.free,
        }))?;
    } else {
        println!(
            "{}: {} occupied and {} free cells of {} (in the unit of the input)",
            path.display(),
            counts.occupied,
            counts.free,
            map.resolution()
        );
    }
    Ok(Outcome::Done)
}

/// Keeps the cells that touch a box.
pub fn crop(args: &CropArgs) -> CommandResult {
    let format = MapFormat::from_name(&args.output, &MapFormat::MAPS).bad_input()?;
    if (0..3).any(|axis| args.min[axis] >= args.max[axis]) {
        return Err(Failure::input(format!(
            "--min {:?} is not below --max {:?} in every direction",
            args.min, args.max
        )));
    }
    let inputs = Inputs::of("the map", &args.input);
    let output = OutputFile::new(&args.output, args.force.force, &inputs)?;
    let (map, _) = mapfile::load(&args.input)?;
    let kept = map
        .cropped(args.min, args.max)
        .while_running("the map cannot be cropped")?;
    if kept.leaf_count() == 0 {
        return Err(nothing_kept(args, &map));
    }
    mapfile::save(&kept, &output, format)?;
    report_written(&kept, &args.output, args.json)
}

fn nothing_kept(args: &CropArgs, map: &OccupancyMap) -> Failure {
    let reach = map.bounds().map_or_else(
        || "it is empty".to_owned(),
        |(low, high)| format!("its cells reach from {low:.3?} to {high:.3?}"),
    );
    Failure::input(format!(
        "{} has no known cells from --min {:?} to --max {:?}: {reach}",
        args.input.display(),
        args.min,
        args.max
    ))
}

/// Adds the log-odds of two maps, as if both had been measured into one.
pub fn merge(args: &MergeArgs) -> CommandResult {
    let format = MapFormat::from_name(&args.out, &MapFormat::MAPS).bad_input()?;
    let inputs = Inputs::of("a map", &args.first).and("a map", &args.second);
    let output = OutputFile::new(&args.out, args.force.force, &inputs)?;
    let (mut map, _) = mapfile::load(&args.first)?;
    let (other, _) = mapfile::load(&args.second)?;
    check_same_resolution(&map, &other, [&args.first, &args.second])?;
    map.merge(&other)
        .while_running("the maps cannot be merged")?;
    mapfile::save(&map, &output, format)?;
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
    let format = MapFormat::from_name(&args.output, &MapFormat::MAPS).bad_input()?;
    let inputs = Inputs::of("the map", &args.input).and("the transform", &args.sim3);
    let output = OutputFile::new(&args.output, args.force.force, &inputs)?;
    let (map, _) = mapfile::load(&args.input)?;
    let target_from_source = read_sim3(&args.sim3).bad_input()?;
    let resolution = args
        .resolution
        .unwrap_or(map.resolution() * target_from_source.scale);
    let moved = map
        .transformed(&similarity(&target_from_source), resolution)
        .while_running("the map cannot be transformed")?;
    mapfile::save(&moved, &output, format)?;
    report_written(&moved, &args.output, args.json)
}

/// The same transform in the types of the occupancy crate.
pub fn similarity(transform: &Sim3) -> Similarity {
    let rotation = transform.to_se3().rotation_matrix();
    Similarity {
        scale: transform.scale,
        rotation: std::array::from_fn(|i| std::array::from_fn(|j| rotation[(i, j)])),
        translation: transform.translation.into(),
    }
}

/// `diff --json`: cells by their state before and after.
#[derive(Debug, Serialize)]
struct DifferenceReport {
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
    let difference = before
        .difference(&after)
        .while_running("the maps cannot be compared")?;
    if args.json.json {
        print_json(&DifferenceReport::from(difference))?;
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

impl From<MapDifference> for DifferenceReport {
    fn from(difference: MapDifference) -> Self {
        Self {
            same: difference.same,
            free_to_occupied: difference.free_to_occupied,
            occupied_to_free: difference.occupied_to_free,
            only_before: difference.only_before,
            only_after: difference.only_after,
            mean_log_odds_difference: difference.mean_log_odds_difference,
        }
    }
}

/// What the summary beside a map says of its lengths.
struct RunBeside {
    /// Whether they are metres; `None` where there is no summary.
    is_metric: Option<bool>,
    /// Median height of the camera over the floor, which is at z = 0; `None` where none was found.
    camera_height: Option<f64>,
}

impl RunBeside {
    fn of(map: &Path) -> Self {
        let path = map.with_file_name("summary.json");
        let text = std::fs::read_to_string(path).unwrap_or_default();
        let summary: serde_json::Value = serde_json::from_str(&text).unwrap_or_default();
        let height = summary["floor"]["camera_height"].as_f64();
        Self {
            is_metric: summary["scale"].as_str().map(|scale| scale == "metric"),
            camera_height: height.filter(|height| height.is_finite() && *height > 0.0),
        }
    }

    /// What the description of the grid says to people, as comments.
    fn note(&self, [low, high]: [f64; 2]) -> String {
        match self.is_metric {
            Some(true) => format!("# cells from z = {low:.3} to {high:.3} m\n"),
            Some(false) => format!(
                "# cells from z = {low:.3} to {high:.3} map units\n{UNKNOWN_SCALE_WARNING}"
            ),
            None => "# WARNING: nothing beside the map says its unit; nav2 takes resolution and origin as metres\n".to_owned(),
        }
    }
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
    let inputs = Inputs::of("the map", &args.map);
    let force = args.force.force;
    let yaml = args.output.with_extension("yaml");
    let pgm_file = OutputFile::new(&args.output, force, &inputs)?;
    let yaml_file = OutputFile::new(&yaml, force, &inputs)?;
    let (map, _) = mapfile::load(&args.map)?;
    let beside = RunBeside::of(&args.map);
    let band = beside
        .camera_height
        .map_or([f64::NEG_INFINITY, f64::INFINITY], |height| {
            [0.1 * height, 1.1 * height]
        });
    let low = args.min_height.unwrap_or(band[0]);
    let high = args.max_height.unwrap_or(band[1]);
    let Some(grid) = map.projected(low, high) else {
        return Err(Failure::input(format!(
            "{} has no known cells between the heights {low} and {high}",
            args.map.display(),
        )));
    };
    pgm_file.write(&grid.to_pgm())?;
    let note = beside.note([low, high]);
    yaml_file.write((grid.to_yaml(&name.to_string_lossy()) + &note).as_bytes())?;
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
