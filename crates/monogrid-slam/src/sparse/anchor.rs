//! New points of a new keyframe, and those that were not found again.

use super::SparseConfig;
use super::matching::{find_in_older, nearby_idepth};
use crate::map::{Map, MapKeyframe, SparsePoint};
use monogrid_depth::DepthMap;
use monogrid_features::{CornerConfig, PatchSearchConfig, detect_corners, patch_level};
use monogrid_geometry::{Pinhole, Vec2};
use monogrid_image::{Mask, Pyramid};

/// Points anchored per keyframe with fewer observations after this many keyframes are dropped.
const DROP_AFTER_KEYFRAMES: u32 = 3;
/// Coarser levels on which corners are searched where the finest shows too few: the faint blotches
/// of a plain wall stand out of the noise there, and hold the scale where nothing else does.
const NUM_COARSER: usize = 2;

/// New corners of the newest keyframe where it sees few points, with depth from the dense map (its
/// units) at or around them, and where the keyframes used last see them. `seen` are the pixels of
/// the points that it sees already.
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
    corners
        .iter()
        .filter_map(|corner| {
            let (idepth, sigma) = nearby_idepth(depth, &corner.pixel)?;
            Some(SparsePoint {
                host: newest.id,
                pixel: corner.pixel,
                idepth: idepth / unit,
                prior_idepth: idepth / unit,
                prior_sigma: sigma / unit,
                pixel_size: pixel_size(&pyramid, &corner.pixel),
                observations: Vec::new(),
                alive: true,
            })
        })
        .collect()
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
