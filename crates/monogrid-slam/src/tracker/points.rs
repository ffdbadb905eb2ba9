//! A pose from points of the sparse layer that are found again. It needs no good start, and it does not drift
//! with the dense depth of one keyframe.

use crate::map::{Map, MapKeyframe};
use crate::policy::do_points_decide;
use crate::sparse::{PointSearch, SearchImage, find_in_image, position};
use crate::{PointTrackingConfig, SparseConfig};
use monogrid_features::{AbsolutePoseConfig, PatchSearchConfig, PointPixel, absolute_pose};
use monogrid_geometry::{Mat6, Pinhole, Se3, Vec6};
use monogrid_graph::{MapMatch, PoseOnlyConfig, PoseOnlySolution, PoseOutcome, refine_pose};
use monogrid_image::Pyramid;

/// The points as they are known, seen from one keyframe.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PointMap<'a> {
    pub map: &'a Map,
    /// The keyframe that poses are relative to.
    pub keyframe: &'a MapKeyframe,
    pub pinhole: &'a Pinhole,
    pub sparse: &'a SparseConfig,
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
    /// The pose of a frame that is within a few pixels of `near`; `None` when the points do not decide.
    /// `covariance` of `near` (left, keyframe units) says what it is worth beside them, if anything.
    pub(crate) fn pose_near(
        &self,
        frame: &Pyramid,
        near: &Se3,
        covariance: Option<&Mat6>,
        config: &PointTrackingConfig,
    ) -> Option<PointPose> {
        let start = self.camera_from_world(near);
        let matches = self.search(frame, &start, config.near_radius_px, config);
        let (solution, num_inliers) = self.refined(&matches, &start, config)?;
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
    pub(crate) fn pose_around(
        &self,
        frame: &Pyramid,
        start: &Se3,
        config: &PointTrackingConfig,
    ) -> Option<PointPose> {
        let guess = self.camera_from_world(start);
        let matches = self.search(frame, &guess, config.search_radius_px, config);
        let settings = AbsolutePoseConfig {
            max_error_px: config.max_error_px,
            min_inliers: config.min_inliers,
            ..AbsolutePoseConfig::default()
        };
        let sampled = absolute_pose(&matches, self.pinhole, &settings)?;
        let found = self.frame_from_keyframe(&sampled);
        self.pose_near(frame, &found, None, config)
    }

    /// Points that are found within a radius of where a pose predicts them.
    fn search(
        &self,
        frame: &Pyramid,
        camera_from_world: &Se3,
        radius_px: f64,
        config: &PointTrackingConfig,
    ) -> Vec<PointPixel> {
        let image = SearchImage {
            pyramid: frame,
            fragment: self.keyframe.fragment,
            camera_from_world: *camera_from_world,
        };
        let settings = PointSearch {
            patch: PatchSearchConfig {
                radius_px,
                min_correlation: config.min_correlation,
                ..PatchSearchConfig::default()
            },
            max_points: config.max_points,
            from_newest: true,
        };
        let (map, pinhole) = (self.map, self.pinhole);
        let search = find_in_image(map, &image, &settings, pinhole, self.sparse);
        let found = search.found.iter();
        found
            .map(|&(point, pixel)| PointPixel {
                point_in_world: position(map, &map.points()[point], pinhole),
                pixel,
            })
            .collect()
    }

    /// The pose on all points that agree with it, and how many do.
    fn refined(
        &self,
        matches: &[PointPixel],
        start: &Se3,
        config: &PointTrackingConfig,
    ) -> Option<(PoseOnlySolution, usize)> {
        let weighted: Vec<MapMatch> = matches
            .iter()
            .map(|seen| MapMatch {
                point_in_world: seen.point_in_world,
                pixel: seen.pixel,
                inv_sigma_px: 1.0 / self.sparse.pose_sigma_px,
            })
            .collect();
        let settings = PoseOnlyConfig {
            min_inliers: config.min_inliers,
            ..PoseOnlyConfig::default()
        };
        let solution = refine_pose(start, self.pinhole, &weighted, &settings).ok()?;
        let pose = solution.camera_from_world;
        let agrees = |seen: &&PointPixel| {
            let in_camera = pose * seen.point_in_world;
            let error = self.pinhole.project(&in_camera) - seen.pixel;
            in_camera.z > 1e-6 && error.norm() <= config.max_error_px
        };
        let num_inliers = matches.iter().filter(agrees).count();
        (solution.outcome == PoseOutcome::Good).then_some((solution, num_inliers))
    }

    /// Covariance of a left update `[v, w]` given in the keyframe's units.
    fn in_world_units(&self, covariance: &Mat6) -> Mat6 {
        let unit = self.keyframe.world_from_keyframe.scale;
        let scale = Vec6::new(unit, unit, unit, 1.0, 1.0, 1.0);
        Mat6::from_fn(|i, j| covariance[(i, j)] * scale[i] * scale[j])
    }

    fn camera_from_world(&self, frame_from_keyframe: &Se3) -> Se3 {
        self.keyframe
            .world_from_camera(frame_from_keyframe)
            .inverse()
    }

    fn frame_from_keyframe(&self, camera_from_world: &Se3) -> Se3 {
        let world_from_keyframe = &self.keyframe.world_from_keyframe;
        let pose = *camera_from_world * world_from_keyframe.to_se3();
        Se3::new(pose.rotation, pose.translation / world_from_keyframe.scale)
    }
}

/// The mean of two poses weighted by information; `None` where that is singular. Covariances are of left updates.
fn fuse((a, a_covariance): (&Se3, &Mat6), (b, b_covariance): (&Se3, &Mat6)) -> Option<Se3> {
    let b_from_a = (*b * a.inverse()).log();
    let share = a_covariance * (a_covariance + b_covariance).try_inverse()?;
    let fused = Se3::exp(&(share * b_from_a)) * *a;
    fused.is_finite().then_some(fused)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fused_pose_lies_between_by_information() {
        let a = Se3::exp(&Vec6::new(0.1, 0.2, -0.1, 0.02, -0.01, 0.03));
        let step = Vec6::new(0.01, -0.02, 0.03, 0.004, 0.003, -0.002);
        let b = Se3::exp(&step) * a;
        let (certain, vague) = (Mat6::identity() * 1e-4, Mat6::identity() * 3e-4);
        let fused = fuse((&a, &certain), (&b, &vague)).unwrap();
        let expected = Se3::exp(&(step * 0.25)) * a;
        assert!((fused * expected.inverse()).log().norm() < 1e-12);
        let nearly_b = fuse((&a, &vague), (&b, &(certain * 1e-6))).unwrap();
        assert!((nearly_b * b.inverse()).log().norm() < 1e-7);
    }
}
