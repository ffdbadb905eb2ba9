//! What of a run is explored.

use super::ReportInput;
use super::tracking::{STATES, state};
use crate::run::tracking::frames::FrameRow;
use crate::run::tracking::tracked::Tracked;
use monogrid_report::explorer::{
    Camera, Cells, Frames, PageMesh, PathPoint, Scene, cloud_and_keyframes, point_groups,
    seconds_since,
};
use monogrid_slam::TrackingState;
use std::collections::BTreeMap;

/// Keyframes that are farther apart in number than this and that the graph holds together are a
/// loop; nearer ones are neighbours anyway.
const MIN_LOOP: u64 = 10;

/// The scene of a run.
pub(super) fn scene(tracked: &Tracked, input: &ReportInput) -> anyhow::Result<Scene> {
    let slam = &tracked.run.slam;
    let keyframes = input.keyframes;
    let begin = tracked.rows.first().map_or(0, |row| row.timestamp_ns);
    let points = || {
        let groups = point_groups(keyframes, input.colours);
        cloud_and_keyframes(keyframes, &groups, input.colours, begin)
    };
    let cells = |map| Cells::new(map, Some(input.cell_colours));
    let (cells, (cloud, shown)) = rayon::join(|| input.map.map(cells).transpose(), points);
    let ids = shown.iter().map(|keyframe| u64::from(keyframe.id));
    let positions: BTreeMap<u64, usize> = ids.zip(0..).collect();
    let image = keyframes.first().and_then(|keyframe| keyframe.image);
    let size = image.map(|image| <[usize; 2]>::from(image.size()));
    let pictures = input.pictures.as_ref();
    let mesh = pictures.and_then(|pictures| pictures.mesh.as_ref());
    let mesh = input.map.zip(mesh);
    Ok(Scene {
        unit: input.summary.unit().to_owned(),
        cells: cells?,
        mesh: mesh.and_then(|(map, mesh)| PageMesh::new(mesh, map.resolution())),
        cloud: (cloud.count[0] > 0).then_some(cloud),
        plan: pictures.and_then(|pictures| pictures.plan.clone()),
        camera: size.map(|size| Camera::new(slam.pinhole(), size)),
        keyframes: shown,
        links: links(tracked, &positions),
        path: path(tracked, input),
        reference: input.reference.path.clone(),
        frames: Some(Frames {
            error: errors(tracked, input),
            ..frames(&tracked.rows, begin)
        }),
        cut: pictures.and_then(|pictures| pictures.cut),
    })
}

/// Where the camera was.
fn path(tracked: &Tracked, input: &ReportInput) -> Vec<PathPoint> {
    let poses = tracked.run.trajectory.iter().zip(&input.paths.path);
    poses
        .map(|(pose, point)| {
            let [x, y, z] = point.map(|value| value as f32);
            (pose.frame_index, x, y, z)
        })
        .collect()
}

/// Distance from the reference of each frame; empty without a reference.
fn errors(tracked: &Tracked, input: &ReportInput) -> Vec<f32> {
    let errors = &input.reference.errors;
    if errors.is_empty() {
        return Vec::new();
    }
    let poses = tracked.run.trajectory.iter().zip(errors);
    let known = poses.filter_map(|(pose, error)| Some((pose.frame_index, (*error)?)));
    let by_frame: BTreeMap<usize, f64> = known.collect();
    let error = |row: &FrameRow| by_frame.get(&row.index).map_or(-1.0, |error| *error as f32);
    tracked.rows.iter().map(error).collect()
}

/// Loops of the graph, as positions of keyframes.
fn links(tracked: &Tracked, positions: &BTreeMap<u64, usize>) -> Vec<[usize; 2]> {
    let graph = tracked.run.slam.pose_graph();
    let edges = graph.edges().iter();
    edges
        .filter(|edge| edge.i.abs_diff(edge.j) > MIN_LOOP)
        .filter_map(|edge| Some([*positions.get(&edge.i)?, *positions.get(&edge.j)?]))
        .collect()
}

/// What became of the frames, as columns.
fn frames(rows: &[FrameRow], begin: i64) -> Frames {
    let mut frames = Frames {
        legend: STATES.to_vec(),
        ..Frames::default()
    };
    for row in rows {
        let state = state(row);
        let position = STATES.iter().position(|known| *known == state);
        frames.state.push(position.unwrap_or_default());
        frames.index.push(row.index);
        frames.time.push(seconds_since(begin, row.timestamp_ns));
        let report = row.report();
        let reason = report.and_then(|report| report.reason);
        let reason = reason.map(|reason| reason.to_string()).unwrap_or_default();
        let before = frames.reasons.last().map_or("", |(_, last)| last);
        if before != reason {
            frames.reasons.push((frames.index.len() - 1, reason));
        }
        let tracked = report.filter(|report| report.state != TrackingState::Initialising);
        let good = tracked.map_or(-1, |report| (100.0 * report.good_share).round() as i16);
        frames.good.push(good);
        let milliseconds = report.map_or(-1.0, |report| {
            let times = report.milliseconds;
            ((times.tracking + times.depth + times.graph) * 10.0).round() as f32 / 10.0
        });
        frames.milliseconds.push(milliseconds);
        let keyframe = report.and_then(|report| report.keyframe);
        frames.keyframe.push(keyframe.map_or(-1, i64::from));
    }
    frames
}
