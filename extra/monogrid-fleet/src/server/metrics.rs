//! What operators count: how a server is, as Prometheus reads it.

use crate::messages::{AgentState, Fleet};
use monogrid_app::process::usage::rss_bytes;
use monogrid_report::ReportError;
use monogrid_report::explorer::{Answer, Server, Serving};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// How often it is counted.
const EVERY: Duration = Duration::from_secs(1);
/// A server that has not counted for so long answers nobody.
const STUCK_AFTER: Duration = Duration::from_secs(30);

/// Answers `GET /metrics` and `GET /health`, and takes nothing in.
pub struct Metrics {
    last: Arc<Mutex<Last>>,
    serving: Option<Serving>,
}

/// What was counted last.
#[derive(Default)]
struct Last {
    text: String,
    at: Option<Instant>,
    why_nothing_is_kept: Option<String>,
}

impl Last {
    /// Whether the server works; else why not.
    fn health(&self, now: Instant) -> Result<(), String> {
        let silent = self.at.map(|at| now.saturating_duration_since(at));
        match (silent, &self.why_nothing_is_kept) {
            (None, _) => Err("the server begins".to_owned()),
            (Some(silent), _) if silent > STUCK_AFTER => {
                let seconds = silent.as_secs();
                Err(format!("the server has done nothing for {seconds} s"))
            }
            (_, Some(why)) => Err(why.clone()),
            _ => Ok(()),
        }
    }

    fn answer(&self, path: &str) -> Option<Answer> {
        let line = |text: &str| Answer::text(format!("{text}\n"));
        match (path, self.health(Instant::now())) {
            ("/metrics", _) => Some(Answer::text(self.text.clone())),
            ("/health", Ok(())) => Some(line("ok")),
            ("/health", Err(why)) => Some(line(&why).unavailable()),
            _ => None,
        }
    }
}

impl Metrics {
    /// Begins to answer at an address.
    ///
    /// # Errors
    /// An address that cannot be listened at.
    pub fn listen(address: SocketAddr) -> Result<Self, ReportError> {
        let last = Arc::new(Mutex::new(Last::default()));
        let shown = Arc::clone(&last);
        let answer = move |path: &str| locked(&shown).answer(path);
        let serving = Server::listen_openly(address)?.start(answer)?;
        Ok(Self {
            last,
            serving: Some(serving),
        })
    }

    /// Whether it is time to count again.
    pub fn is_due(&self) -> bool {
        locked(&self.last).at.is_none_or(|at| at.elapsed() >= EVERY)
    }

    /// What is answered from now on.
    pub fn set(&self, counted: &Counted, why_nothing_is_kept: Option<String>) {
        *locked(&self.last) = Last {
            text: counted.text(),
            at: Some(Instant::now()),
            why_nothing_is_kept,
        };
    }
}

fn locked(last: &Mutex<Last>) -> MutexGuard<'_, Last> {
    last.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Drop for Metrics {
    fn drop(&mut self) {
        // a panic of its thread has been said
        let _ = self.serving.take().map(Serving::end);
    }
}

/// What was counted.
pub struct Counted<'a> {
    /// All runs.
    pub fleet: &'a Fleet,
    /// Bytes of packets and recordings on the disk.
    pub bytes: u64,
    /// Packets that were not taken.
    pub refused: u64,
    /// Time since the last packet of each run that has not ended, by its key.
    pub silent: BTreeMap<String, Duration>,
}

impl Counted<'_> {
    /// Numbers with their names and what they are.
    fn totals(&self) -> [(&'static str, &'static str, u64); 9] {
        let agents = || self.fleet.agents.iter();
        let joined = || agents().filter(|agent| agent.shared_from_agent.is_some());
        let of = |agents: &mut dyn Iterator<Item = &AgentState>| agents.map(|a| a.keyframes).sum();
        let (keyframes, keyframes_joined): (u64, u64) = (of(&mut agents()), of(&mut joined()));
        let ended = agents().filter(|agent| agent.has_ended).count() as u64;
        let packets = agents().map(|agent| agent.packets).sum();
        let apart = keyframes - keyframes_joined;
        [
            ("runs", "Runs that have come.", agents().count() as u64),
            (
                "runs_joined",
                "Runs whose place is known.",
                joined().count() as u64,
            ),
            ("runs_ended", "Runs of which all has come.", ended),
            ("keyframes", "Keyframes that have come.", keyframes),
            (
                "keyframes_joined",
                "Those of joined runs.",
                keyframes_joined,
            ),
            ("keyframes_apart", "Those of other runs.", apart),
            ("packets", "Packets that have come.", packets),
            (
                "packets_refused_total",
                "Packets that were not taken.",
                self.refused,
            ),
            (
                "disk_bytes",
                "Packets and recordings on the disk.",
                self.bytes,
            ),
        ]
    }

    /// The format of Prometheus: a line of help, one of the type, and numbers.
    pub fn text(&self) -> String {
        let mut text = String::new();
        for (name, help, value) in self.totals() {
            let name = format!("monogrid_fleet_{name}");
            head(&mut text, &name, help);
            // a text takes everything
            let _ = writeln!(text, "{name} {value}");
        }
        let name = "monogrid_fleet_link_lag_seconds";
        head(
            &mut text,
            name,
            "Time since the last packet of a run that goes on.",
        );
        for (run, silent) in &self.silent {
            // keys of runs are letters, digits, -, _ and /
            let _ = writeln!(text, "{name}{{run=\"{run}\"}} {:.1}", silent.as_secs_f64());
        }
        if let Some(bytes) = rss_bytes() {
            let name = "process_resident_memory_bytes";
            head(&mut text, name, "Memory that the server holds.");
            let _ = writeln!(text, "{name} {bytes}");
        }
        text
    }
}

fn head(text: &mut String, name: &str, help: &str) {
    let kind = match name.ends_with("_total") {
        true => "counter",
        false => "gauge",
    };
    let _ = writeln!(text, "# HELP {name} {help}\n# TYPE {name} {kind}");
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::Similarity;
    use monogrid_geometry::Sim3;

    #[test]
    fn a_server_that_does_nothing_or_keeps_nothing_is_not_well() {
        let now = Instant::now();
        let last = |silent_s: u64, why: Option<&str>| Last {
            at: now.checked_sub(Duration::from_secs(silent_s)),
            why_nothing_is_kept: why.map(str::to_owned),
            ..Last::default()
        };
        assert_eq!(last(29, None).health(now), Ok(()));
        assert!(last(31, None).health(now).unwrap_err().contains("31 s"));
        assert_eq!(last(1, Some("full")).health(now), Err("full".to_owned()));
        assert!(Last::default().health(now).is_err());
    }

    #[test]
    fn what_is_counted_is_what_prometheus_reads() {
        let agent = |run: &str, keyframes, is_joined: bool| AgentState {
            run: run.to_owned(),
            packets: 3 * keyframes,
            keyframes,
            has_ended: is_joined,
            shared_from_agent: is_joined.then(|| Similarity::from(&Sim3::identity())),
            set_apart: None,
        };
        let fleet = Fleet {
            version: 1,
            shared: None,
            agents: vec![
                agent("a/1", 5, true),
                agent("b/2", 7, true),
                agent("c/3", 2, false),
            ],
        };
        let counted = Counted {
            fleet: &fleet,
            bytes: 1234,
            refused: 1,
            silent: [("c/3".to_owned(), Duration::from_millis(2500))].into(),
        };
        let text = counted.text();
        for line in [
            "monogrid_fleet_runs 3",
            "monogrid_fleet_runs_joined 2",
            "monogrid_fleet_keyframes 14",
            "monogrid_fleet_keyframes_joined 12",
            "monogrid_fleet_keyframes_apart 2",
            "monogrid_fleet_packets 42",
            "monogrid_fleet_packets_refused_total 1",
            "monogrid_fleet_disk_bytes 1234",
            "monogrid_fleet_link_lag_seconds{run=\"c/3\"} 2.5",
        ] {
            assert!(text.lines().any(|l| l == line), "{line}: {text}");
        }
        let numbers = text.lines().filter(|line| !line.starts_with('#'));
        for line in numbers {
            let (name, value) = line.rsplit_once(' ').unwrap();
            let name = name.split('{').next().unwrap();
            assert!(value.parse::<f64>().is_ok(), "{line}");
            assert!(text.contains(&format!("# TYPE {name} ")), "{line}");
        }
    }
}
