//! Which keyframes should see the same surfaces, predicted from their poses and depths.

use super::GraphConfig;
use crate::KeyframeCamera;
use crate::KeyframeId;
use crate::view::View;
use monogrid_alignment::DepthPixel;
use monogrid_geometry::{Pinhole, Sim3, Vec2, Vec3};
use std::sync::Arc;

/// Smallest predicted overlap of the nearest keyframes.
const MIN_NEAREST_OVERLAP: f64 = 0.2;
/// Largest distance of the nearest keyframes in units of the median depth.
const MAX_NEAREST_DISTANCE: f64 = 1.3;
/// Predicted overlap from which every other keyframe is tried too, however old.
const MIN_OVERLAP: f64 = 0.35;
/// Largest angle between the rays to the same surface, degrees.
const MAX_VIEW_ANGLE_DEG: f64 = 50.0;
/// Largest ratio of the distances to the same surface.
const MAX_DISTANCE_RATIO: f64 = 2.0;

/// Points with which the overlap of two keyframes is predicted.
const NUM_PROBES: usize = 300;

/// A few points of a keyframe, in its units.
#[derive(Clone, Debug, Default)]
pub(super) struct Probes {
    points: Vec<Vec3>,
    /// Their distances, ascending.
    distances: Vec<f64>,
}

impl Probes {
    pub(super) fn new(samples: &[DepthPixel], pinhole: &Pinhole) -> Self {
        let stride = samples.len().div_ceil(NUM_PROBES).max(1);
        let points = samples.iter().step_by(stride).filter_map(|sample| {
            let pixel = Vec2::new(f64::from(sample.x), f64::from(sample.y));
            let depth = 1.0 / f64::from(sample.idepth);
            (depth.is_finite() && depth > 0.0).then(|| pinhole.unproject(&pixel) * depth)
        });
        Self::of(points.collect())
    }

    fn of(points: Vec<Vec3>) -> Self {
        let mut distances: Vec<f64> = points.iter().map(Vec3::norm).collect();
        distances.sort_by(f64::total_cmp);
        Self { points, distances }
    }

    /// Share of the points, at most, that a camera sees which is this far away. A point is seen if
    /// its distances to both cameras differ by a limited ratio, and the cameras are no farther
    /// apart than the sum of the two.
    fn seen_from_at_most(&self, distance: f64) -> f64 {
        const ROUNDING: f64 = 1.0 - 1e-9;
        let least = distance / (1.0 + MAX_DISTANCE_RATIO) * ROUNDING;
        let too_near = self.distances.partition_point(|d| *d < least);
        let num = self.distances.len();
        (num - too_near) as f64 / num.max(1) as f64
    }

    /// Whether another keyframe is near enough to have this overlap. Most of a long way
    /// are not, which is seen without their points.
    fn is_near(&self, other: &Self, other_from_self: &Sim3, min_overlap: f64) -> bool {
        let in_other = other_from_self.translation.norm();
        let in_own = in_other / other_from_self.scale;
        self.seen_from_at_most(in_own) >= min_overlap
            && other.seen_from_at_most(in_other) >= min_overlap
    }

    /// Share of the points that another keyframe sees from a similar direction and distance.
    fn seen_in(&self, other_from_self: &Sim3, camera: &KeyframeCamera) -> f64 {
        if self.points.is_empty() {
            return 0.0;
        }
        let max_cosine = MAX_VIEW_ANGLE_DEG.to_radians().cos();
        let seen = self.points.iter().filter(|point| {
            let in_other = *other_from_self * **point;
            // the same ray, seen from the own camera, in the axes of the other
            let own_ray = other_from_self.rotation * **point * other_from_self.scale;
            let ratio = in_other.norm() / own_ray.norm();
            sees(camera, &in_other)
                && in_other.dot(&own_ray) > max_cosine * in_other.norm() * own_ray.norm()
                && ratio < MAX_DISTANCE_RATIO
                && ratio * MAX_DISTANCE_RATIO > 1.0
        });
        seen.count() as f64 / self.points.len() as f64
    }
}

/// Whether a point is in the field of view of a camera.
fn sees(camera: &KeyframeCamera, point: &Vec3) -> bool {
    if point.z <= Pinhole::MIN_DEPTH {
        return false;
    }
    let pixel = camera.pinhole.project(point);
    let (width, height) = (camera.width as f64, camera.height as f64);
    pixel.x > 0.0 && pixel.y > 0.0 && pixel.x < width && pixel.y < height
}

/// A finished keyframe as the graph keeps it.
#[derive(Clone, Debug)]
pub(super) struct Entry {
    pub view: Arc<View>,
    pub probes: Probes,
}

/// A keyframe as the search sees it.
pub(super) struct Candidate<'a> {
    pub entry: &'a Entry,
    pub world_from_keyframe: Sim3,
}

/// A keyframe with its distance and its overlap, if that is large enough.
fn rate(
    own: &Candidate<'_>,
    other: &Candidate<'_>,
    min_overlap: f64,
) -> Option<(KeyframeId, f64, f64)> {
    let other_from_own = other.world_from_keyframe.inverse() * own.world_from_keyframe;
    let (own_probes, other_probes) = (&own.entry.probes, &other.entry.probes);
    if !own_probes.is_near(other_probes, &other_from_own, min_overlap) {
        return None;
    }
    let own_from_other = other_from_own.inverse();
    let (own_view, other_view) = (&own.entry.view, &other.entry.view);
    let forward = own_probes.seen_in(&other_from_own, &other_view.camera);
    let backward = other_probes.seen_in(&own_from_other, &own_view.camera);
    let (a, b) = (&own.world_from_keyframe, &other.world_from_keyframe);
    let distance = (a.translation - b.translation).norm() / a.scale.min(b.scale);
    let overlap = forward.min(backward);
    (overlap >= min_overlap).then_some((other_view.id, distance, overlap))
}

/// The ten nearest keyframes, and all others with a large predicted overlap; nearest first, then by
/// overlap, without repetition.
pub(super) fn choose(
    own: &Candidate<'_>,
    others: &[Candidate<'_>],
    config: &GraphConfig,
) -> Vec<KeyframeId> {
    let least = MIN_NEAREST_OVERLAP.min(MIN_OVERLAP);
    let rate = |other| rate(own, other, least);
    let mut rated: Vec<(KeyframeId, f64, f64)> = others.iter().filter_map(rate).collect();
    rated.sort_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0)));
    let near: Vec<KeyframeId> = rated
        .iter()
        .filter(|r| r.2 >= MIN_NEAREST_OVERLAP && r.1 <= MAX_NEAREST_DISTANCE)
        .take(config.nearest)
        .map(|r| r.0)
        .collect();
    rated.retain(|r| r.2 >= MIN_OVERLAP && !near.contains(&r.0));
    rated.sort_by(|a, b| b.2.total_cmp(&a.2).then(a.0.cmp(&b.0)));
    let overlapping = rated.iter().take(config.max_overlapping).map(|r| r.0);
    near.iter().copied().chain(overlapping).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::Rotation;

    /// Points on a wall before a camera, from left to right ever farther away.
    fn wall() -> Probes {
        let points = (0..30).map(|k| {
            let x = f64::from(k) / 30.0 - 0.5;
            Vec3::new(x, 0.1 * x, 1.0) * (1.0 + 0.1 * f64::from(k))
        });
        Probes::of(points.collect())
    }

    #[test]
    fn keyframes_are_passed_over_unseen_only_where_no_overlap_is_possible() {
        let camera = KeyframeCamera::new(Pinhole::new(300.0, 300.0, 160.0, 120.0), (320, 240));
        let own = wall();
        let (mut overlapping, mut passed_over) = (0, 0);
        for step in -60..60 {
            for (scale, aside) in [(1.0, 0.0), (0.7, 0.3), (1.6, -0.5)] {
                let at = Vec3::new(aside, 0.1, 0.25 * f64::from(step));
                let other_from_own = Sim3::new(scale, Rotation::identity(), at);
                let other = wall();
                let own_from_other = other_from_own.inverse();
                let forward = own.seen_in(&other_from_own, &camera);
                let backward = other.seen_in(&own_from_other, &camera);
                let is_near = own.is_near(&other, &other_from_own, 0.2);
                assert!(is_near || forward.min(backward) < 0.2, "{other_from_own:?}");
                overlapping += usize::from(forward.min(backward) >= 0.2);
                passed_over += usize::from(!is_near);
            }
        }
        assert!(overlapping > 10, "{overlapping}");
        assert!(passed_over > 100, "{passed_over}");
    }
}
