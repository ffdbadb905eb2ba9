//! Runs: their files, what goes wrong in them, and what goes on with them.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "a test may panic and talk"
)]

mod common;
mod runs {
    mod export;
    mod masks;
    mod panics;
    mod pipeline;
    mod run;
    mod sessions;
    mod settings;
    mod stalled_sources;
    mod submaps;
    mod video;
}
