//! Trajectories, tables and the graph of keyframes as files.

use crate::output::OutputFolder;
use crate::process::failure::{Classify, Failure};
use crate::process::talk;
use crate::run::RunSettings;
use crate::run::align::{MapFrame, in_map};
use crate::run::sessions::{Earlier, MAP_FROM_WORLD, tracked_frame};
use crate::run::tracking::frames::{FrameFate, FrameRow};
use crate::run::tracking::tracked::Tracked;
use monogrid_datasets::{
    TimedPose, format_seconds, format_sim3, format_tum, parse_seconds, read_file,
};
use monogrid_geometry::{Se3, Sim3};
use monogrid_graph::g2o;
use monogrid_graph::pose_graph::PoseGraph;
use monogrid_mapping::z_up_from_camera_world;
use monogrid_slam::{FrameReport, TrajectoryPose};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;

/// Writes `trajectory.txt`, `trajectory_fragment_N.txt`, `trajectory_live.txt`,
/// `trajectory_odometry.txt`, `frames.csv`, `keyframes.txt`, `trajectory_earlier.txt`,
/// `map_from_world.txt`, `graph.g2o` (similarities, exact) and `graph_rigid.g2o` (poses alone, for
/// viewers of other programs).
pub fn write_tables(
    folder: &OutputFolder,
    tracked: &Tracked,
    frame: &MapFrame,
    final_poses: &[TimedPose],
    settings: &RunSettings,
) -> Result<(), Failure> {
    talk::doing("poses, colours and points are written");
    folder.write("trajectory.txt", format_tum(final_poses))?;
    for fragment in tracked.run.slam.fragments() {
        // z up as its first camera was held
        let trajectory = tracked.run.slam.trajectory_in(fragment.id);
        let poses = all_in_map(&z_up_from_camera_world(), &trajectory);
        if !poses.is_empty() {
            let name = format!("trajectory_fragment_{}.txt", fragment.id);
            folder.write(&name, format_tum(&poses))?;
        }
    }
    let live = live_poses(tracked, frame);
    folder.write("trajectory_live.txt", format_tum(&live))?;
    let odometry = reported_poses(tracked, frame, |report| report.odom_from_camera);
    folder.write("trajectory_odometry.txt", format_tum(&odometry))?;
    folder.write("frames.csv", frames_csv(&tracked.rows))?;
    folder.write(MAP_FROM_WORLD, format_sim3(&frame.map_from_world))?;
    if settings.is_localise_only() {
        return Ok(());
    }
    if let Some(continued) = &settings.continued {
        let text = earlier_trajectory(&continued.earlier, tracked, frame);
        folder.write("trajectory_earlier.txt", text)?;
    }
    folder.write("keyframes.txt", keyframes_txt(tracked, frame))?;
    let graph = keyframe_graph(tracked, frame);
    folder.write("graph.g2o", g2o::write(&graph))?;
    folder.write("graph_rigid.g2o", g2o::write_rigid(&graph))
}

/// Writes `trajectory_bridged.txt`: frames that no image has a pose for, as an inertial sensor has
/// them.
pub fn write_bridged(
    folder: &OutputFolder,
    poses: &[TimedPose],
    frame: &MapFrame,
) -> Result<(), Failure> {
    if poses.is_empty() {
        return Ok(());
    }
    let in_frame = |pose: &TimedPose| TimedPose {
        world_from_camera: in_map(&frame.map_from_world, &pose.world_from_camera),
        ..*pose
    };
    let poses: Vec<_> = poses.iter().map(in_frame).collect();
    folder.write("trajectory_bridged.txt", format_tum(&poses))
}

/// The frames of earlier sessions where they are known to be now, session after session.
fn earlier_trajectory(earlier: &Earlier, tracked: &Tracked, frame: &MapFrame) -> String {
    let mut frames: Vec<_> = earlier.frames.iter().collect();
    // stable: the frames of a session stay in their order
    frames.sort_by_key(|recorded| recorded.session);
    let mut text = String::new();
    for (number, session) in (0..).zip(&earlier.sessions) {
        let _ = writeln!(text, "# session {number}: {}", session.source);
        let first = frames.partition_point(|f| f.session < number);
        let of_session = frames[first..].iter().take_while(|f| f.session == number);
        let poses: Vec<TimedPose> = of_session
            .filter_map(|recorded| {
                let frame_then = tracked_frame(recorded);
                let keyframe = tracked.run.poses.in_main_map(recorded.keyframe)?;
                let pose = frame_then.world_from_camera(keyframe);
                Some(TimedPose {
                    timestamp_ns: recorded.timestamp_ns,
                    world_from_camera: in_map(&frame.map_from_world, &pose),
                })
            })
            .collect();
        text += &format_tum(&poses);
    }
    text
}

/// Final poses of all tracked frames in the frame of the results.
pub fn final_poses(tracked: &Tracked, frame: &MapFrame) -> Vec<TimedPose> {
    all_in_map(&frame.map_from_world, &tracked.run.trajectory)
}

fn all_in_map(map_from_world: &Sim3, trajectory: &[TrajectoryPose]) -> Vec<TimedPose> {
    let timed = |pose: &TrajectoryPose| TimedPose {
        timestamp_ns: pose.timestamp_ns,
        world_from_camera: in_map(map_from_world, &pose.world_from_camera),
    };
    trajectory.iter().map(timed).collect()
}

/// Where the camera was, in the frame of the results.
#[derive(Debug)]
pub struct Paths {
    /// All that is known at the end.
    pub path: Vec<[f64; 3]>,
    /// As it was reported frame by frame, where loops have changed it.
    pub reported: Option<Vec<[f64; 3]>>,
}

impl Paths {
    /// Of a run with these final poses.
    pub fn new(final_poses: &[TimedPose], tracked: &Tracked, frame: &MapFrame) -> Self {
        let has_loops = tracked.run.slam.graph_stats().loop_closures > 0;
        Self {
            path: path_of(final_poses),
            reported: has_loops.then(|| path_of(&live_poses(tracked, frame))),
        }
    }
}

/// Positions of the camera.
pub fn path_of(poses: &[TimedPose]) -> Vec<[f64; 3]> {
    let position = |pose: &TimedPose| pose.world_from_camera.translation.into();
    poses.iter().map(position).collect()
}

/// Poses in what is the map in the end, as they were reported frame by frame.
fn live_poses(tracked: &Tracked, frame: &MapFrame) -> Vec<TimedPose> {
    let map = tracked.run.slam.exchanged();
    reported_poses(tracked, frame, |report| match map {
        None => report.world_from_camera,
        Some(map) => {
            let place = report.fragment.filter(|place| place.id == map)?;
            Some(place.fragment_from_camera)
        }
    })
}

/// Poses as they were reported frame by frame.
fn reported_poses(
    tracked: &Tracked,
    frame: &MapFrame,
    pose: impl Fn(&FrameReport) -> Option<Se3>,
) -> Vec<TimedPose> {
    let timed = |report: &FrameReport| {
        Some(TimedPose {
            timestamp_ns: report.timestamp_ns,
            world_from_camera: in_map(&frame.map_from_world, &pose(report)?),
        })
    };
    let reports = tracked.rows.iter().filter_map(FrameRow::report);
    reports.filter_map(timed).collect()
}

fn frames_csv(rows: &[FrameRow]) -> String {
    let mut text = String::from(
        "frame,timestamp,state,reason,residual,good_share,usage,exposure_gain,tracking_ms,depth_ms,\
             graph_ms,keyframe,event,fragment,latency_ms\n",
    );
    for row in rows {
        let (state, reason) = match &row.fate {
            FrameFate::Processed(report) => (
                report.state.name(),
                report.reason.map(|r| r.to_string()).unwrap_or_default(),
            ),
            FrameFate::Skipped(reason) => ("skipped", reason.clone()),
            FrameFate::Repeated => ("repeated", "the image before once more".to_owned()),
            FrameFate::Dropped => ("dropped", "behind the camera".to_owned()),
        };
        let (time, reason) = (format_seconds(row.timestamp_ns), reason.replace('"', "'"));
        let _ = write!(text, "{},{time},{state},\"{reason}\",", row.index);
        if let Some(report) = row.report() {
            let times = report.milliseconds;
            let id = |id: Option<u32>| id.map(|id| id.to_string()).unwrap_or_default();
            let _ = write!(
                text,
                "{:.4},{:.4},{:.4},{:.5},{:.3},{:.3},{:.3},{},{},{}",
                report.residual,
                report.good_share,
                report.usage,
                report.exposure_gain,
                times.tracking,
                times.depth,
                times.graph,
                id(report.keyframe),
                events(report),
                id(report.fragment.map(|fragment| fragment.id))
            );
        } else {
            text.push_str(",,,,,,,,,");
        }
        let latency = row.latency_ms.map(|ms| format!("{ms:.1}"));
        let _ = writeln!(text, ",{}", latency.unwrap_or_default());
    }
    text
}

/// Largest table of frames that is read: days of video.
const MAX_TABLE_BYTES: u64 = 1 << 30;

/// Times of the frames by number, of the `frames.csv` of a run.
pub fn frame_times_ns(table: &Path) -> Result<BTreeMap<usize, i64>, Failure> {
    let bytes = read_file(table, MAX_TABLE_BYTES).bad_input()?;
    let text = String::from_utf8_lossy(&bytes);
    let time_of = |line: &str| {
        let mut fields = line.split(',');
        Some((fields.next()?.parse().ok()?, parse_seconds(fields.next()?)?))
    };
    Ok(text.lines().filter_map(time_of).collect())
}

/// What happened with a frame beside its tracking, several separated by spaces.
fn events(report: &FrameReport) -> String {
    let (reactivated, started) = (report.reactivated_keyframe, report.started_fragment);
    let joined = report.joined_fragments.iter();
    let mut events = Vec::new();
    events.extend(report.relocalised.then(|| "relocalised".to_owned()));
    events.extend(report.created_keyframe.then(|| "new_keyframe".to_owned()));
    events.extend(reactivated.map(|id| format!("reactivated:{id}")));
    events.extend(started.map(|id| format!("fragment_started:{id}")));
    events.extend(joined.map(|id| format!("fragment_joined:{id}")));
    events.join(" ")
}

fn keyframes_txt(tracked: &Tracked, frame: &MapFrame) -> String {
    let mut text = String::from("# id frame timestamp scale tx ty tz qx qy qz qw points part\n");
    let parts = tracked.run.slam.parts();
    for keyframe in tracked.run.slam.keyframes() {
        let Some(pose) = tracked.run.poses.in_main_map(keyframe.id) else {
            continue;
        };
        let pose = frame.map_from_world * *pose;
        let [x, y, z] = pose.translation.into();
        let [qx, qy, qz, qw] = pose.rotation.coords.into();
        let _ = writeln!(
            text,
            "{} {} {} {:.9} {x:.9} {y:.9} {z:.9} {qx:.10} {qy:.10} {qz:.10} {qw:.10} {} {}",
            keyframe.id,
            keyframe.frame_index,
            format_seconds(keyframe.timestamp_ns),
            pose.scale,
            keyframe.num_pixels,
            parts[keyframe.id as usize],
        );
    }
    text
}

/// The keyframe graph in the frame of the results.
fn keyframe_graph(tracked: &Tracked, frame: &MapFrame) -> PoseGraph {
    let mut graph = tracked.run.slam.pose_graph();
    let nodes: Vec<_> = graph.nodes().to_vec();
    for node in nodes {
        // Only poses that are not finite are refused; they stay as they are.
        let _ = graph.set_pose(node.id, frame.map_from_world * node.world_from_keyframe);
    }
    graph
}
