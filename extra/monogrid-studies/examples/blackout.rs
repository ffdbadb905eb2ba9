//! Two seconds without a picture, with and without an inertial sensor: where the camera is
//! afterwards (`scripts/imu.sh`).
//!
//! `cargo run --release -p monogrid-studies --example blackout -- WORLD known|unknown [seed=I]
//! [imu=0] [before=SECONDS] [small=1]`
//!
//! A built-in world at 640x480 (`small`: 320x240), carried by hand, with the noise of the
//! demonstration. `unknown`: the camera goes on; `known`: it turns round in the dark and goes back.
//! Prints the way in the dark, how the loss ended, and by what share of that way positions in the
//! second after it are wrong, when the path before it is aligned with the truth, with scale.
#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    clippy::too_many_lines,
    reason = "a tool for development, read from top to bottom"
)]

use monogrid_datasets::TimedPose;
use monogrid_geometry::{Sim3, Vec3, align_similarity};
use monogrid_image::Mask;
use monogrid_inertial::{Imu, ImuNoise};
use monogrid_slam::settings::SLAM;
use monogrid_slam::{FrameInput, MAIN_MAP, Slam, SlamConfig};
use monogrid_studies::Options;
use monogrid_worlds::{
    CameraPath, Carrier, ImuConfig, LightingConfig, SynthConfig, SynthSequence, World, imu_samples,
};
use std::sync::Arc;

/// Length of the dark, s.
const DARK_SECS: f64 = 2.0;
/// Seconds after it.
const AFTER_SECS: f64 = 6.0;
/// Frames in which a built-in motion goes its way at walking pace, 30 per second.
const WALKING_FRAMES: usize = 1500;

/// The time on the built-in path at which the camera is at a time: in the dark it turns round.
fn turned_back(secs: f64, dark: f64) -> f64 {
    let into = ((secs - dark) / DARK_SECS).clamp(0.0, 1.0);
    // the speed falls evenly from 1 to -1
    let way = into * (1.0 - into) * DARK_SECS;
    dark.min(secs) + way - (secs - dark - DARK_SECS).max(0.0)
}

fn path(world: &str, is_known: bool, dark: f64, config: &SynthConfig) -> CameraPath {
    let walk = SynthSequence::path_for(world, Carrier::Hand.into(), config).unwrap();
    if !is_known {
        return walk;
    }
    let count = ((dark + DARK_SECS + AFTER_SECS) * 20.0) as i64;
    let poses: Vec<TimedPose> = (0..=count)
        .map(|k| TimedPose {
            timestamp_ns: k * 50_000_000,
            world_from_camera: walk.world_from_camera(turned_back(k as f64 * 0.05, dark)),
        })
        .collect();
    CameraPath::recorded(&poses, 20.0).unwrap()
}

/// Similarity of the path before the dark to the truth.
fn aligned(slam: &Slam, path: &CameraPath, dark: f64) -> Option<Sim3> {
    let before = slam
        .trajectory()
        .into_iter()
        .filter(|p| p.timestamp_ns as f64 * 1e-9 < dark);
    let pairs = before.map(|p| {
        let truth = path.world_from_camera(p.timestamp_ns as f64 * 1e-9);
        (p.world_from_camera.translation, truth.translation)
    });
    let (estimate, truth): (Vec<Vec3>, Vec<Vec3>) = pairs.unzip();
    align_similarity(&estimate, &truth, true)
        .ok()
        .map(|fit| fit.target_from_source)
}

fn main() {
    let mut args = std::env::args().skip(1);
    let (world, place) = (args.next().unwrap(), args.next().unwrap());
    let options = Options::read(args);
    let (seed, dark) = (options.number("seed", 0), options.number("before", 10.0));
    let camera = match options.number("small", 0) {
        0 => SynthConfig::demo(),
        _ => SynthConfig::small(),
    };
    let config = SynthConfig {
        frames: WALKING_FRAMES,
        seed,
        ..camera
    };
    let path = path(&world, place == "known", dark, &config);
    let built = World::by_name_with(&world, &LightingConfig::quick()).unwrap();
    let sequence = SynthSequence::new(Arc::new(built), path.clone(), config).unwrap();
    let sequence = sequence.shortened(((dark + DARK_SECS + AFTER_SECS) * 30.0) as usize);

    let camera = sequence.camera();
    let mask = Mask::filled(camera.width, camera.height, 255);
    let config = options.applied_to(SlamConfig::default(), SLAM, "slam");
    let mut slam = Slam::new(config, camera.pinhole, mask, 0).unwrap();
    let has_imu = options.number("imu", 1) != 0;
    if has_imu {
        let sensor = ImuConfig::default();
        let samples = imu_samples(&path, &sensor, seed, dark + DARK_SECS + AFTER_SECS);
        let imu = Imu::new(
            samples,
            ImuNoise::default(),
            sensor.camera_from_imu.inverse(),
        );
        slam = slam.with_imu(Arc::new(imu));
    }
    for k in 0..sequence.len() {
        let frame = sequence.frame(k).unwrap();
        let secs = frame.timestamp_ns as f64 * 1e-9;
        let is_dark = (dark..dark + DARK_SECS).contains(&secs);
        let image = if is_dark {
            frame.image.map(|_| 0.0)
        } else {
            frame.image
        };
        slam.process_frame(FrameInput {
            index: k,
            timestamp_ns: frame.timestamp_ns,
            image,
            depth: None,
        });
    }
    slam.finish();

    let at = |secs: f64| path.world_from_camera(secs).translation;
    let steps = (0..200).map(|k| dark + DARK_SECS * f64::from(k) / 200.0);
    let way: f64 = steps
        .map(|t| (at(t + DARK_SECS / 200.0) - at(t)).norm())
        .sum();
    let fit = aligned(&slam, &path, dark);
    let after = slam
        .trajectory_in(MAIN_MAP)
        .into_iter()
        .filter(|p| p.timestamp_ns as f64 * 1e-9 >= dark + DARK_SECS);
    let after: Vec<_> = after.collect();
    let error = |p: &monogrid_slam::TrajectoryPose| {
        let truth = at(p.timestamp_ns as f64 * 1e-9);
        fit.map(|fit| (fit * p.world_from_camera.translation - truth).norm())
    };
    let soon = after.iter().take(30).filter_map(error);
    let mut errors: Vec<f64> = soon.collect();
    errors.sort_by(f64::total_cmp);
    let ended = match slam.fragments().first() {
        Some(fragment) if fragment.joined.is_some() => "joined",
        Some(_) => "apart",
        None if slam.counts().relocalisations > 0 => "recognised",
        None if after.is_empty() => "lost",
        None => "tracked",
    };
    let share = errors
        .get(errors.len() / 2)
        .map_or("–".to_owned(), |e| format!("{:.1} %", 100.0 * e / way));
    println!(
        "| {world} | {place} | {seed} | {} | {way:.2} m | {ended} | {} of {} | {share} |",
        if has_imu { "yes" } else { "no" },
        after.len(),
        (AFTER_SECS * 30.0) as usize,
    );
}
