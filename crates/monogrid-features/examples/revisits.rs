//! Relocalisation and loops against the truth, for sequences with depth images and true poses.
//!
//! `cargo run --release -p monogrid-features --example revisits -- FOLDER [name=value ...]`
//!
//! | option | meaning | default |
//! |---|---|---|
//! | `step` | frames per keyframe | 10 |
//! | `gap` | a frame is not compared with keyframes less than this many frames away | 30 |
//! | `skip` | every how many frames one is relocalised | 7 |
//! | `jumps` | seeded jumps to another part of the sequence | 20 |
//! | `max_frames` | frames used | all |
//! | `verbose` | 1: prints every match | 0 |
//! | `inliers`, `agreement`, `loop_agreement`, `contradiction` | thresholds | as in the library |
//!
//! Keyframes get the true depth at pixels with a gradient, with 3 % of noise, 2 % of gross errors, and a
//! unit of their own (30 %). A pose is wrong beyond 20 cm or 5 degrees, a scale beyond 10 %.
#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a tool for development, read from top to bottom"
)]

mod bench;

use bench::{Options, Sequence, seconds_of_work};
use monogrid_features::{DepthLookup, InverseDepth, PlaceMemory, PlaceMemoryConfig, Rng};
use monogrid_geometry::{Se3, Sim3};
use monogrid_image::GrayImage;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Semi-dense depth as a depth filter would give it, in units of `unit` metres.
fn semi_dense(image: &GrayImage, depth: &GrayImage, unit: f64, seed: u64) -> DepthLookup {
    let mut rng = Rng::new(seed);
    let mut pixels = Vec::new();
    for y in 2..image.height() - 2 {
        for x in 2..image.width() - 2 {
            let dx = image.at(x + 1, y) - image.at(x - 1, y);
            let dy = image.at(x, y + 1) - image.at(x, y - 1);
            let z = depth.at(x, y);
            if dx.hypot(dy) > 10.0 && z.is_finite() && z > 0.0 {
                let mut noise = 1.0 + 0.03 * rng.normal();
                if rng.uniform() < 0.02 {
                    noise *= rng.normal().exp();
                }
                let idepth = (unit / f64::from(z) * noise.max(0.1)) as f32;
                let idepth_var = (0.03 * idepth).powi(2);
                let known = InverseDepth { idepth, idepth_var };
                pixels.push((x as u16, y as u16, known));
            }
        }
    }
    DepthLookup::new(image.width(), image.height(), pixels)
}

/// A keyframe and its unit in metres.
struct Key {
    frame: usize,
    unit: f64,
}

/// Outcome of comparing with the truth.
#[derive(Clone, Copy, Default)]
struct Tally {
    asked: usize,
    /// With an older place in view.
    possible: usize,
    found: usize,
    wrong: usize,
    seconds: f64,
    slowest: f64,
}

impl Tally {
    fn print(&self, what: &str) {
        println!(
            "{what}: {} asked, {} possible, {} found, {} wrong, {:.1} ms each, slowest {:.1} ms",
            self.asked,
            self.possible,
            self.found,
            self.wrong,
            1e3 * self.seconds / self.asked.max(1) as f64,
            1e3 * self.slowest
        );
    }

    fn time<T>(&mut self, step: impl FnOnce() -> T) -> T {
        let begun = seconds_of_work();
        let out = step();
        let seconds = seconds_of_work() - begun;
        self.asked += 1;
        self.seconds += seconds;
        self.slowest = self.slowest.max(seconds);
        out
    }
}

struct Bench {
    sequence: Sequence,
    poses: Vec<Option<Se3>>,
    keys: BTreeMap<u64, Key>,
    memory: PlaceMemory,
    gap: usize,
    is_verbose: bool,
}

impl Bench {
    /// Truth of two frames: a from b, metres.
    fn truth(&self, a: usize, b: usize) -> Option<Se3> {
        Some(self.poses[a]?.inverse() * self.poses[b]?)
    }

    fn is_far(&self, id: u64, frame: usize) -> bool {
        self.keys[&id].frame.abs_diff(frame) >= self.gap
    }

    /// Whether some allowed keyframe was taken near the frame: within 0.5 m and 25 degrees.
    fn is_possible(&self, frame: usize, is_allowed: impl Fn(u64) -> bool) -> bool {
        self.keys.iter().any(|(id, key)| {
            is_allowed(*id)
                && self.truth(frame, key.frame).is_some_and(|t| {
                    t.translation.norm() < 0.5 && t.rotation.angle().to_degrees() < 25.0
                })
        })
    }

    /// Distance in metres and degrees between a found pose and the truth; the translation is found in
    /// units of the keyframe.
    fn error(&self, frame: usize, id: u64, found: &Se3) -> (f64, f64) {
        let key = &self.keys[&id];
        let Some(truth) = self.truth(frame, key.frame) else {
            return (0.0, 0.0);
        };
        let mut metric = *found;
        metric.translation *= key.unit;
        let error = metric.inverse() * truth;
        (
            error.translation.norm(),
            error.rotation.angle().to_degrees(),
        )
    }

    fn relocalise_all(&self, skip: usize) {
        let mut tally = Tally::default();
        for frame in (0..self.poses.len()).step_by(skip) {
            if self.poses[frame].is_none() {
                continue;
            }
            let pyramid = self.sequence.pyramid(frame);
            let allowed = |id| self.is_far(id, frame);
            let found = tally.time(|| self.memory.relocalise(&pyramid, None, allowed));
            let is_possible = self.is_possible(frame, allowed);
            tally.possible += usize::from(is_possible);
            if let Some(best) = found.first() {
                tally.found += 1;
                let (metres, degrees) = self.error(frame, best.keyframe, &best.frame_from_keyframe);
                let is_wrong = metres > 0.2 || degrees > 5.0;
                tally.wrong += usize::from(is_wrong);
                if is_wrong || self.is_verbose {
                    println!(
                        "frame {frame} in keyframe of {}: {} inliers, {:?}, off by {metres:.3} m, {degrees:.2} deg",
                        self.keys[&best.keyframe].frame, best.num_inliers, best.support
                    );
                }
            } else if is_possible && self.is_verbose {
                println!("frame {frame} not found");
            }
        }
        tally.print("relocalisation");
    }

    fn loops(&self) {
        let mut tally = Tally::default();
        for (id, key) in &self.keys {
            let allowed = |other: u64| other < *id && self.is_far(other, key.frame);
            let found = tally.time(|| self.memory.find_loops(*id, allowed));
            tally.possible += usize::from(self.is_possible(key.frame, allowed));
            tally.found += usize::from(!found.is_empty());
            for m in &found {
                let other = &self.keys[&m.keyframe];
                let Sim3 {
                    scale,
                    rotation,
                    translation,
                } = m.this_from_other;
                let rigid = Se3::new(rotation, translation / scale);
                let (metres, degrees) = self.error(key.frame, m.keyframe, &rigid);
                let ratio = scale * key.unit / other.unit;
                let is_wrong = metres > 0.2 || degrees > 5.0 || ratio.ln().abs() > 0.1;
                tally.wrong += usize::from(is_wrong);
                if is_wrong || self.is_verbose {
                    println!(
                        "keyframe {} like {}: {} inliers, {:?}, {:?}, off by {metres:.3} m, {degrees:.2} deg, scale {ratio:.3}",
                        key.frame, other.frame, m.num_inliers, m.support, m.support_of_other
                    );
                }
            }
        }
        tally.print("loops");
    }

    /// After a jump only keyframes are known that lie `gap` frames away; one second to find a place.
    fn jumps(&self, count: u64) {
        let (mut possible, mut within_second, mut wrong, mut tries) = (0, 0, 0, 0);
        for seed in 0..count {
            let mut rng = Rng::new(seed);
            let first = rng.below(self.poses.len().saturating_sub(30).max(1));
            let window = first..(first + 30).min(self.poses.len());
            let allowed =
                |id: u64| self.is_far(id, window.start) && self.is_far(id, window.end - 1);
            possible += usize::from(window.clone().any(|f| self.is_possible(f, allowed)));
            for frame in window.clone() {
                tries += 1;
                let pyramid = self.sequence.pyramid(frame);
                if let Some(best) = self.memory.relocalise(&pyramid, None, allowed).first() {
                    let (metres, degrees) =
                        self.error(frame, best.keyframe, &best.frame_from_keyframe);
                    let is_wrong = metres > 0.2 || degrees > 5.0;
                    wrong += usize::from(is_wrong);
                    within_second += usize::from(!is_wrong);
                    println!(
                        "jump {seed} to frame {first}: after {} frames in keyframe of {}, off by {metres:.3} m, {degrees:.2} deg",
                        frame - first,
                        self.keys[&best.keyframe].frame
                    );
                    break;
                }
            }
        }
        println!(
            "jumps: {count}, place known in {possible}, found within a second {within_second}, wrong {wrong}, {tries} tries"
        );
    }
}

fn main() {
    let mut args = std::env::args().skip(1);
    let folder = args.next().unwrap();
    let options = Options::read(args);
    let usual = PlaceMemoryConfig::default();
    let config = PlaceMemoryConfig {
        min_inliers: options.number("inliers", usual.min_inliers),
        min_agreement: options.number("agreement", usual.min_agreement),
        min_loop_agreement: options.number("loop_agreement", usual.min_loop_agreement),
        max_contradiction: options.number("contradiction", usual.max_contradiction),
        ..usual
    };
    let sequence = Sequence::open(&folder);
    let pinhole = *sequence.undistorter.pinhole();
    let num_frames = sequence.dataset.frames.len();
    let num_frames = num_frames.min(options.number("max_frames", usize::MAX));
    let poses: Vec<Option<Se3>> = (0..num_frames).map(|f| sequence.true_pose(f)).collect();
    let mut bench = Bench {
        sequence,
        poses,
        keys: BTreeMap::new(),
        memory: PlaceMemory::new(pinhole, config),
        gap: options.number("gap", 30),
        is_verbose: options.number("verbose", 0) == 1,
    };
    let mut rng = Rng::new(1);
    for frame in (0..num_frames).step_by(options.number("step", 10)) {
        let Some(depth) = bench.sequence.true_depth(frame) else {
            continue;
        };
        let pyramid = Arc::new(bench.sequence.pyramid(frame));
        let unit = (0.3 * rng.normal()).exp();
        let lookup = semi_dense(pyramid.level(0), &depth, unit, frame as u64);
        let id = bench.keys.len() as u64;
        bench.keys.insert(id, Key { frame, unit });
        bench.memory.insert(id, &pyramid, None, &lookup);
    }
    println!("{} keyframes of {num_frames} frames", bench.keys.len());
    bench.relocalise_all(options.number("skip", 7));
    bench.loops();
    bench.jumps(options.number("jumps", 20) as u64);
}
