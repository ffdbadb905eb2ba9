//! Bundle adjustment over the newest and the most covisible keyframes, and at the end over all.

use super::looks::Looks;
use super::{LeftLens, SparseConfig};
use crate::certainty::PoseSigma;
use crate::map::{Adjustment, Map, MapKeyframe};
use crate::{FragmentId, KeyframeId};
use monogrid_geometry::Pinhole;
use monogrid_graph::RobustKernel;
use monogrid_graph::bundle::{
    AnchoredPoint, BundleConfig, BundleError, BundleKeyframe, BundleProblem, BundleSolution,
    CovarianceOf, InverseDepthPrior, Observation, PoseFreedom, adjust, adjust_to_images,
};
use std::collections::{BTreeMap, BTreeSet};

/// Standard deviation of a found position, px of the level on which the patch stands out.
const SIGMA_PX: f64 = 0.6;
/// Most covisible older keyframes whose poses are adjusted with the newest ones.
const WINDOW_COVISIBLE: usize = 8;
/// Shared points from which an older keyframe counts as covisible.
const MIN_SHARED_POINTS: usize = 15;
/// Points with a measured depth from which these hold the scale.
const MIN_MEASURED_POINTS: usize = 15;
/// A measured depth: some are of another surface than their point, of a reflection, or of glass.
const RANGE_KERNEL: RobustKernel = RobustKernel::Huber { delta: 2.0 };
/// Iterations of the adjustment.
const MAX_ITERATIONS: usize = 8;
/// Squared normalised residual above which an observation is removed after the adjustment.
const MAX_CHI_SQ: f64 = 9.0;
/// Iterations of each adjustment of all keyframes together.
const FINAL_ITERATIONS: usize = 30;
/// Iterations of the adjustment to images.
const IMAGE_ITERATIONS: usize = 5;

/// What is known about the world of a fragment.
#[derive(Clone, Copy, Debug)]
struct Gauge {
    /// The keyframe that is the world.
    origin: KeyframeId,
    /// Whether enough depths were measured to hold the scale.
    is_measured: bool,
}

impl Gauge {
    /// Of a fragment, by the points that are adjusted.
    fn new(map: &Map, fragment: FragmentId, points: &[AnchoredPoint]) -> Self {
        let first = map.in_fragment(fragment).next();
        let measured = points.iter().filter(|point| point.prior.is_some());
        Self {
            origin: first.map_or(0, |keyframe| keyframe.id),
            is_measured: measured.count() >= MIN_MEASURED_POINTS,
        }
    }
}

/// Adjusts the window around the newest keyframe; says which observations do not fit, and how well
/// the pose of that keyframe is known.
pub(crate) fn adjust_window(map: &Map, pinhole: &Pinhole, config: &SparseConfig) -> Adjustment {
    let lens = LeftLens::of_pinhole(pinhole);
    let Some(newest) = map.newest() else {
        return Adjustment::default();
    };
    let free = window(map, newest, config);
    let settings = BundleConfig {
        covariance: CovarianceOf::Poses,
        ..bundle_settings(MAX_ITERATIONS, config)
    };
    let adjustment = adjust_by(map, newest.fragment, free, &lens, &|problem| {
        adjust(&problem.bundle, &settings)
    });
    let known = adjustment.last.filter(|(id, _)| *id == newest.id);
    // no points hold one that was not adjusted
    let last = known.unwrap_or((newest.id, PoseSigma::UNKNOWN));
    Adjustment {
        last: (newest.rank > 0).then_some(last),
        ..adjustment
    }
}

/// Adjusts all keyframes of a fragment and all points that they share; says which observations do
/// not fit.
pub(crate) fn adjust_all(
    map: &Map,
    fragment: FragmentId,
    lens: &LeftLens,
    config: &SparseConfig,
) -> Adjustment {
    let settings = final_settings(FINAL_ITERATIONS, config);
    adjust_by(map, fragment, all_of(map, fragment), lens, &|problem| {
        adjust(&problem.bundle, &settings)
    })
}

/// The same to the places at which points were found and to the images where they are projected:
/// from near the solution, since an image says nothing of what is more than two pixels away.
pub(crate) fn adjust_all_to_images(
    map: &Map,
    fragment: FragmentId,
    lens: &LeftLens,
    config: &SparseConfig,
) -> Adjustment {
    let settings = final_settings(IMAGE_ITERATIONS, config);
    adjust_by(map, fragment, all_of(map, fragment), lens, &|problem| {
        let identities = (problem.keyframes.as_slice(), problem.points.as_slice());
        let looks = Looks::new(map, &problem.bundle, identities, &config.images);
        adjust_to_images(&problem.bundle, &looks, &settings)
    })
}

fn all_of(map: &Map, fragment: FragmentId) -> Vec<KeyframeId> {
    map.in_fragment(fragment).map(|k| k.id).collect()
}

/// What all adjustments share. Most patches are found to a tenth of a pixel and some a pixel
/// beside, where they overlap an edge of something nearer or are seen too flat: a nearly absolute
/// error lets these say little.
fn bundle_settings(max_iterations: usize, config: &SparseConfig) -> BundleConfig {
    BundleConfig {
        max_iterations,
        kernel: RobustKernel::Huber {
            delta: config.kernel_px / SIGMA_PX,
        },
        inlier_chi2: MAX_CHI_SQ,
        ..BundleConfig::default()
    }
}

/// The same at the end: errors of large loops fall slowly.
fn final_settings(max_iterations: usize, config: &SparseConfig) -> BundleConfig {
    BundleConfig {
        min_relative_decrease: 1e-6,
        ..bundle_settings(max_iterations, config)
    }
}

/// Adjusts some keyframes of a fragment, given ascending, with the points that they see, by a way
/// to solve it.
fn adjust_by(
    map: &Map,
    fragment: FragmentId,
    mut free: Vec<KeyframeId>,
    lens: &LeftLens,
    solve: &dyn Fn(&Problem) -> Result<BundleSolution, BundleError>,
) -> Adjustment {
    // A keyframe that sees too little keeps the pose that tracking gave it.
    free.retain(|id| num_shared_points(map, *id) >= MIN_SHARED_POINTS);
    let Some(problem) = Problem::build(map, fragment, &free, lens) else {
        return Adjustment::default();
    };
    match solve(&problem) {
        Ok(solution) => problem.adjustment(map, &solution),
        Err(error) => Adjustment {
            failure: Some(error),
            ..Adjustment::default()
        },
    }
}

/// How many points a keyframe shares with others.
fn num_shared_points(map: &Map, id: KeyframeId) -> usize {
    let points = map[id].points.all().map(|index| &map.points()[index]);
    points.filter(|point| point.is_shared()).count()
}

/// The keyframes used last, and the others that share most points with the newest.
fn window(map: &Map, newest: &MapKeyframe, config: &SparseConfig) -> Vec<KeyframeId> {
    let recent = map.recent_in(newest.fragment);
    let recent = &recent[recent.len().saturating_sub(config.window_newest)..];
    let mut shared: BTreeMap<KeyframeId, usize> = BTreeMap::new();
    let points = newest.points.all().map(|index| &map.points()[index]);
    for point in points.filter(|p| p.alive) {
        let others = point.observations.iter().map(|o| o.keyframe);
        for id in others.chain([point.host]).filter(|id| !recent.contains(id)) {
            *shared.entry(id).or_default() += 1;
        }
    }
    shared.retain(|_, count| *count >= MIN_SHARED_POINTS);
    let mut covisible: Vec<(usize, KeyframeId)> =
        shared.into_iter().map(|(id, count)| (count, id)).collect();
    covisible.sort_by_key(|(count, id)| (std::cmp::Reverse(*count), *id));
    covisible.truncate(WINDOW_COVISIBLE);
    let mut ids = recent.to_vec();
    ids.extend(covisible.iter().map(|(_, id)| *id));
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
        map: &Map,
        fragment: FragmentId,
        free: &[KeyframeId],
        lens: &LeftLens,
    ) -> Option<Self> {
        let is_free = |id: KeyframeId| free.binary_search(&id).is_ok();
        let seen: BTreeSet<usize> = free.iter().flat_map(|id| map[*id].points.all()).collect();
        let seen = seen.into_iter();
        let shared = seen.filter(|index| map.points()[*index].is_shared());
        let points: Vec<usize> = shared.collect();
        let mut keyframes: BTreeSet<KeyframeId> = free.iter().copied().collect();
        for point in points.iter().map(|index| &map.points()[*index]) {
            keyframes.insert(point.host);
            keyframes.extend(point.observations.iter().map(|o| o.keyframe));
        }
        let keyframes = Vec::from_iter(keyframes);
        let slot_of = |id: KeyframeId| keyframes.partition_point(|other| *other < id);
        let is_metric = map.is_metric(fragment);
        let mut bundle = BundleProblem {
            pinhole: lens.pinhole,
            keyframes: Vec::new(),
            points: Vec::with_capacity(points.len()),
            observations: Vec::new(),
        };
        for (slot, &i) in points.iter().enumerate() {
            let point = &map.points()[i];
            bundle.points.push(AnchoredPoint {
                host: slot_of(point.host),
                pixel: lens.ideal(point.pixel),
                inverse_depth: point.idepth,
                prior: (is_metric && point.is_measured).then_some(InverseDepthPrior {
                    mean: point.prior_idepth,
                    sigma: point.prior_sigma,
                    kernel: RANGE_KERNEL,
                }),
            });
            for observation in &point.observations {
                bundle.observations.push(Observation {
                    keyframe: slot_of(observation.keyframe),
                    point: slot,
                    pixel: lens.ideal(observation.pixel),
                    inv_sigma_px: 1.0 / (SIGMA_PX * point.pixel_size),
                });
            }
        }
        let gauge = Gauge::new(map, fragment, &bundle.points);
        bundle.keyframes = freedoms(map, &keyframes, &is_free, gauge);
        (!bundle.observations.is_empty()).then_some(Self {
            bundle,
            keyframes,
            points,
        })
    }

    /// How well the last pose is known beside those that were not adjusted, if it was.
    fn last(&self, map: &Map, solution: &BundleSolution) -> Option<(KeyframeId, PoseSigma)> {
        let id = *self.keyframes.last()?;
        let is_free = self.bundle.keyframes.last()?.freedom != PoseFreedom::Fixed;
        let covariance = solution.covariance.as_ref()?.poses.last()?;
        // the unit of a keyframe is about the median depth
        let median_depth = map[id].world_from_keyframe.scale;
        is_free.then(|| (id, PoseSigma::of(covariance, median_depth)))
    }

    /// What a solution says about keyframes and points.
    fn adjustment(&self, map: &Map, solution: &BundleSolution) -> Adjustment {
        let camera_from_world = solution.camera_from_world.iter().copied();
        let idepths = solution.inverse_depths.iter().copied();
        let keyframes = self.keyframes.iter().copied();
        let points = self.points.iter().copied();
        let observations = self.bundle.observations.iter();
        Adjustment {
            last: self.last(map, solution),
            camera_from_world: keyframes.zip(camera_from_world).collect(),
            idepths: points.zip(idepths).collect(),
            refuted: observations
                .zip(&solution.observations)
                .filter(|(_, outcome)| !outcome.is_inlier())
                .map(|(o, _)| (self.points[o.point], self.keyframes[o.keyframe]))
                .collect(),
            failure: None,
        }
    }
}

/// What may change about each pose. The first keyframe of the fragment is its world; where nothing
/// else is fixed and no depth was measured, the distance to the farthest keyframe holds the scale.
fn freedoms(
    map: &Map,
    keyframes: &[KeyframeId],
    is_free: &dyn Fn(KeyframeId) -> bool,
    gauge: Gauge,
) -> Vec<BundleKeyframe> {
    let mut out: Vec<BundleKeyframe> = keyframes
        .iter()
        .map(|&id| BundleKeyframe {
            camera_from_world: map[id].camera_from_world,
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
    if let ([anchor], false) = (fixed.as_slice(), gauge.is_measured && !floats) {
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
