//! Optimisation around what is new, against that of everything.
#![allow(clippy::unwrap_used, reason = "a test fails where it unwraps")]

use super::*;
use crate::graph::job::EdgeKind;
use crate::graph::keyframe_graph::edges::CERTAIN;
use crate::graph::keyframe_graph::tests::map_of;
use crate::{MAIN_MAP, SlamConfig};
use monogrid_geometry::{Mat7, Pinhole, Sim3, Vec7};

const LEN: usize = 120;

fn along(x: f64) -> Sim3 {
    Sim3::exp(&Vec7::from_column_slice(&[x, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
}

/// A straight way, each keyframe a unit from the one before and tied to the last three.
fn way(window: usize) -> KeyframeGraph {
    let mut config = SlamConfig::default();
    config.graph.window = window;
    config.graph.max_iterations = 100;
    let pinhole = Pinhole::new(300.0, 300.0, 160.0, 120.0);
    let mut graph = KeyframeGraph::new(&config, pinhole, None).unwrap();
    let poses: Vec<Sim3> = (0..LEN).map(|k| along(k as f64)).collect();
    graph.poses = crate::PoseSnapshot::clone(&map_of(&poses));
    graph.poses.fragment.resize(LEN, MAIN_MAP);
    for j in 1..LEN as KeyframeId {
        for i in j.saturating_sub(3)..j {
            tie(&mut graph, i, j, f64::from(j - i));
        }
    }
    graph.edges.judge(|_| true);
    graph
}

/// An edge that has a keyframe this far ahead of another.
fn tie(graph: &mut KeyframeGraph, i: KeyframeId, j: KeyframeId, distance: f64) {
    let information = Mat7::identity() / 0.01_f64.powi(2);
    graph.set_edge(
        (i, j, EdgeKind::Sparse),
        along(distance),
        information,
        CERTAIN,
    );
}

fn largest_difference(a: &KeyframeGraph, b: &KeyframeGraph) -> f64 {
    let pairs = a
        .poses
        .world_from_keyframe
        .iter()
        .zip(&b.poses.world_from_keyframe);
    pairs.fold(0.0, |worst: f64, (a, b)| {
        worst.max((a.inverse() * *b).log().norm())
    })
}

/// How far keyframes were moved.
fn moves(graph: &KeyframeGraph) -> Vec<f64> {
    let poses = graph.poses.world_from_keyframe.iter().enumerate();
    poses
        .map(|(k, pose)| (pose.translation.x - k as f64).abs())
        .collect()
}

#[test]
fn a_window_holds_what_changed_what_is_newest_and_what_is_nearest() {
    let graph = way(20);
    let window = graph.window(MAIN_MAP, [50], 20).unwrap();
    assert_eq!(window.free.len(), 20);
    let newest = (LEN - NEWEST) as KeyframeId..LEN as KeyframeId;
    assert!(newest.clone().all(|id| window.free.contains(&id)));
    assert!(window.free.contains(&50));
    // seven more, none of them farther than three from these
    let far = |id: &&KeyframeId| **id < newest.start - 3 && id.abs_diff(50) > 3;
    assert_eq!(window.free.iter().filter(far).count(), 0, "{window:?}");
    for id in &window.free {
        for other in graph.neighbours(*id, MAIN_MAP) {
            assert!(window.free.contains(&other) != window.border.contains(&other));
        }
    }
    assert_eq!(graph.window(MAIN_MAP, [], LEN), None, "all of them");
    assert_eq!(
        graph.window(MAIN_MAP, 0..20, 20),
        None,
        "too much has changed"
    );
    assert_eq!(graph.window(1, [], 20), None, "nothing there");
}

#[test]
fn edges_are_found_from_both_ends_until_they_are_removed() {
    let mut graph = way(20);
    assert_eq!(
        graph.neighbours(50, MAIN_MAP),
        [47, 48, 49, 51, 52, 53].into()
    );
    graph.edges.remove(&(47, 50, EdgeKind::Sparse));
    graph.edges.remove(&(50, 52, EdgeKind::Sparse));
    assert_eq!(graph.neighbours(50, MAIN_MAP), [48, 49, 51, 53].into());
    graph.poses.fragment[51] = 1;
    assert_eq!(graph.neighbours(50, MAIN_MAP), [48, 49, 53].into());
}

#[test]
fn what_changes_near_the_end_moves_the_end_alone_and_as_in_the_whole() {
    let (mut windowed, mut whole) = (way(40), way(LEN));
    for graph in [&mut windowed, &mut whole] {
        tie(graph, 110, 119, 9.03);
        graph.optimise(Search::Near);
    }
    assert!(largest_difference(&windowed, &whole) < 1e-4);
    let moved = moves(&windowed);
    assert!(moved[119] > 0.005, "{}", moved[119]);
    assert!(moved[..LEN - 40].iter().all(|m| *m == 0.0));
}

#[test]
fn what_strains_the_keyframes_around_the_window_spreads_to_all() {
    let (mut windowed, mut whole) = (way(40), way(LEN));
    for graph in [&mut windowed, &mut whole] {
        // shorter than the way by as much as each of its steps can give way
        tie(graph, 10, 119, 108.0);
        graph.optimise(Search::Near);
    }
    let moved = moves(&windowed);
    assert!(moved[60] > 0.1, "the middle of the loop: {}", moved[60]);
    assert!(largest_difference(&windowed, &whole) < 0.01);
}

#[test]
fn a_closed_loop_moves_everything_at_once() {
    let (mut windowed, mut whole) = (way(40), way(LEN));
    for graph in [&mut windowed, &mut whole] {
        tie(graph, 10, 119, 108.9);
        graph.optimise(Search::Wide);
    }
    let poses = |graph: &KeyframeGraph| graph.poses.world_from_keyframe.clone();
    assert_eq!(poses(&windowed), poses(&whole));
    assert!(windowed.edges.new_ones().is_empty());
}

#[test]
fn newest_covariances_hardly_depend_on_the_window() {
    let (mut windowed, mut whole) = (way(40), way(LEN));
    for graph in [&mut windowed, &mut whole] {
        graph.update_covariances(false);
    }
    let of = |graph: &KeyframeGraph| graph.poses.previous_from_keyframe_covariance.clone();
    for (id, (a, b)) in of(&windowed).iter().zip(&of(&whole)).enumerate() {
        assert_eq!(a.is_some(), id >= LEN - NEWEST);
        let (Some(a), Some(b)) = (a, b) else {
            continue;
        };
        assert!((a - b).norm() < 1e-3 * b.norm(), "{id}: {a} {b}");
    }
}

#[test]
fn edges_are_told_of_once() {
    let mut graph = way(20);
    let all = graph.edges.take_changes();
    assert_eq!((all.set.len(), all.removed.len()), (3 * LEN - 6, 0));
    assert!(
        all.set
            .iter()
            .all(|e| graph.edges.get(&e.key()) == Some(&e.edge))
    );
    tie(&mut graph, 1, 2, 1.1);
    graph.edges.remove(&(4, 5, EdgeKind::Sparse));
    graph.edges.remove(&(4, 5, EdgeKind::Direct));
    let changes = graph.edges.take_changes();
    assert_eq!((changes.set.len(), changes.set[0].edge.j), (1, 2));
    assert_eq!(changes.removed, [(4, 5, EdgeKind::Sparse)]);
}
