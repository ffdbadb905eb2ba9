//! What the process has used: time and memory.

pub use monogrid_pipeline::clock::{process_cpu, thread_cpu};
use std::path::Path;
use std::sync::OnceLock;
use std::time::Instant;

/// When the process started, as nearly as it is known: when this was called first.
pub fn process_start() -> Instant {
    static START: OnceLock<Instant> = OnceLock::new();
    *START.get_or_init(Instant::now)
}

/// Largest resident memory so far, bytes; `None` where the system does not say.
pub fn peak_rss_bytes() -> Option<u64> {
    bytes_in("/proc/self/status", "VmHWM:")
}

/// Resident memory now, bytes; `None` where the system does not say.
pub fn rss_bytes() -> Option<u64> {
    bytes_in("/proc/self/status", "VmRSS:")
}

/// An amount of memory by its name in one of the system's files on memory, bytes.
pub fn bytes_in(file: impl AsRef<Path>, name: &str) -> Option<u64> {
    let text = std::fs::read_to_string(file).ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    let kilobytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kilobytes * 1024)
}
