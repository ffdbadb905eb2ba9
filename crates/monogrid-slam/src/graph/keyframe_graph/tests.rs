//! The graph on rendered keyframes.
#![allow(clippy::unwrap_used, reason = "a test fails where it unwraps")]

use super::edges::{
    DIRECT_ROTATION_SIGMA, DIRECT_SCALE_SIGMA, DIRECT_TRANSLATION_SHARE, DIRECT_TRANSLATION_SIGMA,
};
use super::*;
use crate::KeyframeCamera;
use crate::graph::SharedPoints;
use crate::graph::job::OdometryEdge;
use crate::store::Store;
use crate::test_world::small_demo;
use crate::view::{Exposure, KeyframeImage};
use monogrid_alignment::{DepthPixel, SimilarityConstraint};
use monogrid_geometry::{Mat6, Mat7, Sim3, Vec7};
use monogrid_image::Mask;
use monogrid_worlds::SynthSequence;

/// Keyframes of a rendered room with exact depth, and their true poses; the unit of keyframe k is
/// `1 + 0.1 k` metres.
pub(super) fn keyframes(
    sequence: &SynthSequence,
    step: usize,
    count: usize,
) -> (Vec<Arc<View>>, Vec<Sim3>) {
    let store = Store::default();
    let mut views = Vec::new();
    let mut poses = Vec::new();
    for k in 0..count {
        let frame = sequence.frame(k * step).unwrap();
        let depth = sequence.depth(k * step).unwrap();
        let unit = 1.0 + 0.1 * k as f32;
        let image = &frame.image;
        let mut samples = Vec::new();
        for y in 2..image.height() - 2 {
            for x in 2..image.width() - 2 {
                let dx = image.at(x + 1, y) - image.at(x - 1, y);
                let dy = image.at(x, y + 1) - image.at(x, y - 1);
                let z = depth.at(x, y);
                if dx.hypot(dy) > 10.0 && z.is_finite() && z > 0.0 {
                    let idepth = unit / z;
                    let idepth_var = (0.01 * idepth).powi(2);
                    let (x, y) = (x as u16, y as u16);
                    samples.push(DepthPixel {
                        x,
                        y,
                        idepth,
                        idepth_var,
                    });
                }
            }
        }
        poses.push(frame.world_from_camera.with_scale(f64::from(unit)));
        views.push(Arc::new(View {
            id: k as KeyframeId,
            camera: KeyframeCamera::new(sequence.camera().pinhole, (image.width(), image.height())),
            image: KeyframeImage::new(&store, image),
            samples: store.keep(samples),
            exposure: Exposure::NEUTRAL,
            has_converged: true,
        }));
    }
    // relative to the first, which holds the world
    let first_from_world = poses[0].inverse();
    (
        views,
        poses.iter().map(|pose| first_from_world * *pose).collect(),
    )
}

fn chain_of(len: usize) -> Vec<Option<KeyframeId>> {
    (0..len as KeyframeId).map(|id| id.checked_sub(1)).collect()
}

/// A map of one fragment, each keyframe tracked on the one before.
pub(super) fn map_of(world_from_keyframe: &[Sim3]) -> Arc<PoseSnapshot> {
    Arc::new(PoseSnapshot {
        world_from_keyframe: world_from_keyframe.to_vec(),
        parent: chain_of(world_from_keyframe.len()),
        ..PoseSnapshot::default()
    })
}

pub(super) fn error(found: &[Sim3], truth: &[Sim3]) -> (f64, f64) {
    let errors = found.iter().zip(truth).map(|(f, t)| {
        let difference = t.inverse() * *f;
        (difference.translation.norm(), difference.scale.ln().abs())
    });
    errors.fold((0.0, 0.0), |worst, e| (worst.0.max(e.0), worst.1.max(e.1)))
}

#[test]
fn constraints_take_out_the_drift_of_position_and_scale() {
    let sequence = small_demo();
    let camera = sequence.camera();
    let (views, truth) = keyframes(sequence, 8, 8);
    let drift = Sim3::exp(&Vec7::from_column_slice(&[
        0.006, -0.004, 0.005, 0.002, 0.003, -0.002, 0.03,
    ]));
    let mask = Mask::filled(camera.width, camera.height, 255);
    let mut graph = KeyframeGraph::new(&SlamConfig::default(), camera.pinhole, Some(mask)).unwrap();
    let mut poses = vec![truth[0]];
    let mut chain = vec![truth[0]];
    let mut stats = GraphStats::default();
    for (k, view) in views.iter().enumerate() {
        let job = |world_from_keyframe: &[Sim3], link| GraphJob {
            finished: Some(Arc::clone(view)),
            poses: map_of(world_from_keyframe),
            link,
            ..GraphJob::default()
        };
        let link = (k + 1 < views.len()).then(|| {
            let previous_from_keyframe = truth[k].inverse() * truth[k + 1] * drift;
            poses.push(poses[k] * previous_from_keyframe);
            chain.push(chain[k] * previous_from_keyframe);
            Link::Odometry(OdometryEdge {
                i: k as KeyframeId,
                j: k as KeyframeId + 1,
                i_from_j: previous_from_keyframe,
                covariance: Mat6::identity() * 1e-4,
                scale_sigma: 0.05,
            })
        });
        let update = graph.run(job(&poses, link.unwrap_or_default()));
        poses = update.poses.world_from_keyframe.clone();
        stats = update.stats;
        assert!(
            update
                .poses
                .previous_from_keyframe_covariance
                .iter()
                .skip(1)
                .all(Option::is_some)
        );
    }
    let (before, after) = (error(&chain, &truth), error(&poses, &truth));
    assert!(stats.constraints >= 10, "{stats:?}");
    assert!(before.0 > 0.04 && before.1 > 0.19, "{before:?}");
    assert!(after.0 < 0.01 && after.1 < 0.01, "{before:?} {after:?}");
}

#[test]
fn a_keyframe_of_another_room_is_not_constrained() {
    let sequence = small_demo();
    let camera = sequence.camera();
    let (mut views, poses) = keyframes(sequence, 8, 2);
    // the depth of the first, the image upside down
    let image = views[0].image.pyramid().unwrap().level(0).clone();
    let (width, height) = (image.width(), image.height());
    let turned = monogrid_image::GrayImage::from_fn(width, height, |x, y| {
        image.at(width - 1 - x, height - 1 - y)
    });
    views[1] = Arc::new(View {
        image: KeyframeImage::new(&Store::default(), &turned),
        ..View::clone(&views[1])
    });
    let mask = Mask::filled(width, height, 255);
    let mut graph = KeyframeGraph::new(&SlamConfig::default(), camera.pinhole, Some(mask)).unwrap();
    let mut last = GraphUpdate::default();
    for view in views {
        last = graph.run(GraphJob {
            finished: Some(view),
            poses: map_of(&poses),
            ..GraphJob::default()
        });
    }
    assert_eq!((last.stats.pairs_tried, last.stats.constraints), (1, 0));
    assert_eq!(
        last.poses.world_from_keyframe, poses,
        "nothing to move them"
    );
}

/// Keyframes of one room as two fragments, the second in a world of its own; what comes of the last
/// job.
fn two_fragments(config: FragmentConfig) -> (GraphUpdate, Vec<Sim3>, Sim3) {
    let sequence = small_demo();
    let camera = sequence.camera();
    let (views, truth) = keyframes(sequence, 8, 8);
    let mask = Mask::filled(camera.width, camera.height, 255);
    let config = SlamConfig {
        fragments: config,
        ..SlamConfig::default()
    };
    let mut graph = KeyframeGraph::new(&config, camera.pinhole, Some(mask)).unwrap();
    let fragment_from_world = Sim3::exp(&Vec7::from_column_slice(&[
        1.3, -0.4, 0.8, 0.3, 0.9, -0.2, 0.7,
    ]));
    let fragments = [0, 0, 0, 0, 1, 1, 1, 1];
    let mut poses: Vec<Sim3> = truth
        .iter()
        .zip(fragments)
        .map(|(pose, fragment)| match fragment {
            0 => *pose,
            _ => fragment_from_world * *pose,
        })
        .collect();
    let parents = [
        None,
        Some(0),
        Some(1),
        Some(2),
        None,
        Some(4),
        Some(5),
        Some(6),
    ];
    let mut fragments = fragments.to_vec();
    let mut joined = Vec::new();
    let mut last = GraphUpdate::default();
    for view in views {
        let id = view.id as usize;
        last = graph.run(GraphJob {
            finished: Some(view),
            poses: Arc::new(PoseSnapshot {
                world_from_keyframe: poses[..=id].to_vec(),
                parent: parents[..=id].to_vec(),
                fragment: fragments[..=id].to_vec(),
                ..PoseSnapshot::default()
            }),
            ..GraphJob::default()
        });
        // later keyframes of the fragment are where it is now
        let moved = last.poses.world_from_keyframe[id] * poses[id].inverse();
        let own = fragments[id];
        for later in id + 1..poses.len() {
            if fragments[later] == own && !last.joined.is_empty() {
                poses[later] = moved * poses[later];
                fragments[later] = last.poses.fragment[id];
            }
        }
        poses[..=id].clone_from_slice(&last.poses.world_from_keyframe);
        fragments[..=id].clone_from_slice(&last.poses.fragment);
        joined.append(&mut last.joined);
    }
    last.joined = joined;
    (last, truth, fragment_from_world)
}

#[test]
fn a_fragment_joins_where_several_keyframes_say_that_it_is() {
    let (update, truth, _) = two_fragments(FragmentConfig::default());
    assert_eq!(update.joined, [Joined { from: 1, into: 0 }]);
    assert_eq!(update.poses.fragment, [0; 8]);
    assert!(update.stats.loop_closures >= 2);
    let after = error(&update.poses.world_from_keyframe, &truth);
    assert!(after.0 < 0.02 && after.1 < 0.02, "{after:?}");
}

#[test]
fn a_fragment_that_too_few_keyframes_recognise_stays_where_it_is() {
    let (update, truth, fragment_from_world) = two_fragments(FragmentConfig {
        min_agreeing: 20,
        ..FragmentConfig::default()
    });
    assert_eq!(update.joined, []);
    assert_eq!(update.poses.fragment, [0, 0, 0, 0, 1, 1, 1, 1]);
    let (main, fragment) = update.poses.world_from_keyframe.split_at(4);
    let expected: Vec<Sim3> = truth[4..]
        .iter()
        .map(|t| fragment_from_world * *t)
        .collect();
    let (in_main, in_fragment) = (error(main, &truth[..4]), error(fragment, &expected));
    assert!(in_main.0 < 0.01 && in_main.1 < 0.01, "{in_main:?}");
    // twice the unit: errors in its own length
    assert!(
        in_fragment.0 < 0.02 && in_fragment.1 < 0.01,
        "{in_fragment:?}"
    );
}

/// A graph with two keyframes, the second one median depth beside the first.
fn two_keyframes() -> KeyframeGraph {
    let mask = Mask::filled(320, 240, 255);
    let pinhole = monogrid_geometry::Pinhole::new(300.0, 300.0, 160.0, 120.0);
    let mut graph = KeyframeGraph::new(&SlamConfig::default(), pinhole, Some(mask)).unwrap();
    let aside = Sim3::exp(&Vec7::from_column_slice(&[
        1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
    ]));
    graph.poses = PoseSnapshot::clone(&map_of(&[Sim3::identity(), aside]));
    graph
}

/// A measurement of the second keyframe in the first that is off by this much along the way, and
/// very sure.
fn measured(graph: &KeyframeGraph, off: f64) -> SimilarityConstraint {
    let error = Vec7::from_column_slice(&[off, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    SimilarityConstraint {
        b_from_a: graph.relative(0, 1) * Sim3::exp(&error),
        information: Mat7::identity() * 1e12,
        reciprocal_chi_sq: 0.0,
        visible_share: 1.0,
    }
}

#[test]
fn a_loop_is_certain_only_as_far_as_drift_explains_it() {
    let drift = GraphConfig::default().places.drift;
    let limit = drift.translation_start + drift.translation_share;
    for (off, is_certain) in [(0.9 * limit, true), (1.1 * limit, false), (1.0, false)] {
        let mut graph = two_keyframes();
        let constraint = measured(&graph, off);
        graph.close_loop(0, 1, &constraint);
        let kernel = graph.edges.get(&(0, 1, EdgeKind::Direct)).unwrap().kernel;
        assert_eq!(kernel, graph.kernel(is_certain), "off by {off}");
    }
}

#[test]
fn no_edge_is_surer_than_the_errors_that_its_residuals_do_not_show() {
    let mut graph = two_keyframes();
    let constraint = measured(&graph, 0.0);
    graph.set_direct_edge(0, 1, &constraint, true);
    let edge = *graph.edges.get(&(0, 1, EdgeKind::Direct)).unwrap();
    let sigmas = edge
        .information
        .try_inverse()
        .unwrap()
        .diagonal()
        .map(f64::sqrt);
    let translation = DIRECT_TRANSLATION_SIGMA.hypot(DIRECT_TRANSLATION_SHARE);
    for k in 0..7 {
        let expected = match k {
            0..3 => translation,
            3..6 => DIRECT_ROTATION_SIGMA,
            _ => DIRECT_SCALE_SIGMA,
        };
        let share = sigmas[k] / expected;
        assert!((share - 1.0).abs() < 1e-3, "{k}: {sigmas} {expected}");
    }
    // what is held without a measurement is not surer either
    graph.hold(0, 1);
    let held = *graph.edges.get(&(0, 1, EdgeKind::Odometry)).unwrap();
    assert!((held.information - edge.information).norm() < 1e-3 * edge.information.norm());
}

/// Keyframes that look for places alone; poses that are off by this much from the fifth on.
fn with_places_only(off: f64) -> GraphStats {
    let sequence = small_demo();
    let camera = sequence.camera();
    let (views, truth) = keyframes(sequence, 8, 8);
    let mut config = SlamConfig::default();
    config.graph.nearest = 0;
    config.graph.max_overlapping = 0;
    config.graph.places.min_keyframes_between = 3;
    let mask = Mask::filled(camera.width, camera.height, 255);
    let mut graph = KeyframeGraph::new(&config, camera.pinhole, Some(mask)).unwrap();
    let aside = Sim3::exp(&Vec7::from_column_slice(&[
        off, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
    ]));
    let poses: Vec<Sim3> = (0..)
        .zip(&truth)
        .map(|(id, pose)| if id < 4 { *pose } else { aside * *pose })
        .collect();
    let mut stats = GraphStats::default();
    for (view, id) in views.iter().zip(1..) {
        let job = GraphJob {
            finished: Some(Arc::clone(view)),
            poses: map_of(&poses[..id]),
            ..GraphJob::default()
        };
        stats = graph.run(job).stats;
    }
    stats
}

#[test]
fn a_loop_that_only_confirms_the_poses_is_not_added() {
    let confirmed = with_places_only(0.0);
    assert!(confirmed.loops_proposed >= 2, "{confirmed:?}");
    assert_eq!(confirmed.loop_closures, 0, "{confirmed:?}");
    let drifted = with_places_only(0.2);
    assert!(drifted.loop_closures >= 1, "{drifted:?}");
}

#[test]
fn an_optimisation_that_fails_is_said_and_moves_nothing() {
    let mut graph = two_keyframes();
    let mut poses = graph.poses.world_from_keyframe.clone();
    poses[1].translation.x = f64::NAN;
    let job = |poses: &[Sim3]| GraphJob {
        poses: map_of(poses),
        shared_points: vec![SharedPoints {
            i: 0,
            j: 1,
            count: 50,
        }],
        ..GraphJob::default()
    };
    let update = graph.run(job(&poses));
    assert!(update.failure.is_some());
    assert_eq!(update.poses.world_from_keyframe[0], poses[0]);
    let poses = two_keyframes().poses.world_from_keyframe;
    assert_eq!(graph.run(job(&poses)).failure, None, "said once");
}
