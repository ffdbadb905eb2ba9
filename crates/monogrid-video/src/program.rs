//! The program that decodes a source, which must not outlive it.

use std::io::{Error, ErrorKind, Result};
use std::process::{Child, Command, ExitStatus};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Time between looks at whether the program has ended.
const LOOK_EVERY: Duration = Duration::from_millis(5);

/// A program that runs for a source: the thread that reads starts it, any thread may end it.
///
/// It is in a process group of its own, so that an interrupt at the terminal, which is for this
/// process, does not reach it, and what it started is ended with it.
#[derive(Clone, Debug, Default)]
pub(crate) struct Program(Arc<Mutex<State>>);

#[derive(Debug, Default)]
struct State {
    child: Option<Child>,
    /// Nothing is to be started any more.
    is_over: bool,
}

impl Program {
    /// Starts it; the pipes of the child are for the caller to take. It may take so many bytes of
    /// memory for data, where the system can limit that (Linux).
    pub(crate) fn start<T>(
        &self,
        command: &mut Command,
        most_bytes: Option<u64>,
        pipes: impl FnOnce(&mut Child) -> T,
    ) -> Result<T> {
        bind(command, most_bytes);
        let mut state = self.lock();
        if state.is_over {
            return Err(Error::new(ErrorKind::Interrupted, "nobody waits for it"));
        }
        let child = state.child.insert(command.spawn()?);
        Ok(pipes(child))
    }

    /// Waits until it has ended by itself; `None` where it was never started, or was ended before.
    pub(crate) fn wait(&self) -> Option<ExitStatus> {
        loop {
            if let Some(status) = self.lock().child.as_mut()?.try_wait().ok()? {
                return Some(status);
            }
            std::thread::sleep(LOOK_EVERY);
        }
    }

    /// Ends it, and lets none be started any more. Waits for nothing.
    pub(crate) fn end(&self) {
        let mut state = self.lock();
        state.is_over = true;
        state.kill();
    }

    /// Ends it and waits until it is gone: for the thread that reads.
    pub(crate) fn finish(&self) {
        let child = {
            let mut state = self.lock();
            state.kill();
            state.child.take()
        };
        if let Some(mut child) = child {
            drop(child.wait());
        }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    fn kill(&mut self) {
        let Some(child) = &mut self.child else {
            return;
        };
        // its number is its own until it was waited for
        if !matches!(child.try_wait(), Ok(None)) {
            return;
        }
        #[cfg(unix)]
        if let Some(group) = rustix::process::Pid::from_raw(child.id().cast_signed()) {
            use rustix::process::{Signal, kill_process_group};
            let _ = kill_process_group(group, Signal::KILL);
        }
        drop(child.kill());
    }
}

/// Puts the program into a group of its own; where the system can do that (Linux), it ends with
/// this process however that ends, and takes no more memory than it may.
fn bind(command: &mut Command, most_bytes: Option<u64>) {
    #[cfg(not(target_os = "linux"))]
    let _ = most_bytes;
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(command, 0);
    #[cfg(target_os = "linux")]
    {
        use rustix::process::{Resource, Rlimit, Signal};
        use rustix::process::{getppid, set_parent_process_death_signal, setrlimit};
        use std::os::unix::process::CommandExt;
        let parent = Some(rustix::process::getpid());
        let in_child = move || {
            set_parent_process_death_signal(Some(Signal::KILL))?;
            if most_bytes.is_some() {
                let (current, maximum) = (most_bytes, most_bytes);
                setrlimit(Resource::Data, Rlimit { current, maximum })?;
            }
            match getppid() == parent {
                true => Ok(()),
                // it was gone before
                false => Err(Error::from(ErrorKind::Interrupted)),
            }
        };
        #[expect(
            unsafe_code,
            reason = "between fork and exec: three system calls, no memory, no locks"
        )]
        // SAFETY: the closure makes three system calls, and none allocates or takes a lock
        unsafe {
            command.pre_exec(in_child);
        }
    }
}
