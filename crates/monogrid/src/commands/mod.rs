//! The commands.

pub mod batch;
pub mod calibrate;
pub mod cameras;
pub mod check;
pub mod demo;
pub mod distances;
pub mod evaluate;
pub mod evaluate_map;
pub mod info;
pub mod map;
pub mod merge_runs;
pub mod posed_depth;
pub mod report;
pub mod rescale;
pub mod run;
pub mod sensor_model;
pub mod shell;
pub mod slice;
pub mod sweep;
pub mod synth;
pub mod tools;
pub mod truth;
pub mod view;
pub mod vocabulary;

use crate::args::JsonArg;
use crate::failure::{CommandResult, Failure, Outcome};
use monogrid_worlds::MeshModel;
use serde::Serialize;
use std::path::Path;

impl JsonArg {
    /// Prints a report for programs where that is asked for, else for people: the end of a command that did all it was to do.
    pub fn print(self, report: &impl Serialize, for_people: impl FnOnce()) -> CommandResult {
        if self.json {
            print_json(report)?;
        } else {
            for_people();
        }
        Ok(Outcome::Done)
    }
}

/// Prints one JSON object to standard output.
pub fn print_json(value: &impl Serialize) -> Result<(), Failure> {
    let text = serde_json::to_string_pretty(value).map_err(Failure::running)?;
    println!("{text}");
    Ok(())
}

/// What is said of a mesh or a cloud of which something was left out.
pub fn left_out(model: &MeshModel, source: &Path) -> Option<String> {
    let count = model.left_out;
    (count > 0).then(|| {
        format!(
            "{}: {count} points whose coordinates are not finite are left out",
            source.display()
        )
    })
}

/// Says what the user should know.
pub fn warn(warnings: &[String]) {
    for warning in warnings {
        eprintln!("warning: {warning}");
    }
}

/// A number of bytes for people.
pub fn bytes(count: u64) -> String {
    match count {
        0..1_000 => format!("{count} bytes"),
        1_000..1_000_000 => format!("{:.1} kB", count as f64 / 1e3),
        _ => format!("{:.2} MB", count as f64 / 1e6),
    }
}

/// Most threads of computation: each needs memory of its own.
const MAX_THREADS: usize = 256;

/// Makes the pool of `threads` threads (default: all cores); returns their number.
///
/// Results never depend on it.
pub fn use_threads(threads: Option<usize>) -> Result<usize, Failure> {
    if let Some(threads) = threads.filter(|threads| !(1..=MAX_THREADS).contains(threads)) {
        return Err(Failure::input(format!(
            "--threads is {threads}, expected 1 to {MAX_THREADS}"
        )));
    }
    let available = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let threads = threads.unwrap_or(available);
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build_global()
        .map_err(Failure::running)?;
    Ok(threads)
}
