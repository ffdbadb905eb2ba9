//! `monogrid map`: an occupancy map from a recording, from scans, or from posed depth images.

use crate::commands::maps::posed_depth::PosedDepthFolder;
use crate::commands::{bytes, use_threads, warn};
use clap::Args;
use monogrid_app::args::{MappingArgs, Profile, WriteArgs};
use monogrid_app::config::RunConfig;
use monogrid_app::mapfile;
use monogrid_app::output::{Inputs, OutputFile};
use monogrid_app::process::failure::{Classify, CommandResult, Failure};
use monogrid_app::process::usage::{peak_rss_bytes, process_cpu};
use monogrid_app::recorded::Recorded;
use monogrid_app::run::align::{Align, Up};
use monogrid_app::run::sessions::{Source, files_of};
use monogrid_app::run::summary::unit_name;
use monogrid_datasets::{Scale, ScansReader, encode_png_rgb};
use monogrid_geometry::Sim3;
use monogrid_mapping::{KeyframeScan, Mapper, MeshConfig};
use monogrid_occupancy::{MapFormat, OccupancyMap};
use monogrid_report::picture::voxels::{View, occupied_cubes, render};
use monogrid_report::surface::{CellColours, MeshFormat};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// `monogrid map`.
#[derive(Debug, Args)]
pub struct MapArgs {
    /// Recording (.mgk), submaps (submaps.json, or one .mgs in its own frame), the folder of a run,
    /// scans (.scans) or a folder in TUM layout with depth images
    pub recording: PathBuf,
    /// Map to write: .ot (probabilities), .bt (occupied, free) or .mgo (exact, small)
    #[arg(long, value_name = "MAP.{ot,bt,mgo}")]
    pub out: PathBuf,
    /// Write a picture of the map as well
    #[arg(long, value_name = "OUT.png")]
    pub png: Option<PathBuf>,
    /// Write the surface of the map as well; in the colours of the keyframes where the map is made
    /// of a recording
    #[arg(long, value_name = "OUT.{ply,glb,obj,stl}")]
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
    #[arg(
        long, value_name = "scene|first-camera|X,Y,Z", value_parser = Up::parse,
        allow_hyphen_values = true
    )]
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
    pub write: WriteArgs,
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
    watch: Stopwatch,
    frame: String,
    warnings: Vec<String>,
    /// Colours of the cells, for the surface.
    colours: CellColours,
    mesh: MeshConfig,
    /// Name of the unit of length, for the file of the surface.
    unit: &'static str,
}

/// Builds and writes the map.
pub fn execute(args: &MapArgs) -> CommandResult {
    let threads = use_threads(args.threads)?;
    let (files, kind) = Files::new(args)?;
    let align = Align::parse(args.align.as_deref(), args.up.unwrap_or_default())?;
    let mut built = match kind {
        Kind::Recording => from_recording(args, &align, threads)?,
        Kind::Scans => from_scans(args, &align, threads)?,
        Kind::Folder => from_folder(args, &align, threads)?,
    };
    built.map.pack(threads);
    let file_bytes = files.write(&built)?;
    warn(&built.warnings);
    let report = built.report(file_bytes, threads);
    args.write.json.print(&report, || report.print(&args.out))
}

/// The files that are asked for.
struct Files {
    map: (OutputFile, MapFormat),
    png: Option<OutputFile>,
    mesh: Option<(OutputFile, MeshFormat)>,
}

impl Files {
    /// Refuses names that cannot be written before anything is built; what that will be built of.
    fn new(args: &MapArgs) -> Result<(Self, Kind), Failure> {
        let format = MapFormat::from_name(&args.out, &MapFormat::MAPS).bad_input()?;
        let kind = Kind::of(&args.recording)?;
        let inputs = inputs(args, &kind)?;
        let file = |path: &Path| OutputFile::new(path, args.write.force, &inputs);
        let mesh = |path: &Path| Ok::<_, Failure>((file(path)?, MeshFormat::from_name(path)?));
        let files = Self {
            map: (file(&args.out)?, format),
            png: args.png.as_deref().map(file).transpose()?,
            mesh: args.mesh.as_deref().map(mesh).transpose()?,
        };
        Ok((files, kind))
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
            let mesh = built.colours.mesh(&built.map, &built.mesh);
            let mesh = mesh.while_running("the surface cannot be made")?;
            file.write_with(|out| Ok(format.write(&mesh, (built.unit, "mesh"), out)?))?;
        }
        Ok(file_bytes)
    }
}

impl Built {
    /// Nothing yet of measurements whose poses and sigmas are given; how they are added to the map,
    /// and the frame of the map. There is neither a range limit nor an uncertainty of the pose,
    /// unless asked for.
    fn nothing(
        args: &MapArgs,
        align: &Align,
        threads: usize,
    ) -> Result<(Self, Mapper, Sim3), Failure> {
        let mut usual = RunConfig::of(args.profile.unwrap_or_default());
        usual.mapping.max_range = f64::INFINITY;
        usual.mapping.pose_sigma = 0.0;
        usual.mapping.pose_sigma_deg = 0.0;
        let config = settings(args, Some(usual))?;
        let (map_from_world, frame) = given_frame(align)?;
        let mesh = config.mapping.mesh;
        let mapper = Mapper::new(config.mapping, threads);
        let nothing = Self {
            map: mapper.empty_map().bad_input()?,
            points: 0,
            scans: 0,
            watch: Stopwatch::default(),
            frame,
            warnings: Vec::new(),
            colours: CellColours::unknown(),
            mesh,
            unit: "the unit of the poses",
        };
        Ok((nothing, mapper, map_from_world))
    }

    fn report(self, file_bytes: u64, threads: usize) -> MapReport {
        let seconds = self.watch.cpu.as_secs_f64();
        MapReport {
            points: self.points,
            scans: self.scans,
            seconds,
            seconds_per_100k_points: seconds * 1e5 / self.points.max(1) as f64,
            wall_seconds: self.watch.wall.as_secs_f64(),
            resolution: self.map.resolution(),
            leaves: self.map.leaf_count(),
            bytes_in_memory: self.map.bytes_in_memory(),
            peak_rss_bytes: peak_rss_bytes(),
            file_bytes,
            frame: self.frame,
            threads,
            warnings: self.warnings,
        }
    }
}

impl MapReport {
    fn print(&self, map: &Path) {
        println!(
            "{} measurements of {} scans in {:.2} s of CPU ({:.4} s per 100 000)",
            self.points, self.scans, self.seconds, self.seconds_per_100k_points
        );
        let [memory, disk] = [self.bytes_in_memory as u64, self.file_bytes].map(bytes);
        let map = map.display();
        println!(
            "{map}: cells of {}, {} leaves, {memory} in memory, {disk} on disk; {}",
            self.resolution, self.leaves, self.frame
        );
    }
}

/// What is read: the images of a folder too.
fn inputs(args: &MapArgs, kind: &Kind) -> Result<Inputs, Failure> {
    let inputs = Inputs::of("the recording", &args.recording)
        .and_all("a trajectory", &args.trajectory)
        .and_all("a calibration", &args.depth_calibration)
        .and_all("the settings", &args.config)
        .and_named("the reference", args.align.as_deref());
    Ok(match kind {
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
                "{} is neither a recording (.mgk), nor submaps (submaps.json), nor scans (.scans), \
                 nor a folder of a run or with depth images",
                path.display()
            ))),
        }
    }
}

/// The settings: those of a file where one is named, else the usual ones, else those of the
/// profile; then the options.
fn settings(args: &MapArgs, usual: Option<RunConfig>) -> Result<RunConfig, Failure> {
    let config = match usual {
        Some(usual) if args.config.is_none() => usual,
        _ => RunConfig::resolve_mapping(args.profile, args.config.as_deref())?,
    };
    let mut config = config.with_settings(&args.set)?;
    config.apply(&args.mapping);
    config.validate()?;
    Ok(config)
}

/// Measures the time of a piece of work on all threads.
#[derive(Default)]
struct Stopwatch {
    cpu: Duration,
    wall: Duration,
}

impl Stopwatch {
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
    // a profile that is named is meant instead of the settings of the recording
    let usual = recorded.config.clone().filter(|_| args.profile.is_none());
    let config = settings(args, usual)?;
    let mut watch = Stopwatch::default();
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
        eprintln!("{}", cell.reason("map units", true));
    }
    let is_metric = recorded.frame.is_aligned || recorded.session.scale == Scale::Metric;
    Ok(Built {
        colours,
        mesh: config.mapping.mesh,
        unit: unit_name(is_metric),
        map,
        points: stats.points,
        scans: stats.keyframes,
        watch,
        frame: recorded.frame.description,
        warnings: recorded.warnings,
    })
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
            "--align gt: needs a recording of a run (.mgk); data with given poses can be moved \
             with sim3:FILE",
        )),
    }
}

fn from_scans(args: &MapArgs, align: &Align, threads: usize) -> Result<Built, Failure> {
    let (mut built, mapper, map_from_world) = Built::nothing(args, align, threads)?;
    for (id, scan) in (0..).zip(ScansReader::open(&args.recording).bad_input()?) {
        let scan = scan.bad_input()?;
        let points = built.watch.time(|| {
            let ends: Vec<[f32; 3]> = scan.points.iter().map(|p| p.point_in_sensor).collect();
            let sigmas: Vec<f32> = scan.points.iter().map(|p| p.range_sigma).collect();
            let (map, pose) = (&mut built.map, &scan.world_from_sensor);
            mapper.integrate_points(map, id, pose, &map_from_world, (&ends, &sigmas))
        });
        built.points += points.while_running("the map cannot be built")?;
        built.scans += 1;
    }
    Ok(built)
}

fn from_folder(args: &MapArgs, align: &Align, threads: usize) -> Result<Built, Failure> {
    let folder = PosedDepthFolder::open(
        &args.recording,
        args.depth_calibration.as_deref(),
        args.trajectory.as_deref(),
    )?;
    let (mut built, mapper, map_from_world) = Built::nothing(args, align, threads)?;
    for (id, (entry, pose)) in (0..).zip(folder.posed()?) {
        let depth = folder.read(entry)?;
        let points = built.watch.time(|| {
            let (pinhole, config) = (folder.pinhole, mapper.config());
            let scan = KeyframeScan::from_depth_image(id, &depth, pinhole, config);
            let map_from_camera = map_from_world * pose.with_scale(1.0);
            mapper.integrate(&mut built.map, &scan, &map_from_camera)
        });
        built.points += points.while_running("the map cannot be built")?;
        built.scans += 1;
    }
    let num_without_pose = folder.dataset.depths.len() - built.scans;
    built.warnings = folder.dataset.warnings;
    if num_without_pose > 0 {
        built.warnings.push(format!(
            "{num_without_pose} depth images have no pose of their time"
        ));
    }
    Ok(built)
}
