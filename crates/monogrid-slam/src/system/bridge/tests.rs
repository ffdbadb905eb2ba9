use super::*;
use crate::policy::MAX_BRIDGE_SCALE_SIGMA;
use crate::start::Start;
use crate::system::Slam;
use crate::system::lost::{BRIDGE_FRAMES, Recovery};
use crate::test_world::small_demo;
use crate::{FrameInput, FrameReport, SlamConfig};
use monogrid_geometry::Vec6;
use monogrid_image::{GrayImage, Mask};
use monogrid_worlds::SynthSequence;

const STEP: usize = 2;
const INTERVAL_NS: i64 = 66_666_667;
/// Frames that are tracked before the loss.
const TRACKED: usize = 20;

fn input(sequence: &SynthSequence, k: usize, change: fn(GrayImage) -> GrayImage) -> FrameInput {
    FrameInput {
        index: k,
        timestamp_ns: k as i64 * INTERVAL_NS,
        image: change(sequence.frame(STEP * k).unwrap().image),
        depth: (k == 0)
            .then(|| sequence.depth(0))
            .flatten()
            .map(Into::into),
    }
}

/// A system that has tracked some frames in metres, and the start that it would make of those after
/// them, which are changed first.
fn after_a_loss(sequence: &SynthSequence, change: fn(GrayImage) -> GrayImage) -> (Slam, Started) {
    let camera = sequence.camera();
    let mask = Mask::filled(camera.width, camera.height, 255);
    let mut slam = Slam::new(SlamConfig::default(), camera.pinhole, mask, 0).unwrap();
    for k in 0..TRACKED {
        slam.process_frame(input(sequence, k, |image| image));
    }
    let setup = &slam.setup;
    let mut start = Start::new(&setup.config, 0);
    for k in TRACKED..8 * TRACKED {
        let frame = setup.frame(input(sequence, k, change));
        if let Ok(started) = start.add_frame(frame, setup) {
            return (slam, *started);
        }
    }
    panic!("the camera moves enough for a start");
}

#[test]
fn a_start_that_shows_the_frames_before_it_lies_in_the_map() {
    let sequence = small_demo();
    let (mut slam, started) = after_a_loss(sequence, |image| image);
    assert_eq!(slam.recovery.known().len(), BRIDGE_FRAMES);
    let landing = land(&slam.setup, &slam.map, slam.recovery.known(), &started).unwrap();

    let first = started.keyframe.index;
    let num_later = started.later.len();
    let num_keyframes = slam.map.keyframes().len();
    let mut report = FrameReport::new(first, 0, TrackingState::Lost);
    let landed = Recovery::Landed(Box::new(landing.clone()), Box::new(started));
    slam.recover(landed, &mut report);
    let keyframe = &slam.map.keyframes()[num_keyframes];
    assert_eq!(
        (keyframe.fragment, keyframe.parent),
        (0, Some(landing.parent))
    );
    let [bridge] = slam.bridges() else {
        panic!("one loss was bridged");
    };
    assert_eq!(bridge.first_frame, first);
    assert!(bridge.scale_sigma < MAX_BRIDGE_SCALE_SIGMA);
    // all frames but those that wait have poses in the map, in metres
    let trajectory = slam.trajectory();
    assert_eq!(trajectory.len(), TRACKED + (first - TRACKED) + 1);
    assert!(num_later > 0);
    let world_from_sequence = sequence.frame(0).unwrap().world_from_camera.inverse();
    for pose in trajectory {
        let truth = world_from_sequence
            * sequence
                .frame(STEP * pose.frame_index)
                .unwrap()
                .world_from_camera;
        let error_m = (pose.world_from_camera.translation - truth.translation).norm();
        assert!(error_m < 0.05, "frame {}: {error_m} m", pose.frame_index);
    }
    let unit = slam.map[landing.parent].world_from_keyframe.scale;
    let depth_m = landing.parent_from_start.scale * unit;
    assert!((0.5..5.0).contains(&depth_m), "median depth {depth_m} m");
}

#[test]
fn a_start_at_another_place_lies_nowhere() {
    let sequence = small_demo();
    let mirrored = |image: GrayImage| {
        let width = image.width();
        GrayImage::from_fn(width, image.height(), |x, y| image.at(width - 1 - x, y))
    };
    let (slam, started) = after_a_loss(sequence, mirrored);
    assert!(land(&slam.setup, &slam.map, slam.recovery.known(), &started).is_none());
}

/// Poses of a camera that moves along a curve, in a map and in a start.
fn paths(map_from_start: &Sim3, error: f64) -> Vec<KnownTwice> {
    (0..8)
        .map(|k| {
            let t = 0.1 * f64::from(k);
            let in_start = Se3::exp(&Vec6::new(t, 0.2 * t * t, 0.1 * t, 0.3 * t, -0.1, 0.0));
            let moved = (*map_from_start * in_start.with_scale(1.0)).to_se3();
            let off = Vec3::new((7.0 * t).sin(), (11.0 * t).cos(), (13.0 * t).sin()) * error;
            KnownTwice {
                in_map: Se3::new(moved.rotation, moved.translation + off),
                in_start,
            }
        })
        .collect()
}

#[test]
fn two_paths_say_place_and_scale_and_how_well() {
    let truth = Se3::exp(&Vec6::new(1.0, -2.0, 0.5, 0.4, 1.0, -0.2)).with_scale(2.5);
    let exact = Fit::of(&paths(&truth, 0.0)).unwrap();
    assert!((exact.map_from_start.inverse() * truth).log().norm() < 1e-9);
    assert!(exact.evidence.scale_sigma < 1e-9 && exact.evidence.turn_rms < 1e-9);
    let noisy = Fit::of(&paths(&truth, 0.01)).unwrap();
    let scale_sigma = noisy.evidence.scale_sigma;
    let error = (noisy.map_from_start.scale / truth.scale).ln().abs();
    assert!(error < 3.0 * scale_sigma, "{error} {scale_sigma}");
    assert!((0.001..0.05).contains(&scale_sigma), "{scale_sigma}");
    assert!(Fit::of(&[]).is_none());
}
