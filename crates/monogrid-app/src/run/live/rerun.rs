//! The Rerun viewer: a program of its own that asks the page of a run as a browser does.

use crate::process::failure::{Classify, Failure};
use std::io::Write;
use std::net::{Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Who looks at a run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum View {
    /// A browser, at this address; at any port that is free where it is 0.
    Browser(SocketAddr),
    /// The Rerun viewer, or a file for it.
    Rerun(Option<PathBuf>),
}

impl View {
    /// As the command line has it.
    ///
    /// # Errors
    /// What was expected.
    pub fn parse(text: &str) -> Result<Self, String> {
        if text == "rerun" {
            return Ok(Self::Rerun(None));
        }
        match text.strip_prefix("rrd=") {
            Some(file) if !file.is_empty() => Ok(Self::Rerun(Some(file.into()))),
            _ => {
                let port = text
                    .parse()
                    .map(|port: u16| (Ipv4Addr::LOCALHOST, port).into());
                let address = port.or_else(|_| text.parse());
                address.map(Self::Browser).map_err(|_| {
                    "expected a port (0 to 65535; 0: any that is free), an address with a port, \
                     rerun, or rrd=FILE"
                        .to_owned()
                })
            }
        }
    }

    /// Says what is missing before anything is computed.
    pub fn check(&self, may_replace: bool) -> Result<(), Failure> {
        let Self::Rerun(file) = self else {
            return Ok(());
        };
        program()?;
        match file {
            Some(file) if file.exists() && !may_replace => Err(Failure::input(format!(
                "{} exists; choose another file, or --force",
                file.display()
            ))),
            _ => Ok(()),
        }
    }
}

const PROGRAM: &str = "monogrid-rerun";

/// The program, beside this one or on the PATH.
fn program() -> Result<PathBuf, Failure> {
    let name = format!("{PROGRAM}{}", std::env::consts::EXE_SUFFIX);
    let own = std::env::current_exe().ok();
    let beside = own.as_deref().and_then(Path::parent).map(Path::to_owned);
    let path = std::env::var_os("PATH").unwrap_or_default();
    let folders = beside.into_iter().chain(std::env::split_paths(&path));
    let mut places = folders.map(|folder| folder.join(&name));
    places.find(|place| place.is_file()).ok_or_else(|| {
        Failure::input(format!(
            "{PROGRAM} is not installed: cargo install --path extra/monogrid-rerun (Rust 1.95 or \
             newer), and for --view=rerun the viewer: pip install rerun-sdk"
        ))
    })
}

/// How long after the last frame there is time for the last news to be taken.
const LAST_NEWS: Duration = Duration::from_secs(3);

/// The program while it looks at a run.
#[derive(Debug)]
pub struct Rerun {
    child: Child,
    file: Option<PathBuf>,
}

impl Rerun {
    /// Lets it look at the page of a run.
    pub fn start(url: &str, file: Option<&Path>) -> Result<Self, Failure> {
        let program = program()?;
        let mut command = Command::new(&program);
        // every user of this computer sees arguments, and whoever knows the address sees the run
        command.arg("-").stdin(Stdio::piped());
        // nothing of this process is held open by it, nor by a viewer that outlives both
        command.stdout(Stdio::null()).stderr(Stdio::null());
        if let Some(file) = file {
            command.arg("--rrd").arg(file);
        }
        let doing = format!("{} cannot be started", program.display());
        let mut child = command.spawn().while_running(&doing)?;
        if let Some(mut input) = child.stdin.take() {
            // what becomes of a program that does not read it is seen in the end
            let _ = writeln!(input, "{url}");
        }
        Ok(Self {
            child,
            file: file.map(Path::to_owned),
        })
    }

    /// Waits until it has taken the last news, but not for long after the last frame; what it lacks
    /// is said.
    pub fn end(mut self, last_frame: Instant) {
        if let Some(lack) = self.wait(last_frame) {
            eprintln!("warning: {PROGRAM} {lack}");
        }
    }

    fn wait(&mut self, last_frame: Instant) -> Option<String> {
        let status = loop {
            match self.child.try_wait() {
                Ok(None) if last_frame.elapsed() < LAST_NEWS => {
                    std::thread::sleep(Duration::from_millis(20));
                }
                Ok(Some(status)) => break status,
                Ok(None) | Err(_) => {
                    // so that nobody writes into a file of a run that is over
                    let _ = self.child.kill();
                    let _ = self.child.wait();
                    return Some("was too slow and lacks the end of the run".to_owned());
                }
            }
        };
        let has_file = self.file.as_ref().is_none_or(|file| file.is_file());
        (!status.success() || !has_file).then(|| {
            let viewer = match self.file {
                Some(_) => "",
                None => "; the viewer itself is installed by pip install rerun-sdk",
            };
            format!("has not shown the whole run ({status}){viewer}")
        })
    }
}

#[cfg(test)]
mod tests {
    use super::View;

    #[test]
    fn a_run_is_looked_at_by_a_browser_or_by_rerun() {
        let at = |ip: [u8; 4]| Ok(View::Browser((ip, 8080).into()));
        assert_eq!(View::parse("8080"), at([127, 0, 0, 1]));
        assert_eq!(View::parse("0.0.0.0:8080"), at([0, 0, 0, 0]));
        assert_eq!(View::parse("rerun"), Ok(View::Rerun(None)));
        let file = View::Rerun(Some("a=b.rrd".into()));
        assert_eq!(View::parse("rrd=a=b.rrd"), Ok(file));
        for wrong in ["", "70000", "-1", "rrd", "rrd=", "browser", "rerun=1"] {
            assert!(
                View::parse(wrong).is_err_and(|said| said.contains("rrd=FILE")),
                "{wrong}"
            );
        }
    }
}
