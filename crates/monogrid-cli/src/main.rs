//! From the video of one camera to a 3D occupancy map: the command.

use std::process::ExitCode;

fn main() -> ExitCode {
    ExitCode::from(monogrid_cli::program::main(std::env::args_os()))
}
