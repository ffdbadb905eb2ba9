//! Precision and recall of the memory of places and of FAB-MAP, by appearance alone.
//!
//! `cargo run --release -p monogrid-features --example place_recognition -- FOLDER [name=value ...]`
//!
//! | option | meaning | default |
//! |---|---|---|
//! | `step` | frames per keyframe | 10 |
//! | `gap` | keyframes less than this many frames away are not asked for | 100 |
//! | `depth` | depth of the scene where there are no depth images, units of the true poses | 2 |
//! | `vocabulary` | file for FAB-MAP | the built-in one |
//! | `p_seen`, `p_phantom` | detector of FAB-MAP | as in the library |
//! | `mean_field` | 1: the mean of all places instead of samples | 0 |
//!
//! Every keyframe asks for the most alike of the older ones. The answer is right when at least 10 % of the
//! pixels of one image are seen in the other (rays to the true depth, checked against the true depth there);
//! a place is known when some older keyframe shares 40 %. Recall: known places with a right answer.
#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a tool for development, read from top to bottom"
)]

mod bench;

use bench::{Options, Sequence, seconds_of_work};
use monogrid_features::{
    Descriptor, FabMap, FabMapConfig, FeatureConfig, FeatureExtractor, PlaceConfig, PlaceIndex,
    PlaceVocabulary,
};
use monogrid_geometry::{Pinhole, Se3, Vec2};
use monogrid_image::GrayImage;
use std::sync::Arc;

/// A keyframe with all that the truth needs.
struct Key {
    frame: usize,
    world_from_camera: Se3,
    depth: Option<GrayImage>,
    descriptors: Vec<Descriptor>,
}

/// Share of the pixels of `a` that `b` sees.
fn seen(a: &Key, b: &Key, pinhole: &Pinhole, size: (usize, usize), usual_depth: f64) -> f64 {
    let b_from_a = b.world_from_camera.inverse() * a.world_from_camera;
    let (mut num, mut num_seen) = (0usize, 0usize);
    for y in (8..size.1).step_by(16) {
        for x in (8..size.0).step_by(16) {
            let known = a.depth.as_ref().map(|d| f64::from(d.at(x, y)));
            let z = known.unwrap_or(usual_depth);
            if !(z.is_finite() && z > 0.0) {
                continue;
            }
            num += 1;
            let point = b_from_a * (pinhole.unproject(&Vec2::new(x as f64, y as f64)) * z);
            if point.z <= 0.0 {
                continue;
            }
            let pixel = pinhole.project(&point);
            let inside = pixel.x >= 0.0
                && pixel.y >= 0.0
                && pixel.x < (size.0 - 1) as f64
                && pixel.y < (size.1 - 1) as f64;
            if !inside {
                continue;
            }
            let there = b.depth.as_ref().map_or(point.z, |d| {
                f64::from(d.at(pixel.x.round() as usize, pixel.y.round() as usize))
            });
            num_seen += usize::from((there - point.z).abs() < 0.1 * point.z);
        }
    }
    num_seen as f64 / num.max(1) as f64
}

/// The best answer to a query.
struct Answer {
    score: f64,
    is_right: bool,
    is_known: bool,
}

/// Points of the curve: highest recall at each of some precisions, and the curve by rank.
fn print_curve(name: &str, mut answers: Vec<Answer>, num_known: usize) {
    answers.sort_by(|a, b| b.score.total_cmp(&a.score));
    let (mut right, mut recalled) = (0usize, 0usize);
    let mut curve: Vec<(f64, f64, f64)> = Vec::new();
    for (i, answer) in answers.iter().enumerate() {
        right += usize::from(answer.is_right);
        recalled += usize::from(answer.is_right && answer.is_known);
        // answers with equal scores cannot be told apart
        if answers
            .get(i + 1)
            .is_none_or(|next| next.score < answer.score)
        {
            let precision = right as f64 / (i + 1) as f64;
            let recall = recalled as f64 / num_known.max(1) as f64;
            curve.push((precision, recall, answer.score));
        }
    }
    println!(
        "{name}: {} answers, {num_known} known places",
        answers.len()
    );
    for wanted in [1.0, 0.99, 0.95, 0.9, 0.8] {
        let best = curve
            .iter()
            .filter(|point| point.0 >= wanted)
            .max_by(|a, b| a.1.total_cmp(&b.1));
        match best {
            Some((_, recall, score)) => {
                println!("  precision {wanted:.2}: recall {recall:.3} (score {score:.1})");
            }
            None => println!("  precision {wanted:.2}: never"),
        }
    }
    if let Some((precision, recall, _)) = curve.last() {
        println!("  all answers: precision {precision:.3}, recall {recall:.3}");
    }
    let every = curve.len().div_ceil(12).max(1);
    let points = curve.iter().step_by(every);
    let text: Vec<String> = points
        .map(|(p, r, _)| format!("({r:.2}, {p:.3})"))
        .collect();
    println!("  curve (recall, precision): {}", text.join(" "));
}

fn keys(sequence: &Sequence, step: usize) -> Vec<Key> {
    let extractor = FeatureExtractor::new(FeatureConfig::default());
    let mut keys = Vec::new();
    for frame in (0..sequence.dataset.frames.len()).step_by(step) {
        let Some(world_from_camera) = sequence.true_pose(frame) else {
            continue;
        };
        let features = extractor.extract(&sequence.pyramid(frame), None);
        keys.push(Key {
            frame,
            world_from_camera,
            depth: sequence.true_depth(frame),
            descriptors: features.iter().map(|f| f.descriptor).collect(),
        });
    }
    keys
}

fn main() {
    let mut args = std::env::args().skip(1);
    let folder = args.next().unwrap();
    let options = Options::read(args);
    let vocabulary = options.0.get("vocabulary").map_or_else(
        || PlaceVocabulary::built_in().unwrap(),
        |path| PlaceVocabulary::from_bytes(&std::fs::read(path).unwrap()).unwrap(),
    );
    let usual = FabMapConfig::default();
    let config = FabMapConfig {
        p_seen: options.number("p_seen", usual.p_seen),
        p_phantom: options.number("p_phantom", usual.p_phantom),
        is_mean_field: options.number("mean_field", 0.0) > 0.0,
        ..usual
    };
    let sequence = Sequence::open(&folder);
    let keys = keys(&sequence, options.number("step", 10));
    let (gap, usual_depth) = (options.number("gap", 100), options.number("depth", 2.0));
    let overlap = |a: &Key, b: &Key| {
        let undistorter = &sequence.undistorter;
        let (pinhole, size) = (undistorter.pinhole(), undistorter.size());
        seen(a, b, pinhole, size, usual_depth).max(seen(b, a, pinhole, size, usual_depth))
    };
    let mut index = PlaceIndex::new();
    let mut map = FabMap::new(Arc::new(vocabulary), config);
    let (mut of_index, mut of_map) = (Vec::new(), Vec::new());
    let (mut num_known, mut index_seconds, mut map_seconds) = (0, 0.0, 0.0);
    for (id, key) in keys.iter().enumerate() {
        let is_old = |other: u64| key.frame >= keys[other as usize].frame + gap;
        let older = keys.iter().filter(|other| key.frame >= other.frame + gap);
        let overlaps: Vec<f64> = older.map(|other| overlap(key, other)).collect();
        let is_known = overlaps.iter().any(|share| *share >= 0.4);
        num_known += usize::from(is_known);
        let answer = |place: u64, score: f64| Answer {
            score,
            is_right: overlaps[place as usize] >= 0.1,
            is_known,
        };
        let begun = seconds_of_work();
        let found = index.query(&key.descriptors, &PlaceConfig::default(), is_old);
        index_seconds += seconds_of_work() - begun;
        // the sum of rarities ranks within a query; between queries the number of matches compares
        let best = found.first();
        of_index.extend(best.map(|c| answer(c.place, c.matches.len() as f64)));
        let begun = seconds_of_work();
        let beliefs = map.query(&key.descriptors, is_old);
        map_seconds += seconds_of_work() - begun;
        let best = beliefs.places.first();
        of_map.extend(best.map(|b| answer(b.place, b.ln_ratio)));
        index.add(id as u64, &key.descriptors);
        map.add(id as u64, &key.descriptors);
    }
    println!(
        "{folder}: {} keyframes, query {:.1} ms (memory), {:.1} ms (FAB-MAP); {} and {} bytes per place",
        keys.len(),
        1e3 * index_seconds / keys.len().max(1) as f64,
        1e3 * map_seconds / keys.len().max(1) as f64,
        index.bytes_of_places() / keys.len().max(1),
        map.bytes_of_places() / keys.len().max(1)
    );
    let accepted = of_map.iter().filter(|a: &&Answer| a.score > 0.0);
    let (mut num, mut right) = (0, 0);
    for answer in accepted {
        num += 1;
        right += usize::from(answer.is_right);
    }
    println!("FAB-MAP believes {num} to be more probable than a new place, {right} rightly");
    print_curve("memory", of_index, num_known);
    print_curve("FAB-MAP", of_map, num_known);
}
