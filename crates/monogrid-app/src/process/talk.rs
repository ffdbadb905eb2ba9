//! No command is silent for long: where nothing else is said, a line every ten seconds names what
//! goes on, and on a terminal a spinner does.

use super::console;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// Time between lines where there is no terminal: with the time between looks below ten seconds.
const LINE_EVERY: Duration = Duration::from_millis(9500);
/// Time between looks.
const LOOK_EVERY: Duration = Duration::from_millis(250);
/// Work that takes less has no spinner.
const SPINNER_AFTER: Duration = Duration::from_secs(1);

static TALK: Mutex<Talk> = Mutex::new(Talk {
    work: None,
    said: None,
});
static SPINNER: Mutex<Option<ProgressBar>> = Mutex::new(None);

/// What goes on, since when, and when something was last said.
#[derive(Debug, Default)]
struct Talk {
    work: Option<(String, Instant)>,
    said: Option<Instant>,
}

impl Talk {
    fn is_due(&mut self, now: Instant) -> bool {
        let said = *self.said.get_or_insert(now);
        now.saturating_duration_since(said) >= LINE_EVERY
    }

    /// What goes on, and for how long.
    fn line(&self, now: Instant) -> Option<String> {
        let (name, begin) = self.work.as_ref()?;
        let seconds = now.saturating_duration_since(*begin).as_secs();
        Some(format!("{name} · {seconds} s"))
    }
}

fn talk() -> MutexGuard<'static, Talk> {
    TALK.lock().unwrap_or_else(PoisonError::into_inner)
}

fn spinner() -> MutexGuard<'static, Option<ProgressBar>> {
    SPINNER.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Talks from now on; what is named until something else is.
pub fn begin(name: &str) {
    doing(name);
    let is_terminal = console::is_drawn();
    let tell = move || {
        loop {
            thread::sleep(LOOK_EVERY);
            if is_terminal {
                show();
                continue;
            }
            let now = Instant::now();
            let line = {
                let mut talk = talk();
                talk.is_due(now).then(|| talk.line(now)).flatten()
            };
            if let Some(line) = line {
                console::err(format_args!("{line}\n"));
            }
        }
    };
    // a command without a thread to talk is silent, and does its work
    let _ = thread::Builder::new().name("talk".into()).spawn(tell);
}

/// Names what goes on from now on.
pub fn doing(name: &str) {
    talk().work = Some((name.to_owned(), Instant::now()));
}

/// Says how far work is that has begun then.
pub fn counting(line: String, begin: Instant) {
    talk().work = Some((line, begin));
}

/// Whether nothing was said for so long that something should be.
pub fn is_due() -> bool {
    talk().is_due(Instant::now())
}

/// Others talk, or nobody should, until this is dropped.
#[derive(Debug)]
pub struct Rest(Option<String>);

/// Lets others talk.
#[must_use]
pub fn rest() -> Rest {
    let before = talk().work.take();
    show();
    Rest(before.map(|(name, _)| name))
}

impl Drop for Rest {
    fn drop(&mut self) {
        if let Some(name) = &self.0 {
            doing(name);
        }
    }
}

/// Draws the spinner, or takes it away.
fn show() {
    let now = Instant::now();
    let (line, is_long) = {
        let talk = talk();
        let begin = talk.work.as_ref().map_or(now, |(_, begin)| *begin);
        (talk.line(now), now.duration_since(begin) > SPINNER_AFTER)
    };
    let mut spinner = spinner();
    match (line, spinner.as_ref()) {
        (Some(line), Some(bar)) => {
            bar.set_message(line);
            bar.tick();
        }
        (Some(line), None) if is_long => {
            let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr_with_hz(8));
            if let Ok(style) = ProgressStyle::with_template("{spinner} {msg}") {
                bar.set_style(style);
            }
            *spinner = Some(bar.with_message(line));
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
    talk().said = Some(Instant::now());
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
    fn work_is_named_when_nothing_was_said_for_long() {
        let begun = Instant::now();
        let after = |seconds| begun + Duration::from_secs(seconds);
        let mut talk = Talk::default();
        assert_eq!((talk.is_due(begun), talk.line(begun)), (false, None));
        talk.work = Some(("final adjustment".into(), begun));
        assert_eq!(
            [9, 10].map(|seconds| talk.is_due(after(seconds))),
            [false, true]
        );
        assert_eq!(
            talk.line(after(12)).as_deref(),
            Some("final adjustment · 12 s")
        );
        // steps that follow each other are no reason to be silent
        talk.work = Some(("report".into(), after(8)));
        assert!(talk.is_due(after(10)));
        assert_eq!(talk.line(after(10)).as_deref(), Some("report · 2 s"));
        talk.said = Some(after(10));
        assert!(!talk.is_due(after(19)));
    }
}
