//! The command `monogrid` as a function, for those who bring it along: what runs it is the
//! process's only.

pub use monogrid_app::process::console::printable;

use crate::cli::{Cli, Command, EvaluateCommand, command};
use crate::{batch, commands};
use monogrid_app::config::RunConfig;
use monogrid_app::process::failure::CommandResult;
use monogrid_app::process::{failure, memory, talk, usage};
use monogrid_pipeline::Settings;
use std::error::Error;
use std::ffi::OsString;
use std::path::Path;

/// Does what a command line asks for, the name of the program first, and prints what it has to say;
/// the exit code.
///
/// It takes the whole process: its pool of threads, its signals, its standard output. It is meant
/// to be called once.
pub fn main(arguments: impl IntoIterator<Item = OsString>) -> u8 {
    // the clock of "frames per second, everything included"
    usage::process_start();
    batch::child::end_with_parent();
    memory::share_heaps();
    memory::keep_no_large_pictures();
    let cli = match Cli::parse(arguments) {
        Ok(cli) => cli,
        Err(error) => return failure::usage(&error),
    };
    cli.log.begin("monogrid");
    talk::begin("working");
    let result = failure::caught(|| execute(&cli));
    // nothing is drawn behind the last word
    let _resting = talk::rest();
    failure::exit_code(result)
}

fn execute(cli: &Cli) -> CommandResult {
    match &cli.command {
        Command::Demo(args) => commands::runs::demo::execute(args),
        Command::Run(args) => commands::runs::run::execute(args),
        Command::Batch(args) => commands::runs::batch::execute(args),
        Command::Calibrate(args) => commands::sources::calibrate::execute(args),
        Command::Cameras(args) => commands::sources::cameras::execute(args),
        Command::Check(args) => commands::sources::check::execute(args),
        Command::View(args) => commands::runs::view::execute(args),
        Command::Map(args) => commands::maps::map::execute(args),
        Command::Report(args) => commands::runs::report::execute(args),
        Command::Export(args) => commands::runs::export::execute(args),
        Command::Rescale(args) => commands::runs::rescale::execute(args),
        Command::MergeRuns(args) => commands::runs::merge_runs::execute(args),
        Command::Truth(args) => commands::evaluate::truth::execute(args),
        Command::Synth(args) => commands::sources::synth::execute(args),
        Command::Info(args) => commands::maps::info::execute(args),
        Command::Convert(args) => commands::maps::tools::convert(args),
        Command::Transform(args) => commands::maps::tools::transform(args),
        Command::Crop(args) => commands::maps::tools::crop(args),
        Command::Merge(args) => commands::maps::tools::merge(args),
        Command::Diff(args) => commands::maps::tools::diff(args),
        Command::Mesh(args) => commands::maps::tools::mesh(args),
        Command::Plan(args) => commands::maps::tools::plan(args),
        Command::Distances(args) => commands::maps::distances::execute(args),
        Command::Project(args) => commands::maps::tools::project(args),
        Command::Slice(args) => commands::maps::slice::execute(args),
        Command::Thesis(command) => command.execute(),
        Command::Evaluate(command) => match command {
            EvaluateCommand::Trajectory(args) => commands::evaluate::trajectory(args),
            EvaluateCommand::Depth(args) => commands::evaluate::depth(args),
            EvaluateCommand::Map(args) => commands::evaluate::map::map(args),
            EvaluateCommand::Paths(args) => commands::evaluate::map::paths(args),
        },
        Command::Completions(args) => commands::shell::completions(args, command()),
        Command::Man(args) => commands::shell::man(args, command()),
    }
}

/// The settings of a `config.toml`, or the default ones, with changes as `--set` takes them
/// (`mapping.resolution=0.02`).
///
/// # Errors
/// A file or a setting that is not understood, or out of its range.
pub fn settings(
    config: Option<&Path>,
    changes: &[String],
) -> Result<Settings, Box<dyn Error + Send + Sync>> {
    let resolved = RunConfig::resolve(None, config, changes);
    let config = resolved.map_err(failure::Failure::into_error)?;
    config.validate().map_err(failure::Failure::into_error)?;
    Ok(Settings {
        working_size: config.working_size(),
        slam: config.slam,
        mapping: config.mapping,
        seed: config.seed,
        ..Settings::default()
    })
}

#[cfg(test)]
mod tests {
    use monogrid_image::WorkingSize;

    #[test]
    fn settings_of_a_program_of_ones_own_say_how_many_pixels_are_worked_with()
    -> Result<(), Box<dyn std::error::Error + Send + Sync>> {
        let folder = tempfile::tempdir()?;
        let file = folder.path().join("config.toml");
        std::fs::write(&file, "profile = \"fast\"\n")?;
        let fast = super::settings(Some(&file), &[])?;
        assert_eq!(fast.working_size, WorkingSize::Pixels(120_000));
        let fewer = super::settings(None, &["working_pixels=5000".to_owned()])?;
        assert_eq!(fewer.working_size, WorkingSize::Pixels(5000));
        assert!(super::settings(None, &["working_pixels=5".to_owned()]).is_err());
        Ok(())
    }
}
