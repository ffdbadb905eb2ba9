//! The command line: every command, option and default, as `--help` shows them.

use crate::commands::evaluate_map::{EvaluateMapArgs, EvaluatePathsArgs};
use crate::commands::sensor_model::SensorModelArgs;
use crate::commands::slice::SliceArgs;
use crate::commands::sweep::SweepArgs;
use crate::commands::synth::SynthArgs;
use crate::commands::tools::{CropArgs, DiffArgs, MergeArgs, ProjectArgs, TransformArgs};
use crate::commands::truth::TruthArgs;
use crate::commands::vocabulary::VocabularyArgs;
use clap::{Args, Parser, Subcommand, ValueEnum};
use std::path::PathBuf;

/// From the video of one camera to a 3D occupancy map.
#[derive(Debug, Parser)]
#[command(name = "monogrid", version, arg_required_else_help = true, after_help = EXIT_CODES)]
pub struct Cli {
    /// What to do
    #[command(subcommand)]
    pub command: Command,
}

const EXIT_CODES: &str = "\
Exit codes: 0 done, 1 failed while running, 2 wrong usage or bad input,
3 finished, but tracking never started or was lost for good (what was mapped is saved).

First steps:  monogrid demo
              monogrid run my-images/ --calibration camera.toml";

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Render a built-in world, run the whole system on it, evaluate against the exact truth
    #[command(after_help = "Example: monogrid demo --out demo")]
    Demo(DemoArgs),
    /// Turn an image sequence into a trajectory, keyframes with depth and an occupancy map
    #[command(
        after_help = "Example: monogrid run recordings/kitchen --out runs/kitchen --resolution 0.02"
    )]
    Run(Box<RunArgs>),
    /// Read a source without running: size, rate, calibration, what would hurt tracking
    #[command(after_help = "Example: monogrid check recordings/kitchen")]
    Check(CheckArgs),
    /// Build an occupancy map from a recording, or from poses and depth from anywhere
    #[command(
        after_help = "Example: monogrid map runs/kitchen/recording.mgk --out kitchen.ot --resolution 0.02"
    )]
    Map(MapArgs),
    /// Ground-truth map of a mesh, a point cloud, a built-in world, or posed depth images
    #[command(
        after_help = "Example: monogrid truth room.ply --trajectory groundtruth.txt --resolution 0.02 --out truth.ot"
    )]
    Truth(TruthArgs),
    /// Synthetic dataset in TUM layout with exact depth, poses and truth map
    #[command(after_help = "Example: monogrid synth office --out recordings/office --frames 600")]
    Synth(SynthArgs),
    /// The thesis' experiments: every resolution, sensor model and parameter, with tables and figures
    #[command(
        after_help = "Example: monogrid sweep runs/room/recording.mgk --truth truth.ot --align gt:groundtruth.txt --out sweeps/room"
    )]
    Sweep(SweepArgs),
    /// Curves of the inverse sensor models: probability over range, for any parameters
    #[command(after_help = "Example: monogrid sensor-model --plot curves")]
    SensorModel(SensorModelArgs),
    /// Grey pictures of the layers of a map
    #[command(after_help = "Example: monogrid slice kitchen.ot slices --leaves")]
    Slice(SliceArgs),
    /// Facts about a map
    #[command(after_help = "Example: monogrid info kitchen.bt")]
    Info(InfoArgs),
    /// Convert a map: .ot, .bt and .mgo to .ot, .bt, .mgo, .ply or .pcd
    #[command(after_help = "Example: monogrid convert kitchen.ot kitchen.ply")]
    Convert(ConvertArgs),
    /// Move, turn and scale a map
    #[command(
        after_help = "Example: monogrid transform kitchen.ot moved.ot --sim3 world_from_kitchen.txt"
    )]
    Transform(TransformArgs),
    /// Keep the cells of a map that touch a box
    #[command(after_help = "Example: monogrid crop house.ot kitchen.ot --min -1,0,0 --max 2,3,2.5")]
    Crop(CropArgs),
    /// Add the log-odds of two maps, as if both had been measured into one
    #[command(after_help = "Example: monogrid merge morning.ot evening.ot --out day.ot")]
    Merge(MergeArgs),
    /// Count the cells whose state differs between two maps
    #[command(after_help = "Example: monogrid diff morning.ot evening.ot")]
    Diff(DiffArgs),
    /// Map seen from above as .pgm and .yaml for nav2's map server
    #[command(
        after_help = "Example: monogrid project kitchen.ot kitchen.pgm --min-height 0.1 --max-height 1.5"
    )]
    Project(ProjectArgs),
    /// Train the words by which FAB-MAP knows places, on images of many places
    #[command(
        after_help = "Example: monogrid vocabulary recordings/kitchen recordings/office --every 10 --out places.vocabulary"
    )]
    Vocabulary(VocabularyArgs),
    /// Compare a result with the truth
    #[command(subcommand)]
    Evaluate(EvaluateCommand),
}

/// What to evaluate.
#[derive(Debug, Subcommand)]
pub enum EvaluateCommand {
    /// Errors of a trajectory (ATE, RPE, scale drift), as `evo` computes them
    #[command(
        after_help = "Example: monogrid evaluate trajectory runs/kitchen/trajectory.txt groundtruth.txt --align sim3"
    )]
    Trajectory(EvaluateTrajectoryArgs),
    /// Inverse depth of the keyframes of a recording, and its variance, against true depth
    #[command(
        after_help = "Example: monogrid evaluate depth runs/kitchen/recording.mgk recordings/kitchen"
    )]
    Depth(EvaluateDepthArgs),
    /// Cells of a map against the true map: ROC, MCC, calibration, surface, four rules for unknown
    #[command(after_help = "Example: monogrid evaluate map runs/kitchen/global.ot truth.ot")]
    Map(EvaluateMapArgs),
    /// Can a robot plan on the map, and are its plans safe in the true map
    #[command(
        after_help = "Example: monogrid evaluate paths runs/kitchen/global.ot truth.ot --robot-radius 0.2"
    )]
    Paths(EvaluatePathsArgs),
}

/// Output for programs.
#[derive(Debug, Clone, Copy, Default, Args)]
pub struct JsonArg {
    /// Print one JSON object to standard output
    #[arg(long)]
    pub json: bool,
}

/// The two complete configurations.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ProfileArg {
    /// The best we know
    Default,
    /// LSD-SLAM and the mapping rules of the thesis
    Thesis,
}

/// Inverse sensor models.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum SensorModelArg {
    /// Ideal sensor convolved with the Gaussian of the range
    Thrun,
    /// Andert's model for stereo cameras
    Andert,
    /// Free before, occupied at the measured range
    Ideal,
    /// End points only, no free space
    None,
}

/// How measurements are combined.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum IntegrationArg {
    /// One update per cell and keyframe
    Fused,
    /// Every measurement updates every cell that it crosses
    Rays,
}

/// A length or "chosen from the data".
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum AutoOr {
    /// From the resolution and the uncertainty of each measurement
    Auto,
    /// A fixed value
    Value(f64),
}

/// Sensor model and map options shared by `run` and `map`.
#[derive(Debug, Clone, Default, Args)]
pub struct MappingArgs {
    /// Inverse sensor model [default: thrun]
    #[arg(long, value_enum, help_heading = "Mapping")]
    pub sensor_model: Option<SensorModelArg>,
    /// Edge length of a cell, in metres or map units [default: 0.05]
    #[arg(long, value_name = "L", value_parser = positive, help_heading = "Mapping")]
    pub resolution: Option<f64>,
    /// Thickness L of the occupied band of the models ideal and thrun [default: auto]
    #[arg(long, value_name = "L|auto", value_parser = auto_or_positive, help_heading = "Mapping")]
    pub buffer: Option<AutoOr>,
    /// Significance k of the model andert [default: auto]
    #[arg(long, value_name = "K|auto", value_parser = auto_or_positive, help_heading = "Mapping")]
    pub significance: Option<AutoOr>,
    /// How measurements are combined [default: fused]
    #[arg(long, value_enum, help_heading = "Mapping")]
    pub integration: Option<IntegrationArg>,
    /// Ignore measurements farther away than this
    #[arg(long, value_name = "L", value_parser = positive, help_heading = "Mapping")]
    pub max_range: Option<f64>,
}

/// Options of `run` that say what to read.
#[derive(Debug, Clone, Default, Args)]
pub struct SourceArgs {
    /// Camera calibration [default: calibration.toml or calibration.txt in the source]
    #[arg(long, value_name = "FILE", help_heading = "Input")]
    pub calibration: Option<PathBuf>,
    /// First frame to use
    #[arg(long, value_name = "N", default_value_t = 0, help_heading = "Input")]
    pub start: usize,
    /// Use at most this many frames
    #[arg(long, value_name = "N", help_heading = "Input")]
    pub max_frames: Option<usize>,
    /// Frame rate of a folder of images without timestamps [default: 30]
    #[arg(long, value_name = "N", value_parser = positive, help_heading = "Input")]
    pub fps: Option<f64>,
    /// Working size of the images [default: about as many pixels as 640x480]
    #[arg(long, value_name = "WxH", value_parser = size, help_heading = "Input")]
    pub size: Option<(usize, usize)>,
    /// Image of the size of the input, black where pixels must be ignored
    #[arg(long, value_name = "FILE", help_heading = "Input")]
    pub mask: Option<PathBuf>,
}

/// `monogrid run`.
#[derive(Debug, Args)]
pub struct RunArgs {
    /// Folder in TUM RGB-D or EuRoC layout, or any folder of images
    pub source: PathBuf,
    #[command(flatten)]
    pub input: SourceArgs,
    /// Go on with the map of an earlier run: recognise the camera in it, extend it; the result holds both
    #[arg(
        long = "continue",
        value_name = "DIR",
        conflicts_with = "seed_depth",
        help_heading = "Input"
    )]
    pub continue_from: Option<PathBuf>,
    /// Only track in the map of --continue, which stays as it is; writes the trajectory and no map
    #[arg(long, requires = "continue_from", help_heading = "Input")]
    pub localise_only: bool,
    /// Output folder [default: runs/NAME]
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    pub out: Option<PathBuf>,
    /// Replace the output folder even if monogrid did not write it
    #[arg(long, help_heading = "Output")]
    pub force: bool,
    #[command(flatten)]
    pub json: JsonArg,
    /// Start from the depth image of the first frame: the dataset's own, or a file; makes the scale metric
    #[arg(long, value_name = "FILE|dataset", help_heading = "Input")]
    pub seed_depth: Option<String>,
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
    pub profile: Option<ProfileArg>,
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
    /// Play frames at their own pace and drop those that come too early
    #[arg(long, help_heading = "Input")]
    pub realtime: bool,
    /// Threads of computation [default: all cores]; the results do not depend on it
    #[arg(long, value_name = "N", help_heading = "Settings")]
    pub threads: Option<usize>,
}

/// `monogrid demo`.
#[derive(Debug, Args)]
pub struct DemoArgs {
    /// Output folder
    #[arg(long, value_name = "DIR", default_value = "runs/demo")]
    pub out: PathBuf,
    /// Replace the output folder even if monogrid did not write it
    #[arg(long)]
    pub force: bool,
    /// Render at most this many frames
    #[arg(long, value_name = "N")]
    pub max_frames: Option<usize>,
    /// Complete set of settings to start from [default: default]
    #[arg(long, value_enum)]
    pub profile: Option<ProfileArg>,
    /// Seed of everything random
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Threads of computation [default: all cores]; the results do not depend on it
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
    #[command(flatten)]
    pub json: JsonArg,
}

/// `monogrid check`.
#[derive(Debug, Args)]
pub struct CheckArgs {
    /// Folder in TUM RGB-D or EuRoC layout, or any folder of images
    pub source: PathBuf,
    #[command(flatten)]
    pub input: SourceArgs,
    #[command(flatten)]
    pub json: JsonArg,
}

/// `monogrid map`.
#[derive(Debug, Args)]
pub struct MapArgs {
    /// Recording (.mgk), scans (.scans) or a folder in TUM layout with depth images
    pub recording: PathBuf,
    /// Map to write: .ot (probabilities), .bt (occupied, free) or .mgo (exact, small)
    #[arg(long, value_name = "MAP.{ot,bt,mgo}")]
    pub out: PathBuf,
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
    /// Settings, TOML (as config.toml of a run; its section [mapping] is used)
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Change one setting, e.g. --set mapping.update_limits=[-0.6,1.2]
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Complete set of settings to start from [default: default]
    #[arg(long, value_enum)]
    pub profile: Option<ProfileArg>,
    /// Threads of computation [default: all cores]; the result does not depend on it
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
    #[command(flatten)]
    pub json: JsonArg,
}

/// `monogrid info`.
#[derive(Debug, Args)]
pub struct InfoArgs {
    /// Map (.ot, .bt or .mgo)
    pub map: PathBuf,
    #[command(flatten)]
    pub json: JsonArg,
}

/// `monogrid convert`.
#[derive(Debug, Args)]
pub struct ConvertArgs {
    /// Map to read (.ot, .bt or .mgo)
    pub input: PathBuf,
    /// File to write (.ot, .bt, .mgo, .ply or .pcd); point clouds hold the centres of occupied cells
    pub output: PathBuf,
    #[command(flatten)]
    pub json: JsonArg,
}

/// How an estimated trajectory is aligned to the truth.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum AlignMode {
    /// Rotation, translation and scale
    Sim3,
    /// Rotation and translation
    Se3,
    /// As it is
    None,
}

/// `monogrid evaluate trajectory`.
#[derive(Debug, Args)]
pub struct EvaluateTrajectoryArgs {
    /// Estimated trajectory, TUM format
    pub estimate: PathBuf,
    /// True trajectory, TUM format (or EuRoC .csv)
    pub truth: PathBuf,
    /// How the estimate is aligned to the truth
    #[arg(long, value_enum, default_value = "sim3")]
    pub align: AlignMode,
    /// Write the alignment (target_from_source): scale tx ty tz qx qy qz qw
    #[arg(long, value_name = "FILE")]
    pub write_sim3: Option<PathBuf>,
    #[command(flatten)]
    pub json: JsonArg,
}

/// `monogrid evaluate depth`.
#[derive(Debug, Args)]
pub struct EvaluateDepthArgs {
    /// Recording of a run (.mgk)
    pub recording: PathBuf,
    /// Folder in TUM layout with true depth images
    pub truth: PathBuf,
    /// Intrinsics and scale of the depth images [default: calibration_depth.txt in the folder]
    #[arg(long, value_name = "FILE")]
    pub depth_calibration: Option<PathBuf>,
    /// Compare the depth of the final map: made better by the keyframes around each, at the final poses
    #[arg(long)]
    pub refined: bool,
    #[command(flatten)]
    pub json: JsonArg,
}

/// A positive, finite number.
pub fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        _ => Err("expected a positive number".into()),
    }
}

fn auto_or_positive(text: &str) -> Result<AutoOr, String> {
    if text == "auto" {
        return Ok(AutoOr::Auto);
    }
    positive(text)
        .map(AutoOr::Value)
        .map_err(|_| "expected a positive number or `auto`".into())
}

/// Width and height of an image.
pub fn size(text: &str) -> Result<(usize, usize), String> {
    let expected = || "expected WIDTHxHEIGHT, both from 32 to 8192, e.g. 640x480".to_owned();
    let (width, height) = text.split_once(['x', 'X']).ok_or_else(expected)?;
    let side = |text: &str| text.parse().ok().filter(|n| (32..=8192).contains(n));
    Ok((
        side(width).ok_or_else(expected)?,
        side(height).ok_or_else(expected)?,
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn every_command_shows_an_example() {
        fn check(command: &clap::Command) {
            if command.get_name() != "help" && !command.has_subcommands() {
                let help = command.get_after_help().map(ToString::to_string);
                assert!(
                    help.is_some_and(|text| text.contains("Example: monogrid")),
                    "{} has no example",
                    command.get_name()
                );
            }
            command.get_subcommands().for_each(check);
        }
        check(&Cli::command());
    }

    #[test]
    fn sizes_and_lengths_are_checked() {
        assert_eq!(size("640x480"), Ok((640, 480)));
        for bad in ["640", "x480", "0x480", "640x-1", "9999x480"] {
            assert!(size(bad).is_err(), "{bad}");
        }
        for bad in ["0", "-1", "nan", "inf", "x"] {
            assert!(positive(bad).is_err(), "{bad}");
        }
        assert_eq!(auto_or_positive("auto"), Ok(AutoOr::Auto));
        assert_eq!(auto_or_positive("0.1"), Ok(AutoOr::Value(0.1)));
    }
}
