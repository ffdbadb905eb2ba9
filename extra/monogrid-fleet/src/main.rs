//! `monogrid-fleet`: see the library of the same name.

use std::process::ExitCode;

fn main() -> ExitCode {
    ExitCode::from(monogrid_fleet::program::main(std::env::args_os()))
}
