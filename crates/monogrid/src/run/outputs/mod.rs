//! The files of a run, besides the recording.

mod maps;
mod tables;

pub use maps::write_maps;
pub use tables::{final_poses, path_of, reported_path, write_tables};
