//! Progress over things that are done one by one: a bar on a terminal, a line for each.

use super::talk::{self, Rest};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

/// A bar that is drawn so many times per second, or never.
pub fn bar(count: usize, template: &str, hz: Option<u8>) -> ProgressBar {
    let target = hz.map_or_else(
        ProgressDrawTarget::hidden,
        ProgressDrawTarget::stderr_with_hz,
    );
    let bar = ProgressBar::with_draw_target(Some(count as u64), target);
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style);
    }
    bar
}

/// Counts what is done, on standard error.
#[derive(Debug)]
pub struct Progress {
    bar: ProgressBar,
    /// A bar that is drawn is enough.
    _resting: Option<Rest>,
}

impl Progress {
    /// Over so many things; the bar is only drawn on a terminal.
    pub fn new(count: usize, of: &str, is_shown: bool) -> Self {
        let template = format!("{{bar:30}} {{pos}}/{{len}} {of} · {{elapsed}} gone, {{eta}} to go");
        let bar = bar(count, &template, is_shown.then_some(4));
        talk::doing(of);
        Self {
            bar,
            _resting: is_shown.then(talk::rest),
        }
    }

    /// One more is done: what there is to say of it.
    pub fn done(&self, text: &str) {
        self.bar.inc(1);
        let (count, all) = (self.bar.position(), self.bar.length().unwrap_or(0));
        self.bar.suspend(|| eprintln!("{count}/{all} {text}"));
    }

    /// Removes the bar.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}
