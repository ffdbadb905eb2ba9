//! Calibrations as the programs of others write them, against numbers worked out by hand.

use monogrid_datasets::Calibration;
use monogrid_geometry::{Camera, Distortion, Pinhole};
use std::path::Path;

fn parse_for(name: &str, text: &str, size: (usize, usize)) -> Calibration {
    Calibration::parse(text, Path::new(name), Some(size)).expect(text)
}

fn camera(name: &str, text: &str) -> Camera {
    parse_for(name, text, (640, 480)).camera
}

/// Why a text is refused.
fn refused(name: &str, text: &str) -> String {
    let parsed = Calibration::parse(text, Path::new(name), Some((640, 480)));
    parsed.expect_err(text).to_string()
}

#[track_caller]
fn assert_camera(camera: &Camera, pinhole: [f64; 4], distortion: Distortion) {
    let Pinhole { fx, fy, cx, cy } = camera.pinhole;
    for (value, expected) in [fx, fy, cx, cy].into_iter().zip(pinhole) {
        assert!((value - expected).abs() < 1e-9, "{value} is not {expected}");
    }
    assert_eq!(camera.distortion, distortion);
    assert_eq!((camera.width, camera.height), (640, 480));
}

const FX_TO_CY: [f64; 4] = [417.3, 416.5, 318.6, 235.3];

const PLUMB_BOB: Distortion = Distortion::RadialTangential {
    k1: 0.26,
    k2: -0.95,
    p1: -0.005,
    p2: 0.003,
    k3: 1.16,
};

const RATIONAL: Distortion = Distortion::Rational {
    k: [0.6, -2.6, 1.5, 0.48, -2.42, 1.43],
    p: [0.0008, -0.0002],
};

const FISHEYE: Distortion = Distortion::Equidistant {
    k: [-0.011, 0.05, -0.047, 0.009],
};

const MEI: Distortion = Distortion::Omnidirectional {
    xi: 1.8,
    k: [-0.11, 0.45],
    p: [-0.0003, 0.0005],
};

const DOUBLE_SPHERE: Distortion = Distortion::DoubleSphere {
    xi: -0.2,
    alpha: 0.6,
};

const EXTENDED: Distortion = Distortion::ExtendedUnified {
    alpha: 0.6,
    beta: 1.1,
};

const K_ROWS: &str = "417.3, 0., 318.6, 0., 416.5, 235.3, 0., 0., 1.";

/// A matrix as OpenCV writes it into YAML.
fn opencv_matrix(rows: usize, cols: usize, data: &str) -> String {
    let data = data.replacen(", ", ",\n       ", 4);
    format!("!!opencv-matrix\n   rows: {rows}\n   cols: {cols}\n   dt: d\n   data: [ {data} ]\n")
}

/// A file of OpenCV's samples with these names of keys.
fn opencv([width, height, matrix, lens]: [&str; 4], more: &str, coefficients: &str) -> String {
    let count = coefficients.split(',').count();
    format!(
        "%YAML:1.0\n---\ncalibration_time: \"Mon Oct 27 20:27:45 2014\"\n{width}: 640\n{height}: \
         480\nboard_width: 4\n{more}{matrix}: {}{lens}: {}avg_reprojection_error: 4.4e-01\n",
        opencv_matrix(3, 3, K_ROWS),
        opencv_matrix(count, 1, coefficients)
    )
}

const NAMES: [&str; 4] = [
    "image_width",
    "image_height",
    "camera_matrix",
    "distortion_coefficients",
];

const OLD_NAMES: [&str; 4] = [
    "image_Width",
    "image_Height",
    "Camera_Matrix",
    "Distortion_Coefficients",
];

const PLUMB_BOB_TEXT: &str = "2.6e-01, -9.5e-01, -5.0e-03, 3.0e-03, 1.16";

#[test]
fn opencv_samples_of_all_versions_and_their_flag() {
    for names in [NAMES, OLD_NAMES] {
        let text = opencv(names, "flags: 0\n", PLUMB_BOB_TEXT);
        assert_camera(&camera("out.yml", &text), FX_TO_CY, PLUMB_BOB);
        let eight = "0.6, -2.6, 0.0008, -0.0002, 1.5, 0.48, -2.42, 1.43";
        let text = opencv(names, "flags: 16384\n", eight);
        assert_camera(&camera("out.yml", &text), FX_TO_CY, RATIONAL);
        let zeros = opencv(names, "", &format!("{eight}, 0., 0., 0., 0., 0., 0."));
        assert_camera(&camera("out.yml", &zeros), FX_TO_CY, RATIONAL);
        let prism = opencv(names, "", &format!("{eight}, 0.1, 0., 0., 0."));
        assert!(refused("out.yml", &prism).contains("thin prism"));
    }
    let four = "-0.011, 0.05, -0.047, 0.009";
    for flag in ["fisheye_model: 1\n", "fisheye_model: true\n"] {
        let text = opencv(NAMES, flag, four);
        assert_camera(&camera("out.yml", &text), FX_TO_CY, FISHEYE);
    }
    let text = opencv(NAMES, "fisheye_model: 0\n", four);
    let radtan = camera("out.yml", &text).distortion;
    assert!(matches!(radtan, Distortion::RadialTangential { .. }));
    let omni = opencv(NAMES, "xi: 1.8\n", "-0.11, 0.45, -0.0003, 0.0005");
    assert_camera(&camera("out.yml", &omni), FX_TO_CY, MEI);
}

#[test]
fn opencv_xml_says_the_same_as_its_yaml() {
    let xml = |names: [&str; 4], more: &str, lens: &str| {
        let [width, height, matrix, coefficients] = names;
        format!(
            "<?xml version=\"1.0\"?>\n<opencv_storage>\n<calibration_time>\"Mon Oct \
             27\"</calibration_time>\n<{width}>640</{width}>\n<{height}>480</{height}>\n<!-- \
             flags: -->\n{more}<{matrix} type_id=\"opencv-matrix\">\n  <rows>3</rows>\n  \
             <cols>3</cols>\n  <dt>d</dt>\n  <data>\n    {}</data></{matrix}>\n<{coefficients} \
             type_id=\"opencv-matrix\">\n  <rows>5</rows>\n  <cols>1</cols>\n  <dt>d</dt>\n  \
             <data>\n    {}</data></{coefficients}>\n</opencv_storage>\n",
            K_ROWS.replace(',', ""),
            lens.replace(',', "")
        )
    };
    for names in [NAMES, OLD_NAMES] {
        let text = xml(names, "", PLUMB_BOB_TEXT);
        // with or without the ending
        for name in ["out.xml", "calibration.txt"] {
            assert_camera(&camera(name, &text), FX_TO_CY, PLUMB_BOB);
        }
    }
    let flag = "<fisheye_model>1</fisheye_model>\n";
    let text = xml(NAMES, flag, "-0.011, 0.05, -0.047, 0.009");
    assert_camera(&camera("out.xml", &text), FX_TO_CY, FISHEYE);
    let cut = &text[..text.find("</data>").unwrap()];
    assert!(refused("out.xml", cut).contains("the end of the file within"));
}

#[test]
fn camera_info_as_topic_echo_prints_it() {
    let ros1 = "header: \n  seq: 1\n  stamp: \n    secs: 1305031452\n    nsecs: 791720000\n  \
        frame_id: \"camera\"\nheight: 480\nwidth: 640\ndistortion_model: \"plumb_bob\"\nD: [0.26, \
        -0.95, -0.005, 0.003, 1.16]\nK: [417.3, 0.0, 318.6, 0.0, 416.5, 235.3, 0.0, 0.0, 1.0]\nR: \
        [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]\nP: [520.9, 0.0, 320.0, 0.0, 0.0, 521.0, \
        250.1, 0.0, 0.0, 0.0, 1.0, 0.0]\nbinning_x: 0\nbinning_y: 0\nroi: \n  x_offset: 0\n  \
        y_offset: 0\n  height: 0\n  width: 0\n  do_rectify: False\n---\n";
    let block = |key: &str, values: &[f64]| {
        let lines: Vec<String> = values.iter().map(|v| format!("- {v:?}\n")).collect();
        format!("{key}:\n{}", lines.concat())
    };
    let ros2 = |model: &str, lens: &[f64]| {
        format!(
            "header:\n  stamp:\n    sec: 13\n    nanosec: 79\n  frame_id: camera\nheight: 480\n\
             width: 640\ndistortion_model: {model}\n{}{}{}binning_x: 0\nbinning_y: 0\nroi:\n  \
             x_offset: 0\n  y_offset: 0\n  height: 0\n  width: 0\n  do_rectify: false\n---\n",
            block("d", lens),
            block("k", &[417.3, 0.0, 318.6, 0.0, 416.5, 235.3, 0.0, 0.0, 1.0]),
            block(
                "p",
                &[
                    520.9, 0.0, 320.0, 0.0, 0.0, 521.0, 250.1, 0.0, 0.0, 0.0, 1.0, 0.0
                ]
            ),
        )
    };
    let plumb_bob = ros2("plumb_bob", &[0.26, -0.95, -0.005, 0.003, 1.16]);
    // whatever it was pasted into
    for name in ["info.yaml", "info.txt"] {
        assert_camera(&camera(name, ros1), FX_TO_CY, PLUMB_BOB);
        assert_camera(&camera(name, &plumb_bob), FX_TO_CY, PLUMB_BOB);
    }
    // two messages: the first one counts
    let twice = format!("{plumb_bob}{}", plumb_bob.replace("417.3", "999.0"));
    assert_camera(&camera("info.yaml", &twice), FX_TO_CY, PLUMB_BOB);
    let rational = ros2(
        "rational_polynomial",
        &[0.6, -2.6, 0.0008, -0.0002, 1.5, 0.48, -2.42, 1.43],
    );
    assert_camera(&camera("info.yaml", &rational), FX_TO_CY, RATIONAL);
    let fisheye = ros2("equidistant", &[-0.011, 0.05, -0.047, 0.009]);
    assert_camera(&camera("info.yaml", &fisheye), FX_TO_CY, FISHEYE);
    let half = plumb_bob.replace("binning_x: 0\nbinning_y: 0", "binning_x: 2\nbinning_y: 2");
    let half = camera("info.yaml", &half);
    assert_eq!((half.width, half.height), (320, 240));
    assert!((half.pinhole.fx - 208.65).abs() < 1e-9);
    // (318.6 + 0.5) / 2 - 0.5
    assert!((half.pinhole.cx - 159.05).abs() < 1e-9);
    let never = ros1.replace("417.3", "0.0").replace("416.5", "0.0");
    assert!(refused("info.yaml", &never).contains("not calibrated"));
}

#[test]
fn ost_txt_of_the_ros_calibrator() {
    let ost = |lens: &str| {
        format!(
            "# oST version 5.0 parameters\n\n\n[image]\n\nwidth\n640\n\nheight\n480\n\n\
             [narrow_stereo]\n\ncamera matrix\n417.300000 0.000000 318.600000\n0.000000 416.500000 \
             235.300000\n0.000000 0.000000 1.000000\n\ndistortion\n{lens}\n\nrectification\n1.0 \
             0.0 0.0\n0.0 1.0 0.0\n0.0 0.0 1.0\n\nprojection\n520.0 0.0 320.0 0.0\n0.0 521.0 250.0 \
             0.0\n0.0 0.0 1.0 0.0\n"
        )
    };
    let text = ost("0.260000 -0.950000 -0.005000 0.003000 1.160000");
    for name in ["ost.txt", "ost.ini"] {
        assert_camera(&camera(name, &text), FX_TO_CY, PLUMB_BOB);
    }
    let rational = ost("0.6 -2.6 0.0008 -0.0002 1.5 0.48 -2.42 1.43");
    assert_camera(&camera("ost.txt", &rational), FX_TO_CY, RATIONAL);
    assert!(refused("ost.txt", &ost("0.1 0.2 0.3 0.4")).contains("names the model"));
}

#[test]
fn kalibr_models_in_front_of_the_intrinsics() {
    let kalibr = |model: &str, own: &str, lens: (&str, &str)| {
        format!(
            "cam0:\n  cam_overlaps: [1]\n  camera_model: {model}\n  distortion_coeffs: {}\n  \
             distortion_model: {}\n  intrinsics: [{own}417.3, 416.5, 318.6, 235.3]\n  resolution: \
             [640, 480]\n  rostopic: /cam0/image_raw\ncam1:\n  T_cn_cnm1:\n  - [1.0, 0.0, 0.0, \
             -0.1]\n  - [0.0, 1.0, 0.0, 0.0]\n  - [0.0, 0.0, 1.0, 0.0]\n  - [0.0, 0.0, 0.0, \
             1.0]\n  camera_model: pinhole\n  distortion_coeffs: [0.9, 0.9, 0.9, 0.9]\n  \
             distortion_model: equidistant\n  intrinsics: [1, 2, 3, 4]\n  resolution: [1, 1]\n",
            lens.1, lens.0
        )
    };
    for (model, own, lens, expected) in [
        ("ds", "-0.2, 0.6, ", ("none", "[]"), DOUBLE_SPHERE),
        ("eucm", "0.6, 1.1, ", ("none", "[]"), EXTENDED),
        (
            "omni",
            "1.8, ",
            ("radtan", "[-0.11, 0.45, -0.0003, 0.0005]"),
            MEI,
        ),
        (
            "pinhole",
            "",
            ("equidistant", "[-0.011, 0.05, -0.047, 0.009]"),
            FISHEYE,
        ),
        (
            "pinhole",
            "",
            ("fov", "[0.9]"),
            Distortion::Fov { omega: 0.9 },
        ),
        ("pinhole", "", ("none", "[]"), Distortion::None),
    ] {
        let text = kalibr(model, own, lens);
        let read = parse_for("camchain.yaml", &text, (640, 480));
        assert_camera(&read.camera, FX_TO_CY, expected);
        assert!(read.interpretation().contains("first camera of the chain"));
    }
    let said = refused("camchain.yaml", &kalibr("ocam", "", ("none", "[]")));
    assert!(
        said.contains("camera model ocam is not supported"),
        "{said}"
    );
    let said = refused(
        "camchain.yaml",
        &kalibr("omni", "1.8, ", ("equidistant", "[0, 0, 0, 0]")),
    );
    assert!(
        said.contains("omni with distortion_model equidistant"),
        "{said}"
    );
    let said = refused("camchain.yaml", &kalibr("ds", "0.6, ", ("none", "[]")));
    assert!(said.contains("intrinsics of 3 numbers"), "{said}");
    // lenses that a program calls by the name of the camera's model
    let said = refused("x.yaml", &kalibr("equirectangular", "", ("", "[]")));
    assert!(said.contains("v360"), "{said}");
}

#[test]
fn vins_models() {
    let vins = |model: &str, keys: &[(&str, f64)]| {
        let lines = keys
            .iter()
            .map(|(key, value)| format!("   {key}: {value}\n"));
        format!(
            "%YAML:1.0\n---\nmodel_type: {model}\ncamera_name: camera\nimage_width: 640\n\
             image_height: 480\nprojection_parameters:\n{}",
            lines.collect::<String>()
        )
    };
    let at = |names: [&'static str; 4]| -> Vec<(&str, f64)> {
        names.into_iter().zip(FX_TO_CY).collect()
    };
    let fish = [("k2", -0.011), ("k3", 0.05), ("k4", -0.047), ("k5", 0.009)];
    let text = vins(
        "KANNALA_BRANDT",
        &[&fish[..], &at(["mu", "mv", "u0", "v0"])].concat(),
    );
    assert_camera(&camera("cam0.yaml", &text), FX_TO_CY, FISHEYE);
    let mei = [
        ("xi", 1.8),
        ("k1", -0.11),
        ("k2", 0.45),
        ("p1", -0.0003),
        ("p2", 0.0005),
    ];
    let text = vins(
        "MEI",
        &[&mei[..], &at(["gamma1", "gamma2", "u0", "v0"])].concat(),
    );
    assert_camera(&camera("cam0.yaml", &text), FX_TO_CY, MEI);
    let pinhole = at(["fx", "fy", "cx", "cy"]);
    let radtan = [("k1", 0.26), ("k2", -0.95), ("p1", -0.005), ("p2", 0.003)];
    let text = vins("PINHOLE", &[&radtan[..], &pinhole].concat());
    let without_k3 = Distortion::from_name("radtan", &[0.26, -0.95, -0.005, 0.003]).unwrap();
    assert_camera(&camera("cam0.yaml", &text), FX_TO_CY, without_k3);
    let said = refused("cam0.yaml", &vins("SCARAMUZZA", &[]));
    assert!(
        said.contains("camera model SCARAMUZZA is not supported"),
        "{said}"
    );
    let said = refused(
        "cam0.yaml",
        &vins("MEI", &at(["gamma1", "gamma2", "u0", "v0"])),
    );
    assert!(said.contains("without xi"), "{said}");
}

#[test]
fn orb_slam_and_stella_name_their_models() {
    let orb = |kind: &str| {
        format!(
            "%YAML:1.0\nFile.version: \"1.0\"\n\nCamera.type: \"{kind}\"\n\nCamera1.fx: 417.3\n\
             Camera1.fy: 416.5\nCamera1.cx: 318.6\nCamera1.cy: 235.3\nCamera1.k1: -0.011\n\
             Camera1.k2: 0.05\nCamera1.k3: -0.047\nCamera1.k4: 0.009\nCamera.width: 640\n\
             Camera.height: 480\nCamera.fps: 30\nTbc: !!opencv-matrix\n  rows: 4\n  cols: 4\n  dt: \
             f\n  data: [1, 0, 0, 0]\n"
        )
    };
    let rectified = parse_for("orb.yaml", &orb("Rectified"), (640, 480));
    assert_camera(&rectified.camera, FX_TO_CY, Distortion::None);
    let said = rectified.interpretation();
    assert!(
        said.contains("distortion in the file is not used"),
        "{said}"
    );
    let fisheye = camera("orb.yaml", &orb("KannalaBrandt8"));
    assert_camera(&fisheye, FX_TO_CY, FISHEYE);
    let said = refused("orb.yaml", &orb("Spline"));
    assert!(
        said.contains("camera model spline is not supported"),
        "{said}"
    );
    let comma = orb("PinHole").replace("417.3", "417,3");
    let said = refused("orb.yaml", &comma);
    assert!(said.contains("417,3 is not a number"), "{said}");
    // without a size it is that of the images, not the sides of a matrix
    let without = orb("Rectified").replace("Camera.width: 640\nCamera.height: 480\n", "");
    assert_camera(&camera("orb.yaml", &without), FX_TO_CY, Distortion::None);
    let around = "Camera:\n  name: \"360\"\n  setup: \"monocular\"\n  model: \
        \"equirectangular\"\n  fps: 30.0\n  cols: 1920\n  rows: 960\n  color_order: \"RGB\"\n";
    let said = refused("stella.yaml", around);
    assert!(said.contains("equirectangular is not supported"), "{said}");
    assert!(said.contains("v360=equirect:flat"), "{said}");
}

#[test]
fn colmap_fisheyes_and_the_camera_whose_size_is_that_of_the_images() {
    let simple = "1 SIMPLE_RADIAL_FISHEYE 640 480 417.3 319.1 235.8 -0.011\n";
    let radial = "1 RADIAL_FISHEYE 640 480 417.3 319.1 235.8 -0.011 0.05\n";
    for (text, k2) in [(simple, 0.0), (radial, 0.05)] {
        let k = [-0.011, k2, 0.0, 0.0];
        let expected = [417.3, 417.3, 318.6, 235.3];
        let camera = camera("cameras.txt", text);
        assert_camera(&camera, expected, Distortion::Equidistant { k });
    }
    let full = "1 FULL_OPENCV 640 480 417.3 416.5 319.1 235.8 0.6 -2.6 0.0008 -0.0002 1.5 0.48 \
        -2.42 1.43\n";
    assert_camera(&camera("cameras.txt", full), FX_TO_CY, RATIONAL);
    let prism = "1 THIN_PRISM_FISHEYE 640 480 1 1 1 1 1 1 1 1 1 1 1 1\n";
    let said = refused("cameras.txt", prism);
    assert!(
        said.contains("THIN_PRISM_FISHEYE is not supported"),
        "{said}"
    );
    // a camera that is not supported does not matter where another one is that of the images
    let several = format!(
        "{}3 PINHOLE 1280 720 900 900 640 360\n7 {}",
        prism.replace("640", "800"),
        &radial[2..]
    );
    let read = parse_for("cameras.txt", &several, (640, 480));
    assert_eq!(read.camera, camera("cameras.txt", radial));
    let said = read.interpretation();
    assert!(
        said.contains("camera 7 is used, the only one of 3"),
        "{said}"
    );
    let read = parse_for("cameras.txt", &several, (1280, 720));
    assert_eq!(read.camera.pinhole.fx, 900.0);
}

#[test]
fn binary_cameras_of_colmap_are_chosen_alike() {
    let mut bytes = 2_u64.to_le_bytes().to_vec();
    let mut push = |id: u32, model: i32, size: [u64; 2], parameters: &[f64]| {
        bytes.extend(id.to_le_bytes());
        bytes.extend(model.to_le_bytes());
        bytes.extend(size.iter().flat_map(|side| side.to_le_bytes()));
        bytes.extend(parameters.iter().flat_map(|value| value.to_le_bytes()));
    };
    push(1, 1, [1280, 720], &[900.0, 900.0, 640.0, 360.0]);
    push(2, 9, [640, 480], &[417.3, 319.1, 235.8, -0.011, 0.05]);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cameras.bin");
    std::fs::write(&path, &bytes).unwrap();
    let read = Calibration::read(&path, Some((640, 480))).unwrap();
    let text = "2 RADIAL_FISHEYE 640 480 417.3 319.1 235.8 -0.011 0.05\n";
    assert_eq!(read.camera, camera("cameras.txt", text));
    let read = Calibration::read(&path, Some((1280, 720))).unwrap();
    assert_eq!(read.camera.pinhole.fx, 900.0);
}

/// A raw calibration of KITTI with two cameras; the first is for images of 640x480 as they were
/// taken.
fn kitti_raw(rectified: &str) -> String {
    let camera = |id: &str, focal: &str| {
        format!(
            "S_{id}: 6.400000e+02 4.800000e+02\nK_{id}: {focal} 0.0 318.6 0.0 416.5 235.3 0.0 0.0 \
             1.0\nD_{id}: 2.6e-01 -9.5e-01 -5.0e-03 3.0e-03 1.16\nR_{id}: 1 0 0 0 1 0 0 0 1\n\
             T_{id}: 0 0 0\nS_rect_{id}: {rectified}\nR_rect_{id}: 1 0 0 0 1 0 0 0 1\nP_rect_{id}: \
             5.0e+02 0 3.1e+02 0 0 5.0e+02 2.3e+02 0 0 0 1 0\n"
        )
    };
    format!(
        "calib_time: 09-Jan-2012 13:57:47\ncorner_dist: 9.950000e-02\n{}{}",
        camera("00", "417.3"),
        camera("02", "420.0")
    )
}

#[test]
fn kitti_raw_has_matrices_for_each_size() {
    let text = kitti_raw("6.200000e+02 4.600000e+02");
    let taken = parse_for("calib_cam_to_cam.txt", &text, (640, 480));
    assert_camera(&taken.camera, FX_TO_CY, PLUMB_BOB);
    let rectified = parse_for("calib_cam_to_cam.txt", &text, (620, 460)).camera;
    assert_eq!(rectified.distortion, Distortion::None);
    assert_eq!(rectified.pinhole, Pinhole::new(500.0, 500.0, 310.0, 230.0));
    assert_eq!((rectified.width, rectified.height), (620, 460));
    let path = Path::new("calib_cam_to_cam.txt");
    let other = Calibration::parse(&text, path, Some((1242, 375))).unwrap_err();
    let said = other.to_string();
    assert!(said.contains("620x460 and 640x480"), "{said}");
    // where both sizes are the same, what was assumed is said
    let same = kitti_raw("6.400000e+02 4.800000e+02");
    let both = parse_for("calib_cam_to_cam.txt", &same, (640, 480));
    assert_eq!(both.camera.distortion, Distortion::None);
    assert!(both.interpretation().contains("taken for rectified ones"));
}

#[test]
fn basalt_names_its_models() {
    let basalt = |model: &str, own: &str| {
        format!(
            "{{\"value0\": {{\"T_imu_cam\": [{{\"px\": 0.04}}], \"intrinsics\": \
             [{{\"camera_type\": \"{model}\", \"intrinsics\": {{\"fx\": 417.3, \"fy\": 416.5, \
             \"cx\": 318.6, \"cy\": 235.3{own}}}}}], \"resolution\": [[640, 480]], \"vignette\": \
             []}}}}"
        )
    };
    for (model, own, expected) in [
        ("ds", ", \"xi\": -0.2, \"alpha\": 0.6", DOUBLE_SPHERE),
        ("eucm", ", \"alpha\": 0.6, \"beta\": 1.1", EXTENDED),
        (
            "kb4",
            ", \"k1\": -0.011, \"k2\": 0.05, \"k3\": -0.047, \"k4\": 0.009",
            FISHEYE,
        ),
        ("pinhole", "", Distortion::None),
        (
            "pinhole-radtan8",
            ", \"k1\": 0.6, \"k2\": -2.6, \"p1\": 0.0008, \"p2\": -0.0002, \"k3\": 1.5, \"k4\": \
             0.48, \"k5\": -2.42, \"k6\": 1.43, \"rpmax\": 2.7",
            RATIONAL,
        ),
    ] {
        let text = basalt(model, own);
        for name in ["calibration.json", "calibration.txt"] {
            assert_camera(&camera(name, &text), FX_TO_CY, expected);
        }
    }
    assert!(refused("c.json", &basalt("ds", "")).contains("without xi"));
    assert!(refused("c.json", &basalt("bal", "")).contains("camera model bal is not supported"));
    assert!(refused("c.json", "{\"value1\": 3}").contains("Basalt"));
}

#[test]
fn files_that_say_no_size_take_that_of_the_images() {
    let text = format!(
        "%YAML:1.0\n---\nM1: {}D1: {}",
        opencv_matrix(3, 3, K_ROWS),
        opencv_matrix(1, 5, PLUMB_BOB_TEXT)
    );
    let read = parse_for("intrinsics.yml", &text, (640, 480));
    assert_camera(&read.camera, FX_TO_CY, PLUMB_BOB);
    assert!(
        read.interpretation()
            .contains("does not say its image size")
    );
    assert!(Calibration::parse(&text, Path::new("intrinsics.yml"), None).is_err());
}
