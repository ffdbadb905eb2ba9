//! How a run ended.
//!
//! A run that loses track in its last frames has done its job, one that never recovers has not.

use crate::failure::Outcome;
use crate::run::RunSettings;
use crate::run::frames::FrameRow;
use crate::run::threads::Tracked;
use crate::run::tracking::EarlyEnd;
use monogrid_slam::TrackingState;
use serde::Serialize;

/// How a run ended, as `summary.json` says it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    /// All frames were processed, and the last ones have poses.
    Done,
    /// The user stopped it, whatever the state of tracking was.
    Interrupted,
    /// Tracking never started.
    NotInitialised,
    /// The camera was never recognised in the map of the earlier run.
    NotRecognised,
    /// Tracking was lost for good.
    Lost,
    /// It ended in a fragment that was not joined.
    Fragment,
    /// Too many images in a row could not be read.
    Unreadable,
}

impl Status {
    /// How a run ended.
    pub fn of(tracked: &Tracked, settings: &RunSettings) -> Self {
        match &tracked.early_end {
            Some(EarlyEnd::Interrupted) => Self::Interrupted,
            Some(EarlyEnd::Unreadable(_)) => Self::Unreadable,
            _ if tracked.run.slam.num_keyframes() == 0 => Self::NotInitialised,
            _ if settings.continued.is_some() && tracked.run.trajectory.is_empty() => {
                Self::NotRecognised
            }
            None => match end_of(&tracked.rows) {
                End::Lost => Self::Lost,
                End::Fragment if !has_last_frame(tracked) => Self::Fragment,
                _ => Self::Done,
            },
        }
    }

    /// Which exit code it has.
    pub fn outcome(self) -> Outcome {
        match self {
            Self::NotInitialised | Self::NotRecognised | Self::Lost | Self::Fragment => {
                Outcome::NotTracked
            }
            Self::Interrupted => Outcome::Interrupted,
            // said as a failure
            Self::Done | Self::Unreadable => Outcome::Done,
        }
    }
}

/// Whether the last frame is in the map: a fragment may have been joined when the run was over.
fn has_last_frame(tracked: &Tracked) -> bool {
    let last = tracked.rows.iter().rev().find_map(FrameRow::report);
    let placed = tracked.run.trajectory.last();
    last.zip(placed)
        .is_some_and(|(last, placed)| placed.frame_index >= last.index)
}

/// What the end of a run looks like.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum End {
    /// With poses in the map, or with a short loss.
    Tracked,
    /// Without a pose for a while.
    Lost,
    /// The same, in a fragment.
    Fragment,
}

/// Seconds of video without a pose at the end after which tracking counts as lost for good.
const LOST_FOR_GOOD_SECS: f64 = 1.0;
/// And at least so many frames.
const LOST_FOR_GOOD_FRAMES: usize = 10;

/// Whether the last second of a run has poses in the map, and what it has instead.
fn end_of(rows: &[FrameRow]) -> End {
    let processed: Vec<&FrameRow> = rows.iter().filter(|row| row.report().is_some()).collect();
    let newest_first = processed.iter().rev();
    let num_lost = newest_first.take_while(|row| row.has_no_place()).count();
    let tail = &processed[processed.len() - num_lost..];
    let span_secs = match (tail.first(), tail.last()) {
        (Some(first), Some(last)) => (last.timestamp_ns - first.timestamp_ns) as f64 * 1e-9,
        _ => 0.0,
    };
    if num_lost < LOST_FOR_GOOD_FRAMES || span_secs < LOST_FOR_GOOD_SECS {
        return End::Tracked;
    }
    let reports = tail.iter().filter_map(|row| row.report());
    let mut states = reports.map(|report| report.state);
    if states.any(|state| state == TrackingState::Fragment) {
        End::Fragment
    } else {
        End::Lost
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::frames::FrameFate;
    use monogrid_slam::FrameReport;

    fn row(index: usize, state: TrackingState) -> FrameRow {
        let timestamp_ns = index as i64 * 33_000_000;
        FrameRow {
            index,
            timestamp_ns,
            fate: FrameFate::Processed(Box::new(FrameReport::new(index, timestamp_ns, state))),
            latency_ms: None,
        }
    }

    #[test]
    fn lost_for_good_means_a_second_without_a_pose_at_the_end() {
        let rows = |num_lost: usize, num_good: usize| -> Vec<FrameRow> {
            (0..num_lost + 100 + num_good)
                .map(|i| {
                    let is_lost = (100..100 + num_lost).contains(&i);
                    let state = if is_lost {
                        TrackingState::Lost
                    } else {
                        TrackingState::Good
                    };
                    row(i, state)
                })
                .collect()
        };
        assert_eq!(end_of(&rows(40, 0)), End::Lost);
        assert_eq!(end_of(&rows(20, 0)), End::Tracked, "less than a second");
        assert_eq!(end_of(&rows(40, 1)), End::Tracked, "found again");
        assert_eq!(end_of(&[]), End::Tracked);
        let mut in_fragment = rows(40, 0);
        in_fragment.extend((140..180).map(|i| row(i, TrackingState::Fragment)));
        assert_eq!(end_of(&in_fragment), End::Fragment);
        in_fragment.push(row(180, TrackingState::Good));
        assert_eq!(end_of(&in_fragment), End::Tracked);
    }
}
