//! Printing for people who may have stopped reading.
//!
//! The standard macros panic when the other end of a pipe is closed (`monogrid info MAP | head`) or
//! the disk is full, and a run that panics loses its map. These have their names and go on;
//! [`finish`] says in the end what could not be written.
//!
//! Names of files, topics and frames come from outside and may hold what a terminal obeys. All text
//! goes through [`printable`].

use super::talk;
use clap::{Args, ValueEnum};
use monogrid_datasets::log_line;
pub use monogrid_datasets::printable;
use std::fmt::{self, Arguments, Write as _};
use std::io::{self, IsTerminal, Write};
use std::sync::OnceLock;
use std::time::SystemTime;

/// The first thing that went wrong with standard output.
static FAILED: OnceLock<io::Error> = OnceLock::new();

/// How, and how much, is said on standard error, and by whom.
static LOG: OnceLock<(LogArgs, &'static str)> = OnceLock::new();

/// How messages are written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum LogForm {
    /// For people
    #[default]
    Human,
    /// A line of JSON each: time, level, name, message
    Json,
}

/// How bad something is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, ValueEnum)]
pub enum LogLevel {
    /// All is as it should be
    #[default]
    Info,
    /// Something should be looked at
    Warn,
    /// Something did not work
    Error,
}

impl LogLevel {
    /// That of a text, by the word that it begins with, and the text without it.
    fn of(text: &str) -> (Self, &str) {
        let text = text.trim_end_matches('\n');
        let known = [("warning: ", Self::Warn), ("error: ", Self::Error)];
        let found = known
            .into_iter()
            .find_map(|(word, level)| Some((level, text.strip_prefix(word)?)));
        found.unwrap_or((Self::Info, text))
    }

    fn name(self) -> &'static str {
        match self {
            Self::Info => "info",
            Self::Warn => "warn",
            Self::Error => "error",
        }
    }
}

/// What a program says on standard error.
#[derive(Clone, Copy, Debug, Default, Args)]
pub struct LogArgs {
    /// How messages on standard error are written
    #[arg(long, value_name = "FORM", global = true, value_enum, default_value_t)]
    pub log: LogForm,
    /// The least level of a message that is written
    #[arg(long, value_name = "LEVEL", global = true, value_enum, default_value_t)]
    pub log_level: LogLevel,
}

impl LogArgs {
    /// Holds for all that is said from now on in this process, by the program of this name.
    pub fn begin(self, name: &'static str) {
        // the first one holds
        let _ = LOG.set((self, name));
        if self.log == LogForm::Json {
            std::panic::set_hook(Box::new(|panic| err(format_args!("error: {panic}\n"))));
        }
    }

    /// What is written of a text.
    fn written(self, name: &str, text: &str) -> Option<String> {
        let (level, message) = LogLevel::of(text);
        if level < self.log_level {
            return None;
        }
        let now = SystemTime::UNIX_EPOCH.elapsed().unwrap_or_default();
        Some(match self.log {
            LogForm::Human => text.to_owned(),
            LogForm::Json => log_line(now, level.name(), name, message) + "\n",
        })
    }
}

fn log() -> (LogArgs, &'static str) {
    LOG.get().copied().unwrap_or_default()
}

/// Whether bars and spinners are drawn on standard error: on a terminal, by a program that says
/// everything to people.
pub fn is_drawn() -> bool {
    let (LogArgs { log, log_level }, _) = log();
    (log, log_level) == Default::default() && io::stderr().is_terminal()
}

/// Text to standard output.
pub fn out(text: Arguments) {
    if let Err(error) = talk::said(|| write_printable(io::stdout().lock(), text)) {
        // the first one is kept
        let _ = FAILED.set(error);
    }
}

/// Text to standard error; nothing if nobody reads it.
pub fn err(text: Arguments) {
    let ((args, name), mut said) = (log(), String::new());
    // an error of a text that formats itself is none of ours
    let _ = said.write_fmt(text);
    if let Some(text) = args.written(name, &said) {
        let _ = talk::said(|| write_printable(io::stderr().lock(), format_args!("{text}")));
    }
}

fn write_printable(mut to: impl Write, text: Arguments) -> io::Result<()> {
    /// Keeps the error that a formatter cannot hold.
    struct Printed<'a, W>(&'a mut W, io::Result<()>);
    impl<W: Write> fmt::Write for Printed<'_, W> {
        fn write_str(&mut self, text: &str) -> fmt::Result {
            self.1 = self.0.write_all(printable(text).as_bytes());
            match self.1 {
                Ok(()) => Ok(()),
                Err(_) => Err(fmt::Error),
            }
        }
    }
    let mut printed = Printed(&mut to, Ok(()));
    // an error of the writer is kept, one of a text that formats itself is none of ours
    let _ = printed.write_fmt(text);
    printed.1
}

/// Whether everything has arrived on standard output.
pub fn finish() -> Result<(), String> {
    let flushed = io::stdout().lock().flush();
    match (FAILED.get(), flushed) {
        (Some(error), _) => Err(error.to_string()),
        (None, flushed) => flushed.map_err(|error| error.to_string()),
    }
}

/// As that of the standard library, through [`printable`], and without a panic.
#[macro_export]
macro_rules! print {
    ($($arg:tt)*) => { $crate::process::console::out(format_args!($($arg)*)) };
}
/// As that of the standard library, through [`printable`], and without a panic.
#[macro_export]
macro_rules! println {
    () => { $crate::process::console::out(format_args!("\n")) };
    ($($arg:tt)*) => {
        $crate::process::console::out(format_args!("{}\n", format_args!($($arg)*)))
    };
}
/// As that of the standard library, through [`printable`], and without a panic.
#[macro_export]
macro_rules! eprint {
    ($($arg:tt)*) => { $crate::process::console::err(format_args!($($arg)*)) };
}
/// As that of the standard library, through [`printable`], and without a panic.
#[macro_export]
macro_rules! eprintln {
    () => { $crate::process::console::err(format_args!("\n")) };
    ($($arg:tt)*) => {
        $crate::process::console::err(format_args!("{}\n", format_args!($($arg)*)))
    };
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_terminal_obeys_is_shown() {
        let printed = |text: &str| {
            let mut bytes = Vec::new();
            write_printable(&mut bytes, format_args!("{text}")).unwrap();
            String::from_utf8(bytes).unwrap()
        };
        for (text, shown) in [
            ("\x1b[2Jname", "\\u001b[2Jname"),
            ("a\rb\x08\x7f\u{9b}31m", "a\\u000db\\u0008\\u007f\\u009b31m"),
            ("left\u{202e}thgir\u{2066}", "left\\u202ethgir\\u2066"),
            (
                "two\nlines\tand Küche 📷 日本\n",
                "two\nlines\tand Küche 📷 日本\n",
            ),
            ("\\u001b", "\\u001b"),
        ] {
            assert_eq!(printed(text), shown);
        }
    }

    #[test]
    fn levels_are_those_of_the_words_and_less_is_not_said() {
        let args = |log, log_level| LogArgs { log, log_level };
        let people = args(LogForm::Human, LogLevel::Warn);
        assert_eq!(people.written("monogrid", "10 frames\n"), None);
        let text = "warning: dark\n";
        assert_eq!(people.written("monogrid", text).as_deref(), Some(text));
        let programs = args(LogForm::Json, LogLevel::Info);
        for (text, level, message) in [
            ("warning: dark\nand blurred\n", "warn", "dark\nand blurred"),
            ("error: no file\n", "error", "no file"),
            ("10 frames\n", "info", "10 frames"),
        ] {
            let line = programs.written("monogrid", text).unwrap();
            let read: serde_json::Value = serde_json::from_str(&line).unwrap();
            assert_eq!(line.lines().count(), 1);
            assert_eq!(read["name"], "monogrid");
            assert_eq!(
                (&read["level"], &read["message"]),
                (&level.into(), &message.into())
            );
        }
    }

    #[test]
    fn json_stays_the_same() {
        let names = [
            "\x1b]0;title\x07",
            "\u{9b}2J\u{7f}",
            "\u{202e}txt.exe",
            "quote\" and \\",
        ];
        for json in [
            serde_json::to_string(&names),
            serde_json::to_string_pretty(&names),
        ] {
            let json = json.unwrap();
            let read: Vec<String> = serde_json::from_str(&printable(&json)).unwrap();
            assert_eq!(read, names);
            assert!(!printable(&json).contains(monogrid_datasets::is_obeyed));
        }
    }

    #[test]
    fn what_cannot_be_written_is_an_error() {
        struct Full;
        impl Write for Full {
            fn write(&mut self, _: &[u8]) -> io::Result<usize> {
                Err(io::ErrorKind::StorageFull.into())
            }
            fn flush(&mut self) -> io::Result<()> {
                Ok(())
            }
        }
        let error = write_printable(Full, format_args!("text")).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::StorageFull);
    }
}
