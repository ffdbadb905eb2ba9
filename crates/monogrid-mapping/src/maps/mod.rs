//! Local, large and global maps while a run goes on, and at its end.

mod band;
mod global;
mod live;
mod local;
mod mapper;
#[cfg(test)]
mod tests;

pub use band::navigation_band;
pub use live::{LiveMaps, LiveView, MapReader, Maps, Waiting};
pub use local::LocalMap;
pub use mapper::{MapStats, Mapper};
