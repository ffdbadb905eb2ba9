//! From the video of one camera to a 3D occupancy map.

#[macro_use]
mod say;

mod args;
mod cli;
mod colours;
mod commands;
mod config;
mod curves;
mod depth_images;
mod doubts;
mod explorer;
mod failure;
mod input;
mod keyframe_pixels;
mod map_camera;
mod mapfile;
mod memory;
mod output;
mod picture;
mod recorded;
mod refine;
mod report;
mod run;
mod self_calibration;
mod surface;
mod sweep;
mod usage;
mod video;

use cli::{Cli, Command, EvaluateCommand};
use std::process::ExitCode;

fn main() -> ExitCode {
    // the clock of "frames per second, everything included"
    usage::process_start();
    memory::share_heaps();
    let cli = match Cli::from_process() {
        Ok(cli) => cli,
        Err(error) => return failure::usage(&error),
    };
    let result = match &cli.command {
        Command::Demo(args) => commands::demo::execute(args),
        Command::Run(args) => commands::run::execute(args),
        Command::Calibrate(args) => commands::calibrate::execute(args),
        Command::Cameras(args) => commands::cameras::execute(args),
        Command::Check(args) => commands::check::execute(args),
        Command::View(args) => commands::view::execute(args),
        Command::Map(args) => commands::map::execute(args),
        Command::Rescale(args) => commands::rescale::execute(args),
        Command::Truth(args) => commands::truth::execute(args),
        Command::Synth(args) => commands::synth::execute(args),
        Command::Info(args) => commands::info::execute(args),
        Command::Convert(args) => commands::convert::execute(args),
        Command::Transform(args) => commands::tools::transform(args),
        Command::Crop(args) => commands::tools::crop(args),
        Command::Merge(args) => commands::tools::merge(args),
        Command::Diff(args) => commands::tools::diff(args),
        Command::Mesh(args) => commands::mesh::execute(args),
        Command::Plan(args) => commands::plan::execute(args),
        Command::Distances(args) => commands::distances::execute(args),
        Command::Project(args) => commands::tools::project(args),
        Command::SensorModel(args) => commands::sensor_model::execute(args),
        Command::Slice(args) => commands::slice::execute(args),
        Command::Sweep(args) => commands::sweep::execute(args),
        Command::Vocabulary(args) => commands::vocabulary::execute(args),
        Command::Evaluate(EvaluateCommand::Trajectory(args)) => {
            commands::evaluate::trajectory(args)
        }
        Command::Evaluate(EvaluateCommand::Depth(args)) => commands::evaluate::depth(args),
        Command::Evaluate(EvaluateCommand::Map(args)) => commands::evaluate_map::map(args),
        Command::Evaluate(EvaluateCommand::Paths(args)) => commands::evaluate_map::paths(args),
    };
    failure::exit_code(result)
}
