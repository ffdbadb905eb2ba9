//! Trajectory and Sim(3) files.

use monogrid_datasets::{
    TimedPose, format_sim3, format_tum, parse_trajectory, read_path, read_sim3, write_sim3,
    write_tum,
};
use monogrid_geometry::{Se3, Sim3, Vec3, Vec6, Vec7};
use proptest::prelude::*;
use std::path::Path;

fn path() -> &'static Path {
    Path::new("poses.txt")
}

#[test]
fn tum_and_euroc_lines_mean_the_same() {
    let tum = "# header\n1403715524.907143168 0.5 2.0 -1 0.789985 -0.205376 0.554528 0.161996\n";
    let euroc = "#timestamp, p_RS_R_x [m], ...\n1403715524907143168,0.5,2.0,-1,0.161996,0.789985,\
                 -0.205376,0.554528,-0.002,-0.009\n";
    let a = parse_trajectory(tum, path()).expect("TUM");
    let b = parse_trajectory(euroc, path()).expect("EuRoC");
    assert_eq!(a[0].timestamp_ns, 1_403_715_524_907_143_168);
    assert_eq!(a, b);
    // commas alone do not make it EuRoC's: where w is follows from the names, else from the times
    let values = "0.5,2.0,-1,0.789985,-0.205376,0.554528,0.161996";
    let w_first = "0.5,2.0,-1,0.161996,0.789985,-0.205376,0.554528";
    for other in [
        format!("1403715524.907143168,{values}\n"),
        format!("timestamp,tx,ty,tz,qx,qy,qz,qw\n1403715524907143168,{values}\n"),
        format!(
            "timestamp, p_WS_W_x, p_WS_W_y, p_WS_W_z, q_WS_x, q_WS_y, q_WS_z, q_WS_w, v\n\
             1403715524907143168, {values}, 7\n"
        ),
        format!("#timestamp,x,y,z,qw [],qx [],qy [],qz []\n1403715524.907143168,{w_first}\n"),
        format!("1403715524907143168,{w_first},0,0,0,\n"),
    ] {
        assert_eq!(
            parse_trajectory(&other, path()).expect(&other),
            a,
            "{other}"
        );
    }
    // q = (x, y, z, w) turns the x axis to (w^2+x^2-y^2-z^2, ...)
    let q = [0.789985, -0.205376, 0.554528, 0.161996f64];
    let norm: f64 = q.iter().map(|v| v * v).sum();
    let expected = (q[3] * q[3] + q[0] * q[0] - q[1] * q[1] - q[2] * q[2]) / norm;
    let turned = a[0].world_from_camera.rotation * Vec3::x();
    assert!((turned.x - expected).abs() < 1e-12);
}

#[test]
fn times_may_be_in_any_unit() {
    let pose = "0.5 0.3 0.7 0.7504 0.5344 -0.2649 -0.2849";
    let read = |times: [&str; 2]| {
        let text = times.map(|time| format!("{time} {pose}\n")).concat();
        let poses = parse_trajectory(&text, path()).expect(&text);
        poses.iter().map(|p| p.timestamp_ns).collect::<Vec<_>>()
    };
    let expected = [1_305_031_452_299_500_032, 1_305_031_452_339_500_032];
    for times in [
        // as ORB-SLAM3 writes them for EuRoC, and numpy
        ["1305031452299500032.000000", "1305031452339500032.000000"],
        ["1305031452299500032", "1305031452339500032"],
        ["1.305031452299500032e+18", "1.305031452339500032e+18"],
        ["1305031452299500.032", "1305031452339500.032"],
        ["1305031452299.500032", "1305031452339.500032"],
        ["1305031452.299500032", "1305031452.339500032"],
    ] {
        assert_eq!(read(times), expected, "{times:?}");
    }
    assert_eq!(read(["0", "40"]), [0, 40_000_000]);
    assert_eq!(read(["0", "0.04"]), [0, 40_000_000]);
}

#[test]
fn matrices_covariances_and_names_of_columns() {
    let kitti = "1 0 0 1 0 1 0 2 0 0 1 3\n1 0 0 4 0 1 0 5 0 0 1 6\n";
    let poses = parse_trajectory(kitti, path()).expect("KITTI");
    assert_eq!(poses[1].timestamp_ns, 1_000_000_000);
    assert_eq!(
        poses[1].world_from_camera.translation,
        Vec3::new(4.0, 5.0, 6.0)
    );
    let covariances = format!("1.5 1 2 3 0 0 0 1{}\n", " 0.1".repeat(12));
    let poses = parse_trajectory(&covariances, path()).expect("OpenVINS");
    assert_eq!(
        poses[0].world_from_camera.translation,
        Vec3::new(1.0, 2.0, 3.0)
    );
    let named = "timestamp tx ty tz qx qy qz qw\n1.5 1 2 3 0 0 0 1\n";
    assert_eq!(parse_trajectory(named, path()).expect("named"), poses);
}

#[test]
fn positions_alone_are_a_path_and_no_trajectory() {
    let folder = tempfile::tempdir().expect("folder");
    let file = folder.path().join("prism.csv");
    for text in [
        "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m]\n1403715523912143104,1,2,3\n\
         1403715523962143104,1,2,4\n",
        "1403715523.962143104 1 2 4\n1403715523.912143104 1 2 3\n",
    ] {
        std::fs::write(&file, text).expect("writable");
        let path = read_path(&file).expect("positions");
        assert_eq!(path[0].timestamp_ns, 1_403_715_523_912_143_104);
        let pose = path[1].world_from_camera;
        assert_eq!(pose, Se3::new(Default::default(), Vec3::new(1.0, 2.0, 4.0)));
        let error = parse_trajectory(text, &file).expect_err("no orientations");
        assert!(error.to_string().contains("quaternion"), "{error}");
    }
    for text in ["1 0 0\n", "1 0 0 inf\n", "1 0 0 0\n2 0 0\n"] {
        std::fs::write(&file, text).expect("writable");
        assert!(read_path(&file).is_err(), "{text}");
    }
}

#[test]
fn poses_are_sorted_and_duplicates_dropped() {
    let text = "2 0 0 0 0 0 0 1\n1 5 0 0 0 0 0 1\n2 9 9 9 0 0 0 1\n";
    let poses = parse_trajectory(text, path()).expect("readable");
    let xs: Vec<f64> = poses
        .iter()
        .map(|p| p.world_from_camera.translation.x)
        .collect();
    assert_eq!(xs, [5.0, 0.0]);
}

#[test]
fn broken_lines_are_named() {
    for (text, part) in [
        ("1 0 0 0 0 0 0 1\n2 0 0 0 0 0 1\n", "line 2"),
        ("1 0 0 0 0 0 0 1 7\n", "line 1"),
        ("1 0 0 0 0 0 0 0\n", "line 1"),
        ("1 0 0 0 0 0 0 3\n", "line 1"),
        ("1 nan 0 0 0 0 0 1\n", "line 1"),
        ("x 0 0 0 0 0 0 1\n", "line 1"),
        ("1,0,0,0,1\n", "line 1"),
        ("", "no poses"),
        ("# nothing\n", "no poses"),
    ] {
        let error = parse_trajectory(text, path()).expect_err(text).to_string();
        assert!(
            error.contains("poses.txt") && error.contains(part),
            "{error}"
        );
    }
}

#[test]
fn sim3_files_refuse_what_is_no_similarity() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("align.txt");
    for text in [
        "",
        "1 0 0 0 0 0 0\n",
        "0 0 0 0 0 0 0 1\n",
        "-1 0 0 0 0 0 0 1\n",
        "nan 0 0 0 0 0 0 1\n",
        "1 0 0 0 0 0 0 0\n",
        "1 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n",
    ] {
        std::fs::write(&path, text).expect("writable");
        let error = read_sim3(&path).expect_err(text).to_string();
        assert!(error.contains("align.txt"), "{error}");
    }
    assert!(read_sim3(&folder.path().join("none.txt")).is_err());
}

fn twist() -> impl Strategy<Value = Vec6> {
    (
        prop::array::uniform3(-50.0..50.0f64),
        prop::array::uniform3(-1.8..1.8f64),
    )
        .prop_map(|(v, w)| Vec6::new(v[0], v[1], v[2], w[0], w[1], w[2]))
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 64,
        failure_persistence: None,
        ..Default::default()
    })]

    #[test]
    fn tum_round_trips(
        twists in prop::collection::vec(twist(), 1..10),
        start in -1_000_000_000_000i64..2_000_000_000_000_000_000,
    ) {
        let poses: Vec<TimedPose> = twists
            .iter()
            .enumerate()
            .map(|(i, t)| TimedPose {
                timestamp_ns: start + i as i64,
                world_from_camera: Se3::exp(t),
            })
            .collect();
        let folder = tempfile::tempdir().expect("folder");
        let file = folder.path().join("trajectory.txt");
        write_tum(&file, &poses).expect("writable");
        let text = std::fs::read_to_string(&file).expect("readable");
        prop_assert_eq!(&text, &format_tum(&poses));
        let read = parse_trajectory(&text, &file).expect("own file");
        prop_assert_eq!(read.len(), poses.len());
        for (a, b) in read.iter().zip(&poses) {
            prop_assert_eq!(a.timestamp_ns, b.timestamp_ns);
            let error = (a.world_from_camera.inverse() * b.world_from_camera).log();
            prop_assert!(error.norm() < 1e-7, "{}", error.norm());
        }
    }

    #[test]
    fn sim3_round_trips(t in twist(), log_scale in -3.0..3.0f64) {
        let tangent = [t[0], t[1], t[2], t[3], t[4], t[5], log_scale];
        let sim3 = Sim3::exp(&Vec7::from_column_slice(&tangent));
        let folder = tempfile::tempdir().expect("folder");
        let file = folder.path().join("align.txt");
        write_sim3(&file, &sim3).expect("writable");
        let read = read_sim3(&file).expect("own file");
        prop_assert_eq!(read.scale, sim3.scale);
        prop_assert!((read.translation - sim3.translation).norm() < 1e-12);
        prop_assert!(read.rotation.angle_to(&sim3.rotation) < 1e-7);
        prop_assert!(format_sim3(&read).lines().count() == 2);
    }
}
