//! Times the solvers on typical sizes: `cargo run --release -p monogrid-graph --example timing`.
#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a program for developers"
)]

#[path = "../tests/common/mod.rs"]
mod common;

use common::{PINHOLE, Random, SceneOptions, cpu_seconds, disturb, scene};
use monogrid_geometry::{Se3, Vec6};
use monogrid_graph::bundle::{BundleConfig, PoseFreedom, adjust};
use monogrid_graph::{MapMatch, PoseOnlyConfig, refine_pose};
use std::time::Instant;

fn time_bundle() {
    let mut scene = scene(&SceneOptions {
        keyframes: 15,
        points: 1500,
        noise_px: 0.7,
        outlier_share: 0.05,
        seed: 1,
    });
    scene.problem.keyframes[0].freedom = PoseFreedom::Fixed;
    scene.problem.keyframes[1].freedom = PoseFreedom::Fixed;
    disturb(&mut scene.problem, 0.02, 0.05, 2);
    for with_covariance in [false, true] {
        let config = BundleConfig {
            min_relative_decrease: 1e-6,
            with_covariance,
            ..BundleConfig::default()
        };
        let mut solution = adjust(&scene.problem, &config).unwrap();
        let clock = Instant::now();
        let start = cpu_seconds(&clock);
        for _ in 0..50 {
            solution = adjust(&scene.problem, &config).unwrap();
        }
        let mean = (cpu_seconds(&clock) - start) / 50.0;
        println!(
            "bundle: 15 keyframes, 1500 points, {} observations, {} iterations, covariance \
             {with_covariance}: {:.2} ms, cost {:.0} -> {:.0}, {:?}",
            scene.problem.observations.len(),
            solution.iterations,
            mean * 1e3,
            solution.initial_cost,
            solution.final_cost,
            solution.outcome
        );
    }
}

fn time_pose_only() {
    let mut random = Random(3);
    let truth = Se3::exp(&Vec6::new(0.3, -0.2, 0.5, 0.4, -0.9, 0.2));
    let matches: Vec<_> = (0..600)
        .map(|_| {
            let pixel =
                monogrid_geometry::Vec2::new(640.0 * random.uniform(), 480.0 * random.uniform());
            let x = PINHOLE.unproject(&pixel) * (1.0 + 5.0 * random.uniform());
            let mut seen = pixel;
            seen.x += random.normal() * 0.7;
            seen.y += random.normal() * 0.7;
            if random.uniform() < 0.1 {
                seen.x += 50.0 * random.signed();
            }
            MapMatch {
                point_in_world: truth.inverse() * x,
                pixel: seen,
                inv_sigma_px: 1.0 / 0.7,
            }
        })
        .collect();
    let start_pose = Se3::exp(&Vec6::new(0.02, 0.01, -0.02, 0.01, -0.01, 0.01)) * truth;
    let mut iterations = 0;
    let clock = Instant::now();
    // The kernel counts in ticks: many runs between two readings.
    let runs = 1000;
    let start = cpu_seconds(&clock);
    for _ in 0..runs {
        let found = refine_pose(&start_pose, &PINHOLE, &matches, &PoseOnlyConfig::default());
        iterations = found.unwrap().iterations;
    }
    let mean = (cpu_seconds(&clock) - start) / f64::from(runs);
    println!(
        "pose_only: 600 matches, {iterations} iterations: {:.3} ms",
        mean * 1e3
    );
}

fn main() {
    time_bundle();
    time_pose_only();
}
