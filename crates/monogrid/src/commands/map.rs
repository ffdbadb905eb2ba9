//! `monogrid map`: an occupancy map from a recording, from scans, or from posed depth images.

use super::{print_json, use_threads};
use crate::cli::MapArgs;
use crate::config::{Profile, RunConfig};
use crate::failure::{Classify, CommandResult, Failure, Outcome};
use crate::input::{depth_calibration, registered_depth};
use crate::mapfile::{self, MapFormat};
use crate::recorded::Recorded;
use crate::run::align::Align;
use crate::usage::{peak_rss_bytes, process_cpu};
use monogrid_datasets::{
    Dataset, DepthRegistration, ScansReader, SourceOptions, TimedPose, read_trajectory,
};
use monogrid_geometry::{Camera, Distortion, Se3, Sim3};
use monogrid_image::Undistorter;
use monogrid_occupancy::OccupancyMap;
use monogrid_slam::mapping::{KeyframeCamera, KeyframeScan, Mapper};
use serde::Serialize;
use std::path::Path;
use std::time::{Duration, Instant};

/// `map --json`.
#[derive(Debug, Serialize)]
struct MapReport {
    points: usize,
    scans: usize,
    seconds: f64,
    seconds_per_100k_points: f64,
    wall_seconds: f64,
    resolution: f64,
    leaves: usize,
    bytes_in_memory: usize,
    peak_rss_bytes: Option<u64>,
    file_bytes: u64,
    frame: String,
    threads: usize,
    warnings: Vec<String>,
}

/// A map and what it took.
struct Built {
    map: OccupancyMap,
    points: usize,
    scans: usize,
    cpu: Duration,
    wall: Duration,
    frame: String,
    warnings: Vec<String>,
}

/// Builds and writes the map.
pub fn execute(args: &MapArgs) -> CommandResult {
    let threads = use_threads(args.threads)?;
    let format = MapFormat::from_name(&args.out, &MapFormat::MAPS)?;
    let align = Align::parse(args.align.as_deref())?;
    let built = match Kind::of(&args.recording)? {
        Kind::Recording => from_recording(args, &align, threads)?,
        Kind::Scans => from_scans(args, &align, threads)?,
        Kind::Folder => from_folder(args, &align, threads)?,
    };
    mapfile::save(&built.map, &args.out, format)?;
    for warning in &built.warnings {
        eprintln!("warning: {warning}");
    }
    let seconds = built.cpu.as_secs_f64();
    let report = MapReport {
        points: built.points,
        scans: built.scans,
        seconds,
        seconds_per_100k_points: seconds * 1e5 / built.points.max(1) as f64,
        wall_seconds: built.wall.as_secs_f64(),
        resolution: built.map.resolution(),
        leaves: built.map.leaf_count(),
        bytes_in_memory: built.map.bytes_in_memory(),
        peak_rss_bytes: peak_rss_bytes(),
        file_bytes: std::fs::metadata(&args.out).map_or(0, |m| m.len()),
        frame: built.frame,
        threads,
        warnings: built.warnings,
    };
    if args.json.json {
        print_json(&report)?;
    } else {
        println!(
            "{} measurements of {} scans in {:.2} s of CPU ({:.4} s per 100 000)",
            report.points, report.scans, report.seconds, report.seconds_per_100k_points
        );
        println!(
            "{}: cells of {}, {} leaves, {:.2} MB in memory, {:.2} MB on disk; {}",
            args.out.display(),
            report.resolution,
            report.leaves,
            report.bytes_in_memory as f64 / 1e6,
            report.file_bytes as f64 / 1e6,
            report.frame
        );
    }
    Ok(Outcome::Done)
}

/// What there is to map.
enum Kind {
    Recording,
    Scans,
    Folder,
}

impl Kind {
    fn of(path: &Path) -> Result<Self, Failure> {
        let metadata = std::fs::metadata(path).map_err(|error| {
            Failure::input(format!("{} cannot be read: {error}", path.display()))
        })?;
        if metadata.is_dir() {
            return Ok(Self::Folder);
        }
        match path.extension().and_then(|extension| extension.to_str()) {
            Some("scans") => Ok(Self::Scans),
            Some("mgk") => Ok(Self::Recording),
            _ => Err(Failure::input(format!(
                "{} is neither a recording (.mgk), nor scans (.scans), nor a folder with depth images",
                path.display()
            ))),
        }
    }
}

/// The settings: those of the recording unless a file or profile is given, then the options.
fn settings(args: &MapArgs, recorded: Option<RunConfig>) -> Result<RunConfig, Failure> {
    let explicit = args.config.is_some() || args.profile.is_some();
    let mut config = match recorded {
        Some(recorded) if !explicit => recorded,
        _ => RunConfig::resolve_mapping(args.profile.map(Into::into), args.config.as_deref())?,
    };
    config.apply(&args.mapping);
    config.validate()?;
    Ok(config)
}

/// Measures the time of a piece of work on all threads.
struct Stopwatch {
    cpu: Duration,
    wall: Duration,
}

impl Stopwatch {
    fn new() -> Self {
        Self {
            cpu: Duration::ZERO,
            wall: Duration::ZERO,
        }
    }

    fn time<T>(&mut self, work: impl FnOnce() -> T) -> T {
        let (cpu, wall) = (process_cpu(), Instant::now());
        let result = work();
        self.cpu += process_cpu() - cpu;
        self.wall += wall.elapsed();
        result
    }
}

fn from_recording(args: &MapArgs, align: &Align, threads: usize) -> Result<Built, Failure> {
    let recorded = Recorded::read(&args.recording, align)?;
    let config = settings(args, recorded.config.clone())?;
    let mapper = Mapper::new(config.mapping, recorded.camera, threads);
    let poses = recorded.world_from_keyframes();
    let mut watch = Stopwatch::new();
    let (map, stats) = watch
        .time(|| {
            let scans = recorded.scans(&mapper.config().filter);
            mapper.build(&scans, &poses, &recorded.frame.map_from_world)
        })
        .while_running("the map cannot be built")?;
    Ok(Built {
        map,
        points: stats.points,
        scans: stats.keyframes,
        cpu: watch.cpu,
        wall: watch.wall,
        frame: recorded.frame.description,
        warnings: recorded.warnings,
    })
}

/// Settings for measurements whose poses and sigmas are given: neither range limit nor uncertainty of
/// the pose, unless asked for.
fn settings_for_given_poses(args: &MapArgs) -> Result<RunConfig, Failure> {
    let mut base = RunConfig::of(args.profile.map(Profile::from).unwrap_or_default());
    base.mapping.max_range = f64::INFINITY;
    base.mapping.pose_sigma = 0.0;
    base.mapping.pose_sigma_deg = 0.0;
    if args.config.is_some() {
        return settings(args, None);
    }
    base.apply(&args.mapping);
    base.validate()?;
    Ok(base)
}

/// The frame of data that has its own poses.
fn given_frame(align: &Align) -> Result<(Sim3, String), Failure> {
    match align {
        Align::FirstCamera => Ok((Sim3::identity(), "frame of the given poses".to_owned())),
        Align::Sim3 {
            path,
            target_from_results,
        } => Ok((
            *target_from_results,
            format!("aligned by {}", path.display()),
        )),
        Align::Trajectory { .. } => Err(Failure::input(
            "--align gt: needs a recording of a run (.mgk); data with given poses can be moved with sim3:FILE",
        )),
    }
}

fn from_scans(args: &MapArgs, align: &Align, threads: usize) -> Result<Built, Failure> {
    let config = settings_for_given_poses(args)?;
    let (map_from_world, frame) = given_frame(align)?;
    let reader = ScansReader::open(&args.recording).bad_input()?;
    let mapper = Mapper::without_camera(config.mapping, threads);
    let mut map = mapper.empty_map().bad_input()?;
    let mut watch = Stopwatch::new();
    let (mut points, mut scans) = (0, 0);
    for scan in reader {
        let scan = scan.bad_input()?;
        points += watch
            .time(|| {
                let ends: Vec<[f32; 3]> = scan.points.iter().map(|p| p.point_in_sensor).collect();
                let sigmas: Vec<f32> = scan.points.iter().map(|p| p.range_sigma).collect();
                let pose = &scan.world_from_sensor;
                mapper.integrate_points(&mut map, scans, pose, &map_from_world, (&ends, &sigmas))
            })
            .while_running("the map cannot be built")?;
        scans += 1;
    }
    Ok(Built {
        map,
        points,
        scans: scans as usize,
        cpu: watch.cpu,
        wall: watch.wall,
        frame,
        warnings: Vec::new(),
    })
}

fn from_folder(args: &MapArgs, align: &Align, threads: usize) -> Result<Built, Failure> {
    let dataset = Dataset::open(&args.recording, SourceOptions::default()).bad_input()?;
    let (camera, calibration) = depth_camera(&dataset, args)?;
    let poses = trajectory_of(&dataset, args)?;
    let config = settings_for_given_poses(args)?;
    let (map_from_world, frame) = given_frame(align)?;
    let undistorter = Undistorter::new(&camera, monogrid_image::WorkingSize::Automatic, None);
    let (width, height) = undistorter.size();
    let keyframe_camera = KeyframeCamera {
        pinhole: *undistorter.pinhole(),
        width,
        height,
    };
    let registration = DepthRegistration::new(&calibration, undistorter.pinhole(), width, height);
    let mapper = Mapper::new(config.mapping, keyframe_camera, threads);
    let mut map = mapper.empty_map().bad_input()?;
    let mut watch = Stopwatch::new();
    let (mut points, mut scans) = (0, 0u32);
    let mut warnings = dataset.warnings.clone();
    let mut num_without_pose = 0;
    for entry in &dataset.depths {
        let Some(pose) = nearest_pose(&poses, entry.timestamp_ns) else {
            num_without_pose += 1;
            continue;
        };
        let depth = registered_depth(&entry.path, &calibration, &registration)?;
        points += watch
            .time(|| {
                let scan = KeyframeScan::from_depth_image(scans, &depth, mapper.config());
                let map_from_camera = map_from_world * pose.with_scale(1.0);
                mapper.integrate(&mut map, &scan, &map_from_camera)
            })
            .while_running("the map cannot be built")?;
        scans += 1;
    }
    if scans == 0 {
        return Err(Failure::input(format!(
            "none of the {} depth images of {} has a pose of its time; give poses with --trajectory",
            dataset.depths.len(),
            args.recording.display()
        )));
    }
    if num_without_pose > 0 {
        warnings.push(format!(
            "{num_without_pose} depth images have no pose of their time"
        ));
    }
    Ok(Built {
        map,
        points,
        scans: scans as usize,
        cpu: watch.cpu,
        wall: watch.wall,
        frame,
        warnings,
    })
}

/// The camera into which depth is brought, and that of the depth images.
fn depth_camera(
    dataset: &Dataset,
    args: &MapArgs,
) -> Result<(Camera, monogrid_datasets::DepthCalibration), Failure> {
    if dataset.depths.is_empty() {
        return Err(Failure::input(format!(
            "{} has no depth images: expected depth.txt and depth/",
            args.recording.display()
        )));
    }
    let colour = dataset.calibration(None).bad_input()?;
    let fallback = colour.as_ref().map(|calibration| calibration.camera);
    let calibration = match (&args.depth_calibration, fallback) {
        (None, None) if dataset.depth_calibration_path.is_none() => {
            return Err(Failure::input(format!(
                "no calibration in {}: expected calibration_depth.txt or calibration.txt, or \
                 --depth-calibration",
                dataset.root.display()
            )));
        }
        (file, colour) => depth_calibration(
            dataset,
            file.as_deref(),
            &colour.unwrap_or(Camera {
                width: 1,
                height: 1,
                pinhole: monogrid_geometry::Pinhole::new(1.0, 1.0, 0.0, 0.0),
                distortion: Distortion::None,
            }),
        )?,
    };
    // poses are those of the colour camera where there is one
    Ok((fallback.unwrap_or(calibration.camera), calibration))
}

fn trajectory_of(dataset: &Dataset, args: &MapArgs) -> Result<Vec<TimedPose>, Failure> {
    let path = args.trajectory.as_ref().or(dataset.ground_truth.as_ref());
    let Some(path) = path else {
        return Err(Failure::input(format!(
            "no poses for the depth images of {}: expected groundtruth.txt, or --trajectory FILE",
            args.recording.display()
        )));
    };
    read_trajectory(path).bad_input()
}

/// Times farther apart than this do not belong together.
const MAX_POSE_DISTANCE_NS: u64 = 20_000_000;

/// The pose nearest in time, if it is near enough.
fn nearest_pose(poses: &[TimedPose], timestamp_ns: i64) -> Option<Se3> {
    let after = poses.partition_point(|pose| pose.timestamp_ns < timestamp_ns);
    let candidates = &poses[after.saturating_sub(1)..(after + 1).min(poses.len())];
    let nearest = candidates
        .iter()
        .min_by_key(|pose| pose.timestamp_ns.abs_diff(timestamp_ns))?;
    (nearest.timestamp_ns.abs_diff(timestamp_ns) <= MAX_POSE_DISTANCE_NS)
        .then_some(nearest.world_from_camera)
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::{Rotation, Vec3};

    #[test]
    fn poses_are_taken_from_the_nearest_time_or_not_at_all() {
        let pose = |timestamp_ns, x| TimedPose {
            timestamp_ns,
            world_from_camera: Se3::new(Rotation::identity(), Vec3::new(x, 0.0, 0.0)),
        };
        let poses = [pose(0, 0.0), pose(30_000_000, 1.0), pose(90_000_000, 2.0)];
        let x_at = |t| nearest_pose(&poses, t).map(|p| p.translation.x as i32);
        assert_eq!(x_at(-5_000_000), Some(0));
        assert_eq!(x_at(14_000_000), Some(0));
        assert_eq!(x_at(16_000_000), Some(1));
        assert_eq!(x_at(60_000_000), None);
        assert_eq!(x_at(100_000_000), Some(2));
        assert_eq!(x_at(120_000_000), None);
        assert_eq!(nearest_pose(&[], 0), None);
    }
}
