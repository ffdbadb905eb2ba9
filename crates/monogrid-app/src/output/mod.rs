//! What the program writes, and what it never touches.
//!
//! An output *folder* carries a manifest of what was written into it. A folder is replaced only
//! when everything that lies in it stands in the manifest and is as it was written; otherwise the
//! call is refused, or, with `--force`, goes on beside what it did not write. A single output
//! *file* that exists is replaced with `--force` only, or by the folder whose manifest lists it, if
//! it is as it was written. Nothing that the call reads is ever written to or removed, with
//! `--force` neither, whatever name or link leads to it. Every file appears whole or not at all.
//!
//! What is read is known by device and inode, so that no link leads to it. The manifest is locked
//! while a process writes, and a lock ends with its process. In a folder of output folders
//! (`batch`) each has its manifest and is checked when it is written to.

mod file;
mod folder;
mod inputs;
mod inspect;
mod manifest;
mod numbered;
mod place;

pub use file::OutputFile;
pub use folder::OutputFolder;
pub use inputs::{Inputs, MAP, map_at, result_at};
pub use manifest::Content;
pub use place::{changed_ns, place_of_file, resolved};
