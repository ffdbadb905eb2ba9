//! Compares maps of the demonstration world with its exact truth: the loop in which the mapping
//! defaults are found.
//!
//! `cargo run --release -p monogrid-slam --example map_quality -- TRAJECTORY MAP.ot…`
//!
//! `TRAJECTORY` is the true one, from whose positions the free space is filled.
#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    clippy::too_many_lines,
    missing_docs,
    reason = "a tool for development, read from top to bottom"
)]

use monogrid_datasets::synth::{Carrier, SynthConfig, SynthSequence};
use monogrid_evaluation::{MapEvaluationConfig, TruthConfig, evaluate_map, truth_from_triangles};
use monogrid_occupancy::read_ot;
use std::fs::File;

fn main() {
    let mut args = std::env::args().skip(1);
    let trajectory = args.next().unwrap();
    let cameras: Vec<[f64; 3]> = monogrid_datasets::read_trajectory(trajectory.as_ref())
        .unwrap()
        .iter()
        .map(|p| p.world_from_camera.translation.into())
        .collect();
    let sequence =
        SynthSequence::built_in("living-room", Carrier::Hand, SynthConfig::demo()).unwrap();
    let mesh = sequence.world().mesh();
    let triangles: Vec<_> = mesh
        .triangles
        .iter()
        .map(|t| t.map(|i| mesh.vertices[i as usize].map(f64::from)))
        .collect();
    for path in args {
        let map = read_ot(File::open(&path).unwrap(), usize::MAX).unwrap();
        let config = TruthConfig::with_resolution(map.resolution());
        let truth = truth_from_triangles(&triangles, &cameras, &config).unwrap();
        let report = evaluate_map(&map, &truth.grid, &MapEvaluationConfig::default()).unwrap();
        let (o, k) = (&report.policies.observed, &report.policies.known);
        println!(
            "{path}: {} m, observed AUC {:.4} MCC {:.3} precision {:.3} recall {:.3}, known AUC {:.3}, coverage free {:.3} occupied {:.3}, surface {:?}",
            map.resolution(),
            o.auc,
            o.mcc,
            o.precision,
            o.recall,
            k.auc,
            report.coverage_free,
            report.coverage_occupied,
            report.surface
        );
    }
}
