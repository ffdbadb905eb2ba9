//! What the process is to its user and to its system: messages, exit codes, interrupts, memory,
//! threads.

#[macro_use]
pub mod console;
pub mod failure;
pub mod interrupt;
pub mod memory;
pub mod progress;
pub mod talk;
pub mod usage;

use failure::Failure;
use serde::Serialize;

/// Prints one JSON object to standard output.
pub fn print_json(value: &impl Serialize) -> Result<(), Failure> {
    let text = serde_json::to_string_pretty(value).map_err(Failure::running)?;
    println!("{text}");
    Ok(())
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
