//! A run as a process of its own: a fault of it, or its end by others, harms no other.

use super::class::End;
use super::schedule::Grown;
use monogrid_app::process::failure::{Classify, Failure};
use monogrid_app::process::usage::bytes_in;
use std::ffi::OsString;
use std::fs::OpenOptions;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// Names the process that a process is to end with.
const PARENT: &str = "MONOGRID_PARENT";
/// The interpreter of the Python package, which is then the program.
const PYTHON: &str = "MONOGRID_PYTHON";
/// Time between looks at a run.
const LOOK_EVERY: Duration = Duration::from_millis(20);
/// Time that a run gets to save what it has, when it is stopped.
const GRACE: Duration = Duration::from_secs(60);

/// How a run is watched.
#[derive(Clone, Copy)]
pub struct Watch<'a> {
    /// It is stopped when it takes longer.
    pub timeout: Option<Duration>,
    /// It is stopped when this is set.
    pub interrupted: &'a AtomicBool,
    /// Hears of the largest resident memory until now, bytes.
    pub peak: &'a Grown<'a>,
}

/// A run that has ended.
#[derive(Debug)]
pub struct Ended {
    /// How.
    pub end: End,
    /// Wall time.
    pub wall: Duration,
    /// CPU time, where the system says it.
    pub cpu: Option<Duration>,
    /// Largest resident memory, bytes, where the system says it.
    pub peak_rss_bytes: Option<u64>,
}

/// Ends this process when the one ends that `MONOGRID_PARENT` names, where the system can do that
/// (Linux).
pub fn end_with_parent() {
    #[cfg(target_os = "linux")]
    {
        use rustix::process::{Signal, getppid, set_parent_process_death_signal};
        let named = std::env::var(PARENT).ok();
        let Some(named) = named.and_then(|text| text.parse::<i32>().ok()) else {
            return;
        };
        // refused nowhere; without it the process only lives longer
        let _ = set_parent_process_death_signal(Some(Signal::KILL));
        if getppid().is_none_or(|parent| parent.as_raw_nonzero().get() != named) {
            // it was gone before
            std::process::exit(130);
        }
    }
}

/// This program, to be started once more.
fn this_program() -> Result<Command, Failure> {
    let program = std::env::current_exe().while_running("this program cannot be found")?;
    let is_python = program
        .file_name()
        .is_some_and(|name| name.to_string_lossy().starts_with("python"));
    if is_python {
        let python = std::env::var_os(PYTHON).map_or(program, PathBuf::from);
        let mut command = Command::new(python);
        command.args(["-m", "monogrid"]);
        return Ok(command);
    }
    // the same one, also when its file was replaced meanwhile
    let same = Path::new("/proc/self/exe");
    Ok(Command::new(if same.exists() { same } else { &program }))
}

/// Runs this program with these arguments until it ends; what it says is appended to the log.
pub fn run(arguments: &[OsString], log: &Path, watch: Watch) -> Result<Ended, Failure> {
    let doing = format!("{} cannot be written", log.display());
    let open = || OpenOptions::new().append(true).create(true).open(log);
    let (out, err) = (open().while_running(&doing)?, open().while_running(&doing)?);
    let mut command = this_program()?;
    command.args(arguments).stdin(Stdio::null());
    command.stdout(out).stderr(err);
    command.env(PARENT, std::process::id().to_string());
    #[cfg(unix)]
    // an interrupt from the terminal is for this process, which passes it on
    std::os::unix::process::CommandExt::process_group(&mut command, 0);
    let begin = Instant::now();
    let child = command.spawn().while_running("no run can be started")?;
    wait(child, begin, watch)
}

fn wait(mut child: Child, begin: Instant, watch: Watch) -> Result<Ended, Failure> {
    // why it was asked to stop, and when
    let mut stop: Option<(End, Instant)> = None;
    let mut peak = None;
    let mut ended = None;
    while !has_ended(&mut child, &mut ended).while_running("a run cannot be waited for")? {
        let status = format!("/proc/{}/status", child.id());
        peak = peak.max(bytes_in(status, "VmHWM:"));
        if let Some(bytes) = peak {
            (watch.peak)(bytes);
        }
        if let Some((_, since)) = stop {
            if since.elapsed() > GRACE {
                let _ = child.kill();
            }
        } else if watch.interrupted.load(Ordering::Relaxed) {
            stop = Some((End::Interrupted, Instant::now()));
            ask_to_stop(&mut child);
        } else if watch.timeout.is_some_and(|limit| begin.elapsed() > limit) {
            stop = Some((End::TooLong, Instant::now()));
            ask_to_stop(&mut child);
        }
        thread::sleep(LOOK_EVERY);
    }
    let wall = begin.elapsed();
    let cpu = cpu_time(child.id());
    let status = child.wait().while_running("a run cannot be waited for")?;
    let end = match (stop, status.code()) {
        // it had finished all the same
        (_, Some(code @ (0 | 3))) => End::Exit(code),
        (Some((why, _)), _) => why,
        (None, Some(code)) => End::Exit(code),
        (None, None) => End::Signal(signal_of(status)),
    };
    Ok(Ended {
        end,
        wall,
        cpu,
        peak_rss_bytes: peak,
    })
}

/// Whether it has ended; it is not taken leave of, so that the system still knows its times.
#[cfg(unix)]
fn has_ended(child: &mut Child, _: &mut Option<ExitStatus>) -> std::io::Result<bool> {
    use rustix::process::{Pid, WaitId, WaitIdOptions, waitid};
    let options = WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT;
    match waitid(WaitId::Pid(Pid::from_child(child)), options) {
        Ok(status) => Ok(status.is_some()),
        Err(rustix::io::Errno::INTR) => Ok(false),
        Err(error) => Err(error.into()),
    }
}

#[cfg(not(unix))]
fn has_ended(child: &mut Child, ended: &mut Option<ExitStatus>) -> std::io::Result<bool> {
    *ended = child.try_wait()?;
    Ok(ended.is_some())
}

/// As Ctrl-C does: it saves what it has.
#[cfg(unix)]
fn ask_to_stop(child: &mut Child) {
    use rustix::process::{Pid, Signal, kill_process};
    // it may have ended just now
    let _ = kill_process(Pid::from_child(child), Signal::INT);
}

#[cfg(not(unix))]
fn ask_to_stop(child: &mut Child) {
    let _ = child.kill();
}

#[cfg(unix)]
fn signal_of(status: ExitStatus) -> i32 {
    use std::os::unix::process::ExitStatusExt;
    status.signal().unwrap_or_default()
}

#[cfg(not(unix))]
fn signal_of(_: ExitStatus) -> i32 {
    0
}

/// CPU time of a process that has ended and of those that it waited for.
#[cfg(target_os = "linux")]
fn cpu_time(process: u32) -> Option<Duration> {
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).ok()?;
    cpu_in(&stat, rustix::param::clock_ticks_per_second())
}

#[cfg(not(target_os = "linux"))]
fn cpu_time(_: u32) -> Option<Duration> {
    None
}

/// User and system time, own and of children: the fields 14 to 17, counted from 1; the second one
/// is a name that may hold anything.
#[cfg(target_os = "linux")]
fn cpu_in(stat: &str, ticks_per_second: u64) -> Option<Duration> {
    let (_, after_name) = stat.rsplit_once(')')?;
    let times = after_name.split_whitespace().skip(11).take(4);
    let ticks: Vec<u64> = times.filter_map(|time| time.parse().ok()).collect();
    let all: u64 = ticks.iter().sum();
    (ticks.len() == 4).then(|| Duration::from_secs_f64(all as f64 / ticks_per_second.max(1) as f64))
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn times_are_read_behind_any_name() {
        let stat = "12 (a) S 1) Z 1 2 3 4 5 6 7 8 9 10 100 20 3 4 20 0 1";
        assert_eq!(cpu_in(stat, 100), Some(Duration::from_millis(1270)));
        assert_eq!(cpu_in("12 (a) Z 1", 100), None);
    }
}
