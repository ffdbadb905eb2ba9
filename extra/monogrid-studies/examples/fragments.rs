//! Fragments of the map: the video jumps to a part that was never seen, and comes back to the known
//! part.
//!
//! `cargo run --release -p monogrid-studies --example fragments -- FOLDER parts=0-300,900-200
//! [key=value …]`
//!
//! `parts` are played one after the other as one video; a part `900-200` is played backwards;
//! `covered=30` puts so many frames of a covered lens between two parts, `step=2` leaves out every
//! second frame. A part may come from another sequence (`0-300,OTHER:0-400` with `OTHER=FOLDER2`):
//! such a part must never be joined. `seed=I`, and settings as `fragments.min_lost_secs=2.0`;
//! `maps=1` prints every frame that changes its state.
//!
//! Printed are the fragments, and errors with the similarity that aligns the first part (rotations:
//! the mean of all differences in it, since positions determine that less well): of poses as they
//! were reported after the first part (what a robot would have believed), and of all final poses
//! after it.
#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a tool for development, read from top to bottom"
)]

use monogrid_geometry::{Rotation, Se3, Sim3, Vec3, align_similarity};
use monogrid_image::GrayImage;
use monogrid_slam::settings::SLAM;
use monogrid_slam::{FrameInput, Slam, SlamConfig, TrackingState};
use monogrid_studies::{Options, Sequence};
use std::path::Path;

/// A frame of the video: scene and frame, or a covered lens.
type Shown = Option<(usize, usize)>;

/// The video that `parts` describe, and where each part begins.
fn video(options: &Options, names: &[String]) -> (Vec<Shown>, Vec<usize>) {
    let (step, covered) = (options.number("step", 1), options.number("covered", 0));
    let (mut frames, mut begins) = (Vec::new(), Vec::new());
    for part in options.0["parts"].split(',') {
        let (scene, range) = match part.split_once(':') {
            Some((name, range)) => (1 + names.iter().position(|n| n == name).unwrap(), range),
            None => (0, part),
        };
        let (from, to) = range.split_once('-').unwrap();
        let (from, to): (usize, usize) = (from.parse().unwrap(), to.parse().unwrap());
        if !frames.is_empty() {
            frames.extend(std::iter::repeat_n(None, covered));
        }
        begins.push(frames.len());
        let indices: Vec<usize> = if from < to {
            (from..to).collect()
        } else {
            (to..from).rev().collect()
        };
        frames.extend(indices.into_iter().step_by(step).map(|k| Some((scene, k))));
    }
    (frames, begins)
}

/// Largest and root mean square error of positions (m), and largest of rotations (degrees).
#[derive(Default)]
struct Errors {
    count: usize,
    sum_sq: f64,
    largest_m: f64,
    largest_deg: f64,
}

impl Errors {
    fn add(&mut self, (fit, turn): &(Sim3, Rotation), pose: &Se3, truth: &Se3) {
        let position = (*fit * pose.translation - truth.translation).norm();
        let rotation = (*turn * pose.rotation).inverse() * truth.rotation;
        self.count += 1;
        self.sum_sq += position * position;
        self.largest_m = self.largest_m.max(position);
        self.largest_deg = self.largest_deg.max(rotation.angle().to_degrees());
    }

    fn print(&self, what: &str) {
        let rms = (self.sum_sq / self.count.max(1) as f64).sqrt();
        println!(
            "{what}: {} frames, rms {rms:.4} m, largest {:.4} m, {:.2} degrees",
            self.count, self.largest_m, self.largest_deg
        );
    }
}

/// Tracks the video: the poses as they were reported, and how many frames had which state.
fn play(
    slam: &mut Slam,
    scenes: &[Sequence],
    frames: &[Shown],
    print_states: bool,
) -> (Vec<(usize, Se3)>, [usize; 5]) {
    let (width, height) = scenes[0].undistorter.size();
    let mut reported: Vec<(usize, Se3)> = Vec::new();
    let mut counts = [0usize; 5];
    let mut last_state = None;
    for (k, shown) in frames.iter().enumerate() {
        let report = slam.process_frame(FrameInput {
            index: k,
            timestamp_ns: k as i64 * 33_333_333,
            image: match shown {
                Some((scene, frame)) => scenes[*scene].image(*frame),
                None => GrayImage::filled(width, height, 3.0),
            },
            depth: None,
        });
        counts[report.state as usize] += 1;
        if print_states && last_state != Some(report.state) {
            println!(
                "  {k} {shown:?}: {} {:?}",
                report.state.name(),
                report.reason
            );
        }
        last_state = Some(report.state);
        if let Some(id) = report.started_fragment {
            println!("frame {k}: fragment {id} started");
        }
        if report.relocalised {
            println!("frame {k}: recognised ({})", report.state.name());
        }
        for id in &report.joined_fragments {
            println!("frame {k}: fragment {id} joined");
        }
        reported.extend(report.world_from_camera.map(|pose| (k, pose)));
    }
    (reported, counts)
}

/// What brings the estimated poses of the first part, beside the true ones, to these: positions by
/// the similarity, and rotations by the mean of all differences.
fn fitted(first_part: &[(Se3, Se3)]) -> (Sim3, Rotation) {
    let positions = first_part.iter();
    let (estimate, true_positions): (Vec<Vec3>, Vec<Vec3>) = positions
        .map(|(e, t)| (e.translation, t.translation))
        .unzip();
    let fit = align_similarity(&estimate, &true_positions, true).unwrap();
    let turns = first_part.iter();
    let turns: Vec<Rotation> = turns
        .map(|(e, t)| t.rotation * e.rotation.inverse())
        .collect();
    let from_first = |turn: &Rotation| (turns[0].inverse() * *turn).scaled_axis();
    let mean = turns.iter().map(from_first).sum::<Vec3>() / turns.len() as f64;
    (fit.target_from_source, turns[0] * Rotation::new(mean))
}

fn main() {
    let mut args = std::env::args().skip(1);
    let folder = args.next().unwrap();
    let options = Options::read(args);
    let is_scene = |(name, folder): &(&String, &String)| {
        name.chars().all(char::is_uppercase) && Path::new(folder).is_dir()
    };
    let others: Vec<(&String, &String)> = options.0.iter().filter(is_scene).collect();
    let names: Vec<String> = others.iter().map(|(name, _)| (*name).clone()).collect();
    let mut scenes = vec![Sequence::open(&folder)];
    scenes.extend(others.iter().map(|(_, folder)| Sequence::open(folder)));
    let (frames, begins) = video(&options, &names);
    let config = options.applied_to(SlamConfig::default(), SLAM, "slam");
    let mut slam = scenes[0].system(config, options.number("seed", 0));
    let (reported, counts) = play(&mut slam, &scenes, &frames, options.number("maps", 0) > 0);
    slam.finish();
    for fragment in slam.fragments() {
        println!("{fragment:?}");
    }
    println!(
        "{} frames, parts begin at {begins:?}, states {counts:?} [init good degraded fragment \
         lost], {:?}",
        frames.len(),
        slam.graph_stats()
    );
    let second = begins.get(1).copied().unwrap_or(frames.len());
    let trajectory = slam.trajectory();
    let truth = |k: usize| frames[k].map(|(scene, frame)| (scene, scenes[scene].true_pose(frame)));
    let first_part: Vec<(Se3, Se3)> = trajectory
        .iter()
        .filter(|pose| pose.frame_index < second)
        .filter_map(|pose| Some((pose.world_from_camera, truth(pose.frame_index)?.1)))
        .collect();
    let true_from_world = fitted(&first_part);
    let errors = |poses: &mut dyn Iterator<Item = (usize, Se3)>| {
        let (mut errors, mut elsewhere) = (Errors::default(), 0);
        for (k, pose) in poses {
            match truth(k) {
                Some((0, truth)) => errors.add(&true_from_world, &pose, &truth),
                _ => elsewhere += 1,
            }
        }
        (errors, elsewhere)
    };
    let first = &mut trajectory
        .iter()
        .map(|p| (p.frame_index, p.world_from_camera));
    let (errors_first, _) = errors(&mut first.filter(|(k, _)| *k < second));
    errors_first.print("first part, final");
    let (live, wrong) = errors(&mut reported.iter().copied().filter(|(k, _)| *k >= second));
    live.print("afterwards, as reported");
    println!("poses reported for frames of another place or a covered lens: {wrong}");
    let last = &mut trajectory
        .iter()
        .map(|p| (p.frame_index, p.world_from_camera));
    let (last, wrong) = errors(&mut last.filter(|(k, _)| *k >= second));
    last.print("afterwards, final");
    println!("final poses of such frames: {wrong}");
    let degraded = counts[TrackingState::Lost as usize];
    println!("lost: {degraded} frames");
}
