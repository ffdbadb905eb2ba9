//! One view relative to a keyframe, from correspondences to a verdict.

use super::PlaceMemoryConfig;
use super::refine::{Correspondence, Fit, Freedom, Projection, refine};
use super::search::{FeatureGrid, Pair, SearchArea, search};
use super::support::cell_of;
use super::view::Landmark;
use crate::{DescriptorMatch, Feature, PointPixel, absolute_pose};
use monogrid_geometry::median::median;
use monogrid_geometry::{Pinhole, Sim3, Vec2};

/// One side of a comparison: corners, with landmarks for those whose depth is known.
pub(super) struct Side<'a> {
    pub features: &'a [Feature],
    pub landmarks: &'a [Option<Landmark>],
    pub grid: FeatureGrid<'a>,
    pub pinhole: &'a Pinhole,
}

impl<'a> Side<'a> {
    pub(super) fn new(
        features: &'a [Feature],
        landmarks: &'a [Option<Landmark>],
        size: (usize, usize),
        pinhole: &'a Pinhole,
    ) -> Self {
        Self {
            features,
            landmarks,
            grid: FeatureGrid::new(features, size.0, size.1),
            pinhole,
        }
    }
}

/// Half widths of the guided search, px of the corner's level, and its repetitions.
const RADII_PX: [f64; 2] = [12.0, 6.0];

/// Pose of view `b` relative to keyframe `a`, whose landmarks it sees; `matches` pair features of
/// `b` (`a_idx`) with those of `a` (`b_idx`), as a query of the index returns them.
pub(super) fn locate(
    a: &Side<'_>,
    b: &Side<'_>,
    matches: &[DescriptorMatch],
    freedom: Freedom,
    config: &PlaceMemoryConfig,
) -> Option<(Fit, Vec<Correspondence>)> {
    let sightings: Vec<PointPixel> = matches
        .iter()
        .filter_map(|m| {
            Some(PointPixel {
                point_in_world: (*a.landmarks.get(m.b_idx)?)?.point,
                pixel: b.features.get(m.a_idx)?.pixel,
            })
        })
        .collect();
    let rigid = absolute_pose(&sightings, b.pinhole, &config.pose)?;
    let pairs = matches.iter().map(|m| (m.b_idx, m.a_idx)).collect();
    let rough = correspondences(a, b, pairs, freedom, config);
    let mut pose = with_scale(&rough, &Sim3::from(rigid), freedom, config)?;
    let mut best = None;
    for radius_px in RADII_PX {
        let area = SearchArea {
            radius_px,
            max_distance: config.max_guided_distance,
        };
        let mut pairs: Vec<(usize, usize)> = search(a.landmarks, &b.grid, &pose, b.pinhole, area)
            .into_iter()
            .map(
                |Pair {
                     landmark_idx,
                     feature_idx,
                 }| (landmark_idx, feature_idx),
            )
            .collect();
        if freedom == Freedom::Similarity {
            let back = search(b.landmarks, &a.grid, &pose.inverse(), a.pinhole, area);
            pairs.extend(back.into_iter().map(|p| (p.feature_idx, p.landmark_idx)));
        }
        pairs.sort_unstable();
        pairs.dedup();
        let found = correspondences(a, b, pairs, freedom, config);
        let fit = refine(&found, &pose, freedom)?;
        pose = fit.b_from_a;
        best = Some((fit, found));
    }
    best
}

/// What is known about pairs of features of `a` and `b`.
fn correspondences(
    a: &Side<'_>,
    b: &Side<'_>,
    pairs: Vec<(usize, usize)>,
    freedom: Freedom,
    config: &PlaceMemoryConfig,
) -> Vec<Correspondence> {
    let sigma_px = |f: &Feature| config.pixel_sigma * (1usize << f.level) as f64;
    let projection = |from: &Side<'_>, i: usize, to: &Side<'_>, j: usize| {
        let landmark = (*from.landmarks.get(i)?)?;
        let feature = to.features.get(j)?;
        Some(Projection {
            point: landmark.point,
            relative_sigma: landmark.relative_sigma,
            pixel: feature.pixel,
            sigma_px: sigma_px(feature),
            pinhole: *to.pinhole,
        })
    };
    let both = pairs.into_iter().map(|(i, j)| Correspondence {
        forward: projection(a, i, b, j),
        backward: match freedom {
            Freedom::Rigid => None,
            Freedom::Similarity => projection(b, j, a, i),
        },
    });
    both.filter(|c| c.forward.is_some() || c.backward.is_some())
        .collect()
}

/// A rigid pose in the units of `a` as a similarity: the ratio of the units is the median ratio of
/// the depths that `b` knows to those that the pose predicts. `None` with too few of them.
fn with_scale(
    correspondences: &[Correspondence],
    b_from_a: &Sim3,
    freedom: Freedom,
    config: &PlaceMemoryConfig,
) -> Option<Sim3> {
    if freedom == Freedom::Rigid {
        return Some(*b_from_a);
    }
    let mut ratios: Vec<f64> = correspondences
        .iter()
        .filter_map(|c| {
            let (forward, backward) = (c.forward.as_ref()?, c.backward.as_ref()?);
            let point = *b_from_a * forward.point;
            let error = forward.pinhole.project(&point) - forward.pixel;
            let is_close =
                point.z > Pinhole::MIN_DEPTH && error.norm() < 2.0 * config.pose.max_error_px;
            is_close.then(|| backward.point.z / point.z)
        })
        .collect();
    if ratios.len() < config.pose.min_inliers / 2 {
        return None;
    }
    let scale = median(&mut ratios)?;
    let translation = b_from_a.translation * scale;
    Some(Sim3::new(scale, b_from_a.rotation, translation))
}

/// Whether a fit has enough inliers, spread over the image, and a small covariance.
pub(super) fn is_determined(
    fit: &Fit,
    correspondences: &[Correspondence],
    size: (usize, usize),
    config: &PlaceMemoryConfig,
) -> bool {
    let judged = correspondences.iter().zip(&fit.inliers);
    let inliers = judged.filter_map(|(c, is_inlier)| is_inlier.then_some(c));
    let mut cells = std::collections::BTreeSet::new();
    let mut depths: Vec<f64> = Vec::new();
    for c in inliers {
        let seen: Option<(Vec2, f64)> = match (&c.forward, &c.backward) {
            (Some(f), _) => Some((f.pixel, (fit.b_from_a * f.point).z)),
            (None, Some(b)) => Some((b.pixel, b.point.z)),
            (None, None) => None,
        };
        if let Some((pixel, depth)) = seen {
            cells.insert(cell_of(&pixel, size.0, size.1));
            depths.push(depth);
        }
    }
    let Some(median_depth) = median(&mut depths) else {
        return false;
    };
    let sigma = |from: usize| {
        let sum: f64 = (from..from + 3).map(|i| fit.covariance[(i, i)]).sum();
        sum.sqrt()
    };
    fit.num_inliers >= config.min_inliers
        && cells.len() >= config.min_cells
        && sigma(0) < config.max_translation_sigma * median_depth
        && sigma(3) < config.max_rotation_sigma_deg.to_radians()
        && fit.covariance[(6, 6)].sqrt() < config.max_scale_sigma
}
