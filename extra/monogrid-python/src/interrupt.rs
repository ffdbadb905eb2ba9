//! Ctrl-C within a second, whatever is computed.

use pyo3::prelude::*;
use std::panic::resume_unwind;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::sync::{PoisonError, RwLock};
use std::thread::{self, Builder};
use std::time::Duration;

/// Time between looks whether somebody has interrupted.
const LOOK_EVERY: Duration = Duration::from_millis(50);
/// Questions that are answered between two looks: a long ray takes a tenth of a millisecond.
const CHUNK: usize = 256;

/// Does work without Python's lock. Ctrl-C ends the wait: the work goes on alone to its end, and
/// its result is dropped.
pub fn wait_for<T: Send + 'static>(
    py: Python,
    work: impl FnOnce() -> T + Send + 'static,
) -> PyResult<T> {
    let (done, is_done) = sync_channel(1);
    let thread = Builder::new().name("monogrid".to_owned()).spawn(move || {
        // nobody may wait any more
        let _ = done.send(work());
    })?;
    py.detach(|| result_of(is_done, || thread.join()))
}

/// The result of a thread that was begun without Python's lock, or Ctrl-C, or its panic.
fn result_of<T>(is_done: Receiver<T>, join: impl FnOnce() -> thread::Result<()>) -> PyResult<T> {
    loop {
        match is_done.recv_timeout(LOOK_EVERY) {
            Ok(result) => return Ok(result),
            Err(RecvTimeoutError::Timeout) => Python::attach(|py| py.check_signals())?,
            Err(RecvTimeoutError::Disconnected) => {
                let nothing = || Box::new("a thread ended without a result") as _;
                resume_unwind(join().err().unwrap_or_else(nothing));
            }
        }
    }
}

/// Answers questions about something that others may read at once, and change in turn, without
/// Python's lock; Ctrl-C ends it.
pub fn look_at<L: Send + Sync, I: Sync, T: Send>(
    py: Python,
    lock: &RwLock<L>,
    questions: &[I],
    answer: impl Fn(&L, usize, &I) -> T + Sync,
) -> PyResult<Vec<T>> {
    let stop = AtomicBool::new(false);
    let work = || {
        let looked_at = lock.read().unwrap_or_else(PoisonError::into_inner);
        let mut answers = Vec::with_capacity(questions.len());
        for (chunk, questions) in questions.chunks(CHUNK).enumerate() {
            if stop.load(Relaxed) {
                break;
            }
            let numbered = questions.iter().enumerate();
            answers.extend(numbered.map(|(k, q)| answer(&looked_at, chunk * CHUNK + k, q)));
        }
        answers
    };
    if questions.len() <= CHUNK {
        return Ok(py.detach(work));
    }
    py.detach(|| {
        thread::scope(|scope| {
            let (done, is_done) = sync_channel(1);
            let work = &work;
            // the channel ends with the thread
            let working = scope.spawn(move || {
                // whoever was interrupted has no use for it
                let _ = done.send(work());
            });
            let answers = result_of(is_done, || working.join());
            answers.inspect_err(|_| stop.store(true, Relaxed))
        })
    })
}
