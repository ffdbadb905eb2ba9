//! What the points of a map say about the camera that made it.
//!
//! The sparse layer sees hundreds of points from many keyframes: adjusted with the camera free,
//! they show it better than corners followed over the first seconds, at the cost of some twenty
//! milliseconds per ten keyframes.
//!
//! So a calibration that was given is checked (`calibration_check`), a camera that nobody gave is
//! refined after a first pass (`refine`), a rolling shutter is found (`rolling`), and radial
//! distortion that a calibration has left goes into the last adjustment.

use crate::camera::self_calibration::interval_ns;
use monogrid_calibration::{
    Estimate, EstimateConfig, Intrinsics, Parameters, Prior, Scene, Sighting, refine_intrinsics,
};
use monogrid_geometry::{Pinhole, ReadoutDirection, Se3, Vec2, Vec3};
use monogrid_slam::{Slam, TrajectoryPose};
use std::collections::BTreeMap;

/// Pieces that are looked at, evenly over the map: an upper limit for what it costs.
const MAX_PIECES: usize = 40;

/// The camera of the working images, which have no distortion, as the calibration has it.
pub fn as_calibrated(slam: &Slam) -> Intrinsics {
    let Pinhole { fx, fy, cx, cy } = *slam.pinhole();
    Intrinsics {
        focal: (fx * fy).sqrt(),
        centre: Vec2::new(cx, cy),
        radial: [0.0; 2],
        readout: 0.0,
    }
}

/// The camera of the images in working pixels that the main map shows in pieces of `num_views`
/// keyframes, when `guess` is about right.
pub fn shown_by_map(
    slam: &Slam,
    num_views: usize,
    guess: &Intrinsics,
    (size, prior): ((usize, usize), &Prior),
    taken_out: &TakenOut,
) -> Estimate {
    let scene = scene(slam, guess, taken_out);
    let step = scene.pieces(num_views).count().div_ceil(MAX_PIECES).max(1);
    let pieces = scene.pieces(num_views).step_by(step);
    refine_intrinsics(pieces, size, prior, &EstimateConfig::default())
}

/// Keyframes of a piece of the map that is asked for the rolling shutter.
const VIEWS_FOR_READOUT: usize = 20;

/// Standard deviation of the logarithm of the focal length by which a calibration may be off where
/// something else is in question.
const FOCAL_SIGMA: f64 = 0.02;

/// Standard deviation of the radial distortion that a calibration has left in undistorted images:
/// rectified images of KITTI keep 0.025.
pub const LEFT_RADIAL: f64 = 0.03;

/// Standard deviation of what is not in question.
pub const HELD: f64 = 1e-6;

/// Time from the first row of an image to the last as the main map shows it, ms; `None` where it
/// does not show that it takes any. `camera` is that of the working images.
pub fn readout_ms_by_map(slam: &Slam, camera: &Intrinsics, taken_out: &TakenOut) -> Option<f64> {
    let (share, _) = nearly(slam, camera, FOCAL_SIGMA, taken_out)?.readout()?;
    Some(share * Motion::of(slam).interval_ns / 1e6)
}

/// A camera as the main map shows it that may be off in its focal length (standard deviation of the
/// logarithm), radial distortion and rolling shutter; `None` without a keyframe.
fn nearly(
    slam: &Slam,
    camera: &Intrinsics,
    log_focal_sigma: f64,
    taken_out: &TakenOut,
) -> Option<Estimate> {
    let size = working_size(slam)?;
    let prior = Prior {
        mean: camera.parameters(),
        sigma: Parameters::from([log_focal_sigma, LEFT_RADIAL, HELD, HELD, HELD, 0.5]),
    };
    let prior = (size, &prior);
    Some(shown_by_map(
        slam,
        VIEWS_FOR_READOUT,
        camera,
        prior,
        taken_out,
    ))
}

/// Standard deviations by which the radial distortion that is left must differ from none, and the
/// least that matters where the image ends, px.
const LEFT_SIGMAS: f64 = 2.0;
const MIN_LEFT_PX: f64 = 0.5;

/// Radial distortion that the calibration has left in the working images, as the main map shows it:
/// a ray at `x` from the axis is seen at `x (1 + radial |x|^2)`. `None` where it does not show any
/// that another focal length would not explain as well; what is found belongs to the focal length
/// of the calibration.
pub fn left_radial_by_map(slam: &Slam, taken_out: &TakenOut) -> Option<f64> {
    let size = working_size(slam)?;
    let camera = as_calibrated(slam);
    let shown = |log_focal_sigma: f64| {
        let shown = nearly(slam, &camera, log_focal_sigma, taken_out)?;
        Some((shown.intrinsics.radial[0], shown.sigma[1]))
    };
    let with_focal = shown(FOCAL_SIGMA).filter(|found| is_shown(*found))?;
    let (radial, _) = shown(HELD)?;
    let corner = Vec2::new(size.0 as f64, size.1 as f64).norm() / 2.0 / camera.focal;
    let at_corner_px = radial * corner.powi(3) * camera.focal;
    is_left(with_focal, (radial, at_corner_px)).then_some(radial)
}

/// Whether distortion differs from none, given its standard deviation.
fn is_shown((radial, sigma): (f64, f64)) -> bool {
    radial.abs() >= LEFT_SIGMAS * sigma
}

/// Whether distortion is there, as it is with the focal length free (and its standard deviation)
/// and with that of the calibration (and what it comes to where the image ends, px).
fn is_left(with_focal: (f64, f64), (radial, at_corner_px): (f64, f64)) -> bool {
    is_shown(with_focal) && radial * with_focal.0 > 0.0 && at_corner_px.abs() > MIN_LEFT_PX
}

/// Width and height of the working images, once there is a keyframe.
fn working_size(slam: &Slam) -> Option<(usize, usize)> {
    let keyframes = slam.keyframes();
    let keyframe = keyframes.first()?;
    Some(keyframe.size())
}

/// The rolling shutter that was taken out of the images of a run.
#[derive(Clone, Debug)]
pub struct TakenOut {
    direction: ReadoutDirection,
    /// First frames and ms, in their order; the first is that of all frames before the second.
    changes: Vec<(usize, f64)>,
}

impl TakenOut {
    /// The same out of all frames, ms.
    pub fn always(readout_ms: f64, direction: ReadoutDirection) -> Self {
        Self {
            direction,
            changes: vec![(0, readout_ms)],
        }
    }

    /// What was taken out of a frame that comes after all others, ms.
    pub fn note(&mut self, frame_index: usize, readout_ms: f64) {
        if self.at(frame_index) != readout_ms {
            self.changes.push((frame_index, readout_ms));
        }
    }

    /// What was taken out of a frame, ms.
    fn at(&self, frame_index: usize) -> f64 {
        let mut changes = self.changes.iter().rev();
        let change = changes.find(|(first, _)| *first <= frame_index);
        change.map_or(0.0, |(_, readout_ms)| *readout_ms)
    }

    /// The first frame that was read otherwise than the first of all.
    pub fn first_changed(&self) -> Option<usize> {
        self.changes.get(1).map(|(first, _)| *first)
    }
}

/// The main map as a scene: its finished keyframes are the views. Pixels are those that the camera
/// saw, before its rolling shutter was taken out.
fn scene(slam: &Slam, guess: &Intrinsics, taken_out: &TakenOut) -> Scene {
    let snapshot = slam.snapshot();
    let pinhole: &Pinhole = slam.pinhole();
    let ray_of = |[x, y]: [f64; 2]| pinhole.unproject(&Vec2::new(x, y));
    let motion = Motion::of(slam);
    let mut views = BTreeMap::new();
    let mut scene = Scene {
        intrinsics: *guess,
        poses: Vec::new(),
        points: Vec::new(),
        sightings: Vec::new(),
    };
    for keyframe in slam.keyframes() {
        if let Some(pose) = snapshot.in_main_map(keyframe.id) {
            // units do not change what is seen
            let world_from_camera = pose.to_se3();
            let view = View {
                index: scene.poses.len(),
                world_from_camera,
                around: motion.around(keyframe.frame_index),
                taken_out: taken_out.at(keyframe.frame_index) * 1e6 / motion.interval_ns.max(1.0),
            };
            views.insert(keyframe.id, view);
            scene.poses.push(world_from_camera.inverse());
        }
    }
    let size = working_size(slam).unwrap_or((1, 1));
    for point in slam.points() {
        let Some(host) = views.get(&point.host) else {
            continue;
        };
        let index = scene.points.len();
        let in_world = host.world_from_camera * (ray_of(point.pixel) / point.idepth);
        let own = std::iter::once((point.host, point.pixel));
        let mut seen: Vec<Sighting> = own
            .chain(point.observations)
            .filter_map(|(id, pixel)| {
                let view = views.get(&id)?;
                let pixel = guess.project(&ray_of(pixel))?;
                let phase = taken_out.direction.phase(&pixel, size);
                let bend = motion.step(view, guess, &in_world) * phase;
                Some(Sighting {
                    view: view.index,
                    point: index,
                    pixel: pixel + bend * view.taken_out,
                    bend,
                })
            })
            .collect();
        seen.sort_unstable_by_key(|sighting| sighting.view);
        scene.sightings.extend(seen);
        scene.points.push(in_world);
    }
    scene
}

/// A keyframe of the map.
struct View {
    index: usize,
    world_from_camera: Se3,
    /// The poses of the frames before and after it.
    around: Option<[TrajectoryPose; 2]>,
    /// The rolling shutter that was taken out of its image, in shares of the time from frame to
    /// frame.
    taken_out: f64,
}

/// How the camera moved from frame to frame.
struct Motion {
    poses: Vec<TrajectoryPose>,
    /// Median time from frame to frame, ns.
    interval_ns: f64,
}

impl Motion {
    fn of(slam: &Slam) -> Self {
        let poses = slam.trajectory();
        let times: Vec<i64> = poses.iter().map(|pose| pose.timestamp_ns).collect();
        Self {
            poses,
            interval_ns: interval_ns(&times),
        }
    }

    /// The poses of the frames before and after one, where they follow it at once.
    fn around(&self, frame_index: usize) -> Option<[TrajectoryPose; 2]> {
        let poses = &self.poses;
        let at = poses.binary_search_by_key(&frame_index, |pose| pose.frame_index);
        let at = at.ok()?;
        let around = [*poses.get(at.checked_sub(1)?)?, *poses.get(at + 1)?];
        let [before, after] = around.map(|pose| pose.timestamp_ns as f64);
        (after - before <= MAX_GAP * self.interval_ns).then_some(around)
    }

    /// How far a point moves in the image of a view from frame to frame, px; 0 where nobody knows.
    fn step(&self, view: &View, camera: &Intrinsics, point: &Vec3) -> Vec2 {
        let step = || {
            let [before, after] = view.around?;
            let seen = |pose: &TrajectoryPose| {
                camera.project(&(pose.world_from_camera.inverse() * *point))
            };
            let time_ns = (after.timestamp_ns - before.timestamp_ns).max(1) as f64;
            Some((seen(&after)? - seen(&before)?) * (self.interval_ns / time_ns))
        };
        step().unwrap_or_default()
    }
}

/// Frames before and after another that are further apart than this many intervals do not show how
/// it moved.
const MAX_GAP: f64 = 3.0;

#[cfg(test)]
mod tests {
    use super::{ReadoutDirection, TakenOut, is_left};

    #[test]
    fn distortion_is_left_where_no_focal_length_explains_it_and_it_matters() {
        assert!(is_left((0.0124, 0.0045), (0.018, 3.0)));
        assert!(is_left((-0.0124, 0.0045), (-0.018, -3.0)));
        // tsukuba: with its focal length it seems so, with a free one it is none
        assert!(!is_left((-0.0007, 0.0048), (-0.0073, -1.2)));
        assert!(!is_left((0.0088, 0.0045), (0.018, 3.0)), "not certain");
        assert!(!is_left((0.0124, 0.0045), (-0.018, -3.0)), "they disagree");
        assert!(
            !is_left((0.0124, 0.0045), (0.018, 0.4)),
            "too little to matter"
        );
    }

    #[test]
    fn what_was_taken_out_holds_until_it_changes() {
        let mut taken_out = TakenOut::always(0.0, ReadoutDirection::Down);
        for (frame, readout_ms) in [
            (0, 0.0),
            (3, 0.0),
            (7, 20.0),
            (9, 20.0),
            (12, 25.0),
            (13, 0.0),
        ] {
            taken_out.note(frame, readout_ms);
        }
        let at = [0, 6, 7, 11, 12, 13, 99].map(|frame| taken_out.at(frame));
        assert_eq!(at, [0.0, 0.0, 20.0, 20.0, 25.0, 0.0, 0.0]);
        assert_eq!(taken_out.first_changed(), Some(7));
        assert_eq!(
            TakenOut::always(8.0, ReadoutDirection::Down).first_changed(),
            None
        );
    }
}
