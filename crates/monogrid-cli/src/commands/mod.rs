//! The commands.

pub mod evaluate;
pub mod maps;
pub mod runs;
pub mod shell;
pub mod sources;

use monogrid_app::process::{bytes, use_threads, warn};
use monogrid_worlds::MeshModel;
use std::path::Path;

/// What is said of a mesh or a cloud of which something was left out.
pub fn left_out(model: &MeshModel, source: &Path) -> Option<String> {
    let count = model.left_out;
    (count > 0).then(|| {
        format!(
            "{}: {count} points whose coordinates are not finite are left out, {} are used",
            source.display(),
            model.mesh.vertices.len()
        )
    })
}

/// `-1` after an option is its value.
pub fn with_numbers(command: clap::Command) -> clap::Command {
    let command = command.mut_args(|arg| match arg.get_action().takes_values() {
        true => arg.allow_negative_numbers(true),
        false => arg,
    });
    command.mut_subcommands(with_numbers)
}
