//! Map files: OctoMap's (`[OCTOMAP13]`) `.ot` and `.bt`, point clouds, and the crate's own compact
//! format.

pub(crate) mod bt;
pub(crate) mod cloud;
pub(crate) mod compact;
pub(crate) mod header;
pub(crate) mod named;
pub(crate) mod ot;
pub(crate) mod save;

pub use bt::{read_bt, write_bt};
pub use cloud::{write_pcd, write_ply};
pub use compact::{MGO_MAGIC, read_mgo, write_mgo};
pub use named::{MapFormat, read_map};
pub use ot::{read_ot, write_colour_ot, write_ot};
pub use save::save_atomically;

use crate::error::MapError;
use std::io::{Error, ErrorKind};

fn write_error(source: Error) -> MapError {
    MapError::io("writing the map")(source)
}

/// A short file is damaged, as `cut` says.
fn read_error(source: Error, cut: impl FnOnce() -> MapError) -> MapError {
    match source.kind() {
        ErrorKind::UnexpectedEof => cut(),
        _ => MapError::io("reading the map")(source),
    }
}
