//! `monogrid synth`: a synthetic dataset in TUM layout with exact depth, poses and truth map.

use crate::commands::evaluate::truth::{config_for, of_world, positions_along};
use crate::commands::use_threads;
use anyhow::Context as _;
use clap::{Args, ValueEnum};
use monogrid_app::args::{JsonArg, frame_rate, positive, readout_ms, size};
use monogrid_app::output::{Inputs, OutputFolder};
use monogrid_app::process::console::is_drawn;
use monogrid_app::process::failure::{Classify, CommandResult, Failure};
use monogrid_app::run::tracking::progress::watched;
use monogrid_datasets::{Calibration, read_trajectory};
use monogrid_geometry::{Camera, Distortion, Pinhole};
use monogrid_occupancy::MapFormat;
use monogrid_worlds::{
    CameraPath, EffectsConfig, ImuConfig, LightingConfig, MOTION_NAMES, MeshLighting, Motion,
    SynthConfig, SynthSequence, WORLD_NAMES, World, WriteConfig, usual_frames, write_sequence_imu,
    write_tum_layout,
};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;

/// What a real camera does to the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum NoiseArg {
    /// A perfect camera
    Off,
    /// Noise of the sensor and changing exposure, as in `monogrid demo`
    Demo,
    /// Also vignette, motion blur, rolling shutter, lost frames, and somebody who walks by
    Harsh,
}

/// Number of frames: at most four days of video.
fn frame_count(text: &str) -> Result<usize, String> {
    let frames = text.parse().ok().filter(|n| (1..=10_000_000).contains(n));
    frames.ok_or_else(|| "expected 1 to 10000000".to_owned())
}

/// `monogrid synth`.
#[derive(Debug, Args)]
pub struct SynthArgs {
    /// Built-in world (living-room, office, machine-hall, corridor-loop, blank-walls, stairs,
    /// street) or a mesh (.ply, .obj) together with --trajectory
    pub world: PathBuf,
    /// Output folder
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Write into the folder although it holds other files; those of the same names are replaced
    #[arg(long)]
    pub force: bool,
    /// Built-in motion: hand, drone, car, hand-back, drone-back, car-back [default: hand; in the
    /// street, car]
    #[arg(long, value_name = "NAME", conflicts_with = "trajectory")]
    pub motion: Option<String>,
    /// Motion of the camera: poses in the frame of the world
    #[arg(long, value_name = "FILE")]
    pub trajectory: Option<PathBuf>,
    /// Number of frames; the built-in motion takes as long as they do [default: at walking pace]
    #[arg(long, value_name = "N", value_parser = frame_count)]
    pub frames: Option<usize>,
    /// Write only this many of them, the beginning of the motion
    #[arg(long, value_name = "N", value_parser = frame_count)]
    pub max_frames: Option<usize>,
    /// Frames per second
    #[arg(long, value_name = "N", value_parser = frame_rate, default_value_t = 30.0)]
    pub fps: f64,
    /// Size of the images, 65 degrees wide
    #[arg(long, value_name = "WxH", value_parser = size, default_value = "640x480")]
    pub size: (usize, usize),
    /// The camera, with its size, field of view and distortion
    #[arg(long, value_name = "FILE", conflicts_with = "size")]
    pub calibration: Option<PathBuf>,
    /// Effects of a real camera
    #[arg(long, value_enum, default_value = "demo")]
    pub noise: NoiseArg,
    /// Time from the first row to the last, milliseconds [default: 0, or 20 with --noise harsh]
    #[arg(long, value_name = "MS", value_parser = readout_ms)]
    pub rolling_shutter: Option<f64>,
    /// Seed of noise, exposure and unsteadiness
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// A depth image with every n-th frame; 0 for none
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub depth_every: usize,
    /// Edge of the cells of the truth map truth.ot
    #[arg(long, value_name = "L", value_parser = positive, default_value_t = 0.05)]
    pub truth_resolution: f64,
    /// Write the readings of an inertial sensor beside the camera too, as mav0/imu0 in EuRoC's
    /// layout, with the errors of a phone's
    #[arg(long)]
    pub imu: bool,
    /// Write the images of a second camera too, so far to the right, metres; for a camera without
    /// a lens
    #[arg(long, value_name = "M", value_parser = positive)]
    pub stereo: Option<f64>,
    /// Light the world coarsely, in a moment
    #[arg(long)]
    pub quick_light: bool,
    /// Threads of computation [default: all cores]; the result does not depend on it
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
    #[command(flatten)]
    pub json: JsonArg,
}

/// `synth --json`.
#[derive(Debug, Serialize)]
struct SynthReport {
    world: String,
    frames: usize,
    depth_images: usize,
    seconds_of_video: f64,
    inertial_readings: usize,
    path_length: f64,
    truth_occupied: u64,
    truth_free: u64,
    out: PathBuf,
}

/// Control poses per second of a recorded motion: keeps a hand's motion, drops the tracker's noise.
const RECORDED_KNOTS_HZ: f64 = 20.0;

/// Renders and writes the dataset.
pub fn execute(args: &SynthArgs) -> CommandResult {
    use_threads(args.threads)?;
    let motion = motion(args)?;
    let recorded = recorded_path(args)?;
    check_world(args)?;
    let inputs = Inputs::of("the mesh", &args.world)
        .and_all("the motion", &args.trajectory)
        .and_all("the calibration", &args.calibration);
    let camera = camera(args)?;
    if args.stereo.is_some() && camera.distortion != Distortion::None {
        return Err(Failure::input(
            "--stereo: found a calibration with a lens, expected one without distortion",
        ));
    }
    let folder = OutputFolder::replace(&args.out, args.force, &inputs)?;
    let world = world(args)?;
    let config = SynthConfig {
        camera,
        fps: args.fps,
        frames: frames(args, recorded.as_ref()),
        effects: effects(args),
        seed: args.seed,
    };
    let path = match recorded {
        Some(path) => path,
        None => SynthSequence::path_for(world.name(), motion, &config).bad_input()?,
    };
    let sequence = SynthSequence::new(Arc::new(world), path, config)
        .bad_input()?
        .shortened(args.max_frames.unwrap_or(usize::MAX));
    write(args, &folder, &sequence)
}

fn write(args: &SynthArgs, folder: &OutputFolder, sequence: &SynthSequence) -> CommandResult {
    // first, because it says at once when the motion leaves the world
    let cameras = positions_along(sequence.path());
    let config = config_for(&args.world, args.truth_resolution);
    let truth = of_world(sequence.world(), &cameras, &config)?;
    if truth.reaches_border {
        eprintln!("warning: the world is open: the outside counts as free in truth.ot");
    }
    let map = truth.grid.to_map().while_running("the truth map")?;
    folder.write_with("truth.ot", |mut out| {
        Ok(MapFormat::Ot.write(&map, &mut out)?)
    })?;
    let config = WriteConfig {
        depth_every: args.depth_every,
        with_mesh: true,
        baseline_m: args.stereo.unwrap_or(0.0),
    };
    let what = ("rendering", "frames", sequence.len());
    let is_terminal = is_drawn();
    let written = watched(
        what,
        is_terminal,
        || {},
        |done| {
            write_tum_layout(sequence, folder.path(), &config, |count| {
                done.store(count, Ordering::Relaxed);
            })
        },
    );
    let readings = match args.imu {
        true => write_sequence_imu(sequence, folder.path(), &ImuConfig::default()),
        false => Ok(0),
    };
    // what there is of it is ours, whole or not
    folder.list_new()?;
    written.while_running("the dataset cannot be written")?;
    let inertial_readings = readings.while_running("the inertial readings cannot be written")?;
    let counts = truth.grid.counts();
    let report = SynthReport {
        world: sequence.world().name().to_owned(),
        frames: sequence.len(),
        depth_images: match args.depth_every {
            0 => 0,
            every => sequence.len().div_ceil(every),
        },
        seconds_of_video: sequence.config().frames as f64 / args.fps,
        inertial_readings,
        path_length: sequence.path().length_m(args.fps),
        truth_occupied: counts.occupied,
        truth_free: counts.free,
        out: args.out.clone(),
    };
    args.json.print(&report, || {
        let (out, length) = (args.out.display(), report.path_length);
        println!(
            "{out}: {} frames and {} depth images of {}, {length:.1} m in {:.1} s",
            report.frames, report.depth_images, report.world, report.seconds_of_video
        );
        println!(
            "truth.ot: {} occupied and {} free cells of {}",
            report.truth_occupied, report.truth_free, args.truth_resolution
        );
    })
}

/// Whether a world is asked for by the name of a mesh file.
pub fn is_mesh(world: &Path) -> bool {
    let extension = world.extension().unwrap_or_default();
    let is = |name| extension.eq_ignore_ascii_case(name);
    is("ply") || is("obj") || is("stl")
}

/// Refuses worlds that cannot be, before the output folder is touched.
fn check_world(args: &SynthArgs) -> Result<(), Failure> {
    let name = &*args.world.to_string_lossy();
    Err(Failure::input(match is_mesh(&args.world) {
        true if !args.world.is_file() => format!("mesh {name} does not exist"),
        true if args.trajectory.is_none() => {
            format!("the mesh {name} has no motion of its own: give one with --trajectory FILE")
        }
        false if !WORLD_NAMES.contains(&name) => format!(
            "{name} is neither a built-in world ({}) nor a mesh (.ply, .obj)",
            WORLD_NAMES.join(", ")
        ),
        _ => return Ok(()),
    }))
}

fn motion(args: &SynthArgs) -> Result<Motion, Failure> {
    let usual = match args.world.to_str() {
        Some("street") => "car",
        _ => "hand",
    };
    let name = args.motion.as_deref().unwrap_or(usual);
    Motion::by_name(name).ok_or_else(|| {
        Failure::input(format!(
            "--motion is {name:?}, expected one of {}",
            MOTION_NAMES.join(", ")
        ))
    })
}

fn recorded_path(args: &SynthArgs) -> Result<Option<CameraPath>, Failure> {
    let Some(file) = &args.trajectory else {
        return Ok(None);
    };
    let poses = read_trajectory(file).bad_input()?;
    let path = CameraPath::recorded(&poses, RECORDED_KNOTS_HZ)
        .with_context(|| format!("trajectory {}", file.display()));
    path.map(Some).map_err(Failure::Input)
}

fn world(args: &SynthArgs) -> Result<World, Failure> {
    if is_mesh(&args.world) {
        return World::from_file(&args.world, MeshLighting::default()).bad_input();
    }
    let lighting = match args.quick_light {
        true => LightingConfig::quick(),
        false => LightingConfig::default(),
    };
    World::by_name_with(&args.world.to_string_lossy(), &lighting).bad_input()
}

/// The camera that was given, else that of the demonstration at another size: the same view across.
fn camera(args: &SynthArgs) -> Result<Camera, Failure> {
    if let Some(path) = &args.calibration {
        return Ok(Calibration::read(path, None).bad_input()?.camera);
    }
    let (width, height) = args.size;
    let demo = SynthConfig::demo().camera;
    let focal_px = demo.pinhole.fx * width as f64 / demo.width as f64;
    Ok(Camera {
        width,
        height,
        pinhole: Pinhole::centred(focal_px, width, height),
        ..demo
    })
}

fn frames(args: &SynthArgs, recorded: Option<&CameraPath>) -> usize {
    args.frames.unwrap_or_else(|| match recorded {
        Some(path) => (path.duration_secs() * args.fps).floor() as usize + 1,
        None => {
            let usual = usual_frames(&args.world.to_string_lossy());
            (usual as f64 * args.fps / 30.0).ceil() as usize
        }
    })
}

fn effects(args: &SynthArgs) -> EffectsConfig {
    let effects = match args.noise {
        NoiseArg::Off => EffectsConfig::default(),
        NoiseArg::Demo => EffectsConfig::demo(),
        NoiseArg::Harsh => EffectsConfig::harsh(),
    };
    let readout_secs = args.rolling_shutter.map(|ms| ms / 1e3);
    EffectsConfig {
        readout_secs: readout_secs.unwrap_or(effects.readout_secs),
        ..effects
    }
}
