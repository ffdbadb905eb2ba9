//! Runs, and what is done with the folder of one or of many.

pub mod batch;
pub mod demo;
pub mod export;
pub mod merge_runs;
pub mod report;
pub mod rescale;
pub mod run;
pub mod view;
