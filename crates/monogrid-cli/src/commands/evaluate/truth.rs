//! `monogrid truth`: a ground-truth map of a mesh, a point cloud, a built-in world or posed depth.

use crate::commands::maps::posed_depth::PosedDepthFolder;
use crate::commands::sources::synth::is_mesh;
use crate::commands::{bytes, left_out, warn};
use clap::Args;
use monogrid_app::args::{WriteArgs, positive};
use monogrid_app::mapfile;
use monogrid_app::output::{Inputs, OutputFile};
use monogrid_app::process::failure::{Classify, CommandResult, Failure};
use monogrid_app::run::outputs::path_of;
use monogrid_datasets::read_path;
use monogrid_evaluation::{
    PosedDepth, Triangle, Truth, TruthConfig, TruthGrid, View, truth_from_depth_images,
    truth_from_points, truth_from_triangles,
};
use monogrid_occupancy::MapFormat;
use monogrid_worlds::{
    CameraPath, Carrier, LightingConfig, MeshModel, SynthConfig, SynthSequence, TriangleMesh,
    WORLD_NAMES, World, usual_frames,
};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// `monogrid truth`.
#[derive(Debug, Args)]
pub struct TruthArgs {
    /// Mesh or point cloud (.ply, .pcd, .obj, .stl), a built-in world (e.g. living-room), or a
    /// folder in TUM layout with depth images and poses
    pub source: PathBuf,
    /// Edge length of a cell, in units of the source
    #[arg(long, value_name = "L", value_parser = positive, default_value_t = 0.05)]
    pub resolution: f64,
    /// Map to write: .ot or .bt
    #[arg(long, value_name = "MAP.{ot,bt}")]
    pub out: PathBuf,
    /// Poses of the camera in the frame of the source; free is what can be reached from them
    /// [default: groundtruth.txt of a folder, the built-in motion of a world]
    #[arg(long, value_name = "FILE")]
    pub trajectory: Option<PathBuf>,
    /// Points of a cloud fill all cells within this distance, at least half their spacing [default:
    /// 0]
    #[arg(long, value_name = "L", value_parser = positive)]
    pub splat_radius: Option<f64>,
    /// Holes of the surface up to twice this many cells wide are closed
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub hole_cells: usize,
    /// Depth images: ignore depth beyond this [default: none is ignored]
    #[arg(long, value_name = "L", value_parser = positive)]
    pub max_depth: Option<f64>,
    /// Depth images: use every n-th [default: so that at most 300 are used]
    #[arg(long, value_name = "N")]
    pub every: Option<usize>,
    /// Depth images: intrinsics and scale [default: calibration_depth.txt in the folder]
    #[arg(long, value_name = "FILE")]
    pub depth_calibration: Option<PathBuf>,
    #[command(flatten)]
    pub write: WriteArgs,
}

/// `truth --json`.
#[derive(Debug, Default, Serialize)]
struct TruthReport {
    made_from: String,
    resolution: f64,
    occupied: u64,
    free: u64,
    unknown: u64,
    cameras: usize,
    cameras_in_free_space: Option<usize>,
    reaches_border: Option<bool>,
    leaves: usize,
    file_bytes: u64,
    warnings: Vec<String>,
}

/// A truth, and what is known of it without its cells.
type Made = (TruthGrid, TruthReport);

/// Most depth images used unless asked for more: they are all in memory at once, 1.2 MB each.
const MAX_DEPTH_IMAGES: usize = 300;
/// Camera positions per second of a built-in motion.
const POSITIONS_PER_SEC: f64 = 5.0;

/// Builds and writes the map.
pub fn execute(args: &TruthArgs) -> CommandResult {
    let format = MapFormat::from_name(&args.out, &MapFormat::MAPS).bad_input()?;
    let kind = Kind::of(&args.source)?;
    let output = OutputFile::new(&args.out, args.write.force, &inputs(args, &kind)?)?;
    let (grid, made) = match kind {
        Kind::Folder => from_folder(args)?,
        Kind::Mesh => from_mesh(args)?,
        Kind::World(name) => from_world(args, &name)?,
    };
    let map = grid.to_map();
    let map = map.while_running("the map cannot be built")?;
    let file_bytes = mapfile::save(&map, &output, format)?;
    warn(&made.warnings);
    let counts = grid.counts();
    let report = TruthReport {
        resolution: args.resolution,
        occupied: counts.occupied,
        free: counts.free,
        unknown: counts.unknown,
        leaves: map.leaf_count(),
        file_bytes,
        ..made
    };
    args.write.json.print(&report, || {
        let (out, size) = (args.out.display(), bytes(file_bytes));
        println!(
            "{out}: truth of {}, cells of {}",
            report.made_from, report.resolution
        );
        println!(
            "{} occupied, {} free, {} unknown cells; {size}",
            report.occupied, report.free, report.unknown
        );
    })
}

/// What is read: the images of a folder too.
fn inputs(args: &TruthArgs, kind: &Kind) -> Result<Inputs, Failure> {
    let inputs = Inputs::default()
        .and_all("a trajectory", &args.trajectory)
        .and_all("a calibration", &args.depth_calibration);
    match kind {
        Kind::Folder => inputs.and_dataset(&args.source),
        Kind::Mesh => Ok(inputs.and("the surface", &args.source)),
        Kind::World(_) => Ok(inputs),
    }
}

/// What the truth is made from.
enum Kind {
    Folder,
    Mesh,
    World(String),
}

impl Kind {
    fn of(source: &Path) -> Result<Self, Failure> {
        if source.is_dir() {
            return Ok(Self::Folder);
        }
        let is_pcd = source
            .extension()
            .is_some_and(|e| e.eq_ignore_ascii_case("pcd"));
        if is_mesh(source) || is_pcd {
            return Ok(Self::Mesh);
        }
        match source.to_str() {
            Some(name) if WORLD_NAMES.contains(&name) => Ok(Self::World(name.to_owned())),
            _ => Err(Failure::input(format!(
                "{} is neither a mesh or cloud (.ply, .pcd, .obj, .stl), nor a folder with depth \
                 images, nor a built-in world ({})",
                source.display(),
                WORLD_NAMES.join(", ")
            ))),
        }
    }
}

fn from_mesh(args: &TruthArgs) -> Result<Made, Failure> {
    let Some(trajectory) = &args.trajectory else {
        return Err(Failure::input(format!(
            "a surface alone does not say what is inside: give camera positions in the frame of {} \
             with --trajectory FILE",
            args.source.display()
        )));
    };
    let model = MeshModel::read(&args.source).bad_input()?;
    let left_out = left_out(&model, &args.source);
    let mesh = model.mesh;
    let cameras = positions(trajectory)?;
    let config = truth_config(args);
    let truth = if mesh.triangles.is_empty() {
        let points: Vec<[f64; 3]> = mesh.vertices.iter().map(|v| v.map(f64::from)).collect();
        let truth = truth_from_points(&points, &cameras, &config).bad_input();
        truth.map(|truth| (truth, format!("{} points", points.len())))
    } else {
        let triangles = triangles_of(&mesh, &args.source)?;
        let truth = truth_from_triangles(&triangles, &cameras, &config).bad_input();
        truth.map(|truth| (truth, format!("{} triangles", triangles.len())))
    };
    // what is wrong with the surface may be why there is no truth of it
    let (truth, what) = truth.inspect_err(|_| warn(left_out.as_slice()))?;
    let (grid, mut made) = of_surface(truth, what, cameras.len());
    made.warnings.extend(left_out);
    Ok((grid, made))
}

fn from_world(args: &TruthArgs, name: &str) -> Result<Made, Failure> {
    let cameras = match &args.trajectory {
        Some(trajectory) => positions(trajectory)?,
        None => built_in_positions(name)?,
    };
    // light does not change the shape
    let lighting = LightingConfig {
        texel_m: 1.0,
        ..LightingConfig::quick()
    };
    let world = World::by_name_with(name, &lighting).bad_input()?;
    let truth = of_world(&world, &cameras, &truth_config(args))?;
    let what = format!("the built-in world {name}");
    Ok(of_surface(truth, what, cameras.len()))
}

/// The truth of a world from which its camera saw what it saw.
pub fn of_world(
    world: &World,
    cameras: &[[f64; 3]],
    config: &TruthConfig,
) -> Result<Truth, Failure> {
    let triangles = triangles_of(&world.mesh(), Path::new(world.name()))?;
    truth_from_triangles(&triangles, cameras, config).bad_input()
}

fn of_surface(truth: Truth, made_from: String, cameras: usize) -> Made {
    let mut warnings = Vec::new();
    if truth.reaches_border {
        warnings.push(
            "free space reaches the border of the map: the surface is open there, and the outside \
             counts as free; close it, or raise --hole-cells"
                .to_owned(),
        );
    }
    if truth.cameras_in_free_space < cameras {
        warnings.push(format!(
            "{} of {cameras} camera positions are inside the surface",
            cameras - truth.cameras_in_free_space
        ));
    }
    let report = TruthReport {
        made_from,
        cameras,
        cameras_in_free_space: Some(truth.cameras_in_free_space),
        reaches_border: Some(truth.reaches_border),
        warnings,
        ..TruthReport::default()
    };
    (truth.grid, report)
}

/// Cells of a map that any mesh or cloud may fill, and how many more for each of its bytes: a few
/// corners that lie far apart must not fill the memory.
const SMALL_FILE_CELLS: u64 = 400_000_000;
const CELLS_PER_BYTE: u64 = 400;

/// The usual settings for a source: a mesh or cloud, or a built-in world, which is no file.
pub fn config_for(source: &Path, resolution: f64) -> TruthConfig {
    let usual = TruthConfig::with_resolution(resolution);
    let file = std::fs::metadata(source).ok().filter(|file| file.is_file());
    let max_cells = file.map_or(usual.max_cells, |file| {
        let more = file.len().saturating_mul(CELLS_PER_BYTE);
        usual.max_cells.min(SMALL_FILE_CELLS.saturating_add(more))
    });
    TruthConfig { max_cells, ..usual }
}

fn truth_config(args: &TruthArgs) -> TruthConfig {
    TruthConfig {
        hole_cells: args.hole_cells,
        splat_radius: args.splat_radius.unwrap_or(0.0),
        ..config_for(&args.source, args.resolution)
    }
}

/// The triangles of a mesh.
pub fn triangles_of(mesh: &TriangleMesh, source: &Path) -> Result<Vec<Triangle>, Failure> {
    let corner = |index: u32| mesh.vertices.get(index as usize).map(|v| v.map(f64::from));
    let triangle = |[a, b, c]: [u32; 3]| Some([corner(a)?, corner(b)?, corner(c)?]);
    let triangles: Option<Vec<Triangle>> = mesh.triangles.iter().map(|t| triangle(*t)).collect();
    triangles.ok_or_else(|| {
        Failure::input(format!(
            "{} has a triangle with a corner beyond its {} vertices",
            source.display(),
            mesh.vertices.len()
        ))
    })
}

fn positions(trajectory: &Path) -> Result<Vec<[f64; 3]>, Failure> {
    Ok(path_of(&read_path(trajectory).bad_input()?))
}

/// Where the camera of a built-in world is carried along.
fn built_in_positions(world: &str) -> Result<Vec<[f64; 3]>, Failure> {
    let config = SynthConfig {
        frames: usual_frames(world),
        ..SynthConfig::demo()
    };
    let path = SynthSequence::path_for(world, Carrier::Hand.into(), &config).bad_input()?;
    Ok(positions_along(&path))
}

/// Positions along a motion, close enough to fill free space from.
pub fn positions_along(path: &CameraPath) -> Vec<[f64; 3]> {
    let count = (path.duration_secs() * POSITIONS_PER_SEC).ceil() as usize;
    let position = |k: usize| {
        let secs = (k as f64 / POSITIONS_PER_SEC).min(path.duration_secs());
        path.world_from_camera(secs).translation.into()
    };
    (0..=count).map(position).collect()
}

fn from_folder(args: &TruthArgs) -> Result<Made, Failure> {
    let folder = PosedDepthFolder::open(
        &args.source,
        args.depth_calibration.as_deref(),
        args.trajectory.as_deref(),
    )?;
    let posed = folder.posed()?;
    if args.every == Some(0) {
        return Err(Failure::input("--every is 0, expected at least 1"));
    }
    let usual = posed.len().div_ceil(MAX_DEPTH_IMAGES);
    let used: Vec<_> = posed
        .into_iter()
        .step_by(args.every.unwrap_or(usual))
        .collect();
    let depths = used.iter().map(|(entry, _)| folder.read(entry));
    let depths = depths.collect::<Result<Vec<_>, _>>()?;
    let parts = used.iter().zip(&depths);
    let images = parts.map(|((_, pose), depth)| PosedDepth {
        view: View {
            world_from_camera: *pose,
            camera: folder.pinhole,
            width: depth.width(),
            height: depth.height(),
        },
        depth: depth.as_slice(),
    });
    let images: Vec<PosedDepth> = images.collect();
    let max_depth = args.max_depth.unwrap_or(f64::INFINITY);
    let grid = truth_from_depth_images(&images, args.resolution, max_depth).bad_input()?;
    let num_depths = folder.dataset.depths.len();
    let report = TruthReport {
        made_from: format!("{} of {num_depths} depth images", images.len()),
        cameras: images.len(),
        ..TruthReport::default()
    };
    Ok((grid, report))
}
