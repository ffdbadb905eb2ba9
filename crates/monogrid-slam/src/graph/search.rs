//! Which keyframes should see the same surfaces, predicted from their poses and depths.

use super::GraphConfig;
use crate::KeyframeId;
use crate::mapping::KeyframeCamera;
use monogrid_alignment::DepthSample;
use monogrid_geometry::{Pinhole, Sim3, Vec3};

/// Points with which the overlap of two keyframes is predicted.
const NUM_PROBES: usize = 300;

/// A few points of a keyframe, in its units.
#[derive(Clone, Debug, Default)]
pub(crate) struct Probes(Vec<Vec3>);

impl Probes {
    pub(crate) fn new(samples: &[DepthSample], pinhole: &Pinhole) -> Self {
        let stride = samples.len().div_ceil(NUM_PROBES).max(1);
        let points = samples.iter().step_by(stride).filter_map(|sample| {
            let pixel = monogrid_geometry::Vec2::new(f64::from(sample.x), f64::from(sample.y));
            let depth = 1.0 / f64::from(sample.idepth);
            (depth.is_finite() && depth > 0.0).then(|| pinhole.unproject(&pixel) * depth)
        });
        Self(points.collect())
    }

    /// Share of the points that another keyframe sees from a similar direction and distance.
    fn seen_in(
        &self,
        other_from_self: &Sim3,
        camera: &KeyframeCamera,
        config: &GraphConfig,
    ) -> f64 {
        if self.0.is_empty() {
            return 0.0;
        }
        let max_cosine = config.max_view_angle_deg.to_radians().cos();
        let seen = self.0.iter().filter(|point| {
            let in_other = *other_from_self * **point;
            // the same ray, seen from the own camera, in the axes of the other
            let own_ray = other_from_self.rotation * **point * other_from_self.scale;
            let ratio = in_other.norm() / own_ray.norm();
            sees(camera, &in_other)
                && in_other.dot(&own_ray) > max_cosine * in_other.norm() * own_ray.norm()
                && ratio < config.max_distance_ratio
                && ratio * config.max_distance_ratio > 1.0
        });
        seen.count() as f64 / self.0.len() as f64
    }
}

/// Whether a point is in the field of view of a camera.
fn sees(camera: &KeyframeCamera, point: &Vec3) -> bool {
    if point.z <= 1e-6 {
        return false;
    }
    let pixel = camera.pinhole.project(point);
    let (width, height) = (camera.width as f64, camera.height as f64);
    pixel.x > 0.0 && pixel.y > 0.0 && pixel.x < width && pixel.y < height
}

/// A keyframe as the search sees it.
pub(crate) struct Candidate<'a> {
    pub id: KeyframeId,
    pub world_from_keyframe: Sim3,
    pub probes: &'a Probes,
    pub camera: &'a KeyframeCamera,
}

/// The ten nearest keyframes, and all others with a large predicted overlap; nearest first, then by
/// overlap, without repetition.
pub(crate) fn choose(
    own: &Candidate<'_>,
    others: &[Candidate<'_>],
    config: &GraphConfig,
) -> Vec<KeyframeId> {
    let mut rated: Vec<(KeyframeId, f64, f64)> = others
        .iter()
        .map(|other| {
            let other_from_own = other.world_from_keyframe.inverse() * own.world_from_keyframe;
            let forward = own.probes.seen_in(&other_from_own, other.camera, config);
            let backward = other
                .probes
                .seen_in(&other_from_own.inverse(), own.camera, config);
            let units = own
                .world_from_keyframe
                .scale
                .min(other.world_from_keyframe.scale);
            let distance = (own.world_from_keyframe.translation
                - other.world_from_keyframe.translation)
                .norm()
                / units;
            (other.id, distance, forward.min(backward))
        })
        .filter(|(_, _, overlap)| *overlap >= config.min_nearest_overlap.min(config.min_overlap))
        .collect();
    rated.sort_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0)));
    let near: Vec<KeyframeId> = rated
        .iter()
        .filter(|r| r.2 >= config.min_nearest_overlap && r.1 <= config.max_nearest_distance)
        .take(config.nearest)
        .map(|r| r.0)
        .collect();
    rated.retain(|r| r.2 >= config.min_overlap && !near.contains(&r.0));
    rated.sort_by(|a, b| b.2.total_cmp(&a.2).then(a.0.cmp(&b.0)));
    let overlapping = rated.iter().take(config.max_overlapping).map(|r| r.0);
    near.iter().copied().chain(overlapping).collect()
}
