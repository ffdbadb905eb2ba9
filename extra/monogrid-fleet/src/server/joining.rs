//! Joining of maps, in a process of its own: `monogrid merge-runs` on what has come of all runs.

use super::store::{Store, StoreError, log_file};
use super::transforms::{OwnPoses, Place, read_joined};
use crate::messages::RunKey;
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

/// When and how maps are joined.
#[derive(Clone, Debug)]
pub struct JoiningConfig {
    /// Time from the end of one joining to the next one at least.
    pub every: Duration,
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
    own: BTreeMap<RunKey, OwnPoses>,
}

impl Joining {
    /// Begins to join what has come.
    ///
    /// # Errors
    /// When recordings cannot be made ready, or the process not be started.
    pub fn begin(store: &mut Store, config: &JoiningConfig) -> Result<Self, StoreError> {
        let (files, own) = store.recordings()?;
        let (log, out) = store.joined();
        let (program, first) = config.program.split_first().unzip();
        let mut command = Command::new(program.cloned().unwrap_or_default());
        command.args(first.unwrap_or_default()).arg("merge-runs");
        command.args(files).arg("--out").arg(&out);
        command.args(&config.arguments).stdin(Stdio::null());
        // ends with this process
        command.env("MONOGRID_PARENT", std::process::id().to_string());
        let spawned = log_file(&log).and_then(|file| {
            command.stdout(file.try_clone()?).stderr(file);
            command.spawn()
        });
        let child = spawned.map_err(|error| StoreError::File {
            path: log.clone(),
            error,
        })?;
        Ok(Self {
            child,
            log,
            out,
            own,
        })
    }

    /// What was joined, or why nothing was, once it is over.
    ///
    /// # Errors
    /// When the process cannot be looked at.
    pub fn ended(&mut self) -> std::io::Result<Option<Result<Vec<Place>, String>>> {
        let Some(status) = self.child.try_wait()? else {
            return Ok(None);
        };
        // the second code says that some maps stay apart
        if !matches!(status.code(), Some(0 | APART)) {
            let why = format!("merge-runs ended with {status}: see {}", self.log.display());
            return Ok(Some(Err(why)));
        }
        let joined = read_joined(&self.out, &self.own);
        Ok(Some(joined.map_err(|error| error.to_string())))
    }
}

impl Drop for Joining {
    fn drop(&mut self) {
        // it may have ended
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
