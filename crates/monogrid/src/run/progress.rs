//! The progress bar on standard error: frames, rate, state of tracking, keyframes.

use super::frames::{FrameFate, FrameRow};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::time::{Duration, Instant};

/// A bar that is only drawn on a terminal; warnings are always written.
#[derive(Debug)]
pub struct Progress {
    bar: ProgressBar,
    begin: Instant,
    /// When a line was last written, where there is no terminal for the bar.
    last_line: Option<Instant>,
    num_done: usize,
    num_warnings: usize,
}

/// Time between lines where there is no terminal.
const LINE_EVERY: Duration = Duration::from_secs(20);

/// Warnings of the same kind that are written before the rest is only counted.
const MAX_WARNINGS: usize = 20;

impl Progress {
    /// A bar for so many frames.
    pub fn new(num_frames: usize, show: bool) -> Self {
        let target = if show {
            ProgressDrawTarget::stderr_with_hz(8)
        } else {
            ProgressDrawTarget::hidden()
        };
        let bar = ProgressBar::with_draw_target(Some(num_frames as u64), target);
        if let Ok(style) = ProgressStyle::with_template("{bar:30} {pos}/{len} frames · {msg}") {
            bar.set_style(style);
        }
        Self {
            bar,
            begin: Instant::now(),
            last_line: (!show).then(Instant::now),
            num_done: 0,
            num_warnings: 0,
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
            FrameFate::BeforeSeed => "waiting for the seed depth".to_owned(),
        };
        let rate = self.num_done as f64 / self.begin.elapsed().as_secs_f64().max(1e-3);
        let text = format!("{rate:.0} per second · {num_keyframes} keyframes · {state}");
        if let Some(last) = &mut self.last_line
            && last.elapsed() >= LINE_EVERY
        {
            *last = Instant::now();
            let of = self.bar.length().unwrap_or_default();
            eprintln!("{} of {of} frames · {text}", self.num_done);
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
    pub fn finish(&self) {
        self.bar.finish_and_clear();
        if self.num_warnings > MAX_WARNINGS {
            eprintln!("warning: {} more", self.num_warnings - MAX_WARNINGS);
        }
    }
}
