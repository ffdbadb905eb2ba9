//! Progress on standard error: a bar on a terminal, a line now and then elsewhere.

use crate::process::progress;
use crate::process::talk::{self, Rest};
use crate::run::tracking::frames::{FrameFate, FrameRow};
use indicatif::ProgressBar;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::thread;
use std::time::{Duration, Instant};

/// A bar that is only drawn on a terminal; warnings are always written.
#[derive(Debug)]
pub struct Progress {
    bar: ProgressBar,
    begin: Instant,
    /// Lines are written, where there is no terminal for the bar.
    has_lines: bool,
    num_done: usize,
    num_warnings: usize,
    /// What was named before is named again after the last frame.
    resting: Option<Rest>,
}

/// Time between looks at work of which others count what is done.
const LOOK_EVERY: Duration = Duration::from_millis(250);

/// Warnings of the same kind that are written before the rest is only counted.
const MAX_WARNINGS: usize = 20;

impl Progress {
    /// A bar for so many frames; 0 where their number is not known.
    pub fn new(num_frames: usize, show: bool) -> Self {
        Self {
            bar: bar(num_frames, "frames", show),
            begin: Instant::now(),
            has_lines: !show,
            num_done: 0,
            num_warnings: 0,
            resting: Some(talk::rest()),
        }
    }

    /// One more frame is done.
    pub fn frame(&mut self, row: &FrameRow, num_keyframes: usize) {
        self.num_done += 1;
        let state = match &row.fate {
            FrameFate::Processed(report) => match report.reason {
                Some(reason) => format!("{} ({reason})", report.state.name()),
                None => report.state.name().to_owned(),
            },
            FrameFate::Skipped(_) => "frame unreadable".to_owned(),
            FrameFate::Repeated => "image repeated".to_owned(),
            FrameFate::Dropped => "frame dropped".to_owned(),
        };
        let elapsed = self.begin.elapsed();
        let rate = self.num_done as f64 / elapsed.as_secs_f64().max(1e-3);
        let total = self.bar.length().unwrap_or_default() as usize;
        let left = left(self.num_done, total, elapsed);
        let text = format!("{rate:.0} per second{left} · {num_keyframes} keyframes · {state}");
        // a frame may take long: lines come by the clock, not by frames
        if self.has_lines {
            let of = match total {
                0 => String::new(),
                _ => format!(" of {total}"),
            };
            let line = format!("{}{of} frames · {text}", self.num_done);
            talk::counting(line, self.begin);
        }
        self.bar.set_message(text);
        self.bar.set_position(self.num_done as u64);
    }

    /// Something the user should know at once.
    pub fn warn(&mut self, text: &str) {
        self.num_warnings += 1;
        if self.num_warnings <= MAX_WARNINGS {
            self.bar.suspend(|| eprintln!("warning: {text}"));
        }
    }

    /// Removes the bar.
    pub fn finish(&mut self) {
        self.bar.finish_and_clear();
        self.resting = None;
        if self.num_warnings > MAX_WARNINGS {
            eprintln!("warning: {} more", self.num_warnings - MAX_WARNINGS);
        }
    }
}

/// Does work that counts keyframes or something else of which there are so many (0 where that is
/// not known), and says meanwhile how far it is and how long it will take; `look` is called each
/// time.
pub fn watched<T>(
    (what, of, total): (&str, &str, usize),
    show: bool,
    look: impl Fn() + Send,
    work: impl FnOnce(&AtomicUsize) -> T,
) -> T {
    let _resting = talk::rest();
    let done = &AtomicUsize::new(0);
    let (ended, wait) = channel::<()>();
    thread::scope(|scope| {
        scope.spawn(move || {
            let bar = bar(total, &format!("{of} · {what}"), show);
            let begin = Instant::now();
            // an end of the work closes the channel
            while wait.recv_timeout(LOOK_EVERY) == Err(RecvTimeoutError::Timeout) {
                look();
                let num_done = done.load(Ordering::Relaxed);
                let left = left(num_done, total, begin.elapsed());
                bar.set_position(num_done as u64);
                bar.set_message(left.clone());
                if !show && talk::is_due() {
                    match total {
                        0 => eprintln!("{what}: {num_done} {of}"),
                        _ => eprintln!("{what}: {num_done} of {total} {of}{left}"),
                    }
                }
            }
            bar.finish_and_clear();
        });
        let result = work(done);
        drop(ended);
        result
    })
}

fn bar(count: usize, of: &str, show: bool) -> ProgressBar {
    let template = match count {
        0 => format!("{{spinner}} {{pos}} {of} · {{msg}}"),
        _ => format!("{{bar:30}} {{pos}}/{{len}} {of} · {{msg}}"),
    };
    progress::bar(count, &template, show.then_some(8))
}

/// How long the rest will take if it goes on as until now; empty where that cannot be known.
fn left(num_done: usize, total: usize, elapsed: Duration) -> String {
    if num_done == 0 || num_done >= total {
        return String::new();
    }
    let rest = (total - num_done) as f64 / num_done as f64;
    let seconds = (elapsed.as_secs_f64() * rest).ceil() as u64;
    match seconds {
        0..100 => format!(" · about {seconds} s left"),
        _ => format!(" · about {} min left", seconds.div_ceil(60)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_left_follows_from_what_was_done() {
        let elapsed = Duration::from_secs(30);
        assert_eq!(left(30, 45, elapsed), " · about 15 s left");
        assert_eq!(left(1, 11, elapsed), " · about 5 min left");
        assert_eq!(
            [
                left(0, 9, elapsed),
                left(9, 9, elapsed),
                left(5, 0, elapsed)
            ]
            .concat(),
            ""
        );
    }

    #[test]
    fn watched_work_gives_its_result() {
        let result = watched(
            ("counting", "sheep", 3),
            false,
            || {},
            |done| done.fetch_add(3, Ordering::Relaxed) + 7,
        );
        assert_eq!(result, 7);
    }
}
