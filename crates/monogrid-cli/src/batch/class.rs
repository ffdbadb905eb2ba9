//! What became of a recording, in one word, and what a batch does about it.

use super::metrics::Metrics;
use clap::ValueEnum;
use serde::{Deserialize, Serialize};

/// What became of a recording; the worst last.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, ValueEnum,
)]
#[serde(rename_all = "kebab-case")]
pub enum Class {
    /// Tracked to its end, and at least 90 % of its frames have a pose
    Ok,
    /// Lost for good, or for more than 10 % of its frames
    Lost,
    /// Tracking never started: there is no map
    NotStarted,
    /// The recording or its options cannot be used
    BadInput,
    /// It took longer than --timeout
    Timeout,
    /// The run failed, and said why
    Failed,
    /// The run ended by a fault of the program
    Crashed,
    /// The run was ended from outside, by the system when memory ran out, or by somebody
    Killed,
    /// The disk was full
    NoSpace,
    /// The batch was interrupted; what was mapped until then is saved
    Interrupted,
    /// It has begun, and its end was not seen
    #[default]
    Unfinished,
}

/// Share of the frames of a recording that have a pose if it is said to have worked.
const MIN_COVERAGE: f64 = 0.9;

/// How a run ended, as its parent saw it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// By itself, with this exit code.
    Exit(i32),
    /// By this signal.
    Signal(i32),
    /// It was stopped because it took too long.
    TooLong,
    /// It was stopped because the batch was.
    Interrupted,
}

/// What a program says that panicked, whatever its exit code.
const PANIC: &str = "panicked at ";
/// Signals by which others end a program: hang up, interrupt, kill, terminate.
const FROM_OUTSIDE: [i32; 4] = [1, 2, 9, 15];
/// How the system says that something cannot be read now: an error of the device, too little
/// memory, too many open files, a network or its file system that does not answer (EIO, EAGAIN,
/// ENOMEM, ENFILE, EMFILE, ENETDOWN to EHOSTUNREACH, ESTALE, EREMOTEIO).
const CAN_PASS: [i32; 16] = [
    5, 11, 12, 23, 24, 100, 101, 102, 103, 104, 110, 111, 112, 113, 116, 121,
];
/// How the system says that a disk, or what a user may have of it, is full: ENOSPC, EDQUOT, and
/// EFBIG of `ulimit -f`.
const DISK_FULL: [&str; 3] = ["(os error 28)", "(os error 122)", "(os error 27)"];

impl Class {
    /// What became of a run that ended so, said this and left that.
    pub fn of(end: End, said: &str, metrics: Option<&Metrics>) -> Self {
        let is_full = || DISK_FULL.iter().any(|error| said.contains(error));
        let can_pass = || {
            CAN_PASS
                .iter()
                .any(|n| said.contains(&format!("(os error {n})")))
        };
        match end {
            End::TooLong => Self::Timeout,
            End::Interrupted | End::Exit(4 | 130) => Self::Interrupted,
            End::Signal(signal) if FROM_OUTSIDE.contains(&signal) => Self::Killed,
            End::Signal(_) => Self::Crashed,
            End::Exit(1) if said.contains(PANIC) => Self::Crashed,
            End::Exit(1 | 2) if is_full() => Self::NoSpace,
            End::Exit(1 | 2) if can_pass() => Self::Failed,
            End::Exit(2) => Self::BadInput,
            End::Exit(0 | 3) => metrics.map_or(Self::Failed, Self::of_metrics),
            End::Exit(_) => match metrics.map(|metrics| metrics.status.as_str()) {
                Some("unreadable") => Self::BadInput,
                Some("failed") => Self::Crashed,
                _ => Self::Failed,
            },
        }
    }

    fn of_metrics(metrics: &Metrics) -> Self {
        match metrics.status.as_str() {
            "done" if metrics.coverage() >= MIN_COVERAGE => Self::Ok,
            "not_initialised" | "stands_still" | "only_turns" => Self::NotStarted,
            "unreadable" => Self::BadInput,
            _ => Self::Lost,
        }
    }

    /// Whether it says something about the recording: the same run would end so again.
    pub fn is_final(self) -> bool {
        matches!(
            self,
            Self::Ok | Self::Lost | Self::NotStarted | Self::BadInput | Self::Timeout
        )
    }

    /// Whether it is worth another try at once, alone, with all of the memory.
    pub fn is_tried_again(self) -> bool {
        self == Self::Killed
    }

    /// Whether nothing more is to be begun.
    pub fn stops_the_batch(self) -> bool {
        matches!(self, Self::NoSpace | Self::Interrupted)
    }

    /// As in `task.json` and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Lost => "lost",
            Self::NotStarted => "not-started",
            Self::BadInput => "bad-input",
            Self::Timeout => "timeout",
            Self::Failed => "failed",
            Self::Crashed => "crashed",
            Self::Killed => "killed",
            Self::NoSpace => "no-space",
            Self::Interrupted => "interrupted",
            Self::Unfinished => "unfinished",
        }
    }

    /// What it means, for people: as the help of the command line says it.
    pub fn meaning(self) -> String {
        let value = self.to_possible_value();
        let help = value.and_then(|value| value.get_help().map(ToString::to_string));
        help.unwrap_or_default()
    }

    /// All of them, the best first.
    pub fn all() -> &'static [Self] {
        Self::value_variants()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn metrics(status: &str, tracked: u64) -> Metrics {
        Metrics {
            status: status.into(),
            frames: 100,
            tracked,
            lost_episodes: 0,
            keyframes: 3,
            loop_closures: 0,
            frames_per_second: 1.0,
            scale: "metric".into(),
            points: 1,
            ate_rmse_m: None,
            warnings: Vec::new(),
        }
    }

    #[test]
    fn every_end_has_its_class() {
        let of = |end, said: &str, status: &str, tracked| {
            Class::of(end, said, Some(&metrics(status, tracked)))
        };
        let exit = End::Exit;
        assert_eq!(of(exit(0), "", "done", 90), Class::Ok);
        assert_eq!(of(exit(0), "", "done", 89), Class::Lost);
        assert_eq!(of(exit(3), "", "lost", 100), Class::Lost);
        assert_eq!(of(exit(3), "", "fragment", 95), Class::Lost);
        assert_eq!(of(exit(3), "", "not_initialised", 0), Class::NotStarted);
        for status in ["stands_still", "only_turns"] {
            assert_eq!(of(exit(3), "", status, 0), Class::NotStarted);
        }
        assert_eq!(of(exit(3), "", "partial", 40), Class::Lost);
        assert_eq!(of(exit(1), "", "unreadable", 50), Class::BadInput);
        assert_eq!(Class::of(exit(2), "error: no", None), Class::BadInput);
        assert_eq!(Class::of(exit(1), "error: x", None), Class::Failed);
        for error in [5, 24, 110, 116] {
            let said = format!("error: a.png: it failed (os error {error})");
            assert_eq!(Class::of(exit(2), &said, None), Class::Failed);
            assert_eq!(of(exit(1), &said, "unreadable", 50), Class::Failed);
        }
        let missing = "error: a.png: not found (os error 2)";
        assert_eq!(Class::of(exit(2), missing, None), Class::BadInput);
        for error in [27, 28, 122] {
            let said = format!("error: map.ot cannot be written: (os error {error})");
            assert_eq!(Class::of(exit(1), &said, None), Class::NoSpace);
            assert_eq!(of(exit(0), &said, "done", 100), Class::Ok, "a warning");
        }
        assert_eq!(Class::of(exit(0), "", None), Class::Failed, "no summary");
        let said = "thread 'mapper' (7) panicked at a.rs:1:2:\nno\nerror: the mapper failed: no";
        assert_eq!(of(exit(1), said, "failed", 50), Class::Crashed);
        assert_eq!(Class::of(exit(1), said, None), Class::Crashed);
        assert_eq!(of(exit(1), "", "failed", 50), Class::Crashed);
        assert_eq!(Class::of(exit(1), "error: no", None), Class::Failed);
        assert_eq!(Class::of(End::Signal(11), "", None), Class::Crashed);
        assert_eq!(Class::of(End::Signal(9), "", None), Class::Killed);
        assert_eq!(Class::of(End::TooLong, "", None), Class::Timeout);
        assert_eq!(of(exit(4), "", "interrupted", 5), Class::Interrupted);
        assert_eq!(Class::of(End::Interrupted, "", None), Class::Interrupted);
    }

    #[test]
    fn names_are_those_of_the_file_and_the_command_line() {
        for class in Class::all() {
            let json = serde_json::to_string(class).unwrap();
            assert_eq!(json, format!("\"{}\"", class.name()));
            let value = class.to_possible_value().unwrap();
            assert_eq!(value.get_name(), class.name());
        }
        assert!(Class::all().is_sorted(), "the worst last");
    }

    #[test]
    fn what_is_not_the_recordings_fault_is_done_again() {
        let again: Vec<&str> = Class::all()
            .iter()
            .filter(|class| !class.is_final())
            .map(|class| class.name())
            .collect();
        let expected = [
            "failed",
            "crashed",
            "killed",
            "no-space",
            "interrupted",
            "unfinished",
        ];
        assert_eq!(again, expected);
    }
}
