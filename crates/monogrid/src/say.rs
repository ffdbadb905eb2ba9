//! Printing for people who may have stopped reading.
//!
//! The standard macros panic when the other end of a pipe is closed (`monogrid info MAP | head`) or the disk is full, and a
//! run that panics loses its map. These have their names and go on; [`finish`] says in the end what could not be written.

use std::fmt::Arguments;
use std::io::{self, Write};
use std::sync::OnceLock;

/// The first thing that went wrong with standard output.
static FAILED: OnceLock<io::Error> = OnceLock::new();

/// Text to standard output.
pub fn out(text: Arguments) {
    if let Err(error) = io::stdout().lock().write_fmt(text) {
        // the first one is kept
        let _ = FAILED.set(error);
    }
}

/// Text to standard error; nothing if nobody reads it.
pub fn err(text: Arguments) {
    let _ = io::stderr().lock().write_fmt(text);
}

/// Whether everything has arrived on standard output.
pub fn finish() -> Result<(), String> {
    let flushed = io::stdout().lock().flush();
    match (FAILED.get(), flushed) {
        (Some(error), _) => Err(error.to_string()),
        (None, flushed) => flushed.map_err(|error| error.to_string()),
    }
}

macro_rules! print {
    ($($arg:tt)*) => { $crate::say::out(format_args!($($arg)*)) };
}
macro_rules! println {
    () => { $crate::say::out(format_args!("\n")) };
    ($($arg:tt)*) => { $crate::say::out(format_args!("{}\n", format_args!($($arg)*))) };
}
macro_rules! eprint {
    ($($arg:tt)*) => { $crate::say::err(format_args!($($arg)*)) };
}
macro_rules! eprintln {
    () => { $crate::say::err(format_args!("\n")) };
    ($($arg:tt)*) => { $crate::say::err(format_args!("{}\n", format_args!($($arg)*))) };
}
