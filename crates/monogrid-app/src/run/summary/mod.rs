//! `summary.json`: what a run did, in numbers.

mod make;
mod status;

pub use make::is_metric;
pub use status::Status;

use crate::input::Input;
use crate::process::usage::{peak_rss_bytes, process_start};
use crate::run::align::{FloorSummary, UpSummary};
use crate::run::sensed::InertialSummary;
use crate::run::tracking::frames::FrameRow;
use monogrid_datasets::RecordedSession;
use monogrid_evaluation::{DepthReport, MapReport, PolicyReport, TrajectoryReport};
use monogrid_mapping::SceneCell;
use monogrid_slam::{Bridge, Fragment, MapBytes};
use serde::{Serialize, Serializer};

/// What `scale` says of metres.
const METRIC: &str = "metric";
/// And of everything else.
pub const ARBITRARY: &str = "arbitrary";

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

/// How long frames took that came at their own pace: from when the camera had one (but for decoding
/// the first) to its pose, ms.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Latency {
    /// Half of the frames took at most this.
    pub median: f32,
    /// And 99 % at most this.
    pub p99: f32,
    /// The slowest.
    pub most: f32,
}

impl Latency {
    /// Of the frames that were tracked; `None` where they did not come at their own pace.
    fn of(rows: &[FrameRow]) -> Option<Self> {
        let tracked = rows.iter().filter(|row| row.report().is_some());
        let mut all: Vec<f32> = tracked.filter_map(|row| row.latency_ms).collect();
        all.sort_unstable_by(f32::total_cmp);
        let most = *all.last()?;
        let share = |percent: usize| all.get((all.len() * percent).div_ceil(100).saturating_sub(1));
        Some(Self {
            median: *share(50)?,
            p99: *share(99)?,
            most,
        })
    }
}

/// What is known of the camera.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct CameraSummary {
    /// Focal length of the images in pixels: that along their rows.
    pub focal_px: f64,
    /// Standard deviation of its logarithm: with 95 % it is within 1.96 of these; `null` where it
    /// was given or assumed.
    pub focal_sigma: Option<f64>,
    /// Whether it is assumed, since nothing shows it.
    pub is_focal_assumed: bool,
}

impl CameraSummary {
    /// What an input knows of its camera in the end.
    pub fn of(input: &Input) -> Self {
        let own = input.own_calibration.as_ref();
        Self {
            focal_px: input.camera().pinhole.fx,
            focal_sigma: own.and_then(|own| own.focal_sigma),
            is_focal_assumed: own.is_some_and(|own| own.is_assumed),
        }
    }
}

/// Facts about the global map.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct MapFacts {
    /// Edge of a cell.
    pub resolution: f64,
    /// Why it is that, where it follows from the scene.
    pub cell: Option<SceneCell>,
    /// Lowest and highest z of `map.pgm`; `null` where there is none.
    pub band: Option<[f64; 2]>,
    /// Leaves of the pruned octree.
    pub leaves: usize,
    /// Memory of the map itself.
    pub bytes_in_memory: usize,
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
    /// How it ended.
    pub status: Status,
    /// Frames of the source, without those that repeat the one before.
    pub frames: usize,
    /// Frames with a believed pose in the map.
    pub tracked: usize,
    /// Those of them whose pose is uncertain: too little in view held it.
    pub uncertain: usize,
    /// Those of them in which the camera was lost for a short time: their pose follows from those
    /// before and after.
    pub interpolated: usize,
    /// Frames of the source that repeat the one before and were left out.
    pub repeated: usize,
    /// Unreadable frames.
    pub skipped: usize,
    /// Frames dropped because the program was behind (`--realtime`).
    pub dropped: usize,
    /// Time from a frame to its pose (`--realtime`).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub latency_ms: Option<Latency>,
    /// The camera whose images were tracked.
    pub camera: CameraSummary,
    /// Rolling shutter, given or found: time from the first row of an image to the last, ms.
    pub rolling_shutter_ms: f64,
    /// Times that tracking was lost.
    pub lost_episodes: usize,
    /// Finished keyframes.
    pub keyframes: usize,
    /// Of these, those of which a depth camera or a stereo pair measured the depth, and so the
    /// scale.
    pub measured_keyframes: usize,
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
    /// The fragment that is the map in the end, since it is much larger than the first one, which
    /// has its name in `fragments`; `null` where the first one is the map.
    pub map_was_fragment: Option<u32>,
    /// Parts of the map that know of each other only by tracked motion; 1 where points and
    /// alignments hold all of it together.
    pub parts: usize,
    /// Losses after which the map went on with frames that both sides know.
    pub bridges: Vec<Bridge>,
    /// The runs that made the map, this one last.
    pub sessions: Vec<RecordedSession>,
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
    /// What the keyframes, their points and the frames take in memory at the end, by owner.
    pub memory_bytes: MapBytes,
    /// `metric` or `arbitrary`.
    pub scale: &'static str,
    /// The frame of trajectory and maps.
    pub frame: String,
    /// What z is in it.
    pub up: UpSummary,
    /// The floor at z = 0; `null` where none was found or looked for, or up is uncertain.
    pub floor: Option<FloorSummary>,
    /// The level surface at z = 0 that is no floor, since things lie below it (a table, perhaps)
    /// or up is uncertain (a wall, perhaps); `null` where there is none.
    pub level_surface: Option<FloorSummary>,
    /// What the inertial sensor beside the camera says; not there without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub inertial: Option<InertialSummary>,
    /// Profile.
    pub profile: &'static str,
    /// Seed.
    pub seed: u64,
    /// Working size of the images.
    pub working_size: [usize; 2],
    /// Threads of computation.
    pub threads: usize,
    /// How the camera moves, as a look at the images said before: `moves`, `stands still`, `only
    /// turns`, `unclear`; `null` where nobody could look, or need not.
    pub motion: Option<&'static str>,
    /// How far to trust the map, in a sentence; `null` where there is none.
    pub trust: Option<String>,
    /// What the user should know.
    pub warnings: Vec<String>,
    /// Error against a reference trajectory, where one was given.
    #[serde(skip_serializing_if = "Option::is_none", serialize_with = "as_value")]
    pub trajectory: Option<TrajectoryReport>,
    /// Error of the depth against the truth, where there is one.
    #[serde(skip_serializing_if = "Option::is_none", serialize_with = "as_value")]
    pub depth: Option<DepthReport>,
    /// Error of the global map against the truth, where there is one.
    #[serde(skip_serializing_if = "Option::is_none", serialize_with = "as_value")]
    pub map_error: Option<MapReport>,
}

/// Name of the unit of length, for people.
pub fn unit_name(is_metric: bool) -> &'static str {
    match is_metric {
        true => "m",
        false => "map units (scale unknown)",
    }
}

/// Writes a report with its keys in the order of the alphabet.
fn as_value<S: Serializer>(report: &impl Serialize, serializer: S) -> Result<S::Ok, S::Error> {
    serde_json::to_value(report)
        .map_err(serde::ser::Error::custom)?
        .serialize(serializer)
}

impl Summary {
    /// Name of the unit of length.
    pub fn unit(&self) -> &'static str {
        unit_name(self.scale == METRIC)
    }

    /// Frames with a pose from their image.
    pub fn seen(&self) -> usize {
        self.tracked - self.interpolated
    }

    /// Those of them with a pose that is certain.
    pub fn certain(&self) -> usize {
        self.seen() - self.uncertain
    }

    /// Fragments that were not joined.
    pub fn num_apart(&self) -> usize {
        let fragments = self.fragments.iter();
        fragments.filter(|f| f.joined_into.is_none()).count()
    }

    /// The error of the map over the cells that it observed.
    pub fn observed_map_error(&self) -> Option<&PolicyReport> {
        Some(&self.map_error.as_ref()?.policies.observed)
    }

    /// Brings the numbers that grow until the last file is written up to date.
    pub fn take_times(&mut self) {
        let total = process_start().elapsed().as_secs_f64();
        self.seconds.total = total;
        self.frames_per_second = self.frames as f64 / total.max(1e-9);
        self.peak_rss_bytes = peak_rss_bytes();
    }
}

#[cfg(test)]
mod tests {
    use super::Latency;
    use crate::run::tracking::frames::{FrameFate, FrameRow};
    use monogrid_slam::{FrameReport, TrackingState};

    #[test]
    fn latency_is_that_of_the_frames_that_were_tracked() {
        let row = |index: usize| FrameRow {
            index,
            timestamp_ns: 0,
            fate: match index {
                0 => FrameFate::Dropped,
                _ => {
                    FrameFate::Processed(Box::new(FrameReport::new(index, 0, TrackingState::Good)))
                }
            },
            latency_ms: Some(if index == 0 { 1e6 } else { index as f32 }),
        };
        let rows: Vec<FrameRow> = (0..=200).map(row).collect();
        let expected = Latency {
            median: 100.0,
            p99: 198.0,
            most: 200.0,
        };
        assert_eq!(Latency::of(&rows), Some(expected));
        assert_eq!(Latency::of(&rows[..1]), None);
        let at_rest = rows.into_iter().map(|row| FrameRow {
            latency_ms: None,
            ..row
        });
        assert_eq!(Latency::of(&at_rest.collect::<Vec<_>>()), None);
    }
}
