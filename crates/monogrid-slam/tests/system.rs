//! The whole system on a rendered room: accuracy, determinism, starts, and input that is not a
//! video.
#![allow(clippy::too_many_lines, reason = "a test tells its story in one place")]
#![allow(clippy::unwrap_used, reason = "a test fails where it unwraps")]

use monogrid_evaluation::{StampedPose, TrajectoryConfig, TrajectoryReport, evaluate_trajectory};
use monogrid_geometry::{Rng, Se3, Sim3, Vec2, Vec3, rotation_exp};
use monogrid_image::{GrayImage, Mask, bilinear};
use monogrid_slam::{
    DepthInput, DepthPixel, FrameInput, FrameReport, InitializationMode, KeptKeyframe, LostReason,
    Scale, Slam, SlamConfig, TrackingState,
};
use monogrid_worlds::SynthSequence;
use std::sync::OnceLock;

const FRAMES: usize = 90;

struct Clip {
    sequence: SynthSequence,
    inputs: Vec<FrameInput>,
    truth: Vec<StampedPose>,
}

/// The small demonstration, whose world is made once.
fn demo() -> &'static SynthSequence {
    static DEMO: OnceLock<SynthSequence> = OnceLock::new();
    DEMO.get_or_init(|| SynthSequence::small_demo().unwrap())
}

/// The first three seconds of the small demonstration, rendered once.
fn clip() -> &'static Clip {
    static CLIP: OnceLock<Clip> = OnceLock::new();
    CLIP.get_or_init(|| {
        let sequence = demo().clone().shortened(FRAMES);
        let mut inputs = Vec::new();
        let mut truth = Vec::new();
        for k in 0..sequence.len() {
            let frame = sequence.frame(k).unwrap();
            truth.push((frame.timestamp_ns, frame.world_from_camera));
            inputs.push(FrameInput {
                index: k,
                timestamp_ns: frame.timestamp_ns,
                image: frame.image,
                depth: None,
            });
        }
        Clip {
            sequence,
            inputs,
            truth,
        }
    })
}

fn system(config: SlamConfig, seed: u64) -> Slam {
    let camera = clip().sequence.camera();
    let mask = Mask::filled(camera.width, camera.height, 255);
    Slam::new(config, camera.pinhole, mask, seed).unwrap()
}

fn run(config: SlamConfig, seed: u64, inputs: &[FrameInput]) -> (Slam, Vec<FrameReport>) {
    let mut slam = system(config, seed);
    let reports = inputs
        .iter()
        .map(|input| slam.process_frame(input.clone()))
        .collect();
    slam.finish();
    (slam, reports)
}

fn evaluate(slam: &Slam) -> TrajectoryReport {
    let estimate: Vec<StampedPose> = slam
        .trajectory()
        .iter()
        .map(|p| (p.timestamp_ns, p.world_from_camera))
        .collect();
    evaluate_trajectory(&estimate, &clip().truth, &TrajectoryConfig::default()).unwrap()
}

fn with_seed_depth() -> Vec<FrameInput> {
    let mut inputs = clip().inputs.clone();
    inputs[0].depth = clip().sequence.depth(0).map(Into::into);
    inputs
}

/// Everything that must not depend on threads or on the run, as text.
fn fingerprint(slam: &Slam, reports: &[FrameReport]) -> String {
    use std::fmt::Write;
    let mut text = String::new();
    for pose in slam.trajectory() {
        writeln!(text, "{pose:?}").unwrap();
    }
    writeln!(text, "{:?}", slam.snapshot()).unwrap();
    for keyframe in slam.keyframes() {
        let keyframe = keyframe.load().unwrap();
        writeln!(text, "{} {:?}", keyframe.id, keyframe.pixels).unwrap();
    }
    for report in reports {
        writeln!(
            text,
            "{:?} {:?} {:?} {:?}",
            report.state, report.world_from_camera, report.odom_from_camera, report.covariance
        )
        .unwrap();
    }
    text
}

#[test]
fn starts_from_two_views_and_gives_every_frame_a_pose() {
    let (slam, reports) = run(SlamConfig::default(), 0, &clip().inputs);
    let report = evaluate(&slam);
    assert!((report.coverage - 1.0).abs() < 1e-9, "{}", report.coverage);
    // about 1 % of the path of the clip; measured 0.2 %
    assert!(
        report.ate_rmse < 0.01 * report.path_length,
        "{} of {}",
        report.ate_rmse,
        report.path_length
    );
    assert_eq!(slam.scale(), Scale::Arbitrary);
    assert_eq!(slam.counts().lost_episodes, 0);
    assert_eq!(reports[0].state, TrackingState::Initialising);
    let tracked = reports.last().unwrap();
    assert_eq!(tracked.state, TrackingState::Good);
    assert!(tracked.covariance.is_some());
    assert!(slam.keyframes().iter().all(|k| k.num_pixels > 1000));
}

#[test]
fn a_seed_depth_makes_the_scale_metric() {
    let (slam, reports) = run(SlamConfig::default(), 0, &with_seed_depth());
    let report = evaluate(&slam);
    assert_eq!(slam.scale(), Scale::Metric);
    assert!((report.scale - 1.0).abs() < 0.02, "scale {}", report.scale);
    assert!(report.ate_rmse < 0.01 * report.path_length);
    assert_eq!(reports[0].state, TrackingState::Good);
    assert!(reports[0].created_keyframe);
}

/// All of the clip with what a depth camera would measure with every frame of these: its noise is
/// that of structured light, and some pixels are holes.
fn with_depth_camera(has_depth: impl Fn(usize) -> bool) -> Vec<FrameInput> {
    let mut inputs = clip().inputs.clone();
    for k in (0..FRAMES).filter(|k| has_depth(*k)) {
        let depth = clip().sequence.depth(k).unwrap();
        let mut random = Rng::new(k as u64);
        let mut uniform = || (random.next_u64() >> 40) as f32 / (1u32 << 24) as f32;
        inputs[k].depth = Some(DepthInput::Measured(depth.map(|z| {
            let normal = (0..12).map(|_| uniform()).sum::<f32>() - 6.0;
            let is_hole = uniform() < 0.02;
            if is_hole {
                f32::NAN
            } else {
                z + 0.0014 * z * z * normal
            }
        })));
    }
    inputs
}

#[test]
fn a_depth_camera_holds_the_scale_with_every_frame_and_with_few() {
    let (all, reports) = run(SlamConfig::default(), 0, &with_depth_camera(|_| true));
    let (seldom, _) = run(
        SlamConfig::default(),
        0,
        &with_depth_camera(|k| k % 20 == 0),
    );
    assert!(reports.iter().all(|r| r.state == TrackingState::Good));
    let [with, rare] = [&all, &seldom].map(evaluate);
    for (slam, report) in [(&all, &with), (&seldom, &rare)] {
        assert_eq!(slam.scale(), Scale::Metric);
        assert!((report.scale - 1.0).abs() < 0.005, "scale {}", report.scale);
        let share = report.ate_rmse / report.path_length;
        assert!(share < 0.005, "{} m", report.ate_rmse);
    }
    assert_eq!(all.num_measured_keyframes(), all.num_keyframes());
    // the last one was made after the last depth image
    assert!(seldom.num_measured_keyframes() + 1 >= seldom.num_keyframes());
    // what is published of a keyframe is what the depth camera saw of it
    let area = clip().sequence.camera().width * clip().sequence.camera().height;
    assert!(all.keyframes().iter().all(|k| k.num_pixels > area * 8 / 10));
}

#[test]
fn frames_before_the_first_measured_depth_wait_and_are_tracked_backwards() {
    let inputs = with_depth_camera(|k| k == 15);
    let mut slam = system(SlamConfig::default(), 0).with_first_measured(15);
    let reports: Vec<FrameReport> = inputs
        .iter()
        .cloned()
        .map(|i| slam.process_frame(i))
        .collect();
    slam.finish();
    assert!(
        reports[..15]
            .iter()
            .all(|r| r.reason == Some(LostReason::WaitingForDepth))
    );
    assert!(reports[15].created_keyframe && slam.keyframes()[0].frame_index == 15);
    assert_eq!(
        (slam.trajectory().len(), slam.scale()),
        (FRAMES, Scale::Metric)
    );
    let report = evaluate(&slam);
    assert!(
        report.ate_rmse < 0.01 * report.path_length,
        "{} m",
        report.ate_rmse
    );
}

#[test]
fn where_too_little_is_measured_the_start_is_as_it_would_be_without() {
    let mut inputs = clip().inputs.clone();
    let (width, height) = (inputs[0].image.width(), inputs[0].image.height());
    inputs[5].depth = Some(GrayImage::filled(width, height, f32::NAN).into());
    let mut slam = system(SlamConfig::default(), 0).with_first_measured(5);
    let reports: Vec<FrameReport> = inputs.into_iter().map(|i| slam.process_frame(i)).collect();
    slam.finish();
    let waits = |r: &FrameReport| r.reason == Some(LostReason::WaitingForDepth);
    assert!(reports[..5].iter().all(waits) && !reports[5..].iter().any(waits));
    assert_eq!(slam.scale(), Scale::Arbitrary);
    assert_eq!(reports.last().unwrap().state, TrackingState::Good);
}

#[test]
fn a_camera_that_only_turns_is_tracked_with_depth() {
    let sequence = demo();
    let camera = sequence.camera();
    // one picture in the middle of a turn: what the pixels of a camera that turned about its
    // centre show follows from it
    let frame = sequence.frame(0).unwrap();
    let depth = sequence.depth(0).unwrap();
    let turned = |angle: f64| {
        let pinhole = camera.pinhole;
        let first_from_turned = rotation_exp(&Vec3::new(0.0, angle, 0.0));
        let seen = |x: usize, y: usize| {
            let ray = first_from_turned * pinhole.unproject(&Vec2::new(x as f64, y as f64));
            (pinhole.project(&ray), ray.z)
        };
        let inside = |at: &Vec2| {
            let (w, h) = (camera.width as f64, camera.height as f64);
            at.x >= 0.0 && at.y >= 0.0 && at.x < w - 1.0 && at.y < h - 1.0
        };
        let image = GrayImage::from_fn(camera.width, camera.height, |x, y| {
            let (at, _) = seen(x, y);
            bilinear(&frame.image, at.x as f32, at.y as f32).unwrap_or(0.0)
        });
        let depth = GrayImage::from_fn(camera.width, camera.height, |x, y| {
            let (at, along) = seen(x, y);
            let z = if inside(&at) {
                depth.at(at.x as usize, at.y as usize)
            } else {
                f32::NAN
            };
            z / along as f32
        });
        (image, depth)
    };
    let mut slam = system(SlamConfig::default(), 0);
    for k in 0..12 {
        let angle = 0.02 * k as f64;
        let (image, depth) = turned(angle);
        let report = slam.process_frame(FrameInput {
            index: k,
            timestamp_ns: k as i64 * 33_333_333,
            image,
            depth: Some(depth.into()),
        });
        assert_eq!(report.state, TrackingState::Good, "frame {k}");
        let pose = report.world_from_camera.unwrap();
        assert!(pose.translation.norm() < 0.01, "frame {k}: {pose:?}");
        assert!(
            (pose.rotation.angle() - angle).abs() < 0.002,
            "frame {k}: {pose:?}"
        );
    }
}

#[test]
fn the_same_bits_for_any_number_of_threads_and_any_memory() {
    let inputs = &clip().inputs[..70];
    let on = |threads: usize, memory_mb: f64| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
        pool.build().unwrap().install(|| {
            let mut config = SlamConfig::default();
            config.memory.keyframes_mb = memory_mb;
            config.memory.prepared_mb = memory_mb;
            let mut slam = system(config, 3);
            slam.spill_into(tempfile::tempfile().unwrap());
            let process = |input: &FrameInput| slam.process_frame(input.clone());
            let reports: Vec<FrameReport> = inputs.iter().map(process).collect();
            let has_room = memory_mb > 0.0;
            if has_room {
                slam.finish();
            } else {
                // what is given back before the last adjustment changes nothing
                let mut told = 0;
                slam.conclude(&mut |slam| {
                    told += 1;
                    slam.room().give(0);
                });
                assert_eq!(told, 1);
            }
            let text = fingerprint(&slam, &reports);
            (text, slam.map_size().bytes, slam.num_keyframes())
        })
    };
    let (one, all, count) = on(1, 1e6);
    assert!(one.len() > 10_000 && count > 1 && all.in_file == 0);
    assert!(one == on(2, 1e6).0, "two threads differ");
    let (five, spilled, _) = on(5, 0.0);
    assert!(one == five, "five threads without memory differ");
    // the value used last stays, and nothing is lost in the file
    assert!(
        spilled.keyframes * count < all.keyframes,
        "{spilled:?} {all:?}"
    );
    assert!(spilled.in_file > all.keyframes / 2, "{spilled:?} {all:?}");
}

#[test]
fn the_thesis_profile_starts_at_random_with_its_seed() {
    let (slam, reports) = run(SlamConfig::thesis(), 1, &clip().inputs);
    assert_eq!(reports[0].state, TrackingState::Good);
    assert!(!slam.keyframes().is_empty());
    assert!(slam.points().next().is_none(), "no sparse layer");
    let (again, reports_again) = run(SlamConfig::thesis(), 1, &clip().inputs);
    assert!(fingerprint(&slam, &reports) == fingerprint(&again, &reports_again));
    let (other, other_reports) = run(SlamConfig::thesis(), 2, &clip().inputs);
    assert!(fingerprint(&slam, &reports) != fingerprint(&other, &other_reports));
}

#[test]
fn repeated_images_take_over_the_pose_and_change_nothing_else() {
    let mut inputs = with_seed_depth();
    inputs.truncate(30);
    let mut repeated = inputs.clone();
    let mut copy = inputs[20].clone();
    copy.timestamp_ns += 1_000_000;
    repeated.insert(21, copy);
    let (plain, _) = run(SlamConfig::default(), 0, &inputs);
    let (with_copy, reports) = run(SlamConfig::default(), 0, &repeated);
    assert_eq!(reports[21].reason, Some(LostReason::Repeated));
    assert_eq!(reports[21].world_from_camera, reports[20].world_from_camera);
    let last = |slam: &Slam| slam.trajectory().last().unwrap().world_from_camera;
    assert_eq!(last(&plain), last(&with_copy));
}

#[test]
fn nothing_to_see_is_no_map() {
    let camera = clip().sequence.camera();
    let blank = |k: usize, value: f32| FrameInput {
        index: k,
        timestamp_ns: k as i64 * 33_000_000,
        image: GrayImage::filled(camera.width, camera.height, value),
        depth: None,
    };
    for config in [SlamConfig::default(), SlamConfig::thesis()] {
        let inputs: Vec<FrameInput> = (0..20).map(|k| blank(k, k as f32)).collect();
        let (slam, reports) = run(config, 0, &inputs);
        assert!(slam.keyframes().is_empty());
        assert!(slam.trajectory().is_empty());
        assert!(reports.iter().all(|r| r.reason.is_some()));
    }
}

#[test]
fn a_camera_that_stands_still_does_not_start() {
    let one = &clip().inputs[0];
    let inputs: Vec<FrameInput> = (0..40)
        .map(|k| {
            // the noise of another frame each time, so that images are not repeated
            let mut input = one.clone();
            input.index = k;
            input.timestamp_ns = k as i64 * 33_000_000;
            for (i, value) in input.image.as_mut_slice().iter_mut().enumerate() {
                *value += ((i * 31 + k * 17) % 5) as f32 - 2.0;
            }
            input
        })
        .collect();
    let (slam, _) = run(SlamConfig::default(), 0, &inputs);
    assert!(slam.keyframes().is_empty());
}

#[test]
fn a_covered_lens_is_lost_with_a_reason_and_found_again() {
    let mut inputs = with_seed_depth();
    for input in &mut inputs[40..43] {
        input.image = GrayImage::filled(320, 240, 12.0);
    }
    let (slam, reports) = run(SlamConfig::default(), 0, &inputs);
    for report in &reports[40..43] {
        assert_eq!(report.state, TrackingState::Lost);
        assert!(report.reason.is_some() && report.world_from_camera.is_none());
    }
    assert_eq!(slam.counts().lost_episodes, 1);
    assert!(reports[50..].iter().all(|r| r.state == TrackingState::Good));
    let report = evaluate(&slam);
    assert!(report.ate_rmse < 0.015 * report.path_length);
}

#[test]
fn odometry_follows_the_camera_from_frame_to_frame() {
    let (slam, reports) = run(SlamConfig::default(), 0, &with_seed_depth());
    assert!(slam.keyframes().len() > 2, "a keyframe was changed");
    let truth = &clip().truth;
    let odometry = |k: usize| reports[k].odom_from_camera.unwrap();
    for k in 1..reports.len() {
        let step = odometry(k - 1).inverse() * odometry(k);
        let true_step = truth[k - 1].1.inverse() * truth[k].1;
        let error = step.inverse() * true_step;
        assert!(error.translation.norm() < 0.004, "{k}: {error:?}");
        assert!(error.rotation.angle() < 0.003, "{k}: {error:?}");
    }
    let last = reports.last().unwrap();
    let corrected = last.map_from_odom().unwrap() * last.odom_from_camera.unwrap();
    let difference = corrected.inverse() * last.world_from_camera.unwrap();
    assert!(difference.translation.norm() < 1e-9);
}

/// Forth and back without points, from a random start: the map drifts, and is corrected where the
/// camera comes back to what it saw.
#[test]
fn what_is_around_the_camera_stays_where_it_is_when_the_map_is_corrected() {
    let forth = (0..300).step_by(3);
    let back = (0..300).step_by(3).rev().skip(1);
    let inputs = forth.chain(back).enumerate().map(|(index, k)| FrameInput {
        index,
        timestamp_ns: 33_333_333 * index as i64,
        image: demo().frame(k).unwrap().image,
        depth: None,
    });
    let mut slam = system(SlamConfig::thesis(), 1);
    let mut placed: Option<(u32, Se3, Sim3)> = None;
    let mut last: Option<Se3> = None;
    let (mut correction, mut shift, mut keyframes) = (0.0_f64, 0.0_f64, 0);
    for input in inputs {
        let report = slam.process_frame(input);
        let poses = report.odom_from_camera.zip(report.map_from_odom());
        let Some((odom_from_camera, map_from_odom)) = poses else {
            continue;
        };
        let step = last.map(|last| last.inverse() * map_from_odom);
        correction = correction.max(step.map_or(0.0, |step| step.translation.norm()));
        last = Some(map_from_odom);
        let now = slam.keyframe_in_use().unwrap();
        assert!(now.num_gaps == 0 && !now.pixels.is_empty());
        match placed {
            // the camera moves by what was tracked alone, in the unit of now
            Some((id, odom_from_last, last_from_keyframe)) if id == now.id => {
                let unit = now.camera_from_keyframe.scale / last_from_keyframe.scale;
                let last_from_keyframe = last_from_keyframe.to_se3().stretched(unit);
                let keyframe_from_this = now.camera_from_keyframe.to_se3().inverse();
                let tracked = last_from_keyframe * keyframe_from_this;
                let moved = odom_from_last.inverse() * odom_from_camera;
                shift = shift.max((moved.translation - tracked.translation).norm());
            }
            _ => keyframes += 1,
        }
        placed = Some((now.id, odom_from_camera, now.camera_from_keyframe));
    }
    assert!(keyframes > 5, "{keyframes}");
    assert!(correction > 0.01, "nothing was corrected: {correction}");
    assert!(
        shift < 0.05 * correction,
        "{shift} at a correction of {correction}"
    );
}

/// After ten seconds the video jumps back to its beginning: to another keyframe than the last.
#[test]
fn a_kidnapped_camera_is_recognised_at_an_old_keyframe() {
    const SEEN_AGAIN: std::ops::Range<usize> = 4..16;
    let sequence = demo();
    let mut inputs: Vec<FrameInput> = (0..300)
        .step_by(3)
        .enumerate()
        .map(|(index, k)| {
            let frame = sequence.frame(k).unwrap();
            FrameInput {
                index,
                timestamp_ns: frame.timestamp_ns,
                image: frame.image,
                depth: (k == 0)
                    .then(|| sequence.depth(0))
                    .flatten()
                    .map(Into::into),
            }
        })
        .collect();
    let jump = inputs.len();
    let end_ns = inputs[jump - 1].timestamp_ns;
    for k in SEEN_AGAIN {
        let index = inputs.len();
        inputs.push(FrameInput {
            index,
            timestamp_ns: end_ns + (index - jump + 1) as i64 * 100_000_000,
            ..inputs[k].clone()
        });
    }
    let mut slam = system(SlamConfig::default(), 0);
    let frames = inputs.iter().cloned();
    let reports: Vec<FrameReport> = frames.map(|frame| slam.process_frame(frame)).collect();
    // nobody knows how the camera came here, and what is around it
    assert_eq!(slam.keyframe_in_use().unwrap().num_gaps, 1);
    slam.finish();
    assert_eq!(slam.counts().relocalisations, 1);
    assert!(
        reports[jump..]
            .iter()
            .filter(|r| r.world_from_camera.is_none())
            .count()
            <= 2
    );
    // the jump is a correction of the map, not a motion
    let found = reports[jump..].iter().find(|r| r.relocalised).unwrap();
    let before = reports[jump - 1].odom_from_camera.unwrap();
    let motion = before.inverse() * found.odom_from_camera.unwrap();
    assert!(motion.translation.norm() < 1e-9 && motion.rotation.angle() < 1e-9);
    let correction = found.map_from_odom().unwrap();
    let earlier = reports[jump - 1].map_from_odom().unwrap();
    assert!((earlier.inverse() * correction).translation.norm() > 0.1);
    // what was seen twice has the same pose twice
    let poses = slam.trajectory();
    let pose = |index: usize| {
        Some(
            poses
                .iter()
                .find(|p| p.frame_index == index)?
                .world_from_camera,
        )
    };
    for (k, again) in SEEN_AGAIN.zip(jump..).skip(2) {
        let again_from_first = pose(again).unwrap().inverse() * pose(k).unwrap();
        let (moved, turned) = (again_from_first.translation, again_from_first.rotation);
        assert!(moved.norm() < 0.02, "frame {k}: {moved}");
        assert!(turned.angle() < 0.01, "frame {k}");
    }
}

#[test]
fn profiles_differ_in_every_documented_switch() {
    let (ours, thesis) = (SlamConfig::default(), SlamConfig::thesis());
    assert_eq!(thesis.initialization.mode, InitializationMode::Random);
    assert_eq!(ours.initialization.mode, InitializationMode::TwoView);
    assert!(ours.tracking.motion_hypotheses && !thesis.tracking.motion_hypotheses);
    assert!(thesis.publication.smoothed && !ours.publication.smoothed);
    assert!(ours.sparse.enabled && !thesis.sparse.enabled);
    assert!((thesis.keyframes.distance_weight - 3.0).abs() < 1e-12);
    assert!((thesis.keyframes.usage_weight - 4.0).abs() < 1e-12);
    assert_eq!(thesis.keyframes.old_keyframes_observed, 0);
    assert!(thesis.tracking.max_relative_sigma > ours.tracking.max_relative_sigma);
    assert_ne!(thesis.depth, ours.depth);
    assert_ne!(thesis.tracking.alignment, ours.tracking.alignment);
}

/// Each switch of a profile has an effect of its own on the result.
#[test]
fn each_switch_changes_the_result() {
    let inputs = &with_seed_depth()[..45];
    let reference = {
        let (slam, reports) = run(SlamConfig::default(), 0, inputs);
        fingerprint(&slam, &reports)
    };
    let thesis = SlamConfig::thesis();
    let switches: Vec<(&str, SlamConfig)> = [
        ("tracking.alignment", {
            let mut c = SlamConfig::default();
            c.tracking.alignment = thesis.tracking.alignment.clone();
            c
        }),
        ("tracking.motion_hypotheses", {
            let mut c = SlamConfig::default();
            c.tracking.motion_hypotheses = false;
            c
        }),
        ("tracking.max_relative_sigma", {
            let mut c = SlamConfig::default();
            c.tracking.max_relative_sigma = thesis.tracking.max_relative_sigma;
            c
        }),
        (
            "keyframes",
            SlamConfig {
                keyframes: thesis.keyframes.clone(),
                ..SlamConfig::default()
            },
        ),
        ("keyframes.old_keyframes_observed", {
            let mut c = SlamConfig::default();
            c.keyframes.old_keyframes_observed = 0;
            c
        }),
        (
            "depth",
            SlamConfig {
                depth: thesis.depth.clone(),
                ..SlamConfig::default()
            },
        ),
        (
            "publication",
            SlamConfig {
                publication: thesis.publication.clone(),
                ..SlamConfig::default()
            },
        ),
        ("sparse", {
            let mut c = SlamConfig::default();
            c.sparse.enabled = false;
            c
        }),
        ("graph", {
            let mut c = SlamConfig::default();
            c.graph.enabled = false;
            c
        }),
    ]
    .into();
    for (name, config) in switches {
        let (slam, reports) = run(config, 0, inputs);
        assert!(
            slam.trajectory().len() == inputs.len(),
            "{name}: {} poses",
            slam.trajectory().len()
        );
        assert!(
            fingerprint(&slam, &reports) != reference,
            "{name} changes nothing"
        );
    }
}

#[test]
fn world_starts_at_the_first_keyframe() {
    let (slam, _) = run(SlamConfig::default(), 0, &with_seed_depth()[..10]);
    let first = slam.trajectory()[0].world_from_camera;
    assert!((first.inverse() * Se3::identity()).log().norm() < 1e-9);
}

const ONE_WAY: usize = 70;

/// Seven seconds again and again, to the last frame and back to the first.
fn back_and_forth(ways: usize) -> Vec<FrameInput> {
    let sequence = demo();
    let frames: Vec<GrayImage> = (0..ONE_WAY)
        .map(|k| sequence.frame(3 * k).unwrap().image)
        .collect();
    (0..ways * ONE_WAY)
        .map(|index| FrameInput {
            index,
            timestamp_ns: index as i64 * 100_000_000,
            image: frames[source_of(index)].clone(),
            depth: (index == 0)
                .then(|| sequence.depth(0))
                .flatten()
                .map(Into::into),
        })
        .collect()
}

fn source_of(index: usize) -> usize {
    let (way, k) = (index / ONE_WAY, index % ONE_WAY);
    if way % 2 == 0 { k } else { ONE_WAY - 1 - k }
}

#[test]
fn a_camera_that_stays_in_one_place_needs_no_new_keyframes() {
    const WAYS: usize = 6;
    let inputs = back_and_forth(WAYS);
    let mut slam = system(SlamConfig::default(), 0);
    let mut sizes = Vec::new();
    let mut again = 0;
    for input in &inputs {
        let report = slam.process_frame(input.clone());
        assert_eq!(report.state, TrackingState::Good, "{}", input.index);
        again += usize::from(report.reactivated_keyframe.is_some());
        if (input.index + 1) % ONE_WAY == 0 {
            sizes.push(slam.map_size());
        }
    }
    slam.finish();
    assert!(again >= 6, "{again}");
    assert_eq!(slam.counts().reactivations, again);
    // each way leaves off somewhat elsewhere; after the third all views are known
    let (early, last) = (sizes[2], sizes[WAYS - 1]);
    assert_eq!(last.keyframes, early.keyframes, "{sizes:?}");
    assert_eq!(last.points, early.points, "{sizes:?}");
    assert!(last.edges <= early.edges * 11 / 10, "{sizes:?}");
    let (early, last) = (early.bytes.keyframes, last.bytes.keyframes);
    assert!(last <= early * 11 / 10, "{sizes:?}");
    // revisions stop when depth no longer improves
    let revisions: u32 = slam.keyframes().iter().map(|k| k.revision).sum();
    assert!(revisions > 0 && (revisions as usize) < again, "{revisions}");
    // and the same image has the same pose, each time
    let poses = slam.trajectory();
    assert_eq!(poses.len(), inputs.len());
    for (index, pose) in poses.iter().enumerate().skip(ONE_WAY) {
        let first = poses[source_of(index)].world_from_camera;
        let moved = pose.world_from_camera.inverse() * first;
        assert!(moved.translation.norm() < 0.02, "{index}: {moved:?}");
        assert!(moved.rotation.angle() < 0.01, "{index}: {moved:?}");
    }
    // nothing of this is needed to look at what was found
    let edges = slam.pose_graph().edges().len();
    let before = slam.map_size().bytes.keyframes;
    slam.release();
    let left = slam.map_size().bytes.keyframes;
    assert!(left < before * 2 / 3, "{before} {left}");
    let published: usize = slam.keyframes().iter().map(published_bytes).sum();
    assert!(
        published <= left && left < published * 11 / 10,
        "{published} {left}"
    );
    assert!(edges > 0 && slam.pose_graph().edges().len() == edges);
    assert_eq!(slam.trajectory().len(), poses.len());
    let index = inputs.len();
    let report = slam.process_frame(FrameInput {
        index,
        timestamp_ns: index as i64 * 100_000_000,
        ..inputs[0].clone()
    });
    assert_eq!(report.state, TrackingState::Lost);
    let mut without = SlamConfig::default();
    without.keyframes.reactivation.enabled = false;
    let (grown, _) = run(without, 0, &inputs);
    assert!(
        grown.keyframes().len() > slam.keyframes().len(),
        "{} {}",
        grown.keyframes().len(),
        slam.keyframes().len()
    );
}

/// What of a finished keyframe nobody can do without.
fn published_bytes(keyframe: &KeptKeyframe) -> usize {
    let (width, height) = keyframe.size();
    width * height + keyframe.num_pixels * size_of::<DepthPixel>()
}
