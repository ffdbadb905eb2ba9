//! The frame in which results are written.

use crate::failure::{Classify, Failure};
use monogrid_datasets::{TimedPose, read_sim3, read_trajectory};
use monogrid_evaluation::{StampedPose, TrajectoryConfig, TrajectoryReport, evaluate_trajectory};
use monogrid_geometry::{Se3, Sim3};
use monogrid_slam::mapping::z_up_from_camera_world;
use std::path::{Path, PathBuf};

/// What `--align` asks for.
#[derive(Clone, Debug)]
pub enum Align {
    /// Nothing: z up as the first camera was held.
    FirstCamera,
    /// A transform from the frame of unaligned results to the frame of a reference.
    Sim3 {
        /// The file it came from.
        path: PathBuf,
        /// The transform.
        target_from_results: Sim3,
    },
    /// The frame of the map of an earlier run.
    Map {
        /// From the world of that run.
        map_from_world: Sim3,
        /// What that run says about it.
        description: String,
        /// Whether its lengths are metres.
        is_metric: bool,
    },
    /// The frame of a trajectory, to which the estimated one is fitted.
    Trajectory {
        /// The file it came from.
        path: PathBuf,
        /// The trajectory.
        poses: Vec<TimedPose>,
    },
}

/// The frame that was found.
#[derive(Clone, Debug)]
pub struct MapFrame {
    /// From the world of the run.
    pub map_from_world: Sim3,
    /// For people and for `summary.json`.
    pub description: String,
    /// Whether the frame fixes the scale.
    pub is_aligned: bool,
    /// How well a trajectory fitted.
    pub fit: Option<TrajectoryReport>,
}

impl Align {
    /// Reads what `gt:FILE` or `sim3:FILE` names.
    pub fn parse(argument: Option<&str>) -> Result<Self, Failure> {
        let Some(argument) = argument else {
            return Ok(Self::FirstCamera);
        };
        match argument.split_once(':') {
            Some(("gt", file)) => Ok(Self::Trajectory {
                path: file.into(),
                poses: read_trajectory(Path::new(file)).bad_input()?,
            }),
            Some(("sim3", file)) => Ok(Self::Sim3 {
                path: file.into(),
                target_from_results: read_sim3(Path::new(file)).bad_input()?,
            }),
            _ => Err(Failure::input(format!(
                "--align {argument}: expected gt:FILE (a trajectory) or sim3:FILE"
            ))),
        }
    }

    /// The frame of the results, given the estimated trajectory in the world of the run.
    ///
    /// An alignment that cannot be found is not fatal: the results are written unaligned and the
    /// reason is returned beside them.
    pub fn frame(&self, trajectory: &[(i64, Se3)]) -> (MapFrame, Option<String>) {
        let z_up = z_up_from_camera_world();
        let first_camera = MapFrame {
            map_from_world: z_up,
            description: "z up as the first camera was held, x ahead, origin at the first keyframe"
                .to_owned(),
            is_aligned: false,
            fit: None,
        };
        match self {
            Self::FirstCamera => (first_camera, None),
            Self::Map {
                map_from_world,
                description,
                is_metric,
            } => (
                MapFrame {
                    map_from_world: *map_from_world,
                    description: description.clone(),
                    is_aligned: *is_metric,
                    fit: None,
                },
                None,
            ),
            Self::Sim3 {
                path,
                target_from_results,
            } => (
                MapFrame {
                    map_from_world: *target_from_results * z_up,
                    description: format!("aligned by {}", path.display()),
                    is_aligned: true,
                    fit: None,
                },
                None,
            ),
            Self::Trajectory { path, poses } => match fit(trajectory, poses) {
                Ok(report) => (
                    MapFrame {
                        map_from_world: report.gt_from_est,
                        description: format!("frame of {}", path.display()),
                        is_aligned: true,
                        fit: Some(report),
                    },
                    None,
                ),
                Err(reason) => (
                    first_camera,
                    Some(format!(
                        "results are not aligned to {}: {reason}",
                        path.display()
                    )),
                ),
            },
        }
    }
}

/// `map_from_camera` of a pose in the world: the scale of the frame applies to the position only.
pub fn in_map(map_from_world: &Sim3, world_from_camera: &Se3) -> Se3 {
    (*map_from_world * world_from_camera.with_scale(1.0)).to_se3()
}

fn fit(trajectory: &[(i64, Se3)], poses: &[TimedPose]) -> Result<TrajectoryReport, String> {
    let estimate: Vec<StampedPose> = trajectory
        .iter()
        .map(|(timestamp_ns, pose)| stamped(*timestamp_ns, *pose))
        .collect();
    evaluate_trajectory(&estimate, &stamped_all(poses), &TrajectoryConfig::default())
        .map_err(|error| error.to_string())
}

/// A pose in the type of the evaluation.
pub fn stamped(timestamp_ns: i64, world_from_camera: Se3) -> StampedPose {
    (timestamp_ns, world_from_camera)
}

/// A trajectory in the type of the evaluation.
pub fn stamped_all(poses: &[TimedPose]) -> Vec<StampedPose> {
    poses
        .iter()
        .map(|pose| stamped(pose.timestamp_ns, pose.world_from_camera))
        .collect()
}
