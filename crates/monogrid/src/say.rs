//! Printing for people who may have stopped reading.
//!
//! The standard macros panic when the other end of a pipe is closed (`monogrid info MAP | head`), and a run that
//! panics loses its map. These have their names and go on without a reader.

use std::fmt::Arguments;
use std::io::Write;

/// Text to standard output; nothing if nobody reads it.
pub fn out(text: Arguments) {
    let _ = std::io::stdout().lock().write_fmt(text);
}

/// Text to standard error; nothing if nobody reads it.
pub fn err(text: Arguments) {
    let _ = std::io::stderr().lock().write_fmt(text);
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
