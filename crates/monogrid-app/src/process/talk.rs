//! No command is silent for long: where nothing else is said, a line every ten seconds names what
//! goes on, and on a terminal a spinner does.

use super::console;
use indicatif::{ProgressBar, ProgressDrawTarget};
use std::io::IsTerminal;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// Time between lines where there is no terminal: with the time between looks below ten seconds.
const LINE_EVERY: Duration = Duration::from_millis(9500);
/// Time between looks.
const LOOK_EVERY: Duration = Duration::from_millis(250);

static WORK: Mutex<Option<Work>> = Mutex::new(None);
/// When something was last said.
static SAID: Mutex<Option<Instant>> = Mutex::new(None);
static SPINNER: Mutex<Option<ProgressBar>> = Mutex::new(None);

/// What goes on.
#[derive(Clone, Debug)]
struct Work {
    name: String,
    begin: Instant,
}

fn work() -> MutexGuard<'static, Option<Work>> {
    WORK.lock().unwrap_or_else(PoisonError::into_inner)
}

fn spinner() -> MutexGuard<'static, Option<ProgressBar>> {
    SPINNER.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Talks from now on; what is named until something else is.
pub fn begin(name: &str) {
    doing(name);
    let is_terminal = std::io::stderr().is_terminal();
    // a command without a thread to talk is silent, and does its work
    let _ = thread::Builder::new().name("talk".into()).spawn(move || {
        loop {
            thread::sleep(LOOK_EVERY);
            if is_terminal {
                show();
            } else if let Some(line) = line(Instant::now()) {
                console::err(format_args!("{line}\n"));
            }
        }
    });
}

/// Names what goes on from now on.
pub fn doing(name: &str) {
    *work() = Some(Work {
        name: name.to_owned(),
        begin: Instant::now(),
    });
}

/// Whether nothing was said for so long that something should be.
pub fn is_due() -> bool {
    has_been_silent(Instant::now())
}

fn has_been_silent(now: Instant) -> bool {
    let mut said = SAID.lock().unwrap_or_else(PoisonError::into_inner);
    let since = now.saturating_duration_since(*said.get_or_insert(now));
    since >= LINE_EVERY
}

/// Others talk, or nobody should, until this is dropped.
#[derive(Debug)]
pub struct Rest(Option<String>);

/// Lets others talk.
#[must_use]
pub fn rest() -> Rest {
    let before = work().take();
    show();
    Rest(before.map(|work| work.name))
}

impl Drop for Rest {
    fn drop(&mut self) {
        if let Some(name) = &self.0 {
            doing(name);
        }
    }
}

/// What is to be said now, where nothing was for long.
fn line(now: Instant) -> Option<String> {
    let work = work();
    let work = work.as_ref()?;
    if !has_been_silent(now) {
        return None;
    }
    let seconds = now.saturating_duration_since(work.begin).as_secs();
    Some(format!("{} · {seconds} s", work.name))
}

/// Draws the spinner, or takes it away.
fn show() {
    let work = work().clone();
    let mut spinner = spinner();
    match (work, spinner.as_ref()) {
        // what takes no time is not worth a look
        (Some(work), None) if work.begin.elapsed() > Duration::from_secs(1) => {
            let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr_with_hz(8));
            bar.set_message(work.name);
            *spinner = Some(bar);
        }
        (Some(work), Some(bar)) => {
            let seconds = work.begin.elapsed().as_secs();
            bar.set_message(format!("{} · {seconds} s", work.name));
            bar.tick();
        }
        (None, Some(bar)) => {
            bar.finish_and_clear();
            *spinner = None;
        }
        (_, None) => {}
    }
}

/// Something is said: the spinner makes room, and there is no need to talk for a while.
pub(super) fn said<T>(say: impl FnOnce() -> T) -> T {
    *SAID.lock().unwrap_or_else(PoisonError::into_inner) = Some(Instant::now());
    let bar = spinner().clone();
    match bar {
        Some(bar) => bar.suspend(say),
        None => say(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_every_ten_seconds_names_the_work_unless_others_talk() {
        said(|| ());
        doing("final adjustment");
        let begun = Instant::now();
        let after = |seconds| line(begun + Duration::from_secs(seconds));
        assert_eq!(after(9), None);
        assert_eq!(after(12).as_deref(), Some("final adjustment · 12 s"));
        said(|| ());
        assert_eq!(after(9), None);
        // steps that follow each other are no reason to be silent
        doing("report");
        assert_eq!(after(12).as_deref(), Some("report · 12 s"));
        let resting = rest();
        assert_eq!(after(60), None);
        drop(resting);
        assert_eq!(after(21).as_deref(), Some("report · 21 s"));
        *work() = None;
    }
}
