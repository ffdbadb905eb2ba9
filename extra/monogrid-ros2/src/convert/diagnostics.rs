//! How the node is.

use monogrid_messages::diagnostic_msgs::{
    DiagnosticArray, DiagnosticStatus, ERROR, KeyValue, OK, STALE, WARN,
};
use monogrid_messages::std_msgs::Header;
use monogrid_slam::{LostReason, TrackingState};

/// What is known of the camera now.
#[derive(Clone, Debug, PartialEq)]
pub enum Condition {
    /// There is nothing to track yet, and why.
    Waiting(String),
    /// No image has come for this long, s.
    Silent(f64),
    /// What became of the last image.
    Tracked(TrackingState, Option<LostReason>),
}

impl Condition {
    fn level(&self) -> u8 {
        match self {
            Self::Tracked(TrackingState::Good, _) => OK,
            Self::Tracked(TrackingState::Lost, _) => ERROR,
            Self::Waiting(_) | Self::Tracked(..) => WARN,
            Self::Silent(_) => STALE,
        }
    }

    fn message(&self) -> String {
        match self {
            Self::Waiting(why) => why.clone(),
            Self::Silent(seconds) => format!("no image for {seconds:.0} s"),
            Self::Tracked(state, None) => state.name().to_owned(),
            Self::Tracked(state, Some(reason)) => format!("{}: {reason}", state.name()),
        }
    }
}

/// What is said of a scale that nobody knows.
pub const NOT_METRIC: &str = "unknown: lengths are not metres";

/// The condition of the node with facts, in the order that they are given. Tracking without metres
/// is a warning.
#[must_use]
pub fn diagnostics(
    header: Header,
    name: &str,
    condition: &Condition,
    is_metric: bool,
    facts: Vec<(&str, String)>,
) -> DiagnosticArray {
    let fact = |(key, value): (&str, String)| KeyValue {
        key: key.to_owned(),
        value,
    };
    let (mut level, mut message) = (condition.level(), condition.message());
    if level == OK && !is_metric {
        level = WARN;
        message += &format!("; scale {NOT_METRIC}");
    }
    DiagnosticArray {
        header,
        status: vec![DiagnosticStatus {
            level,
            name: name.to_owned(),
            message,
            hardware_id: String::new(),
            values: facts.into_iter().map(fact).collect(),
        }],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn conditions_say_how_bad_and_why() {
        let said = |condition: &Condition, is_metric| {
            let facts = vec![("dropped", "3".to_owned())];
            let array = diagnostics(Header::default(), "monogrid", condition, is_metric, facts);
            assert_eq!(array.status[0].values[0].key, "dropped");
            (array.status[0].level, array.status[0].message.clone())
        };
        let of = |condition: &Condition| said(condition, true);
        let tracked = Condition::Tracked;
        let (level, message) = said(&tracked(TrackingState::Good, None), false);
        assert!(level == WARN && message.contains("not metres"), "{message}");
        assert_eq!(of(&tracked(TrackingState::Good, None)), (OK, "good".into()));
        let lost = tracked(TrackingState::Lost, Some(LostReason::NoTexture));
        assert_eq!(
            of(&lost),
            (ERROR, "lost: image has almost no texture".into())
        );
        let weak = tracked(TrackingState::Degraded, None);
        assert_eq!(of(&weak), (WARN, "degraded".into()));
        assert_eq!(
            of(&Condition::Silent(4.2)),
            (STALE, "no image for 4 s".into())
        );
        let waiting = Condition::Waiting("no calibration".into());
        assert_eq!(of(&waiting), (WARN, "no calibration".into()));
    }
}
