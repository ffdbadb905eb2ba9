//! A pose from points of the sparse layer that are found again. It needs no good start, and it does
//! not drift with the dense depth of one keyframe.

use crate::map::{Map, MapKeyframe};
use crate::policy::{MIN_POINT_INLIERS, do_points_decide};
use crate::setup::Setup;
use crate::sparse::{POSE_SIGMA_PX, PointSearch, Which, find_in_image, position};
use monogrid_features::{AbsolutePoseConfig, PatchSearchConfig, PointPixel, absolute_pose};
use monogrid_geometry::{Mat6, Pinhole, Se3, Vec6};
use monogrid_graph::{MapMatch, PoseOnlyConfig, PoseOnlySolution, PoseOutcome, refine_pose};
use monogrid_image::Pyramid;

/// Points of the keyframe in use that are looked for in every frame, to confirm the pose by
/// alignment.
const PROBE_POINTS: usize = 60;
/// Largest error of a point that confirms a pose, px.
const PROBE_ERROR_PX: f64 = 1.5;
/// Points that are looked for at most where a pose is not confirmed.
const MAX_POINTS: usize = 300;
/// Half width of the search around where alignment predicts a point, px.
const NEAR_RADIUS_PX: f64 = 8.0;
/// Half width of the search where alignment failed, or its pose does not agree with the points,
/// px.
const SEARCH_RADIUS_PX: f64 = 32.0;
/// Smallest correlation of a patch that was found.
const MIN_CORRELATION: f32 = 0.7;
/// Largest error of a point that agrees with a pose, px.
const MAX_ERROR_PX: f64 = 3.0;
/// Factor on the standard deviations of a pose by alignment where it is fused with that of the
/// points: its residuals do not show the errors of the depth.
const ALIGNMENT_SIGMA_FACTOR: f64 = 2.0;

/// The points as they are known, seen from one keyframe.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PointMap<'a> {
    pub map: &'a Map,
    /// The keyframe that poses are relative to.
    pub keyframe: &'a MapKeyframe,
    pub setup: &'a Setup,
}

/// A pose that enough points agree with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PointPose {
    /// Translation in the keyframe's units.
    pub frame_from_keyframe: Se3,
    /// Points that agree.
    pub num_inliers: usize,
}

impl PointMap<'_> {
    /// Whether a few points are where a pose predicts them; otherwise the pose may be wrong.
    pub(crate) fn confirms(&self, frame: &Pyramid, pose: &Se3) -> bool {
        let camera_from_world = self.camera_from_world(pose);
        let probe = PointSearch {
            which: Which::SeenBy(self.keyframe.id),
            max_points: PROBE_POINTS,
            // the basin of a patch is some pixels wide
            ..self.around(frame, &camera_from_world, 0.0)
        };
        let probed = self.search(&probe);
        let agreeing = self.num_agreeing(&camera_from_world, &probed.seen, PROBE_ERROR_PX);
        do_points_decide(agreeing, probed.num_searched)
    }

    /// The pose of a frame that is within a few pixels of `near`; `None` when the points do not
    /// decide. `covariance` of `near` (left, keyframe units) says what it is worth beside them, if
    /// anything.
    pub(crate) fn pose_near(
        &self,
        frame: &Pyramid,
        near: &Se3,
        covariance: Option<&Mat6>,
    ) -> Option<PointPose> {
        let start = self.camera_from_world(near);
        let search = self.around(frame, &start, NEAR_RADIUS_PX);
        let matches = self.search(&search).seen;
        let (solution, num_inliers) = self.refined(&matches, &start)?;
        if !do_points_decide(num_inliers, matches.len()) {
            return None;
        }
        let pose = solution.camera_from_world;
        let fused = covariance.and_then(|covariance| {
            let covariance = covariance * ALIGNMENT_SIGMA_FACTOR.powi(2);
            let in_world = self.in_world_units(&covariance);
            fuse((&pose, &solution.covariance), (&start, &in_world))
        });
        Some(PointPose {
            frame_from_keyframe: self.frame_from_keyframe(&fused.unwrap_or(pose)),
            num_inliers,
        })
    }

    /// The pose of a frame of which `start` is a guess: points are looked for far around, the pose
    /// of random samples that explains most of them says where to look for them more closely.
    pub(crate) fn pose_around(&self, frame: &Pyramid, start: &Se3) -> Option<PointPose> {
        let guess = self.camera_from_world(start);
        let search = self.around(frame, &guess, SEARCH_RADIUS_PX);
        let matches = self.search(&search).seen;
        let sampling = AbsolutePoseConfig {
            max_error_px: MAX_ERROR_PX,
            min_inliers: MIN_POINT_INLIERS,
            ..AbsolutePoseConfig::default()
        };
        let sampled = absolute_pose(&matches, &self.setup.pinhole, &sampling)?;
        self.pose_near(frame, &self.frame_from_keyframe(&sampled), None)
    }

    /// All points are looked for within a radius of where a pose predicts them, as they were seen
    /// last.
    fn around<'a>(
        &self,
        frame: &'a Pyramid,
        camera_from_world: &Se3,
        radius_px: f64,
    ) -> PointSearch<'a> {
        PointSearch {
            pyramid: frame,
            fragment: self.keyframe.fragment,
            camera_from_world: *camera_from_world,
            patch: PatchSearchConfig {
                radius_px,
                min_correlation: MIN_CORRELATION,
                ..PatchSearchConfig::default()
            },
            which: Which::All,
            with_depth: true,
            max_points: MAX_POINTS,
            from_newest: true,
        }
    }

    /// Points that are found around where a pose predicts them.
    fn search(&self, search: &PointSearch) -> Probed {
        let (map, pinhole) = (self.map, &self.setup.pinhole);
        let search = find_in_image(map, search, pinhole);
        let found = search.found.iter();
        let seen = found.map(|&(point, pixel)| PointPixel {
            point_in_world: position(map, &map.points()[point], pinhole),
            pixel,
        });
        Probed {
            num_searched: search.num_searched,
            seen: seen.collect(),
        }
    }

    fn num_agreeing(&self, camera_from_world: &Se3, seen: &[PointPixel], max_px: f64) -> usize {
        let agrees = |seen: &&PointPixel| {
            let in_camera = *camera_from_world * seen.point_in_world;
            let error = self.setup.pinhole.project(&in_camera) - seen.pixel;
            in_camera.z > Pinhole::MIN_DEPTH && error.norm() <= max_px
        };
        seen.iter().filter(agrees).count()
    }

    /// The pose on all points that agree with it, and how many do.
    fn refined(&self, matches: &[PointPixel], start: &Se3) -> Option<(PoseOnlySolution, usize)> {
        let weighted = matches.iter().map(|seen| MapMatch {
            point_in_world: seen.point_in_world,
            pixel: seen.pixel,
            inv_sigma_px: 1.0 / POSE_SIGMA_PX,
        });
        let weighted: Vec<MapMatch> = weighted.collect();
        let refinement = PoseOnlyConfig {
            min_inliers: MIN_POINT_INLIERS,
            ..PoseOnlyConfig::default()
        };
        let solution = refine_pose(start, &self.setup.pinhole, &weighted, &refinement).ok()?;
        let pose = solution.camera_from_world;
        let num_inliers = self.num_agreeing(&pose, matches, MAX_ERROR_PX);
        (solution.outcome == PoseOutcome::Good).then_some((solution, num_inliers))
    }

    /// Covariance of a left update `[v, w]` given in the keyframe's units.
    fn in_world_units(&self, covariance: &Mat6) -> Mat6 {
        let unit = self.keyframe.world_from_keyframe.scale;
        let scale = Vec6::new(unit, unit, unit, 1.0, 1.0, 1.0);
        Mat6::from_fn(|i, j| covariance[(i, j)] * scale[i] * scale[j])
    }

    fn camera_from_world(&self, frame_from_keyframe: &Se3) -> Se3 {
        let world_from_camera = self.keyframe.world_from_camera(frame_from_keyframe);
        world_from_camera.inverse()
    }

    fn frame_from_keyframe(&self, camera_from_world: &Se3) -> Se3 {
        let world_from_keyframe = &self.keyframe.world_from_keyframe;
        let pose = *camera_from_world * world_from_keyframe.to_se3();
        Se3::new(pose.rotation, pose.translation / world_from_keyframe.scale)
    }
}

/// Points that were looked for in a frame.
struct Probed {
    num_searched: usize,
    seen: Vec<PointPixel>,
}

/// The mean of two poses weighted by information; `None` where that is singular. Covariances are of
/// left updates.
fn fuse((a, a_covariance): (&Se3, &Mat6), (b, b_covariance): (&Se3, &Mat6)) -> Option<Se3> {
    let b_from_a = (*b * a.inverse()).log();
    let share = a_covariance * (a_covariance + b_covariance).try_inverse()?;
    let fused = Se3::exp(&(share * b_from_a)) * *a;
    fused.is_finite().then_some(fused)
}

#[cfg(test)]
mod tests;
