//! How a command fails: exit code and message.

use super::console;
use monogrid_pipeline::attempt;
use monogrid_report::ReportError;
use std::fmt::Display;

/// Why a command did not do its job.
#[derive(Debug)]
pub enum Failure {
    /// Exit code 1: something went wrong while running.
    Running(anyhow::Error),
    /// Exit code 2: wrong usage or bad input.
    Input(anyhow::Error),
    /// Exit code 4: the user stopped it before there was anything to save.
    Interrupted,
}

/// What is said when there is nothing to save.
const NOTHING_SAVED: &str =
    "interrupted before the first image was tracked: there is nothing to save";

/// How a command that ran to its end ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// Exit code 0.
    Done,
    /// Exit code 3: tracking never started or was lost for good.
    NotTracked,
    /// Exit code 3: not all recordings that were to be merged show the same places.
    Apart,
    /// Exit code 4: the user stopped it; what there was until then is saved.
    Interrupted,
}

/// What every command returns.
pub type CommandResult = Result<Outcome, Failure>;

impl Failure {
    /// Bad input described by `message`.
    pub fn input(message: impl Display) -> Self {
        Self::Input(anyhow::anyhow!("{message}"))
    }

    /// A failure while running described by `message`.
    pub fn running(message: impl Display) -> Self {
        Self::Running(anyhow::anyhow!("{message}"))
    }

    /// The error, for those who do not know of exit codes.
    pub fn into_error(self) -> Box<dyn std::error::Error + Send + Sync> {
        match self {
            Self::Running(error) | Self::Input(error) => error.into(),
            Self::Interrupted => NOTHING_SAVED.into(),
        }
    }

    /// Writes the message to standard error and returns the exit code.
    pub fn report(&self) -> u8 {
        let (code, error) = match self {
            Self::Running(error) => (1, error),
            Self::Input(error) => (2, error),
            Self::Interrupted => {
                eprintln!("{NOTHING_SAVED}");
                return Outcome::Interrupted.code();
            }
        };
        eprintln!("error: {}", render(error));
        code
    }
}

impl From<ReportError> for Failure {
    fn from(error: ReportError) -> Self {
        match error.is_bad_input() {
            true => Self::Input(error.into()),
            false => Self::Running(error.into()),
        }
    }
}

/// The error and its causes in one sentence; a cause whose text its parent already contains is not
/// repeated.
pub fn render(error: &anyhow::Error) -> String {
    let mut text = String::new();
    for cause in error.chain() {
        let cause = cause.to_string();
        if text.is_empty() {
            text = cause;
        } else if !text.contains(&cause) {
            text.push_str(": ");
            text.push_str(&cause);
        }
    }
    text
}

impl Outcome {
    /// What the process ends with.
    pub fn code(self) -> u8 {
        match self {
            Self::Done => 0,
            Self::NotTracked | Self::Apart => 3,
            Self::Interrupted => 4,
        }
    }
}

/// Does what a command does; a panic is a failure while running.
pub fn caught(command: impl FnOnce() -> CommandResult) -> CommandResult {
    let failed = |message| {
        Failure::running(format!(
            "the program failed, which is a fault of its own: {message}"
        ))
    };
    attempt(command).unwrap_or_else(|message| Err(failed(message)))
}

/// Says why a command failed; its exit code. A command whose result could not be printed has
/// failed.
pub fn exit_code(result: CommandResult) -> u8 {
    match (result, console::finish()) {
        (Err(failure), _) => failure.report(),
        (Ok(_), Err(error)) => not_printed(&error).report(),
        (Ok(outcome), Ok(())) => outcome.code(),
    }
}

/// Help, version, or what is wrong with the command line; the exit code.
pub fn usage(message: &clap::Error) -> u8 {
    let printed = message.print().map_err(|error| error.to_string());
    let printed = printed.and_then(|()| console::finish());
    match printed {
        _ if message.use_stderr() => 2,
        Ok(()) => 0,
        Err(error) => not_printed(&error).report(),
    }
}

fn not_printed(error: &str) -> Failure {
    Failure::running(format!("standard output cannot be written: {error}"))
}

/// Says which class an error belongs to.
pub trait Classify<T> {
    /// The error means bad input (exit code 2).
    fn bad_input(self) -> Result<T, Failure>;
    /// The error happened while running (exit code 1).
    fn while_running(self, doing: &str) -> Result<T, Failure>;
}

impl<T, E: Into<anyhow::Error>> Classify<T> for Result<T, E> {
    fn bad_input(self) -> Result<T, Failure> {
        self.map_err(|error| Failure::Input(error.into()))
    }

    fn while_running(self, doing: &str) -> Result<T, Failure> {
        self.map_err(|error| Failure::Running(error.into().context(doing.to_owned())))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn causes_are_joined_and_not_repeated() {
        let inner = std::io::Error::other("disk on fire");
        let error = anyhow::Error::from(inner).context("cannot write map");
        assert_eq!(render(&error), "cannot write map: disk on fire");
        let inner = std::io::Error::other("disk on fire");
        let error = anyhow::Error::from(inner).context("cannot write: disk on fire");
        assert_eq!(render(&error), "cannot write: disk on fire");
    }
}
