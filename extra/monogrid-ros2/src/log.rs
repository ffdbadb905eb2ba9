//! What the node says to people: on standard error, and on `/rosout` to those who look from
//! elsewhere.

use crate::clock::Clock;
use crate::node::{Outlet, Quality, RosNode};
use monogrid_datasets::printable;
use monogrid_messages::rcl_interfaces;
use std::io::{Write, stderr};
use std::sync::Arc;

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

/// Says things.
pub struct Log {
    outlet: Outlet<rcl_interfaces::Log>,
    name: String,
    least: Severity,
    clock: Arc<Clock>,
}

impl Log {
    /// Begins to publish, as the logger of this name; less than `least` is not said.
    ///
    /// # Errors
    /// A network that cannot be used.
    pub fn new(
        node: &mut RosNode,
        name: String,
        least: Severity,
        clock: Arc<Clock>,
    ) -> anyhow::Result<Self> {
        Ok(Self {
            outlet: node.publisher("/rosout", Quality::Log)?,
            name,
            least,
            clock,
        })
    }

    /// Says something.
    pub fn say(&self, severity: Severity, text: &str) {
        if severity < self.least {
            return;
        }
        let (stamp, name) = (self.clock.now(), &self.name);
        let (kind, text) = (format!("{severity:?}").to_uppercase(), printable(text));
        let (sec, nanosec) = (stamp.sec, stamp.nanosec);
        let line = format!("[{kind}] [{sec}.{nanosec:09}] [{name}]: {text}");
        // what cannot be said is no reason to stop
        let _ = writeln!(stderr(), "{line}");
        let _ = self.outlet.publish(rcl_interfaces::Log {
            stamp,
            level: severity.number(),
            name: name.clone(),
            msg: text.to_string(),
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
    fn what_goes_on_is_said_ever_more_seldom() {
        let mut said = 0;
        let times = (0..1000).filter(|count| has_grown(*count, &mut said));
        assert_eq!(times.count(), 10);
        assert_eq!(said, 512);
    }
}
