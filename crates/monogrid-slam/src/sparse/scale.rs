//! The unit of a keyframe's dense depth, from the adjusted points that the keyframe sees.

use super::SparseLayer;
use super::matching::dense_idepth;
use crate::KeyframeId;
use monogrid_depth::DepthMap;
use monogrid_geometry::{Pinhole, Vec2};

/// Dense inverse depth (keyframe units) where a keyframe sees a point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DenseLink {
    pub point: usize,
    pub idepth: f64,
    /// Relative standard deviation.
    pub relative_sigma: f64,
}

/// Fewest points that pin a unit.
const MIN_LINKS: usize = 20;
/// Links with a larger relative standard deviation are not used.
const MAX_RELATIVE_SIGMA: f64 = 0.15;

/// Looks up the dense depth at every point that the keyframe sees.
pub(crate) fn dense_links(
    layer: &SparseLayer,
    keyframe: KeyframeId,
    depth: &DepthMap,
) -> Vec<DenseLink> {
    let pixel_in_keyframe = |point: &super::points::SparsePoint| -> Option<Vec2> {
        if point.host == keyframe {
            return Some(point.pixel);
        }
        point
            .observations
            .iter()
            .find(|o| o.keyframe == keyframe)
            .map(|o| o.pixel)
    };
    layer
        .points
        .iter()
        .enumerate()
        .filter(|(_, point)| point.alive)
        .filter_map(|(i, point)| {
            let (idepth, sigma) = dense_idepth(depth, &pixel_in_keyframe(point)?)?;
            let relative_sigma = sigma / idepth;
            (relative_sigma < MAX_RELATIVE_SIGMA).then_some(DenseLink {
                point: i,
                idepth,
                relative_sigma,
            })
        })
        .collect()
}

/// Length of the keyframe's unit in world units: the weighted median of dense over adjusted inverse
/// depth; `None` with too few points.
pub(crate) fn keyframe_scale(
    layer: &SparseLayer,
    keyframe: KeyframeId,
    links: &[DenseLink],
    pinhole: &Pinhole,
) -> Option<f64> {
    let camera_from_world = layer.camera_from_world.get(keyframe as usize)?;
    let mut ratios: Vec<(f64, f64)> = links
        .iter()
        .filter(|link| layer.points[link.point].alive)
        .filter(|link| !layer.points[link.point].observations.is_empty())
        .filter_map(|link| {
            let point = &layer.points[link.point];
            let in_camera = *camera_from_world * point.position(&layer.camera_from_world, pinhole);
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
