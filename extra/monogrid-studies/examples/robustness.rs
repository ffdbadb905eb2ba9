//! What a disturbance does to a run: one row of the robustness matrix (`scripts/robustness.sh`).
//!
//! `cargo run --release -p monogrid-studies --example robustness -- WORLD DISTURBANCE [seed=I]
//! [frames=N] [imu=1] [list=1]`
//!
//! A built-in world at 320x240, carried by hand (`street`: by a car), with the noise of the
//! demonstration. Disturbances: `low-rate`, `blur`, `exposure-jumps`, `black-frames`, `person`,
//! `rolling-shutter`, `noise`, `fast`; `none` for comparison. Prints coverage, ATE as a share of
//! the path, the share of the frames that were called good and are off by more than 2 % of the path
//! or 3 degrees in the end, and how many frames were lost. `list=1` names the frames that are off.
#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a tool for development, read from top to bottom"
)]

use monogrid_evaluation::{StampedPose, TrajectoryConfig, WrongPose, evaluate_trajectory};
use monogrid_image::{GrayImage, Mask};
use monogrid_inertial::Imu;
use monogrid_slam::{FrameInput, Slam, SlamConfig, TrackingState};
use monogrid_studies::Options;
use monogrid_worlds::{
    Carrier, EffectsConfig, ImuConfig, LightingConfig, NoiseConfig, SynthConfig, SynthSequence,
    imu_samples, usual_frames,
};
use std::sync::Arc;

/// Frames in which a built-in motion goes its way at walking pace (in the street at that of a car),
/// 30 per second, and who carries the camera.
fn pace(world: &str) -> (usize, Carrier) {
    match world {
        "street" => (usual_frames(world), Carrier::Car),
        _ => (1500, Carrier::Hand),
    }
}

/// What is made worse.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Disturbance {
    None,
    /// 10 frames per second.
    LowRate,
    /// The shutter is open for 20 ms.
    Blur,
    /// The exposure doubles or halves every 25 frames.
    ExposureJumps,
    /// Five frames of 150 are black.
    BlackFrames,
    /// Somebody walks through the picture.
    Person,
    /// 25 ms between the first and the last row.
    RollingShutter,
    /// A tenth of the light.
    Noise,
    /// Twice the walking pace.
    Fast,
}

impl Disturbance {
    fn by_name(name: &str) -> Option<Self> {
        Some(match name {
            "none" => Self::None,
            "low-rate" => Self::LowRate,
            "blur" => Self::Blur,
            "exposure-jumps" => Self::ExposureJumps,
            "black-frames" => Self::BlackFrames,
            "person" => Self::Person,
            "rolling-shutter" => Self::RollingShutter,
            "noise" => Self::Noise,
            "fast" => Self::Fast,
            _ => return None,
        })
    }

    fn effects(self) -> EffectsConfig {
        let mut effects = EffectsConfig::demo();
        match self {
            Self::Blur => effects.shutter_secs = 0.020,
            Self::Person => effects.has_mover = true,
            Self::RollingShutter => effects.readout_secs = 0.025,
            Self::Noise => {
                let usual = NoiseConfig::default();
                effects.noise = Some(NoiseConfig {
                    full_well_electrons: 0.1 * usual.full_well_electrons,
                    ..usual
                });
            }
            _ => {}
        }
        effects
    }

    /// The settings of a sequence whose first `frames` at walking pace and 30 per second are shown,
    /// and how many are.
    fn sequence(self, usual_frames: usize, frames: usize, seed: u64) -> (SynthConfig, usize) {
        let usual = SynthConfig {
            frames: usual_frames,
            effects: self.effects(),
            seed,
            ..SynthConfig::small()
        };
        match self {
            Self::LowRate => {
                let config = SynthConfig {
                    fps: usual.fps / 3.0,
                    frames: usual_frames / 3,
                    ..usual
                };
                (config, frames / 3)
            }
            Self::Fast => {
                let config = SynthConfig {
                    frames: usual_frames / 2,
                    ..usual
                };
                (config, frames / 2)
            }
            _ => (usual, frames),
        }
    }

    /// What becomes of a picture.
    fn applied(self, image: GrayImage, index: usize) -> GrayImage {
        /// Twice the light at a gamma of 2.2.
        const DOUBLED: f32 = 1.37;
        match self {
            Self::BlackFrames if index % 150 >= 145 => image.map(|_| 0.0),
            Self::ExposureJumps => {
                let factor = [1.0, DOUBLED, 1.0, 1.0 / DOUBLED][index / 25 % 4];
                image.map(|grey| (grey * factor).round().min(255.0))
            }
            _ => image,
        }
    }
}

/// Shows the sequence to a system of its own; it, the true poses, and what was said of each frame
/// at the time.
fn run(
    sequence: &SynthSequence,
    disturbance: Disturbance,
    imu: Option<Imu>,
) -> (Slam, Vec<StampedPose>, Vec<TrackingState>) {
    let camera = sequence.camera();
    let mask = Mask::filled(camera.width, camera.height, 255);
    let mut slam = Slam::new(SlamConfig::default(), camera.pinhole, mask, 0).unwrap();
    if let Some(imu) = imu {
        slam = slam.with_imu(Arc::new(imu));
    }
    let mut truth = Vec::new();
    let mut states = Vec::new();
    for k in 0..sequence.len() {
        let frame = sequence.frame(k).unwrap();
        truth.push((frame.timestamp_ns, frame.world_from_camera));
        let report = slam.process_frame(FrameInput {
            index: k,
            timestamp_ns: frame.timestamp_ns,
            image: disturbance.applied(frame.image, frame.index),
            depth: None,
        });
        states.push(report.state);
    }
    slam.finish();
    (slam, truth, states)
}

/// The readings of a phone beside the camera.
fn imu(sequence: &SynthSequence) -> Imu {
    let sensor = ImuConfig::default();
    let samples = imu_samples(
        sequence.path(),
        &sensor,
        sequence.config().seed,
        f64::INFINITY,
    );
    Imu::new(samples, sensor.noise, sensor.camera_from_imu.inverse())
}

/// The frame that was taken at a time.
fn frame_at(truth: &[StampedPose], time_secs: f64) -> usize {
    let is_before = |pose: &StampedPose| (pose.0 as f64) < 1e9 * time_secs - 1e6;
    truth.partition_point(is_before)
}

fn main() {
    let mut args = std::env::args().skip(1);
    let (world, name) = (args.next().unwrap(), args.next().unwrap());
    let options = Options::read(args);
    let disturbance = Disturbance::by_name(&name).unwrap();
    let seed = options.number("seed", 0);
    let (usual_frames, carrier) = pace(&world);
    let (config, frames) = disturbance.sequence(usual_frames, options.number("frames", 600), seed);
    let quick = LightingConfig::quick();
    let sequence = SynthSequence::built_in_with(&world, carrier, config, &quick).unwrap();
    let sequence = sequence.shortened(frames);
    let (slam, truth, states) = run(
        &sequence,
        disturbance,
        options.is("imu", "1").then(|| imu(&sequence)),
    );
    let num_lost = states.iter().filter(|s| **s == TrackingState::Lost).count();
    let poses: Vec<StampedPose> = slam
        .trajectory()
        .iter()
        .map(|p| (p.timestamp_ns, p.world_from_camera))
        .collect();
    let coverage = poses.len() as f64 / truth.len() as f64;
    print!(
        "| {world} | {name} | {seed} | {} | {coverage:.3} | ",
        truth.len()
    );
    match evaluate_trajectory(&poses, &truth, &TrajectoryConfig::default()) {
        Ok(report) => {
            let ate = 100.0 * report.ate_rmse / report.path_length;
            let frame = |pose: &WrongPose| frame_at(&truth, pose.time_secs);
            let is_good = |pose: &&WrongPose| states[frame(pose)] == TrackingState::Good;
            let num_good = states.iter().filter(|s| **s == TrackingState::Good).count();
            let num_wrong = report.wrong.iter().filter(is_good).count();
            let share = num_wrong as f64 / num_good.max(1) as f64;
            println!("{ate:.2} | {share:.3} | {num_lost} |");
            for pose in report.wrong.iter().filter(|_| options.is("list", "1")) {
                let frame = frame(pose);
                let state = states[frame].name();
                let (metres, degrees) = (pose.distance, pose.degrees);
                println!("frame {frame} {state}: {metres:.2} m, {degrees:.1} degrees");
            }
        }
        Err(_) => println!("– | 0.000 | {num_lost} |"),
    }
}
