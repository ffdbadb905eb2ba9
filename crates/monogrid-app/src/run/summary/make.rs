//! What a run did, counted.

use super::{
    ARBITRARY, CameraSummary, FragmentSummary, Latency, METRIC, MapFacts, Seconds, Status, Summary,
};
use crate::input::Input;
use crate::input::seen::name;
use crate::run::RunSettings;
use crate::run::align::MapFrame;
use crate::run::sessions::sessions;
use crate::run::tracking::frames::{FrameFate, FrameRow};
use crate::run::tracking::tracked::Tracked;

use monogrid_mapping::Maps;
use monogrid_slam::{KeyframeId, PoseSource, Scale, Slam};
use std::collections::BTreeSet;

impl Summary {
    /// The summary of a run as far as it has come, without what is known from a truth.
    pub fn new(
        input: &Input,
        settings: &RunSettings,
        tracked: &Tracked,
        frame: &MapFrame,
        maps: Option<&Maps>,
    ) -> Self {
        let slam = &tracked.run.slam;
        let graph = slam.graph_stats();
        let points = maps.map_or(0, |maps| maps.stats.points);
        let repeated = count(tracked, |fate| matches!(fate, FrameFate::Repeated));
        let mut summary = Self {
            source: input.name.clone(),
            version: env!("CARGO_PKG_VERSION"),
            status: Status::of(tracked, settings),
            frames: num_frames(input, tracked) - repeated,
            repeated,
            tracked: tracked.run.trajectory.len(),
            uncertain: tracked.num_from(PoseSource::Uncertain),
            interpolated: tracked.num_from(PoseSource::Interpolated),
            skipped: count(tracked, |fate| matches!(fate, FrameFate::Skipped(_))),
            dropped: count(tracked, |fate| matches!(fate, FrameFate::Dropped)),
            latency_ms: Latency::of(&tracked.rows),
            camera: CameraSummary::of(input),
            rolling_shutter_ms: tracked.readout_ms,
            lost_episodes: slam.counts().lost_episodes,
            keyframes: slam.num_keyframes(),
            measured_keyframes: slam.num_measured_keyframes(),
            reactivated_keyframes: slam.counts().reactivations,
            relocalisations: slam.counts().relocalisations,
            fragments: slam.fragments().iter().map(FragmentSummary::new).collect(),
            map_was_fragment: slam.exchanged(),
            parts: num_parts(slam),
            bridges: slam.bridges().to_vec(),
            sessions: sessions(slam, settings.earlier(), &input.name),
            localise_only: settings.is_localise_only(),
            constraints: graph.constraints,
            graph_wait_ms: graph.max_wait_ms,
            loop_closures: graph.loop_closures,
            points,
            frames_per_second: 0.0,
            seconds: stage_seconds(tracked),
            mapping_seconds_per_100k_points: mapping_seconds(tracked, points),
            map: map_facts(maps, settings),
            peak_rss_bytes: None,
            memory_bytes: tracked.run.map_size.bytes,
            scale: scale_name(is_metric(tracked, frame)),
            frame: frame.description.clone(),
            up: frame.up,
            floor: frame.floor,
            level_surface: frame.level_surface,
            inertial: None,
            profile: settings.config.profile.name(),
            seed: settings.config.seed,
            working_size: input.size().into(),
            threads: settings.threads,
            motion: input.motion.map(|motion| name(motion.did)),
            trust: None,
            warnings: Vec::new(),
            trajectory: frame.fit.clone(),
            depth: None,
            map_error: None,
        };
        summary.take_times();
        summary
    }
}

fn scale_name(is_metric: bool) -> &'static str {
    if is_metric { METRIC } else { ARBITRARY }
}

/// Frames of the source: where nothing was tracked, those that were looked at.
fn num_frames(input: &Input, tracked: &Tracked) -> usize {
    let looked_at = input.motion.filter(|_| input.no_map().is_some());
    looked_at.map_or(tracked.rows.len(), |motion| motion.num_frames)
}

/// CPU time of mapping for each 100 000 measurements.
fn mapping_seconds(tracked: &Tracked, points: usize) -> f64 {
    match points {
        0 => 0.0,
        _ => tracked.cpu.mapping.as_secs_f64() * 1e5 / points as f64,
    }
}

fn map_facts(maps: Option<&Maps>, settings: &RunSettings) -> MapFacts {
    let asked = settings.config.mapping.resolution;
    MapFacts {
        resolution: maps.map_or(asked, |maps| maps.global.resolution()),
        cell: None,
        band: None,
        leaves: maps.map_or(0, |maps| maps.global.leaf_count()),
        bytes_in_memory: maps.map_or(0, |maps| maps.global.bytes_in_memory()),
    }
}

/// Whether lengths of the results are metres.
pub fn is_metric(tracked: &Tracked, frame: &MapFrame) -> bool {
    tracked.run.slam.scale() == Scale::Metric || frame.is_aligned
}

/// Parts of the map, by their oldest keyframes.
fn num_parts(slam: &Slam) -> usize {
    let poses = slam.snapshot();
    let all = slam.keyframes().into_iter().map(|keyframe| keyframe.id);
    let in_map = all.filter(|id| poses.in_main_map(*id).is_some());
    let part_of = slam.parts();
    let parts: BTreeSet<KeyframeId> = in_map.map(|id| part_of[id as usize]).collect();
    parts.len()
}

fn count(tracked: &Tracked, test: fn(&FrameFate) -> bool) -> usize {
    tracked.rows.iter().filter(|row| test(&row.fate)).count()
}

/// CPU seconds of the stages: the CPU time of tracking, depth and graph together, divided as the
/// wall time of their steps.
fn stage_seconds(tracked: &Tracked) -> Seconds {
    let cpu = &tracked.cpu;
    let mut walls = [0.0; 3];
    let reports = tracked.rows.iter().filter_map(FrameRow::report);
    for times in reports.map(|report| report.milliseconds) {
        walls[0] += times.tracking;
        walls[1] += times.depth;
        walls[2] += times.graph;
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
