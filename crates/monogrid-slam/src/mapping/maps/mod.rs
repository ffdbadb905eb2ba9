//! Local, large and global maps while a run goes on, and at its end.

mod global;
mod live;
mod mapper;
#[cfg(test)]
mod tests;

pub use live::{LiveMaps, LiveView, MapReader, Maps, Waiting};
pub use mapper::{MapStats, Mapper, z_up_from_camera_world};
