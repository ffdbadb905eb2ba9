//! New points of a new keyframe, and those that were not found again.

use super::SparseConfig;
use super::matching::{find_in_older, nearby_idepth};
use crate::map::{Map, MapKeyframe, SparsePoint};
use crate::store::Kept;
use monogrid_depth::DepthMap;
use monogrid_features::{CornerConfig, PatchSearchConfig, detect_corners, patch_level};
use monogrid_geometry::{Mat3, Pinhole, Vec2, Vec3};
use monogrid_image::{Mask, Pyramid};

/// Points anchored per keyframe with fewer observations after this many keyframes are dropped.
const DROP_AFTER_KEYFRAMES: u32 = 3;
/// Coarser levels on which corners are searched where the finest shows too few: the faint blotches
/// of a plain wall stand out of the noise there, and hold the scale where nothing else does.
const NUM_COARSER: usize = 2;

/// New corners of the newest keyframe where it sees few points, with the depth that a depth camera
/// measured there, or from the dense map (its units) at or around them or that of a surface that
/// goes on, and where the keyframes used last see them. `seen` are the pixels of the points that
/// it sees already.
pub(crate) fn anchor(
    map: &Map,
    depth: &DepthMap,
    seen: &[Vec2],
    pinhole: &Pinhole,
    mask: &Mask,
    config: &SparseConfig,
) -> Vec<SparsePoint> {
    let Some(newest) = map.newest() else {
        return Vec::new();
    };
    let mut points = corners(newest, depth, seen, (pinhole, mask), config);
    let observations = find_in_older(map, newest, &points, pinhole);
    for (point, observations) in points.iter_mut().zip(observations) {
        point.observations = observations;
    }
    points
}

fn corners(
    newest: &MapKeyframe,
    depth: &DepthMap,
    seen: &[Vec2],
    (pinhole, mask): (&Pinhole, &Mask),
    config: &SparseConfig,
) -> Vec<SparsePoint> {
    let missing = config.points_per_keyframe.saturating_sub(seen.len());
    if missing == 0 {
        return Vec::new();
    }
    let settings = corner_settings(missing, pinhole, config);
    let Some(pyramid) = newest.pyramid() else {
        return Vec::new();
    };
    let corners = detect_corners(&pyramid, Some(mask), seen, &settings);
    let unit = newest.world_from_keyframe.scale;
    let measured = newest.measured.as_ref().and_then(Kept::get);
    let measured: Vec<Option<(f64, f64)>> = corners
        .iter()
        .map(|corner| {
            let (idepth, sigma) = measured.as_ref()?.near(corner.pixel.x, corner.pixel.y)?;
            Some((f64::from(idepth) * unit, f64::from(sigma) * unit))
        })
        .collect();
    let nearby: Vec<Option<(f64, f64)>> = corners
        .iter()
        .zip(&measured)
        .map(|(corner, measured)| measured.or_else(|| nearby_idepth(depth, &corner.pixel)))
        .collect();
    let known = corners.iter().zip(&nearby);
    let known: Vec<(Vec2, f64)> = known
        .filter_map(|(corner, nearby)| Some((corner.pixel, (*nearby)?.0)))
        .collect();
    corners
        .iter()
        .zip(nearby.iter().zip(&measured))
        .filter_map(|(corner, (nearby, measured))| {
            let (idepth, sigma) = nearby.or_else(|| continued_idepth(&known, &corner.pixel))?;
            Some(SparsePoint {
                host: newest.id,
                pixel: corner.pixel,
                idepth: idepth / unit,
                prior_idepth: idepth / unit,
                prior_sigma: sigma / unit,
                is_measured: measured.is_some(),
                pixel_size: pixel_size(&pyramid, &corner.pixel),
                observations: Vec::new(),
                alive: true,
            })
        })
        .collect()
}

/// Corners with depth that say where a surface goes on.
const CONTINUED_FROM: usize = 16;
/// Fewest of them.
const MIN_CONTINUED_FROM: usize = 8;
/// Relative change of inverse depth per px that a surface is expected to have.
const SLOPE_PER_PX: f64 = 0.002;
/// Relative standard deviation of a corner's inverse depth about the plane.
const PLANE_SIGMA: f64 = 0.05;
/// Relative standard deviation of an inverse depth where the surface is taken to go on: a guess
/// ([`SparsePoint::has_depth`]).
const CONTINUED_SIGMA: f64 = 0.3;

/// Inverse depth, and how uncertain it is, where the plane through the nearest corners with depth
/// goes on. A camera that turns towards a plain wall sees faint corners which nobody knows the
/// depth of; they say how it turns all the same, and their depth once it has moved.
///
/// The inverse depth of a plane is an affine function of the pixel: least squares with a prior of
/// zero on its slope.
fn continued_idepth(known: &[(Vec2, f64)], pixel: &Vec2) -> Option<(f64, f64)> {
    let offsets = known.iter().map(|(at, idepth)| (at - pixel, *idepth));
    let mut nearest: Vec<(Vec2, f64)> = offsets.collect();
    nearest.sort_by(|a, b| a.0.norm().total_cmp(&b.0.norm()));
    nearest.truncate(CONTINUED_FROM);
    if nearest.len() < MIN_CONTINUED_FROM {
        return None;
    }
    let mean = nearest.iter().map(|(_, idepth)| idepth).sum::<f64>() / nearest.len() as f64;
    let slope_weight = (PLANE_SIGMA / SLOPE_PER_PX).powi(2);
    let mut normal = Mat3::from_diagonal(&Vec3::new(0.0, slope_weight, slope_weight));
    let mut right = Vec3::zeros();
    for (offset, idepth) in &nearest {
        let row = Vec3::new(1.0, offset.x, offset.y);
        normal += row * row.transpose();
        right += row * (idepth / mean - 1.0);
    }
    let relative = (normal.try_inverse()? * right).x;
    // farther from the corners a plane says nothing
    let idepth = mean * (1.0 + relative).clamp(0.5, 2.0);
    Some((idepth, CONTINUED_SIGMA * idepth))
}

/// [`SparsePoint::pixel_size`] of a point at a pixel of its host's images.
pub(crate) fn pixel_size(host: &Pyramid, pixel: &Vec2) -> f64 {
    let level = patch_level(host, pixel, &PatchSearchConfig::default());
    f64::from(1u32 << level)
}

/// How corners are detected in the images of a camera.
pub(crate) fn corner_settings(
    max_corners: usize,
    pinhole: &Pinhole,
    config: &SparseConfig,
) -> CornerConfig {
    let usual = CornerConfig::default();
    CornerConfig {
        max_corners,
        num_coarser: NUM_COARSER,
        // in a small image things are small
        min_distance_px: (config.min_spacing * pinhole.fx).min(usual.min_distance_px),
        ..usual
    }
}

/// Points in use that were not found again soon after they were anchored, in the fragment of the
/// newest keyframe.
pub(crate) fn unconfirmed(map: &Map) -> Vec<usize> {
    let Some(newest) = map.newest() else {
        return Vec::new();
    };
    let is_old = |k: &&MapKeyframe| newest.id.saturating_sub(k.id) >= DROP_AFTER_KEYFRAMES;
    let old = map.in_fragment(newest.fragment).filter(is_old);
    old.flat_map(|keyframe| keyframe.points.anchored.clone())
        .filter(|index| {
            let point = &map.points()[*index];
            point.alive && point.observations.len() < 2
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::map::Observation;

    /// Inverse depth of a plane at a pixel.
    fn plane(at: &Vec2) -> f64 {
        0.5 + 0.0004 * at.x - 0.0002 * at.y
    }

    fn corners_of_plane(count: usize) -> Vec<(Vec2, f64)> {
        let at = (0..count).map(|k| Vec2::new(10.0 * (k % 6) as f64, 40.0 * (k / 6) as f64));
        at.map(|at| (at, plane(&at))).collect()
    }

    #[test]
    fn a_plane_goes_on_beyond_its_corners_as_a_guess() {
        let at = Vec2::new(110.0, 40.0);
        let (idepth, sigma) = continued_idepth(&corners_of_plane(16), &at).unwrap();
        // the prior pulls the slope towards zero
        assert!((idepth / plane(&at) - 1.0).abs() < 0.03, "{idepth}");
        let point = SparsePoint {
            host: 0,
            pixel: at,
            idepth,
            prior_idepth: idepth,
            prior_sigma: sigma,
            is_measured: false,
            pixel_size: 1.0,
            observations: Vec::new(),
            alive: true,
        };
        assert!(!point.has_depth());
        let seen = Observation {
            keyframe: 1,
            pixel: at,
        };
        let observations = vec![seen];
        assert!(
            SparsePoint {
                observations,
                ..point.clone()
            }
            .has_depth()
        );
        let prior_sigma = 0.1 * idepth;
        assert!(
            SparsePoint {
                prior_sigma,
                ..point
            }
            .has_depth()
        );
    }

    #[test]
    fn a_few_corners_are_no_surface_and_the_nearest_say_how_it_goes_on() {
        let at = Vec2::new(110.0, 40.0);
        assert!(continued_idepth(&corners_of_plane(MIN_CONTINUED_FROM - 1), &at).is_none());
        let near = continued_idepth(&corners_of_plane(CONTINUED_FROM), &at);
        let mut more = corners_of_plane(CONTINUED_FROM);
        more.push((Vec2::new(900.0, 900.0), 7.0));
        assert_eq!(continued_idepth(&more, &at), near);
    }

    #[test]
    fn corners_lie_closer_in_small_images() {
        let config = SparseConfig {
            min_spacing: 0.02,
            ..SparseConfig::default()
        };
        let distance = |f: f64| {
            let pinhole = Pinhole::new(f, f, 0.0, 0.0);
            corner_settings(1, &pinhole, &config).min_distance_px
        };
        assert_eq!(distance(250.0), 5.0);
        assert_eq!(distance(1000.0), CornerConfig::default().min_distance_px);
    }
}
