//! Layouts on disk, made by the tests.

use super::images::gray;
use monogrid_datasets::{
    DEFAULT_FPS, Dataset, DatasetError, Layout, SourceOptions, encode_png, encode_png_16, read_gray,
};
use monogrid_geometry::{Camera, Distortion, Pinhole, Vec3};
use monogrid_image::Image;
use std::fs;
use std::io::Read as _;
use std::path::Path;
use tempfile::TempDir;

fn folder() -> TempDir {
    tempfile::tempdir().expect("temporary folder")
}

fn image(path: &Path) {
    fs::create_dir_all(path.parent().expect("a parent")).expect("writable");
    fs::write(path, encode_png(&gray(8, 6))).expect("writable");
}

fn open(path: &Path) -> Result<Dataset, DatasetError> {
    Dataset::open(path, SourceOptions::default())
}

fn names(dataset: &Dataset) -> Vec<String> {
    dataset
        .frames
        .iter()
        .map(|f| {
            f.path
                .file_name()
                .expect("a name")
                .to_string_lossy()
                .into_owned()
        })
        .collect()
}

fn times(dataset: &Dataset) -> Vec<i64> {
    dataset.frames.iter().map(|f| f.timestamp_ns).collect()
}

#[test]
fn plain_folder_in_natural_order_at_a_rate() {
    let root = folder();
    for name in ["f10.png", "f2.png", "f1.png", "mask.png", ".hidden.png"] {
        image(&root.path().join(name));
    }
    fs::write(root.path().join("notes.md"), "x").expect("writable");
    let options = SourceOptions { fps: Some(20.0) };
    let dataset = Dataset::open(root.path(), options).expect("opens");
    assert_eq!(dataset.layout, Layout::Folder);
    assert_eq!(names(&dataset), ["f1.png", "f2.png", "f10.png"]);
    assert_eq!(times(&dataset), [0, 50_000_000, 100_000_000]);
    assert_eq!(dataset.frames[2].index, 2);
    assert!(dataset.warnings.iter().any(|w| w.contains("natural order")));
    assert!(read_gray(&dataset.frames[0].path).is_ok());
    let unset = open(root.path()).expect("opens");
    assert!(unset.warnings.iter().any(|w| w.contains("--fps")));
    let interval = unset.frame_interval_secs().expect("frames");
    assert!((interval - 1.0 / DEFAULT_FPS).abs() < 1e-9);
    for fps in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let options = SourceOptions { fps: Some(fps) };
        assert!(Dataset::open(root.path(), options).is_err(), "{fps}");
    }
}

#[test]
fn images_in_a_subfolder_are_found() {
    let root = folder();
    image(&root.path().join("images/0001.png"));
    image(&root.path().join("images/0002.png"));
    fs::write(
        root.path().join("camera.txt"),
        "Pinhole 0.5 0.6 0.5 0.5 0\n8 6\n",
    )
    .expect("writable");
    let dataset = open(root.path()).expect("opens");
    assert_eq!(names(&dataset), ["0001.png", "0002.png"]);
    assert_eq!(
        dataset.calibration_path.as_deref(),
        Some(root.path().join("camera.txt").as_path())
    );
}

#[test]
fn tum_layout_sorts_and_reports_disorder() {
    let root = folder();
    for name in ["a.png", "b.png", "c d.png"] {
        image(&root.path().join("rgb").join(name));
    }
    fs::write(
        root.path().join("rgb.txt"),
        "# timestamp filename\n2.000000001 rgb/b.png\n1.5 rgb/a.png\n3 rgb/c d.png\n3.0 \
         rgb/a.png\n",
    )
    .expect("writable");
    fs::write(
        root.path().join("depth.txt"),
        "1.51 depth/1.png\n2.9 depth/2.png\n",
    )
    .expect("writable");
    fs::write(root.path().join("groundtruth.txt"), "").expect("writable");
    let dataset = open(root.path()).expect("opens");
    assert_eq!(dataset.layout, Layout::Tum);
    assert_eq!(names(&dataset), ["a.png", "b.png", "c d.png"]);
    assert_eq!(
        times(&dataset),
        [1_500_000_000, 2_000_000_001, 3_000_000_000]
    );
    assert!(
        dataset
            .warnings
            .iter()
            .any(|w| w.contains("backwards 1 times"))
    );
    assert!(dataset.warnings.iter().any(|w| w.contains("1 of 4 frames")));
    assert!(dataset.ground_truth.is_some());
    // the interval is 0.5 to 1 s; 0.6 of it reaches from 1.5 to 1.51 and from 3 to 2.9
    let depth_of = |t| dataset.depth_of_frame(t).map(|d| d.timestamp_ns);
    assert_eq!(depth_of(1_500_000_000), Some(1_510_000_000));
    assert_eq!(depth_of(3_000_000_000), Some(2_900_000_000));
    assert_eq!(depth_of(9_000_000_000), None);
    let options = SourceOptions { fps: Some(10.0) };
    let with_rate = Dataset::open(root.path(), options).expect("opens");
    assert_eq!(times(&with_rate), times(&dataset));
    assert!(with_rate.warnings.iter().any(|w| w.contains("not used")));
    // the list itself as source
    let by_list = open(&root.path().join("rgb.txt")).expect("opens");
    assert_eq!(names(&by_list), names(&dataset));
}

#[test]
fn euroc_layout() {
    let root = folder();
    let camera = root.path().join("mav0/cam0");
    image(&camera.join("data/1403715273262142976.png"));
    image(&camera.join("data/1403715273312143104.png"));
    fs::write(
        camera.join("data.csv"),
        "#timestamp [ns],filename\r\n1403715273262142976,1403715273262142976.png\r\n\
         1403715273312143104,1403715273312143104.png\r\n",
    )
    .expect("writable");
    fs::write(
        camera.join("sensor.yaml"),
        "T_BS:\n  data: [1, 0, 0, 0.1, 0, 1, 0, 0.2, 0, 0, 1, 0, 0, 0, 0, 1]\n\
         resolution: [8, 6]\nintrinsics: [8.0, 8.0, 4.0, 3.0]\n",
    )
    .expect("writable");
    let truth = root
        .path()
        .join("mav0/state_groundtruth_estimate0/data.csv");
    fs::create_dir_all(truth.parent().expect("parent")).expect("writable");
    fs::write(
        &truth,
        "1403715273262142976,1,2,3,0.7071067811865476,0,0,0.7071067811865476,0,0\n",
    )
    .expect("writable");
    for source in [root.path().to_path_buf(), root.path().join("mav0")] {
        let dataset = open(&source).expect("opens");
        assert_eq!(dataset.layout, Layout::Euroc);
        assert_eq!(
            times(&dataset),
            [1_403_715_273_262_142_976, 1_403_715_273_312_143_104]
        );
        let poses = dataset
            .reference_trajectory()
            .expect("readable")
            .expect("present");
        // a quarter turn about z carries the camera's lever arm (0.1, 0.2, 0) to (-0.2, 0.1, 0)
        let position = poses[0].world_from_camera.translation;
        let expected = [0.8, 2.1, 3.0];
        for (value, expected) in position.iter().zip(expected) {
            assert!((value - expected).abs() < 1e-9, "{position}");
        }
        let calibration = dataset
            .calibration(None)
            .expect("readable")
            .expect("present");
        assert_eq!(calibration.camera.width, 8);
        assert!(read_gray(&dataset.frames[1].path).is_ok());
    }
}

#[test]
fn kitti_layout_with_exponents_in_times() {
    let root = folder();
    for name in ["000000.png", "000001.png"] {
        image(&root.path().join("image_0").join(name));
    }
    fs::write(
        root.path().join("times.txt"),
        "0.000000e+00\n1.036224e-01\n",
    )
    .expect("writable");
    let dataset = open(root.path()).expect("opens");
    assert_eq!(dataset.layout, Layout::Kitti);
    assert_eq!(times(&dataset), [0, 103_622_400]);
}

#[test]
fn tum_mono_layout_matches_ids_with_names() {
    let root = folder();
    for name in ["00000.png", "00001.png", "00003.png"] {
        image(&root.path().join("images").join(name));
    }
    fs::write(
        root.path().join("times.txt"),
        "00000 1449168740.01 10.5\n00001 1449168740.06 10.5\n00002 1449168740.11 10.5\n\
         00003 1449168740.16 10.5\n",
    )
    .expect("writable");
    fs::write(root.path().join("pcalib.txt"), "").expect("writable");
    image(&root.path().join("vignette.png"));
    let dataset = open(root.path()).expect("opens");
    // the vignette beside the list is not a frame
    assert_eq!(dataset.layout, Layout::TumMonoVo);
    assert_eq!(names(&dataset), ["00000.png", "00001.png", "00003.png"]);
    assert_eq!(times(&dataset)[2], 1_449_168_740_160_000_000);
    assert!(
        dataset
            .warnings
            .iter()
            .any(|w| w.contains("4 times for 3 images"))
    );
    assert!(dataset.response_path.is_some() && dataset.vignette_path.is_some());
}

#[test]
fn missing_images_are_warned_about_and_an_error_when_all_are_missing() {
    let root = folder();
    image(&root.path().join("a.png"));
    let list = root.path().join("rgb.txt");
    fs::write(&list, "1 a.png\n2 gone.png\n").expect("writable");
    let dataset = open(root.path()).expect("opens");
    assert_eq!(dataset.frames.len(), 2);
    assert!(dataset.warnings.iter().any(|w| w.contains("gone.png")));
    fs::write(&list, "1 x.png\n2 gone.png\n").expect("writable");
    let error = open(root.path()).expect_err("nothing there").to_string();
    assert!(
        error.contains("rgb.txt") && error.contains("x.png"),
        "{error}"
    );
}

#[test]
fn bad_sources_are_explained() {
    let root = folder();
    let error = open(&root.path().join("nowhere")).expect_err("missing");
    assert!(matches!(error, DatasetError::SourceMissing(_)));
    let error = open(root.path()).expect_err("empty").to_string();
    assert!(error.contains("an empty folder"), "{error}");
    fs::write(root.path().join("readme.md"), "").expect("writable");
    let error = open(root.path()).expect_err("no images").to_string();
    assert!(error.contains("1 files and folders"), "{error}");
    let video = root.path().join("video.mp4");
    fs::write(&video, "").expect("writable");
    let error = open(&video).expect_err("a video").to_string();
    assert!(error.contains(".mp4 file"), "{error}");
    fs::write(root.path().join("notes"), "").expect("writable");
    let error = open(&root.path().join("notes")).expect_err("no ending");
    assert!(
        error.to_string().contains("no kind that we know"),
        "{error}"
    );
    // a path that no file has would be printed in full
    for (name, first) in [("long.txt", "1 a"), ("paths.txt", "a")] {
        let list = root.path().join(name);
        fs::write(&list, format!("{first}{}\n", "b".repeat(5000))).expect("writable");
        let error = open(&list).expect_err("too long").to_string();
        assert!(error.contains(name) && error.len() < 400, "{error}");
    }
    let list = root.path().join("rgb.txt");
    for (text, part) in [
        ("", "without lines"),
        ("# comment only\n", "without lines"),
        ("1.0\n", "line 1"),
        ("1.0 a.png\nabc b.png\n", "line 2"),
        ("nan a.png\n", "line 1"),
    ] {
        fs::write(&list, text).expect("writable");
        let error = open(root.path()).expect_err(text).to_string();
        assert!(error.contains("rgb.txt") && error.contains(part), "{error}");
    }
    image(&root.path().join("a.png"));
    fs::write(&list, "5 a.png\n5 a.png\n5 a.png\n").expect("writable");
    let error = open(root.path()).expect_err("all the same time");
    assert!(matches!(
        error,
        DatasetError::DuplicateTimes {
            duplicates: 2,
            frames: 3,
            ..
        }
    ));
}

#[test]
fn times_in_any_unit_are_recognised_and_said() {
    let root = folder();
    for name in ["a.png", "b.png", "c.png"] {
        image(&root.path().join("rgb").join(name));
    }
    let expected = [
        1_305_031_452_790_000_000,
        1_305_031_452_823_333_000,
        1_305_031_452_856_666_000,
    ];
    let list = |times: [&str; 3]| {
        let lines = times.iter().zip(["a", "b", "c"]);
        let text: String = lines
            .map(|(time, name)| format!("{time} rgb/{name}.png\n"))
            .collect();
        fs::write(root.path().join("rgb.txt"), text).expect("writable");
        open(root.path()).expect("opens")
    };
    for (times, unit) in [
        (
            [
                "1305031452.790000",
                "1305031452.823333",
                "1305031452.856666",
            ],
            None,
        ),
        (
            ["1305031452790", "1305031452823.333", "1305031452856.666"],
            Some("milliseconds"),
        ),
        (
            ["1305031452790000", "1305031452823333", "1305031452856666"],
            Some("microseconds"),
        ),
        (
            [
                "1305031452790000000",
                "1305031452823333000",
                "1305031452856666000",
            ],
            Some("nanoseconds"),
        ),
    ] {
        let dataset = list(times);
        assert_eq!(super::sources::times(&dataset), expected, "{unit:?}");
        let said: Vec<&String> = dataset
            .warnings
            .iter()
            .filter(|w| w.contains("taken for"))
            .collect();
        match unit {
            None => assert!(said.is_empty(), "{said:?}"),
            Some(unit) => assert!(said[0].contains(unit), "{said:?}"),
        }
    }
}

#[test]
fn clocks_that_start_at_0_count_in_any_unit() {
    let root = folder();
    for name in ["a.png", "b.png", "c.png"] {
        image(&root.path().join("rgb").join(name));
    }
    let list = "0 rgb/a.png\n33 rgb/b.png\n67 rgb/c.png\n";
    fs::write(root.path().join("rgb.txt"), list).expect("writable");
    let dataset = open(root.path()).expect("opens");
    assert_eq!(times(&dataset), [0, 33_000_000, 67_000_000]);
    fs::remove_file(root.path().join("rgb.txt")).expect("there");
    fs::write(root.path().join("times.txt"), "0\n33333\n66666\n").expect("writable");
    let dataset = open(root.path()).expect("opens");
    assert_eq!(times(&dataset), [0, 33_333_000, 66_666_000]);
    assert!(dataset.warnings.iter().any(|w| w.contains("microseconds")));
}

#[test]
fn a_clock_that_was_set_is_refused_and_disorder_is_not() {
    let root = folder();
    image(&root.path().join("a.png"));
    let list = |times: &[u32]| {
        let lines = times
            .iter()
            .map(|time| format!("{}.{:03} a.png\n", time / 1000, time % 1000));
        fs::write(root.path().join("rgb.txt"), lines.collect::<String>()).expect("writable");
        open(root.path())
    };
    // 60 frames, then the clock is 1.5 s earlier, between the times before
    let mut reset: Vec<u32> = (0..60).map(|k| 33 * k).collect();
    reset.extend((0..40).map(|k| 400 + 33 * k + 10));
    let error = list(&reset).expect_err("two recordings").to_string();
    assert!(
        error.contains("jumps back by 1.537 s at frame 60"),
        "{error}"
    );
    // two frames that changed places
    let mut swapped: Vec<u32> = (0..100).map(|k| 33 * k).collect();
    swapped.swap(50, 51);
    let dataset = list(&swapped).expect("sorted");
    assert!(times(&dataset).is_sorted());
    assert!(
        dataset
            .warnings
            .iter()
            .any(|w| w.contains("backwards 1 times"))
    );
    // any order at all
    let shuffled: Vec<u32> = (0..101).map(|k| 33 * ((37 * k) % 101)).collect();
    assert!(times(&list(&shuffled).expect("sorted")).is_sorted());
}

#[test]
fn seven_scenes_tell_colour_from_depth_by_name() {
    for (ending, mark) in [("png", "."), ("png", "_"), ("png", "-")] {
        let root = folder();
        let place = |k: usize, kind: &str| root.path().join(format!("frame-{k:06}{mark}{kind}"));
        for k in 0..3 {
            image(&place(k, &format!("color.{ending}")));
            image(&place(k, &format!("depth.{ending}")));
            let matrix = format!("1 0 0 {k}\n0 1 0 0.5\n0 0 1 0\n0 0 0 1\n");
            fs::write(place(k, "pose.txt"), matrix).expect("writable");
        }
        // tracking failed in one
        fs::write(place(1, "pose.txt"), "0 0 0 0\n".repeat(4)).expect("writable");
        let dataset = open(root.path()).expect("opens");
        assert_eq!(dataset.layout, Layout::SevenScenes);
        assert_eq!(dataset.frames.len(), 3);
        assert!(names(&dataset).iter().all(|name| name.contains("color")));
        let depths: Vec<i64> = dataset.depths.iter().map(|d| d.timestamp_ns).collect();
        assert_eq!(depths, times(&dataset));
        assert!(dataset.depths[1].path.to_string_lossy().contains("000001"));
        let camera = Camera::try_new(8, 6, Pinhole::centred(8.0, 8, 6), Distortion::None).unwrap();
        assert_eq!(dataset.registered_depth(camera).units_per_metre, 1000.0);
        let poses = dataset
            .reference_trajectory()
            .expect("readable")
            .expect("there");
        assert_eq!(poses.len(), 2);
        assert_eq!(poses[1].timestamp_ns, dataset.frames[2].timestamp_ns);
        assert_eq!(poses[1].world_from_camera.translation.x, 2.0);
    }
    // without images in colour, depth images are images
    let root = folder();
    image(&root.path().join("0.depth.png"));
    assert_eq!(open(root.path()).expect("opens").frames.len(), 1);
}

#[test]
fn icl_nuim_counts_frames_and_its_y_axis_points_up() {
    let root = folder();
    let mut list = String::new();
    for k in 0..4 {
        image(&root.path().join(format!("rgb/{k}.png")));
        image(&root.path().join(format!("depth/{k}.png")));
        list += &format!("{k} depth/{k}.png {k} rgb/{k}.png\n");
    }
    fs::write(root.path().join("associations.txt"), list).expect("writable");
    // the poses begin with the second frame; the camera turns about its x axis
    let (sin, cos) = 0.1_f64.sin_cos();
    let poses = format!("1 1 2 3 0 0 0 1\n2 1 2.5 3 {sin} 0 0 {cos}\n");
    fs::write(root.path().join("office.gt.freiburg"), poses).expect("writable");
    let dataset = open(root.path()).expect("opens");
    assert_eq!(dataset.layout, Layout::IclNuim);
    assert!(dataset.frames[3].path.ends_with("rgb/3.png"));
    assert_eq!(times(&dataset), [0, 33_333_333, 66_666_667, 100_000_000]);
    let depths: Vec<i64> = dataset.depths.iter().map(|d| d.timestamp_ns).collect();
    assert_eq!(depths, times(&dataset));
    assert!(dataset.depths[2].path.ends_with("depth/2.png"));
    let calibration = dataset.calibration(Some((640, 480)));
    let calibration = calibration.expect("known").expect("there");
    assert_eq!(calibration.camera.pinhole.fy, 480.0);
    // images of another size are of another camera
    assert!(dataset.calibration(Some((320, 240))).unwrap().is_none());
    let units = dataset.registered_depth(calibration.camera).units_per_metre;
    assert_eq!(units, 5000.0);
    let reference = dataset.reference_trajectory();
    let reference = reference.expect("readable").expect("there");
    let at: Vec<i64> = reference.iter().map(|pose| pose.timestamp_ns).collect();
    assert_eq!(at, times(&dataset)[1..3]);
    let pose = reference[1].world_from_camera;
    assert_eq!(pose.translation, Vec3::new(1.0, -2.5, 3.0));
    // a point ahead of a camera that looked down now lies as far below as it lay above
    let ahead = pose.rotation * Vec3::new(0.0, 0.0, 1.0);
    assert!((ahead - Vec3::new(0.0, 0.2_f64.sin(), 0.2_f64.cos())).norm() < 1e-12);
    // a list by times is no list of frames
    let list = "0.5 rgb/0.png 0.51 depth/0.png\n";
    fs::write(root.path().join("associations.txt"), list).expect("writable");
    assert_ne!(open(root.path()).expect("opens").layout, Layout::IclNuim);
}

#[test]
fn kitti_raw_has_a_date_for_each_image() {
    let root = folder();
    let drive = root.path().join("2011_09_26/drive_0001");
    for camera in ["image_00", "image_02"] {
        // the second image is missing
        for k in [0, 2] {
            image(&drive.join(format!("{camera}/data/{k:010}.png")));
        }
        let dates = "2011-09-26 13:02:25.900000000\n2011-09-26 13:02:26.000000000\n2011-09-26 \
            13:02:26.100000000\n";
        fs::write(drive.join(camera).join("timestamps.txt"), dates).expect("writable");
    }
    let numbers =
        |id: &str, f: f64| format!("S_rect_{id}: 8 6\nP_rect_{id}: {f} 0 4 0 0 {f} 3 0 0 0 1 0\n");
    let text = format!(
        "calib_time: x\n{}{}",
        numbers("00", 9.0),
        numbers("02", 10.0)
    );
    let calibration = root.path().join("2011_09_26/calib_cam_to_cam.txt");
    fs::write(calibration, text).expect("writable");
    for (source, focal) in [
        (drive.clone(), 9.0),
        (drive.join("image_00"), 9.0),
        (drive.join("image_02"), 10.0),
    ] {
        let dataset = open(&source).expect("opens");
        assert_eq!(dataset.layout, Layout::KittiRaw);
        let start = 1_317_042_145_900_000_000;
        assert_eq!(times(&dataset), [start, start + 200_000_000]);
        let read = dataset
            .calibration(Some((8, 6)))
            .expect("readable")
            .expect("there");
        assert_eq!(read.camera.pinhole.fx, focal);
    }
}

#[test]
fn euroc_without_its_list_has_times_in_names() {
    let root = folder();
    let camera = root.path().join("mav0/cam0");
    for name in ["1403636579763555584.png", "1403636579813555584.png"] {
        image(&camera.join("data").join(name));
    }
    let expected = [1_403_636_579_763_555_584, 1_403_636_579_813_555_584];
    let mav0 = root.path().join("mav0");
    for source in [root.path(), &mav0, &camera, &camera.join("data")] {
        let dataset = open(source).expect("opens");
        assert_eq!(times(&dataset), expected, "{source:?}");
        assert!(dataset.warnings.iter().any(|w| w.contains("nanoseconds")));
    }
    // a rate that somebody gave stands above names
    let options = SourceOptions { fps: Some(10.0) };
    for source in [root.path(), &camera] {
        let dataset = Dataset::open(source, options).expect("opens");
        assert_eq!(times(&dataset), [0, 100_000_000]);
        assert!(dataset.warnings.is_empty(), "{:?}", dataset.warnings);
    }
    // with its list, the folder of the camera is one of EuRoC too
    let list = "#timestamp,name\n1403636579763555584,1403636579763555584.png\n";
    fs::write(camera.join("data.csv"), list).expect("writable");
    assert_eq!(open(&camera).expect("opens").layout, Layout::Euroc);
    // names that are numbers of images
    let root = folder();
    image(&root.path().join("0000000001.png"));
    image(&root.path().join("0000000002.png"));
    assert_eq!(open(root.path()).expect("opens").layout, Layout::Folder);
    assert_eq!(times(&open(root.path()).expect("opens"))[0], 0);
}

#[test]
fn tum_vi_has_its_camera_and_its_poses_elsewhere() {
    let root = folder();
    let names = ["1520530308199447626", "1520530308249448626"];
    let camera = root.path().join("mav0/cam0");
    for name in names {
        image(&camera.join(format!("data/{name}.png")));
    }
    let write = |name: &str, text: &str| {
        let path = root.path().join(name);
        fs::create_dir_all(path.parent().expect("a parent")).expect("writable");
        fs::write(path, text).expect("writable");
    };
    let list: String = names.iter().map(|n| format!("{n},{n}.png\n")).collect();
    write(
        "mav0/cam0/data.csv",
        &format!("#timestamp [ns],filename\n{list}"),
    );
    // the camera is 0.1 m ahead of the sensor
    write(
        "dso/camchain.yaml",
        "cam0:\n  T_cam_imu:\n  - [1.0, 0.0, 0.0, 0.0]\n  - [0.0, 1.0, 0.0, 0.0]\n  - [0.0, 0.0, \
         1.0, -0.1]\n  - [0.0, 0.0, 0.0, 1.0]\n  camera_model: pinhole\n  distortion_coeffs: \
         [0.003, 0.0007, -0.002, 0.0002]\n  distortion_model: equidistant\n  intrinsics: [4.0, \
         4.0, 3.5, 2.5]\n  resolution: [8, 6]\n",
    );
    let pose = format!(
        "#timestamp [ns], px, py, pz, qw, qx, qy, qz\n{},1,2,3,1,0,0,0\n",
        names[0]
    );
    write("mav0/mocap0/data.csv", &pose);
    let dataset = open(root.path()).expect("opens");
    assert_eq!(dataset.layout, Layout::TumVi);
    assert_eq!(
        times(&dataset),
        names.map(|name| name.parse::<i64>().expect("a number"))
    );
    let calibration = dataset.calibration(None).expect("known").expect("there");
    assert_eq!(calibration.camera.width, 8);
    let poses = dataset.reference_trajectory();
    let poses = poses.expect("readable").expect("there");
    let place = poses[0].world_from_camera.translation;
    assert!((place - Vec3::new(1.0, 2.0, 3.1)).norm() < 1e-12, "{place}");
}

#[test]
fn eth3d_is_like_tum_with_a_camera_of_four_numbers() {
    let root = folder();
    let (mut lists, mut poses) = ([String::new(), String::new()], String::new());
    for k in 0..3 {
        for (list, kind) in lists.iter_mut().zip(["rgb", "depth"]) {
            image(&root.path().join(format!("{kind}/5436.{k}00000.png")));
            *list += &format!("5436.{k}00000 {kind}/5436.{k}00000.png\n");
        }
        poses += &format!("5436.{k}00000 {k} 0 0 0 0 0 1\n");
    }
    for (name, text) in [
        ("rgb.txt", &lists[0]),
        ("depth.txt", &lists[1]),
        ("associated.txt", &lists[0]),
        ("groundtruth.txt", &poses),
        (
            "calibration.txt",
            &"726.28 726.28 354.65 186.46\n".to_owned(),
        ),
    ] {
        fs::write(root.path().join(name), text).expect("writable");
    }
    let dataset = open(root.path()).expect("opens");
    assert_eq!(
        (dataset.layout, dataset.layout.name()),
        (Layout::Eth3d, "ETH3D")
    );
    assert_eq!((dataset.frames.len(), dataset.depths.len()), (3, 3));
    let calibration = dataset.calibration(Some((739, 458)));
    let calibration = calibration.expect("known").expect("there");
    assert_eq!(calibration.camera.pinhole.cx, 354.65);
    let units = dataset.registered_depth(calibration.camera).units_per_metre;
    assert_eq!(units, 5000.0);
    let poses = dataset.reference_trajectory();
    assert_eq!(poses.expect("readable").expect("there").len(), 3);
}

#[test]
fn scannet_has_a_folder_for_each_kind_and_a_camera_for_depth() {
    let root = folder();
    let write = |name: &str, text: &str| {
        let path = root.path().join(name);
        fs::create_dir_all(path.parent().expect("a parent")).expect("writable");
        fs::write(path, text).expect("writable");
    };
    for k in 0..12 {
        image(&root.path().join(format!("color/{k}.png")));
        write(
            &format!("pose/{k}.txt"),
            &format!("1 0 0 {k}\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"),
        );
        let depth = Image::filled(4, 3, 1500_u16);
        fs::create_dir_all(root.path().join("depth")).expect("writable");
        let depth = encode_png_16(&depth);
        fs::write(root.path().join(format!("depth/{k}.png")), depth).expect("writable");
    }
    // tracking failed in one
    write("pose/1.txt", &"-inf -inf -inf -inf\n".repeat(4));
    let matrix = |f: f64| format!("{f} 0 3.5 0\n0 {f} 2.5 0\n0 0 1 0\n0 0 0 1\n");
    write("intrinsic/intrinsic_color.txt", &matrix(9.0));
    write("intrinsic/intrinsic_depth.txt", &matrix(5.0));
    let dataset = open(root.path()).expect("opens");
    assert_eq!(dataset.layout, Layout::ScanNet);
    // in the order of their numbers
    assert_eq!(names(&dataset)[2], "2.png");
    let depths: Vec<i64> = dataset.depths.iter().map(|d| d.timestamp_ns).collect();
    assert_eq!(depths, times(&dataset));
    let poses = dataset.reference_trajectory();
    let poses = poses.expect("readable").expect("there");
    assert_eq!(poses.len(), 11);
    assert_eq!(poses[1].world_from_camera.translation.x, 2.0);
    let camera = dataset
        .calibration(Some((8, 6)))
        .expect("known")
        .expect("there");
    assert_eq!(camera.camera.pinhole.fx, 9.0);
    let depth = dataset.depth_calibration().expect("known").expect("there");
    assert_eq!((depth.camera.width, depth.camera.pinhole.fx), (4, 5.0));
    assert_eq!(depth.units_per_metre, 1000.0);
}

#[test]
fn kitti_poses_take_the_times_of_the_frames() {
    let root = folder();
    let sequence = root.path().join("sequences/07");
    for name in ["000000.png", "000001.png"] {
        image(&sequence.join("image_0").join(name));
    }
    fs::write(sequence.join("times.txt"), "0.0\n0.1\n").expect("writable");
    let poses = root.path().join("poses/07.txt");
    fs::create_dir_all(root.path().join("poses")).expect("writable");
    fs::write(
        &poses,
        "1 0 0 0 0 1 0 0 0 0 1 0\n0 0 1 5 0 1 0 6 -1 0 0 7\n",
    )
    .expect("writable");
    let dataset = open(&sequence).expect("opens");
    let read = dataset
        .reference_trajectory()
        .expect("readable")
        .expect("present");
    assert_eq!(read[1].timestamp_ns, 100_000_000);
    let point = read[1].world_from_camera * monogrid_geometry::Vec3::new(1.0, 2.0, 3.0);
    assert!(
        (point - monogrid_geometry::Vec3::new(8.0, 8.0, 6.0)).norm() < 1e-9,
        "{point}"
    );
    for text in ["1 0 0 0 0 1 0 0 0 0 2 0\n", "1 0 0 0 0 1 0 0 0 0 -1 0\n"] {
        fs::write(&poses, text).expect("writable");
        assert!(dataset.reference_trajectory().is_err(), "{text}");
    }
    fs::write(&poses, "1 0 0 0 0 1 0 0 0 0 1 0\n".repeat(3)).expect("writable");
    let error = dataset
        .reference_trajectory()
        .expect_err("three poses")
        .to_string();
    assert!(
        error.contains("07.txt") && error.contains("2 frames"),
        "{error}"
    );
}

#[test]
fn depth_without_images_opens() {
    let root = folder();
    fs::write(
        root.path().join("depth.txt"),
        "0.5 depth/a.png\n0.1 depth/b.png\n",
    )
    .expect("writable");
    let dataset = open(root.path()).expect("opens");
    assert!(dataset.frames.is_empty());
    let times: Vec<i64> = dataset.depths.iter().map(|d| d.timestamp_ns).collect();
    assert_eq!(times, [100_000_000, 500_000_000]);
    assert_eq!(dataset.frame_interval_secs(), None);
}

/// The files of a folder as a zip file (with an entry that leads out of it), as a tar file with a
/// long name, and as a gzipped one.
fn archives(folder: &Path) -> TempDir {
    let out = self::folder();
    let create = |name: &str| fs::File::create(out.path().join(name)).expect("writable");
    let mut zip = zip::ZipWriter::new(create("Kitchen.zip"));
    let options = zip::write::SimpleFileOptions::default();
    let mut tar = tar::Builder::new(Vec::new());
    let mut add = |name: &str, bytes: &[u8]| {
        zip.start_file(name, options).expect("an entry");
        std::io::Write::write_all(&mut zip, bytes).expect("writable");
    };
    for name in ["rgb.txt", "rgb/1.png", "rgb/2.png", "calibration.txt"] {
        let bytes = fs::read(folder.join(name)).expect("readable");
        add(&format!("set/{name}"), &bytes);
        tar.append_path_with_name(folder.join(name), format!("set/{name}"))
            .expect("an entry");
    }
    add("../escaped.txt", b"x");
    add("set/program.exe", b"x");
    zip.finish().expect("writable");
    let mut header = tar::Header::new_gnu();
    header.set_size(1);
    header.set_mode(0o644);
    let long = format!("set/{}/note.md", "a long name ".repeat(20));
    tar.append_data(&mut header, long, &b"x"[..])
        .expect("an entry");
    let tar = tar.into_inner().expect("in memory");
    std::io::Write::write_all(&mut create("Kitchen.tar"), &tar).expect("writable");
    let fast = flate2::Compression::fast();
    let mut gz = flate2::write::GzEncoder::new(create("Kitchen.tar.gz"), fast);
    std::io::Write::write_all(&mut gz, &tar).expect("writable");
    gz.finish().expect("writable");
    out
}

#[test]
fn sequences_in_archives() {
    let root = folder();
    image(&root.path().join("rgb/1.png"));
    image(&root.path().join("rgb/2.png"));
    fs::write(
        root.path().join("rgb.txt"),
        "0.1 rgb/1.png\n0.2 rgb/2.png\n",
    )
    .expect("writable");
    fs::write(root.path().join("calibration.txt"), "5 5 4 3 8 6\n").expect("writable");
    let packed = archives(root.path());
    for name in ["Kitchen.zip", "Kitchen.tar", "Kitchen.tar.gz"] {
        let dataset = open(&packed.path().join(name)).expect(name);
        assert_eq!(
            (dataset.name.as_str(), dataset.layout),
            ("Kitchen", Layout::Tum)
        );
        assert_eq!(times(&dataset), [100_000_000, 200_000_000]);
        let copy = dataset.clone();
        drop(dataset);
        assert!(
            read_gray(&copy.frames[1].path).is_ok(),
            "files live as long as the data set"
        );
        assert!(copy.calibration(None).expect("readable").is_some());
        let is_said = copy.warnings.iter().any(|w| w.contains("decompressed"));
        assert_eq!(is_said, name == "Kitchen.tar.gz", "{:?}", copy.warnings);
        let image = copy.frames[1].path.clone();
        assert!(image.ends_with(format!("{name}/set/rgb/2.png")));
        drop(copy);
        assert!(read_gray(&image).is_err(), "and go with it");
    }
    assert!(!packed.path().join("escaped.txt").exists());
}

#[test]
fn images_of_tum_monovo_in_their_zip() {
    let root = folder();
    let mut zip =
        zip::ZipWriter::new(fs::File::create(root.path().join("images.zip")).expect("writable"));
    for name in ["00000.png", "00001.png"] {
        zip.start_file(name, zip::write::SimpleFileOptions::default())
            .expect("an entry");
        std::io::Write::write_all(&mut zip, &encode_png(&gray(8, 6))).expect("writable");
    }
    zip.finish().expect("writable");
    fs::write(
        root.path().join("times.txt"),
        "00000 1.5 0.01\n00001 1.6 0.01\n",
    )
    .expect("writable");
    fs::write(
        root.path().join("camera.txt"),
        "Pinhole 0.5 0.6 0.5 0.5 0\n8 6\n",
    )
    .expect("writable");
    let dataset = open(root.path()).expect("opens");
    assert_eq!(dataset.layout, Layout::TumMonoVo);
    assert_eq!(times(&dataset), [1_500_000_000, 1_600_000_000]);
    assert!(dataset.calibration(None).expect("readable").is_some());
    assert!(read_gray(&dataset.frames[0].path).is_ok());
}

#[test]
fn archives_that_are_no_sequences() {
    let root = folder();
    let bomb = root.path().join("bomb.zip");
    let mut zip = zip::ZipWriter::new(fs::File::create(&bomb).expect("writable"));
    zip.start_file("1.png", zip::write::SimpleFileOptions::default())
        .expect("an entry");
    std::io::Write::write_all(&mut zip, &vec![0; 10_000_000]).expect("writable");
    zip.finish().expect("writable");
    let error = open(&bomb).expect_err("a bomb").to_string();
    assert!(error.contains("100 times the size"), "{error}");
    let gz = fs::File::create(root.path().join("bomb.tgz")).expect("writable");
    let mut tar = tar::Builder::new(flate2::write::GzEncoder::new(
        gz,
        flate2::Compression::best(),
    ));
    let mut header = tar::Header::new_gnu();
    header.set_size(10_000_000);
    header.set_mode(0o644);
    // one that would not even be listed
    tar.append_data(&mut header, "1.bin", std::io::repeat(0).take(10_000_000))
        .expect("an entry");
    tar.into_inner()
        .and_then(flate2::write::GzEncoder::finish)
        .expect("writable");
    let error = open(&root.path().join("bomb.tgz"))
        .expect_err("a bomb")
        .to_string();
    assert!(error.contains("100 times the size"), "{error}");
    let whole = fs::read(&bomb).expect("readable");
    for (name, bytes) in [
        ("cut.zip", &whole[..whole.len() / 2]),
        ("empty.tar", &[][..]),
        ("text.tgz", b"text"),
    ] {
        fs::write(root.path().join(name), bytes).expect("writable");
        let error = open(&root.path().join(name)).expect_err(name).to_string();
        assert!(
            error.contains("an archive that cannot be read") || error.contains("no images"),
            "{error}"
        );
    }
}

#[test]
fn a_zip_file_whose_content_is_not_what_went_in_is_refused() {
    let root = folder();
    let whole = root.path().join("whole.zip");
    let mut zip = zip::ZipWriter::new(fs::File::create(&whole).expect("writable"));
    let stored =
        zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    zip.start_file("1.png", stored).expect("an entry");
    std::io::Write::write_all(&mut zip, &encode_png(&gray(8, 6))).expect("writable");
    zip.finish().expect("writable");
    assert!(open(&whole).is_ok());
    let whole = fs::read(&whole).expect("readable");
    let central = whole
        .windows(4)
        .position(|four| four == b"PK\x01\x02")
        .expect("a directory");
    let refused = |at: usize, value: u8| {
        let mut bytes = whole.clone();
        bytes[at] ^= value;
        let path = root.path().join("changed.zip");
        fs::write(&path, bytes).expect("writable");
        open(&path).expect_err("changed").to_string()
    };
    // its flags, its method, a byte of the image
    assert!(refused(central + 8, 1).contains("encrypted"));
    assert!(refused(central + 10, 12).contains("method 12"));
    let mut bytes = whole.clone();
    bytes[central - 10] ^= 1;
    let path = root.path().join("changed.zip");
    fs::write(&path, bytes).expect("writable");
    let dataset = open(&path).expect("its directory is whole");
    let error = read_gray(&dataset.frames[0].path).expect_err("changed");
    assert!(matches!(error, DatasetError::Io { .. }), "{error}");
}

/// A tar file with a header of this kind and size (of zeros that are not written), and an image
/// behind it.
fn tar_with_header(path: &Path, kind: tar::EntryType, size: u64) {
    use std::io::{Seek as _, SeekFrom, Write as _};
    let mut header = tar::Header::new_gnu();
    header.set_entry_type(kind);
    header.set_size(size);
    header.set_cksum();
    let mut file = fs::File::create(path).expect("writable");
    file.write_all(header.as_bytes()).expect("writable");
    file.seek(SeekFrom::Current(size.next_multiple_of(512) as i64))
        .expect("seekable");
    let mut rest = tar::Builder::new(file);
    let image = encode_png(&gray(8, 6));
    let mut header = tar::Header::new_gnu();
    header.set_size(image.len() as u64);
    rest.append_data(&mut header, "1.png", &image[..])
        .expect("an entry");
    rest.finish().expect("writable");
}

#[test]
fn a_tar_file_with_a_huge_name_or_header_is_refused_before_it_is_read() {
    let root = folder();
    let path = root.path().join("a.tar");
    for kind in [tar::EntryType::GNULongName, tar::EntryType::XHeader] {
        // sparse: no disk has to hold it, no memory either
        tar_with_header(&path, kind, 1 << 40);
        let error = open(&path).expect_err("huge").to_string();
        assert!(error.contains("1099511627776 bytes"), "{error}");
    }
    // of no use, and skipped
    tar_with_header(&path, tar::EntryType::XGlobalHeader, 1 << 40);
    let dataset = open(&path).expect("opens");
    assert!(read_gray(&dataset.frames[0].path).is_ok());
}

#[test]
fn a_tar_file_that_is_cut_within_a_file_is_refused() {
    let root = folder();
    let mut tar = tar::Builder::new(Vec::new());
    let image = encode_png(&gray(80, 60));
    for name in ["1.png", "2.png"] {
        let mut header = tar::Header::new_gnu();
        header.set_size(image.len() as u64);
        tar.append_data(&mut header, name, &image[..])
            .expect("an entry");
    }
    let bytes = tar.into_inner().expect("in memory");
    let second = bytes.len() - 1024 - image.len().next_multiple_of(512);
    let path = root.path().join("cut.tar");
    fs::write(&path, &bytes[..second + image.len() / 2]).expect("writable");
    let error = open(&path).expect_err("cut").to_string();
    assert!(error.contains("cut off"), "{error}");
}

/// Pixels that a source may show beyond those of any source.
fn more_pixels(dataset: &Dataset) -> usize {
    let mut budget = dataset.pixel_budget();
    budget.spend(1 << 27, 1).expect("as any source");
    let more = (0..).find(|_| budget.spend(1, 1).is_err());
    more.expect("no source may show everything")
}

#[test]
fn what_images_may_show_follows_from_what_is_stored_once() {
    let root = folder();
    for name in ["1.png", "2.png", "3.png"] {
        image(&root.path().join(name));
    }
    let length = |name: &str| {
        let file = fs::metadata(root.path().join(name));
        file.expect("a file").len() as usize
    };
    let one = length("1.png");
    let dataset = open(root.path()).expect("a folder");
    assert_eq!(more_pixels(&dataset), 256 * 3 * one);
    // one that is listed again and again is one file
    let list = "0.0 1.png\n0.1 2.png\n0.2 1.png\n0.3 1.png\n0.4 1.png\n";
    fs::write(root.path().join("rgb.txt"), list).expect("writable");
    let dataset = open(root.path()).expect("a list");
    assert_eq!(dataset.frames.len(), 5);
    assert_eq!(more_pixels(&dataset), 256 * 2 * one);
    // an archive counts as it is, whatever its entries claim
    let path = root.path().join("a.zip");
    let mut zip = zip::ZipWriter::new(fs::File::create(&path).expect("writable"));
    let deflated = zip::write::SimpleFileOptions::default();
    for name in ["1.png", "2.png"] {
        zip.start_file(name, deflated).expect("an entry");
        let plain = encode_png(&Image::from_fn(500, 500, |_, _| 0));
        std::io::Write::write_all(&mut zip, &plain).expect("writable");
    }
    zip.finish().expect("writable");
    let dataset = open(&path).expect("an archive");
    assert_eq!(more_pixels(&dataset), 256 * length("a.zip"));
}

#[test]
fn folders_within_folders_cost_no_more_than_their_names() {
    let root = folder();
    let path = root.path().join("a.zip");
    let mut zip = zip::ZipWriter::new(fs::File::create(&path).expect("writable"));
    let folders = "a/".repeat(32_000);
    for name in ["1.png", "2.png"] {
        zip.start_file(
            format!("{folders}{name}"),
            zip::write::SimpleFileOptions::default(),
        )
        .expect("an entry");
        std::io::Write::write_all(&mut zip, &encode_png(&gray(8, 6))).expect("writable");
    }
    zip.finish().expect("writable");
    let begin = std::time::Instant::now();
    let dataset = open(&path).expect("an archive");
    assert_eq!(names(&dataset), ["1.png", "2.png"]);
    // looked at folder by folder, they take a minute
    assert!(begin.elapsed() < std::time::Duration::from_secs(10));
}

#[test]
fn links_are_no_files_of_an_archive_and_of_two_names_the_first_counts() {
    let root = folder();
    let path = root.path().join("a.tar");
    let mut tar = tar::Builder::new(fs::File::create(&path).expect("writable"));
    let mut add = |name: &str, kind: tar::EntryType, content: &[u8]| {
        let mut header = tar::Header::new_gnu();
        header.set_size(content.len() as u64);
        header.set_entry_type(kind);
        if !kind.is_file() {
            header.set_link_name("/etc/passwd").expect("a name");
        }
        header.set_cksum();
        tar.append_data(&mut header, name, content)
            .expect("writable");
    };
    add("1.png", tar::EntryType::Regular, &encode_png(&gray(8, 6)));
    add("1.png", tar::EntryType::Regular, &encode_png(&gray(16, 6)));
    add("2.png", tar::EntryType::Symlink, &[]);
    add("3.png", tar::EntryType::Link, &[]);
    tar.finish().expect("writable");
    let dataset = open(&path).expect("an archive");
    assert_eq!(names(&dataset), ["1.png"]);
    let first = read_gray(&dataset.frames[0].path).expect("an image");
    assert_eq!(first.width(), 8);
}

#[test]
fn encrypted_zip_files_are_refused() {
    let root = folder();
    let path = root.path().join("a.zip");
    let mut zip = zip::ZipWriter::new(fs::File::create(&path).expect("writable"));
    zip.start_file("1.png", zip::write::SimpleFileOptions::default())
        .expect("an entry");
    std::io::Write::write_all(&mut zip, &encode_png(&gray(8, 6))).expect("writable");
    zip.finish().expect("writable");
    assert!(open(&path).is_ok());
    // the flag in the list at the end, and in front of the file
    let mut bytes = fs::read(&path).expect("readable");
    for (mark, flags) in [(b"PK\x01\x02", 8), (b"PK\x03\x04", 6)] {
        let at = bytes.windows(4).position(|four| four == mark);
        bytes[at.expect("a header") + flags] |= 1;
    }
    fs::write(&path, bytes).expect("writable");
    let error = open(&path).expect_err("encrypted").to_string();
    assert!(error.contains("encrypted"), "{error}");
}
