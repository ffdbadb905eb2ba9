//! The command line: every command, option and default, as `--help` shows them.

use crate::commands::evaluate::{self, map as evaluate_map, truth};
use crate::commands::maps::{distances, info, map, slice, tools};
use crate::commands::runs::{batch, demo, export, merge_runs, report, rescale, run, view};
use crate::commands::sources::{calibrate, cameras, check, synth};
use crate::commands::{shell, with_numbers};
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use monogrid_app::process::console::{LogArgs, printable};
use monogrid_thesis::ThesisCommand;
use std::ffi::OsString;

/// From the video of one camera to a 3D occupancy map.
#[derive(Debug, Parser)]
#[command(name = "monogrid", version, arg_required_else_help = true, after_help = EXIT_CODES)]
pub struct Cli {
    /// What to do
    #[command(subcommand)]
    pub command: Command,
    /// What it says of it
    #[command(flatten)]
    pub log: LogArgs,
}

impl Cli {
    /// What the program was called with.
    pub fn parse(arguments: impl IntoIterator<Item = OsString>) -> Result<Self, clap::Error> {
        let arguments = with_thesis(with_view(arguments));
        let parsed = command().try_get_matches_from(&arguments);
        Self::from_arg_matches(&parsed.map_err(|error| with_printable(error, &arguments))?)
    }
}

/// An error repeats the arguments that it is about: it is that of arguments that a terminal only
/// shows.
fn with_printable(error: clap::Error, arguments: &[OsString]) -> clap::Error {
    let shown: Vec<String> = arguments
        .iter()
        .map(|argument| printable(&argument.to_string_lossy()).into_owned())
        .collect();
    let is_shown = |(raw, shown): (&OsString, &String)| raw.to_string_lossy() == shown.as_str();
    if arguments.iter().zip(&shown).all(is_shown) {
        return error;
    }
    let again = command().try_get_matches_from(shown).err();
    again.unwrap_or_else(|| command().error(error.kind(), "an argument holds control characters"))
}

/// `--view rerun` and `--view rrd=FILE` as one word, as `--view=8080` is: what follows `--view`
/// alone is the source.
fn with_view(arguments: impl IntoIterator<Item = OsString>) -> Vec<OsString> {
    let mut joined: Vec<OsString> = Vec::new();
    for argument in arguments {
        let is_viewer = argument == "rerun" || argument.to_string_lossy().starts_with("rrd=");
        match joined.last_mut() {
            Some(last) if last == "--view" && is_viewer => {
                last.push("=");
                last.push(argument);
            }
            _ => joined.push(argument),
        }
    }
    joined
}

/// The commands that belong to `thesis` by their earlier names, which scripts still have.
fn with_thesis(mut arguments: Vec<OsString>) -> Vec<OsString> {
    let earlier = ["sweep", "sensor-model", "vocabulary"];
    let command = arguments.get(1).and_then(|word| word.to_str());
    if command.is_some_and(|command| earlier.contains(&command)) {
        arguments.insert(1, "thesis".into());
    }
    arguments
}

/// All commands; `-1` after an option is its value, so that the option says what is wrong with it.
pub fn command() -> clap::Command {
    with_numbers(Cli::command())
}

const EXIT_CODES: &str = "\
Exit codes: 0 done, 1 failed while running, 2 wrong usage or bad input,
3 finished, but tracking never started or was lost for good, fewer than half of the frames have a
  pose that is certain (what was mapped is saved), or recordings stay apart,
4 interrupted (what was mapped until then is saved), 130 interrupted again: nothing more is saved.

First steps:  monogrid demo
              monogrid run video.mp4";

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Render a built-in world, run the whole system on it, evaluate against the exact truth
    #[command(after_help = "Example: monogrid demo --out demo")]
    Demo(demo::DemoArgs),
    /// Turn a video or image sequence into a trajectory, keyframes with depth and an occupancy map
    #[command(
        after_help = "Example: monogrid run recordings/kitchen --out runs/kitchen --resolution 0.02"
    )]
    Run(Box<run::RunArgs>),
    /// Many recordings, each by a run of its own: resumable, a status for each, several at once
    #[command(
        after_help = "Example: monogrid batch recordings.tsv --out maps --jobs 8\n\nA list has a \
            recording per line, and behind tabs what is said of it alone: name=NAME and options of \
            `monogrid run`\nas KEY=VALUE."
    )]
    Batch(batch::BatchArgs),
    /// One page of all recordings of a batch: what worked, what did not and why, the worst first
    #[command(after_help = "Example: monogrid report maps")]
    Report(report::ReportArgs),
    /// Cameras of this computer that can be a source
    #[command(after_help = "Example: monogrid cameras")]
    Cameras(cameras::CamerasArgs),
    /// Camera from a video of a chessboard that is shown to it from many sides
    #[command(after_help = "Example: monogrid calibrate board.mp4 --out my-phone")]
    Calibrate(calibrate::CalibrateArgs),
    /// Read a source without running: size, rate, calibration, what would hurt tracking
    #[command(after_help = "Example: monogrid check recordings/kitchen")]
    Check(check::CheckArgs),
    /// Look at a map, a cloud or a run: in the browser, as a page or as a picture
    #[command(after_help = "Example: monogrid view runs/kitchen")]
    View(view::ViewArgs),
    /// Build an occupancy map from a recording, or from poses and depth from anywhere
    #[command(
        after_help = "Example: monogrid map runs/kitchen/recording.mgk --out kitchen.ot \
            --resolution 0.02"
    )]
    Map(map::MapArgs),
    /// A run of unknown scale in metres: trajectory, recording, maps and cloud in a new folder
    #[command(
        after_help = "Example: monogrid rescale runs/kitchen --scale-from camera-height=1.5m --out \
            runs/kitchen-metric"
    )]
    Rescale(rescale::RescaleArgs),
    /// A run for other programs: COLMAP, radiance fields and splats, modelling, surveying
    #[command(
        after_help = "Example: monogrid export runs/kitchen --to colmap --out kitchen-colmap"
    )]
    Export(export::ExportArgs),
    /// Runs of different days and cameras as one map, as far as they show the same places
    #[command(after_help = "Example: monogrid merge-runs runs/monday runs/tuesday --out runs/both")]
    MergeRuns(merge_runs::MergeRunsArgs),
    /// Ground-truth map of a mesh, a point cloud, a built-in world, or posed depth images
    #[command(
        after_help = "Example: monogrid truth room.ply --trajectory groundtruth.txt --resolution \
            0.02 --out truth.ot"
    )]
    Truth(truth::TruthArgs),
    /// Synthetic dataset in TUM layout with exact depth, poses and truth map
    #[command(after_help = "Example: monogrid synth office --out recordings/office --frames 600")]
    Synth(synth::SynthArgs),
    /// Grey pictures of the layers of a map
    #[command(after_help = "Example: monogrid slice kitchen.ot slices --leaves")]
    Slice(slice::SliceArgs),
    /// Facts about a map or submaps
    #[command(after_help = "Example: monogrid info kitchen.bt")]
    Info(info::InfoArgs),
    /// Convert a map: .ot, .bt and .mgo to .ot, .bt, .mgo, .ply or .pcd
    #[command(after_help = "Example: monogrid convert kitchen.ot kitchen.ply")]
    Convert(tools::ConvertArgs),
    /// Move, turn and scale a map
    #[command(
        after_help = "Example: monogrid transform kitchen.ot moved.ot --sim3 world_from_kitchen.txt"
    )]
    Transform(tools::TransformArgs),
    /// Keep the cells of a map that touch a box
    #[command(after_help = "Example: monogrid crop house.ot kitchen.ot --min -1,0,0 --max 2,3,2.5")]
    Crop(tools::CropArgs),
    /// Add the log-odds of two maps, as if both had been measured into one
    #[command(after_help = "Example: monogrid merge morning.ot evening.ot --out day.ot")]
    Merge(tools::MergeArgs),
    /// Count the cells whose state differs between two maps
    #[command(after_help = "Example: monogrid diff morning.ot evening.ot")]
    Diff(tools::DiffArgs),
    /// Surface of a map as a triangle mesh: .ply, .glb, .obj, .stl, .dxf or .usdz
    #[command(after_help = "Example: monogrid mesh kitchen.ot kitchen.glb")]
    Mesh(tools::MeshArgs),
    /// Map seen from above: .pgm and .yaml for nav2's map server, .png, .svg or .dxf for people
    #[command(
        after_help = "Example: monogrid project kitchen.ot kitchen.pgm --min-height 0.1 \
            --max-height 1.5"
    )]
    Project(tools::ProjectArgs),
    /// Distance to the nearest obstacle in every cell, as an array for numpy
    #[command(
        after_help = "Example: monogrid distances kitchen.ot kitchen.npy --max-distance 2 --height \
            0.3"
    )]
    Distances(distances::DistancesArgs),
    /// Path of a robot through a map
    #[command(after_help = "Example: monogrid plan kitchen.ot 0,0,0.5 2,1,0.5 --robot-radius 0.2")]
    Plan(tools::PlanArgs),
    /// Compare a result with the truth
    #[command(subcommand)]
    Evaluate(EvaluateCommand),
    /// Repeat the experiments of the thesis
    #[command(subcommand)]
    Thesis(ThesisCommand),
    /// Print a script that lets a shell complete commands and options
    #[command(after_help = "Example: monogrid completions bash > \
            ~/.local/share/bash-completion/completions/monogrid")]
    Completions(shell::CompletionsArgs),
    /// Pages of the manual, for `man`
    #[command(after_help = "Example: monogrid man --out ~/.local/share/man/man1 --force")]
    Man(shell::ManArgs),
}

/// What to evaluate.
#[derive(Debug, Subcommand)]
pub enum EvaluateCommand {
    /// Errors of a trajectory (ATE, RPE, scale drift), as `evo` computes them
    #[command(
        after_help = "Example: monogrid evaluate trajectory runs/kitchen/trajectory.txt \
            groundtruth.txt --align sim3"
    )]
    Trajectory(evaluate::EvaluateTrajectoryArgs),
    /// Inverse depth of the keyframes of a recording, and its variance, against true depth
    #[command(
        after_help = "Example: monogrid evaluate depth runs/kitchen/recording.mgk \
            recordings/kitchen"
    )]
    Depth(evaluate::EvaluateDepthArgs),
    /// Cells of a map against the true map: ROC, MCC, calibration, surface, four rules for unknown
    #[command(after_help = "Example: monogrid evaluate map runs/kitchen truth.ot")]
    Map(evaluate_map::EvaluateMapArgs),
    /// Can a robot plan on the map, and are its plans safe in the true map
    #[command(after_help = "Example: monogrid evaluate paths runs/kitchen truth.ot \
            --robot-radius 0.2")]
    Paths(evaluate_map::EvaluatePathsArgs),
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        command().debug_assert();
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
        check(&command());
    }

    #[test]
    fn a_viewer_may_stand_beside_its_option_and_a_source_after_it() {
        let joined =
            |words: &[&str]| with_view(words.iter().map(OsString::from)).join(" ".as_ref());
        assert_eq!(joined(&["--view", "rerun", "video"]), "--view=rerun video");
        assert_eq!(joined(&["--view", "rrd=a b"]), "--view=rrd=a b");
        assert_eq!(joined(&["--view", "video"]), "--view video");
        assert_eq!(joined(&["rerun", "--view"]), "rerun --view");
    }

    #[test]
    fn commands_of_the_thesis_are_found_by_their_earlier_names() {
        let parse = |words: &[&str]| {
            Cli::parse(words.iter().map(OsString::from)).map(|cli| format!("{:?}", cli.command))
        };
        for earlier in [
            &["sensor-model", "--plot", "curves"][..],
            &["vocabulary", "images", "--out", "words"],
            &["sweep", "a.mgk", "--out", "sweep"],
        ] {
            let words = |before: &[&'static str]| [before, earlier].concat();
            let now = parse(&words(&["monogrid", "thesis"])).unwrap();
            assert_eq!(parse(&words(&["monogrid"])).unwrap(), now);
        }
        let help = command().render_help().to_string();
        assert!(!help.contains("sweep") && help.contains("thesis"), "{help}");
    }

    #[test]
    fn errors_show_arguments_without_obeying_them() {
        for words in [
            &["monogrid", "\x1b[2Jrun"][..],
            &["monogrid", "run", "v.mp4", "--\x1b]0;title\x07=1"],
            &[
                "monogrid",
                "run",
                "v.mp4",
                "--resolution",
                "\u{9b}2J\u{202e}",
            ],
            &["monogrid", "run", "v.mp4", "more\r\x7f"],
        ] {
            let error = Cli::parse(words.iter().map(OsString::from)).unwrap_err();
            let text = error.render().ansi().to_string();
            // colours of our own
            let plain: Vec<&str> = text.split("\x1b[").collect();
            let rest = plain.iter().skip(1).all(|part| part.contains('m'));
            assert!(
                rest && !text
                    .replace("\x1b[", "")
                    .contains(monogrid_datasets::is_obeyed),
                "{text:?}"
            );
            assert!(
                text.contains("\\u00") || text.contains("\\u202e"),
                "{text:?}"
            );
        }
    }

    #[test]
    fn a_negative_number_gets_the_answer_of_its_option() {
        let arguments = ["monogrid", "run", "images", "--resolution", "-1"];
        let error = command().try_get_matches_from(arguments).unwrap_err();
        let text = error.to_string();
        assert!(
            text.contains("--resolution") && text.contains("expected a positive number"),
            "{text}"
        );
    }
}
