//! The campaign of `scripts/torture.sh`: hostile input, kills, full disks, odd names and extreme
//! settings, each against the program as users start it, with a limit on memory and time.
//!
//! It takes minutes, so that every part is ignored unless asked for. `TORTURE_SECONDS` is the time
//! for each kind of mutated file, client or source, `TORTURE_MUTANTS` a number of them in its
//! place, `TORTURE_SEED` begins another sequence of mutations, `TORTURE_KEEP` is a folder that
//! inputs which did harm are copied to.
#![cfg(unix)]
#![allow(clippy::too_many_lines, reason = "a test tells its story in one place")]
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "a test may panic and talk"
)]

mod common;
mod torture {
    pub mod clients;
    pub mod disks;
    pub mod kills;
    pub mod limits;
    pub mod mutations;
    pub mod names;
    pub mod seeds;
    pub mod settings;
    pub mod sources;
}

use std::time::Duration;
use torture::limits::Ended;

/// What an input may cost.
pub const MAX_SECONDS: u64 = 60;
/// Address space, kB: 2 GB of memory, and the program's own code and stacks.
pub const MAX_KB: u64 = 2_400_000;

/// A number from the environment.
pub fn from_environment(name: &str, default: u64) -> u64 {
    let text = std::env::var(name).unwrap_or_default();
    text.parse().unwrap_or(default)
}

/// What came of the runs of a part.
#[derive(Default)]
pub struct Outcomes {
    runs: usize,
    refused: usize,
    harmed: usize,
    slowest: Duration,
}

impl Outcomes {
    /// Counts a run and what was wrong with it.
    pub fn count(&mut self, what: &str, ended: &Ended, harms: &[String]) {
        self.runs += 1;
        self.refused += usize::from(ended.code != Some(0));
        self.slowest = self.slowest.max(ended.took);
        self.harmed += usize::from(!harms.is_empty());
        for harm in harms {
            println!("  {what}: {harm}: {}", ended.said);
        }
    }

    /// Prints the row of the part; fails where harm was done.
    pub fn conclude(&self, part: &str) {
        row(
            part,
            self.runs,
            &format!("{} refused", self.refused),
            self.slowest,
            self.harmed,
        );
        assert_eq!(self.harmed, 0, "see above");
    }
}

/// A row of the table of a part.
pub fn row(what: &str, runs: usize, outcome: &str, slowest: Duration, harmed: usize) {
    println!(
        "| {what} | {runs} | {outcome} | {:.1} s | {harmed} |",
        slowest.as_secs_f64()
    );
}
