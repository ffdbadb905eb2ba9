//! Times the solvers on typical sizes: `cargo run --release -p monogrid-graph --example timing`.
#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a program for developers"
)]

#[path = "../tests/suite/common/mod.rs"]
mod common;

use common::{PINHOLE, Random, SceneOptions, cpu_seconds, disturb, scene};
use monogrid_geometry::{Mat7, Se3, Sim3, Vec3, Vec6, Vec7};
use monogrid_graph::bundle::{BundleConfig, CovarianceOf, PoseFreedom, adjust};
use monogrid_graph::pose_graph::{GraphEdge, GraphNode, PoseGraph, PoseGraphConfig};
use monogrid_graph::{MapMatch, PoseOnlyConfig, RobustKernel, refine_pose};
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
    for covariance in [
        CovarianceOf::Nothing,
        CovarianceOf::Poses,
        CovarianceOf::PosesAndPoints,
    ] {
        let config = BundleConfig {
            min_relative_decrease: 1e-6,
            covariance,
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
             {covariance:?}: {:.2} ms, cost {:.0} -> {:.0}, {:?}",
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

const LOOP_KEYFRAMES: usize = 1000;
const LOOP_RADIUS_M: f64 = 50.0;

/// Poses on a circle, looking along it.
fn circle() -> Vec<Sim3> {
    let pose = |k: usize| {
        let angle = std::f64::consts::TAU * k as f64 / LOOP_KEYFRAMES as f64;
        let turn = Se3::exp(&Vec6::new(0.0, 0.0, 0.0, 0.0, -angle, 0.0)).rotation;
        let position = Vec3::new(angle.cos(), 0.0, angle.sin()) * LOOP_RADIUS_M;
        Se3::new(turn, position).with_scale(1.0)
    };
    (0..LOOP_KEYFRAMES).map(pose).collect()
}

/// Measures relative poses with noise and, per keyframe between both, a drift.
struct Measure<'a> {
    truth: &'a [Sim3],
    random: Random,
}

impl Measure<'_> {
    fn edge(&mut self, i: usize, j: usize, drift: f64, kernel: RobustKernel) -> GraphEdge {
        let sigma = [2e-3, 2e-3, 2e-3, 1e-3, 1e-3, 1e-3, 5e-3];
        let noise = Vec7::from_fn(|k, _| 0.3 * sigma[k] * self.random.normal());
        let bias = Vec7::from([1e-4, 0.0, 0.0, 0.0, 4e-5, 0.0, 1e-4]) * drift;
        let i_from_j = self.truth[i].inverse() * self.truth[j] * Sim3::exp(&(noise + bias));
        GraphEdge {
            i: i as u64,
            j: j as u64,
            i_from_j,
            information: Mat7::from_diagonal(&Vec7::from_fn(|k, _| sigma[k].powi(-2))),
            kernel,
        }
    }
}

/// A loop of 1000 keyframes with 13 edges each, as runs of `corridor-loop` have them, that has
/// drifted by 3 % of its way; six edges between its ends close it.
fn time_closure() {
    let truth = circle();
    let mut measure = Measure {
        truth: &truth,
        random: Random(5),
    };
    let certain = RobustKernel::Huber { delta: 3.0 };
    let doubted = RobustKernel::DynamicCovariance { phi: 25.0 };
    let mut graph = PoseGraph::new();
    let mut world_from_keyframe = truth[0];
    for k in 0..LOOP_KEYFRAMES {
        if k > 0 {
            world_from_keyframe =
                world_from_keyframe * measure.edge(k - 1, k, 1.0, certain).i_from_j;
        }
        let node = GraphNode {
            id: k as u64,
            world_from_keyframe,
            is_fixed: k == 0,
        };
        graph.add_node(node).unwrap();
        for back in (1..=13.min(k)).rev() {
            let kernel = if back < 3 { certain } else { doubted };
            let edge = measure.edge(k - back, k, back as f64, kernel);
            graph.add_edge(edge).unwrap();
        }
    }
    let near = PoseGraphConfig {
        graduation: None,
        ..PoseGraphConfig::default()
    };
    graph.optimise(&near).unwrap();
    let before = worst_position_error(&graph, &truth);
    for k in 0..6 {
        let edge = measure.edge(k, LOOP_KEYFRAMES - 6 + k, 0.0, certain);
        graph.add_edge(edge).unwrap();
    }
    let clock = Instant::now();
    let start = cpu_seconds(&clock);
    let report = graph.optimise(&PoseGraphConfig::default()).unwrap();
    let optimised = cpu_seconds(&clock);
    let uncertainty = graph.uncertainty().unwrap();
    for k in LOOP_KEYFRAMES - 12..LOOP_KEYFRAMES {
        uncertainty.relative(k as u64 - 1, k as u64).unwrap();
    }
    println!(
        "closure: {LOOP_KEYFRAMES} keyframes, {} edges: {:.0} ms, {} iterations, largest error \
         {before:.2} -> {:.2} m in a loop of {:.0} m; covariances of 12 keyframes {:.0} ms",
        graph.edges().len(),
        1e3 * (optimised - start),
        report.iterations,
        worst_position_error(&graph, &truth),
        std::f64::consts::TAU * LOOP_RADIUS_M,
        1e3 * (cpu_seconds(&clock) - optimised),
    );
}

fn worst_position_error(graph: &PoseGraph, truth: &[Sim3]) -> f64 {
    let errors = graph.nodes().iter().zip(truth);
    errors
        .map(|(n, t)| (n.world_from_keyframe.translation - t.translation).norm())
        .fold(0.0, f64::max)
}

fn main() {
    time_bundle();
    time_pose_only();
    time_closure();
}
