//! Absolute and relative error of an estimated trajectory, as `evo` computes them (`[EVO]`,
//! `[STURM12]`), and scale drift.
//!
//! Flow: **associate** by time → **align** (`[UMEYAMA91]`) → errors of positions (ATE) and of
//! motions over one frame (RPE); beside them the scale of short windows and the share of the truth
//! that is covered. Poses are `world_from_camera`; lengths are those of the true trajectory.

mod align;
mod associate;
mod coverage;
mod scale_drift;
mod wrong;

pub use associate::{PosePair, StampedPose};
pub use scale_drift::WindowScale;
pub use wrong::{WrongPose, WrongPoseConfig};

use crate::statistics::ErrorSummary;
use align::align;
use monogrid_geometry::median::median;
use monogrid_geometry::{AlignmentError, Se3, Sim3, Vec3};
use serde::Serialize;

/// What may be adjusted before the trajectories are compared.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum TrajectoryAlignment {
    /// Rotation, translation and scale (`evo_ape -as`).
    #[default]
    Sim3,
    /// Rotation and translation (`evo_ape -a`).
    Se3,
    /// Nothing.
    None,
}

impl TrajectoryAlignment {
    /// Whether the scale is adjusted too; `None` where nothing is.
    fn with_scale(self) -> Option<bool> {
        (self != Self::None).then_some(self == Self::Sim3)
    }
}

/// Settings of [`evaluate_trajectory`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrajectoryConfig<'a> {
    /// How the estimate is aligned. Default: with scale.
    pub alignment: TrajectoryAlignment,
    /// Poses farther apart in time are not compared, seconds, [0, inf). Default 0.01, as `evo`.
    pub max_difference_secs: f64,
    /// Time between two frames of the source, for the coverage, seconds. Default: taken from the
    /// estimate as the median of those of its intervals that are not gaps.
    pub frame_interval_secs: Option<f64>,
    /// Times of the frames of the source, nanoseconds, in any order: the coverage is that of the
    /// frames. Default: not known, and the coverage that of the true poses.
    pub frame_times_ns: Option<&'a [i64]>,
    /// Poses that count as wrong.
    pub wrong: WrongPoseConfig,
}

impl Default for TrajectoryConfig<'_> {
    fn default() -> Self {
        Self {
            alignment: TrajectoryAlignment::Sim3,
            max_difference_secs: 0.01,
            frame_interval_secs: None,
            frame_times_ns: None,
            wrong: WrongPoseConfig::default(),
        }
    }
}

/// Why a trajectory could not be evaluated.
#[derive(Debug, thiserror::Error, Clone, PartialEq)]
#[non_exhaustive]
pub enum TrajectoryError {
    /// A setting outside its documented range.
    #[error("trajectory evaluation: {field} is {value}, allowed: {allowed}")]
    Config {
        /// Name of the field.
        field: &'static str,
        /// What it was.
        value: f64,
        /// What it may be.
        allowed: &'static str,
    },
    /// A pose with a number that is not finite.
    #[error(
        "pose {index} of the {which} trajectory holds NaN or infinity; remove it from the file"
    )]
    NotFinite {
        /// "estimated" or "true".
        which: &'static str,
        /// Position in the slice.
        index: usize,
    },
    /// The trajectories hardly overlap in time.
    #[error(
        "{found} poses of {estimated} estimated and {truth} true ones lie within \
         {max_difference_secs} s of each other, expected at least {expected}; are both files in \
         the same clock, in seconds?"
    )]
    TooFewMatches {
        /// Pairs found.
        found: usize,
        /// Pairs needed.
        expected: usize,
        /// Poses of the estimate.
        estimated: usize,
        /// Poses of the truth.
        truth: usize,
        /// The limit used.
        max_difference_secs: f64,
    },
    /// The positions do not determine an alignment.
    #[error(
        "cannot align the estimated trajectory to the true one: {0}; try to compare it without \
         alignment"
    )]
    Alignment(#[from] AlignmentError),
}

/// Everything known about the error of a trajectory. Lengths are in the unit of the truth.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TrajectoryReport {
    /// Absolute trajectory error, root mean square.
    pub ate_rmse: f64,
    /// Its mean.
    pub ate_mean: f64,
    /// Its median.
    pub ate_median: f64,
    /// Its standard deviation.
    pub ate_std: f64,
    /// Its largest value.
    pub ate_max: f64,
    /// Its smallest value.
    pub ate_min: f64,
    /// Error of the translation from one matched frame to the next, root mean square.
    pub rpe_trans_rmse: f64,
    /// Error of the rotation from one matched frame to the next, root mean square, degrees.
    pub rpe_rot_rmse_deg: f64,
    /// All of the translation error over one frame.
    pub rpe_trans: ErrorSummary,
    /// All of the rotation error over one frame, degrees.
    pub rpe_rot_deg: ErrorSummary,
    /// Angle between z of the estimate and z of the truth as the camera sees them, median, degrees;
    /// nothing is aligned for it. What it is worth depends on both worlds having z up.
    pub tilt_deg: f64,
    /// Scale that was applied to the estimate (1 unless aligned with scale).
    pub scale: f64,
    /// Largest over smallest of `window_scales`; 1 when fewer than two windows count, infinite
    /// (`null` in JSON) when the estimate stands still in one of them.
    pub scale_drift: f64,
    /// Share of the compared poses that are wrong (see [`WrongPoseConfig`]), [0, 1].
    pub wrong_share: f64,
    /// These, in the order of their times; not in JSON, where there can be thousands.
    #[serde(skip)]
    pub wrong: Vec<WrongPose>,
    /// Scale of windows that are aligned alone.
    pub window_scales: Vec<WindowScale>,
    /// Pairs of poses compared.
    pub matched: usize,
    /// Poses in the estimate.
    pub estimated: usize,
    /// Poses in the truth.
    pub truth: usize,
    /// Share with an estimated pose within half a frame interval, [0, 1]: of the frames whose true
    /// pose is known, or of all true poses where the times of the frames are not.
    pub coverage: f64,
    /// Frames that it is the share of; `None` where their times are not known.
    pub frames: Option<usize>,
    /// The frame interval used for that, seconds.
    pub frame_interval_secs: f64,
    /// Length of the true path through the matched poses.
    pub path_length: f64,
    /// How the estimate was aligned.
    pub alignment: TrajectoryAlignment,
    /// Whether both say how the camera was turned. Where one has the same orientation all the time,
    /// it has positions alone: errors of rotations are 0 then, and nobody knows them.
    pub has_orientations: bool,
    /// The alignment: true world from estimated world.
    #[serde(skip)]
    pub gt_from_est: Sim3,
}

/// Compares an estimated trajectory with the true one.
///
/// Both are `world_from_camera` poses with their time in nanoseconds, in any order. Pairing follows
/// `evo`: every pose of the shorter trajectory takes the nearest pose of the longer one.
///
/// # Errors
/// A setting outside its range, a pose that is not finite, fewer than two (three, when aligned)
/// pairs of poses, or positions that determine no alignment.
pub fn evaluate_trajectory(
    estimate: &[StampedPose],
    truth: &[StampedPose],
    config: &TrajectoryConfig,
) -> Result<TrajectoryReport, TrajectoryError> {
    validate(config)?;
    let estimate = checked_and_sorted(estimate, "estimated")?;
    let truth = checked_and_sorted(truth, "true")?;
    let mut pairs = associate::associate(&estimate, &truth, config.max_difference_secs);
    let (found, lengths) = (pairs.len(), (estimate.len(), truth.len()));
    let too_few = || too_few(found, lengths, config);
    if found < num_expected(config.alignment) {
        return Err(too_few());
    }
    let are_turned = [&estimate, &truth].map(|poses| is_turned(poses));
    let has_orientations = are_turned == [true; 2];
    let gt_from_est = align(&pairs, config.alignment, has_orientations)?;
    complete(&mut pairs, are_turned, &gt_from_est);
    let apply_to = |p: &PosePair| apply(&gt_from_est, &p.est_from_camera);
    let aligned: Vec<Se3> = pairs.iter().map(apply_to).collect();
    let ate = ErrorSummary::of(&position_errors(&pairs, &aligned)).ok_or_else(too_few)?;
    let (translations, rotations_deg) = relative_errors(&pairs, &aligned);
    let rpe_trans = ErrorSummary::of(&translations).ok_or_else(too_few)?;
    let rpe_rot_deg = ErrorSummary::of(&rotations_deg).ok_or_else(too_few)?;
    let window_scales = scale_drift::window_scales(&pairs);
    let wrong = wrong::wrong_poses(&pairs, config.alignment, &config.wrong);
    let frame_interval_secs = config
        .frame_interval_secs
        .unwrap_or_else(|| coverage::frame_interval_secs(&estimate));
    let frames = config
        .frame_times_ns
        .map(|times| coverage::with_truth(times, &truth, frame_interval_secs));
    let expected_times = (frames.clone()).unwrap_or_else(|| truth.iter().map(|p| p.0).collect());
    Ok(TrajectoryReport {
        ate_rmse: ate.rmse,
        ate_mean: ate.mean,
        ate_median: ate.median,
        ate_std: ate.std,
        ate_max: ate.max,
        ate_min: ate.min,
        rpe_trans_rmse: rpe_trans.rmse,
        rpe_rot_rmse_deg: rpe_rot_deg.rmse,
        rpe_trans,
        rpe_rot_deg,
        tilt_deg: tilt_deg(&pairs),
        scale: gt_from_est.scale,
        scale_drift: scale_drift::scale_drift(&window_scales),
        wrong_share: wrong.len() as f64 / pairs.len() as f64,
        wrong,
        window_scales,
        matched: pairs.len(),
        estimated: estimate.len(),
        truth: truth.len(),
        coverage: coverage::coverage(&estimate, &expected_times, frame_interval_secs),
        frames: frames.as_ref().map(Vec::len),
        frame_interval_secs,
        path_length: path_length(&pairs),
        alignment: config.alignment,
        has_orientations,
        gt_from_est,
    })
}

fn validate(config: &TrajectoryConfig) -> Result<(), TrajectoryError> {
    let check = |field, value, is_good: bool, allowed| match is_good {
        true => Ok(()),
        false => Err(TrajectoryError::Config {
            field,
            value,
            allowed,
        }),
    };
    let (gap, frame) = (config.max_difference_secs, config.frame_interval_secs);
    check("max_difference_secs", gap, gap >= 0.0, "0 or more seconds")?;
    let (frame, positive) = (frame.unwrap_or(1.0), "a positive number of seconds");
    check("frame_interval_secs", frame, frame > 0.0, positive)?;
    let (share, angle) = (config.wrong.path_share, config.wrong.degrees);
    check("wrong.path_share", share, share > 0.0, "a positive number")?;
    let (is_angle, allowed) = (angle > 0.0 && angle <= 180.0, "more than 0 and at most 180");
    check("wrong.degrees", angle, is_angle, allowed)
}

fn checked_and_sorted(
    poses: &[StampedPose],
    which: &'static str,
) -> Result<Vec<StampedPose>, TrajectoryError> {
    if let Some(index) = poses.iter().position(|(_, pose)| !pose.is_finite()) {
        return Err(TrajectoryError::NotFinite { which, index });
    }
    let mut sorted = poses.to_vec();
    sorted.sort_by_key(|p| p.0);
    Ok(sorted)
}

/// Poses that determine an alignment, and something to compare.
fn num_expected(alignment: TrajectoryAlignment) -> usize {
    alignment.with_scale().map_or(2, |_| 3)
}

fn too_few(
    found: usize,
    (estimated, truth): (usize, usize),
    config: &TrajectoryConfig,
) -> TrajectoryError {
    TrajectoryError::TooFewMatches {
        found,
        expected: num_expected(config.alignment),
        estimated,
        truth,
        max_difference_secs: config.max_difference_secs,
    }
}

/// Takes orientations that are not known, of the estimate and of the truth, from the other one.
fn complete(pairs: &mut [PosePair], are_known: [bool; 2], gt_from_est: &Sim3) {
    for pair in pairs {
        let (est, gt) = (&mut pair.est_from_camera, &mut pair.gt_from_camera);
        match are_known {
            [true, true] => {}
            [false, true] => est.rotation = gt_from_est.rotation.inverse() * gt.rotation,
            [_, false] => gt.rotation = gt_from_est.rotation * est.rotation,
        }
    }
}

/// Whether poses have more than one orientation: no camera is held that still.
fn is_turned(poses: &[StampedPose]) -> bool {
    poses
        .windows(2)
        .any(|pair| pair[0].1.rotation != pair[1].1.rotation)
}

/// The pose of the camera in the true world: its scale acts on the position only.
fn apply(gt_from_est: &Sim3, est_from_camera: &Se3) -> Se3 {
    let rotation = gt_from_est.rotation * est_from_camera.rotation;
    Se3::new(rotation, *gt_from_est * est_from_camera.translation)
}

fn position_errors(pairs: &[PosePair], aligned: &[Se3]) -> Vec<f64> {
    let pairs = pairs.iter().zip(aligned);
    let errors = pairs.map(|(p, a)| (a.translation - p.gt_from_camera.translation).norm());
    errors.collect()
}

/// Lengths of the translations, and angles in degrees, of
/// (true motion)^-1 (estimated motion) from each matched frame to the next.
fn relative_errors(pairs: &[PosePair], aligned: &[Se3]) -> (Vec<f64>, Vec<f64>) {
    pairs
        .windows(2)
        .zip(aligned.windows(2))
        .map(|(gt, est)| {
            let gt_motion = gt[0].gt_from_camera.inverse() * gt[1].gt_from_camera;
            let est_motion = est[0].inverse() * est[1];
            let error = gt_motion.inverse() * est_motion;
            let turn = error.rotation.angle();
            (error.translation.norm(), turn.to_degrees())
        })
        .unzip()
}

/// Median angle between the two vertical directions in the camera, degrees.
fn tilt_deg(pairs: &[PosePair]) -> f64 {
    let up_in_camera = |pose: &Se3| pose.rotation.inverse() * Vec3::z();
    let tilt =
        |p: &PosePair| up_in_camera(&p.est_from_camera).angle(&up_in_camera(&p.gt_from_camera));
    let mut tilts: Vec<f64> = pairs.iter().map(tilt).collect();
    median(&mut tilts).map_or(0.0, f64::to_degrees)
}

fn path_length(pairs: &[PosePair]) -> f64 {
    pairs
        .windows(2)
        .map(|w| (w[1].gt_from_camera.translation - w[0].gt_from_camera.translation).norm())
        .sum()
}
