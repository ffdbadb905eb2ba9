use super::*;
use crate::map::{Adjustment, MapKeyframe, Observation};
use crate::sparse::SparseConfig;
use crate::system::Slam;
use crate::test_world::small_demo;
use crate::{FrameInput, KeyframeId, MAIN_MAP, PoseSource, SlamConfig, TrajectoryPose};
use monogrid_geometry::{Se3, Vec3, Vec6};
use monogrid_image::Mask;
use monogrid_worlds::SynthSequence;

/// Every fourth frame of the sequence is shown.
const STEP: usize = 4;

/// A system that has made some keyframes, in metres.
fn with_keyframes(sequence: &SynthSequence) -> Slam {
    let camera = sequence.camera();
    let mask = Mask::filled(camera.width, camera.height, 255);
    let mut config = SlamConfig::default();
    // so that measured depth holds the scale and little else
    config.depth_camera.sigma = 0.007;
    let mut slam = Slam::new(config, camera.pinhole, mask, 0).unwrap();
    for index in 0..45 {
        let k = STEP * index;
        slam.process_frame(FrameInput {
            index,
            timestamp_ns: index as i64 * 100_000_000,
            image: sequence.frame(k).unwrap().image,
            depth: (k == 0)
                .then(|| sequence.depth(0))
                .flatten()
                .map(Into::into),
        });
    }
    slam.await_graph();
    slam
}

/// Largest error of a keyframe's position, metres.
fn largest_error_m(slam: &Slam, sequence: &SynthSequence) -> f64 {
    let first = sequence.frame(0).unwrap().world_from_camera;
    let errors = slam.map.keyframes().iter().map(|keyframe| {
        let truth = first.inverse()
            * sequence
                .frame(STEP * keyframe.frame_index)
                .unwrap()
                .world_from_camera;
        (keyframe.world_from_keyframe.translation - truth.translation).norm()
    });
    errors.fold(0.0, f64::max)
}

fn num_observations(slam: &Slam) -> usize {
    let points = slam.map.points().iter().filter(|point| point.alive);
    points.map(|point| point.observations.len()).sum()
}

#[test]
fn the_whole_map_comes_back_to_where_its_points_have_it() {
    let sequence = small_demo();
    let mut slam = with_keyframes(sequence);
    let (error_m, seen) = (largest_error_m(&slam, sequence), num_observations(&slam));
    let num_keyframes = slam.map.next_id();
    assert!(
        num_keyframes > 3 && error_m < 0.01,
        "{num_keyframes}: {error_m}"
    );

    // all but the first are moved by a centimetre and half a degree
    let moved = |id: KeyframeId| {
        let side = [1.0, -1.0][id as usize % 2];
        let by = Se3::exp(&(Vec6::new(0.01, -0.005, 0.005, 0.005, 0.005, -0.005) * side));
        (id, by * slam.map[id].camera_from_world)
    };
    let camera_from_world = (1..num_keyframes).map(moved).collect();
    slam.map.adjust(Adjustment {
        camera_from_world,
        ..Adjustment::default()
    });
    adjust_whole(&slam.setup, &mut slam.map, MAIN_MAP);
    assert_eq!(slam.counts().failed_adjustments, 0);
    let after_m = largest_error_m(&slam, sequence);
    assert!(after_m < 0.008, "{after_m} from {error_m} m");
    let found = num_observations(&slam);
    assert!(found > seen, "{found} from {seen}");

    // not where it would take too long
    slam.setup.config.sparse.final_max_keyframes = num_keyframes as usize - 1;
    let before = slam.snapshot();
    adjust_whole(&slam.setup, &mut slam.map, MAIN_MAP);
    assert_eq!(slam.snapshot(), before);
}

/// Largest distance between two sets of positions of the same keyframes.
fn largest_move(a: &[Vec3], b: &[Vec3]) -> f64 {
    let moves = a.iter().zip(b).map(|(a, b)| (a - b).norm());
    moves.fold(0.0, f64::max)
}

fn positions(slam: &Slam) -> Vec<Vec3> {
    let keyframes = slam.map.keyframes().iter();
    keyframes
        .map(|keyframe| keyframe.world_from_keyframe.translation)
        .collect()
}

#[test]
fn points_have_the_last_word_and_those_found_a_pixel_beside_little_to_say() {
    let mut slam = with_keyframes(small_demo());
    slam.finish();
    let finished = positions(&slam);
    adjust_whole(&slam.setup, &mut slam.map, MAIN_MAP);
    let before = positions(&slam);
    let moved_m = largest_move(&finished, &before);
    // one more round refutes a point and finds some again: 0.33 mm; where edges of direct alignment
    // come last it is 0.87 mm
    assert!(moved_m < 5e-4, "{moved_m}");

    let beside = wrong_observations(&slam);
    assert!(beside.len() > 100, "{}", beside.len());
    let refuted = beside.iter().map(|(point, seen)| (*point, seen.keyframe));
    slam.map.adjust(Adjustment {
        refuted: refuted.collect(),
        ..Adjustment::default()
    });
    slam.map.observe(beside);
    let lens = LeftLens::of_pinhole(&slam.setup.pinhole);
    let moved_m = |kernel_px: f64| {
        let config = SparseConfig {
            kernel_px,
            ..SparseConfig::default()
        };
        let adjusted = adjust_all(&slam.map, MAIN_MAP, &lens, &config);
        let after: Vec<Vec3> = adjusted
            .camera_from_world
            .iter()
            .map(|(_, pose)| pose.inverse().translation)
            .collect();
        largest_move(&before, &after)
    };
    let (default_m, quadratic_m) = (moved_m(SparseConfig::default().kernel_px), moved_m(1.5));
    assert!(
        default_m < 0.75 * quadratic_m,
        "{default_m} of {quadratic_m} m"
    );
}

/// Of every sixth point, how the keyframes that see it would see it a pixel to the right: less than
/// what is refuted.
fn wrong_observations(slam: &Slam) -> Vec<(usize, Observation)> {
    let points = slam.map.points().iter().enumerate().step_by(6);
    points
        .filter(|(_, point)| point.alive)
        .flat_map(|(index, point)| {
            let beside = |seen: &Observation| Observation {
                pixel: seen.pixel + Vec2::new(1.0, 0.0),
                ..*seen
            };
            let seen: Vec<_> = point.observations.iter().map(beside).collect();
            seen.into_iter().map(move |seen| (index, seen))
        })
        .collect()
}

/// Largest angle between the orientations of the same keyframes, rad.
fn largest_turn(a: &[Se3], b: &[Se3]) -> f64 {
    let turns = a
        .iter()
        .zip(b)
        .map(|(a, b)| (a.rotation.inverse() * b.rotation).angle());
    turns.fold(0.0, f64::max)
}

fn poses(slam: &Slam) -> Vec<Se3> {
    let keyframes = slam.map.keyframes().iter();
    keyframes
        .map(|keyframe| keyframe.camera_from_world)
        .collect()
}

#[test]
fn images_correct_places_that_are_all_wrong_alike() {
    let mut slam = with_keyframes(small_demo());
    // to begin where images have the keyframes
    slam.setup.config.sparse.images.min_keyframes = 0;
    slam.finish();
    let finished = poses(&slam);
    // what every second keyframe sees, half a pixel to the right
    let points = slam.map.points().iter().enumerate();
    let beside: Vec<(usize, Observation)> = points
        .filter(|(_, point)| point.alive)
        .flat_map(|(index, point)| {
            let odd = point.observations.iter().filter(|o| o.keyframe % 2 == 1);
            odd.map(move |seen| (index, *seen))
        })
        .map(|(index, seen)| {
            let pixel = seen.pixel + Vec2::new(0.5, 0.0);
            (index, Observation { pixel, ..seen })
        })
        .collect();
    let refuted = beside.iter().map(|(point, seen)| (*point, seen.keyframe));
    slam.map.adjust(Adjustment {
        refuted: refuted.collect(),
        ..Adjustment::default()
    });
    slam.map.observe(beside);
    let lens = LeftLens::of_pinhole(&slam.setup.pinhole);
    let mut config = SparseConfig::default();
    let adjusted = adjust_all(&slam.map, MAIN_MAP, &lens, &config);
    slam.map.adjust(adjusted);
    let turned = largest_turn(&finished, &poses(&slam));
    // half a pixel
    assert!(turned > 0.3 / slam.setup.pinhole.fx, "{turned}");

    let left = |config: &SparseConfig| {
        let adjusted = adjust_all_to_images(&slam.map, MAIN_MAP, &lens, config);
        assert_eq!(adjusted.failure, None);
        let ids = adjusted
            .camera_from_world
            .iter()
            .map(|(id, _)| *id as usize);
        let before: Vec<Se3> = ids.map(|id| finished[id]).collect();
        let after: Vec<Se3> = adjusted
            .camera_from_world
            .iter()
            .map(|(_, pose)| *pose)
            .collect();
        largest_turn(&before, &after)
    };
    let by_images = left(&config);
    assert!(by_images < 0.2 * turned, "{by_images} of {turned}");
    config.images.independent_pixels = 0.0;
    let by_places = left(&config);
    assert!(by_places > 0.8 * turned, "{by_places} of {turned}");
}

#[test]
fn only_a_map_that_shows_nothing_wrong_with_its_camera_is_adjusted_to_images() {
    let finished = |enabled: bool, min_keyframes: usize, left_radial: f64| {
        let mut slam = with_keyframes(small_demo());
        slam.setup.config.sparse.images.enabled = enabled;
        slam.setup.config.sparse.images.min_keyframes = min_keyframes;
        slam.setup.left_radial = left_radial;
        slam.finish();
        poses(&slam)
    };
    let without = finished(false, 0, 0.0);
    let all = without.len();
    // too few to show anything
    assert_eq!(finished(true, all + 1, 0.0), without);
    assert_ne!(finished(true, all, 0.0), without);
    // and something that they show
    assert_eq!(finished(true, all, 1e-4), finished(false, 0, 1e-4));
}

#[test]
fn a_keyframe_is_certain_while_it_shares_points_with_others() {
    let mut slam = with_keyframes(small_demo());
    let (first, others) = slam.map.keyframes().split_first().unwrap();
    assert_eq!(first.pose_sigma, None, "the world");
    let is_held = |k: &&MapKeyframe| k.pose_sigma.is_some() && k.is_certain();
    assert_eq!(others.iter().filter(is_held).count(), others.len());
    let before = slam.trajectory();
    let is_certain = |pose: &TrajectoryPose| pose.source == PoseSource::Certain;
    assert!(before.iter().all(is_certain));

    let newest = slam.map.newest().unwrap();
    let seen = newest.points.all().map(|i| (i, &slam.map.points()[i]));
    let refuted = seen.flat_map(|(i, point)| {
        let observed = point.observations.iter().map(move |o| (i, o.keyframe));
        observed.filter(move |(_, id)| point.host == newest.id || *id == newest.id)
    });
    let refuted = refuted.collect();
    slam.map.adjust(Adjustment {
        refuted,
        ..Adjustment::default()
    });
    let alone = adjust_window(&slam.map, &slam.setup.pinhole, &slam.setup.config.sparse);
    slam.map.adjust(alone);
    assert!(!slam.map.newest().unwrap().is_certain());
    let certain = slam
        .trajectory()
        .iter()
        .filter(|pose| is_certain(pose))
        .count();
    assert!(certain < before.len(), "frames on it are not either");
}
