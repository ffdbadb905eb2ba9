//! Recorded sequences: everything opens, decodes and means what their
//! README says.

use monogrid_datasets::{
    Calibration, Dataset, DepthRegistration, FrameChecker, Layout, SourceOptions, read_depth,
    read_gray, read_trajectory,
};
use monogrid_geometry::Distortion;
use std::path::PathBuf;

/// A recording below the folder that MONOGRID_DATA names.
fn data(name: &str) -> PathBuf {
    let folder = std::env::var_os("MONOGRID_DATA");
    let folder = folder.expect("MONOGRID_DATA names the folder of recorded sequences");
    let path = PathBuf::from(folder).join(name);
    assert!(path.exists(), "{} is absent", path.display());
    path
}

struct Expected {
    name: &'static str,
    frames: usize,
    depths: usize,
    size: (usize, usize),
    fx: f64,
    poses: Option<usize>,
    interval_secs: f64,
}

const SEQUENCES: [Expected; 5] = [
    Expected {
        name: "red-kitchen",
        frames: 700,
        depths: 140,
        size: (640, 480),
        fx: 519.5,
        poses: Some(700),
        interval_secs: 1.0 / 30.0,
    },
    Expected {
        name: "icl-office",
        frames: 54,
        depths: 7,
        size: (640, 480),
        fx: 481.2,
        poses: Some(54),
        interval_secs: 0.05,
    },
    Expected {
        name: "tsukuba",
        frames: 150,
        depths: 0,
        size: (640, 480),
        fx: 615.0,
        poses: Some(150),
        interval_secs: 1.0 / 30.0,
    },
    Expected {
        name: "kitti-forward",
        frames: 51,
        depths: 0,
        size: (1226, 370),
        fx: 707.0912,
        poses: Some(51),
        interval_secs: 0.1,
    },
    Expected {
        name: "euroc-static",
        frames: 30,
        depths: 0,
        size: (752, 480),
        fx: 458.654,
        poses: None,
        interval_secs: 0.05,
    },
];

#[test]
#[ignore = "needs the sequences below MONOGRID_DATA"]
fn every_sequence_opens_and_decodes() {
    for expected in SEQUENCES {
        let path = data(expected.name);
        let dataset = Dataset::open(&path, SourceOptions::default()).expect("opens");
        assert_eq!(dataset.name, expected.name);
        assert_eq!(dataset.layout, Layout::Tum);
        assert_eq!(dataset.frames.len(), expected.frames, "{}", expected.name);
        assert_eq!(dataset.depths.len(), expected.depths, "{}", expected.name);
        assert_eq!(dataset.warnings, Vec::<String>::new());
        let interval = dataset.frame_interval_secs().expect("several frames");
        assert!(
            (interval - expected.interval_secs).abs() < 1e-4,
            "{interval}"
        );
        let calibration = dataset
            .calibration(None)
            .expect("readable")
            .expect("present");
        assert_eq!(
            (calibration.camera.width, calibration.camera.height),
            expected.size
        );
        assert_eq!(calibration.camera.pinhole.fx, expected.fx);
        for frame in dataset.frames.iter().step_by(17) {
            let image = read_gray(&frame.path).expect("decodes");
            assert_eq!((image.width(), image.height()), expected.size);
            let mean = image.as_slice().iter().sum::<f32>() / image.as_slice().len() as f32;
            assert!(
                (5.0..250.0).contains(&mean),
                "{}: {mean}",
                frame.path.display()
            );
        }
        let poses = dataset.ground_truth.as_deref().map(read_trajectory);
        let count = poses.map(|p| p.expect("readable").len());
        assert_eq!(count, expected.poses, "{}", expected.name);
    }
}

#[test]
#[ignore = "needs the sequences below MONOGRID_DATA"]
fn euroc_times_are_exact_and_its_lens_is_distorted() {
    let path = data("euroc-static");
    let dataset = Dataset::open(&path, SourceOptions::default()).expect("opens");
    for frame in &dataset.frames {
        // the file name is the integer that the list gives as a decimal number
        let stem = frame.path.file_stem().expect("a name").to_string_lossy();
        assert_eq!(frame.timestamp_ns.to_string(), stem);
    }
    let camera = dataset
        .calibration(None)
        .expect("readable")
        .expect("present")
        .camera;
    assert!(matches!(
        camera.distortion,
        Distortion::RadialTangential { k1, .. } if k1 == -0.28340811
    ));
}

#[test]
#[ignore = "needs the sequences below MONOGRID_DATA"]
fn kitti_projection_matrix_agrees_with_the_one_line_form() {
    let path = data("kitti-forward");
    let line = Calibration::read(&path.join("calibration.txt"), None).expect("readable");
    let matrix = Calibration::read(&path.join("calib.txt"), Some((1226, 370))).expect("readable");
    assert_eq!(line.camera, matrix.camera);
    let error = Calibration::read(&path.join("calib.txt"), None).expect_err("no size");
    assert!(error.to_string().contains("size of the images"), "{error}");
}

#[test]
#[ignore = "needs the sequences below MONOGRID_DATA"]
fn trajectories_of_all_formats_are_read() {
    for (name, count) in [
        ("trajectories/handheld-xyz.txt", 3000),
        // 20957 lines, of which two share a time
        ("trajectories/handheld-desk.txt", 20956),
        ("trajectories/mav-v102.csv", 16702),
    ] {
        let path = data(name);
        let poses = read_trajectory(&path).expect("readable");
        assert_eq!(poses.len(), count, "{name}");
        assert!(poses.is_sorted_by(|a, b| a.timestamp_ns < b.timestamp_ns));
    }
}

#[test]
#[ignore = "needs the sequences below MONOGRID_DATA"]
fn depth_belongs_to_frames_and_registers_densely() {
    for (name, every) in [("red-kitchen", 5), ("icl-office", 8)] {
        let path = data(name);
        let dataset = Dataset::open(&path, SourceOptions::default()).expect("opens");
        let with_depth: Vec<usize> = dataset
            .frames
            .iter()
            .filter(|f| dataset.depth_of_frame(f.timestamp_ns).is_some())
            .map(|f| f.index)
            .collect();
        assert_eq!(with_depth.len(), dataset.depths.len());
        assert!(with_depth.iter().all(|i| i % every == 0), "{with_depth:?}");
        let calibration = dataset
            .depth_calibration()
            .expect("readable")
            .expect("present");
        let colour = dataset
            .calibration(None)
            .expect("readable")
            .expect("present")
            .camera;
        let depth =
            read_depth(&dataset.depths[0].path, calibration.units_per_metre).expect("16 bit");
        let known = |image: &monogrid_image::Image<f32>| {
            image.as_slice().iter().filter(|v| v.is_finite()).count()
        };
        let registration =
            DepthRegistration::new(&calibration, &colour.pinhole, colour.width, colour.height);
        let registered = registration.register(&depth).expect("right size");
        // the kitchen's colour camera sees 9 % more on each side than its depth camera
        let share = known(&registered) as f64 / known(&depth) as f64;
        assert!((0.75..1.2).contains(&share), "{name}: {share}");
        let (near, far) = registered
            .as_slice()
            .iter()
            .filter(|v| v.is_finite())
            .fold((f32::MAX, 0.0f32), |(a, b), &v| (a.min(v), b.max(v)));
        assert!(near > 0.2 && far < 12.0, "{name}: {near} to {far} m");
        if name == "icl-office" {
            // same camera: the identity
            for (a, b) in registered.as_slice().iter().zip(depth.as_slice()) {
                assert!(a.is_nan() == b.is_nan());
                assert!(a.is_nan() || (a - b).abs() < 1e-4 * b, "{a} {b}");
            }
        }
    }
}

#[test]
#[ignore = "needs the sequences below MONOGRID_DATA"]
fn repeated_frames_of_the_kitchen_are_those_with_equal_files() {
    let path = data("red-kitchen");
    let dataset = Dataset::open(&path, SourceOptions::default()).expect("opens");
    let frames = &dataset.frames[215..300];
    let mut checker = FrameChecker::default();
    let mut before = None;
    let mut repeats = 0;
    for frame in frames {
        let bytes = std::fs::read(&frame.path).expect("readable");
        let image = read_gray(&frame.path).expect("decodes");
        let is_equal = before.as_ref() == Some(&bytes);
        assert_eq!(
            checker.check(&image).is_repeated,
            is_equal,
            "frame {}",
            frame.index
        );
        repeats += usize::from(is_equal);
        before = Some(bytes);
    }
    assert!(repeats > 5, "{repeats}");
}
