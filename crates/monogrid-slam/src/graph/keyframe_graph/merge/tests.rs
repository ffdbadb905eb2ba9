//! Which fragments are joined, and with which cameras.
#![allow(clippy::unwrap_used, reason = "a test fails where it unwraps")]

use super::super::tests::{error, keyframes, map_of};
use super::*;
use crate::KeyframeCamera;
use crate::graph::RestoredGraph;
use crate::graph::job::Joined;
use crate::store::Store;
use crate::test_world::small_demo;
use crate::view::{KeyframeImage, View};
use crate::{PoseSnapshot, SlamConfig};
use monogrid_alignment::DepthPixel;
use monogrid_geometry::{Pinhole, Vec7};
use monogrid_image::GrayImage;
use std::sync::Arc;

/// Pixels that the second camera does not have at the left and at the top.
const CUT: [usize; 2] = [40, 24];

/// The same keyframe by a camera that sees less, with another centre.
fn cut(view: &View) -> View {
    let pyramid = view.image.pyramid().unwrap();
    let image = pyramid.level(0);
    let [left, top] = CUT;
    let (width, height) = (image.width() - left - 16, image.height() - top);
    let Pinhole { fx, fy, cx, cy } = view.camera.pinhole;
    let samples = view.samples.get().unwrap();
    let samples = samples.iter().filter_map(|sample| {
        let x = usize::from(sample.x).checked_sub(left)?;
        let y = usize::from(sample.y).checked_sub(top)?;
        (x < width).then_some(DepthPixel {
            x: x as u16,
            y: y as u16,
            ..*sample
        })
    });
    View {
        camera: KeyframeCamera::new(
            Pinhole::new(fx, fy, cx - left as f64, cy - top as f64),
            (width, height),
        ),
        samples: Store::default().keep(samples.collect()),
        image: KeyframeImage::new(
            &Store::default(),
            &GrayImage::from_fn(width, height, |x, y| image.at(x + left, y + top)),
        ),
        ..view.clone()
    }
}

/// The same keyframe in another room: what it shows is upside down, at the same depths.
fn elsewhere(view: &View) -> View {
    let pyramid = view.image.pyramid().unwrap();
    let image = pyramid.level(0);
    let (width, height) = (image.width(), image.height());
    View {
        image: KeyframeImage::new(
            &Store::default(),
            &GrayImage::from_fn(width, height, |x, y| {
                image.at(width - 1 - x, height - 1 - y)
            }),
        ),
        ..view.clone()
    }
}

/// Where the second fragment has its world.
fn fragment_from_world() -> Sim3 {
    Sim3::exp(&Vec7::from_column_slice(&[
        1.3, -0.4, 0.8, 0.3, 0.9, -0.2, 0.7,
    ]))
}

/// Eight keyframes of a room as two fragments of four, the second changed by `change` and in a
/// world of its own; the true poses.
fn two_fragments(change: fn(&View) -> View) -> (KeyframeGraph, Vec<Sim3>) {
    let (views, truth) = keyframes(small_demo(), 8, 8);
    let views = views.iter().map(|view| match view.id {
        0..4 => Arc::clone(view),
        _ => Arc::new(change(view)),
    });
    let pinhole = small_demo().camera().pinhole;
    let mut graph = KeyframeGraph::new(&SlamConfig::default(), pinhole, None).unwrap();
    let mut poses = truth.clone();
    for pose in &mut poses[4..] {
        *pose = fragment_from_world() * *pose;
    }
    let mut snapshot = PoseSnapshot::clone(&map_of(&poses));
    snapshot.fragment = vec![0, 0, 0, 0, 1, 1, 1, 1];
    snapshot.parent[4] = None;
    graph.restore(RestoredGraph {
        views: views.collect(),
        poses: Arc::new(snapshot),
        edges: Vec::new(),
    });
    (graph, truth)
}

#[test]
fn fragments_of_two_cameras_that_show_the_same_room_are_joined() {
    let (mut graph, truth) = two_fragments(cut);
    let (update, meetings) = graph.merge(&MergeConfig::default());
    assert_eq!(update.joined, [Joined { from: 1, into: 0 }]);
    assert_eq!(update.poses.fragment, [0; 8]);
    assert_eq!(meetings.len(), 1);
    assert!(
        meetings[0].is_enough(&MergeConfig::default()),
        "{meetings:?}"
    );
    let after = error(&update.poses.world_from_keyframe, &truth);
    assert!(after.0 < 0.02 && after.1 < 0.02, "{after:?}");
    // keyframes of both are held together by what was aligned
    let between = |e: &&crate::StoredEdge| e.edge.i < 4 && e.edge.j >= 4;
    assert!(update.edges.set.iter().filter(between).count() >= 2);
}

#[test]
fn a_fragment_that_shows_another_room_stays_as_it_is() {
    let (mut graph, truth) = two_fragments(elsewhere);
    let (update, meetings) = graph.merge(&MergeConfig::default());
    assert_eq!(update.joined, []);
    assert_eq!(update.poses.fragment, [0, 0, 0, 0, 1, 1, 1, 1]);
    assert!(meetings.iter().all(|m| m.agreeing.keyframes < 2));
    let apart: Vec<Sim3> = truth[4..]
        .iter()
        .map(|t| fragment_from_world() * *t)
        .collect();
    let after = error(&update.poses.world_from_keyframe[4..], &apart);
    assert!(after.0 < 0.02 && after.1 < 0.02, "{after:?}");
}

/// What two fragments have in common where keyframes of the first and of the second, in pairs, say
/// that the second is off by so much.
fn met(pairs: &[(KeyframeId, KeyframeId, f64)]) -> Consistent {
    let (mut graph, truth) = two_fragments(View::clone);
    graph.sightings = pairs
        .iter()
        .map(|(other, own, off)| {
            let off = [*off, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
            let off = Sim3::exp(&Vec7::from_column_slice(&off));
            let said = truth[*other as usize].inverse() * off * truth[*own as usize];
            Sighting::new(*other, *own, said, None)
        })
        .collect();
    graph.consistent_pairs().remove(0)
}

#[test]
fn sightings_count_by_their_largest_consistent_set_and_its_keyframes_on_both_sides() {
    let right = [(0, 4, 0.0), (1, 5, 0.0), (2, 6, 0.0)];
    let wrong = [(0, 5, 3.0), (3, 6, 3.0)];
    let found = met(&[&wrong[..], &right[..]].concat());
    assert_eq!(found.meeting.sightings, 5);
    assert_eq!(found.meeting.agreeing.keyframes, 3);
    assert_eq!(found.meeting.contradicting.keyframes, 2);
    let agreeing: Vec<_> = found.agreeing.iter().map(|s| (s.other, s.own)).collect();
    assert_eq!(agreeing, [(0, 4), (1, 5), (2, 6)]);
    // three keyframes that recognise a single one are one view of one thing
    let one = met(&[(0, 4, 0.0), (0, 5, 0.0), (0, 6, 0.0)]);
    assert_eq!(one.meeting.agreeing.keyframes, 1);
    // three that contradict each other agree about nothing
    let none = met(&[(0, 4, 0.0), (1, 5, 3.0), (2, 6, -3.0)]);
    assert_eq!(none.meeting.agreeing.keyframes, 1);
    assert_eq!(none.meeting.contradicting.keyframes, 1);
}

#[test]
fn the_largest_set_of_nodes_that_are_all_linked_is_found() {
    let mut links = vec![vec![false; 7]; 7];
    // a triangle at a node with many links, and a set of four
    let pairs = [
        [(0, 1), (0, 2), (1, 2), (0, 3), (0, 4), (0, 5)],
        [(0, 6), (3, 4), (3, 5), (3, 6), (4, 5), (4, 6)],
    ];
    for (i, j) in pairs.concat() {
        (links[i][j], links[j][i]) = (true, true);
    }
    let all = [0, 1, 2, 3, 4, 5, 6];
    assert_eq!(largest_clique(&links, &all), [0, 3, 4, 5]);
    assert_eq!(largest_clique(&links, &[1, 2, 6]), [1, 2]);
    assert_eq!(largest_clique(&links, &[]), [0usize; 0]);
}
