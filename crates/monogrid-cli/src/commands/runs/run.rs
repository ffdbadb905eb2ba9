//! `monogrid run`: what the command line asks for, put together and checked before anything is
//! computed.

use crate::commands::{use_threads, warn, with_numbers};
use clap::{Args, ValueEnum};
use monogrid_app::args::{JsonArg, MappingArgs, Profile, SourceArgs, memory, positive};
use monogrid_app::camera::refine::refine;
use monogrid_app::config::RunConfig;
use monogrid_app::input::depth_images::{FrameDepths, depth_calibration};
use monogrid_app::input::readings::Inertial;
use monogrid_app::input::seen::Motion;
use monogrid_app::input::{Images, Input};
use monogrid_app::output::{Inputs, OutputFile, OutputFolder};
use monogrid_app::process::console::is_drawn;
use monogrid_app::process::failure::{CommandResult, Failure};
use monogrid_app::process::interrupt::{self, abandonable, is_interrupted};
use monogrid_app::process::memory;
use monogrid_app::run::align::{Align, Up};
use monogrid_app::run::conclusion::conclude;
use monogrid_app::run::sessions::{Continued, Earlier, files_of};
use monogrid_app::run::whole::{Extras, run_all};
use monogrid_app::run::{MemoryLimit, RunSettings, SubmapPolicy, View};
use monogrid_image::WorkingSize;
use monogrid_pipeline::Pace;
use monogrid_slam::{Purpose, SlamConfig};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

/// `monogrid run`.
#[derive(Debug, Args)]
pub struct RunArgs {
    /// Video, camera (/dev/video0), address of a stream, - (YUV4MPEG2 on standard input), folder in
    /// TUM RGB-D or EuRoC layout, or any folder of images
    pub source: PathBuf,
    #[command(flatten)]
    pub input: SourceArgs,
    /// Refine the focal length, the principal point and the radial distortion of the calibration by
    /// a first pass over the video (the camera of a video without calibration always is)
    #[arg(long, conflicts_with = "continue_from", help_heading = "Input")]
    pub refine_calibration: bool,
    /// Go on with the map of an earlier run: recognise the camera in it, extend it; the result
    /// holds both
    #[arg(
        long = "continue",
        value_name = "DIR",
        conflicts_with_all = ["seed_depth", "depth", "stereo"],
        help_heading = "Input"
    )]
    pub continue_from: Option<PathBuf>,
    /// Only track in the map of --continue, which stays as it is; writes the trajectory and no map
    #[arg(long, requires = "continue_from", help_heading = "Input")]
    pub localise_only: bool,
    /// Output folder [default: a new one, runs/NAME or runs/NAME-2 ...]
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    pub out: Option<PathBuf>,
    /// Write into the folder although it holds other files; those of the same names are replaced
    #[arg(long, help_heading = "Output")]
    pub force: bool,
    /// Write the run as messages of ROS 2 too, for Foxglove and Rerun: poses, images and points of
    /// keyframes, the map
    #[arg(
        long,
        value_name = "FILE.mcap",
        conflicts_with = "localise_only",
        help_heading = "Output"
    )]
    pub mcap: Option<PathBuf>,
    #[command(flatten)]
    pub json: JsonArg,
    /// Start from the depth image of the first frame: the dataset's own, or a file; makes the scale
    /// metric
    #[arg(long, value_name = "FILE|dataset", help_heading = "Input")]
    pub seed_depth: Option<String>,
    /// Use the images of a depth camera (RGB-D) with every frame that has one: those of the
    /// dataset; makes the scale metric
    #[arg(
        long,
        value_enum,
        conflicts_with = "seed_depth",
        help_heading = "Input"
    )]
    pub depth: Option<DepthSource>,
    /// Use the images of the second camera of a stereo pair, beside those of the first in the
    /// layout of EuRoC or KITTI; makes the scale metric
    #[arg(
        long,
        conflicts_with_all = ["seed_depth", "depth"],
        help_heading = "Input"
    )]
    pub stereo: bool,
    /// Intrinsics and scale of depth images [default: calibration_depth.txt in the source]
    #[arg(long, value_name = "FILE", help_heading = "Input")]
    pub depth_calibration: Option<PathBuf>,
    /// Settings, TOML (as config.toml of an earlier run)
    #[arg(long, value_name = "FILE", help_heading = "Settings")]
    pub config: Option<PathBuf>,
    /// Change one setting, e.g. --set mapping.resolution=0.02
    #[arg(long, value_name = "KEY=VALUE", help_heading = "Settings")]
    pub set: Vec<String>,
    /// Complete set of settings to start from [default: default]
    #[arg(long, value_enum, help_heading = "Settings")]
    pub profile: Option<Profile>,
    /// Seed of everything random
    #[arg(long, value_name = "N", help_heading = "Settings")]
    pub seed: Option<u64>,
    #[command(flatten)]
    pub mapping: MappingArgs,
    /// Radius of the local map around the camera
    #[arg(long, value_name = "L", value_parser = positive, help_heading = "Mapping")]
    pub local_radius: Option<f64>,
    /// Build the final maps in the frame of a reference: a trajectory, or a Sim(3) file
    #[arg(long, value_name = "gt:FILE|sim3:FILE", help_heading = "Mapping")]
    pub align: Option<String>,
    /// What z is in the results: what the scene says, else as the first camera was held [default:
    /// scene]; or a direction in the first camera (x right, y down, z ahead)
    #[arg(
        long, value_name = "scene|first-camera|X,Y,Z", value_parser = Up::parse,
        allow_hyphen_values = true, conflicts_with = "continue_from", help_heading = "Mapping"
    )]
    pub up: Option<Up>,
    /// Play frames at their own pace; where tracking is slower, they wait for at most this long
    /// before some are dropped, evenly [milliseconds, 0 to 60000: 200]
    #[arg(
        long, value_name = "MS", num_args = 0..=1, default_missing_value = "200",
        require_equals = true, value_parser = clap::value_parser!(u64).range(..=60_000),
        help_heading = "Input"
    )]
    pub realtime: Option<u64>,
    /// Show the run while it goes on: in a browser of this computer [port: any that is free], with
    /// 0.0.0.0:PORT of this network too; with rerun in the Rerun viewer, with rrd=FILE in a file
    /// for it (both by the program monogrid-rerun)
    #[arg(
        long, value_name = "[IP:]PORT|rerun|rrd=FILE", num_args = 0..=1,
        default_missing_value = "0", require_equals = true, value_parser = View::parse,
        help_heading = "Output"
    )]
    pub view: Option<View>,
    /// Threads of computation [default: all cores]; the results do not depend on it
    #[arg(long, value_name = "N", help_heading = "Settings")]
    pub threads: Option<usize>,
    /// Memory to stay within, e.g. 500MB: keyframes lie in a file of the output folder as far as
    /// there is no room; the results do not depend on it
    #[arg(long, value_name = "SIZE", value_parser = memory, help_heading = "Settings")]
    pub memory_limit: Option<u64>,
    /// Close finished keyframes into files that never change while the run goes on, beside the
    /// recording: submaps/*.mgs, and submaps/submaps.json, which says where they lie [keyframes of
    /// each, 1 to 1000: 16]
    #[arg(
        long, value_name = "N", num_args = 0..=1, default_missing_value = "16",
        require_equals = true, value_parser = clap::value_parser!(u16).range(1..=1000),
        conflicts_with = "localise_only", help_heading = "Output"
    )]
    pub submaps: Option<u16>,
}

/// The command `run` alone, for options that stand in a list.
pub fn command() -> clap::Command {
    with_numbers(RunArgs::augment_args(clap::Command::new("run")))
}

/// Where the depth of frames comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum DepthSource {
    /// The dataset's own depth images, registered by their calibration
    Dataset,
}

/// Runs the command.
pub fn execute(args: &RunArgs) -> CommandResult {
    if args.memory_limit.is_some() {
        memory::keep_little();
    }
    let threads = use_threads(args.threads)?;
    if let Some(view) = &args.view {
        view.check(args.force)?;
    }
    let continue_from = args.continue_from.as_deref();
    let earlier = continue_from.map(Earlier::read).transpose()?;
    let config = configuration(args, earlier.as_ref())?;
    let align = alignment(args, earlier.as_ref())?;
    interrupt::listen();
    let input = open(args, earlier.as_ref(), &config)?;
    let depth = depths(&input, args)?;
    let inputs = inputs(args, &input, &config);
    let out = args.out.as_deref();
    let file = |path: &PathBuf| OutputFile::of_folder(out, path, args.force, &inputs);
    let mcap = args.mcap.as_ref().map(file).transpose()?;
    let folder = OutputFolder::named_or_new(out, &input.name, args.force, &inputs)?;
    let folder = Arc::new(folder);
    let settings = RunSettings {
        mcap,
        depth,
        continued: earlier.map(|earlier| Continued {
            earlier,
            purpose: match args.localise_only {
                true => Purpose::LocaliseOnly,
                false => Purpose::Extend,
            },
        }),
        pace: args.realtime.map_or(Pace::Taken, |ms| Pace::Real {
            max_wait: Duration::from_millis(ms),
        }),
        show_progress: is_drawn(),
        view: args.view.clone(),
        memory_limit: args.memory_limit.map(MemoryLimit),
        submaps: args.submaps.map(|n| SubmapPolicy::of(usize::from(n))),
        ..RunSettings::new(config, threads)
    };
    describe_input(&input);
    // what is assumed because nobody waited is no calibration for the next run
    if let Some(own) = &input.own_calibration
        && !is_interrupted()
    {
        let (name, content) = own.file();
        folder.write(name, content)?;
    }
    let finished = run_all(&input, &folder, &settings, &align, |_, _| {
        Ok(Extras::default())
    })?;
    conclude(&finished, &folder, args.json.json)
}

/// All settings; options of the command line win.
pub fn configuration(args: &RunArgs, earlier: Option<&Earlier>) -> Result<RunConfig, Failure> {
    let mut config = base_configuration(args, earlier)?;
    let lag_frames = &mut config.slam.graph.lag_frames;
    if args.realtime.is_some() && *lag_frames == SlamConfig::default().graph.lag_frames {
        *lag_frames = REALTIME_LAG_FRAMES;
    }
    let mut config = config.with_settings(&args.set)?;
    config.apply(&args.mapping);
    if let Some(radius) = args.local_radius {
        config.mapping.local_radius = radius;
    }
    if let Some(seed) = args.seed {
        config.seed = seed;
    }
    config.validate()?;
    Ok(config)
}

/// `slam.graph.lag_frames` with `--realtime`, where nothing else is asked for: an optimisation that
/// takes longer than the usual lag lets no frame wait.
const REALTIME_LAG_FRAMES: usize = 8;

/// Profile and file; the settings of the continued run where no profile or file is named.
fn base_configuration(args: &RunArgs, earlier: Option<&Earlier>) -> Result<RunConfig, Failure> {
    if let Some(earlier) = earlier
        && args.config.is_none()
        && args.profile.is_none()
    {
        return RunConfig::recorded(&earlier.session.config).ok_or_else(|| {
            Failure::input(format!(
                "the settings in {} cannot be understood by this version; choose some with \
                 --profile or --config",
                earlier.path.display()
            ))
        });
    }
    RunConfig::resolve(args.profile, args.config.as_deref(), &[])
}

/// What `--align` and `--up` say, else the frame of the continued run.
fn alignment(args: &RunArgs, earlier: Option<&Earlier>) -> Result<Align, Failure> {
    let align = Align::parse(args.align.as_deref(), args.up.unwrap_or_default())?;
    let Some(earlier) = earlier else {
        return Ok(align);
    };
    let known = earlier.frame.clone();
    let known = known.unwrap_or(Align::Level(Up::FirstCamera));
    Ok(align.in_known_frame(match args.localise_only {
        true => known,
        false => known.of_grown_map(),
    }))
}

/// The source, with images of the size of the continued run; a camera that nobody gave is refined.
fn open(args: &RunArgs, earlier: Option<&Earlier>, config: &RunConfig) -> Result<Input, Failure> {
    let Some(earlier) = earlier else {
        let mut input = open_source(args, args.input.clone(), config.working_size())?;
        if args.stereo {
            without_shutter(&mut input)?;
        }
        // what is seen only once has no first pass
        let may_be_refined = args.input.fov.is_none() && input.is_repeatable();
        let is_own = input.own_calibration.is_some() && may_be_refined;
        if args.refine_calibration && !input.is_repeatable() {
            return Err(Failure::input(
                "--refine-calibration: found a stream, which is seen only once; expected a file, \
                 for a first pass",
            ));
        }
        if args.seed_depth.is_none() && args.depth.is_none() && !args.stereo {
            let looked = abandonable("looking", move || {
                input.motion = Motion::of(&input);
                input
            });
            input = looked?;
        }
        if (args.refine_calibration || is_own) && input.no_map().is_none() {
            let config = config.clone();
            let refined = abandonable("first pass", move || {
                refine(&mut input, &config).map(|()| input)
            });
            return refined?;
        }
        return Ok(input);
    };
    let mut source = args.input.clone();
    let size = (earlier.session.width, earlier.session.height);
    source.size = source.size.or(Some(size));
    let mut input = open_source(args, source, config.working_size())?;
    earlier.check_camera(&input.preparation, &input.name)?;
    input.warnings.extend(earlier.warnings.iter().cloned());
    Ok(input)
}

/// Opens the source, and estimates its camera where nobody gave it; an interrupt ends that.
fn open_source(args: &RunArgs, how: SourceArgs, usual: WorkingSize) -> Result<Input, Failure> {
    let source = args.source.clone();
    abandonable("opening", move || Input::open(&source, &how, usual))?
}

/// The depth of frames: of all that have some, or of the first.
fn depths(input: &Input, args: &RunArgs) -> Result<Option<FrameDepths>, Failure> {
    if args.stereo {
        return stereo(input, args).map(Some);
    }
    let calibration_file = args.depth_calibration.as_deref();
    let (option, at_most) = match (&args.seed_depth, args.depth) {
        (None, None) => return Ok(None),
        (None, Some(DepthSource::Dataset)) => ("--depth", usize::MAX),
        (Some(_), _) => ("--seed-depth", 1),
    };
    if let (Some(file), Images::Files(dataset)) = (&args.seed_depth, &input.images)
        && file != "dataset"
    {
        let calibration = depth_calibration(dataset, calibration_file, input.camera())?;
        return FrameDepths::of_file(input, Path::new(file), calibration);
    }
    let depths = FrameDepths::of_dataset(input, calibration_file, at_most)?;
    match &depths {
        Some(found) if at_most > 1 => {
            eprintln!("depth: {} of the frames have a depth image", found.count());
        }
        Some(_) => {}
        None => {
            return Err(Failure::input(format!(
                "{option} dataset: {} has no depth image for any of the frames to use",
                input.name
            )));
        }
    }
    Ok(depths)
}

/// A rolling shutter is taken out of the images of the first camera alone, which would then be of
/// another time than those of the second: for a pair there is none, and none is looked for.
fn without_shutter(input: &mut Input) -> Result<(), Failure> {
    let readout_ms = input.preparation.readout_ms();
    if readout_ms != 0.0 {
        return Err(Failure::input(format!(
            "--stereo: found a rolling shutter of {readout_ms} ms, expected cameras that read all \
             rows at once (--rolling-shutter 0)"
        )));
    }
    input.is_shutter_known = true;
    Ok(())
}

/// The images of the second camera of a stereo pair.
fn stereo(input: &Input, args: &RunArgs) -> Result<FrameDepths, Failure> {
    let pairs = FrameDepths::of_stereo(input, args.input.calibration.as_deref())?;
    let pairs = pairs.ok_or_else(|| {
        Failure::input(format!(
            "--stereo: {} has no second image for any of the frames to use; expected one of the \
             same name in the folder of another camera (cam0 and cam1, image_0 and image_1)",
            input.name
        ))
    })?;
    eprintln!(
        "stereo: {} of the frames have a second image",
        pairs.count()
    );
    Ok(pairs)
}

/// All that is read, and so must not be written.
fn inputs(args: &RunArgs, input: &Input, config: &RunConfig) -> Inputs {
    let inputs = inputs_of_options(args, Some(config)).and("the source", &args.source);
    match &input.images {
        Images::Files(dataset) => inputs.and_files_of(dataset),
        _ => inputs,
    }
}

/// What options and settings name to be read; without the settings, where they are not understood.
pub fn inputs_of_options(args: &RunArgs, config: Option<&RunConfig>) -> Inputs {
    let vocabulary = config.map(|config| &config.slam.graph.places.vocabulary);
    let seed_depth = args.seed_depth.iter().filter(|depth| *depth != "dataset");
    let earlier = args.continue_from.iter().flat_map(|run| files_of(run));
    let mount = &args.input.imu_from_camera;
    let imu = args.input.imu.iter();
    let imu = imu.filter(|imu| *imu != Path::new("none"));
    Inputs::default()
        .and_all("the calibration", &args.input.calibration)
        .and_all("the mask", &args.input.mask)
        .and_all("the run to continue", &args.continue_from)
        .and_all("the run to continue", earlier)
        .and_all("the depth to start with", seed_depth)
        .and_all("the calibration of depth images", &args.depth_calibration)
        .and_all("the settings", &args.config)
        .and_all("the inertial readings", imu)
        .and_all("the mount of the inertial sensor", mount)
        .and_all("the vocabulary", vocabulary)
        .and_named("the reference", args.align.as_deref())
}

fn describe_input(input: &Input) {
    let ((width, height), camera) = (input.size(), input.camera());
    let frames = input.expected_frames();
    let frames = frames.map_or_else(|| "frames".to_owned(), |frames| format!("{frames} frames"));
    eprintln!(
        "{}: {frames} of {}x{} pixels, working size {width}x{height}",
        input.name, camera.width, camera.height
    );
    if !input.interpretation.is_empty() {
        eprintln!("calibration: {}", input.interpretation);
    }
    if let Some(inertial) = &input.inertial {
        let (path, said) = (inertial.path.display(), &inertial.interpretation);
        eprintln!("inertial readings: {path}: {said}");
    }
    warn(&input.warnings);
    let findings = input.inertial.iter().flat_map(Inertial::findings);
    warn(&findings.collect::<Vec<_>>());
}

#[cfg(test)]
mod tests {
    use super::{REALTIME_LAG_FRAMES, configuration};
    use crate::cli::{Cli, Command};

    /// `slam.graph.lag_frames` of a run with these options.
    fn lag_frames(options: &[&str]) -> usize {
        let words = ["monogrid", "run", "video"].iter().chain(options);
        let cli = Cli::parse(words.map(Into::into)).unwrap();
        let Command::Run(args) = &cli.command else {
            panic!("another command");
        };
        let config = configuration(args, None).unwrap();
        config.slam.graph.lag_frames
    }

    #[test]
    fn a_stream_waits_longer_for_the_graph_unless_it_is_told_how_long() {
        let usual = lag_frames(&[]);
        assert!(usual < REALTIME_LAG_FRAMES);
        assert_eq!(lag_frames(&["--realtime"]), REALTIME_LAG_FRAMES);
        let told = format!("slam.graph.lag_frames={usual}");
        assert_eq!(lag_frames(&["--realtime", "--set", &told]), usual);
    }
}
