//! Shows a run of monogrid in the Rerun viewer while it goes on, or writes it as an `.rrd` file.
//!
//! `monogrid run --view=rerun` and `--view=rrd=FILE` start this program. It asks the page of the
//! run on this computer for what is new, a few times a second, as a browser does (`--view`), so
//! that a run never waits for it, and ends with the run.

mod ask;
mod news;
mod show;

use ask::Page;
use rerun::{RecordingStream, RecordingStreamBuilder};
use show::Shown;
use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

/// Time between questions.
const ASK_EVERY: Duration = Duration::from_millis(150);

const USAGE: &str = "usage: monogrid-rerun http://127.0.0.1:PORT/TOKEN/ [--rrd FILE]

Shows the run of `monogrid run --view` at this address in the Rerun viewer (the program `rerun` on
the PATH), or writes it to FILE. With - in place of the address, it is the first line of standard
input, which other users of the computer do not see.
`monogrid run --view=rerun` and `--view=rrd=FILE` call it.";

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let (url, file) = match words[..] {
        ["-h" | "--help"] => {
            println!("{USAGE}");
            return ExitCode::SUCCESS;
        }
        [url] => (url, None),
        [url, "--rrd", file] | ["--rrd", file, url] => (url, Some(PathBuf::from(file))),
        _ => {
            eprintln!("{USAGE}");
            return ExitCode::from(2);
        }
    };
    let url = match url {
        "-" => first_line(),
        url => Ok(url.to_owned()),
    };
    match url.and_then(|url| follow(&url, file.as_deref())) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("monogrid-rerun: {}", printable(&error.to_string()));
            ExitCode::FAILURE
        }
    }
}

/// Text as a terminal may have it: answers and addresses come from outside, and what it would obey
/// is shown instead.
fn printable(text: &str) -> String {
    let turns = |c| matches!(c, '\u{61c}' | '\u{200e}' | '\u{200f}'
        | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    let is_obeyed = |c: char| turns(c) || c.is_control() && !matches!(c, '\n' | '\t');
    let shown = text.chars().map(|c| match is_obeyed(c) {
        true => format!("\\u{:04x}", u32::from(c)),
        false => c.to_string(),
    });
    shown.collect()
}

/// The address on standard input.
fn first_line() -> Result<String, Box<dyn Error>> {
    let mut line = String::new();
    std::io::stdin().read_line(&mut line)?;
    Ok(line.trim_end().to_owned())
}

/// Asks until the run says that nothing more comes.
fn show_all(
    page: &Page,
    shown: &mut Shown,
    recording: &RecordingStream,
) -> Result<(), Box<dyn Error>> {
    loop {
        let answer = page.ask(&shown.question());
        let answer = answer.map_err(|error| format!("the run has gone before its end: {error}"))?;
        if shown.take(recording, &serde_json::from_slice(&answer)?)? {
            return Ok(());
        }
        std::thread::sleep(ASK_EVERY);
    }
}

/// Follows a run to its end.
fn follow(url: &str, file: Option<&Path>) -> Result<(), Box<dyn Error>> {
    let page = Page::at(url)?;
    let builder = RecordingStreamBuilder::new("monogrid");
    let recording = match file {
        Some(file) => builder.save(file)?,
        None => builder.spawn()?,
    };
    let mut shown = Shown::begin(&recording)?;
    let outcome = show_all(&page, &mut shown, &recording);
    // what was shown is kept, however it ended
    recording.flush_blocking()?;
    outcome
}

#[cfg(test)]
mod tests {
    use super::printable;

    #[test]
    fn what_a_terminal_obeys_is_shown() {
        let said = printable("HTTP/1.1 404 \x1b[2J\u{9b}31m\u{202e}\r Küche\n");
        assert_eq!(said, "HTTP/1.1 404 \\u001b[2J\\u009b31m\\u202e\\u000d Küche\n");
    }
}
