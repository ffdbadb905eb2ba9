use super::*;
use crate::system::Slam;
use crate::test_world::small_demo;
use crate::{FrameInput, SlamConfig};
use monogrid_geometry::{Vec3, rotation_exp};
use monogrid_image::{GrayImage, Mask};
use monogrid_worlds::SynthSequence;

/// Frames that are tracked, and those after them that are missed.
const TRACKED: usize = 12;
const MISSED: usize = 3;

fn input(sequence: &SynthSequence, index: usize, image: GrayImage) -> FrameInput {
    FrameInput {
        index,
        timestamp_ns: sequence.frame(index).unwrap().timestamp_ns,
        image,
        depth: (index == 0)
            .then(|| sequence.depth(0))
            .flatten()
            .map(Into::into),
    }
}

/// A run in which some frames, as `shown` has them, are taken for lost.
fn run(sequence: &SynthSequence, shown: impl Fn(GrayImage) -> GrayImage) -> Slam {
    let camera = sequence.camera();
    let mask = Mask::filled(camera.width, camera.height, 255);
    let mut slam = Slam::new(SlamConfig::default(), camera.pinhole, mask, 0).unwrap();
    let image = |k: usize| sequence.frame(k).unwrap().image;
    for k in 0..TRACKED {
        slam.process_frame(input(sequence, k, image(k)));
    }
    for k in TRACKED..TRACKED + MISSED {
        let frame = slam.setup.frame(input(sequence, k, shown(image(k))));
        slam.recovery.count(true);
        slam.recovery.step(&slam.setup, &slam.map, frame, &[], None);
    }
    let end = TRACKED + MISSED;
    let report = slam.process_frame(input(sequence, end, image(end)));
    assert_eq!(report.state, TrackingState::Good);
    assert_eq!(slam.recovery.lost_in_a_row(), 0);
    slam
}

#[test]
fn frames_that_were_missed_get_their_poses_when_the_camera_is_found_again() {
    let sequence = small_demo();
    let slam = run(sequence, |image| image);
    let poses = slam.trajectory();
    assert_eq!(poses.len(), TRACKED + MISSED + 1);
    let truth = |k: usize| sequence.frame(k).unwrap().world_from_camera;
    let from_first = |k: usize| -> Se3 { truth(0).inverse() * truth(k) };
    for (k, pose) in poses.iter().enumerate().skip(TRACKED) {
        assert_eq!(pose.frame_index, k);
        let error = from_first(k).inverse() * pose.world_from_camera;
        assert!(error.log().norm() < 0.01, "{k}: {}", error.log().norm());
    }
}

#[test]
fn pictures_of_another_place_get_none() {
    let sequence = small_demo();
    let mirrored = |image: GrayImage| {
        let width = image.width();
        GrayImage::from_fn(width, image.height(), |x, y| image.at(width - 1 - x, y))
    };
    let slam = run(sequence, mirrored);
    let frames = slam.trajectory().into_iter().map(|pose| pose.frame_index);
    let expected = (0..TRACKED).chain([TRACKED + MISSED]);
    assert!(frames.eq(expected));
}

#[test]
fn another_turn_leaves_the_camera_at_its_place() {
    let step = Se3::new(
        rotation_exp(&Vec3::new(0.0, 0.1, 0.0)),
        Vec3::new(0.3, 0.0, -0.1),
    );
    let turn = rotation_exp(&Vec3::new(0.2, -0.4, 0.1));
    let found = turned(&step, turn);
    assert_eq!(found.rotation, turn);
    let place = |step: &Se3| step.inverse().translation;
    assert!((place(&found) - place(&step)).norm() < 1e-12);
}
