//! How a run ended.
//!
//! A run that loses track in its last frames has done its job, one that never recovers has not.

use crate::process::failure::Outcome;
use crate::run::RunSettings;
use crate::run::tracking::frames::{FrameFate, FrameRow};
use crate::run::tracking::tracked::EarlyEnd;
use crate::run::tracking::tracked::Tracked;
use monogrid_calibration::CameraMotion;
use monogrid_slam::{PoseSource, TrackingState};
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
    /// The camera stands still: there is no map.
    StandsStill,
    /// The camera only turns: there is no map.
    OnlyTurns,
    /// The camera was never recognised in the map of the earlier run.
    NotRecognised,
    /// Tracking was lost for good.
    Lost,
    /// It ended in a fragment that was not joined.
    Fragment,
    /// Fewer than half of the frames have a pose in the map, although the last ones do.
    Partial,
    /// Fewer than half of the frames have a pose in the map that is certain.
    Uncertain,
    /// Too many images in a row could not be read.
    Unreadable,
    /// A part of the program failed; what was mapped until then is there.
    Failed,
    /// The source could not be read to its end: it vanished, stalled, or was cut.
    BrokeOff,
}

impl Status {
    /// How a run ended.
    pub fn of(tracked: &Tracked, settings: &RunSettings) -> Self {
        match &tracked.early_end {
            Some(EarlyEnd::Interrupted) => Self::Interrupted,
            Some(EarlyEnd::Unreadable(..)) => Self::Unreadable,
            Some(EarlyEnd::BrokeOff(_)) => Self::BrokeOff,
            Some(EarlyEnd::Failed(_)) => Self::Failed,
            None if tracked.no_map == Some(CameraMotion::StandsStill) => Self::StandsStill,
            None if tracked.no_map == Some(CameraMotion::OnlyTurns) => Self::OnlyTurns,
            _ if tracked.run.slam.num_keyframes() == 0 => Self::NotInitialised,
            _ if settings.continued.is_some() && tracked.run.trajectory.is_empty() => {
                Self::NotRecognised
            }
            None => match end_of(&tracked.rows) {
                Some(TrackingState::Lost) => Self::Lost,
                Some(_) if !has_last_frame(tracked) => Self::Fragment,
                _ => by_poses(tracked),
            },
        }
    }

    /// Which exit code it has.
    pub fn outcome(self) -> Outcome {
        match self {
            Self::NotInitialised
            | Self::StandsStill
            | Self::OnlyTurns
            | Self::NotRecognised
            | Self::Lost
            | Self::Fragment
            | Self::Partial
            | Self::Uncertain => Outcome::NotTracked,
            Self::Interrupted => Outcome::Interrupted,
            // said as a failure
            Self::Done | Self::Unreadable | Self::BrokeOff | Self::Failed => Outcome::Done,
        }
    }
}

/// How it ended by how many frames have a pose from their image, and how many one that is certain.
fn by_poses(tracked: &Tracked) -> Status {
    let certain = tracked.num_from(PoseSource::Certain);
    let seen = certain + tracked.num_from(PoseSource::Uncertain);
    if !is_half(seen, &tracked.rows) {
        Status::Partial
    } else if !is_half(certain, &tracked.rows) {
        Status::Uncertain
    } else {
        Status::Done
    }
}

/// Whether so many poses are half of the frames or more: of those that tracking was asked for.
fn is_half(num_poses: usize, rows: &[FrameRow]) -> bool {
    let was_asked =
        |row: &&FrameRow| matches!(row.fate, FrameFate::Processed(_) | FrameFate::Skipped(_));
    2 * num_poses >= rows.iter().filter(was_asked).count()
}

/// Whether the last frame is in the map: a fragment may have been joined when the run was over.
fn has_last_frame(tracked: &Tracked) -> bool {
    let last = tracked.rows.iter().rev().find_map(FrameRow::report);
    let ends = last.zip(tracked.run.trajectory.last());
    ends.is_some_and(|(last, placed)| placed.frame_index >= last.index)
}

/// Seconds of video without a pose at the end after which tracking counts as lost for good.
const LOST_FOR_GOOD_SECS: f64 = 1.0;
/// And at least so many frames.
const LOST_FOR_GOOD_FRAMES: usize = 10;

/// What the last second of a run, or more of it, has instead of poses in the map: a fragment at
/// least in part, or nothing.
fn end_of(rows: &[FrameRow]) -> Option<TrackingState> {
    let reports: Vec<_> = rows.iter().filter_map(FrameRow::report).collect();
    let num_lost = rows.iter().rev().filter(|row| row.report().is_some());
    let num_lost = num_lost.take_while(|row| row.has_no_place()).count();
    let tail = &reports[reports.len() - num_lost..];
    let ends = tail.first().zip(tail.last());
    let span_ns = ends.map_or(0, |(first, last)| last.timestamp_ns - first.timestamp_ns);
    if num_lost < LOST_FOR_GOOD_FRAMES || (span_ns as f64 * 1e-9) < LOST_FOR_GOOD_SECS {
        return None;
    }
    let mut states = tail.iter().map(|report| report.state);
    let fragment = states.find(|state| *state == TrackingState::Fragment);
    Some(fragment.unwrap_or(TrackingState::Lost))
}

#[cfg(test)]
mod tests {
    use super::*;
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
    fn half_of_the_frames_are_those_that_were_tracked() {
        let mut rows: Vec<FrameRow> = (0..10).map(|i| row(i, TrackingState::Good)).collect();
        assert!(is_half(5, &rows) && !is_half(4, &rows));
        for fate in [FrameFate::Repeated, FrameFate::Dropped] {
            rows.push(FrameRow {
                fate,
                ..row(10, TrackingState::Good)
            });
        }
        assert!(is_half(5, &rows), "these were not asked for");
        rows.push(FrameRow {
            fate: FrameFate::Skipped("damaged".to_owned()),
            ..row(11, TrackingState::Good)
        });
        assert!(!is_half(5, &rows));
        for status in [Status::Partial, Status::Uncertain] {
            assert_eq!(status.outcome(), Outcome::NotTracked);
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
        assert_eq!(end_of(&rows(40, 0)), Some(TrackingState::Lost));
        assert_eq!(end_of(&rows(20, 0)), None, "less than a second");
        assert_eq!(end_of(&rows(40, 1)), None, "found again");
        assert_eq!(end_of(&[]), None);
        let mut in_fragment = rows(40, 0);
        in_fragment.extend((140..180).map(|i| row(i, TrackingState::Fragment)));
        assert_eq!(end_of(&in_fragment), Some(TrackingState::Fragment));
        in_fragment.push(row(180, TrackingState::Good));
        assert_eq!(end_of(&in_fragment), None);
    }
}
