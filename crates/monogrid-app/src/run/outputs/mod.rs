//! The files of a run, besides the recording.

mod cloud;
mod maps;
mod playback;
mod tables;

pub use cloud::write_cloud;
pub use maps::{
    Ground, MapPictures, Surface, UNKNOWN_SCALE_WARNING, lowest_and_highest, write_global,
    write_maps,
};
pub use playback::Playback;
pub use tables::{Paths, final_poses, frame_times_ns, path_of, write_bridged, write_tables};
