//! A map is kept, and another session goes on with it.
#![allow(clippy::unwrap_used, reason = "a test fails where it unwraps")]

use monogrid_evaluation::{StampedPose, TrajectoryConfig, evaluate_trajectory};
use monogrid_image::{GrayImage, Mask};
use monogrid_slam::{
    ContinueError, FrameInput, FrameReport, LostReason, Purpose, Slam, SlamConfig, SlamError,
    StoredMap, TrackedFrame, TrackingState,
};
use monogrid_worlds::SynthSequence;
use std::fmt::Write;
use std::sync::OnceLock;

/// Of the small demonstration, every third frame.
const FRAMES: usize = 110;
const FIRST: std::ops::Range<usize> = 0..65;
/// Begins where the first session has been.
const SECOND: std::ops::Range<usize> = 45..FRAMES;

struct World {
    sequence: SynthSequence,
    inputs: Vec<FrameInput>,
    truth: Vec<StampedPose>,
}

fn world() -> &'static World {
    static WORLD: OnceLock<World> = OnceLock::new();
    WORLD.get_or_init(|| {
        let sequence = SynthSequence::small_demo().unwrap();
        let (mut inputs, mut truth) = (Vec::new(), Vec::new());
        for index in 0..FRAMES {
            let frame = sequence.frame(3 * index).unwrap();
            truth.push((frame.timestamp_ns, frame.world_from_camera));
            inputs.push(FrameInput {
                index,
                timestamp_ns: frame.timestamp_ns,
                image: frame.image,
                depth: (index == 0)
                    .then(|| sequence.depth(0))
                    .flatten()
                    .map(Into::into),
            });
        }
        World {
            sequence,
            inputs,
            truth,
        }
    })
}

fn mask() -> Mask {
    let camera = world().sequence.camera();
    Mask::filled(camera.width, camera.height, 255)
}

/// The map of the first session and its frames.
fn first() -> &'static (StoredMap, Vec<TrackedFrame>) {
    static FIRST_SESSION: OnceLock<(StoredMap, Vec<TrackedFrame>)> = OnceLock::new();
    FIRST_SESSION.get_or_init(|| {
        let pinhole = world().sequence.camera().pinhole;
        let mut slam = Slam::new(SlamConfig::default(), pinhole, mask(), 0).unwrap();
        for input in &world().inputs[FIRST] {
            slam.process_frame(input.clone());
        }
        slam.finish();
        (slam.stored_map(), slam.tracked_frames())
    })
}

fn continued(map: StoredMap, purpose: Purpose) -> Result<Slam, SlamError> {
    let pinhole = world().sequence.camera().pinhole;
    Slam::continue_from(SlamConfig::default(), pinhole, mask(), 0, map, purpose)
}

fn go_on(purpose: Purpose, inputs: &[FrameInput]) -> (Slam, Vec<FrameReport>) {
    let mut slam = continued(first().0.clone(), purpose).unwrap();
    let reports = inputs
        .iter()
        .map(|input| slam.process_frame(input.clone()))
        .collect();
    slam.finish();
    (slam, reports)
}

/// All of a map, as text.
fn fingerprint(map: &StoredMap) -> String {
    let mut text = String::new();
    for stored in &map.keyframes {
        writeln!(text, "{stored:?}").unwrap();
    }
    writeln!(text, "{:?} {:?}", map.edges, map.points).unwrap();
    text
}

#[test]
fn two_sessions_give_one_map_and_one_trajectory() {
    let (map, frames) = first();
    let (slam, reports) = go_on(Purpose::Extend, &world().inputs[SECOND]);
    let lost = reports.iter().filter(|r| r.world_from_camera.is_none());
    assert!(lost.count() <= 2);
    assert!(reports[0].relocalised || reports[1].relocalised);
    assert_eq!(slam.scale(), map.scale);
    assert!(slam.keyframes().len() > map.keyframes.len());
    assert_eq!(
        slam.snapshot().world_from_keyframe.len(),
        slam.keyframes().len()
    );
    assert!(slam.snapshot().revision > map.pose_revision);
    // the frames of the first session follow their keyframes
    let poses = slam.snapshot();
    let mut both: Vec<StampedPose> = frames
        .iter()
        .filter(|frame| frame.frame_index < SECOND.start)
        .map(|frame| {
            let keyframe = poses.world_from_keyframe[frame.keyframe as usize];
            (frame.timestamp_ns, frame.world_from_camera(&keyframe))
        })
        .collect();
    let second = slam.trajectory();
    both.extend(second.iter().map(|p| (p.timestamp_ns, p.world_from_camera)));
    assert!(both.len() >= FRAMES - 3, "{}", both.len());
    let report = evaluate_trajectory(&both, &world().truth, &TrajectoryConfig::default()).unwrap();
    assert!(
        report.ate_rmse < 0.01 * report.path_length,
        "{} of {}",
        report.ate_rmse,
        report.path_length
    );
    assert!((report.scale - 1.0).abs() < 0.02, "{}", report.scale);
}

#[test]
fn frames_follow_their_keyframes_to_where_the_trajectory_has_them() {
    let pinhole = world().sequence.camera().pinhole;
    let mut slam = Slam::new(SlamConfig::default(), pinhole, mask(), 0).unwrap();
    for input in &world().inputs[..30] {
        slam.process_frame(input.clone());
    }
    slam.finish();
    let poses = slam.snapshot();
    let trajectory = slam.trajectory();
    let frames = slam.tracked_frames();
    assert_eq!(frames.len(), trajectory.len());
    for (frame, pose) in frames.iter().zip(&trajectory) {
        assert_eq!(frame.frame_index, pose.frame_index);
        let keyframe = poses.world_from_keyframe[frame.keyframe as usize];
        let difference = frame.world_from_camera(&keyframe).inverse() * pose.world_from_camera;
        assert!(difference.log().norm() < 1e-9);
    }
}

#[test]
fn localising_changes_nothing_of_the_map() {
    // what was mapped, and a part of what was not
    let inputs = &world().inputs[20..75];
    let before = continued(first().0.clone(), Purpose::LocaliseOnly).unwrap();
    let (slam, reports) = go_on(Purpose::LocaliseOnly, inputs);
    assert!(fingerprint(&slam.stored_map()) == fingerprint(&before.stored_map()));
    assert_eq!(slam.snapshot(), before.snapshot());
    assert!(
        reports
            .iter()
            .all(|r| !r.created_keyframe && r.finished_keyframe.is_none())
    );
    let good = |r: &&FrameReport| r.state == TrackingState::Good;
    assert!(reports[2..40].iter().filter(good).count() >= 36);
    let estimate: Vec<StampedPose> = slam
        .trajectory()
        .iter()
        .map(|p| (p.timestamp_ns, p.world_from_camera))
        .collect();
    let report =
        evaluate_trajectory(&estimate, &world().truth, &TrajectoryConfig::default()).unwrap();
    assert!(
        report.ate_rmse < 0.02 * report.path_length,
        "{}",
        report.ate_rmse
    );
}

#[test]
fn a_place_that_was_never_seen_has_no_pose() {
    let camera = world().sequence.camera();
    let inputs: Vec<FrameInput> = (0..5)
        .map(|index| FrameInput {
            index,
            timestamp_ns: index as i64 * 33_000_000,
            image: GrayImage::from_fn(camera.width, camera.height, |x, y| {
                ((x * 7 + y * 13 + index * 29) % 251) as f32
            }),
            depth: None,
        })
        .collect();
    for purpose in [Purpose::Extend, Purpose::LocaliseOnly] {
        let (slam, reports) = go_on(purpose, &inputs);
        assert!(slam.trajectory().is_empty());
        assert_eq!(slam.keyframes().len(), first().0.keyframes.len());
        assert!(
            reports
                .iter()
                .all(|r| r.reason == Some(LostReason::NotRecognised))
        );
    }
}

#[test]
fn the_same_bits_for_any_number_of_threads() {
    let on = |threads: usize| {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap()
            .install(|| {
                let (slam, _) = go_on(Purpose::Extend, &world().inputs[50..80]);
                fingerprint(&slam.stored_map()) + &format!("{:?}", slam.trajectory())
            })
    };
    assert!(on(1) == on(3));
}

#[test]
fn damaged_maps_are_refused() {
    let map = &first().0;
    let refused = |change: &dyn Fn(&mut StoredMap)| {
        let mut map = map.clone();
        change(&mut map);
        match continued(map, Purpose::Extend) {
            Err(SlamError::Continue(error)) => error,
            other => panic!("{:?}", other.map(|_| ())),
        }
    };
    assert_eq!(refused(&|m| m.keyframes.clear()), ContinueError::Empty);
    assert_eq!(
        refused(&|m| drop(m.keyframes.remove(1))),
        ContinueError::Missing { missing: 1 }
    );
    let error = refused(&|m| m.keyframes[2].parent = Some(2));
    assert!(matches!(error, ContinueError::Keyframe { id: 2, .. }));
    let error = refused(&|m| m.keyframes[1].gain = f64::NAN);
    assert!(matches!(error, ContinueError::Keyframe { id: 1, .. }));
    let error =
        refused(&|m| m.keyframes[0].keyframe.image = monogrid_image::Image::filled(8, 8, 0));
    assert!(matches!(error, ContinueError::Size { id: 0, .. }));
    // what points at keyframes that are not there is left out
    let mut odd = map.clone();
    odd.points[0].host = 999;
    odd.points[1].pixel = [1e300, 5.0];
    odd.points[2].observations = vec![(0, [f64::NAN, 1.0])];
    odd.edges[0].edge.j = 999;
    assert!(continued(odd, Purpose::Extend).is_ok());
    // and without constraints and points the map still holds together
    let mut bare = map.clone();
    bare.edges.clear();
    bare.points.clear();
    let mut slam = continued(bare, Purpose::Extend).unwrap();
    for input in &world().inputs[45..60] {
        slam.process_frame(input.clone());
    }
    assert!(slam.trajectory().len() >= 13);
    let mut config = SlamConfig::default();
    config.graph.places.enabled = false;
    let pinhole = world().sequence.camera().pinhole;
    let refused = Slam::continue_from(config, pinhole, mask(), 0, map.clone(), Purpose::Extend);
    assert!(matches!(
        refused,
        Err(SlamError::Continue(ContinueError::NoPlaces))
    ));
}
