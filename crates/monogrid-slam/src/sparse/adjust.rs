//! Bundle adjustment over the newest and the most covisible keyframes.

use super::SparseConfig;
use super::points::SparseLayer;
use crate::node::Node;
use crate::{FragmentId, KeyframeId};
use monogrid_geometry::{Pinhole, Se3, Vec2, Vec3};
use monogrid_graph::bundle::{
    AnchoredPoint, BundleConfig, BundleKeyframe, BundleProblem, InverseDepthPrior, Observation,
    PoseFreedom, adjust,
};
use monogrid_graph::{MapMatch, PoseOnlyConfig, refine_pose as refine_pose_only};
use std::collections::BTreeMap;

/// What an adjustment did.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Adjusted {
    pub num_keyframes: usize,
    pub num_points: usize,
    pub removed_observations: usize,
}

/// A pose from found points, and which of them agree with it.
pub(crate) struct RefinedPose {
    pub camera_from_world: Se3,
    pub inlier: Vec<bool>,
}

/// Refines a pose on points with known positions.
pub(crate) fn refine_pose(
    initial: &Se3,
    matches: &[(Vec3, Vec2)],
    pinhole: &Pinhole,
    config: &SparseConfig,
) -> RefinedPose {
    let matches: Vec<MapMatch> = matches
        .iter()
        .map(|(point_in_world, pixel)| MapMatch {
            point_in_world: *point_in_world,
            pixel: *pixel,
            inv_sigma_px: 1.0 / config.pose_sigma_px,
        })
        .collect();
    match refine_pose_only(initial, pinhole, &matches, &PoseOnlyConfig::default()) {
        Ok(solution) => RefinedPose {
            camera_from_world: solution.camera_from_world,
            inlier: solution.inliers,
        },
        Err(_) => RefinedPose {
            camera_from_world: *initial,
            inlier: vec![false; matches.len()],
        },
    }
}

/// What is known about the world of a fragment.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Gauge {
    /// The keyframe that is the world.
    origin: KeyframeId,
    /// Whether the inverse depths of its points are metric measurements.
    is_metric: bool,
}

impl Gauge {
    pub(crate) fn of(layer: &SparseLayer, nodes: &[Node], fragment: FragmentId) -> Self {
        let first = nodes.iter().find(|node| node.fragment == fragment);
        let origin = first.map_or(0, |node| node.id);
        Self {
            origin,
            is_metric: layer.has_seed && origin == 0,
        }
    }
}

/// Adjusts the window around the newest keyframe, the last of `recent`, and removes observations that do not
/// fit.
pub(crate) fn adjust_window(
    layer: &mut SparseLayer,
    recent: &[KeyframeId],
    gauge: Gauge,
    pinhole: &Pinhole,
    config: &SparseConfig,
) -> Adjusted {
    let mut free = window(layer, recent, config);
    // A keyframe that sees too little keeps the pose that tracking gave it.
    let seen = count_observations(layer);
    free.retain(|id| seen.get(id).copied().unwrap_or(0) >= config.min_shared_points);
    let Some(problem) = Problem::build(layer, &free, gauge, pinhole, config) else {
        return Adjusted::default();
    };
    let settings = BundleConfig {
        max_iterations: config.max_iterations,
        inlier_chi2: config.max_chi_sq,
        ..BundleConfig::default()
    };
    let Ok(solution) = adjust(&problem.bundle, &settings) else {
        return Adjusted::default();
    };
    for (slot, &id) in problem.keyframes.iter().enumerate() {
        layer.camera_from_world[id as usize] = solution.camera_from_world[slot];
    }
    for (slot, &index) in problem.points.iter().enumerate() {
        layer.points[index].idepth = solution.inverse_depths[slot];
    }
    let mut removed = 0;
    for (observation, outcome) in problem
        .bundle
        .observations
        .iter()
        .zip(&solution.observations)
    {
        if outcome.is_inlier() {
            continue;
        }
        let keyframe = problem.keyframes[observation.keyframe];
        let point = &mut layer.points[problem.points[observation.point]];
        point.observations.retain(|o| o.keyframe != keyframe);
        removed += 1;
    }
    Adjusted {
        num_keyframes: free.len(),
        num_points: problem.points.len(),
        removed_observations: removed,
    }
}

/// How many points with at least two views each keyframe sees.
fn count_observations(layer: &SparseLayer) -> BTreeMap<KeyframeId, usize> {
    let mut seen = BTreeMap::new();
    for point in layer
        .points
        .iter()
        .filter(|p| p.alive && !p.observations.is_empty())
    {
        let others = point.observations.iter().map(|o| o.keyframe);
        for id in others.chain([point.host]) {
            *seen.entry(id).or_default() += 1;
        }
    }
    seen
}

/// The keyframes used last, and the others that share most points with the newest.
fn window(layer: &SparseLayer, recent: &[KeyframeId], config: &SparseConfig) -> Vec<KeyframeId> {
    let recent = &recent[recent.len().saturating_sub(config.window_newest)..];
    let Some(&newest) = recent.last() else {
        return Vec::new();
    };
    let mut shared: BTreeMap<KeyframeId, usize> = BTreeMap::new();
    for point in layer.points.iter().filter(|p| p.alive) {
        let seen_by_newest =
            point.host == newest || point.observations.iter().any(|o| o.keyframe == newest);
        if !seen_by_newest {
            continue;
        }
        let others = point.observations.iter().map(|o| o.keyframe);
        for id in others.chain([point.host]).filter(|id| !recent.contains(id)) {
            *shared.entry(id).or_default() += 1;
        }
    }
    let mut covisible: Vec<(usize, KeyframeId)> = shared
        .into_iter()
        .filter(|(_, count)| *count >= config.min_shared_points)
        .map(|(id, count)| (count, id))
        .collect();
    covisible.sort_by_key(|(count, id)| (std::cmp::Reverse(*count), *id));
    let mut ids = recent.to_vec();
    ids.extend(
        covisible
            .iter()
            .take(config.window_covisible)
            .map(|(_, id)| *id),
    );
    ids.sort_unstable();
    ids
}

/// A window as a bundle problem, with the identities behind its indices.
struct Problem {
    bundle: BundleProblem,
    keyframes: Vec<KeyframeId>,
    points: Vec<usize>,
}

impl Problem {
    /// All points that a free keyframe sees; other keyframes that see them are held fixed.
    fn build(
        layer: &SparseLayer,
        free: &[KeyframeId],
        gauge: Gauge,
        pinhole: &Pinhole,
        config: &SparseConfig,
    ) -> Option<Self> {
        let is_free = |id: KeyframeId| free.binary_search(&id).is_ok();
        let points: Vec<usize> = layer
            .points
            .iter()
            .enumerate()
            .filter(|(_, p)| p.alive && !p.observations.is_empty())
            .filter(|(_, p)| is_free(p.host) || p.observations.iter().any(|o| is_free(o.keyframe)))
            .map(|(i, _)| i)
            .collect();
        let mut slots: BTreeMap<KeyframeId, usize> = free.iter().map(|id| (*id, 0)).collect();
        for &i in &points {
            let point = &layer.points[i];
            slots.insert(point.host, 0);
            slots.extend(point.observations.iter().map(|o| (o.keyframe, 0)));
        }
        for (slot, value) in slots.values_mut().enumerate() {
            *value = slot;
        }
        let keyframes: Vec<KeyframeId> = slots.keys().copied().collect();
        let mut bundle = BundleProblem {
            pinhole: *pinhole,
            keyframes: freedoms(layer, &keyframes, &is_free, gauge),
            points: Vec::with_capacity(points.len()),
            observations: Vec::new(),
            pose_priors: Vec::new(),
        };
        for (slot, &i) in points.iter().enumerate() {
            let point = &layer.points[i];
            bundle.points.push(AnchoredPoint {
                host: slots[&point.host],
                pixel: point.pixel,
                inverse_depth: point.idepth,
                prior: (gauge.is_metric && point.host == gauge.origin).then_some(
                    InverseDepthPrior {
                        mean: point.prior_idepth,
                        sigma: point.prior_sigma,
                    },
                ),
            });
            for observation in &point.observations {
                bundle.observations.push(Observation {
                    keyframe: slots[&observation.keyframe],
                    point: slot,
                    pixel: observation.pixel,
                    inv_sigma_px: 1.0 / config.sigma_px,
                });
            }
        }
        (!bundle.observations.is_empty()).then_some(Self {
            bundle,
            keyframes,
            points,
        })
    }
}

/// What may change about each pose. The first keyframe of the fragment is its world; where nothing else is fixed and no
/// depth was measured, the distance to the farthest keyframe holds the scale.
fn freedoms(
    layer: &SparseLayer,
    keyframes: &[KeyframeId],
    is_free: &dyn Fn(KeyframeId) -> bool,
    gauge: Gauge,
) -> Vec<BundleKeyframe> {
    let mut out: Vec<BundleKeyframe> = keyframes
        .iter()
        .map(|&id| BundleKeyframe {
            camera_from_world: layer.camera_from_world[id as usize],
            freedom: if id == gauge.origin || !is_free(id) {
                PoseFreedom::Fixed
            } else {
                PoseFreedom::Free
            },
        })
        .collect();
    let floats = out.iter().all(|k| k.freedom == PoseFreedom::Free);
    if let Some(oldest) = out.first_mut().filter(|_| floats) {
        // the window is all of a fragment that was joined: it shares no points with the rest
        oldest.freedom = PoseFreedom::Fixed;
    }
    let fixed: Vec<usize> = (0..out.len())
        .filter(|&i| out[i].freedom == PoseFreedom::Fixed)
        .collect();
    if let ([anchor], false) = (fixed.as_slice(), gauge.is_metric && !floats) {
        let centre = |k: &BundleKeyframe| k.camera_from_world.inverse().translation;
        let origin = centre(&out[*anchor]);
        let farthest = (0..out.len())
            .filter(|i| i != anchor)
            .map(|i| ((centre(&out[i]) - origin).norm(), i))
            .max_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((distance, i)) = farthest
            && distance > 1e-9
        {
            out[i].freedom = PoseFreedom::FixedDistance { to: *anchor };
        }
    }
    out
}
