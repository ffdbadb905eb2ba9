//! What the node says to people: on standard error, and on `/rosout` to those who look from
//! elsewhere.

use crate::args::Args;
use crate::clock::Clock;
use crate::node::{Outlet, Quality, RosNode};
use clap::ValueEnum;
use monogrid_datasets::{log_line, printable};
use monogrid_messages::builtin_interfaces::Time;
use monogrid_messages::rcl_interfaces;
use std::io::{Write, stderr};
use std::sync::Arc;
use std::time::Duration;

/// How bad it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// For those who look for a fault.
    Debug,
    /// What is as it should be.
    Info,
    /// Something should be looked at.
    Warn,
    /// Something does not work.
    Error,
    /// The node ends.
    Fatal,
}

impl Severity {
    /// The names of all, from the least on.
    pub const NAMES: [&str; 5] = ["debug", "info", "warn", "error", "fatal"];
    const ALL: [Self; 5] = [
        Self::Debug,
        Self::Info,
        Self::Warn,
        Self::Error,
        Self::Fatal,
    ];

    /// That of a name, in which capitals do not count.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        let mut all = Self::NAMES.iter().zip(Self::ALL);
        let found = all.find(|(own, _)| own.eq_ignore_ascii_case(name));
        found.map(|(_, severity)| severity)
    }

    /// The number that messages have.
    #[must_use]
    pub fn number(self) -> u8 {
        match self {
            Self::Debug => rcl_interfaces::DEBUG,
            Self::Info => rcl_interfaces::INFO,
            Self::Warn => rcl_interfaces::WARN,
            Self::Error => rcl_interfaces::ERROR,
            Self::Fatal => rcl_interfaces::FATAL,
        }
    }
}

/// How messages on standard error are written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum LogForm {
    /// For people
    #[default]
    Human,
    /// A line of JSON each: time, level, name, message
    Json,
}

impl LogForm {
    /// A line for standard error.
    #[must_use]
    pub fn line(self, stamp: Time, severity: Severity, name: &str, text: &str) -> String {
        let (kind, Time { sec, nanosec }) = (format!("{severity:?}"), stamp);
        let since_1970 = Duration::new(u64::try_from(sec).unwrap_or(0), nanosec);
        match self {
            Self::Human => {
                let (kind, text) = (kind.to_uppercase(), printable(text));
                format!("[{kind}] [{sec}.{nanosec:09}] [{name}]: {text}")
            }
            Self::Json => log_line(since_1970, &kind.to_lowercase(), name, text),
        }
    }
}

/// Says things.
pub struct Log {
    outlet: Outlet<rcl_interfaces::Log>,
    form: LogForm,
    name: String,
    least: Severity,
    clock: Arc<Clock>,
}

impl Log {
    /// Begins to publish, as the logger of these options; less than their severity is not said.
    ///
    /// # Errors
    /// A network that cannot be used.
    pub fn new(node: &mut RosNode, args: &Args, clock: Arc<Clock>) -> anyhow::Result<Self> {
        Ok(Self {
            outlet: node.publisher("/rosout", Quality::Log)?,
            form: args.log,
            name: args.logger(),
            least: args.least_severity(),
            clock,
        })
    }

    /// Says something.
    pub fn say(&self, severity: Severity, text: &str) {
        if severity < self.least {
            return;
        }
        let (stamp, name) = (self.clock.now(), &self.name);
        let line = self.form.line(stamp, severity, name, text);
        // what cannot be said is no reason to stop
        let _ = writeln!(stderr(), "{line}");
        let _ = self.outlet.publish(rcl_interfaces::Log {
            stamp,
            level: severity.number(),
            name: name.clone(),
            msg: printable(text).into_owned(),
            ..rcl_interfaces::Log::default()
        });
    }
}

/// Whether a count has become so much larger that it is said again: twice what was said.
pub fn has_grown(count: u64, said: &mut u64) -> bool {
    let has_grown = count > 0 && count >= said.saturating_mul(2);
    if has_grown {
        *said = count;
    }
    has_grown
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn severities_have_the_order_of_their_numbers() {
        for pair in Severity::ALL.windows(2) {
            assert!(pair[0] < pair[1] && pair[0].number() < pair[1].number());
        }
        for (name, severity) in Severity::NAMES.iter().zip(Severity::ALL) {
            assert_eq!(Severity::from_name(&name.to_uppercase()), Some(severity));
        }
        assert_eq!(Severity::from_name("loud"), None);
    }

    #[test]
    fn programs_read_one_line_of_json() {
        let stamp = Time {
            sec: 86_400,
            nanosec: 5_000_000,
        };
        let text = "no \"images\"\nfor 5 s";
        let line = |form: LogForm| form.line(stamp, Severity::Warn, "monogrid", text);
        let json = "{\"time\":\"1970-01-02T00:00:00.005Z\",\"level\":\"warn\",\
                    \"name\":\"monogrid\",\
                    \"message\":\"no \\\"images\\\"\\nfor 5 s\"}";
        assert_eq!(line(LogForm::Json), json);
        let human = format!("[WARN] [86400.005000000] [monogrid]: {text}");
        assert_eq!(line(LogForm::Human), human);
    }

    #[test]
    fn what_goes_on_is_said_ever_more_seldom() {
        let mut said = 0;
        let times = (0..1000).filter(|count| has_grown(*count, &mut said));
        assert_eq!(times.count(), 10);
        assert_eq!(said, 512);
    }
}
