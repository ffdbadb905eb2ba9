//! `monogrid map`: an occupancy map from a recording, from scans, or from posed depth images.

use super::posed_depth::PosedDepthFolder;
use super::{bytes, print_json, use_threads};
use crate::args::{ForceArg, JsonArg, MappingArgs, Profile};
use crate::config::RunConfig;
use crate::failure::{Classify, CommandResult, Failure, Outcome};
use crate::mapfile;
use crate::output::{Inputs, OutputFile};
use crate::picture::voxels::{View, occupied_cubes, render};
use crate::recorded::Recorded;
use crate::run::align::{Align, Up};
use crate::run::sessions::{Source, files_of};
use crate::run::summary::unit_name;
use crate::surface::{CellColours, MeshFormat};
use crate::usage::{peak_rss_bytes, process_cpu};
use clap::Args;
use monogrid_datasets::{Scale, ScansReader, encode_png_rgb};
use monogrid_geometry::Sim3;
use monogrid_occupancy::{MapFormat, OccupancyMap};
use monogrid_slam::mapping::{KeyframeScan, Mapper, MeshConfig};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// `monogrid map`.
#[derive(Debug, Args)]
pub struct MapArgs {
    /// Recording (.mgk), submaps (submaps.json, or one .mgs in its own frame), the folder of a run, scans (.scans) or a folder in TUM layout with depth images
    pub recording: PathBuf,
    /// Map to write: .ot (probabilities), .bt (occupied, free) or .mgo (exact, small)
    #[arg(long, value_name = "MAP.{ot,bt,mgo}")]
    pub out: PathBuf,
    /// Write a picture of the map as well
    #[arg(long, value_name = "OUT.png")]
    pub png: Option<PathBuf>,
    /// Write the surface of the map as well; in the colours of the keyframes where the map is made of a recording
    #[arg(long, value_name = "OUT.{ply,glb}")]
    pub mesh: Option<PathBuf>,
    #[command(flatten)]
    pub mapping: MappingArgs,
    /// Poses for the depth images of a folder [default: groundtruth.txt in it]
    #[arg(long, value_name = "FILE")]
    pub trajectory: Option<PathBuf>,
    /// Intrinsics and scale of depth images [default: calibration_depth.txt in the folder]
    #[arg(long, value_name = "FILE")]
    pub depth_calibration: Option<PathBuf>,
    /// Build the map in the frame of a reference: a trajectory, or a Sim(3) file
    #[arg(long, value_name = "gt:FILE|sim3:FILE")]
    pub align: Option<String>,
    /// What z is in a map of a recording [default: as in the run beside the recording, else scene]
    #[arg(long, value_name = "scene|first-camera|X,Y,Z", value_parser = Up::parse, allow_hyphen_values = true)]
    pub up: Option<Up>,
    /// Settings, TOML (as config.toml of a run; its section [mapping] is used)
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Change one setting, e.g. --set mapping.update_limits=[-0.6,1.2]
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Complete set of settings to start from [default: default]
    #[arg(long, value_enum)]
    pub profile: Option<Profile>,
    /// Threads of computation [default: all cores]; the result does not depend on it
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
    #[command(flatten)]
    pub force: ForceArg,
    #[command(flatten)]
    pub json: JsonArg,
}

/// `map --json`.
#[derive(Debug, Serialize)]
struct MapReport {
    points: usize,
    scans: usize,
    seconds: f64,
    seconds_per_100k_points: f64,
    wall_seconds: f64,
    resolution: f64,
    leaves: usize,
    bytes_in_memory: usize,
    peak_rss_bytes: Option<u64>,
    file_bytes: u64,
    frame: String,
    threads: usize,
    warnings: Vec<String>,
}

/// A map and what it took.
struct Built {
    map: OccupancyMap,
    points: usize,
    scans: usize,
    cpu: Duration,
    wall: Duration,
    frame: String,
    warnings: Vec<String>,
    look: MeshLook,
}

/// How the surface of a map is written.
struct MeshLook {
    /// Colours of its cells.
    colours: CellColours,
    config: MeshConfig,
    unit: &'static str,
}

impl MeshLook {
    /// Of measurements without images, at poses that were given.
    fn of_given_poses(config: MeshConfig) -> Self {
        Self {
            colours: CellColours::unknown(),
            config,
            unit: "the unit of the poses",
        }
    }
}

/// Builds and writes the map.
pub fn execute(args: &MapArgs) -> CommandResult {
    let threads = use_threads(args.threads)?;
    let files = Files::new(args)?;
    let align = Align::parse(args.align.as_deref(), args.up.unwrap_or_default())?;
    let mut built = match Kind::of(&args.recording)? {
        Kind::Recording => from_recording(args, &align, threads)?,
        Kind::Scans => from_scans(args, &align, threads)?,
        Kind::Folder => from_folder(args, &align, threads)?,
    };
    built.map.pack(threads);
    let file_bytes = files.write(&built)?;
    for warning in &built.warnings {
        eprintln!("warning: {warning}");
    }
    let report = MapReport::new(built, file_bytes, threads);
    if args.json.json {
        print_json(&report)?;
    } else {
        report.print(&args.out);
    }
    Ok(Outcome::Done)
}

/// The files that are asked for.
struct Files {
    map: (OutputFile, MapFormat),
    png: Option<OutputFile>,
    mesh: Option<(OutputFile, MeshFormat)>,
}

impl Files {
    /// Refuses names that cannot be written before anything is built.
    fn new(args: &MapArgs) -> Result<Self, Failure> {
        let format = MapFormat::from_name(&args.out, &MapFormat::MAPS).bad_input()?;
        let inputs = inputs(args)?;
        let file = |path: &Path| OutputFile::new(path, args.force.force, &inputs);
        let mesh = |path: &Path| Ok((file(path)?, MeshFormat::from_name(path)?));
        Ok(Self {
            map: (file(&args.out)?, format),
            png: args.png.as_deref().map(file).transpose()?,
            mesh: args.mesh.as_deref().map(mesh).transpose()?,
        })
    }

    /// Writes them; bytes of the map's file.
    fn write(&self, built: &Built) -> Result<u64, Failure> {
        let (file, format) = &self.map;
        let file_bytes = mapfile::save(&built.map, file, *format)?;
        if let Some(png) = &self.png {
            let cubes = occupied_cubes(&built.map).while_running("the map cannot be drawn")?;
            let picture = render(&cubes, &[], None, &View::default());
            png.write(&encode_png_rgb(&picture))?;
        }
        if let Some((file, format)) = &self.mesh {
            let look = &built.look;
            let mesh = look.colours.mesh(&built.map, &look.config);
            let mesh = mesh.while_running("the surface cannot be made")?;
            file.write_with(|out| format.write(&mesh, look.unit, out))?;
        }
        Ok(file_bytes)
    }
}

impl MapReport {
    fn new(built: Built, file_bytes: u64, threads: usize) -> Self {
        let seconds = built.cpu.as_secs_f64();
        Self {
            points: built.points,
            scans: built.scans,
            seconds,
            seconds_per_100k_points: seconds * 1e5 / built.points.max(1) as f64,
            wall_seconds: built.wall.as_secs_f64(),
            resolution: built.map.resolution(),
            leaves: built.map.leaf_count(),
            bytes_in_memory: built.map.bytes_in_memory(),
            peak_rss_bytes: peak_rss_bytes(),
            file_bytes,
            frame: built.frame,
            threads,
            warnings: built.warnings,
        }
    }

    fn print(&self, map: &Path) {
        println!(
            "{} measurements of {} scans in {:.2} s of CPU ({:.4} s per 100 000)",
            self.points, self.scans, self.seconds, self.seconds_per_100k_points
        );
        println!(
            "{}: cells of {}, {} leaves, {} in memory, {} on disk; {}",
            map.display(),
            self.resolution,
            self.leaves,
            bytes(self.bytes_in_memory as u64),
            bytes(self.file_bytes),
            self.frame
        );
    }
}

/// What is read: the images of a folder too.
fn inputs(args: &MapArgs) -> Result<Inputs, Failure> {
    let inputs = Inputs::of("the recording", &args.recording)
        .and_all("a trajectory", &args.trajectory)
        .and_all("a calibration", &args.depth_calibration)
        .and_all("the settings", &args.config)
        .and_named("the reference", args.align.as_deref());
    Ok(match Kind::of(&args.recording)? {
        Kind::Folder => inputs.and_dataset(&args.recording)?,
        Kind::Recording => inputs.and_all("the recording", files_of(&args.recording)),
        Kind::Scans => inputs,
    })
}

/// What there is to map.
enum Kind {
    Recording,
    Scans,
    Folder,
}

impl Kind {
    fn of(path: &Path) -> Result<Self, Failure> {
        let metadata = std::fs::metadata(path).map_err(|error| {
            Failure::input(format!("{} cannot be read: {error}", path.display()))
        })?;
        if Source::is_at(path) {
            return Ok(Self::Recording);
        }
        if metadata.is_dir() {
            return Ok(Self::Folder);
        }
        match path.extension().and_then(|extension| extension.to_str()) {
            Some("scans") => Ok(Self::Scans),
            _ => Err(Failure::input(format!(
                "{} is neither a recording (.mgk), nor submaps (submaps.json), nor scans (.scans), nor a folder of a run or with depth images",
                path.display()
            ))),
        }
    }
}

/// The settings: those of the recording unless a file or profile is given, then the options.
fn settings(args: &MapArgs, recorded: Option<RunConfig>) -> Result<RunConfig, Failure> {
    let explicit = args.config.is_some() || args.profile.is_some();
    let config = match recorded {
        Some(recorded) if !explicit => recorded,
        _ => RunConfig::resolve_mapping(args.profile, args.config.as_deref())?,
    };
    finish_settings(config, args)
}

/// What the command line says, over everything else.
fn finish_settings(config: RunConfig, args: &MapArgs) -> Result<RunConfig, Failure> {
    let mut config = config.with_settings(&args.set)?;
    config.apply(&args.mapping);
    config.validate()?;
    Ok(config)
}

/// Measures the time of a piece of work on all threads.
struct Stopwatch {
    cpu: Duration,
    wall: Duration,
}

impl Stopwatch {
    fn new() -> Self {
        Self {
            cpu: Duration::ZERO,
            wall: Duration::ZERO,
        }
    }

    fn time<T>(&mut self, work: impl FnOnce() -> T) -> T {
        let (cpu, wall) = (process_cpu(), Instant::now());
        let result = work();
        self.cpu += process_cpu() - cpu;
        self.wall += wall.elapsed();
        result
    }
}

fn from_recording(args: &MapArgs, align: &Align, threads: usize) -> Result<Built, Failure> {
    let recorded = Recorded::read(&args.recording, align)?;
    let config = settings(args, recorded.config.clone())?;
    let mut watch = Stopwatch::new();
    let (scans, built) = watch.time(|| {
        let scans = recorded.scans(&config.mapping, threads);
        let built = recorded.map(&scans, &config.mapping, threads);
        (scans, built)
    });
    let (map, stats, cell) = built.while_running("the map cannot be built")?;
    let colours = match args.mesh {
        Some(_) => recorded.cell_colours(&scans, map.resolution()),
        None => CellColours::unknown(),
    };
    if let Some(cell) = cell {
        eprintln!("{}", cell.reason("map units"));
    }
    let is_metric = recorded.frame.is_aligned || recorded.session.scale == Scale::Metric;
    Ok(Built {
        look: MeshLook {
            colours,
            config: config.mapping.mesh,
            unit: unit_name(is_metric),
        },
        map,
        points: stats.points,
        scans: stats.keyframes,
        cpu: watch.cpu,
        wall: watch.wall,
        frame: recorded.frame.description,
        warnings: recorded.warnings,
    })
}

/// Settings for measurements whose poses and sigmas are given: neither range limit nor uncertainty of
/// the pose, unless asked for.
fn settings_for_given_poses(args: &MapArgs) -> Result<RunConfig, Failure> {
    let mut base = RunConfig::of(args.profile.unwrap_or_default());
    base.mapping.max_range = f64::INFINITY;
    base.mapping.pose_sigma = 0.0;
    base.mapping.pose_sigma_deg = 0.0;
    if args.config.is_some() {
        return settings(args, None);
    }
    finish_settings(base, args)
}

/// The frame of data that has its own poses.
fn given_frame(align: &Align) -> Result<(Sim3, String), Failure> {
    match align {
        Align::Level(_) => Ok((Sim3::identity(), "frame of the given poses".to_owned())),
        Align::Sim3 {
            path,
            target_from_results,
            ..
        } => Ok((
            *target_from_results,
            format!("aligned by {}", path.display()),
        )),
        Align::Map {
            map_from_world,
            description,
            ..
        } => Ok((*map_from_world, description.clone())),
        Align::Trajectory { .. } => Err(Failure::input(
            "--align gt: needs a recording of a run (.mgk); data with given poses can be moved with sim3:FILE",
        )),
    }
}

fn from_scans(args: &MapArgs, align: &Align, threads: usize) -> Result<Built, Failure> {
    let config = settings_for_given_poses(args)?;
    let (map_from_world, frame) = given_frame(align)?;
    let reader = ScansReader::open(&args.recording).bad_input()?;
    let look = MeshLook::of_given_poses(config.mapping.mesh);
    let mapper = Mapper::new(config.mapping, threads);
    let mut map = mapper.empty_map().bad_input()?;
    let mut watch = Stopwatch::new();
    let (mut points, mut scans) = (0, 0);
    for scan in reader {
        let scan = scan.bad_input()?;
        points += watch
            .time(|| {
                let ends: Vec<[f32; 3]> = scan.points.iter().map(|p| p.point_in_sensor).collect();
                let sigmas: Vec<f32> = scan.points.iter().map(|p| p.range_sigma).collect();
                let pose = &scan.world_from_sensor;
                mapper.integrate_points(&mut map, scans, pose, &map_from_world, (&ends, &sigmas))
            })
            .while_running("the map cannot be built")?;
        scans += 1;
    }
    Ok(Built {
        look,
        map,
        points,
        scans: scans as usize,
        cpu: watch.cpu,
        wall: watch.wall,
        frame,
        warnings: Vec::new(),
    })
}

fn from_folder(args: &MapArgs, align: &Align, threads: usize) -> Result<Built, Failure> {
    let folder = PosedDepthFolder::open(
        &args.recording,
        args.depth_calibration.as_deref(),
        args.trajectory.as_deref(),
    )?;
    let config = settings_for_given_poses(args)?;
    let (map_from_world, frame) = given_frame(align)?;
    let look = MeshLook::of_given_poses(config.mapping.mesh);
    let mapper = Mapper::new(config.mapping, threads);
    let mut map = mapper.empty_map().bad_input()?;
    let mut watch = Stopwatch::new();
    let (mut points, mut scans) = (0, 0u32);
    for (entry, pose) in folder.posed()? {
        let depth = folder.read(entry)?;
        points += watch
            .time(|| {
                let (pinhole, config) = (folder.pinhole(), mapper.config());
                let scan = KeyframeScan::from_depth_image(scans, &depth, pinhole, config);
                let map_from_camera = map_from_world * pose.with_scale(1.0);
                mapper.integrate(&mut map, &scan, &map_from_camera)
            })
            .while_running("the map cannot be built")?;
        scans += 1;
    }
    let mut warnings = folder.warnings().to_vec();
    let num_without_pose = folder.num_depths() - scans as usize;
    if num_without_pose > 0 {
        warnings.push(format!(
            "{num_without_pose} depth images have no pose of their time"
        ));
    }
    Ok(Built {
        look,
        map,
        points,
        scans: scans as usize,
        cpu: watch.cpu,
        wall: watch.wall,
        frame,
        warnings,
    })
}
