//! Recognises earlier frames of a recording and compares with the true poses.
//!
//! `cargo run --release -p monogrid-features --example places -- FOLDER [step]`
//! where FOLDER has the TUM layout. Every `step`-th frame is a place.
#![allow(clippy::print_stdout, reason = "a program for people")]

use monogrid_features::{
    Descriptor, Feature, FeatureConfig, FeatureExtractor, Match, PlaceConfig, PlaceIndex,
    TwoViewConfig, TwoViewOutcome, two_view,
};
use monogrid_geometry::nalgebra::Quaternion;
use monogrid_geometry::{Pinhole, Rotation, Se3, Vec3};
use monogrid_image::{GrayImage, Pyramid};
use std::path::{Path, PathBuf};
use std::time::Instant;

type Failure = Box<dyn std::error::Error>;

fn rows(path: &Path) -> Result<Vec<Vec<String>>, Failure> {
    let text = std::fs::read_to_string(path)?;
    let kept = text
        .lines()
        .filter(|l| !l.starts_with('#') && !l.is_empty());
    Ok(kept
        .map(|l| l.split_whitespace().map(str::to_owned).collect())
        .collect())
}

fn numbers(row: &[String]) -> Vec<f64> {
    row.iter().filter_map(|word| word.parse().ok()).collect()
}

fn pyramid(path: &Path) -> Result<Pyramid, Failure> {
    let gray = image::load_from_memory(&std::fs::read(path)?)?.to_luma32f();
    let (w, h) = (gray.width() as usize, gray.height() as usize);
    let values = gray.into_raw().into_iter().map(|v| v * 255.0).collect();
    Ok(Pyramid::new(
        GrayImage::from_vec(w, h, values).ok_or("image size")?,
        4,
    ))
}

fn main() -> Result<(), Failure> {
    let mut arguments = std::env::args().skip(1);
    let folder = PathBuf::from(arguments.next().ok_or("which folder?")?);
    let step: usize = arguments.next().map_or(Ok(12), |s| s.parse())?;
    let images = rows(&folder.join("rgb.txt"))?;
    let v = numbers(&rows(&folder.join("calibration.txt"))?[0]);
    let pinhole = Pinhole::new(v[0], v[1], v[2], v[3]);
    let poses: Vec<Se3> = rows(&folder.join("groundtruth.txt"))?
        .iter()
        .map(|row| {
            let v = numbers(row);
            let rotation = Rotation::from_quaternion(Quaternion::new(v[7], v[4], v[5], v[6]));
            Se3::new(rotation, Vec3::new(v[1], v[2], v[3]))
        })
        .collect();
    let extractor = FeatureExtractor::new(FeatureConfig::default());
    let mut index = PlaceIndex::new();
    let mut stored: Vec<Vec<Feature>> = Vec::new();
    let (mut extract_ms, mut query_ms) = (0.0, 0.0);
    for (place, frame) in (0..images.len()).step_by(step).enumerate() {
        let pyramid = pyramid(&folder.join(&images[frame][1]))?;
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
            let verdict = match two_view(&matches, &pinhole, &config) {
                TwoViewOutcome::Accepted(best) => format!("motion, {} inliers", best.num_inliers),
                TwoViewOutcome::Ambiguous { candidates } => {
                    format!("ambiguous, {} inliers", candidates[0].num_inliers)
                }
                other => format!("{other:?}"),
            };
            let truth = poses[frame].inverse() * poses[other * step];
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
    Ok(())
}
