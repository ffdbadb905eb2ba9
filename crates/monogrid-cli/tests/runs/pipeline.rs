//! The pipeline as a library: what a viewer, a live camera or a robot writes, and that it finds
//! what the program finds.

use crate::common::{SMALL_FRAMES, code, json, monogrid, room, small_sequence, stderr};
use monogrid_datasets::{Calibration, read_gray};
use monogrid_geometry::Camera;
use monogrid_image::GrayImage;
use monogrid_inertial::Imu;
use monogrid_mapping::z_up_from_camera_world;
use monogrid_occupancy::{OccupancyMap, write_ot};
use monogrid_pipeline::{Event, Finished, Pipeline, Settings, SourceFrame, Unusable};
use monogrid_worlds::{ImuConfig, SynthConfig, imu_samples};
use std::fs;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::Duration;

fn camera() -> Camera {
    let file = small_sequence().join("calibration.txt");
    Calibration::read(&file, None).unwrap().camera
}

/// Time and image file of each frame.
fn frames() -> Vec<(i64, PathBuf)> {
    let options = monogrid_datasets::SourceOptions::default();
    let dataset = monogrid_datasets::Dataset::open(small_sequence(), options).unwrap();
    let frames = dataset.frames.into_iter();
    frames
        .map(|frame| (frame.timestamp_ns, frame.path))
        .collect()
}

/// A camera that never stops: forth and back through the sequence, every picture twice.
fn endless_frames() -> impl Iterator<Item = (GrayImage, i64)> + Send {
    let frames = frames();
    let last = frames.len() - 1;
    (0..).flat_map(move |k: usize| {
        let round = k % (2 * last);
        let (_, path) = &frames[if round <= last {
            round
        } else {
            2 * last - round
        }];
        let (image, time) = (
            read_gray(path).unwrap(),
            frames[0].0 + 33_333_333 * k as i64,
        );
        [(image.clone(), time), (image, time + 1_000_000)]
    })
}

fn bytes(map: &OccupancyMap) -> Vec<u8> {
    let mut bytes = Vec::new();
    write_ot(map, &mut bytes).unwrap();
    bytes
}

#[test]
fn fifteen_lines_find_the_map_that_the_program_finds() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    let arguments = [
        "run",
        small_sequence().to_str().unwrap(),
        "--out",
        out.to_str().unwrap(),
        "--json",
        // what the program asks the scene for
        "--up",
        "first-camera",
        "--resolution",
        "0.05",
    ];
    let output = monogrid(arguments);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let summary = json(&output);

    let finished_keyframes = Arc::new(AtomicUsize::new(0));
    let seen = Arc::clone(&finished_keyframes);
    let mut pipeline = Pipeline::new(&camera(), Settings::default()).unwrap();
    pipeline
        .listen(move |event: &Event| {
            if matches!(event, Event::Finished(..)) {
                seen.fetch_add(1, Ordering::Relaxed);
            }
        })
        .unwrap();
    for (timestamp_ns, path) in frames() {
        pipeline
            .push(read_gray(&path).unwrap(), timestamp_ns)
            .unwrap();
    }
    let so_far = pipeline.map().unwrap();
    let mut finished = pipeline.finish().unwrap();
    let maps = finished.maps().unwrap().expect("a map");

    let mapped = so_far.expect("keyframes were finished").cell_counts();
    assert!(mapped.occupied > 0 && mapped.free > 0);
    let keyframes = finished_keyframes.load(Ordering::Relaxed);
    assert!(keyframes >= 2);
    assert_eq!(summary["keyframes"], keyframes);
    assert_eq!(summary["tracked"], finished.trajectory.len());
    for (map, name) in [
        (&maps.global, "global.ot"),
        (&maps.large, "large.ot"),
        (&maps.local, "local.ot"),
    ] {
        assert!(
            bytes(map) == fs::read(out.join(name)).unwrap(),
            "{name} differs"
        );
    }
    assert!(finished.maps().unwrap().is_none(), "they were taken");
}

/// The readings of an inertial sensor beside the camera, and the same sensor without any.
fn inertial() -> (Imu, Imu) {
    let config = ImuConfig::default();
    let sequence = room(SynthConfig::small());
    let samples = imu_samples(sequence.path(), &config, 0, 10.0);
    let mount = config.camera_from_imu.inverse();
    let sensor = |samples| Imu::new(samples, config.noise, mount);
    (sensor(samples), sensor(Vec::new()))
}

#[test]
fn readings_that_come_while_images_are_pushed_are_as_good_as_those_known_before() {
    let (known, silent) = inertial();
    let pipeline = |imu: &Imu| {
        let imu = Some(Arc::new(imu.clone()));
        let settings = Settings {
            imu,
            ..Settings::default()
        };
        Pipeline::new(&camera(), settings).unwrap()
    };
    let (mut before, mut live) = (pipeline(&known), pipeline(&silent));
    let maps = live.live_map().unwrap();
    let mut readings = known.samples().iter().peekable();
    let mut came = Vec::new();
    for (k, (timestamp_ns, path)) in frames().into_iter().enumerate() {
        let image = || read_gray(&path).unwrap();
        before.push(image(), timestamp_ns).unwrap();
        // those of every second image are late
        let until_ns = timestamp_ns - 20_000_000 * (k as i64 % 2);
        let mut reading = |until_ns: i64| readings.next_if(|r| r.timestamp_ns <= until_ns);
        while let Some(reading) = reading(until_ns) {
            came.extend(live.push_readings(&[*reading]));
        }
        came.extend(match live.push(image(), timestamp_ns) {
            Err(Unusable::Waits) => None,
            told => Some(told),
        });
        while let Some(reading) = reading(timestamp_ns + 8_000_000) {
            came.extend(live.push_readings(&[*reading]));
        }
    }
    let indices = came.iter().map(|told| told.as_ref().unwrap().index);
    assert!(indices.eq(0..frames().len()), "{came:?}");
    // what is read while it grows becomes level and metric too
    let z_up = z_up_from_camera_world();
    let brought = || {
        maps.latest()
            .is_some_and(|view| view.map_from_world.scale != z_up.scale)
    };
    for _ in 0..600 {
        if brought() {
            break;
        }
        thread::sleep(Duration::from_millis(100));
    }
    assert!(brought(), "the growing map has no metres");
    let (mut before, mut live) = (before.finish().unwrap(), live.finish().unwrap());
    let poses = |finished: &Finished| -> Vec<_> {
        let poses = finished.trajectory.iter();
        poses.map(|pose| pose.world_from_camera).collect()
    };
    assert!(poses(&before) == poses(&live));
    let sensed = live.sensed().unwrap();
    assert_eq!(Some(sensed), before.sensed());
    assert!(sensed.is_metric && sensed.is_level, "{sensed:?}");
    let maps = [
        before.maps().unwrap(),
        live.maps_around_camera(&sensed.map_from_world).unwrap(),
    ];
    let [before, live] = maps.map(|maps| bytes(&maps.unwrap().global));
    assert!(before == live);
}

#[test]
fn pushed_images_of_a_rolling_shutter_find_what_a_source_finds() {
    let settings = || Settings {
        readout_ms: 10.0,
        ..Settings::default()
    };
    let few = || frames().into_iter().take(60);
    let image = |path: &PathBuf| read_gray(path).unwrap();
    let mut pushed = Pipeline::new(&camera(), settings()).unwrap();
    for (k, (timestamp_ns, path)) in few().enumerate() {
        let outcome = pushed.push(image(&path), timestamp_ns);
        match k {
            0 => assert_eq!(outcome.err(), Some(Unusable::Waits)),
            _ => assert_eq!(outcome.unwrap().index, k - 1, "the image before"),
        }
    }
    let (timestamp_ns, path) = few().next_back().unwrap();
    let repeated = pushed.push(image(&path), timestamp_ns + 1);
    assert_eq!(repeated.err(), Some(Unusable::Repeats));
    let mut run = Pipeline::new(&camera(), settings()).unwrap();
    let source = few().enumerate().map(|(index, (timestamp_ns, path))| {
        let image = Ok(read_gray(&path).unwrap());
        SourceFrame {
            index,
            timestamp_ns,
            image,
            depth: None,
        }
    });
    run.run(source, |_, _| ControlFlow::Continue(())).unwrap();
    let (pushed, run) = (pushed.finish().unwrap(), run.finish().unwrap());
    let times = |finished: &Finished| -> Vec<_> {
        let poses = finished.trajectory.iter();
        poses
            .map(|pose| (pose.timestamp_ns, pose.world_from_camera))
            .collect()
    };
    assert_eq!(times(&pushed).len(), 60, "the last image too");
    assert_eq!(times(&pushed), times(&run));
}

#[test]
fn an_endless_camera_is_followed_until_its_listener_has_seen_enough() {
    let mut pipeline = Pipeline::new(&camera(), Settings::default()).unwrap();
    // a viewer: hears of keyframes, and looks at the map that grows
    let live = pipeline.live_map().unwrap();
    let heard = Arc::new(AtomicUsize::new(0));
    let hearing = Arc::clone(&heard);
    pipeline
        .listen(move |event: &Event| {
            let is_finished = matches!(event, Event::Finished(..));
            hearing.fetch_add(usize::from(is_finished), Ordering::Relaxed);
        })
        .unwrap();
    let source = endless_frames()
        .enumerate()
        .map(|(index, (image, timestamp_ns))| SourceFrame {
            index,
            timestamp_ns,
            image: Ok(image),
            depth: None,
        });
    let (mut tracked, mut repeated) = (0_usize, 0_usize);
    pipeline
        .run(source, |_, outcome| {
            match outcome {
                Ok(_) => tracked += 1,
                Err(_) => repeated += 1,
            }
            let view = live.latest();
            let has_seen = view.is_some_and(|view| view.global.leaf_count() > 0);
            if tracked >= SMALL_FRAMES + 20 && !has_seen {
                // the mapper gives way to everybody else on a busy computer
                thread::sleep(Duration::from_millis(50));
            }
            if tracked >= SMALL_FRAMES + 20 && (has_seen || tracked >= 5 * SMALL_FRAMES) {
                ControlFlow::Break(())
            } else {
                ControlFlow::Continue(())
            }
        })
        .unwrap();
    assert!(
        repeated.abs_diff(tracked) <= 1,
        "every second frame repeats the one before: {repeated}"
    );
    let mut finished = pipeline.finish().unwrap();
    let maps = finished.maps().unwrap().expect("a map");
    assert!(heard.load(Ordering::Relaxed) >= 2, "{heard:?}");
    // the live map had every keyframe in the end, with the depth that it was finished with
    let view = live.latest().expect("a view");
    assert!(view.global.leaf_count() > 0 && maps.global.leaf_count() > 0);
}

#[test]
fn what_goes_wrong_is_said_with_its_type() {
    let settings = Settings {
        mapping: monogrid_mapping::MappingConfig {
            resolution: -1.0,
            ..Default::default()
        },
        ..Settings::default()
    };
    assert!(Pipeline::new(&camera(), settings).is_err());
    let mut pipeline = Pipeline::new(&camera(), Settings::default()).unwrap();
    struct Full;
    impl monogrid_pipeline::Listener for Full {
        fn hear(&mut self, _: &Event) -> Result<(), monogrid_pipeline::ListenerError> {
            Ok(())
        }
        fn end(
            &mut self,
            run: monogrid_pipeline::Run,
        ) -> Result<(), monogrid_pipeline::ListenerError> {
            Err(format!("the disk is full after {} frames", run.num_frames).into())
        }
    }
    pipeline.listen(Full).unwrap();
    let small = GrayImage::filled(10, 10, 0.0);
    let unusable = pipeline.push(small, 0).unwrap_err().to_string();
    assert!(
        unusable.contains("10x10") && unusable.contains("320x240"),
        "{unusable}"
    );
    let error = pipeline.finish().unwrap_err().to_string();
    assert!(error.contains("disk is full after 1 frames"), "{error}");
}
