//! Loss and return: frames are covered for one or five seconds, or the video jumps to another part.
//!
//! `cargo run --release -p monogrid-studies --example kidnap -- FOLDER [cases] [frames before the
//! loss]`
//!
//! Each case prints whether the camera was found again, after how many frames of video, and the
//! largest error of a pose that was reported afterwards (aligned on the frames before the loss). A
//! place counts as known when a frame before the loss was within 0.4 m and 25 degrees of the first
//! one after it.
#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a tool for development, read from top to bottom"
)]

use monogrid_geometry::{Rotation, Se3, Vec3, align_similarity};
use monogrid_image::GrayImage;
use monogrid_slam::{FrameInput, SlamConfig};
use monogrid_studies::Sequence;

/// What happens at the loss.
#[derive(Debug)]
enum Case {
    /// The lens is covered for this many frames.
    Covered(usize),
    /// The video goes on at this frame.
    Jump(usize),
}

/// Frames that are tracked after the return.
const AFTER: usize = 75;

fn next(state: &mut u64, below: usize) -> usize {
    *state = state
        .wrapping_mul(6_364_136_223_846_793_005)
        .wrapping_add(1_442_695_040_888_963_407);
    ((*state >> 33) as usize) % below.max(1)
}

/// The sequence of which all videos are made.
struct Scene(Sequence);

/// A pose as reported: position in the video, frame of the sequence, pose.
type Reported = (usize, usize, Se3);

/// What became of a case.
struct CaseResult {
    is_known: bool,
    found_after: Option<usize>,
    worst_m: f64,
    worst_deg: f64,
    relocalisations: usize,
}

impl Scene {
    /// Whether a frame before the loss looked at what `frame` looks at.
    fn is_known(&self, loss: usize, frame: usize) -> bool {
        let after = self.0.true_pose(frame);
        (0..loss).any(|i| {
            let relative = self.0.true_pose(i).inverse() * after;
            relative.translation.norm() < 0.4 && relative.rotation.angle().to_degrees() < 25.0
        })
    }

    fn run(&self, case: &Case, loss: usize, seed: u64) -> CaseResult {
        let len = self.0.dataset.frames.len();
        let (first_after, num_covered) = match *case {
            Case::Covered(frames) => (loss + frames, frames),
            Case::Jump(to) => (to, 0),
        };
        let before = (0..loss).map(|i| (i, false));
        let covered = (loss..loss + num_covered).map(|i| (i, true));
        let after = (first_after..(first_after + AFTER).min(len)).map(|i| (i, false));
        let (width, height) = self.0.undistorter.size();
        let mut slam = self.0.system(SlamConfig::default(), seed);
        let mut poses: Vec<Reported> = Vec::new();
        let mut found_after = None;
        for (k, (frame, is_covered)) in before.chain(covered).chain(after).enumerate() {
            let report = slam.process_frame(FrameInput {
                index: k,
                timestamp_ns: k as i64 * 33_333_333,
                image: if is_covered {
                    GrayImage::filled(width, height, 3.0)
                } else {
                    self.0.image(frame)
                },
                depth: None,
            });
            if let Some(pose) = report.world_from_camera {
                poses.push((k, frame, pose));
                if k >= loss + num_covered && found_after.is_none() {
                    found_after = Some(k - loss - num_covered);
                }
            }
        }
        let (worst_m, worst_deg) = self.worst_errors(&poses, loss);
        CaseResult {
            is_known: self.is_known(loss, first_after.min(len - 1)),
            found_after,
            worst_m,
            worst_deg,
            relocalisations: slam.counts().relocalisations,
        }
    }

    /// Largest errors of position (m) and rotation (degrees) after the loss, with the alignment of
    /// the frames before it: positions for the similarity, the mean of all rotations for the
    /// rotation, because positions determine that less well.
    fn worst_errors(&self, poses: &[Reported], loss: usize) -> (f64, f64) {
        let prior: Vec<&Reported> = poses.iter().filter(|p| p.0 < loss).collect();
        let estimate: Vec<Vec3> = prior.iter().map(|p| p.2.translation).collect();
        let truth: Vec<Vec3> = prior
            .iter()
            .map(|p| self.0.true_pose(p.1).translation)
            .collect();
        let true_from_estimated = align_similarity(&estimate, &truth, true)
            .unwrap()
            .target_from_source;
        let offsets: Vec<Rotation> = prior
            .iter()
            .map(|p| self.0.true_pose(p.1).rotation * p.2.rotation.inverse())
            .collect();
        let first = offsets[0];
        let turns = offsets.iter().map(|o| (first.inverse() * *o).scaled_axis());
        let turn = first * Rotation::new(turns.sum::<Vec3>() / offsets.len() as f64);
        let errors = poses
            .iter()
            .filter(|p| p.0 >= loss)
            .map(|(_, frame, pose)| {
                let truth = self.0.true_pose(*frame);
                let position = true_from_estimated * pose.translation - truth.translation;
                let rotation = (turn * pose.rotation).inverse() * truth.rotation;
                (position.norm(), rotation.angle().to_degrees())
            });
        errors.fold((0.0, 0.0), |worst, error| {
            (worst.0.max(error.0), worst.1.max(error.1))
        })
    }
}

fn main() {
    let mut args = std::env::args().skip(1);
    let scene = Scene(Sequence::open(args.next().unwrap()));
    let cases: usize = args.next().map_or(20, |n| n.parse().unwrap());
    let before: usize = args.next().map_or(250, |n| n.parse().unwrap());
    let len = scene.0.dataset.frames.len();
    let (mut known_cases, mut in_time, mut wrong) = (0, 0, 0);
    for seed in 0..cases {
        let mut random = seed as u64 + 77;
        for _ in 0..4 {
            next(&mut random, 2);
        }
        let loss = before + next(&mut random, (len - AFTER - 160).saturating_sub(before));
        let case = match seed % 3 {
            0 => Case::Covered(30),
            1 => Case::Covered(150),
            _ => Case::Jump(next(&mut random, loss.saturating_sub(60).max(1))),
        };
        let result = scene.run(&case, loss, seed as u64);
        known_cases += usize::from(result.is_known);
        in_time += usize::from(result.is_known && result.found_after.is_some_and(|n| n <= 30));
        wrong += usize::from(result.worst_m > 0.2 || result.worst_deg > 5.0);
        println!(
            "{seed:2} loss at {loss} {case:?}: known {}, found after {:?} frames, worst {:.3} m \
             {:.2} deg, relocalised {} times",
            result.is_known,
            result.found_after,
            result.worst_m,
            result.worst_deg,
            result.relocalisations
        );
    }
    println!(
        "known places {known_cases}, found within a second {in_time}; cases with a wrong pose \
         {wrong} of {cases}"
    );
}
