//! Recognises earlier frames of a recording and compares with the true poses.
//!
//! `cargo run --release -p monogrid-features --example places -- FOLDER [step]`
//! where FOLDER has the TUM layout. Every `step`-th frame is a place.
#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a tool for development, read from top to bottom"
)]

mod bench;

use bench::Sequence;
use monogrid_features::{
    Descriptor, Feature, FeatureConfig, FeatureExtractor, Match, PlaceConfig, PlaceIndex,
    TwoViewConfig, TwoViewOutcome, two_view,
};
use monogrid_geometry::Se3;
use std::time::Instant;

fn main() {
    let mut arguments = std::env::args().skip(1);
    let sequence = Sequence::open(arguments.next().unwrap());
    let step: usize = arguments.next().map_or(12, |s| s.parse().unwrap());
    let pinhole = sequence.undistorter.pinhole();
    let num_frames = sequence.dataset.frames.len();
    let poses: Vec<Option<Se3>> = (0..num_frames).map(|f| sequence.true_pose(f)).collect();
    let extractor = FeatureExtractor::new(FeatureConfig::default());
    let mut index = PlaceIndex::new();
    let mut stored: Vec<Vec<Feature>> = Vec::new();
    let (mut extract_ms, mut query_ms) = (0.0, 0.0);
    for (place, frame) in (0..num_frames).step_by(step).enumerate() {
        let pyramid = sequence.pyramid(frame);
        let begun = Instant::now();
        let features = extractor.extract(&pyramid, None);
        extract_ms += begun.elapsed().as_secs_f64() * 1e3;
        let descriptors: Vec<Descriptor> = features.iter().map(|f| f.descriptor).collect();
        let begun = Instant::now();
        let recent = place.saturating_sub(5) as u64;
        let found = index.query(&descriptors, &PlaceConfig::default(), |p| p < recent);
        query_ms += begun.elapsed().as_secs_f64() * 1e3;
        for candidate in found.iter().take(2) {
            let other = candidate.place as usize;
            let matches: Vec<Match> = candidate
                .matches
                .iter()
                .map(|m| Match {
                    a: stored[other][m.b_idx].pixel,
                    b: features[m.a_idx].pixel,
                })
                .collect();
            let config = TwoViewConfig {
                min_matches: 10,
                min_inlier_ratio: 0.25,
                sigma_px: 2.0,
                ..TwoViewConfig::default()
            };
            let verdict = match two_view(&matches, pinhole, &config) {
                TwoViewOutcome::Accepted(best) => format!("motion, {} inliers", best.num_inliers),
                TwoViewOutcome::Ambiguous { candidates } => {
                    format!("ambiguous, {} inliers", candidates[0].num_inliers)
                }
                other => format!("{other:?}"),
            };
            let (Some(here), Some(there)) = (poses[frame], poses[other * step]) else {
                continue;
            };
            let truth = here.inverse() * there;
            println!(
                "frame {frame} like {}: {} matches, score {:.0}; truly {:.2} m, {:.0} deg away; {verdict}",
                other * step,
                candidate.matches.len(),
                candidate.score,
                truth.translation.norm(),
                truth.rotation.angle().to_degrees(),
            );
        }
        index.add(place as u64, &descriptors);
        stored.push(features);
    }
    let num = stored.len() as f64;
    println!(
        "{} places, {:.1} ms to extract, {:.1} ms to query",
        stored.len(),
        extract_ms / num,
        query_ms / num
    );
}
