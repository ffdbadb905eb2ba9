//! The unit of a keyframe's dense depth, from the adjusted points that the keyframe sees.

use super::matching::{dense_idepth, position};
use crate::map::{DenseLink, Map, MapKeyframe, SeenPoints, SparsePoint};
use crate::{FragmentId, KeyframeId};
use monogrid_depth::DepthMap;
use monogrid_geometry::{Pinhole, Sim3};

/// Fewest points that pin a unit.
const MIN_LINKS: usize = 20;
/// Links with a larger relative standard deviation are not used.
const MAX_RELATIVE_SIGMA: f64 = 0.15;

/// Looks up the dense depth at every point that a keyframe sees.
pub(crate) fn dense_links(
    points: &[SparsePoint],
    seen: &SeenPoints,
    keyframe: KeyframeId,
    depth: &DepthMap,
) -> Vec<DenseLink> {
    seen.all()
        .map(|index| (index, &points[index]))
        .filter(|(_, point)| point.alive)
        .filter_map(|(index, point)| {
            let (idepth, sigma) = dense_idepth(depth, &point.pixel_in(keyframe)?)?;
            let relative_sigma = sigma / idepth;
            (relative_sigma < MAX_RELATIVE_SIGMA).then_some(DenseLink {
                point: index,
                idepth,
                relative_sigma,
            })
        })
        .collect()
}

/// Poses and units of the newest keyframes of a fragment as the points have them. Where too few
/// points pin a unit it stays. Older ones are to stay as the graph has them, which moves the same
/// newest: units that change where it does not reach would pull at its border for ever.
pub(crate) fn world_from_keyframes(
    map: &Map,
    fragment: FragmentId,
    newest: usize,
    pinhole: &Pinhole,
) -> Vec<(KeyframeId, Sim3)> {
    let older = map.num_keyframes_in(fragment).saturating_sub(newest);
    map.in_fragment(fragment)
        .skip(older)
        .map(|keyframe| {
            let unit = keyframe_unit(map, keyframe, pinhole);
            let unit = unit.unwrap_or(keyframe.world_from_keyframe.scale);
            let world_from_camera = keyframe.camera_from_world.inverse();
            (keyframe.id, world_from_camera.with_scale(unit))
        })
        .collect()
}

/// Length of the keyframe's unit in world units: the weighted median of dense over adjusted inverse
/// depth; `None` with too few points.
fn keyframe_unit(map: &Map, keyframe: &MapKeyframe, pinhole: &Pinhole) -> Option<f64> {
    let links = keyframe.points.links.iter();
    let mut ratios: Vec<(f64, f64)> = links
        .map(|link| (link, &map.points()[link.point]))
        .filter(|(_, point)| point.is_shared())
        .filter_map(|(link, point)| {
            let in_camera = keyframe.camera_from_world * position(map, point, pinhole);
            let ratio = link.idepth * in_camera.z;
            let sigma = link.relative_sigma.max(0.01);
            (ratio.is_finite() && ratio > 0.0).then_some((ratio, 1.0 / (sigma * sigma)))
        })
        .collect();
    if ratios.len() < MIN_LINKS {
        return None;
    }
    ratios.sort_by(|a, b| a.0.total_cmp(&b.0));
    let half = 0.5 * ratios.iter().map(|r| r.1).sum::<f64>();
    let mut sum = 0.0;
    ratios
        .iter()
        .find(|(_, weight)| {
            sum += weight;
            sum >= half
        })
        .map(|(ratio, _)| *ratio)
}
