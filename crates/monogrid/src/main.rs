//! From the video of one camera to a 3D occupancy map.
#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "the program talks to people; the libraries do not"
)]

mod cli;
mod failure;
mod output;
mod picture;
mod report;
mod usage;

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    let _cli = cli::Cli::parse();
    ExitCode::SUCCESS
}
