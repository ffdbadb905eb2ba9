//! A pose from points of the sparse layer that are found again. It needs no good start, and it does not drift
//! with the dense depth of one keyframe.

use crate::PointTrackingConfig;
use crate::map::{Map, MapKeyframe};
use crate::policy::do_points_decide;
use crate::sparse::{PointSearch, Which, find_in_image, position};
use crate::system::Setup;
use monogrid_features::{AbsolutePoseConfig, PatchSearchConfig, PointPixel, absolute_pose};
use monogrid_geometry::{Mat6, Se3, Vec6};
use monogrid_graph::{MapMatch, PoseOnlyConfig, PoseOnlySolution, PoseOutcome, refine_pose};
use monogrid_image::Pyramid;

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
    fn config(&self) -> &PointTrackingConfig {
        &self.setup.config.tracking.points
    }

    /// Whether a few points are where a pose predicts them; otherwise the pose may be wrong.
    pub(crate) fn confirms(&self, frame: &Pyramid, pose: &Se3) -> bool {
        let config = self.config();
        let camera_from_world = self.camera_from_world(pose);
        let probe = PointSearch {
            which: Which::SeenBy(self.keyframe.id),
            max_points: config.probe_points,
            // the basin of a patch is some pixels wide
            ..self.around(frame, &camera_from_world, 0.0)
        };
        let probed = self.search(&probe);
        let agreeing = self.num_agreeing(&camera_from_world, &probed.seen, config.probe_error_px);
        do_points_decide(agreeing, probed.num_searched, config)
    }

    /// The pose of a frame that is within a few pixels of `near`; `None` when the points do not decide.
    /// `covariance` of `near` (left, keyframe units) says what it is worth beside them, if anything.
    pub(crate) fn pose_near(
        &self,
        frame: &Pyramid,
        near: &Se3,
        covariance: Option<&Mat6>,
    ) -> Option<PointPose> {
        let config = self.config();
        let start = self.camera_from_world(near);
        let search = self.around(frame, &start, config.near_radius_px);
        let matches = self.search(&search).seen;
        let (solution, num_inliers) = self.refined(&matches, &start)?;
        if !do_points_decide(num_inliers, matches.len(), config) {
            return None;
        }
        let pose = solution.camera_from_world;
        let fused = covariance.and_then(|covariance| {
            let covariance = covariance * config.alignment_sigma_factor.powi(2);
            let in_world = self.in_world_units(&covariance);
            fuse((&pose, &solution.covariance), (&start, &in_world))
        });
        Some(PointPose {
            frame_from_keyframe: self.frame_from_keyframe(&fused.unwrap_or(pose)),
            num_inliers,
        })
    }

    /// The pose of a frame of which `start` is a guess: points are looked for far around, the pose of random
    /// samples that explains most of them says where to look for them more closely.
    pub(crate) fn pose_around(&self, frame: &Pyramid, start: &Se3) -> Option<PointPose> {
        let config = self.config();
        let guess = self.camera_from_world(start);
        let search = self.around(frame, &guess, config.search_radius_px);
        let matches = self.search(&search).seen;
        let sampling = AbsolutePoseConfig {
            max_error_px: config.max_error_px,
            min_inliers: config.min_inliers,
            ..AbsolutePoseConfig::default()
        };
        let sampled = absolute_pose(&matches, &self.setup.pinhole, &sampling)?;
        self.pose_near(frame, &self.frame_from_keyframe(&sampled), None)
    }

    /// All points are looked for within a radius of where a pose predicts them, as they were seen last.
    fn around<'a>(
        &self,
        frame: &'a Pyramid,
        camera_from_world: &Se3,
        radius_px: f64,
    ) -> PointSearch<'a> {
        let config = self.config();
        PointSearch {
            pyramid: frame,
            fragment: self.keyframe.fragment,
            camera_from_world: *camera_from_world,
            patch: PatchSearchConfig {
                radius_px,
                min_correlation: config.min_correlation,
                ..PatchSearchConfig::default()
            },
            which: Which::All,
            max_points: config.max_points,
            from_newest: true,
        }
    }

    /// Points that are found around where a pose predicts them.
    fn search(&self, search: &PointSearch) -> Probed {
        let (map, pinhole) = (self.map, &self.setup.pinhole);
        let search = find_in_image(map, search, pinhole, &self.setup.config.sparse);
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
            in_camera.z > 1e-6 && error.norm() <= max_px
        };
        seen.iter().filter(agrees).count()
    }

    /// The pose on all points that agree with it, and how many do.
    fn refined(&self, matches: &[PointPixel], start: &Se3) -> Option<(PoseOnlySolution, usize)> {
        let (setup, config) = (self.setup, self.config());
        let weighted = matches.iter().map(|seen| MapMatch {
            point_in_world: seen.point_in_world,
            pixel: seen.pixel,
            inv_sigma_px: 1.0 / setup.config.sparse.pose_sigma_px,
        });
        let weighted: Vec<MapMatch> = weighted.collect();
        let refinement = PoseOnlyConfig {
            min_inliers: config.min_inliers,
            ..PoseOnlyConfig::default()
        };
        let solution = refine_pose(start, &setup.pinhole, &weighted, &refinement).ok()?;
        let pose = solution.camera_from_world;
        let num_inliers = self.num_agreeing(&pose, matches, config.max_error_px);
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

/// The mean of two poses weighted by information; `None` where that is singular. Covariances are of left updates.
fn fuse((a, a_covariance): (&Se3, &Mat6), (b, b_covariance): (&Se3, &Mat6)) -> Option<Se3> {
    let b_from_a = (*b * a.inverse()).log();
    let share = a_covariance * (a_covariance + b_covariance).try_inverse()?;
    let fused = Se3::exp(&(share * b_from_a)) * *a;
    fused.is_finite().then_some(fused)
}

#[cfg(test)]
mod tests;
