//! Stereo pairs in the layouts of others, made by the tests.

use super::images::gray;
use monogrid_datasets::{Dataset, SecondCamera, SourceOptions, encode_png};
use monogrid_geometry::{Distortion, Rotation, Vec3};
use std::fs;
use std::path::Path;

fn file(path: &Path, content: impl AsRef<[u8]>) {
    fs::create_dir_all(path.parent().expect("a parent")).expect("writable");
    fs::write(path, content).expect("writable");
}

fn images(folder: &Path, names: &[&str]) {
    for name in names {
        file(&folder.join(name), encode_png(&gray(8, 6)));
    }
}

fn open(path: &Path) -> Dataset {
    Dataset::open(path, SourceOptions::default()).expect("opens")
}

fn second(dataset: &Dataset) -> SecondCamera {
    let camera = dataset.second_camera(None, (8, 6)).expect("readable");
    camera.expect("a second camera")
}

fn assert_at(camera: &SecondCamera, expected: [f64; 3]) {
    let found = camera.second_from_first.translation;
    assert!((found - Vec3::from(expected)).norm() < 1e-9, "{found}");
}

#[test]
fn kitti_says_how_far_its_cameras_are_apart() {
    let root = tempfile::tempdir().expect("folder");
    let root = root.path();
    images(&root.join("image_0"), &["000000.png", "000001.png"]);
    images(&root.join("image_1"), &["000000.png"]);
    file(&root.join("times.txt"), "0.0\n0.1\n");
    // of KITTI's four cameras, the origin is that of the first
    let matrices = "P0: 7 0 4 0 0 7 3 0 0 0 1 0\nP1: 7.5 0 4.5 -3 0 7.5 3 0 0 0 1 0\n\
                    P2: 7 0 4 0.7 0 7 3 0 0 0 1 0\nP3: 7 0 4 -3.5 0 7 3 0.07 0 0 1 0\n";
    file(&root.join("calib.txt"), matrices);
    let dataset = open(root);
    assert_eq!(dataset.num_second_images(), 1);
    let beside = dataset.second_image(&dataset.frames[0]);
    assert_eq!(beside, Some(root.join("image_1/000000.png")));
    assert_eq!(dataset.second_image(&dataset.frames[1]), None);
    let camera = second(&dataset);
    assert_at(&camera, [-0.4, 0.0, 0.0]);
    let pinhole = camera.camera.pinhole;
    assert_eq!((pinhole.fx, pinhole.cx, camera.camera.width), (7.5, 4.5, 8));
    // the cameras in colour
    fs::rename(root.join("image_0"), root.join("image_2")).expect("renamed");
    images(&root.join("image_3"), &["000001.png"]);
    let colour = open(root);
    assert_eq!(colour.num_second_images(), 1);
    assert_at(&second(&colour), [-0.6, 0.01, 0.0]);
}

#[test]
fn euroc_says_where_its_cameras_are_in_the_body() {
    let root = tempfile::tempdir().expect("folder");
    let root = root.path();
    let names = ["1403715273262142976.png", "1403715273312143104.png"];
    let sensor = |camera: &str, pose: &str| {
        let text = format!(
            "T_BS:\n  data: [{pose}, 0, 0, 0, 1]\nresolution: [8, 6]\n\
             intrinsics: [8.0, 8.0, 4.0, 3.0]\ndistortion_model: radial-tangential\n\
             distortion_coefficients: [-0.1, 0.01, 0, 0]\n"
        );
        file(&root.join("mav0").join(camera).join("sensor.yaml"), text);
        images(&root.join("mav0").join(camera).join("data"), &names);
    };
    // a quarter turn about z for both: x of the cameras is y of the body
    sensor("cam0", "0, -1, 0, 0.5, 1, 0, 0, 0.2, 0, 0, 1, 0.1");
    sensor("cam1", "0, -1, 0, 0.5, 1, 0, 0, 0.31, 0, 0, 1, 0.1");
    for source in [root.to_path_buf(), root.join("mav0")] {
        let dataset = open(&source);
        assert_eq!(dataset.num_second_images(), 2);
        let camera = second(&dataset);
        assert_at(&camera, [-0.11, 0.0, 0.0]);
        let turn = camera
            .second_from_first
            .rotation
            .angle_to(&Rotation::identity());
        assert!(turn < 1e-9);
        let is_lens = |lens| matches!(lens, Distortion::RadialTangential { k1, .. } if k1 == -0.1);
        assert!(is_lens(camera.camera.distortion));
    }
}

#[test]
fn a_chain_of_kalibr_says_how_the_second_camera_sees_the_first() {
    let root = tempfile::tempdir().expect("folder");
    let root = root.path();
    for camera in ["cam0", "cam1"] {
        images(
            &root.join(camera).join("data"),
            &["1403715273262142976.png"],
        );
    }
    let camera = |name: &str, pose: &str, focal: f64| {
        format!(
            "{name}:\n{pose}  camera_model: pinhole\n  intrinsics: [{focal}, {focal}, 4, 3]\n  \
             distortion_model: radtan\n  distortion_coeffs: [0, 0, 0, 0]\n  \
             resolution: [8, 6]\n"
        )
    };
    let pose = "  T_cn_cnm1:\n  - [1.0, 0.0, 0.0, -0.1]\n  - [0.0, 1.0, 0.0, 0.02]\n  \
                - [0.0, 0.0, 1.0, 0.0]\n  - [0.0, 0.0, 0.0, 1.0]\n";
    let chain = camera("cam0", "", 8.0) + &camera("cam1", pose, 9.0);
    let elsewhere = root.join("kalibr.yaml");
    file(&elsewhere, &chain);
    let dataset = open(root);
    let error = dataset
        .second_camera(None, (8, 6))
        .expect_err("nothing says it");
    assert!(error.to_string().contains("--calibration"), "{error}");
    let given = dataset.second_camera(Some(&elsewhere), (8, 6));
    let given = given.expect("readable").expect("a second camera");
    assert_at(&given, [-0.1, 0.02, 0.0]);
    assert_eq!(given.camera.pinhole.fx, 9.0);
    file(&root.join("camchain.yaml"), &chain);
    assert_eq!(second(&open(root)), given);
}

#[test]
fn cameras_that_are_no_pair_are_refused() {
    let root = tempfile::tempdir().expect("folder");
    let root = root.path();
    images(&root.join("image_0"), &["000000.png"]);
    images(&root.join("image_1"), &["000000.png"]);
    file(&root.join("times.txt"), "0.0\n");
    for (focal, offset, said) in [
        ("7", "0", "0e0 m from each other, expected 0.001 to 1000"),
        ("7", "nan", "NaN m"),
        ("7", "1e308", "m from each other"),
        ("7", "-1e-3", "m from each other"),
        ("0", "-3", "the second camera: focal length"),
        ("-7", "-3", "the second camera: focal length"),
    ] {
        let matrices =
            format!("P0: 7 0 4 0 0 7 3 0 0 0 1 0\nP1: {focal} 0 4.5 {offset} 0 7 3 0 0 0 1 0\n");
        file(&root.join("calib.txt"), matrices);
        let error = open(root).second_camera(None, (8, 6)).unwrap_err();
        assert!(error.to_string().contains(said), "{offset}: {error}");
    }
}

#[test]
fn one_camera_is_no_pair() {
    let root = tempfile::tempdir().expect("folder");
    images(&root.path().join("image_0"), &["000000.png", "000001.png"]);
    file(&root.path().join("times.txt"), "0.0\n0.1\n");
    let dataset = open(root.path());
    assert_eq!(dataset.second_camera(None, (8, 6)).expect("readable"), None);
}
