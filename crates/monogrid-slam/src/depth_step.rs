//! The depth filter in parallel over fixed bands of rows.

use crate::TrackingConfig;
use crate::fault;
use monogrid_alignment::DepthPixel;
use monogrid_depth::{DepthConfig, DepthMap, FoundDepth, ObserveStats, PixelFilter, StereoFrame};
use monogrid_geometry::Se3;
use rayon::prelude::*;

/// Points that must remain after the limit on their standard deviation; below, the limit is
/// doubled until there are.
const MIN_REFERENCE_POINTS: usize = 1500;

/// Rows per band: fixed, so that the result does not depend on the number of threads.
const BAND_ROWS: usize = 16;

/// Observes the keyframe's pixels in the given frames.
pub(crate) fn observe(
    depth: &mut DepthMap,
    frames: &[StereoFrame<'_>],
    config: &DepthConfig,
) -> ObserveStats {
    let per_band: Vec<ObserveStats> = depth
        .bands(BAND_ROWS)
        .into_par_iter()
        .map(|mut band| {
            fault::pass("pool");
            band.observe(frames, config)
        })
        .collect();
    let mut stats = ObserveStats::default();
    for band in &per_band {
        stats.merge(band);
    }
    depth.finish_observation(&stats);
    stats
}

/// The depth of a keyframe as seen from the next one, which `make_next` makes without any depth.
pub(crate) fn propagate(
    depth: &DepthMap,
    make_next: impl FnOnce() -> Option<DepthMap> + Send,
    next_from_keyframe: &Se3,
    config: &DepthConfig,
) -> Option<DepthMap> {
    let (next, warped) = rayon::join(make_next, || depth.warped(next_from_keyframe));
    let mut next = next?;
    let num_bands = next.host().height().div_ceil(BAND_ROWS);
    let rows: Vec<Vec<FoundDepth>> = (0..num_bands)
        .into_par_iter()
        .map(|band| warped.merged(&next, band * BAND_ROWS..(band + 1) * BAND_ROWS, config))
        .collect();
    next.take_over(&warped, &rows, config);
    Some(next)
}

/// Fills holes, smooths, and drops what its neighbourhood does not support.
pub(crate) fn regularize(depth: &mut DepthMap, config: &DepthConfig) {
    let num_bands = depth.host().height().div_ceil(BAND_ROWS);
    let holes: Vec<Vec<FoundDepth>> = (0..num_bands)
        .into_par_iter()
        .map(|band| depth.holes(band * BAND_ROWS..(band + 1) * BAND_ROWS, config))
        .collect();
    for found in &holes {
        depth.fill(found);
    }
    depth
        .regularize_bands(BAND_ROWS)
        .into_par_iter()
        .for_each(|mut band| {
            band.regularize(config);
        });
    depth.remove_unsupported(config);
}

/// Points for tracking: hypotheses with at most the configured relative sigma; the limit doubles
/// until enough remain or all are taken.
pub(crate) fn tracking_samples(depth: &DepthMap, config: &TrackingConfig) -> Vec<DepthPixel> {
    let filter = PixelFilter {
        min_validity: config.min_validity,
        smoothed: true,
        ..PixelFilter::default()
    };
    let mut samples: Vec<DepthPixel> = Vec::with_capacity(depth.num_candidates());
    // from within: to be asked for one after the other costs more than to be told of all
    depth.pixels(filter).for_each(|p| samples.push(p));
    let enough = MIN_REFERENCE_POINTS.min(samples.len());
    let mut limit = config.max_relative_sigma;
    while limit <= 4.0 {
        let is_kept = |p: &DepthPixel| p.idepth_var <= (limit * p.idepth).powi(2);
        if samples.iter().filter(|p| is_kept(p)).count() >= enough {
            samples.retain(is_kept);
            break;
        }
        limit *= 2.0;
    }
    // those of a keyframe are kept as long as it
    samples.shrink_to_fit();
    samples
}
