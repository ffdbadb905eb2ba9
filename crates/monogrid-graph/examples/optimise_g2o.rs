//! Optimises a g2o file by plain least squares and writes the result: the half of a comparison with
//! another solver that is ours.
//!
//! `cargo run --release -p monogrid-graph --example optimise_g2o -- IN.g2o OUT.g2o`
#![allow(clippy::print_stdout, reason = "a tool that reports to its user")]

use monogrid_graph::RobustKernel;
use monogrid_graph::g2o::{read, write};
use monogrid_graph::pose_graph::PoseGraphConfig;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let (Some(input), Some(output)) = (args.next(), args.next()) else {
        return Err("usage: optimise_g2o IN.g2o OUT.g2o".into());
    };
    let mut graph = read(&std::fs::read_to_string(input)?, RobustKernel::None)?.graph;
    let config = PoseGraphConfig {
        max_iterations: 200,
        min_relative_decrease: 1e-12,
        ..PoseGraphConfig::default()
    };
    let report = graph.optimise(&config)?;
    std::fs::write(output, write(&graph))?;
    println!(
        "{} keyframes, {} edges, cost {:.6} to {:.6}, {} iterations",
        graph.nodes().len(),
        graph.edges().len(),
        report.initial_cost,
        report.final_cost,
        report.iterations
    );
    Ok(())
}
