//! The pose of a new keyframe from the points of the others.

use super::matching::{find_in_newest, position};
use crate::map::{Map, Registration};
use monogrid_geometry::{Pinhole, Vec2};
use monogrid_graph::{MapMatch, PoseOnlyConfig, refine_pose};

/// Fewest points that must agree before the pose of a new keyframe is taken from them.
const MIN_POSE_POINTS: usize = 25;
/// Standard deviation of a found position for the first pose of a frame, when the points are not
/// adjusted with it yet, px.
pub(crate) const POSE_SIGMA_PX: f64 = 1.0;

/// Finds the points that the newest keyframe should see, and refines its pose on them.
pub(crate) fn register(map: &Map, pinhole: &Pinhole) -> Registration {
    let search = find_in_newest(map, pinhole);
    // a guess says nothing about the pose; to be seen here is what makes it a measurement
    let found = search.found.into_iter();
    let (known, guesses): (Vec<_>, Vec<_>) =
        found.partition(|(index, _)| map.points()[*index].has_depth());
    let num_found = known.len();
    let mut registration = Registration::default();
    if num_found < MIN_POSE_POINTS {
        return registration;
    }
    let Some(newest) = map.newest() else {
        return registration;
    };
    let found = known.iter();
    let matches: Vec<MapMatch> = found
        .map(|(index, pixel)| {
            let point = &map.points()[*index];
            MapMatch {
                point_in_world: position(map, point, pinhole),
                pixel: *pixel,
                inv_sigma_px: 1.0 / (POSE_SIGMA_PX * point.pixel_size),
            }
        })
        .collect();
    let initial = &newest.camera_from_world;
    let Ok(refined) = refine_pose(initial, pinhole, &matches, &PoseOnlyConfig::default()) else {
        return registration;
    };
    let found = known.into_iter().zip(refined.inliers);
    let inliers: Vec<(usize, Vec2)> = found.filter_map(|(f, ok)| ok.then_some(f)).collect();
    if inliers.len() >= MIN_POSE_POINTS && inliers.len() * 3 >= num_found {
        registration.camera_from_world = Some(refined.camera_from_world);
        registration.inliers = inliers;
        registration.inliers.extend(guesses);
    }
    registration
}
