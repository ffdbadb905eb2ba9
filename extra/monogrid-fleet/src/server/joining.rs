//! Joining of maps, in a process of its own: `monogrid merge-runs` on what has come of all runs.

use super::store::{Joinable, Store};
use super::transforms::{OwnPoses, Place, read_joined};
use crate::messages::RunKey;
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// When and how maps are joined.
#[derive(Clone, Debug)]
pub struct JoiningConfig {
    /// Time from the end of one joining to the next one at least.
    pub every: Duration,
    /// Time that one joining may take; it counts as failed then.
    pub within: Duration,
    /// So many new keyframes are worth a joining, 1 or more.
    pub min_new_keyframes: u64,
    /// Program and first arguments that make it `monogrid`.
    pub program: Vec<OsString>,
    /// Further arguments of `merge-runs`.
    pub arguments: Vec<OsString>,
}

/// Whether maps are joined now: two can be, enough is new, and the last time was long enough ago.
#[must_use]
pub fn is_due(
    config: &JoiningConfig,
    since_last: Duration,
    new_keyframes: u64,
    joinable: usize,
) -> bool {
    joinable >= 2 && new_keyframes >= config.min_new_keyframes && since_last >= config.every
}

/// Exit code of `merge-runs`, and of the server, when some maps stay apart.
pub const APART: i32 = 3;

/// A joining that goes on. Dropping it ends it.
#[derive(Debug)]
pub struct Joining {
    child: Child,
    log: PathBuf,
    out: PathBuf,
    /// The runs that are joined, in the order in which they came.
    pub runs: Vec<RunKey>,
    own: BTreeMap<RunKey, OwnPoses>,
    began: Instant,
    within: Duration,
}

impl Joining {
    /// Begins to join runs into the map of the server.
    ///
    /// # Errors
    /// When the process cannot be started.
    pub fn begin(
        store: &Store,
        config: &JoiningConfig,
        joinable: Joinable,
    ) -> std::io::Result<Self> {
        let (log, out) = (store.joining_log(), store.map());
        let child = start(config, &joinable.files, &log, &out)?;
        Ok(Self {
            child,
            log,
            out,
            runs: joinable.runs,
            own: joinable.own,
            began: Instant::now(),
            within: config.within,
        })
    }

    /// Begins to try whether recordings can be joined, beside two small ones that can: so that it
    /// is known of one alone, and of none.
    ///
    /// # Errors
    /// When files cannot be written, or the process not be started.
    pub fn begin_trial(
        store: &Store,
        config: &JoiningConfig,
        files: &[PathBuf],
    ) -> Result<Self, String> {
        let (log, folder) = (store.joining_log(), store.trial());
        let mut all = super::companion::write(&folder).map_err(|error| error.to_string())?;
        all.extend_from_slice(files);
        let out = folder.join("map");
        let child = start(config, &all, &log, &out).map_err(|error| error.to_string())?;
        Ok(Self {
            child,
            log,
            out,
            runs: Vec::new(),
            own: BTreeMap::new(),
            began: Instant::now(),
            within: config.within,
        })
    }

    /// Whether it could be joined, or why not, once it is over.
    pub fn ended(&mut self) -> Option<Result<(), String>> {
        let status = match self.child.try_wait() {
            Ok(Some(status)) => status,
            Ok(None) if self.began.elapsed() <= self.within => return None,
            Ok(None) => {
                let seconds = self.within.as_secs();
                return Some(Err(format!(
                    "it takes longer than {seconds} s (--join-within)"
                )));
            }
            Err(error) => return Some(Err(error.to_string())),
        };
        // the second code says that some maps stay apart
        Some(match status.code() {
            Some(0 | APART) => Ok(()),
            _ => Err(format!(
                "merge-runs ended with {status}: {}",
                last_line(&self.log)
            )),
        })
    }

    /// What was joined.
    ///
    /// # Errors
    /// When the result cannot be read.
    pub fn joined(&self) -> Result<Vec<Place>, String> {
        read_joined(&self.out, &self.own).map_err(|error| error.to_string())
    }
}

impl Drop for Joining {
    fn drop(&mut self) {
        // it may have ended
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Starts `merge-runs`. What it says replaces what the one before it said.
fn start(
    config: &JoiningConfig,
    files: &[PathBuf],
    log: &Path,
    out: &Path,
) -> std::io::Result<Child> {
    let (program, first) = config.program.split_first().unzip();
    let mut command = Command::new(program.cloned().unwrap_or_default());
    command.args(first.unwrap_or_default()).arg("merge-runs");
    command.args(files).arg("--out").arg(out);
    command.args(&config.arguments).stdin(Stdio::null());
    // ends with this process
    command.env("MONOGRID_PARENT", std::process::id().to_string());
    let file = File::create(log)?;
    let child = command.stdout(file.try_clone()?).stderr(file).spawn()?;
    // where memory ends, Linux ends this process and not the server
    let _ = std::fs::write(format!("/proc/{}/oom_score_adj", child.id()), "1000");
    Ok(child)
}

/// Longest text of a reason, bytes.
const MAX_REASON_BYTES: u64 = 300;

/// The last line that the process said.
fn last_line(log: &Path) -> String {
    let end = || -> std::io::Result<String> {
        let mut file = File::open(log)?;
        let length = file.metadata()?.len();
        file.seek(SeekFrom::Start(length.saturating_sub(MAX_REASON_BYTES)))?;
        let mut bytes = Vec::new();
        file.take(MAX_REASON_BYTES).read_to_end(&mut bytes)?;
        Ok(String::from_utf8_lossy(&bytes).into_owned())
    };
    let text = end().unwrap_or_default();
    let line = text.lines().rfind(|line| !line.trim().is_empty());
    line.unwrap_or("it said nothing").to_owned()
}

/// Looks for the run that keeps others from being joined: the last one of the fewest, in the order
/// in which they came, that cannot be joined.
#[derive(Clone, Debug)]
pub struct Search {
    /// The runs.
    pub runs: Vec<RunKey>,
    /// Their recordings.
    pub files: Vec<PathBuf>,
    /// Whether all of them failed a second time.
    is_sure: bool,
    /// So many of the first can be joined.
    passed: Option<usize>,
    /// So many of the first cannot.
    failed: usize,
    why: String,
}

/// How a search goes on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Next {
    /// So many of the first runs are tried.
    Try(usize),
    /// This one is to be set apart, and why.
    SetApart(RunKey, String),
    /// All can be joined now: what was wrong has passed.
    Passed,
    /// Not even none can be joined: it is the computer, and no run.
    Nobody(String),
}

impl Search {
    /// Begins with runs that could not be joined.
    #[must_use]
    pub fn new(runs: Vec<RunKey>, files: Vec<PathBuf>) -> Self {
        Self {
            is_sure: false,
            passed: None,
            failed: runs.len(),
            why: String::new(),
            runs,
            files,
        }
    }

    /// What is to be done.
    #[must_use]
    pub fn next(&self) -> Next {
        match (self.passed, self.failed) {
            _ if self.passed == Some(self.runs.len()) => Next::Passed,
            _ if !self.is_sure => Next::Try(self.runs.len()),
            (None, 0) => Next::Nobody(self.why.clone()),
            (None, failed) => Next::Try(failed / 2),
            (Some(passed), failed) if passed + 1 < failed => Next::Try((passed + failed) / 2),
            (Some(passed), _) => Next::SetApart(self.runs[passed].clone(), self.why.clone()),
        }
    }

    /// Takes what a trial of so many runs came to.
    pub fn tried(&mut self, count: usize, result: Result<(), String>) {
        self.is_sure = true;
        match result {
            Ok(()) => self.passed = Some(count),
            Err(why) => {
                self.failed = count;
                self.why = why;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// How a search ends where runs with these numbers cannot be joined with those before them; and
    /// its trials.
    fn search(count: usize, is_bad: impl Fn(usize) -> bool) -> (Next, usize) {
        let runs = (0..count).map(|k| RunKey::new("a", k as u64).unwrap());
        let mut search = Search::new(runs.collect(), Vec::new());
        for trials in 0.. {
            match search.next() {
                Next::Try(count) if is_bad(count) => search.tried(count, Err("bad".into())),
                Next::Try(count) => search.tried(count, Ok(())),
                end => return (end, trials),
            }
        }
        unreachable!()
    }

    #[test]
    fn the_run_that_keeps_others_from_joining_is_found() {
        for count in [2, 3, 7, 200] {
            for bad in 0..count {
                let (end, trials) = search(count, |tried| tried > bad);
                let run = RunKey::new("a", bad as u64).unwrap();
                assert_eq!(end, Next::SetApart(run, "bad".into()), "{bad} of {count}");
                assert!(trials <= 2 + count.ilog2() as usize + 1, "{trials}");
            }
        }
    }

    #[test]
    fn what_has_passed_and_what_is_the_computer_is_no_fault_of_a_run() {
        assert_eq!(search(5, |_| false), (Next::Passed, 1));
        assert_eq!(search(5, |_| true).0, Next::Nobody("bad".into()));
    }
}
