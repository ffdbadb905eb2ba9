//! A run from its source to its output folder, and what all commands share.
//!
//! | module | |
//! |---|---|
//! | [`args`], [`config`] | options that several commands have, and the settings of a run |
//! | [`input`], [`camera`] | a source as working images, and the camera that took them |
//! | [`run`] | frames in, trajectory, keyframes and maps out |
//! | [`output`] | what is written, and what is never touched |
//! | [`recorded`], [`mapfile`], [`truth_map`] | what commands read again |
//! | [`process`] | messages, exit codes, interrupts, memory |
//!
//! The commands are `monogrid-cli` and `monogrid-thesis`; pictures and pages are `monogrid-report`.
#![deny(missing_docs)]

#[macro_use]
pub mod process;
pub mod args;
pub mod camera;
pub mod config;
pub mod input;
pub mod keyframe_colours;
pub mod mapfile;
pub mod output;
pub mod recorded;
pub mod run;
pub mod truth_map;
