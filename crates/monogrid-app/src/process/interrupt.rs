//! Ctrl-C and a request to end (SIGTERM): the first one ends what goes on and saves it, a second
//! one ends the process.

use crate::process::failure::{Classify, Failure};
use monogrid_video::{Aside, Patience, Sink, Waited};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Set by the first one.
pub static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// How long work may take to notice an interrupt by itself.
const GRACE: Duration = Duration::from_millis(1000);

/// From now on interrupts are for this.
pub fn listen() {
    // a second handler in one process is refused, which does no harm
    let _ = ctrlc::set_handler(|| {
        if INTERRUPTED.swap(true, Ordering::Relaxed) {
            std::process::exit(130);
        }
        eprintln!("interrupted: saving (once more to stop at once)");
    });
}

/// Whether there was one.
pub fn is_interrupted() -> bool {
    INTERRUPTED.load(Ordering::Relaxed)
}

/// Does work in a thread of its own. After an interrupt it may end by itself within a moment; work
/// that does not is left alone.
///
/// # Errors
/// When it was left alone, or the system has no more threads.
pub fn abandonable<T: Send + 'static>(
    name: &str,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Failure> {
    let patience = Patience {
        limit: None,
        interrupted: Some(&INTERRUPTED),
    };
    let result = |sink: &Sink<T>| {
        sink.put(work());
    };
    let aside = Aside::start(name, patience, result);
    let mut aside = aside.while_running("no thread can be started")?;
    let waited = match aside.wait() {
        Waited::Interrupted => aside.wait_within(Patience {
            limit: Some(GRACE),
            interrupted: None,
        }),
        waited => waited,
    };
    match waited {
        Waited::Item(result) => Ok(result),
        Waited::Ended | Waited::TooLong(_) | Waited::Interrupted => Err(Failure::Interrupted),
    }
}
