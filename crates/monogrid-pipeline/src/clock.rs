//! CPU time, and giving way to others.

use std::time::Duration;

/// CPU time of all threads of this process.
#[must_use]
pub fn process_cpu() -> Duration {
    cpu(true)
}

/// CPU time of the calling thread.
#[must_use]
pub fn thread_cpu() -> Duration {
    cpu(false)
}

#[cfg(unix)]
fn cpu(of_process: bool) -> Duration {
    use rustix::time::{ClockId, clock_gettime};
    let time = clock_gettime(match of_process {
        true => ClockId::ProcessCPUTime,
        false => ClockId::ThreadCPUTime,
    });
    Duration::new(time.tv_sec.max(0) as u64, time.tv_nsec.max(0) as u32)
}

/// Without such a clock: wall time since the first call, an upper bound for one thread.
#[cfg(not(unix))]
fn cpu(_: bool) -> Duration {
    use std::sync::OnceLock;
    use std::time::Instant;
    static START: OnceLock<Instant> = OnceLock::new();
    START.get_or_init(Instant::now).elapsed()
}

/// Lets other threads go first where there are not enough processors for all: for work that may
/// wait. Has no effect where priorities belong to processes.
pub(crate) fn give_way() {
    /// The lowest priority: 10 let tracking beside map updates keep 68 % of its rate, this 80 %.
    #[cfg(target_os = "linux")]
    const NICENESS: i32 = 19;
    // refused only where raising priorities is meant; the thread then stays as it is
    #[cfg(target_os = "linux")]
    let _ = rustix::process::nice(NICENESS);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_takes_cpu_time() {
        let (process, thread) = (process_cpu(), thread_cpu());
        let mut sum = 0u64;
        while process_cpu() == process || thread_cpu() == thread {
            sum = std::hint::black_box(sum.wrapping_mul(31).wrapping_add(7));
        }
        assert!(process_cpu() > process && thread_cpu() > thread);
    }
}
