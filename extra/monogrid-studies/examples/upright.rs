//! Up and the floor of recordings, and of the built-in worlds entered with a tilted camera.
//!
//! `cargo run --release -p monogrid-studies --example upright -- RECORDING...`
//! `cargo run --release -p monogrid-studies --example upright -- worlds`
//!
//! A line per recording: up (x right, y down, z ahead of the first camera), its confidence, the
//! floor, seconds.
//!
//! A line per world: twelve keyframes along its built-in path, with the exact depth of textured
//! pixels and 1 % of noise. The first is tilted by up to 60 degrees about a random axis, ten times:
//! the largest error of up and of the height of the floor. Then all keyframes are rolled by the
//! same angle, as by a camera that is mounted so.
#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a tool for development, read from top to bottom"
)]

use monogrid_datasets::{ReadOptions, Recording};
use monogrid_geometry::{Pinhole, Rotation, Se3, Vec3};
use monogrid_image::{GradientImage, Image};
use monogrid_mapping::{
    DepthOf, ImageOf, KeyframeCamera, KeyframeScan, MappingConfig, PosedKeyframe, Upright,
    UprightView, final_scans, upright,
};
use monogrid_slam::DepthPixel;
use monogrid_worlds::{LightingConfig, Motion, Renderer, SynthConfig, SynthSequence, WORLD_NAMES};
use std::path::Path;
use std::time::Instant;

fn main() {
    let config = MappingConfig::default();
    for path in std::env::args().skip(1) {
        if path == "worlds" {
            WORLD_NAMES.iter().for_each(|name| tilt_world(name));
            continue;
        }
        let recording = Recording::read(Path::new(&path), ReadOptions::default()).unwrap();
        let camera = KeyframeCamera {
            pinhole: recording.session.pinhole,
            width: recording.session.width,
            height: recording.session.height,
        };
        let keyframes: Vec<PosedKeyframe> = recording
            .keyframes
            .iter()
            .map(|keyframe| PosedKeyframe {
                id: keyframe.id,
                image: keyframe.image.as_ref().map(ImageOf::Held),
                depth: DepthOf::Held(&keyframe.pixels),
                world_from_keyframe: keyframe.world_from_keyframe,
            })
            .collect();
        let scans = final_scans(&keyframes, &camera, &config, 2);
        let started = Instant::now();
        let views: Vec<UprightView> = scans
            .iter()
            .zip(&keyframes)
            .filter_map(|(scan, keyframe)| {
                Some(UprightView {
                    scan,
                    image: keyframe.image,
                    world_from_keyframe: keyframe.world_from_keyframe?,
                })
            })
            .collect();
        let found = upright(&views, &path_of(&views));
        let seconds = started.elapsed().as_secs_f64();
        println!("{path}: {found:?}, {seconds:.2} s");
    }
}

/// A keyframe of a built-in world.
struct Rendered {
    image: Image<u8>,
    pixels: Vec<DepthPixel>,
    world_from_camera: Se3,
}

fn tilt_world(name: &str) {
    let config = SynthConfig::demo();
    let motion = Motion::by_name("hand").unwrap();
    let sequence =
        SynthSequence::built_in_with(name, motion, config, &LightingConfig::quick()).unwrap();
    let renderer = Renderer::new(sequence.camera(), 2.2);
    let poses: Vec<Se3> = (0..12)
        .map(|k| {
            sequence
                .world_from_camera(k * (sequence.len() - 1) / 11)
                .unwrap()
        })
        .collect();
    let level: Vec<Rendered> = poses
        .iter()
        .map(|pose| render(&renderer, &sequence, pose))
        .collect();
    let mut numbers = Numbers(7);
    let (mut worst_deg, mut worst_floor, mut least_sure): (f64, f64, f64) = (0.0, 0.0, 1.0);
    for _ in 0..10 {
        let axis = Vec3::from_fn(|_, _| numbers.next() - 0.5).normalize();
        let tilt = Rotation::from_scaled_axis(axis * (60.0 * numbers.next()).to_radians());
        let tilted = Se3::new(poses[0].rotation * tilt, poses[0].translation);
        let mut keyframes = vec![render(&renderer, &sequence, &tilted)];
        keyframes.extend(level[1..].iter().map(Rendered::copy));
        let (found, off_deg, floor) = judge(&keyframes, &sequence.camera().pinhole);
        worst_deg = worst_deg.max(off_deg);
        worst_floor = worst_floor.max(floor);
        least_sure = least_sure.min(found.confidence);
    }
    println!(
        "{name}: first keyframe tilted: up off by at most {worst_deg:.2} degrees, floor by \
         {worst_floor:.3} m, confidence at least {least_sure:.2}"
    );
    for roll_deg in [20.0_f64, 40.0] {
        let roll = Rotation::from_scaled_axis(Vec3::z() * roll_deg.to_radians());
        let rolled: Vec<Rendered> = poses
            .iter()
            .map(|pose| {
                render(
                    &renderer,
                    &sequence,
                    &Se3::new(pose.rotation * roll, pose.translation),
                )
            })
            .collect();
        let (found, off_deg, _) = judge(&rolled, &sequence.camera().pinhole);
        println!(
            "  all rolled by {roll_deg}: off by {off_deg:.2} degrees, confidence {:.2}",
            found.confidence
        );
    }
}

impl Rendered {
    fn copy(&self) -> Self {
        Self {
            image: self.image.clone(),
            pixels: self.pixels.clone(),
            world_from_camera: self.world_from_camera,
        }
    }
}

/// What a depth filter would find: textured pixels, with noise.
fn render(renderer: &Renderer, sequence: &SynthSequence, pose: &Se3) -> Rendered {
    let seen = renderer.render(sequence.world(), pose);
    let gradient = GradientImage::new(&seen.image).magnitude();
    let mut numbers = Numbers(1);
    let mut pixels = Vec::new();
    for y in 0..seen.image.height() {
        for x in 0..seen.image.width() {
            let depth = seen.depth.row(y)[x];
            if depth.is_finite() && depth > 0.0 && gradient.row(y)[x] > 5.0 {
                let noise = (0..3).map(|_| numbers.next() - 0.5).sum::<f64>() as f32;
                let idepth = (1.0 + 0.02 * noise) / depth;
                pixels.push(DepthPixel {
                    x: x as u16,
                    y: y as u16,
                    idepth,
                    idepth_var: (0.01 * idepth).powi(2),
                });
            }
        }
    }
    Rendered {
        image: seen.image.map(|v| v.round().clamp(0.0, 255.0) as u8),
        pixels,
        world_from_camera: *pose,
    }
}

/// What is found, how far off up is (degrees), and the floor (m; far off where there is none).
fn judge(keyframes: &[Rendered], pinhole: &Pinhole) -> (Upright, f64, f64) {
    let config = MappingConfig::default();
    let camera = KeyframeCamera {
        pinhole: *pinhole,
        width: keyframes[0].image.width(),
        height: keyframes[0].image.height(),
    };
    let first_from_world = keyframes[0].world_from_camera.inverse();
    let scans: Vec<KeyframeScan> = (0..)
        .zip(keyframes)
        .map(|(id, k)| KeyframeScan::new(id, &k.pixels, Some(&k.image), &camera, &config))
        .collect();
    let views: Vec<UprightView> = scans
        .iter()
        .zip(keyframes)
        .map(|(scan, k)| UprightView {
            scan,
            image: Some(ImageOf::Held(&k.image)),
            world_from_keyframe: (first_from_world * k.world_from_camera).with_scale(1.0),
        })
        .collect();
    let found = upright(&views, &path_of(&views)).unwrap();
    let up = first_from_world.rotation * Vec3::z();
    let off_deg = up.angle(&found.up_in_world).to_degrees();
    // the floor of the worlds is at z = 0
    let true_height = -keyframes[0].world_from_camera.translation.z;
    let floor = found
        .floor
        .map_or(9.0, |floor| (floor.height - true_height).abs());
    (found, off_deg, floor)
}

/// The path of the camera, as far as keyframes say it.
fn path_of(views: &[UprightView]) -> Vec<Se3> {
    let pose = |view: &UprightView| view.world_from_keyframe.to_se3();
    views.iter().map(pose).collect()
}

/// Numbers from 0 to 1.
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f64 / f64::from(1 << 24)
    }
}
