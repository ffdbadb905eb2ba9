//! The files of a run, besides the recording: trajectories, tables, maps and pictures.

use super::align::MapFrame;
use super::sessions::{Earlier, MAP_FROM_WORLD, tracked_frame};
use super::{FrameFate, FrameRow, RunSettings, Tracked, in_map};
use crate::failure::{Classify, Failure};
use crate::mapfile::{self, MapFormat};
use crate::output::OutputFolder;
use crate::picture::colour::quantile;
use crate::picture::voxels::{Cube, View, dollhouse_cut, render};
use monogrid_datasets::{TimedPose, encode_png_rgb, format_seconds, format_sim3, format_tum};
use monogrid_geometry::Se3;
use monogrid_graph::g2o;
use monogrid_graph::pose_graph::PoseGraph;
use monogrid_occupancy::{MapError, Occupancy, OccupancyMap};
use monogrid_slam::mapping::{Maps, z_up_from_camera_world};
use monogrid_slam::{FragmentId, FrameReport};
use std::fmt::Write;

/// Writes `trajectory.txt`, `trajectory_fragment_N.txt`, `trajectory_live.txt`, `trajectory_odometry.txt`, `frames.csv`,
/// `keyframes.txt`, `trajectory_earlier.txt`, `map_from_world.txt`, `graph.g2o` (similarities, exact) and `graph_rigid.g2o` (poses alone, for viewers of other programs).
pub fn write_tables(
    folder: &OutputFolder,
    tracked: &Tracked,
    frame: &MapFrame,
    settings: &RunSettings,
) -> Result<(), Failure> {
    folder.write("trajectory.txt", format_tum(&final_poses(tracked, frame)))?;
    for fragment in tracked.slam.fragments() {
        let poses = fragment_poses(tracked, fragment.id);
        if !poses.is_empty() {
            let name = format!("trajectory_fragment_{}.txt", fragment.id);
            folder.write(&name, format_tum(&poses))?;
        }
    }
    folder.write(
        "trajectory_live.txt",
        format_tum(&reported_poses(tracked, frame, |r| r.world_from_camera)),
    )?;
    folder.write(
        "trajectory_odometry.txt",
        format_tum(&reported_poses(tracked, frame, |r| r.odom_from_camera)),
    )?;
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

/// The frames of earlier sessions where they are known to be now, session after session.
fn earlier_trajectory(earlier: &Earlier, tracked: &Tracked, frame: &MapFrame) -> String {
    let mut text = String::new();
    for (number, session) in (0..).zip(&earlier.sessions) {
        let _ = writeln!(text, "# session {number}: {}", session.source);
        let frames = earlier.frames.iter().filter(|f| f.session == number);
        let poses: Vec<TimedPose> = frames
            .filter_map(|recorded| {
                let frame_then = tracked_frame(recorded);
                let keyframe = tracked.snapshot.in_main_map(recorded.keyframe)?;
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
    tracked
        .trajectory
        .iter()
        .map(|pose| TimedPose {
            timestamp_ns: pose.timestamp_ns,
            world_from_camera: in_map(&frame.map_from_world, &pose.world_from_camera),
        })
        .collect()
}

/// Positions of the camera as they were reported frame by frame.
pub fn reported_path(tracked: &Tracked, frame: &MapFrame) -> Vec<[f64; 3]> {
    let poses = reported_poses(tracked, frame, |report| report.world_from_camera);
    poses
        .iter()
        .map(|pose| pose.world_from_camera.translation.into())
        .collect()
}

/// Poses of the frames of a fragment that was not joined, z up as its first camera was held.
fn fragment_poses(tracked: &Tracked, id: FragmentId) -> Vec<TimedPose> {
    let map_from_fragment = z_up_from_camera_world();
    let poses = tracked.slam.trajectory_in(id);
    poses
        .iter()
        .map(|pose| TimedPose {
            timestamp_ns: pose.timestamp_ns,
            world_from_camera: in_map(&map_from_fragment, &pose.world_from_camera),
        })
        .collect()
}

/// Poses as they were reported frame by frame.
fn reported_poses(
    tracked: &Tracked,
    frame: &MapFrame,
    pose: impl Fn(&FrameReport) -> Option<Se3>,
) -> Vec<TimedPose> {
    let reports = tracked.rows.iter().filter_map(FrameRow::report);
    reports
        .filter_map(|report| {
            Some(TimedPose {
                timestamp_ns: report.timestamp_ns,
                world_from_camera: in_map(&frame.map_from_world, &pose(report)?),
            })
        })
        .collect()
}

fn frames_csv(rows: &[FrameRow]) -> String {
    let mut text = String::from(
        "frame,timestamp,state,reason,residual,good_share,usage,exposure_gain,tracking_ms,depth_ms,graph_ms,keyframe,event,fragment\n",
    );
    for row in rows {
        let (state, reason) = match &row.fate {
            FrameFate::Processed(report) => (
                report.state.name(),
                report.reason.map(|r| r.to_string()).unwrap_or_default(),
            ),
            FrameFate::Skipped(reason) => ("skipped", reason.clone()),
            FrameFate::Dropped => ("dropped", "behind the camera".to_owned()),
            FrameFate::BeforeSeed => ("initialising", "waiting for the seed depth".to_owned()),
        };
        let _ = write!(
            text,
            "{},{},{state},\"{}\",",
            row.index,
            format_seconds(row.timestamp_ns),
            reason.replace('"', "'")
        );
        if let Some(report) = row.report() {
            let times = report.milliseconds;
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
                report.keyframe.map(|id| id.to_string()).unwrap_or_default(),
                events(report),
                report
                    .fragment
                    .map(|f| f.id.to_string())
                    .unwrap_or_default()
            );
        } else {
            text.push_str(",,,,,,,,,");
        }
        text.push('\n');
    }
    text
}

/// What happened with a frame beside its tracking, several separated by spaces.
fn events(report: &FrameReport) -> String {
    let mut events = Vec::new();
    if report.relocalised {
        events.push("relocalised".to_owned());
    }
    if report.created_keyframe {
        events.push("new_keyframe".to_owned());
    }
    if let Some(id) = report.reactivated_keyframe {
        events.push(format!("reactivated:{id}"));
    }
    if let Some(id) = report.started_fragment {
        events.push(format!("fragment_started:{id}"));
    }
    for id in &report.joined_fragments {
        events.push(format!("fragment_joined:{id}"));
    }
    events.join(" ")
}

fn keyframes_txt(tracked: &Tracked, frame: &MapFrame) -> String {
    let mut text = String::from("# id frame timestamp scale tx ty tz qx qy qz qw points\n");
    for keyframe in tracked.slam.keyframes() {
        let Some(pose) = tracked.snapshot.in_main_map(keyframe.id) else {
            continue;
        };
        let pose = frame.map_from_world * *pose;
        let (t, q) = (pose.translation, pose.rotation.coords);
        let _ = writeln!(
            text,
            "{} {} {} {:.9} {:.9} {:.9} {:.9} {:.10} {:.10} {:.10} {:.10} {}",
            keyframe.id,
            keyframe.frame_index,
            format_seconds(keyframe.timestamp_ns),
            pose.scale,
            t.x,
            t.y,
            t.z,
            q.x,
            q.y,
            q.z,
            q.w,
            keyframe.pixels.len()
        );
    }
    text
}

/// The keyframe graph in the frame of the results.
fn keyframe_graph(tracked: &Tracked, frame: &MapFrame) -> PoseGraph {
    let mut graph = tracked.slam.pose_graph();
    let nodes: Vec<_> = graph.nodes().to_vec();
    for node in nodes {
        // Only poses that are not finite are refused; they stay as they are.
        let _ = graph.set_pose(node.id, frame.map_from_world * node.world_from_keyframe);
    }
    graph
}

/// Writes the maps in all formats; returns the preview as a PNG file.
pub fn write_maps(
    folder: &OutputFolder,
    maps: &Maps,
    path: &[[f64; 3]],
) -> Result<Vec<u8>, Failure> {
    for (name, map, format) in [
        ("global.ot", &maps.global, MapFormat::Ot),
        ("global.bt", &maps.global, MapFormat::Bt),
        ("local.ot", &maps.local, MapFormat::Ot),
        ("large.ot", &maps.large, MapFormat::Ot),
        ("cloud.ply", &maps.global, MapFormat::Ply),
    ] {
        mapfile::save(map, &folder.file(name), format)?;
    }
    write_grid(folder, &maps.global, path)?;
    let cubes = occupied_cubes(&maps.global).while_running("the preview cannot be drawn")?;
    let picture = render(&cubes, path, dollhouse_cut(&cubes, path), &View::default());
    let preview = encode_png_rgb(&picture);
    folder.write("preview.png", &preview)?;
    Ok(preview)
}

/// The map before and after loops were closed, from above, as PNG files: every keyframe where it was when it
/// was finished, and where the graph has it in the end. The same piece of the world in both.
pub fn write_loop_pictures(
    folder: &OutputFolder,
    maps: &Maps,
    reported_path: &[[f64; 3]],
    path: &[[f64; 3]],
) -> Result<[Vec<u8>; 2], Failure> {
    let cubes = |map| occupied_cubes(map).while_running("the maps cannot be drawn");
    let (before, after) = (cubes(&maps.large)?, cubes(&maps.global)?);
    let cut = dollhouse_cut(&after, path);
    let view = View {
        elevation: std::f64::consts::FRAC_PI_2,
        frame: extent(&after),
        ..View::default()
    };
    let before = encode_png_rgb(&render(&before, reported_path, cut, &view));
    let after = encode_png_rgb(&render(&after, path, cut, &view));
    folder.write("loops_before.png", &before)?;
    folder.write("loops_after.png", &after)?;
    Ok([before, after])
}

/// Box of what is there, but for a few cells far away, with some room around it.
fn extent(cubes: &[Cube]) -> Option<[[f64; 3]; 2]> {
    if cubes.is_empty() {
        return None;
    }
    let ranges = [0, 1, 2].map(|axis| {
        let mut values: Vec<f64> = cubes.iter().map(|cube| cube.center[axis]).collect();
        let low = quantile(&mut values, 0.005);
        let high = quantile(&mut values, 0.995);
        let room = 0.05 * (high - low);
        [low - room, high + room]
    });
    Some([0, 1].map(|end| ranges.map(|range| range[end])))
}

/// Heights that matter to what moves where the camera moved: from somewhat above the floor (where
/// there is one below the camera) to somewhat above the camera.
pub fn navigation_band(cubes: &[Cube], path: &[[f64; 3]]) -> [f64; 2] {
    let heights = || path.iter().map(|p| p[2]);
    let highest = heights().fold(f64::NEG_INFINITY, f64::max);
    let lowest = heights().fold(f64::INFINITY, f64::min);
    let mut occupied: Vec<f64> = cubes.iter().map(|cube| cube.center[2]).collect();
    let floor = quantile(&mut occupied, 0.02).min(lowest);
    let height = highest - floor;
    [floor + 0.1 * height, highest + 0.1 * height]
}

fn write_grid(folder: &OutputFolder, map: &OccupancyMap, path: &[[f64; 3]]) -> Result<(), Failure> {
    let cubes = occupied_cubes(map).while_running("the map cannot be projected")?;
    let band = navigation_band(&cubes, path);
    if let Some(grid) = map.projected(band[0], band[1]) {
        folder.write("map.pgm", grid.to_pgm())?;
        let note = format!("# cells from z = {:.3} to {:.3}\n", band[0], band[1]);
        folder.write("map.yaml", grid.to_yaml("map.pgm") + &note)?;
    }
    Ok(())
}

/// Occupied leaves as cubes.
pub fn occupied_cubes(map: &OccupancyMap) -> Result<Vec<Cube>, MapError> {
    let resolution = map.resolution();
    Ok(map
        .octree_leaves()?
        .into_iter()
        .filter(|leaf| map.state_of(leaf.first) == Occupancy::Occupied)
        .map(|leaf| Cube {
            center: leaf.center(resolution),
            size: f64::from(leaf.edge_cells) * resolution,
        })
        .collect())
}
