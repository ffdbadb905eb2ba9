//! A run: frames in, trajectory, keyframes and maps out.
//!
//! What calls what, in the order of time:
//!
//! ```text
//! the commands run and demo
//!   -> whole::run_all
//!        -> tracking          monogrid_pipeline:
//!                             reader -> tracking -> recorder  (recording, pictures of keyframes)
//!                                                -> mapper    (maps that grow)
//!                                                -> live      (`--view`)
//!        -> sensed, align     the frame of the results
//!        -> outputs           tables, final maps and their pictures
//!        -> summary, report   summary.json, report.html
//!   -> conclusion::conclude      what the user reads, the exit code
//! ```
//!
//! The threads are those of the pipeline; the recorder is its listener. No result depends on a
//! clock: they are the same for any number of threads (`--realtime`, which drops frames, excepted).

pub mod align;
pub mod conclusion;
mod live;
pub mod outputs;
pub mod report;
pub mod sensed;
pub mod sessions;
mod settings;
pub mod summary;
pub mod tracking;
mod trust;
pub mod whole;

pub use live::View;
pub use settings::RunSettings;
pub use tracking::memory_limit::MemoryLimit;
pub use tracking::submaps::SubmapPolicy;
