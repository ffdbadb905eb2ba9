//! Every calibration format against numbers worked out by hand.

use monogrid_datasets::{Calibration, DatasetError, DepthCalibration, read_response};
use monogrid_geometry::{Camera, Distortion, Pinhole};
use proptest::prelude::*;
use std::path::Path;

fn parse(name: &str, text: &str) -> Result<Calibration, DatasetError> {
    Calibration::parse(text, Path::new(name), Some((640, 480)))
}

fn camera(name: &str, text: &str) -> Camera {
    parse(name, text).expect(text).camera
}

fn assert_pinhole(camera: &Camera, expected: [f64; 4]) {
    let Pinhole { fx, fy, cx, cy } = camera.pinhole;
    for (value, expected) in [fx, fy, cx, cy].into_iter().zip(expected) {
        assert!(
            (value - expected).abs() < 1e-9,
            "{value} instead of {expected}"
        );
    }
}

const RADTAN: Distortion = Distortion::RadialTangential {
    k1: -0.28,
    k2: 0.07,
    p1: 0.0002,
    p2: 0.00002,
    k3: 0.0,
};

#[test]
fn one_line_forms() {
    let plain = camera(
        "calibration.txt",
        "# comment\n\n481.2 480.0 319.5 239.5 640 480 # size\n",
    );
    assert_eq!((plain.width, plain.height), (640, 480));
    assert_pinhole(&plain, [481.2, 480.0, 319.5, 239.5]);
    assert_eq!(plain.distortion, Distortion::None);
    let distorted = camera("c.txt", "458 457 367 248 -0.28 0.07 0.0002 0.00002 752 480");
    assert_eq!(distorted.distortion, RADTAN);
    assert_eq!((distorted.width, distorted.height), (752, 480));
    let fov = camera("c.txt", "300 300 320 240 0.9 640 480");
    assert_eq!(fov.distortion, Distortion::Fov { omega: 0.9 });
    let k3 = camera(
        "c.txt",
        "458 457 367 248 -0.28 0.07 0.0002 0.00002 0.01 752 480",
    );
    assert!(matches!(
        k3.distortion,
        Distortion::RadialTangential { k3: 0.01, .. }
    ));
    let zero = camera("c.txt", "458 457 367 248 0 0 0 0 752 480");
    assert_eq!(zero.distortion, Distortion::None);
}

#[test]
fn lsd_slam_files_are_relative_with_half_a_pixel() {
    let text = "0.527334 0.827306 0.473568 0.499436 0.967131\n1280 1024\ncrop\n640 480\n";
    let relative = camera("cameraCalibration.cfg", text);
    assert_pinhole(
        &relative,
        [
            0.527334 * 1280.0,
            0.827306 * 1024.0,
            0.473568 * 1280.0 - 0.5,
            0.499436 * 1024.0 - 0.5,
        ],
    );
    assert_eq!(relative.distortion, Distortion::Fov { omega: 0.967131 });
    let opencv = camera(
        "cameraCalibration.cfg",
        "458 457 367 248 -0.28 0.07 0.0002 0.00002\n752 480\ncrop\n640 480\n",
    );
    assert_pinhole(&opencv, [458.0, 457.0, 367.0, 248.0]);
    assert_eq!(opencv.distortion, RADTAN);
    let rectified = camera("c.cfg", "0.5 0.6 0.5 0.5 0\n640 480\nnone\n640 480\n");
    assert_eq!(rectified.distortion, Distortion::None);
    // the centre of the image: 0.5 relative is between the two middle columns
    assert_pinhole(&rectified, [320.0, 288.0, 319.5, 239.5]);
}

#[test]
fn dso_files_with_and_without_half_a_pixel() {
    let relative = camera(
        "camera.txt",
        "Pinhole 0.5 0.6 0.5 0.5 0\n640 480\ncrop\n640 480\n",
    );
    assert_pinhole(&relative, [320.0, 288.0, 319.5, 239.5]);
    let pixels = camera(
        "camera.txt",
        "Pinhole 320 288 319.5 239.5 0\n640 480\ncrop\n640 480\n",
    );
    assert_pinhole(&pixels, [320.0, 288.0, 319.5, 239.5]);
    let fov = camera(
        "camera.txt",
        "FOV 0.34 0.43 0.49 0.5 0.93\n1280 1024\ncrop\n640 480\n",
    );
    assert_eq!(fov.distortion, Distortion::Fov { omega: 0.93 });
    let radtan = camera(
        "camera.txt",
        "RadTan 458 457 367 248 -0.28 0.07 0.0002 0.00002\n752 480\n",
    );
    assert_eq!(radtan.distortion, RADTAN);
    let k = [0.01, -0.02, 0.003, -0.0004];
    for model in ["EquiDistant", "KannalaBrandt"] {
        let fish = camera(
            "camera.txt",
            &format!("{model} 190 190 254 256 0.01 -0.02 0.003 -0.0004\n512 512\ncrop\n512 512\n"),
        );
        assert_eq!(fish.distortion, Distortion::Equidistant { k });
    }
}

#[test]
fn euroc_sensor_yaml() {
    let text = "%YAML:1.0\nsensor_type: camera\ncomment: VI-Sensor cam0 (MT9M034)\n\n# Sensor \
        extrinsics wrt. the body-frame.\nT_BS:\n  cols: 4\n  rows: 4\n  data: [0.0148655429818, \
        -0.999880929698, 0.00414029679422, -0.0216401454975,\n         0.999557249008, \
        0.0149672133247, 0.025715529948, -0.064676986768,\n        -0.0257744366974, \
        0.00375618835797, 0.999660727178, 0.00981073058949,\n         0.0, 0.0, 0.0, 1.0]\n\n# \
        Camera specific definitions.\nrate_hz: 20\nresolution: [752, 480]\ncamera_model: pinhole\n\
        intrinsics: [458.654, 457.296, 367.215, 248.375] #fu, fv, cu, cv\ndistortion_model: \
        radial-tangential\ndistortion_coefficients: [-0.28, 0.07, 0.0002, 0.00002]\n";
    let calibration = parse("sensor.yaml", text).expect("readable");
    assert_pinhole(&calibration.camera, [458.654, 457.296, 367.215, 248.375]);
    assert_eq!(calibration.camera.distortion, RADTAN);
    assert_eq!(
        (calibration.camera.width, calibration.camera.height),
        (752, 480)
    );
    let pose = calibration.body_from_camera.expect("T_BS");
    assert!((pose.translation.y + 0.064676986768).abs() < 1e-12);
    assert!((pose.rotation_matrix()[(1, 0)] - 0.999557249008).abs() < 1e-6);
}

#[test]
fn kalibr_and_ros_yaml() {
    let kalibr = "cam0:\n  camera_model: pinhole\n  distortion_coeffs: [0.01, -0.02, 0.003, \
        -0.0004]\n  distortion_model: equidistant\n  intrinsics: [190.9, 190.8, 254.9, 256.8]\n  \
        resolution: [512, 512]\ncam1:\n  intrinsics: [1, 2, 3, 4]\n  resolution: [1, 1]\n";
    let calibration = parse("camchain.yaml", kalibr).expect("readable");
    assert_pinhole(&calibration.camera, [190.9, 190.8, 254.9, 256.8]);
    assert!(matches!(
        calibration.camera.distortion,
        Distortion::Equidistant { .. }
    ));
    assert!(!calibration.notes.is_empty());
    let ros = "image_width: 640\nimage_height: 480\ncamera_name: head\ncamera_matrix:\n  rows: \
        3\n  cols: 3\n  data: [500.0, 0.0, 320.0, 0.0, 501.0, 240.0, 0.0, 0.0, 1.0]\n\
        distortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n  data:\n  - \
        -0.28\n  - 0.07\n  - 0.0002\n  - 0.00002\n  - 0.0\n";
    let ros = camera("camera.yaml", ros);
    assert_pinhole(&ros, [500.0, 501.0, 320.0, 240.0]);
    assert_eq!(ros.distortion, RADTAN);
}

#[test]
fn a_matrix_of_intrinsics_takes_the_size_of_the_images() {
    let three = "6.15e+02 0 298.4\n0 615.2 247.5\n0 0 1\n";
    let four = "615 0 298.4 0\n0 615.2 247.5 0\n0 0 1 0\n0 0 0 1\n";
    let path = Path::new("intrinsics.K.txt");
    for text in [three, four] {
        let read = Calibration::parse(text, path, Some((640, 480))).unwrap();
        assert_pinhole(&read.camera, [615.0, 615.2, 298.4, 247.5]);
        assert_eq!((read.camera.width, read.camera.height), (640, 480));
        let error = Calibration::parse(text, path, None).unwrap_err();
        assert!(error.to_string().contains("size of the images"), "{error}");
    }
    // a turned or oblique camera is none
    for wrong in [
        three.replace("0 615.2", "9 615.2"),
        three.replace("02 0", "02 1.5"),
    ] {
        assert!(Calibration::parse(&wrong, path, Some((640, 480))).is_err());
    }
}

#[test]
fn kitti_matrices_with_and_without_labels() {
    let row = "718.856 0 607.1928 0 0 718.856 185.2157 0 0 0 1 0";
    for text in [row.to_owned(), format!("P0: {row}\nP1: {row}\nTr: {row}\n")] {
        let kitti = Calibration::parse(&text, Path::new("calib.txt"), Some((1241, 376)))
            .expect("readable")
            .camera;
        assert_pinhole(&kitti, [718.856, 718.856, 607.1928, 185.2157]);
        assert_eq!((kitti.width, kitti.height), (1241, 376));
    }
}

#[test]
fn own_toml_states_units_and_pixel_centre() {
    let base =
        "width = 640\nheight = 480\nfx = 0.5\nfy = 0.6\ncx = 0.5\ncy = 0.5\nunits = \"relative\"\n";
    let half = camera(
        "calibration.toml",
        &format!("{base}pixel_center = \"half\"\n"),
    );
    assert_pinhole(&half, [320.0, 288.0, 319.5, 239.5]);
    let integer = camera("calibration.toml", base);
    assert_pinhole(&integer, [320.0, 288.0, 320.0, 240.0]);
    let wrong_count = format!("{base}model = \"equidistant\"\ndistortion = [0.1]\n");
    let error = parse("calibration.toml", &wrong_count).expect_err("one of four");
    assert!(error.to_string().contains("k1 k2 k3 k4"), "{error}");
    let unknown = format!("{base}fz = 3\n");
    let error = parse("calibration.toml", &unknown).expect_err("unknown key");
    assert!(error.to_string().contains("fz"), "{error}");
    let undeclared = format!("{base}distortion = [0.1, 0.2, 0.0, 0.0]\n");
    assert!(parse("calibration.toml", &undeclared).is_err());
}

#[test]
fn negative_fy_is_turned_with_a_remark() {
    let icl = parse("c.txt", "481.2 -480.0 319.5 239.5 640 480").expect("readable");
    assert_pinhole(&icl.camera, [481.2, 480.0, 319.5, 239.5]);
    assert!(icl.interpretation().contains("fy was negative"));
}

#[test]
fn impossible_cameras_are_refused_with_the_reason() {
    for (text, reason) in [
        ("nan 480 320 240 640 480", "NaN"),
        ("inf 480 320 240 640 480", "finite"),
        ("0 0 320 240 640 480", "focal length"),
        ("480 0 320 240 640 480", "focal length"),
        ("-480 480 320 240 640 480", "focal length"),
        ("0.8 0.9 320 240 640 480", "focal length"),
        ("480 480 3200 240 640 480", "principal point"),
        ("480 480 320 240 0 480", "width"),
        ("480 480 320 240 640.5 480", "width"),
        ("480 480 320 240 -640 480", "width"),
        ("480 480 320 240 1e300 480", "width"),
        ("480 480 320", "fx fy cx cy"),
        ("480 480 320 240 1 2 3 640 480", "fx fy cx cy"),
        ("four hundred", "fx fy cx cy"),
        ("", "fx fy cx cy"),
        ("# only a comment", "fx fy cx cy"),
        ("0.5 0.6 0.5 0.5 0.9\nsix\n", "width and height"),
        ("Pinhole 0.5 0.6\n640 480\n", "Pinhole fx fy cx cy"),
        ("FOV 0.5 0.6 0.5 0.5 0.9", "second line"),
        ("300 300 320 240 nan 640 480", "omega"),
    ] {
        let error = parse("folder/calibration.txt", text)
            .expect_err(text)
            .to_string();
        assert!(error.contains("folder/calibration.txt"), "{error}");
        assert!(error.contains(reason), "{text:?}: {error}");
    }
}

#[test]
fn depth_calibration_with_and_without_pose() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("calibration_depth.txt");
    let write = |text: &str| std::fs::write(&path, text).expect("writable");
    write("# depth camera\n585 585 320 240 640 480\n1000\n");
    let plain = DepthCalibration::read(&path).expect("readable");
    assert_eq!(plain.units_per_metre, 1000.0);
    assert_eq!(plain.colour_from_depth, monogrid_geometry::Se3::identity());
    assert_eq!(plain.camera.pinhole.fx, 585.0);
    write("585 585 320 240 -0.1 0.02 0 0 640 480\n5000\n0.025 0 0 0 0 0 1\n");
    let posed = DepthCalibration::read(&path).expect("readable");
    assert_eq!(posed.colour_from_depth.translation.x, 0.025);
    assert!(matches!(
        posed.camera.distortion,
        Distortion::RadialTangential { k1: -0.1, .. }
    ));
    for text in [
        "585 585 320 240 640 480\n",
        "585 585 320 240 640 480\n0\n",
        "585 585 320 240 640 480\n-5\n",
        "585 585 320 240 640 480\nnan\n",
        "585 585 320 240\n1000\n",
        "585 585 320 240 640 480\n1000\n0 0 0 0 0 0 0\n",
        "",
    ] {
        write(text);
        assert!(DepthCalibration::read(&path).is_err(), "{text:?}");
    }
}

#[test]
fn response_has_256_values() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("pcalib.txt");
    let values: Vec<String> = (0..256).map(|i| format!("{i}.5")).collect();
    for text in [values.join(" "), values.join("\n") + "\n"] {
        std::fs::write(&path, text).expect("writable");
        let read = read_response(&path).expect("readable");
        assert_eq!(read[255], 255.5);
    }
    std::fs::write(&path, values[..255].join(" ")).expect("writable");
    assert!(
        read_response(&path)
            .expect_err("short")
            .to_string()
            .contains("255")
    );
}

fn any_camera() -> impl Strategy<Value = Camera> {
    let distortion = prop_oneof![
        Just(Distortion::None),
        (-0.3..0.3, -0.1..0.1, -0.01..0.01, -0.01..0.01, -0.05..0.05)
            .prop_map(|(k1, k2, p1, p2, k3)| Distortion::RadialTangential { k1, k2, p1, p2, k3 }),
        (0.1..1.2).prop_map(|omega| Distortion::Fov { omega }),
        prop::array::uniform4(-0.05..0.05f64).prop_map(|k| Distortion::Equidistant { k }),
        (
            prop::array::uniform6(-0.5..0.5f64),
            prop::array::uniform2(-0.01..0.01f64)
        )
            .prop_map(|(k, p)| Distortion::Rational { k, p }),
        (-0.5..0.5, 0.0..1.0).prop_map(|(xi, alpha)| Distortion::DoubleSphere { xi, alpha }),
        (0.0..1.0, 0.5..2.0).prop_map(|(alpha, beta)| Distortion::ExtendedUnified { alpha, beta }),
        (
            0.0..2.0,
            prop::array::uniform2(-0.2..0.2f64),
            prop::array::uniform2(-0.01..0.01f64)
        )
            .prop_map(|(xi, k, p)| Distortion::Omnidirectional { xi, k, p }),
    ];
    let pinhole = (100.0..2000.0, 100.0..2000.0, 100.0..500.0, 100.0..400.0);
    (200..2000usize, 200..2000usize, pinhole, distortion).prop_map(
        |(width, height, (fx, fy, cx, cy), distortion): (_, _, (f64, f64, f64, f64), _)| Camera {
            width,
            height,
            pinhole: Pinhole::new(fx, fy, cx.min(width as f64), cy.min(height as f64)),
            distortion,
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 128,
        failure_persistence: None,
        ..Default::default()
    })]

    #[test]
    fn toml_round_trips_exactly(camera in any_camera()) {
        prop_assume!(camera.validate().is_ok());
        let text = Calibration::to_toml(&camera, Some(24.5));
        let read = Calibration::parse(&text, Path::new("calibration.toml"), None)
            .expect("own format");
        prop_assert_eq!(read.camera, camera);
        prop_assert_eq!(read.readout_ms, Some(24.5));
    }

    #[test]
    fn mangled_calibrations_never_panic(
        words in prop::collection::vec("(Pinhole|FOV|RadTan|P0:|nan|-?[0-9]{0,4}\\.?[0-9]{0,3}|e9\
            |\\[|\\]|\\{|\\}|\n|\n  |,|- |data:|intrinsics:|resolution:|S_00:|K_00:|P_rect_00:\
            |camera matrix\n\
            |\\[image\\]\n|<data>|</data>|\\{\"value0\":|model_type: MEI\n|camera_model: ds\n\
            |Camera\\.fx:|fx:|xi:)", 0..32),
        name in "(a\\.txt|a\\.toml|a\\.yaml|calib\\.cfg|a\\.xml|a\\.json)",
    ) {
        // either outcome is fine; a returned camera must be valid
        let text = words.join(" ");
        if let Ok(calibration) = Calibration::parse(&text, Path::new(&name), Some((640, 480))) {
            prop_assert!(calibration.camera.validate().is_ok());
        }
    }
}

#[test]
fn a_rolling_shutter_stands_in_a_line_of_its_own() {
    let numbers = "481.2 480 319.5 239.5 640 480\n";
    let read = |text: &str| parse("calibration.txt", text);
    assert_eq!(read(numbers).expect("plain").readout_ms, None);
    let with = read(&format!("{numbers}rolling_shutter_ms 24.5\n")).expect("with");
    assert_eq!(with.readout_ms, Some(24.5));
    assert_pinhole(&with.camera, [481.2, 480.0, 319.5, 239.5]);
    assert!(with.interpretation().contains("24.5 ms"));
    for bad in ["fast", "", "-300", "2000", "nan"] {
        let error = read(&format!("rolling_shutter_ms {bad}\n{numbers}")).expect_err(bad);
        assert!(error.to_string().contains("milliseconds"), "{error}");
    }
    let lsd = "0.75 1.0 0.5 0.5 0\n640 480\ncrop\n640 480\nrolling_shutter_ms 12\n";
    assert_eq!(read(lsd).expect("LSD-SLAM").readout_ms, Some(12.0));
}

#[test]
fn binary_cameras_of_colmap() {
    let mut bytes = 1_u64.to_le_bytes().to_vec();
    bytes.extend(7_u32.to_le_bytes());
    bytes.extend(2_i32.to_le_bytes());
    bytes.extend(640_u64.to_le_bytes());
    bytes.extend(480_u64.to_le_bytes());
    for parameter in [500.0, 320.0, 240.0, 0.1_f64] {
        bytes.extend(parameter.to_le_bytes());
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cameras.bin");
    std::fs::write(&path, &bytes).unwrap();
    let read = Calibration::read(&path, None).unwrap();
    let text = camera("cameras.txt", "7 SIMPLE_RADIAL 640 480 500 320 240 0.1\n");
    assert_eq!(read.camera, text);
    for length in 0..bytes.len() {
        std::fs::write(&path, &bytes[..length]).unwrap();
        assert!(Calibration::read(&path, None).is_err(), "{length} bytes");
    }
    bytes[12] = 99;
    std::fs::write(&path, &bytes).unwrap();
    assert!(Calibration::read(&path, None).is_err(), "an unknown model");
}

#[test]
fn cameras_of_colmap() {
    let text = "# Camera list\n1 OPENCV 752 480 458 457 367.5 248.5 -0.28 0.07 0.0002 0.00002\n";
    let opencv = camera("cameras.txt", text);
    assert_pinhole(&opencv, [458.0, 457.0, 367.0, 248.0]);
    assert_eq!((opencv.width, opencv.height), (752, 480));
    assert_eq!(opencv.distortion, RADTAN);
    let simple = camera("cameras.txt", "7 SIMPLE_RADIAL 640 480 500 320 240 0.1\n");
    assert_pinhole(&simple, [500.0, 500.0, 319.5, 239.5]);
    assert!(matches!(
        simple.distortion,
        Distortion::RadialTangential { k1: 0.1, .. }
    ));
    let two = "1 PINHOLE 640 480 500 501 320 240\n2 PINHOLE 640 480 1 1 1 1\n";
    let notes = parse("cameras.txt", two).unwrap().notes;
    assert!(
        notes.iter().any(|note| note.contains("first of 2")),
        "{notes:?}"
    );
    for wrong in [
        "1 PINHOLE 640 480 500 501 320",
        "1 THIN_PRISM_FISHEYE 640 480 1 1 1 1 1 1 1 1 1 1 1 1",
        "1 PINHOLE 640.5 480 500 501 320 240",
    ] {
        assert!(parse("cameras.txt", wrong).is_err(), "{wrong}");
    }
}

#[test]
fn cameras_of_orb_slam_and_stella() {
    let numbers = [458.0, 457.0, 367.0, 248.0];
    let keys = |prefix: &str| {
        [
            "fx: 458",
            "fy: 457",
            "cx: 367",
            "cy: 248",
            "k1: -0.28",
            "k2: 0.07",
            "p1: 0.0002",
            "p2: 0.00002",
        ]
        .map(|line| format!("{prefix}{line}\n"))
        .concat()
    };
    let second = format!(
        "%YAML:1.0\n{}Camera.width: 752\nCamera.height: 480\n",
        keys("Camera.")
    );
    let third = format!(
        "%YAML:1.0\nCamera.type: \"PinHole\"\n{}Camera.width: 752\nCamera.height: 480\n",
        keys("Camera1.")
    );
    let stella = format!(
        "Camera:\n  model: \"perspective\"\n{}  cols: 752\n  rows: 480\n",
        keys("  ")
    );
    for text in [&second, &third, &stella] {
        let camera = camera("camera.yaml", text);
        assert_pinhole(&camera, numbers);
        assert_eq!((camera.width, camera.height), (752, 480), "{text}");
        assert_eq!(camera.distortion, RADTAN, "{text}");
    }
    let fisheye = third.replace("PinHole", "KannalaBrandt8");
    let fisheye = camera("camera.yaml", &fisheye).distortion;
    assert!(matches!(fisheye, Distortion::Equidistant { .. }));
    let other = third.replace("PinHole", "Equirectangular");
    assert!(parse("camera.yaml", &other).is_err());
    let without_size = second.replace("Camera.width", "Camera.fps");
    let path = Path::new("camera.yaml");
    assert!(Calibration::parse(&without_size, path, None).is_err());
    let of_images = Calibration::parse(&without_size, path, Some((752, 480))).unwrap();
    assert_eq!(of_images.camera, camera("camera.yaml", &second));
    let incomplete = second.replace("Camera.cy", "Camera.cz");
    assert!(parse("camera.yaml", &incomplete).is_err());
}
