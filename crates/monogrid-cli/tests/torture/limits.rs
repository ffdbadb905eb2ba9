//! Running the program within limits.

use crate::{MAX_KB, MAX_SECONDS};
use std::ffi::OsStr;
use std::fs::File;
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// How a run ended.
#[derive(Debug)]
pub struct Ended {
    /// Exit code; `None` after a signal, or when the time was over.
    pub code: Option<i32>,
    /// Standard error.
    pub said: String,
    pub took: Duration,
}

impl Ended {
    /// What was wrong with the way it ended; `None` where it ended as it should, with or without an
    /// error.
    pub fn harm(&self) -> Option<String> {
        let first = self.said.lines().next().unwrap_or_default();
        if self.took.as_secs() >= MAX_SECONDS {
            return Some(format!("ran for more than {MAX_SECONDS} s"));
        }
        if self.said.contains("panicked") {
            return Some(format!("panicked: {first}"));
        }
        match self.code {
            Some(0..=4) => None,
            code => Some(format!("ended with {code:?}: {first}")),
        }
    }
}

/// The program in a shell that runs `before` and limits the address space.
pub fn limited<A: AsRef<OsStr>>(before: &str, args: impl IntoIterator<Item = A>) -> Command {
    let mut command = Command::new("sh");
    command
        .arg("-c")
        .arg(format!(
            "ulimit -v {MAX_KB}; ulimit -c 0; {before} exec \"$0\" \"$@\""
        ))
        .arg(env!("CARGO_BIN_EXE_monogrid"))
        .args(args)
        // a thread's arena of 64 MB address space each says nothing about memory
        .env("MALLOC_ARENA_MAX", "2")
        .stdin(Stdio::null());
    command
}

/// Runs to the end, or for [`MAX_SECONDS`]; output goes through files in `folder`.
pub fn run(mut command: Command, folder: &Path) -> Ended {
    let said = folder.join("stderr");
    command
        .stdout(Stdio::null())
        .stderr(File::create(&said).unwrap());
    let begin = Instant::now();
    let mut child = command.spawn().unwrap();
    let code = wait(&mut child, Duration::from_secs(MAX_SECONDS));
    Ended {
        code,
        took: begin.elapsed(),
        said: String::from_utf8_lossy(&std::fs::read(said).unwrap()).into_owned(),
    }
}

/// Exit code within the time; else the child is killed.
pub fn wait(child: &mut Child, time: Duration) -> Option<i32> {
    let begin = Instant::now();
    let mut pause = Duration::from_micros(500);
    loop {
        if let Some(status) = child.try_wait().unwrap() {
            assert!(status.code().is_some() || status.signal().is_some());
            return status.code();
        }
        if begin.elapsed() >= time {
            child.kill().unwrap();
            child.wait().unwrap();
            return None;
        }
        std::thread::sleep(pause);
        pause = (2 * pause).min(Duration::from_millis(20));
    }
}
