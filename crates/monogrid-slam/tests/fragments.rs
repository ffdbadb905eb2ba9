//! A lost camera begins a fragment of the map, which is joined when it is recognised, and only
//! then.
#![allow(clippy::too_many_lines, reason = "a test tells its story in one place")]
#![allow(clippy::unwrap_used, reason = "a test fails where it unwraps")]

use monogrid_geometry::{Se3, Vec3};
use monogrid_image::{GrayImage, Mask};
use monogrid_slam::{
    Fragment, FrameInput, FrameReport, MAIN_MAP, PoseSnapshot, Purpose, Slam, SlamConfig,
    StoredKeyframe, StoredMap, TrackingState, TrajectoryPose,
};
use monogrid_worlds::SynthSequence;
use std::fmt::Write;
use std::sync::OnceLock;

/// Every second frame of the small demonstration is shown, at its own pace.
const STEP: usize = 2;
const INTERVAL_NS: i64 = 66_666_667;
/// The known part, and another that ends there.
const KNOWN: std::ops::Range<usize> = 0..80;
const BACK: std::ops::Range<usize> = 880..1300;

struct World {
    sequence: SynthSequence,
    known: Vec<GrayImage>,
    back: Vec<GrayImage>,
}

fn world() -> &'static World {
    static WORLD: OnceLock<World> = OnceLock::new();
    WORLD.get_or_init(|| {
        let sequence = SynthSequence::small_demo().unwrap();
        let images = |range: std::ops::Range<usize>| {
            let frames = range.step_by(STEP);
            frames.map(|k| sequence.frame(k).unwrap().image).collect()
        };
        let (known, back) = (images(KNOWN), images(BACK));
        World {
            sequence,
            known,
            back,
        }
    })
}

/// What a camera in the mirrored room sees: a place that looks alike and is another.
fn mirrored() -> Vec<GrayImage> {
    let mirror = |image: &GrayImage| {
        let width = image.width();
        GrayImage::from_fn(width, image.height(), |x, y| image.at(width - 1 - x, y))
    };
    let frames = (30..180).step_by(STEP);
    frames
        .map(|k| mirror(&world().sequence.frame(k).unwrap().image))
        .collect()
}

/// A video of the images, whose first one has depth.
fn video<'a>(images: impl Iterator<Item = &'a GrayImage>) -> Vec<FrameInput> {
    images
        .enumerate()
        .map(|(index, image)| FrameInput {
            index,
            timestamp_ns: index as i64 * INTERVAL_NS,
            image: image.clone(),
            depth: (index == 0)
                .then(|| world().sequence.depth(0))
                .flatten()
                .map(Into::into),
        })
        .collect()
}

fn known_then(after: &[GrayImage]) -> Vec<FrameInput> {
    video(world().known.iter().chain(after))
}

fn system() -> Slam {
    let camera = world().sequence.camera();
    let mask = Mask::filled(camera.width, camera.height, 255);
    Slam::new(SlamConfig::default(), camera.pinhole, mask, 0).unwrap()
}

fn run(slam: &mut Slam, inputs: &[FrameInput]) -> Vec<FrameReport> {
    let inputs = inputs.iter();
    inputs.map(|i| slam.process_frame(i.clone())).collect()
}

/// True pose relative to the first frame.
fn truth(frame: usize) -> Se3 {
    let pose = |k| world().sequence.world_from_camera(k).unwrap();
    pose(0).inverse() * pose(frame)
}

/// The frame of the demonstration that frame `index` of [`known_then`] the way back shows.
fn shown(index: usize) -> usize {
    match index.checked_sub(world().known.len()) {
        Some(back) => BACK.start + STEP * back,
        None => KNOWN.start + STEP * index,
    }
}

fn largest_error(poses: impl Iterator<Item = (usize, Se3)>) -> f64 {
    let errors = poses.map(|(frame, pose)| (pose.translation - truth(frame).translation).norm());
    errors.fold(0.0, f64::max)
}

fn in_state(reports: &[FrameReport], state: TrackingState) -> usize {
    reports.iter().filter(|r| r.state == state).count()
}

/// The known part and the way back to it.
struct Outcome {
    reports: Vec<FrameReport>,
    fragments: Vec<Fragment>,
    snapshot: PoseSnapshot,
    trajectory: Vec<TrajectoryPose>,
    /// Poses that are left in fragment 1.
    num_apart: usize,
}

/// It on three threads.
fn there_and_back() -> &'static Outcome {
    static RUN: OnceLock<Outcome> = OnceLock::new();
    RUN.get_or_init(|| there_and_back_on(3))
}

fn there_and_back_on(threads: usize) -> Outcome {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
    pool.build().unwrap().install(|| {
        let mut slam = system();
        let reports = run(&mut slam, &known_then(&world().back));
        slam.finish();
        Outcome {
            reports,
            fragments: slam.fragments(),
            snapshot: PoseSnapshot::clone(&slam.snapshot()),
            trajectory: slam.trajectory(),
            num_apart: slam.trajectory_in(1).len(),
        }
    })
}

#[test]
fn a_fragment_is_joined_when_the_camera_comes_back() {
    let outcome = there_and_back();
    let (before, after) = outcome.reports.split_at(world().known.len());
    assert!(before.iter().all(|r| r.state == TrackingState::Good));
    // nobody was told a pose in the map before the place was known
    let started = after.iter().position(|r| r.started_fragment == Some(1));
    let joined = after.iter().position(|r| r.joined_fragments == [1]);
    let (started, joined) = (started.unwrap(), joined.unwrap());
    for (k, report) in after.iter().enumerate().take(joined) {
        assert!(report.world_from_camera.is_none() && report.odom_from_camera.is_none());
        let is_fragment = report.fragment.is_some_and(|f| f.id == 1);
        assert_eq!(is_fragment, report.state == TrackingState::Fragment);
        assert!(k >= started || report.state == TrackingState::Lost, "{k}");
    }
    let lost_secs = started as f64 * INTERVAL_NS as f64 * 1e-9;
    assert!(lost_secs >= SlamConfig::default().fragments.min_lost_secs);
    assert!(in_state(after, TrackingState::Fragment) > 20);
    assert_eq!(in_state(&after[started..], TrackingState::Lost), 0);
    let fragments = &outcome.fragments;
    assert_eq!(fragments.len(), 1);
    let join = fragments[0].joined.unwrap();
    assert_eq!((join.into, join.frame), (MAIN_MAP, before.len() + joined));
    assert!(fragments[0].keyframes > 2 && fragments[0].frames > 20);
    assert!(outcome.snapshot.fragment.iter().all(|f| *f == MAIN_MAP));
    assert_eq!(outcome.num_apart, 0);
    // afterwards its frames have poses in the map, in metres; the path is five metres long
    let of_fragment: Vec<(usize, Se3)> = outcome
        .trajectory
        .iter()
        .filter(|p| p.frame_index >= before.len())
        .map(|p| (shown(p.frame_index), p.world_from_camera))
        .collect();
    // from the first lost frame on, long before the fragment was started
    assert_eq!(of_fragment.len(), after.len());
    let error = largest_error(of_fragment[started..].iter().copied());
    assert!(error < 0.1, "final {error}");
    // those before it lie farthest from where the fragment was joined
    let error = largest_error(of_fragment.into_iter());
    assert!(error < 0.15, "final, all {error}");
    let live = after.iter().filter_map(|report| {
        let pose = report.world_from_camera?;
        Some((shown(report.index), pose))
    });
    let live: Vec<(usize, Se3)> = live.collect();
    assert!(!live.is_empty());
    let error = largest_error(live.into_iter());
    assert!(error < 0.1, "as reported {error}");
    // odometry never jumps: how the camera came there is not known
    let odometry = |report: &FrameReport| report.odom_from_camera;
    let last = before.iter().rev().find_map(odometry).unwrap();
    let next = after.iter().find_map(odometry).unwrap();
    assert!((last.inverse() * next).log().norm() < 0.05);
}

#[test]
fn another_place_that_looks_alike_stays_apart_and_moves_nothing() {
    let mut slam = system();
    let other = mirrored();
    let inputs = known_then(&other);
    let num_known = world().known.len();
    let mut reports = run(&mut slam, &inputs[..num_known]);
    let mut earlier = None;
    for input in &inputs[num_known..] {
        reports.push(slam.process_frame(input.clone()));
        let started = reports.iter().position(|r| r.started_fragment.is_some());
        if started.is_some_and(|k| k + 6 == reports.len()) {
            earlier = Some(slam.snapshot());
        }
    }
    let earlier = earlier.unwrap();
    let last = slam.snapshot();
    let num_main = earlier.fragment.iter().filter(|f| **f == MAIN_MAP).count();
    assert_eq!(last.fragment[..num_main], earlier.fragment[..num_main]);
    assert!(last.fragment[num_main..].iter().all(|f| *f == 1));
    assert!(last.fragment.len() > num_main + 2);
    assert_eq!(
        last.world_from_keyframe[..num_main],
        earlier.world_from_keyframe[..num_main]
    );
    let after = &reports[num_known..];
    assert!(after.iter().all(|r| r.world_from_camera.is_none()));
    assert!(after.iter().all(|r| r.joined_fragments.is_empty()));
    assert!(in_state(after, TrackingState::Fragment) > 20);
    slam.finish();
    assert!(slam.fragments()[0].joined.is_none());
    assert!(slam.trajectory().iter().all(|p| p.frame_index < num_known));
    let poses = slam.trajectory_in(1);
    assert!(poses.len() > 20, "{}", poses.len());
    assert_eq!(slam.pose_graph().nodes().len(), num_main);
    // the known part is as good as without the rest
    let main = slam.trajectory().into_iter();
    let error = largest_error(main.map(|p| (shown(p.frame_index), p.world_from_camera)));
    assert!(error < 0.03, "{error}");
    // the fragment has the shape of the mirrored room, but for place and scale
    let mirror = |v: Vec3| Vec3::new(-v.x, v.y, v.z);
    let frames = poses
        .iter()
        .map(|p| 30 + STEP * (p.frame_index - num_known));
    let (estimate, target): (Vec<Vec3>, Vec<Vec3>) = poses
        .iter()
        .zip(frames)
        .map(|(p, frame)| {
            (
                p.world_from_camera.translation,
                mirror(truth(frame).translation),
            )
        })
        .unzip();
    let fit = monogrid_geometry::align_similarity(&estimate, &target, true).unwrap();
    let errors = estimate.iter().zip(&target);
    let error = errors
        .map(|(e, t)| (fit.target_from_source * *e - t).norm())
        .fold(0.0, f64::max);
    assert!(error < 0.05, "{error}");

    // a later session knows the fragment by itself
    let map = slam.stored_map();
    // what is said of keyframes without their images is the same
    let links = map.keyframes.iter().map(StoredKeyframe::link);
    assert_eq!(slam.links(), links.collect::<Vec<_>>());
    assert_eq!(
        (slam.edges(), slam.points().collect::<Vec<_>>()),
        (map.edges.clone(), map.points.clone())
    );
    let mut again = continued(map, Purpose::Extend);
    let reports = run(&mut again, &video(other[30..].iter()));
    assert!(reports.iter().all(|r| r.world_from_camera.is_none()));
    assert!(in_state(&reports, TrackingState::Fragment) > 10);
    let ids = reports.iter().filter_map(|r| r.fragment).map(|f| f.id);
    assert!(ids.into_iter().all(|id| id == 1));
    assert_eq!(again.fragments().len(), 1);
}

#[test]
fn the_map_is_the_largest_fragment_in_the_end() {
    let other = mirrored();
    let num_known = 30;
    let mut inputs = video(world().known[..num_known].iter().chain(&other));
    for input in &mut inputs {
        input.depth = None;
    }
    let mut slam = system();
    let reports = run(&mut slam, &inputs);
    assert_eq!(slam.exchanged(), None);
    assert!(in_state(&reports[..num_known], TrackingState::Good) > 10);
    assert!(in_state(&reports, TrackingState::Fragment) > 50);
    let (before, apart) = (slam.trajectory(), slam.trajectory_in(1));
    assert!(apart.len() as f64 > 1.5 * before.len() as f64);
    slam.finish();
    assert_eq!(slam.exchanged(), Some(1));
    let (after, first) = (slam.trajectory(), slam.trajectory_in(1));
    assert_eq!((after.len(), first.len()), (apart.len(), before.len()));
    assert!(after.iter().all(|pose| pose.frame_index >= num_known));
    let fragments = slam.fragments();
    assert_eq!(fragments.len(), 1);
    assert_eq!(fragments[0].frames, first.len());
    assert!(fragments[0].first_frame < num_known && fragments[0].joined.is_none());
    // the graph of the result begins with its own first keyframe
    let graph = slam.pose_graph();
    let fixed = graph.nodes().iter().filter(|node| node.is_fixed);
    assert_eq!(fixed.count(), 1);

    // a later session begins in the larger one, and knows the other
    let again = continued(slam.stored_map(), Purpose::Extend);
    assert_eq!(again.snapshot().fragment, slam.snapshot().fragment);
    assert_eq!(again.fragments().len(), 1);

    // a first map in metres stays the map
    inputs[0].depth = world().sequence.depth(0).map(Into::into);
    let mut slam = system();
    run(&mut slam, &inputs);
    slam.finish();
    assert_eq!(slam.exchanged(), None);
    assert!(slam.trajectory_in(1).len() > slam.trajectory().len());
}

fn continued(map: StoredMap, purpose: Purpose) -> Slam {
    let camera = world().sequence.camera();
    let mask = Mask::filled(camera.width, camera.height, 255);
    let config = SlamConfig::default();
    Slam::continue_from(config, camera.pinhole, mask, 0, map, purpose).unwrap()
}

#[test]
fn a_session_that_begins_elsewhere_finds_into_the_map() {
    let mut first = system();
    run(&mut first, &known_then(&[]));
    first.finish();
    let map = first.stored_map();
    let inputs = video(world().back.iter());
    let mut slam = continued(map.clone(), Purpose::Extend);
    let reports = run(&mut slam, &inputs);
    slam.finish();
    assert!(reports.iter().any(|r| r.started_fragment == Some(1)));
    assert_eq!(slam.fragments()[0].joined.map(|j| j.into), Some(MAIN_MAP));
    let poses = slam.trajectory();
    assert!(poses.len() > 60);
    let of_frame = |index: usize| BACK.start + STEP * index;
    let error = largest_error(
        poses
            .iter()
            .map(|p| (of_frame(p.frame_index), p.world_from_camera)),
    );
    assert!(error < 0.15, "{error}");
    // a map that must stay as it is gets no fragments
    let mut slam = continued(map, Purpose::LocaliseOnly);
    let reports = run(&mut slam, &inputs[..30]);
    assert!(slam.fragments().is_empty());
    assert!(in_state(&reports, TrackingState::Fragment) == 0);
}

#[test]
fn the_same_bits_for_any_number_of_threads() {
    let text = |outcome: &Outcome| {
        let mut text = String::new();
        for report in &outcome.reports {
            let in_fragment = report.fragment.map(|f| f.fragment_from_camera);
            let pose = report.world_from_camera.or(in_fragment);
            writeln!(text, "{:?} {pose:?}", report.state).unwrap();
        }
        text + &format!("{:?} {:?}", outcome.snapshot, outcome.trajectory)
    };
    assert!(text(&there_and_back_on(1)) == text(there_and_back()));
}

#[test]
fn without_fragments_a_lost_camera_waits() {
    let mut config = SlamConfig::default();
    config.fragments.enabled = false;
    let camera = world().sequence.camera();
    let mask = Mask::filled(camera.width, camera.height, 255);
    let mut slam = Slam::new(config, camera.pinhole, mask, 0).unwrap();
    let other = mirrored();
    let reports = run(&mut slam, &known_then(&other));
    assert_eq!(in_state(&reports, TrackingState::Lost), other.len());
    assert!(slam.fragments().is_empty());
}
