//! Random numbers and synthetic scenes that several test files share.
#![allow(
    dead_code,
    clippy::unwrap_used,
    reason = "examples/timing.rs uses a part of it, and unwraps"
)]

pub mod graphs;

use monogrid_geometry::{Pinhole, Se3, Vec2, Vec3, Vec6, rotation_exp};
use monogrid_graph::bundle::{
    AnchoredPoint, BundleKeyframe, BundleProblem, Observation, PoseFreedom,
};

/// Deterministic pseudo-random numbers (Steele's splitmix64), enough for tests.
pub struct Random(pub u64);

impl Random {
    pub fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^= z >> 31;
        (z >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub fn signed(&mut self) -> f64 {
        2.0 * self.uniform() - 1.0
    }

    /// Standard normal (Box-Muller).
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }

    pub fn normal3(&mut self) -> Vec3 {
        Vec3::new(self.normal(), self.normal(), self.normal())
    }

    pub fn below(&mut self, n: usize) -> usize {
        ((self.uniform() * n as f64) as usize).min(n - 1)
    }
}

pub const PINHOLE: Pinhole = Pinhole {
    fx: 525.0,
    fy: 525.0,
    cx: 319.5,
    cy: 239.5,
};

/// How a scene is made.
#[derive(Clone, Copy)]
pub struct SceneOptions {
    pub keyframes: usize,
    pub points: usize,
    pub noise_px: f64,
    pub outlier_share: f64,
    pub seed: u64,
}

/// A scene with its truth.
pub struct Scene {
    pub problem: BundleProblem,
    pub true_poses: Vec<Se3>,
    pub true_inverse_depths: Vec<f64>,
    pub is_outlier: Vec<bool>,
}

/// A camera that sweeps sideways past points 2 to 6 units away. Every point is hosted by the first
/// keyframe that sees it and has noise on all later observations; poses and depths hold the truth.
#[allow(clippy::too_many_lines, reason = "one random case, described once")]
pub fn scene(options: &SceneOptions) -> Scene {
    let mut random = Random(options.seed);
    let n = options.keyframes;
    let poses: Vec<Se3> = (0..n)
        .map(|i| {
            let x = i as f64 / n as f64 * 3.0 - 1.5;
            let wobble = random.normal3() * 0.02;
            let w = Vec3::new(0.02, -0.15 * x, 0.01) + random.normal3() * 0.02;
            let centre = Vec3::new(x, 0.1 * (3.0 * x).sin(), 0.3 * x * x) + wobble;
            let rotation = rotation_exp(&w);
            Se3::new(rotation, -(rotation * centre))
        })
        .collect();
    let (mut points, mut observations) = (vec![], vec![]);
    let (mut inverse_depths, mut is_outlier) = (vec![], vec![]);
    while points.len() < options.points {
        let x = Vec3::new(
            3.0 * random.signed(),
            1.5 * random.signed(),
            4.0 + 2.0 * random.signed(),
        );
        let seen: Vec<(usize, Vec2, f64)> = (0..n)
            .filter_map(|k| {
                let c = poses[k] * x;
                let pixel = PINHOLE.project(&c);
                let inside = pixel.x > 0.0 && pixel.x < 639.0 && pixel.y > 0.0 && pixel.y < 479.0;
                (c.z > 0.5 && inside && random.uniform() < 0.6).then_some((k, pixel, c.z))
            })
            .collect();
        let Some((&(host, pixel, z), others)) = seen.split_first() else {
            continue;
        };
        if others.len() < 2 {
            continue;
        }
        for &(keyframe, pixel, _) in others {
            let is_wrong = random.uniform() < options.outlier_share;
            let mut noisy = pixel + Vec2::new(random.normal(), random.normal()) * options.noise_px;
            if is_wrong {
                noisy += Vec2::new(random.signed(), random.signed()) * 60.0;
            }
            is_outlier.push(is_wrong);
            observations.push(Observation {
                keyframe,
                point: points.len(),
                pixel: noisy,
                inv_sigma_px: 1.0 / options.noise_px.max(0.1),
            });
        }
        inverse_depths.push(1.0 / z);
        points.push(AnchoredPoint {
            host,
            pixel,
            inverse_depth: 1.0 / z,
            prior: None,
        });
    }
    let keyframe = |&camera_from_world: &Se3| BundleKeyframe {
        camera_from_world,
        freedom: PoseFreedom::Free,
    };
    Scene {
        problem: BundleProblem {
            pinhole: PINHOLE,
            keyframes: poses.iter().map(keyframe).collect(),
            points,
            observations,
        },
        true_poses: poses,
        true_inverse_depths: inverse_depths,
        is_outlier,
    }
}

/// Moves all poses that are not fixed (relative to distance `sigma`) and all inverse depths.
pub fn disturb(problem: &mut BundleProblem, sigma: f64, depth_sigma: f64, seed: u64) {
    let mut random = Random(seed);
    for keyframe in &mut problem.keyframes {
        if keyframe.freedom == PoseFreedom::Free {
            let d = Vec6::from_fn(|i, _| random.normal() * if i < 3 { sigma } else { 0.3 * sigma });
            keyframe.camera_from_world = Se3::exp(&d) * keyframe.camera_from_world;
        }
    }
    for point in &mut problem.points {
        point.inverse_depth *= (random.normal() * depth_sigma).exp();
    }
}

/// Largest distance of a camera centre from the truth.
pub fn worst_centre_error(estimated: &[Se3], truth: &[Se3]) -> f64 {
    let pairs = estimated.iter().zip(truth);
    pairs
        .map(|(e, t)| (e.inverse().translation - t.inverse().translation).norm())
        .fold(0.0, f64::max)
}

/// Largest angle between an estimated and a true rotation, rad.
pub fn worst_rotation_error(estimated: &[Se3], truth: &[Se3]) -> f64 {
    let pairs = estimated.iter().zip(truth);
    pairs
        .map(|(e, t)| e.rotation.angle_to(&t.rotation))
        .fold(0.0, f64::max)
}

/// CPU seconds of this thread where Linux tells them, so that other programs do not disturb; else
/// wall.
pub fn cpu_seconds(start: &std::time::Instant) -> f64 {
    let stat = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    let nanoseconds = stat
        .split_whitespace()
        .next()
        .and_then(|t| t.parse::<f64>().ok());
    nanoseconds.map_or(start.elapsed().as_secs_f64(), |t| t * 1e-9)
}
