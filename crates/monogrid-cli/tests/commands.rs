//! The commands beside `run`: maps, their tools, batches, the thesis, and what is never written
//! over.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "a test may panic and talk"
)]

mod common;
mod commands {
    mod bad_input;
    mod batch;
    mod layouts;
    mod map_tools;
    mod maps;
    mod sweep;
    mod users_files;
    mod vocabulary;
}
