//! The command `monogrid`, as a library for those who bring it along: [`program`].
#![deny(missing_docs)]

#[macro_use]
extern crate monogrid_app;

mod batch;
mod cli;
mod commands;
pub mod program;
