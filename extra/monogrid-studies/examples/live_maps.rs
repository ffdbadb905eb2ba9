//! How long the global map needs after a loop closure that moves every keyframe, and what that
//! costs tracking meanwhile.
//!
//! `cargo run --release -p monogrid-studies --example live_maps -- RECORDING FOLDER [key=value …]`
//!
//! Keys: `res=M` (edge of a cell), `keyframes=N` (keyframes of the recording are repeated up to
//! this number, as seen a little later), `closures=N`, `frames=N` of FOLDER to track beside the
//! closures.
//!
//! The closure is a drift of 4 % in scale, 10 cm and 2 degrees, growing from the first keyframe to
//! the last. CPU seconds are those of one thread; wall time means something on an idle machine
//! only.
#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a tool for development, read from top to bottom"
)]

use monogrid_datasets::{ReadOptions, Recording};
use monogrid_geometry::{Sim3, Vec7};
use monogrid_image::GrayImage;
use monogrid_mapping::{
    KeyframeCamera, KeyframeScan, LiveMaps, Mapper, MappingConfig, z_up_from_camera_world,
};
use monogrid_occupancy::{OccupancyMap, write_ot};
use monogrid_slam::{FrameInput, PoseSnapshot, SlamConfig};
use monogrid_studies::{Options, Sequence};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

fn main() {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [recording, folder, rest @ ..] = &args[..] else {
        println!("usage: live_maps RECORDING FOLDER [res=M] [keyframes=N] [closures=N] [frames=N]");
        return;
    };
    let options = Options::read(rest.iter().cloned());
    let config = MappingConfig {
        resolution: options.number("res", 0.016),
        // every keyframe is moved, so that the map can be compared with one from scratch
        follow_threshold: 0.0,
        ..MappingConfig::default()
    };
    let keyframes = options.number("keyframes", 45);
    let (scans, poses) = keyframes_of(Path::new(recording), keyframes, &config);
    let points: usize = scans.iter().map(|s| s.num_pixels).sum();
    println!(
        "{} keyframes, {points} measurements, cells of {} m",
        scans.len(),
        config.resolution
    );

    let mut live = LiveMaps::new(Mapper::new(config.clone(), 1), z_up_from_camera_world()).unwrap();
    let before = thread_seconds();
    for (scan, pose) in scans.iter().zip(&poses) {
        live.add(scan.clone(), *pose).unwrap();
    }
    let reader = live.reader().unwrap();
    println!(
        "large and global map: {:.3} s of CPU",
        thread_seconds() - before
    );
    let mut snapshot = Arc::default();
    for closure in 1..=options.number("closures", 3) {
        snapshot = corrected(&poses, closure);
        follow(&mut live, &snapshot);
        assert_eq!(reader.latest().unwrap().revision, closure);
    }
    let view = reader.latest().unwrap();
    compare_with_scratch(&view.global, &Mapper::new(config, 1), &scans, &snapshot);
    beside_tracking(
        Path::new(folder),
        live,
        &poses,
        options.number("frames", 200),
    );
}

/// Lets the maps follow a closure.
fn follow(live: &mut LiveMaps, snapshot: &Arc<PoseSnapshot>) {
    let (wall, cpu) = (Instant::now(), thread_seconds());
    live.follow(Arc::clone(snapshot)).unwrap();
    let mut longest: f64 = 0.0;
    loop {
        let step = thread_seconds();
        if !live.step().unwrap() {
            break;
        }
        longest = longest.max(thread_seconds() - step);
    }
    println!(
        "closure {}: ready after {:.3} s of CPU, {:.3} s; longest step {longest:.3} s of CPU",
        snapshot.revision,
        thread_seconds() - cpu,
        wall.elapsed().as_secs_f64(),
    );
}

/// Builds the map anew at the last poses.
fn compare_with_scratch(
    global: &OccupancyMap,
    mapper: &Mapper,
    scans: &[KeyframeScan],
    snapshot: &PoseSnapshot,
) {
    let wanted = snapshot.world_from_keyframe.iter().copied();
    let wanted: Vec<_> = wanted.map(Some).collect();
    let before = thread_seconds();
    let built = mapper.build(scans, &wanted, &z_up_from_camera_world());
    let scratch = built.unwrap().0;
    let bytes = |map| {
        let mut bytes = Vec::new();
        write_ot(map, &mut bytes).unwrap();
        bytes
    };
    println!(
        "from scratch: {:.3} s of CPU; identical bytes: {}; {:.0} MB",
        thread_seconds() - before,
        bytes(global) == bytes(&scratch),
        scratch.bytes_in_memory() as f64 / 1e6
    );
}

/// Tracks frames with and without a closure under way all the time.
fn beside_tracking(folder: &Path, mut live: LiveMaps, poses: &[Sim3], frames: usize) {
    let sequence = Sequence::open(folder);
    let entries = sequence.dataset.frames.iter().enumerate().take(frames);
    let images: Vec<(usize, i64, GrayImage)> = entries
        .map(|(frame, entry)| (entry.index, entry.timestamp_ns, sequence.image(frame)))
        .collect();
    let track = || {
        let mut slam = sequence.system(SlamConfig::default(), 0);
        let (wall, cpu) = (Instant::now(), thread_seconds());
        for (index, timestamp_ns, image) in &images {
            slam.process_frame(FrameInput {
                index: *index,
                timestamp_ns: *timestamp_ns,
                image: image.clone(),
                depth: None,
            });
        }
        let frames = images.len() as f64;
        (
            frames / (thread_seconds() - cpu),
            frames / wall.elapsed().as_secs_f64(),
        )
    };
    let alone = track();
    let stop = AtomicBool::new(false);
    let (beside, closures) = std::thread::scope(|scope| {
        let mapper = scope.spawn(|| {
            // as the program's mapper, which lets tracking go first
            #[cfg(target_os = "linux")]
            rustix::process::nice(19).unwrap();
            let mut closures = 0;
            while !stop.load(Ordering::Relaxed) {
                closures += 1;
                live.follow(corrected(poses, closures + 100)).unwrap();
                let mut has_work = true;
                while has_work && !stop.load(Ordering::Relaxed) {
                    has_work = live.step().unwrap();
                }
            }
            closures
        });
        let beside = track();
        stop.store(true, Ordering::Relaxed);
        (beside, mapper.join().unwrap())
    });
    println!(
        "tracking of {} frames per second of CPU: alone {:.1}, beside {closures} closures without \
         a pause {:.1} ({:.0} %); per second: {:.1}, {:.1} ({:.0} %)",
        images.len(),
        alone.0,
        beside.0,
        100.0 * beside.0 / alone.0,
        alone.1,
        beside.1,
        100.0 * beside.1 / alone.1
    );
}

/// Scans and poses of `count` keyframes.
fn keyframes_of(
    recording: &Path,
    count: usize,
    config: &MappingConfig,
) -> (Vec<KeyframeScan>, Vec<Sim3>) {
    let recording = Recording::read(recording, ReadOptions { with_images: true }).unwrap();
    let camera = KeyframeCamera {
        pinhole: recording.session.pinhole,
        width: recording.session.width,
        height: recording.session.height,
    };
    let recorded = &recording.keyframes;
    let mut poses = Vec::new();
    let mut scans = Vec::new();
    for id in 0..count {
        let keyframe = &recorded[id % recorded.len()];
        let image = keyframe.image.as_ref();
        scans.push(KeyframeScan::new(
            id as u32,
            &keyframe.pixels,
            image,
            &camera,
            config,
        ));
        let later = drift((id / recorded.len()) as f64 * 0.1);
        poses.push(keyframe.world_from_keyframe.unwrap() * later);
    }
    (scans, poses)
}

/// A part of the drift that is corrected.
fn drift(share: f64) -> Sim3 {
    Sim3::exp(&(share * Vec7::from([0.06, -0.05, 0.06, 0.02, -0.02, 0.02, 0.04])))
}

/// Poses after a closure, different ones for each revision.
fn corrected(poses: &[Sim3], revision: u64) -> Arc<PoseSnapshot> {
    let sign = if revision.is_multiple_of(2) {
        -1.0
    } else {
        1.0
    };
    let world_from_keyframe = poses.iter().enumerate().map(|(i, pose)| {
        let share = (i + 1) as f64 / poses.len() as f64;
        drift(sign * share) * *pose
    });
    Arc::new(PoseSnapshot {
        revision,
        world_from_keyframe: world_from_keyframe.collect(),
        ..PoseSnapshot::default()
    })
}

/// CPU time of this thread; wall time where the system does not say.
fn thread_seconds() -> f64 {
    let nanoseconds = std::fs::read_to_string("/proc/thread-self/schedstat")
        .ok()
        .and_then(|s| s.split_whitespace().next()?.parse::<u64>().ok());
    match nanoseconds {
        Some(nanoseconds) => nanoseconds as f64 * 1e-9,
        None => {
            use std::sync::OnceLock;
            static START: OnceLock<Instant> = OnceLock::new();
            START.get_or_init(Instant::now).elapsed().as_secs_f64()
        }
    }
}
