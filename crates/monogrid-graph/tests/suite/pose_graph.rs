//! The pose graph against truth, against a dense solver with numeric derivatives, and against
//! itself.

#![allow(
    clippy::unwrap_used,
    reason = "helpers outside test functions unwrap too"
)]

use crate::common::Random;
use crate::common::graphs::{GraphOptions, RandomGraph, Wrong, random_graph};
use monogrid_geometry::nalgebra::{DMatrix, DVector};
use monogrid_geometry::{Mat7, Sim3, Vec7};
use monogrid_graph::RobustKernel;
use monogrid_graph::g2o;
use monogrid_graph::pose_graph::{
    GraphEdge, GraphNode, GraphOutcome, PoseGraph, PoseGraphConfig, PoseGraphError,
};

fn options(seed: u64) -> GraphOptions {
    let mut random = Random(seed ^ 0xabcd);
    GraphOptions {
        nodes: 20 + random.below(60),
        near: 2,
        closures: 0.5 + random.uniform(),
        wrong_share: 0.1,
        wrong: Wrong::Closures,
        seed,
    }
}

fn converges(seed: u64, wrong: Wrong) -> Result<(), String> {
    let mut g = random_graph(&GraphOptions {
        wrong,
        ..options(seed)
    });
    let report = g.graph.optimise(&PoseGraphConfig::default()).unwrap();
    assert!(report.final_cost <= report.initial_cost);
    let error = g.rms_error();
    let (_, scale) = g.worst_errors();
    if error < 0.01 && scale < 0.05 {
        return Ok(());
    }
    Err(format!("seed {seed}: error {error}, scale {scale}"))
}

#[test]
fn random_graphs_with_a_tenth_of_wrong_closures_find_the_truth() {
    for seed in 0..60 {
        assert_eq!(converges(seed, Wrong::Closures), Ok(()));
    }
}

#[test]
#[ignore = "minutes, even in release: cargo test --release -p monogrid-graph -- --ignored"]
fn a_thousand_random_graphs_with_wrong_edges_find_the_truth() {
    for seed in 0..1000 {
        assert_eq!(converges(seed, Wrong::Closures), Ok(()));
    }
    // With odometry wrong as well, wrong measurements can agree with each other by chance.
    let failures = (0..1000).filter(|&seed| converges(seed, Wrong::Anywhere).is_err());
    assert!(failures.count() <= 3);
}

#[test]
fn wrong_edges_are_told_from_right_ones() {
    let (mut wrong, mut right) = (0, 0);
    for seed in 100..110 {
        let mut g = random_graph(&options(seed));
        let report = g.graph.optimise(&PoseGraphConfig::default()).unwrap();
        for (fit, &is_wrong) in report.edges.iter().zip(&g.is_wrong) {
            assert_eq!(fit.weight < 0.2, is_wrong, "seed {seed}: {fit:?}");
            wrong += usize::from(is_wrong);
            right += usize::from(!is_wrong);
        }
    }
    assert!(wrong > 50 && right > 500, "{wrong} and {right}");
}

/// Gauss-Newton on the stated cost with dense matrices and numeric derivatives, first node held.
fn dense_solution(graph: &PoseGraph) -> Vec<Sim3> {
    let mut poses: Vec<_> = graph
        .nodes()
        .iter()
        .map(|n| n.world_from_keyframe)
        .collect();
    let n = 7 * (poses.len() - 1);
    let residuals = |poses: &[Sim3]| {
        let mut out = vec![];
        for e in graph.edges() {
            let (a, b) = (poses[e.i as usize], poses[e.j as usize]);
            let r = (a.inverse() * b * e.i_from_j.inverse()).log();
            let root = e.information.cholesky().unwrap().l().transpose();
            out.extend((root * r).iter().copied());
        }
        DVector::from_vec(out)
    };
    for _ in 0..20 {
        let r = residuals(&poses);
        let mut j = DMatrix::zeros(r.len(), n);
        for k in 0..n {
            let h = 1e-6;
            let moved = |h: f64| {
                let mut d = Vec7::zeros();
                d[k % 7] = h;
                let mut moved = poses.clone();
                moved[1 + k / 7] = Sim3::exp(&d) * moved[1 + k / 7];
                residuals(&moved)
            };
            j.set_column(k, &((moved(h) - moved(-h)) / (2.0 * h)));
        }
        let step = (j.transpose() * &j)
            .cholesky()
            .unwrap()
            .solve(&(-j.transpose() * r));
        for (k, pose) in poses.iter_mut().skip(1).enumerate() {
            let d: Vec7 = step.fixed_rows::<7>(7 * k).into_owned();
            *pose = Sim3::exp(&d) * *pose;
        }
    }
    poses
}

fn plain(nodes: usize, seed: u64) -> RandomGraph {
    let mut g = random_graph(&GraphOptions {
        nodes,
        wrong_share: 0.0,
        closures: 0.5,
        ..options(seed)
    });
    let mut same = PoseGraph::new();
    for node in g.graph.nodes() {
        same.add_node(*node).unwrap();
    }
    for (k, edge) in g.graph.edges().iter().enumerate() {
        // A full, different information for every edge.
        let mut random = Random(k as u64);
        let square = Mat7::from_fn(|_, _| 30.0 * random.signed());
        let information = edge.information + square * square.transpose();
        same.add_edge(GraphEdge {
            kernel: RobustKernel::None,
            information,
            ..*edge
        })
        .unwrap();
    }
    g.graph = same;
    g
}

#[test]
fn sparse_solution_equals_a_dense_one_with_numeric_derivatives() {
    for seed in 0..3 {
        let mut g = plain(8, seed);
        let expected = dense_solution(&g.graph);
        let config = PoseGraphConfig {
            max_iterations: 100,
            min_relative_decrease: 1e-14,
            ..PoseGraphConfig::default()
        };
        g.graph.optimise(&config).unwrap();
        for (node, pose) in g.graph.nodes().iter().zip(&expected) {
            let error = (node.world_from_keyframe * pose.inverse()).log().norm();
            assert!(error < 1e-6, "keyframe {}: {error:e}", node.id);
        }
    }
}

#[test]
fn covariances_equal_the_scatter_of_solutions() {
    // Same graph, many noises: the relative pose of two keyframes scatters as the graph says.
    let (mut sum, mut count) = (0.0, 0.0);
    for seed in 0..150 {
        let mut g = random_graph(&GraphOptions {
            nodes: 12,
            near: 1,
            closures: 0.3,
            wrong_share: 0.0,
            wrong: Wrong::Closures,
            seed,
        });
        g.graph.optimise(&PoseGraphConfig::default()).unwrap();
        let uncertainty = g.graph.uncertainty().unwrap();
        for (i, j) in [(0_usize, 11_usize), (4, 5), (9, 3)] {
            let pose = |k: usize| g.graph.pose(k as u64).unwrap();
            let found = pose(i).inverse() * pose(j);
            let error = (g.truth[i].inverse() * g.truth[j] * found.inverse()).log();
            let covariance = uncertainty.relative(i as u64, j as u64).unwrap();
            let information = covariance.try_inverse().unwrap();
            sum += error.dot(&(information * error));
            count += 7.0;
        }
        assert_eq!(uncertainty.absolute(0).unwrap(), Mat7::zeros());
        assert!(uncertainty.absolute(99).is_err());
    }
    let normalised = sum / count;
    assert!(
        (normalised - 1.0).abs() < 0.1,
        "mean normalised squared error {normalised}"
    );
}

#[test]
fn closure_after_drift_restores_the_scale() {
    // Odometry that loses one percent of scale per keyframe, around a circle, closed once.
    let n = 60_usize;
    let truth: Vec<Sim3> = (0..n)
        .map(|k| {
            let a = k as f64 / n as f64 * std::f64::consts::TAU;
            let w = monogrid_geometry::Vec3::new(0.0, -a, 0.0);
            let rotation = monogrid_geometry::rotation_exp(&w);
            let t = monogrid_geometry::Vec3::new(5.0 * a.cos(), 0.0, 5.0 * a.sin());
            Sim3::new(1.0, rotation, t)
        })
        .collect();
    let mut graph = PoseGraph::new();
    let drift = Sim3::exp(&Vec7::from([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -0.01]));
    let mut pose = truth[0];
    for k in 0..n {
        if k > 0 {
            pose = pose * (truth[k - 1].inverse() * truth[k]) * drift;
        }
        let node = GraphNode {
            id: k as u64,
            world_from_keyframe: pose,
            is_fixed: k == 0,
        };
        graph.add_node(node).unwrap();
    }
    let mut information = Mat7::identity() * 1e4;
    information[(6, 6)] = 1e3;
    for k in 1..n {
        let edge = GraphEdge {
            i: k as u64 - 1,
            j: k as u64,
            i_from_j: truth[k - 1].inverse() * truth[k] * drift,
            information,
            kernel: RobustKernel::Huber { delta: 5.0 },
        };
        graph.add_edge(edge).unwrap();
    }
    graph.optimise(&PoseGraphConfig::default()).unwrap();
    let scale = |graph: &PoseGraph| graph.pose(n as u64 - 1).unwrap().scale;
    assert!(scale(&graph) < 0.6, "nothing but the closure can know");
    let closure = GraphEdge {
        i: 0,
        j: n as u64 - 1,
        i_from_j: truth[0].inverse() * truth[n - 1],
        information: Mat7::identity() * 1e5,
        kernel: RobustKernel::DynamicCovariance { phi: 20.0 },
    };
    graph.add_edge(closure).unwrap();
    let report = graph.optimise(&PoseGraphConfig::default()).unwrap();
    assert!(
        report.edges[n - 1].weight > 0.9,
        "{:?}",
        report.edges[n - 1]
    );
    let scales: Vec<f64> = (0..n as u64)
        .map(|k| graph.pose(k).unwrap().scale)
        .collect();
    let (low, high) = scales
        .iter()
        .fold((f64::MAX, 0.0_f64), |(l, h), &s| (l.min(s), h.max(s)));
    // Each of 60 edges is off by 1 %; the loop leaves no more than a few of them.
    assert!(high / low < 1.05, "scales from {low} to {high}");
}

#[test]
fn every_part_of_a_torn_graph_keeps_one_node() {
    let whole = plain(10, 1).graph;
    let mut graph = PoseGraph::new();
    for node in whole.nodes() {
        graph.add_node(*node).unwrap();
    }
    for edge in whole.edges().iter().filter(|e| (e.i < 5) == (e.j < 5)) {
        graph.add_edge(*edge).unwrap();
    }
    let before = graph.clone();
    let report = graph.optimise(&PoseGraphConfig::default()).unwrap();
    assert!(!report.moved[0] && !report.moved[5]);
    assert!(report.moved[1] && report.moved[6]);
    assert_eq!(before.pose(5), graph.pose(5));
}

#[test]
fn fixed_nodes_stay_and_runs_repeat_exactly() {
    let mut g = random_graph(&options(3));
    g.graph.set_fixed(4, true).unwrap();
    g.graph.set_fixed(9, true).unwrap();
    let before = (g.graph.pose(4), g.graph.pose(9));
    let mut twin = g.graph.clone();
    let first = g.graph.optimise(&PoseGraphConfig::default()).unwrap();
    let second = twin.optimise(&PoseGraphConfig::default()).unwrap();
    assert_eq!(first, second);
    assert_eq!(g.graph, twin);
    assert_eq!((g.graph.pose(4), g.graph.pose(9)), before);
}

#[test]
fn strain_is_what_the_cost_falls_when_a_node_alone_gives_way() {
    let RandomGraph { mut graph, .. } = plain(20, 5);
    graph.optimise(&PoseGraphConfig::default()).unwrap();
    let strains = graph.strains();
    // the first is held, yet nothing pushes it: a world can lie anywhere
    assert!(strains.iter().all(|s| *s < 1e-3), "{strains:?}");

    let away = Sim3::exp(&Vec7::from([0.01, -0.02, 0.01, 0.01, 0.0, 0.01, 0.01]));
    let pose = away * graph.pose(7).unwrap();
    graph.set_pose(7, pose).unwrap();
    for id in 0..20 {
        graph.set_fixed(id, true).unwrap();
    }
    let strain = graph.strains()[7];
    graph.set_fixed(7, false).unwrap();
    assert_eq!(graph.strains()[7], strain, "fixed or not");
    let report = graph.optimise(&PoseGraphConfig::default()).unwrap();
    let fallen = report.initial_cost - report.final_cost;
    assert!(
        fallen > 1.0 && (strain / fallen - 1.0).abs() < 0.1,
        "{strain} {fallen}"
    );
}

#[test]
fn graphs_without_anything_to_do_are_left_alone() {
    let mut graph = PoseGraph::new();
    let report = graph.optimise(&PoseGraphConfig::default()).unwrap();
    assert_eq!(report.outcome, GraphOutcome::NothingToDo);
    let mut g = plain(6, 2);
    for id in 0..6 {
        g.graph.set_fixed(id, true).unwrap();
    }
    let report = g.graph.optimise(&PoseGraphConfig::default()).unwrap();
    assert_eq!(report.outcome, GraphOutcome::NothingToDo);
    assert!(g.graph.uncertainty().unwrap().relative(1, 2).unwrap() == Mat7::zeros());
}

#[test]
fn bad_input_is_refused_by_name() {
    let mut g = plain(5, 3);
    let node = g.graph.nodes()[2];
    assert_eq!(
        g.graph.add_node(node),
        Err(PoseGraphError::Duplicate { id: 2 })
    );
    let good = g.graph.edges()[0];
    let unknown = GraphEdge { j: 77, ..good };
    assert_eq!(
        g.graph.add_edge(unknown),
        Err(PoseGraphError::Unknown { id: 77 })
    );
    let itself = GraphEdge { j: good.i, ..good };
    assert_eq!(
        g.graph.add_edge(itself),
        Err(PoseGraphError::Loop { id: good.i })
    );
    let mut collapse = good;
    collapse.i_from_j.scale = 1e-3;
    assert!(matches!(
        g.graph.add_edge(collapse),
        Err(PoseGraphError::Scale { .. })
    ));
    let mut negative = good;
    negative.information[(3, 3)] = -1.0;
    assert!(matches!(
        g.graph.add_edge(negative),
        Err(PoseGraphError::Information { .. })
    ));
    let nan = Sim3::new(
        f64::NAN,
        node.world_from_keyframe.rotation,
        good.i_from_j.translation,
    );
    assert!(g.graph.set_pose(0, nan).is_err());
}

#[test]
fn g2o_round_trips_bit_for_bit() {
    let mut g = random_graph(&options(5));
    g.graph.set_fixed(3, true).unwrap();
    let text = g2o::write(&g.graph);
    let file = g2o::read(&text, RobustKernel::DynamicCovariance { phi: 20.0 }).unwrap();
    assert_eq!(file.graph.nodes(), g.graph.nodes());
    assert_eq!(file.graph.edges(), g.graph.edges());
    assert!(file.skipped_tags.is_empty());
    assert_eq!(g2o::write(&file.graph), text);
}

#[test]
fn rigid_g2o_edges_have_g2os_own_error() {
    // chi2 of a read edge equals e' I e with e = [t, q_xyz] of M^-1 T_i^-1 T_j, for small errors.
    let mut random = Random(4);
    let mut text = String::new();
    let poses: Vec<Sim3> = (0..2)
        .map(|_| {
            Sim3::exp(&Vec7::from_fn(
                |k, _| if k < 6 { random.signed() } else { 0.0 },
            ))
        })
        .collect();
    for (id, t) in poses.iter().enumerate() {
        let (p, q) = (t.translation, t.rotation.coords);
        text += &format!(
            "VERTEX_SE3:QUAT {id} {} {} {} {} {} {} {}\n",
            p.x, p.y, p.z, q.x, q.y, q.z, q.w
        );
    }
    let error = Sim3::exp(&Vec7::from([1e-4, -2e-4, 3e-4, 2e-4, 1e-4, -1e-4, 0.0]));
    let m = poses[0].inverse() * poses[1] * error.inverse();
    let (p, q) = (m.translation, m.rotation.coords);
    text += &format!(
        "EDGE_SE3:QUAT 0 1 {} {} {} {} {} {} {}",
        p.x, p.y, p.z, q.x, q.y, q.z, q.w
    );
    let square = monogrid_geometry::Mat6::from_fn(|_, _| 10.0 * random.signed());
    let information = square * square.transpose();
    for r in 0..6 {
        for c in r..6 {
            text += &format!(" {}", information[(r, c)]);
        }
    }
    text += "\nVERTEX_XY 7 1 2\n# a remark\n";
    let file = g2o::read(&text, RobustKernel::None).unwrap();
    assert_eq!(file.skipped_tags, ["VERTEX_XY"]);
    let (t, q) = (error.translation, error.rotation.coords);
    let e = monogrid_geometry::Vec6::new(t.x, t.y, t.z, q.x, q.y, q.z);
    let expected = e.dot(&(information * e));
    let found = file.graph.edge_fits()[0].chi2;
    assert!(
        (found / expected - 1.0).abs() < 1e-3,
        "{found} instead of {expected}"
    );
    // And out again.
    let back = g2o::read(&g2o::write_rigid(&file.graph), RobustKernel::None).unwrap();
    let (a, b) = (
        back.graph.edges()[0].information,
        file.graph.edges()[0].information,
    );
    assert!((a - b).norm() < 1e-9 * b.norm());
}

#[test]
fn damaged_g2o_files_are_graphs_that_can_be_written_or_errors() {
    let file = g2o::write(&random_graph(&options(6)).graph);
    // All vertices and the first edges.
    let (vertices, edges): (Vec<&str>, Vec<&str>) =
        file.lines().partition(|line| line.starts_with("VERTEX"));
    let lines = vertices.into_iter().chain(edges.into_iter().take(20));
    let file: String = lines.flat_map(|line| [line, "\n"]).collect();
    let words = [
        "nan",
        "-inf",
        "1e999",
        "-1",
        "99999999999999999999",
        "\n",
        " ",
        "#",
    ];
    let mut random = Random(3);
    let (mut accepted, mut refused) = (0, 0);
    for _ in 0..400 {
        let mut text = file.clone().into_bytes();
        for _ in 0..=random.below(3) {
            let at = random.below(text.len());
            let end = (at + random.below(20)).min(text.len());
            match random.below(6) {
                0 => text[at] ^= 1 << random.below(7),
                4 | 5 if text[at].is_ascii_digit() => text[at] = b'0' + random.below(10) as u8,
                1 => drop(text.drain(at..end)),
                2 => text.truncate(at + 1),
                _ => drop(text.splice(at..end, words[random.below(8)].bytes())),
            }
        }
        match g2o::read(&String::from_utf8_lossy(&text), RobustKernel::None) {
            Ok(read) => {
                accepted += 1;
                let again = g2o::read(&g2o::write(&read.graph), RobustKernel::None).unwrap();
                assert_eq!(again.graph.nodes().len(), read.graph.nodes().len());
            }
            Err(error) => {
                refused += 1;
                assert!(!error.to_string().is_empty());
            }
        }
    }
    assert!(
        accepted > 10 && refused > 10,
        "{accepted} accepted, {refused} refused"
    );
}

#[test]
fn broken_g2o_files_say_which_line() {
    let check = |text: &str, part: &str| {
        let message = g2o::read(text, RobustKernel::None).unwrap_err().to_string();
        assert!(message.contains(part), "{message}");
    };
    check(
        "VERTEX_SIM3:QUAT 1 0 0 0 0 0 0 1",
        "line 1: VERTEX_SIM3:QUAT needs 8 numbers, found 7",
    );
    check(
        "\nVERTEX_SE3:QUAT a 0 0 0 0 0 0 1",
        "line 2: keyframe \"a\"",
    );
    check(
        "VERTEX_SE3:QUAT 1 0 0 0 0 0 0 0",
        "quaternion of length zero",
    );
    check("VERTEX_SIM3:QUAT 1 0 0 0 0 0 0 1 -2", "positive scale");
    let edge = "EDGE_SIM3:QUAT 1 2 0 0 0 0 0 0 1 1".to_owned() + &" 1".repeat(28);
    check(&edge, "line 1: keyframe 1 is not in the graph");
}
