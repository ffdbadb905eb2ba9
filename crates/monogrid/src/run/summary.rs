//! `summary.json`: what a run did, in numbers.

use super::{CpuTimes, FrameRow, Tracked};
use monogrid_slam::{Fragment, TrackingState};
use serde::Serialize;

/// How a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// With poses in the map, or with a short loss.
    Tracked,
    /// Without a pose for a while.
    Lost,
    /// The same, in a fragment that was not joined.
    Fragment,
}

/// Seconds of a run.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Seconds {
    /// Wall time from the start of the process.
    pub total: f64,
    /// CPU time of tracking.
    pub tracking: f64,
    /// CPU time of the depth filter.
    pub depth: f64,
    /// CPU time of the keyframe graph.
    pub graph: f64,
    /// CPU time of mapping.
    pub mapping: f64,
    /// CPU time of decoding and undistortion.
    pub reading: f64,
    /// CPU time of recording and pictures.
    pub recording: f64,
}

/// Facts about the global map.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct MapFacts {
    /// Edge of a cell.
    pub resolution: f64,
    /// Leaves of the pruned octree.
    pub leaves: usize,
    /// Memory of the map itself.
    pub bytes_in_memory: usize,
}

/// A run that took part in a map.
#[derive(Clone, Debug, Serialize)]
pub struct SessionSummary {
    /// Name of its source.
    pub source: String,
    /// First keyframe that it made, if it made any.
    pub first_keyframe: u32,
}

/// A fragment of the map that a lost camera began.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct FragmentSummary {
    /// Its number, as in `frames.csv`.
    pub id: u32,
    /// Its first keyframe.
    pub first_keyframe: u32,
    /// Frame of that keyframe.
    pub first_frame: usize,
    /// Its keyframes, until it was joined.
    pub keyframes: usize,
    /// Its frames with a pose, until it was joined.
    pub frames: usize,
    /// The fragment that it became a part of, 0 for the main map; `null` if it never did.
    pub joined_into: Option<u32>,
    /// The frame after which it was.
    pub joined_at_frame: Option<usize>,
}

impl FragmentSummary {
    /// What the summary says of a fragment.
    pub fn new(fragment: &Fragment) -> Self {
        Self {
            id: fragment.id,
            first_keyframe: fragment.first_keyframe,
            first_frame: fragment.first_frame,
            keyframes: fragment.keyframes,
            frames: fragment.frames,
            joined_into: fragment.joined.map(|join| join.into),
            joined_at_frame: fragment.joined.map(|join| join.frame),
        }
    }
}

/// The content of `summary.json`.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// Name of the source.
    pub source: String,
    /// Version of the program.
    pub version: &'static str,
    /// `done`, `interrupted`, `not_initialised`, `not_recognised`, `lost`, `fragment` (the run ended in a fragment
    /// that was not joined) or `unreadable`.
    pub status: &'static str,
    /// Frames of the source that were used.
    pub frames: usize,
    /// Frames with a believed pose in the map.
    pub tracked: usize,
    /// Unreadable frames.
    pub skipped: usize,
    /// Frames dropped because the program was behind (`--realtime`).
    pub dropped: usize,
    /// Times that tracking was lost.
    pub lost_episodes: usize,
    /// Finished keyframes.
    pub keyframes: usize,
    /// Times that tracking went on with a keyframe that existed already instead of a new one.
    pub reactivated_keyframes: usize,
    /// Times that a lost camera was recognised.
    pub relocalisations: usize,
    /// Pairs of keyframes constrained by direct alignment.
    pub constraints: usize,
    /// Longest time from the end of a keyframe to the use of its optimised poses, milliseconds.
    pub graph_wait_ms: f64,
    /// Fragments that a lost camera began.
    pub fragments: Vec<FragmentSummary>,
    /// The runs that made the map, this one last.
    pub sessions: Vec<SessionSummary>,
    /// Whether the map of an earlier run was only used.
    pub localise_only: bool,
    /// Loops closed.
    pub loop_closures: usize,
    /// Depth measurements mapped.
    pub points: usize,
    /// Frames over wall time, from the start of the process to the last file.
    pub frames_per_second: f64,
    /// Times.
    pub seconds: Seconds,
    /// CPU time of mapping per 100 000 measurements.
    pub mapping_seconds_per_100k_points: f64,
    /// The global map.
    pub map: MapFacts,
    /// Largest resident memory; `null` where the system does not say.
    pub peak_rss_bytes: Option<u64>,
    /// `metric` or `arbitrary`.
    pub scale: &'static str,
    /// The frame of trajectory and maps.
    pub frame: String,
    /// Profile.
    pub profile: &'static str,
    /// Seed.
    pub seed: u64,
    /// Working size of the images.
    pub working_size: [usize; 2],
    /// Threads of computation.
    pub threads: usize,
    /// What the user should know.
    pub warnings: Vec<String>,
    /// Error against a reference trajectory, where one was given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub trajectory: Option<serde_json::Value>,
    /// Error of the depth against the truth, where there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub depth: Option<serde_json::Value>,
    /// Error of the global map against the truth, where there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub map_error: Option<serde_json::Value>,
}

/// Seconds of video without a pose at the end after which tracking counts as lost for good.
const LOST_FOR_GOOD_SECS: f64 = 1.0;
/// And at least so many frames.
const LOST_FOR_GOOD_FRAMES: usize = 10;

/// Whether the last second of a run has poses in the map, and what it has instead.
pub fn end_of(rows: &[FrameRow]) -> End {
    let processed: Vec<&FrameRow> = rows.iter().filter(|row| row.report().is_some()).collect();
    let num_lost = processed
        .iter()
        .rev()
        .take_while(|row| row.has_no_place())
        .count();
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

/// CPU seconds of the stages: the CPU time of tracking, depth and graph together, divided as the wall
/// time of their steps.
pub fn stage_seconds(tracked: &Tracked, cpu: &CpuTimes) -> Seconds {
    let mut walls = [0.0; 3];
    for report in tracked.rows.iter().filter_map(FrameRow::report) {
        let times = report.milliseconds;
        for (wall, time) in walls
            .iter_mut()
            .zip([times.tracking, times.depth, times.graph])
        {
            *wall += time;
        }
    }
    let total: f64 = walls.iter().sum::<f64>().max(f64::MIN_POSITIVE);
    let [tracking, depth, graph] = walls.map(|wall| cpu.slam.as_secs_f64() * wall / total);
    Seconds {
        total: 0.0,
        tracking,
        depth,
        graph,
        mapping: cpu.mapping.as_secs_f64(),
        reading: cpu.reading.as_secs_f64(),
        recording: cpu.recording.as_secs_f64(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::FrameFate;
    use monogrid_slam::{FrameReport, StageTimes};

    fn row(index: usize, state: TrackingState) -> FrameRow {
        let timestamp_ns = index as i64 * 33_000_000;
        FrameRow {
            index,
            timestamp_ns,
            fate: FrameFate::Processed(Box::new(FrameReport {
                index,
                timestamp_ns,
                state,
                reason: None,
                world_from_camera: None,
                odom_from_camera: None,
                covariance: None,
                residual: 0.0,
                good_share: 0.0,
                usage: 0.0,
                exposure_gain: 1.0,
                milliseconds: StageTimes::default(),
                keyframe: None,
                finished_keyframe: None,
                created_keyframe: false,
                reactivated_keyframe: None,
                relocalised: false,
                fragment: None,
                started_fragment: None,
                joined_fragments: Vec::new(),
            })),
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
