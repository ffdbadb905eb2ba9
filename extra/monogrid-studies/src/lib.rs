//! Programs that measure `monogrid-slam` and `monogrid-mapping` apart from the command, for
//! development: each is an example of this crate, and says at its head how it is called. What they
//! share is here.
#![allow(
    clippy::unwrap_used,
    reason = "a tool for development: what is wrong ends it"
)]

mod options;
mod sequence;

pub use options::Options;
pub use sequence::Sequence;
