//! How much of the final map the map has that is read while it grows.
//!
//! `cargo run --release -p monogrid-studies --example live_depth -- FOLDER OUT [res=M] [frames=N]
//! [mapping settings=VALUE …]`
//!
//! Tracks the images of FOLDER, with the true depth of the first one where there is some, and gives
//! the maps all the time that they want after each frame, so that nothing depends on the computer.
//! Writes OUT/live.ot, as it is read after the last frame, and OUT/final.ot, which `monogrid
//! evaluate map OUT/live.ot OUT/final.ot` compares, in the frame of the true poses where there are
//! some, and says what the maps cost (CPU time of one thread).
#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a tool for development, read from top to bottom"
)]

use monogrid_geometry::{Sim3, Vec3, align_similarity};
use monogrid_mapping::{
    KeyframeCamera, LiveMaps, MAPPING, Mapper, MappingConfig, Waiting, final_scans_of,
    z_up_from_camera_world,
};
use monogrid_occupancy::{OccupancyMap, write_ot};
use monogrid_slam::{Event, FrameInput, Slam, SlamConfig};
use monogrid_studies::{Options, Sequence};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicUsize;
use std::time::{Duration, Instant};

fn main() {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [folder, out, rest @ ..] = &args[..] else {
        println!("usage: live_depth FOLDER OUT [res=M] [frames=N] [setting=VALUE …]");
        return;
    };
    let options = Options::read(rest.iter().cloned());
    let config = MappingConfig {
        resolution: options.number("res", 0.032),
        ..options.applied_to(MappingConfig::default(), MAPPING, "mapping")
    };
    let sequence = Sequence::open(folder);
    let mut slam = sequence.system(SlamConfig::default(), 0);
    let camera = KeyframeCamera::new(*sequence.pinhole(), sequence.undistorter.size());
    let mapper = Mapper::new(config, 1);
    let mut live = LiveMaps::new(mapper, z_up_from_camera_world()).unwrap();
    let reader = live.reader().unwrap();

    let (mut steps, mut longest) = (Duration::ZERO, Duration::ZERO);
    let frames = sequence.dataset.frames.iter().enumerate();
    for (frame, entry) in frames.take(options.number("frames", usize::MAX)) {
        let is_first = frame == 0;
        slam.process_frame(FrameInput {
            index: entry.index,
            timestamp_ns: entry.timestamp_ns,
            image: sequence.image(frame),
            depth: is_first
                .then(|| sequence.true_depth(entry.timestamp_ns))
                .flatten()
                .map(Into::into),
        });
        let started = Instant::now();
        hear(&mut live, &slam, &camera);
        loop {
            let step = Instant::now();
            if !live.step().unwrap() {
                break;
            }
            longest = longest.max(step.elapsed());
        }
        steps += started.elapsed();
    }
    let frame = true_frame(&slam, &sequence).unwrap_or_else(z_up_from_camera_world);
    live.bring_to(frame).unwrap();
    println!(
        "{} keyframes; live maps: {:.2} s, longest step {:.0} ms",
        slam.num_keyframes(),
        steps.as_secs_f64(),
        1e3 * longest.as_secs_f64()
    );
    let out = PathBuf::from(out);
    std::fs::create_dir_all(&out).unwrap();
    write(&reader.latest().unwrap().global, &out.join("live.ot"));

    finish(live, slam, &camera, &frame, &out.join("final.ot"));
}

/// Makes the final maps and writes *global*.
fn finish(mut live: LiveMaps, mut slam: Slam, camera: &KeyframeCamera, frame: &Sim3, path: &Path) {
    slam.finish();
    hear(&mut live, &slam, camera);
    live.rest();
    let done = AtomicUsize::new(0);
    let started = Instant::now();
    let config = live.mapper().config().clone();
    for scan in final_scans_of(&slam, &config, 1, &done) {
        live.revise(scan);
    }
    let snapshot = slam.snapshot();
    let maps = live.finish(&snapshot, frame, Some(Vec3::zeros()), 1, &done);
    write(&maps.unwrap().global, path);
    println!("final maps: {:.2} s", started.elapsed().as_secs_f64());
}

/// The frame of the true poses from that of the system.
fn true_frame(slam: &Slam, sequence: &Sequence) -> Option<Sim3> {
    if sequence.truth.is_empty() {
        return None;
    }
    let frames = sequence.dataset.frames.iter();
    let frame_of_time: BTreeMap<i64, usize> = frames
        .enumerate()
        .map(|(frame, entry)| (entry.timestamp_ns, frame))
        .collect();
    let (tracked, truth): (Vec<Vec3>, Vec<Vec3>) = slam
        .trajectory()
        .iter()
        .filter_map(|pose| {
            let frame = *frame_of_time.get(&pose.timestamp_ns)?;
            let truth = sequence.true_pose(frame).translation;
            Some((pose.world_from_camera.translation, truth))
        })
        .unzip();
    let fit = align_similarity(&tracked, &truth, true).ok()?;
    Some(fit.target_from_source)
}

/// Tells the maps what the last frame has changed.
fn hear(live: &mut LiveMaps, slam: &Slam, camera: &KeyframeCamera) {
    for event in slam.events() {
        match event {
            Event::Finished(keyframe, poses) => {
                let waiting = Waiting::Keyframe(keyframe.clone(), *camera);
                match poses.in_main_map(keyframe.id) {
                    Some(pose) => live.add(waiting, *pose).unwrap(),
                    None => live.add_apart(waiting),
                }
                live.follow(Arc::clone(poses)).unwrap();
            }
            Event::Revised(keyframe) => {
                live.revise(Waiting::Keyframe(keyframe.clone(), *camera));
            }
            Event::Moved(poses) => live.follow(Arc::clone(poses)).unwrap(),
            _ => {}
        }
    }
}

fn write(map: &OccupancyMap, path: &Path) {
    let mut bytes = Vec::new();
    write_ot(map, &mut bytes).unwrap();
    std::fs::write(path, bytes).unwrap();
}
