//! Changes of a small map, without images.

use super::*;
use crate::sparse::world_from_keyframes;
use crate::{FragmentId, MAIN_MAP, PoseSnapshot};
use monogrid_geometry::{Pinhole, Se3, Vec2, Vec3, Vec7};
use monogrid_graph::bundle::BundleError;
use monogrid_image::GrayImage;

/// Keyframes in this many fragments, one after the other, three points in each, which the next one
/// sees.
fn map_with(fragments: &[FragmentId]) -> Map {
    let mut map = Map::default();
    for (id, fragment) in (0..).zip(fragments) {
        let parent = (id > 0 && fragments[id as usize - 1] == *fragment).then(|| id - 1);
        map.create(NewKeyframe {
            fragment: *fragment,
            parent,
            frame_index: 10 * id as usize,
            timestamp_ns: i64::from(id),
            image: KeyframeImage::new(map.store(), &GrayImage::filled(32, 32, 0.0)),
            exposure: Exposure::NEUTRAL,
            world_from_keyframe: pose(f64::from(id), 1.0),
            measured: None,
        });
        let inliers = match parent {
            Some(parent) => map[parent].points.anchored.clone(),
            None => 0..0,
        };
        map.register(Registration {
            inliers: inliers.map(|point| (point, Vec2::zeros())).collect(),
            ..Registration::default()
        });
        let points = (1..=3).map(|k| SparsePoint {
            host: id,
            pixel: Vec2::zeros(),
            idepth: f64::from(k),
            prior_idepth: f64::from(k),
            prior_sigma: 0.1,
            is_measured: false,
            pixel_size: 1.0,
            observations: Vec::new(),
            alive: true,
        });
        map.anchor(points.collect());
    }
    map
}

fn pose(place: f64, unit: f64) -> Sim3 {
    Sim3::exp(&Vec7::from_column_slice(&[
        place,
        0.1,
        -0.2,
        0.05 * place,
        0.1,
        0.0,
        unit.ln(),
    ]))
}

fn finish(map: &mut Map, id: KeyframeId, revision: u32) {
    let published = KeptKeyframe {
        id,
        frame_index: map[id].frame_index,
        timestamp_ns: map[id].timestamp_ns,
        revision,
        num_pixels: 0,
        image: map[id].image.clone(),
        pixels: map.store().keep(Vec::new()),
    };
    map.finish(FinishedKeyframe {
        id,
        published: Some(published),
        depth: None,
        links: Vec::new(),
        view: None,
    });
}

fn optimised(map: &Map, moved: &[(KeyframeId, Sim3)], joined: Vec<Joined>) -> GraphUpdate {
    let mut poses = PoseSnapshot::clone(map.snapshot());
    for (id, pose) in moved {
        poses.world_from_keyframe[*id as usize] = *pose;
    }
    for joined in &joined {
        for fragment in poses.fragment.iter_mut().filter(|f| **f == joined.from) {
            *fragment = joined.into;
        }
    }
    GraphUpdate {
        poses,
        joined,
        ..GraphUpdate::default()
    }
}

/// Position in the world of a point at the centre of its host's image.
fn position(map: &Map, point: &SparsePoint) -> Vec3 {
    let in_host = Vec3::new(0.0, 0.0, 1.0 / point.idepth);
    map[point.host].camera_from_world.inverse() * in_host
}

#[test]
fn points_keep_their_place_in_a_keyframe_that_is_moved_and_scaled() {
    let mut map = map_with(&[0, 0, 0]);
    let before: Vec<Vec3> = map.points().iter().map(|p| position(&map, p)).collect();
    let sigma = map.points()[3].prior_sigma / map.points()[3].prior_idepth;
    let (old, new) = (map[1].world_from_keyframe, pose(5.0, 2.5));
    let change = optimised(&map, &[(1, new)], Vec::new());
    map.follow_graph(change, 77);
    for (index, point) in map.points().iter().enumerate() {
        let expected = if point.host == 1 {
            new * (old.inverse() * before[index])
        } else {
            before[index]
        };
        let error = (position(&map, point) - expected).norm();
        assert!(error < 1e-9, "point {index}: {error}");
        assert!((point.prior_idepth - point.idepth).abs() < 1e-12);
    }
    let moved = &map.points()[3];
    assert!((moved.prior_sigma / moved.prior_idepth - sigma).abs() < 1e-12);
}

#[test]
fn a_keyframe_that_a_depth_camera_measured_is_moved_and_keeps_its_size_and_ranges() {
    let mut map = map_with(&[0, 0, 0]);
    map.set_scale(Scale::Metric);
    let depth = GrayImage::from_fn(32, 32, |x, _| if x < 16 { 2.0 } else { f32::NAN });
    map.measure(1, &MeasuredDepth::new(&depth, 0.01));
    let measured: Vec<_> = map.points().iter().map(|p| p.is_measured).collect();
    assert_eq!(
        measured,
        [false, false, false, true, true, true, false, false, false]
    );
    let ranges = |map: &Map| {
        let hosted = map.points().iter().filter(|point| point.host == 1);
        hosted
            .map(|p| (p.prior_idepth, p.prior_sigma))
            .collect::<Vec<_>>()
    };
    assert!(
        ranges(&map)
            .iter()
            .all(|(idepth, sigma)| *idepth == 0.5 && (sigma - 0.01).abs() < 1e-8)
    );
    let (before, known) = (map[1].world_from_keyframe.scale, ranges(&map));
    let change = optimised(
        &map,
        &[(1, pose(5.0, 2.5)), (2, pose(6.0, 2.5))],
        Vec::new(),
    );
    map.follow_graph(change, 77);
    assert_eq!(map[1].world_from_keyframe.scale, before);
    assert_eq!(
        map[1].world_from_keyframe.translation,
        pose(5.0, 2.5).translation
    );
    assert!((map[2].world_from_keyframe.scale - 2.5).abs() < 1e-12);
    assert_eq!(ranges(&map), known);
}

#[test]
fn each_keyframe_knows_the_points_that_it_sees() {
    let mut map = map_with(&[0, 0, 0]);
    let seen = |map: &Map, id| map[id].points.all().collect::<Vec<_>>();
    assert_eq!(seen(&map, 0), [0, 1, 2]);
    assert_eq!(seen(&map, 1), [0, 1, 2, 3, 4, 5]);
    assert_eq!(seen(&map, 2), [3, 4, 5, 6, 7, 8]);
    map.adjust(Adjustment {
        camera_from_world: vec![(2, Se3::identity())],
        idepths: vec![(4, 0.25)],
        refuted: vec![(4, 2)],
        ..Adjustment::default()
    });
    assert_eq!(seen(&map, 2), [3, 5, 6, 7, 8]);
    assert!(!map.points()[4].is_shared() && map.points()[5].is_shared());
    assert_eq!(map.points()[4].pixel_in(2), None);
    assert!((map.points()[4].idepth - 0.25).abs() < 1e-12);
    assert_eq!(map.counts().failed_adjustments, 0);
}

#[test]
fn events_tell_what_a_listener_needs_and_no_more() {
    let mut map = map_with(&[0, 0]);
    assert!(map.take_events().is_empty(), "nobody knows these keyframes");
    finish(&mut map, 0, 0);
    let moved = map[1].world_from_keyframe;
    map.pose(&[(1, moved)]);
    let events = map.take_events();
    let [Event::Finished(keyframe, poses)] = &events[..] else {
        panic!("{events:?}");
    };
    assert!(keyframe.id == 0 && Arc::ptr_eq(poses, map.snapshot()));
    assert!(map.take_events().is_empty());
    map.pose(&[(1, moved)]);
    finish(&mut map, 0, 1);
    map.lose(5);
    let events = map.take_events();
    assert!(
        matches!(
            &events[..],
            [Event::Revised(k), Event::Moved(_), Event::Lost { frame_index: 5 }] if k.revision == 1
        ),
        "{events:?}"
    );
    map.find(9, 1, true);
    let events = map.take_events();
    assert!(matches!(
        &events[..],
        [Event::Found {
            frame_index: 9,
            keyframe: 1
        }]
    ));
    let counts = map.counts();
    assert_eq!((counts.lost_episodes, counts.relocalisations), (1, 1));
}

#[test]
fn an_adjustment_that_fails_is_said_and_moves_nothing() {
    let mut map = map_with(&[0, 0]);
    let before: Vec<Vec3> = map.points().iter().map(|p| position(&map, p)).collect();
    let failure = BundleError::Distance { keyframe: 1, to: 1 };
    map.adjust(Adjustment {
        failure: Some(failure.clone()),
        ..Adjustment::default()
    });
    let events = map.take_events();
    assert!(matches!(&events[..], [Event::NotAdjusted(error)] if *error == failure));
    assert_eq!(map.counts().failed_adjustments, 1);
    for (point, before) in map.points().iter().zip(&before) {
        assert!((position(&map, point) - before).norm() < 1e-12);
    }
}

#[test]
fn a_fragment_that_is_joined_is_counted_as_it_was() {
    let mut map = map_with(&[0, 0, 1, 1]);
    map.begin_fragment(Fragment::begun(1, 2, 20));
    assert_eq!((map.apart().count(), map.next_fragment()), (1, 2));
    map.take_events();
    let joined = Joined {
        from: 1,
        into: MAIN_MAP,
    };
    let change = optimised(&map, &[(2, pose(2.5, 0.5))], vec![joined]);
    map.follow_graph(change, 77);
    assert!(map.keyframes().iter().all(|k| k.fragment == MAIN_MAP));
    let events = map.take_events();
    let [Event::Joined(fragment)] = &events[..] else {
        panic!("{events:?}");
    };
    assert_eq!((fragment.id, fragment.keyframes), (1, 2));
    assert_eq!(fragment.joined.map(|j| (j.into, j.frame)), Some((0, 77)));
    assert_eq!(map.apart().count(), 0);
    assert_eq!(map.fragments()[0].keyframes, 2, "not those of the main map");
}

#[test]
fn a_fragment_that_changes_places_with_the_main_map_leaves_all_poses_as_they_are() {
    let mut map = map_with(&[0, 0, 1, 1, 1, 2, 3]);
    for (id, first) in [(1, 2), (2, 5), (3, 6)] {
        map.begin_fragment(Fragment::begun(id, first, 10 * first as usize));
    }
    // one that was joined to each of the two
    for (fragment, into) in [(2, MAIN_MAP), (3, 1)] {
        let joined = Joined {
            from: fragment,
            into,
        };
        map.place(joined, &pose(0.0, 1.0), 66);
    }
    for id in 0..7 {
        finish(&mut map, id, 0);
    }
    let poses = map.snapshot().world_from_keyframe.clone();
    map.take_events();
    map.exchange(1);
    assert_eq!(map.exchanged(), Some(1));
    let fragments: Vec<FragmentId> = map.keyframes().iter().map(|k| k.fragment).collect();
    assert_eq!(fragments, [1, 1, 0, 0, 0, 1, 0]);
    assert_eq!(map.snapshot().world_from_keyframe, poses);
    assert_eq!(map.snapshot().in_main_map(0), None);
    assert_eq!(map.snapshot().in_main_map(2), Some(&poses[2]));
    // the first map is the fragment now, with what was joined to it
    let [first, second, third] = &map.fragments()[..] else {
        panic!("{:?}", map.fragments());
    };
    assert_eq!(
        (first.id, first.first_keyframe, first.first_frame),
        (1, 0, 0)
    );
    assert_eq!((first.keyframes, first.joined), (3, None));
    let into = |fragment: &Fragment| fragment.joined.map(|join| join.into);
    assert_eq!((into(second), into(third)), (Some(1), Some(MAIN_MAP)));
    let events = map.take_events();
    assert!(events.iter().any(|event| matches!(event, Event::Moved(_))));
}

#[test]
fn a_fragment_that_is_placed_takes_its_points_along_and_nothing_else() {
    let mut map = map_with(&[0, 0, 1, 1]);
    for id in 0..4 {
        finish(&mut map, id, 0);
    }
    map.begin_fragment(Fragment::begun(1, 2, 20));
    let before: Vec<Vec3> = map.points().iter().map(|p| position(&map, p)).collect();
    let poses: Vec<Sim3> = map
        .keyframes()
        .iter()
        .map(|k| k.world_from_keyframe)
        .collect();
    map.take_events();
    let into_from_fragment = pose(-3.0, 0.4);
    let joined = Joined {
        from: 1,
        into: MAIN_MAP,
    };
    map.place(joined, &into_from_fragment, 55);
    for (index, point) in map.points().iter().enumerate() {
        let is_moved = point.host >= 2;
        let expected = if is_moved {
            into_from_fragment * before[index]
        } else {
            before[index]
        };
        assert!((position(&map, point) - expected).norm() < 1e-9, "{index}");
    }
    assert_eq!(map[1].world_from_keyframe, poses[1]);
    assert!(map.keyframes().iter().all(|k| k.fragment == MAIN_MAP));
    let joined = map.fragments()[0].joined.unwrap();
    assert_eq!((joined.into, joined.frame), (MAIN_MAP, 55));
    let events = map.take_events();
    let is_joined = |event: &Event| match event {
        Event::Joined(fragment) => fragment.id == 1 && fragment.keyframes == 2,
        _ => false,
    };
    assert!(events.iter().any(is_joined));
    assert!(events.iter().any(|event| matches!(event, Event::Moved(_))));
    assert_eq!(map.snapshot().fragment_of(3), MAIN_MAP);
}

#[test]
fn the_cost_of_a_graph_update_follows_what_moved() {
    // 1,000 keyframes with 150 points each, of which ten move
    let mut map = Map::default();
    for id in 0..1000 {
        map.create(NewKeyframe {
            fragment: MAIN_MAP,
            parent: (id > 0).then(|| id - 1),
            frame_index: id as usize,
            timestamp_ns: i64::from(id),
            image: KeyframeImage::new(map.store(), &GrayImage::filled(32, 32, 0.0)),
            exposure: Exposure::NEUTRAL,
            world_from_keyframe: pose(f64::from(id), 1.0),
            measured: None,
        });
        let point = |k: u32| SparsePoint {
            host: id,
            pixel: Vec2::zeros(),
            idepth: f64::from(k),
            prior_idepth: f64::from(k),
            prior_sigma: 0.1,
            is_measured: false,
            pixel_size: 1.0,
            observations: Vec::new(),
            alive: true,
        };
        map.anchor((1..=150).map(point).collect());
    }
    let mut fastest_ms = f64::INFINITY;
    for round in 1..=20 {
        let unit = 1.0 + 0.01 * f64::from(round);
        let moved: Vec<(KeyframeId, Sim3)> = (100..110)
            .map(|id| (id, pose(f64::from(id), unit)))
            .collect();
        let change = optimised(&map, &moved, Vec::new());
        let begin = std::time::Instant::now();
        map.follow_graph(change, 77);
        fastest_ms = fastest_ms.min(begin.elapsed().as_secs_f64() * 1e3);
    }
    println!("an update that moves 10 of 1,000 keyframes costs tracking {fastest_ms:.2} ms");
    assert!(fastest_ms < 5.0, "{fastest_ms} ms");
}

#[test]
fn keyframes_see_points_once() {
    let mut map = map_with(&[0, 0, 0]);
    let seen = |point: usize, keyframe: KeyframeId| {
        let pixel = Vec2::new(1.0, 2.0);
        (point, Observation { keyframe, pixel })
    };
    // keyframe 1 sees points 0 to 2 already, keyframe 2 points 3 to 5
    let change = vec![seen(7, 1), seen(1, 2), seen(1, 2), seen(4, 2)];
    map.observe(change);
    assert_eq!(map[2].points.others, [1, 3, 4, 5]);
    assert_eq!(map[1].points.others, [0, 1, 2, 7]);
    let observers = |point: usize| -> Vec<KeyframeId> {
        let observations = map.points()[point].observations.iter();
        observations.map(|o| o.keyframe).collect()
    };
    assert_eq!(observers(1), [1, 2]);
    assert_eq!(observers(4), [2]);
    assert_eq!(observers(7), [1]);
}

#[test]
fn points_settle_the_units_of_the_newest_keyframes_of_a_fragment_and_of_no_others() {
    let map = map_with(&[0, 0, 1, 0, 0]);
    let pinhole = Pinhole::new(30.0, 30.0, 16.0, 16.0);
    let placed = |fragment, newest| -> Vec<KeyframeId> {
        let poses = world_from_keyframes(&map, fragment, newest, &pinhole);
        poses.into_iter().map(|(id, _)| id).collect()
    };
    assert_eq!(placed(0, 3), [1, 3, 4]);
    assert_eq!(placed(0, 10), [0, 1, 3, 4]);
    assert_eq!(placed(1, 3), [2]);
}
