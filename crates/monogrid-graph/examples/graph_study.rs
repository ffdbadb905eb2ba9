//! Convergence of random graphs with wrong edges, and time of a large one:
//! `cargo run --release -p monogrid-graph --example graph_study [graphs]`.
#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a program for developers"
)]

#[path = "../tests/common/mod.rs"]
mod common;

use common::graphs::{GraphOptions, Wrong, random_graph};
use common::{Random, cpu_seconds};
use monogrid_graph::pose_graph::PoseGraphConfig;
use std::time::Instant;

fn study(name: &str, wrong: Wrong, graphs: u64) {
    let (mut bad, mut worst, mut sum, mut switched, mut kept) = (vec![], 0.0_f64, 0.0, 0, 0);
    for seed in 0..graphs {
        let mut random = Random(seed ^ 0xabcd);
        let mut g = random_graph(&GraphOptions {
            nodes: 20 + random.below(60),
            near: 2,
            closures: 0.5 + random.uniform(),
            wrong_share: 0.1,
            wrong,
            seed,
        });
        let before = g.rms_error();
        let report = g.graph.optimise(&PoseGraphConfig::default()).unwrap();
        let error = g.rms_error();
        sum += error;
        worst = worst.max(error);
        if error > 0.01 || error.is_nan() {
            bad.push((seed, error, before));
            // Whether the optimiser missed a better solution, or the wrong edges agree with each other.
            let mut from_truth = g.graph.clone();
            for (id, pose) in g.truth.iter().enumerate() {
                from_truth.set_pose(id as u64, *pose).unwrap();
            }
            let at_truth = from_truth.optimise(&PoseGraphConfig::default()).unwrap();
            println!(
                "  cost {:.1}, from the truth {:.1}",
                report.final_cost, at_truth.final_cost
            );
        }
        for (fit, &is_wrong) in report.edges.iter().zip(&g.is_wrong) {
            switched += usize::from(!is_wrong && fit.weight < 0.1);
            kept += usize::from(is_wrong && fit.weight > 0.5);
        }
    }
    println!(
        "{name}: {} of {graphs} beyond 1 %, worst {:.2} %, mean {:.3} %, right edges off {switched}, \
         wrong edges on {kept}",
        bad.len(),
        worst * 100.0,
        sum / graphs as f64 * 100.0
    );
    for (seed, error, before) in bad.iter().take(5) {
        println!(
            "  seed {seed}: {:.1} %, before {:.1} %",
            error * 100.0,
            before * 100.0
        );
    }
}

fn time(nodes: usize, closures: f64) {
    let mut best = f64::INFINITY;
    for _ in 0..3 {
        let mut g = random_graph(&GraphOptions {
            nodes,
            near: 2,
            closures,
            wrong_share: 0.1,
            wrong: Wrong::Closures,
            seed: 5,
        });
        let before = g.rms_error();
        let clock = Instant::now();
        let start = cpu_seconds(&clock);
        let report = g.graph.optimise(&PoseGraphConfig::default()).unwrap();
        best = best.min(cpu_seconds(&clock) - start);
        let start = cpu_seconds(&clock);
        let again = g.graph.optimise(&PoseGraphConfig::default()).unwrap();
        let again_secs = cpu_seconds(&clock) - start;
        println!(
            "{nodes} keyframes, {} edges: {:.0} ms, {} steps, {:.2} % -> {:.3} %; again {:.0} ms, {} steps",
            g.graph.edges().len(),
            best * 1e3,
            report.iterations,
            before * 100.0,
            g.rms_error() * 100.0,
            again_secs * 1e3,
            again.iterations
        );
    }
}

/// One closure over a drifted path of 1000 keyframes, in a graph that was at rest.
fn time_closure() {
    let mut g = random_graph(&GraphOptions {
        nodes: 1000,
        near: 2,
        closures: 0.0,
        wrong_share: 0.0,
        wrong: Wrong::Closures,
        seed: 6,
    });
    g.graph.optimise(&PoseGraphConfig::default()).unwrap();
    for (i, j) in [(10, 990), (500, 995), (200, 700), (5, 600)] {
        let before = g.rms_error();
        let mut edge = g.graph.edges()[0];
        (edge.i, edge.j) = (i, j);
        edge.i_from_j = g.truth[i as usize].inverse() * g.truth[j as usize];
        g.graph.add_edge(edge).unwrap();
        let clock = Instant::now();
        let start = cpu_seconds(&clock);
        let report = g.graph.optimise(&PoseGraphConfig::default()).unwrap();
        println!(
            "closure {i}-{j}: {:.0} ms, {} steps, {:.2} % -> {:.2} %, weight {:.2}",
            (cpu_seconds(&clock) - start) * 1e3,
            report.iterations,
            before * 100.0,
            g.rms_error() * 100.0,
            report.edges[report.edges.len() - 1].weight
        );
    }
    let clock = Instant::now();
    let start = cpu_seconds(&clock);
    let uncertainty = g.graph.uncertainty().unwrap();
    let factored = cpu_seconds(&clock);
    for k in 0..100 {
        uncertainty.relative(k, k + 1).unwrap();
    }
    println!(
        "uncertainty: {:.1} ms, and {:.2} ms per query",
        (factored - start) * 1e3,
        (cpu_seconds(&clock) - factored) * 10.0
    );
}

fn main() {
    if std::env::args().nth(1).as_deref() == Some("time") {
        time(1000, 0.05);
        time(1000, 0.5);
        time_closure();
        return;
    }
    let graphs = std::env::args()
        .nth(1)
        .and_then(|a| a.parse().ok())
        .unwrap_or(1000);
    study("wrong closures", Wrong::Closures, graphs);
    study("wrong anywhere", Wrong::Anywhere, graphs);
    time(1000, 0.05);
    time(1000, 0.5);
}
