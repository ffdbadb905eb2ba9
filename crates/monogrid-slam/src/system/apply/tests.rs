use super::*;
use crate::test_world::small_demo;
use crate::{FrameInput, MAIN_MAP, SlamConfig};
use monogrid_image::Mask;
use monogrid_worlds::SynthSequence;

/// Frames of the clip, which is the beginning of the built-in sequence played backwards, and how
/// many of the sequence make one: the camera moves by almost half of the depth of the scene.
const FRAMES: usize = 30;
const STEP: usize = 4;

/// The frame of the sequence that a frame of the clip shows.
const fn shown(k: usize) -> usize {
    STEP * (FRAMES - 1 - k)
}

/// A system that starts at the last frame of a clip, from its true depth, with all others before
/// it.
fn started_at_the_end(sequence: &SynthSequence, config: SlamConfig) -> Slam {
    let camera = sequence.camera();
    let mask = Mask::filled(camera.width, camera.height, 255);
    let mut slam = Slam::new(config, camera.pinhole, mask, 0).unwrap();
    let frame = |slam: &Slam, k: usize| {
        let rendered = sequence.frame(shown(k)).unwrap();
        slam.setup.frame(FrameInput {
            index: k,
            timestamp_ns: k as i64 * 133_333_333,
            image: rendered.image,
            depth: sequence
                .depth(shown(k))
                .filter(|_| k == FRAMES - 1)
                .map(Into::into),
        })
    };
    let last = FRAMES - 1;
    let earlier = (0..last).map(|k| BufferedFrame::new(&frame(&slam, k)));
    let earlier = earlier.collect();
    let start = slam.start.take();
    let outcome = start.unwrap().add_frame(frame(&slam, last), &slam.setup);
    let started = outcome.expect("true depth decides at once");
    let mut report = FrameReport::new(last, 0, TrackingState::Initialising);
    slam.begin_map(
        MAIN_MAP,
        Started {
            earlier,
            ..*started
        },
        &mut report,
    );
    slam
}

/// Settings with which the beginning of the clip cannot be tracked on its end.
fn demanding() -> SlamConfig {
    let mut config = SlamConfig::default();
    config.tracking.min_visible_share = 0.85;
    config
}

/// All frames have poses, and that of the first is right.
fn assert_known_from_the_first_frame_on(slam: &Slam, sequence: &SynthSequence) {
    let trajectory = slam.trajectory();
    assert_eq!(trajectory.len(), FRAMES);
    let true_pose = |k: usize| sequence.frame(shown(k)).unwrap().world_from_camera;
    let (first, end) = (true_pose(0), true_pose(FRAMES - 1));
    let expected = end.inverse() * first;
    let error = expected.inverse() * trajectory[0].world_from_camera;
    let (error_m, length_m) = (error.translation.norm(), expected.translation.norm());
    assert!(error_m < 0.02 * length_m, "{error_m} of {length_m} m");
}

#[test]
fn frames_before_the_start_that_the_first_keyframe_shows_need_no_other() {
    let sequence = small_demo();
    let slam = started_at_the_end(sequence, SlamConfig::default());
    assert_eq!(slam.map.keyframes().len(), 1);
    assert_known_from_the_first_frame_on(&slam, sequence);
}

#[test]
fn other_frames_before_the_start_get_keyframes_and_tracking_goes_on_at_the_first() {
    let sequence = small_demo();
    let slam = started_at_the_end(sequence, demanding());
    let keyframes = slam.map.keyframes();
    assert!(keyframes.len() > 1, "{}", keyframes.len());
    assert!(keyframes.iter().skip(1).all(|k| k.frame_index < FRAMES - 1));
    assert!(keyframes.iter().all(|k| k.published.is_some()));
    assert_eq!(
        slam.tracker.active.as_ref().map(|active| active.id),
        Some(0)
    );
    assert_eq!(slam.policy.num_mapped(), 0);
    assert_known_from_the_first_frame_on(&slam, sequence);

    let mut config = demanding();
    config.keyframes.reactivation.enabled = false;
    let without_kept_depth = started_at_the_end(sequence, config);
    assert_eq!(without_kept_depth.map.keyframes().len(), 1);
}
