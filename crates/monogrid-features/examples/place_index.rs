//! How well are places found again among a million descriptors?
//!
//! ```text
//! cargo run --release -p monogrid-features --example place_index -- RECORDING FOLDER...
//! ```
//!
//! RECORDING (`recording.mgk` of a run) has the keyframes that are looked for: each is asked for
//! with itself and its neighbours in time excluded. Two keyframes show the same place where each
//! shows at least 30 % of the depth of the other, by their final poses. The images of the folders
//! are of other places: as many as are needed are described as keyframes are and put into the
//! index, once before the keyframes and once behind them, since a list of the index is followed
//! from its newest entry. Printed are, of keyframes that have a revisit, how many find one first,
//! and among the candidates; candidates per query that are of other places; the median time of a
//! query on a processor (Linux); and memory.
#![allow(clippy::print_stdout, reason = "this is a program")]

use monogrid_datasets::{
    Dataset, ReadOptions, RecordedKeyframe, Recording, SourceOptions, read_gray,
};
use monogrid_features::{Descriptor, FeatureConfig, FeatureExtractor, PlaceConfig, PlaceIndex};
use monogrid_geometry::{Sim3, Vec2};
use monogrid_image::{GrayImage, Pyramid};
use std::collections::BTreeSet;
use std::error::Error;
use std::path::Path;

/// Descriptors of other places that are put into the index.
const DISTRACTORS: [usize; 4] = [0, 10_000, 100_000, 1_000_000];
/// Keyframes before and after the one that is looked for that do not count as revisits, and are not
/// looked at.
const NEIGHBOURS: u32 = 3;
/// Share of the depth of one keyframe that another one shows, at which both show the same place.
const MIN_OVERLAP: f64 = 0.3;
/// Every so many depths are looked at for that.
const STRIDE: usize = 20;
/// First identity of images of other places.
const FIRST_OTHER: u64 = 1 << 32;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let recording = arguments.next().ok_or("expected RECORDING FOLDER...")?;
    let recording = Recording::read(Path::new(&recording), ReadOptions::default())?;
    let keyframes: Vec<Place> = recording.keyframes.iter().filter_map(Place::of).collect();
    let mut others = Vec::new();
    let mut total = 0;
    for folder in arguments {
        let dataset = Dataset::open(Path::new(&folder), SourceOptions::default())?;
        for frame in &dataset.frames {
            if total < DISTRACTORS[DISTRACTORS.len() - 1] {
                let descriptors = described(&read_gray(&frame.path)?);
                total += descriptors.len();
                others.push(descriptors);
            }
        }
    }
    let own: usize = keyframes.iter().map(|k| k.descriptors.len()).sum();
    println!(
        "{} keyframes with {own} descriptors; {} images of other places with {total}",
        keyframes.len(),
        others.len()
    );
    println!(
        "\n| other descriptors | keyframes are | with a revisit | found first | found | candidates \
         of other places per query | ms per query, CPU | bytes per descriptor |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    for wanted in DISTRACTORS {
        let mut held = 0;
        let count = others.iter().take_while(|other| {
            held += other.len();
            held <= wanted
        });
        let count = count.count();
        for is_oldest in [true, false] {
            let index = filled(&keyframes, &others[..count], is_oldest);
            report(&keyframes, &others[..count], &index, is_oldest);
        }
    }
    Ok(())
}

/// A keyframe as a place.
struct Place {
    keyframe: RecordedKeyframe,
    world_from_keyframe: Sim3,
    descriptors: Vec<Descriptor>,
}

impl Place {
    fn of(keyframe: &RecordedKeyframe) -> Option<Self> {
        let image = keyframe.image.as_ref()?;
        Some(Self {
            world_from_keyframe: keyframe.world_from_keyframe?,
            descriptors: described(&image.map(f32::from)),
            keyframe: keyframe.clone(),
        })
    }

    /// Share of the depth of this keyframe that another one shows.
    fn shown_by(&self, other: &Self) -> f64 {
        let other_from_self = other.world_from_keyframe.inverse() * self.world_from_keyframe;
        let camera = other.keyframe.camera;
        let pixels = self.keyframe.pixels.iter().step_by(STRIDE);
        let is_shown = |pixel: &&monogrid_datasets::DepthPixel| {
            let own = Vec2::new(pixel.x.into(), pixel.y.into());
            let ray = self.keyframe.camera.pinhole.unproject(&own);
            let point = other_from_self * (ray / f64::from(pixel.idepth));
            let seen = camera.pinhole.project(&point);
            let is_inside = (0.0..camera.width as f64).contains(&seen.x)
                && (0.0..camera.height as f64).contains(&seen.y);
            point.z > 0.0 && is_inside
        };
        let count = pixels.clone().count();
        pixels.filter(is_shown).count() as f64 / count.max(1) as f64
    }

    fn is_neighbour(&self, other: &Self) -> bool {
        self.keyframe.id.abs_diff(other.keyframe.id) <= NEIGHBOURS
    }

    fn is_revisited_by(&self, other: &Self) -> bool {
        !self.is_neighbour(other) && self.shown_by(other).min(other.shown_by(self)) >= MIN_OVERLAP
    }
}

/// The descriptors of an image as a keyframe has them.
fn described(image: &GrayImage) -> Vec<Descriptor> {
    let config = FeatureConfig::default();
    let pyramid = Pyramid::new(image.clone(), config.num_levels);
    let features = FeatureExtractor::new(config).extract(&pyramid, None);
    features.iter().map(|feature| feature.descriptor).collect()
}

fn filled(keyframes: &[Place], others: &[Vec<Descriptor>], keyframes_first: bool) -> PlaceIndex {
    let own = keyframes.iter();
    let own = own.map(|place| (u64::from(place.keyframe.id), &place.descriptors));
    let others = (FIRST_OTHER..).zip(others);
    let places: Vec<(u64, &Vec<Descriptor>)> = if keyframes_first {
        own.chain(others).collect()
    } else {
        others.chain(own).collect()
    };
    let mut index = PlaceIndex::new();
    for (id, descriptors) in places {
        index.add(id, descriptors);
    }
    index
}

/// Time that this thread has had a processor, nanoseconds; 0 where the system does not say it.
fn on_processor_ns() -> u64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    let first = text.split_whitespace().next();
    first.and_then(|text| text.parse().ok()).unwrap_or(0)
}

fn report(keyframes: &[Place], others: &[Vec<Descriptor>], index: &PlaceIndex, is_oldest: bool) {
    let config = PlaceConfig::default();
    let (mut revisited, mut first, mut found, mut wrong) = (0, 0, 0, 0);
    let mut milliseconds = Vec::new();
    for place in keyframes {
        let ids = |of: &dyn Fn(&Place) -> bool| -> BTreeSet<u64> {
            let those = keyframes.iter().filter(|other| of(other));
            those.map(|other| u64::from(other.keyframe.id)).collect()
        };
        let revisits = ids(&|other| place.is_revisited_by(other));
        let neighbours = ids(&|other| place.is_neighbour(other));
        let begin = on_processor_ns();
        let candidates = index.query(&place.descriptors, &config, |id| !neighbours.contains(&id));
        milliseconds.push((on_processor_ns() - begin) as f64 * 1e-6);
        let is_right = |at: usize| {
            candidates
                .get(at)
                .is_some_and(|c| revisits.contains(&c.place))
        };
        revisited += usize::from(!revisits.is_empty());
        first += usize::from(is_right(0));
        found += usize::from((0..candidates.len()).any(is_right));
        wrong += candidates.iter().filter(|c| c.place >= FIRST_OTHER).count();
    }
    milliseconds.sort_by(f64::total_cmp);
    let total: usize = others.iter().map(Vec::len).sum();
    let all = keyframes.len().max(1);
    println!(
        "| {total} | {} | {revisited} of {all} | {first} | {found} | {:.2} | {:.1} | {:.0} |",
        if is_oldest { "oldest" } else { "newest" },
        wrong as f64 / all as f64,
        milliseconds[milliseconds.len() / 2],
        index.bytes() as f64
            / (total + keyframes.iter().map(|k| k.descriptors.len()).sum::<usize>()).max(1) as f64,
    );
}
