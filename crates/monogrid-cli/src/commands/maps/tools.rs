//! Tools on maps: `crop`, `merge`, `transform`, `diff`, `project`, `convert`, `mesh`, `plan`.

use crate::commands::bytes;
use clap::Args;
use monogrid_app::args::{JsonArg, WriteArgs, positive};
use monogrid_app::mapfile;
use monogrid_app::output::{Inputs, OutputFile, map_at};
use monogrid_app::process::failure::{Classify, CommandResult, Failure};
use monogrid_app::run::outputs::{UNKNOWN_SCALE_WARNING, lowest_and_highest};
use monogrid_datasets::{read_sim3, read_text};
use monogrid_evaluation::{PlanConfig, plan_path};
use monogrid_geometry::Sim3;
use monogrid_mapping::MeshConfig;
use monogrid_occupancy::{MapFormat, OccupancyMap, Similarity};
use monogrid_report::picture::plan::Plan;
use monogrid_report::surface::{CellColours, MeshFormat};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// `monogrid crop`.
#[derive(Debug, Args)]
pub struct CropArgs {
    /// Map to read (.ot, .bt, .mgo, or the folder of a run)
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
    pub write: WriteArgs,
}

/// `monogrid merge`.
#[derive(Debug, Args)]
pub struct MergeArgs {
    /// Map to read (.ot, .bt, .mgo, or the folder of a run)
    pub first: PathBuf,
    /// Map to add, of the same resolution and frame
    pub second: PathBuf,
    /// Map to write (.ot, .bt or .mgo)
    #[arg(long, value_name = "MAP.{ot,bt,mgo}")]
    pub out: PathBuf,
    #[command(flatten)]
    pub write: WriteArgs,
}

/// `monogrid transform`.
#[derive(Debug, Args)]
pub struct TransformArgs {
    /// Map to read (.ot, .bt, .mgo, or the folder of a run)
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
    pub write: WriteArgs,
}

/// `monogrid diff`.
#[derive(Debug, Args)]
pub struct DiffArgs {
    /// Map before (.ot, .bt, .mgo, or the folder of a run)
    pub before: PathBuf,
    /// Map after, of the same resolution and frame
    pub after: PathBuf,
    #[command(flatten)]
    pub json: JsonArg,
}

/// `monogrid project`.
#[derive(Debug, Args)]
pub struct ProjectArgs {
    /// Map to read (.ot, .bt, .mgo, or the folder of a run)
    pub map: PathBuf,
    /// Image to write: .pgm, with its description beside it (.yaml), or a plan for people with a
    /// bar of a round length, .png or .svg, or with outlines, .dxf
    pub output: PathBuf,
    /// Cells whose centres are lower are left out [default: as in map.pgm of the run beside it]
    #[arg(long, value_name = "Z")]
    pub min_height: Option<f64>,
    /// Cells whose centres are higher are left out [default: as in map.pgm of the run beside it]
    #[arg(long, value_name = "Z")]
    pub max_height: Option<f64>,
    #[command(flatten)]
    pub write: WriteArgs,
}

/// `monogrid convert`.
#[derive(Debug, Args)]
pub struct ConvertArgs {
    /// Map to read (.ot, .bt, .mgo, or the folder of a run)
    pub input: PathBuf,
    /// File to write (.ot, .bt, .mgo, .ply or .pcd); point clouds hold the centres of occupied
    /// cells
    pub output: PathBuf,
    #[command(flatten)]
    pub write: WriteArgs,
}

/// `monogrid mesh`.
#[derive(Debug, Args)]
pub struct MeshArgs {
    /// Map to read (.ot, .bt, .mgo, or the folder of a run)
    pub map: PathBuf,
    /// Mesh to write: .ply, .glb, .obj, .stl, .dxf or .usdz
    pub output: PathBuf,
    /// Pieces of the surface with fewer faces of cells are left out; 0 keeps all
    #[arg(long, value_name = "N", default_value_t = MeshConfig::default().min_faces)]
    pub min_faces: usize,
    #[command(flatten)]
    pub write: WriteArgs,
}

/// `monogrid plan`.
#[derive(Debug, Args)]
pub struct PlanArgs {
    /// Map to read (.ot, .bt, .mgo, or the folder of a run)
    pub map: PathBuf,
    /// Where the robot's centre is, in the unit of the map; X,Y on the floor
    #[arg(value_name = "FROM", value_parser = place, allow_hyphen_values = true)]
    pub from: [f64; 3],
    /// Where it is to go; where the robot does not fit, the nearest place where it does, at most
    /// four radii away
    #[arg(value_name = "TO", value_parser = place, allow_hyphen_values = true)]
    pub to: [f64; 3],
    /// Radius of the robot, a ball or on the floor a disc, in the unit of the map
    #[arg(long, value_name = "R", value_parser = positive)]
    pub robot_radius: f64,
    /// On the floor, among the obstacles of map.pgm
    #[arg(long)]
    pub on_floor: bool,
    /// On the floor, among what is between these heights
    #[arg(long, value_name = "LOW,HIGH", value_parser = heights, allow_hyphen_values = true)]
    pub heights: Option<[f64; 2]>,
    /// File to write, any number of them: .csv, .json (nav_msgs/Path), .png or .svg
    #[arg(long, value_name = "FILE")]
    pub out: Vec<PathBuf>,
    /// Replace files that exist; never one that is read
    #[arg(long)]
    pub force: bool,
    /// The robot may enter cells of which nothing is known
    #[arg(long)]
    pub through_unknown: bool,
    #[command(flatten)]
    pub json: JsonArg,
}

fn point(text: &str) -> Result<[f64; 3], String> {
    numbers(text).ok_or_else(|| "expected three numbers, e.g. -1,0,2.5".to_owned())
}

/// A point, or one on the floor.
fn place(text: &str) -> Result<[f64; 3], String> {
    let flat = || numbers(text).map(|[x, y]| [x, y, 0.0]);
    numbers(text)
        .or_else(flat)
        .ok_or_else(|| "expected three numbers, e.g. -1,0,2.5, or on the floor two".to_owned())
}

fn heights(text: &str) -> Result<[f64; 2], String> {
    let ordered = numbers(text).filter(|[low, high]| low < high);
    ordered.ok_or_else(|| "expected the lower and the upper height, e.g. 0.1,0.5".to_owned())
}

/// Just so many numbers between commas.
fn numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let number = |part: &str| part.trim().parse().ok().filter(|v: &f64| v.is_finite());
    let numbers: Option<Vec<f64>> = text.split(',').map(number).collect();
    numbers?.try_into().ok()
}

/// The file of a map that is to be written, and its format.
fn map_file(path: &Path, force: bool, inputs: &Inputs) -> Result<(OutputFile, MapFormat), Failure> {
    let format = MapFormat::from_name(path, &MapFormat::MAPS).bad_input()?;
    Ok((OutputFile::new(path, force, inputs)?, format))
}

/// Writes a map, and what it is for people and programs.
fn finish(
    map: &OccupancyMap,
    (file, format): (OutputFile, MapFormat),
    json: JsonArg,
) -> CommandResult {
    mapfile::save(map, &file, format)?;
    let (counts, resolution) = (map.cell_counts(), map.resolution());
    let report = serde_json::json!({
        "resolution": resolution,
        "leaves": map.leaf_count(),
        "cells_occupied": counts.occupied,
        "cells_free": counts.free,
    });
    json.print(&report, || {
        println!(
            "{}: {} occupied and {} free cells of {resolution} (in the unit of the input)",
            file.path().display(),
            counts.occupied,
            counts.free
        );
    })
}

/// Keeps the cells that touch a box.
pub fn crop(args: &CropArgs) -> CommandResult {
    let CropArgs { min, max, .. } = args;
    let inputs = Inputs::of("the map", &args.input);
    let output = map_file(&args.output, args.write.force, &inputs)?;
    if (0..3).any(|axis| min[axis] >= max[axis]) {
        return Err(Failure::input(format!(
            "--min {min:?} is not below --max {max:?} in every direction"
        )));
    }
    let (map, _) = mapfile::load(&args.input)?;
    let kept = map.cropped(*min, *max);
    let kept = kept.while_running("the map cannot be cropped")?;
    if kept.leaf_count() == 0 {
        let reach = map.bounds().map_or_else(
            || "it is empty".to_owned(),
            |(low, high)| format!("its cells reach from {low:.3?} to {high:.3?}"),
        );
        return Err(Failure::input(format!(
            "{} has no known cells from --min {min:?} to --max {max:?}: {reach}",
            args.input.display()
        )));
    }
    finish(&kept, output, args.write.json)
}

/// Adds the log-odds of two maps, as if both had been measured into one.
pub fn merge(args: &MergeArgs) -> CommandResult {
    let inputs = Inputs::of("a map", &args.first).and("a map", &args.second);
    let output = map_file(&args.out, args.write.force, &inputs)?;
    let [mut map, other] = load_alike([&args.first, &args.second])?;
    map.merge(&other)
        .while_running("the maps cannot be merged")?;
    finish(&map, output, args.write.json)
}

/// Two maps with cells of the same size.
fn load_alike(paths: [&PathBuf; 2]) -> Result<[OccupancyMap; 2], Failure> {
    let [(first, _), (second, _)] = [mapfile::load(paths[0])?, mapfile::load(paths[1])?];
    let [a, b] = [first.resolution(), second.resolution()];
    if (a / b - 1.0).abs() < 1e-6 {
        return Ok([first, second]);
    }
    let [first, second] = paths.map(|path| path.display());
    Err(Failure::input(format!(
        "{first} has cells of {a}, {second} of {b}, expected the same"
    )))
}

/// Moves a map; a map built with `--align` is better than one that was resampled.
pub fn transform(args: &TransformArgs) -> CommandResult {
    let inputs = Inputs::of("the map", &args.input).and("the transform", &args.sim3);
    let output = map_file(&args.output, args.write.force, &inputs)?;
    let (map, _) = mapfile::load(&args.input)?;
    let target_from_source = read_sim3(&args.sim3).bad_input()?;
    let scaled = map.resolution() * target_from_source.scale;
    let resolution = args.resolution.unwrap_or(scaled);
    let moved = map.transformed(&similarity(&target_from_source), resolution);
    let moved = moved.while_running("the map cannot be transformed")?;
    finish(&moved, output, args.write.json)
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
    let [before, after] = load_alike([&args.before, &args.after])?;
    let difference = before.difference(&after);
    let difference = difference.while_running("the maps cannot be compared")?;
    let report = DifferenceReport {
        same: difference.same,
        free_to_occupied: difference.free_to_occupied,
        occupied_to_free: difference.occupied_to_free,
        only_before: difference.only_before,
        only_after: difference.only_after,
        mean_log_odds_difference: difference.mean_log_odds_difference,
    };
    args.json.print(&report, || {
        let [before, after] = [&args.before, &args.after].map(|path| path.display());
        println!("{:>12} cells in the same state", report.same);
        println!("{:>12} from free to occupied", report.free_to_occupied);
        println!("{:>12} from occupied to free", report.occupied_to_free);
        println!("{:>12} known only in {before}", report.only_before);
        println!("{:>12} known only in {after}", report.only_after);
        let mean = report.mean_log_odds_difference;
        println!("log-odds differ by {mean:.4} on average");
    })
}

/// What the summary beside a map says of its lengths.
struct RunBeside {
    /// Whether they are metres; `None` where there is no summary.
    is_metric: Option<bool>,
    /// Lowest and highest z of the map seen from above that the run wrote, else what follows from
    /// the median height of the camera over the floor, which is at z = 0; `None` where neither is
    /// known.
    band: Option<[f64; 2]>,
    /// Whether the run says that it does not know what is up.
    is_up_uncertain: bool,
}

impl RunBeside {
    fn of(map: &Path) -> Self {
        let path = map_at(map).with_file_name("summary.json");
        let text = read_text(&path).unwrap_or_default();
        let summary: serde_json::Value = serde_json::from_str(&text).unwrap_or_default();
        let height = summary["floor"]["camera_height"].as_f64();
        let is_up_uncertain = summary["up"]["is_certain"] == false;
        let is_sound = |height: &f64| height.is_finite() && *height > 0.0 && !is_up_uncertain;
        let height = height.filter(is_sound);
        let written = serde_json::from_value::<[f64; 2]>(summary["map"]["band"].clone()).ok();
        Self {
            is_metric: summary["scale"].as_str().map(|scale| scale == "metric"),
            band: written.or(height.map(|height| [0.1 * height, 1.1 * height])),
            is_up_uncertain,
        }
    }

    /// What the description of the grid says to people, as comments.
    fn note(&self, [low, high]: [f64; 2]) -> String {
        let of_up = match self.is_up_uncertain {
            true => " (up is uncertain)",
            false => "",
        };
        let heights = format!("# cells from z = {low:.3} to {high:.3}");
        match self.is_metric {
            Some(true) => format!("{heights} m{of_up}\n"),
            Some(false) => {
                format!("{heights} map units{of_up}\n{UNKNOWN_SCALE_WARNING}")
            }
            None => "# WARNING: nothing beside the map says its unit; nav2 takes resolution and \
                origin as metres\n"
                .to_owned(),
        }
    }
}

/// Writes the map seen from above, for nav2's map server or for people.
pub fn project(args: &ProjectArgs) -> CommandResult {
    let extension = args.output.extension().unwrap_or_default();
    let is_plan = ["png", "svg", "dxf"].iter().any(|plan| extension == *plan);
    let (Some(name), true) = (args.output.file_name(), is_plan || extension == "pgm") else {
        return Err(Failure::input(format!(
            "cannot write {}: expected a name that ends in .pgm, .png, .svg or .dxf",
            args.output.display()
        )));
    };
    let inputs = Inputs::of("the map", &args.map);
    let yaml = args.output.with_extension("yaml");
    let file = OutputFile::new(&args.output, args.write.force, &inputs)?;
    let yaml_file = || OutputFile::new(&yaml, args.write.force, &inputs);
    let yaml_file = (!is_plan).then(yaml_file).transpose()?;
    let (map, _) = mapfile::load(&args.map)?;
    let beside = RunBeside::of(&args.map);
    let [lowest, highest] = beside.band.unwrap_or([f64::NEG_INFINITY, f64::INFINITY]);
    let low = args.min_height.unwrap_or(lowest);
    let high = args.max_height.unwrap_or(highest);
    let projected = map.projected(low, high).bad_input()?;
    let Some(grid) = projected else {
        return Err(Failure::input(format!(
            "{} has no known cells between the heights {low} and {high}",
            args.map.display(),
        )));
    };
    let plan = Plan {
        grid: &grid,
        path: &[],
        is_metric: beside.is_metric == Some(true),
    };
    if let Some(yaml_file) = yaml_file {
        file.write(&grid.to_pgm())?;
        let note = beside.note([low, high]);
        yaml_file.write((grid.to_yaml(&name.to_string_lossy()) + &note).as_bytes())?;
    } else if extension == "png" {
        file.write(&plan.png())?;
    } else if extension == "svg" {
        file.write(plan.svg().as_bytes())?;
    } else {
        file.write(plan.dxf().as_bytes())?;
    }
    let report = serde_json::json!({
        "width": grid.width,
        "height": grid.height,
        "resolution": grid.resolution,
        "origin": grid.origin,
    });
    args.write.json.print(&report, || {
        let output = args.output.display();
        let and = match is_plan {
            true => String::new(),
            false => format!(" and {}", yaml.display()),
        };
        println!(
            "{output}{and}: {} x {} cells of {}",
            grid.width, grid.height, grid.resolution
        );
    })
}

/// Reads a map and writes it in another format.
pub fn convert(args: &ConvertArgs) -> CommandResult {
    let format = MapFormat::from_name(&args.output, &MapFormat::ALL).bad_input()?;
    let inputs = Inputs::of("the map", &args.input);
    let output = OutputFile::new(&args.output, args.write.force, &inputs)?;
    let (map, from) = mapfile::load(&args.input)?;
    let file_bytes = mapfile::save(&map, &output, format)?;
    let to = format.description();
    let report = serde_json::json!({
        "from": from.description(),
        "to": to,
        "leaves": map.leaf_count(),
        "file_bytes": file_bytes,
    });
    args.write.json.print(&report, || {
        let (input, output) = (args.input.display(), args.output.display());
        println!("{input} -> {output}: {to}, {}", bytes(file_bytes));
        if from == MapFormat::Bt && matches!(format, MapFormat::Ot | MapFormat::Mgo) {
            println!("a .bt holds no probabilities: free and occupied cells got OctoMap's limits");
        }
    })
}

/// Reads a map and writes its surface, in grey: a map knows no colours.
pub fn mesh(args: &MeshArgs) -> CommandResult {
    let format = MeshFormat::from_name(&args.output)?;
    let inputs = Inputs::of("the map", &args.map);
    let output = OutputFile::new(&args.output, args.write.force, &inputs)?;
    let (map, _) = mapfile::load(&args.map)?;
    let config = MeshConfig {
        min_faces: args.min_faces,
        ..MeshConfig::default()
    };
    let mesh = CellColours::unknown().mesh(&map, &config);
    let mesh = mesh.while_running("the surface cannot be made")?;
    output.write_with(|out| Ok(format.write(&mesh, ("the unit of the map", "mesh"), out)?))?;
    let (vertices, triangles) = (mesh.surface.vertices.len(), mesh.surface.triangles.len());
    let report = serde_json::json!({ "vertices": vertices, "triangles": triangles });
    args.write.json.print(&report, || {
        let output = args.output.display();
        println!("{output}: {vertices} vertices, {triangles} triangles");
    })
}

/// Plans, prints and writes the path.
pub fn plan(args: &PlanArgs) -> CommandResult {
    let inputs = Inputs::of("the map", &args.map);
    let file = |path: &PathBuf| {
        let kind = path.extension().unwrap_or_default().to_string_lossy();
        match ["csv", "json", "png", "svg"].contains(&kind.as_ref()) {
            true => Ok((
                OutputFile::new(path, args.force, &inputs)?,
                kind.into_owned(),
            )),
            false => Err(Failure::input(format!(
                "cannot write {}: expected a name that ends in .csv, .json, .png or .svg",
                path.display()
            ))),
        }
    };
    let files: Result<Vec<_>, _> = args.out.iter().map(file).collect();
    let files = files?;
    let (map, _) = mapfile::load(&args.map)?;
    let beside = RunBeside::of(&args.map);
    let lacks_heights =
        "nothing beside the map says what is in the way; expected --heights LOW,HIGH";
    let heights = match (args.heights, args.on_floor) {
        (None, true) => Some(beside.band.ok_or_else(|| Failure::input(lacks_heights))?),
        (given, _) => given,
    };
    let config = PlanConfig {
        through_unknown: args.through_unknown,
        heights,
        ..PlanConfig::with_radius(args.robot_radius)
    };
    let path = plan_path(&map, args.from, args.to, &config).bad_input()?;
    for (end, moved) in ["start", "goal"].into_iter().zip(path.moved) {
        if moved > 0.0 {
            eprintln!(
                "warning: the robot does not fit at the {end}: the path has it {moved:.3} away"
            );
        }
    }
    let points = &path.points;
    let band = heights.unwrap_or_else(|| beside_path(points, args.robot_radius));
    for (file, kind) in &files {
        file.write(&match kind.as_str() {
            "csv" => csv_of(points).into_bytes(),
            "json" => path_message(points).to_string().into_bytes(),
            _ => picture_of(&map, points, band, &beside, kind == "png")?,
        })?;
    }
    args.json.print(&path, || {
        println!(
            "# x y z in the unit of the map; length {:.3}, at least {:.3} from every obstacle, \
             cells of {}",
            path.length, path.clearance, path.planning_cell
        );
        for [x, y, z] in points {
            println!("{x:.4} {y:.4} {z:.4}");
        }
    })
}

/// The path on the map from above, as PNG or SVG.
fn picture_of(
    map: &OccupancyMap,
    path: &[[f64; 3]],
    [low, high]: [f64; 2],
    beside: &RunBeside,
    is_png: bool,
) -> Result<Vec<u8>, Failure> {
    let grid = map.projected(low, high).bad_input()?;
    let grid = grid.ok_or_else(|| Failure::input("nothing is known along the path"))?;
    let plan = Plan {
        grid: &grid,
        path,
        is_metric: beside.is_metric == Some(true),
    };
    Ok(match is_png {
        true => plan.png(),
        false => plan.svg().into_bytes(),
    })
}

/// Lowest and highest of what a ball touches on its way.
fn beside_path(points: &[[f64; 3]], radius: f64) -> [f64; 2] {
    let [low, high] = lowest_and_highest(points.iter());
    [low - radius, high + radius]
}

fn csv_of(points: &[[f64; 3]]) -> String {
    let lines = points
        .iter()
        .map(|[x, y, z]| format!("{x:.4},{y:.4},{z:.4}\n"));
    "x,y,z\n".to_owned() + &lines.collect::<String>()
}

/// A path as ROS 2 has it (`nav_msgs/Path`), in JSON: at each place the robot looks at the next.
fn path_message(points: &[[f64; 3]]) -> serde_json::Value {
    let header = serde_json::json!({ "stamp": { "sec": 0, "nanosec": 0 }, "frame_id": "map" });
    let mut yaw = 0.0;
    let poses = points.iter().enumerate().map(|(k, [x, y, z])| {
        if let Some([u, v, _]) = points.get(k + 1) {
            yaw = f64::atan2(v - y, u - x);
        }
        let (sin, cos) = f64::sin_cos(yaw / 2.0);
        serde_json::json!({ "header": header, "pose": {
            "position": { "x": x, "y": y, "z": z },
            "orientation": { "x": 0.0, "y": 0.0, "z": sin, "w": cos },
        } })
    });
    let poses: Vec<_> = poses.collect();
    serde_json::json!({ "header": header, "poses": poses })
}
