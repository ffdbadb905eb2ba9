//! The depth filter in parallel over fixed bands of rows.

use crate::TrackingConfig;
use monogrid_alignment::DepthSample;
use monogrid_depth::{DepthConfig, DepthMap, FilledHole, ObserveStats, PixelFilter, StereoFrame};
use rayon::prelude::*;

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
        .map(|mut band| band.observe(frames, config))
        .collect();
    let mut stats = ObserveStats::default();
    for band in &per_band {
        stats.merge(band);
    }
    depth.finish_observation(&stats);
    stats
}

/// Fills holes, smooths, and drops what its neighbourhood does not support.
pub(crate) fn regularize(depth: &mut DepthMap, config: &DepthConfig) {
    let num_bands = depth.host().height().div_ceil(BAND_ROWS);
    let holes: Vec<Vec<FilledHole>> = (0..num_bands)
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
pub(crate) fn tracking_samples(depth: &DepthMap, config: &TrackingConfig) -> Vec<DepthSample> {
    let filter = PixelFilter {
        min_validity: config.min_validity,
        smoothed: config.smoothed_depth,
        ..PixelFilter::default()
    };
    let all: Vec<DepthSample> = depth
        .pixels(filter)
        .map(|p| DepthSample {
            x: p.x,
            y: p.y,
            idepth: p.idepth,
            idepth_var: p.idepth_var,
        })
        .collect();
    let mut limit = config.max_relative_sigma;
    loop {
        let kept: Vec<DepthSample> = all
            .iter()
            .filter(|p| p.idepth_var <= (limit * p.idepth).powi(2))
            .copied()
            .collect();
        if kept.len() >= config.min_reference_points.min(all.len()) || limit > 4.0 {
            let mut chosen = if limit > 4.0 { all } else { kept };
            // kept as long as the keyframe
            chosen.shrink_to_fit();
            return chosen;
        }
        limit *= 2.0;
    }
}
