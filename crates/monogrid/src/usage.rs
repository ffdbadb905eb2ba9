//! What the process has used: time and memory.

pub use monogrid_pipeline::clock::{process_cpu, thread_cpu};
use std::sync::OnceLock;
use std::time::Instant;

/// When the process started, as nearly as it is known: when this was called first.
pub fn process_start() -> Instant {
    static START: OnceLock<Instant> = OnceLock::new();
    *START.get_or_init(Instant::now)
}

/// Largest resident memory so far, bytes; `None` where the system does not say.
pub fn peak_rss_bytes() -> Option<u64> {
    peak_in(&std::fs::read_to_string("/proc/self/status").ok()?)
}

/// Resident memory now, bytes; `None` where the system does not say.
pub fn rss_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    bytes_in(&status, "VmRSS:")
}

/// Largest resident memory that the `status` of a process says, bytes.
pub fn peak_in(status: &str) -> Option<u64> {
    bytes_in(status, "VmHWM:")
}

fn bytes_in(status: &str, name: &str) -> Option<u64> {
    let line = status.lines().find_map(|line| line.strip_prefix(name))?;
    let kilobytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kilobytes * 1024)
}
