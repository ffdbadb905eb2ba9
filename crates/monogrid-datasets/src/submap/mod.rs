//! Submaps (`.mgs`): pieces of a run that never change, and the table that says where they lie.
//!
//! A submap is a file of some keyframes in a frame of their own, that of the first of them. It is
//! named by what is in it ([`SubmapId`]), so that whoever has it has it for ever; what a graph
//! moves is in [`SubmapTable`], beside the files. Its blocks are the records of a recording (see
//! `docs/formats.md`), each with its hash, and are read one by one.

mod block;
mod build;
mod directory;
mod id;
mod load;
mod reader;
mod table;

pub use build::{BuiltSubmap, SubmapBuilder};
pub use directory::{SubmapBlock, SubmapInfo};
pub use id::SubmapId;
pub use load::{SUBMAP_FOLDER, is_submap, is_submap_table, submap_table_in};
pub(crate) use load::{read_recording, read_single};
pub use reader::{SubmapPose, SubmapReader};
pub use table::{MovedKeyframe, SUBMAP_TABLE, SubmapEntry, SubmapTable};

/// Name of the kind of file, for messages.
const KIND: &str = "submap";
/// Ending of the names of submaps.
const ENDING: &str = "mgs";
