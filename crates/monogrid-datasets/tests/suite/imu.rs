//! Inertial readings in the forms in which phones and data sets have them.

use monogrid_datasets::{Dataset, ImuFile, SourceOptions, read_transform, write_imu};
use monogrid_geometry::{Se3, Vec3, rotation_exp};
use monogrid_inertial::{GRAVITY_M_S2, ImuNoise, ImuSample};
use std::fs;
use std::path::{Path, PathBuf};

fn file(folder: &Path, text: &str) -> PathBuf {
    let path = folder.join("imu.csv");
    fs::write(&path, text).expect("a file");
    path
}

fn samples() -> Vec<ImuSample> {
    (0..6i64)
        .map(|k| ImuSample {
            timestamp_ns: 1_403_715_273_262_142_976 + k * 5_000_000,
            angular_velocity: Vec3::new(0.25 * k as f64, -0.25, 0.5),
            specific_force: Vec3::new(0.5, -9.75, 0.125 * k as f64),
        })
        .collect()
}

#[test]
fn what_is_written_is_read_with_mount_and_noise() {
    let folder = tempfile::tempdir().unwrap();
    let mount = Se3::new(
        rotation_exp(&Vec3::new(0.2, -1.0, 0.4)),
        Vec3::new(0.1, 0.0, -0.03),
    );
    let noise = ImuNoise {
        gyroscope: 1.7e-4,
        ..ImuNoise::default()
    };
    write_imu(folder.path(), &samples(), &noise, &mount, 200.0).unwrap();
    let found = ImuFile::read(&folder.path().join("data.csv")).unwrap();
    assert_eq!(found.samples, samples(), "to the nanosecond");
    assert_eq!(found.noise, Some(noise));
    let error = found.body_from_imu.unwrap() * mount.inverse();
    assert!(error.log().norm() < 1e-9);
    assert!(
        found.interpretation.contains("nanoseconds"),
        "{}",
        found.interpretation
    );
}

#[test]
fn columns_and_units_of_phones_are_found() {
    let folder = tempfile::tempdir().unwrap();
    // seconds, g, degrees, another order of columns
    let path = file(
        folder.path(),
        "seconds_elapsed,accel_x (g),accel_y (g),accel_z (g),gyro_x (deg/s),gyro_y (deg/s),gyro_z \
         (deg/s)\n12.50,0.1,-0.99,0,90,0,-45\n12.51,0.1,-0.99,0,90,0,-45\n\
         12.52,0.1,-0.99,0,90,0,-45\n",
    );
    let found = ImuFile::read(&path).unwrap();
    let first = found.samples[0];
    assert_eq!(first.timestamp_ns, 12_500_000_000);
    assert!(
        (first.angular_velocity - Vec3::new(90.0, 0.0, -45.0).map(f64::to_radians)).norm() < 1e-12
    );
    assert!((first.specific_force - Vec3::new(0.1, -0.99, 0.0) * GRAVITY_M_S2).norm() < 1e-12);
    // no names, milliseconds, blanks
    let path = file(
        folder.path(),
        "1000 0 0 0.1 0 9.8 0\n1005.5 0 0 0.1 0 9.8 0\n1010 0 0 0.1 0 9.8 0\n",
    );
    let found = ImuFile::read(&path).unwrap();
    assert_eq!(found.samples[1].timestamp_ns, 1_005_500_000);
    assert_eq!(found.samples[1].angular_velocity, Vec3::new(0.0, 0.0, 0.1));
    assert!(found.noise.is_none() && found.body_from_imu.is_none());
    // microseconds
    let path = file(
        folder.path(),
        "timestamp,gx,gy,gz,ax,ay,az\n5000,0,0,0,0,0,9.8\n10000,0,0,0,0,0,9.8\n",
    );
    assert_eq!(
        ImuFile::read(&path).unwrap().samples[1].timestamp_ns,
        10_000_000
    );
}

#[test]
fn what_is_no_such_sensor_is_refused_with_what_was_expected() {
    let folder = tempfile::tempdir().unwrap();
    let cases = [
        ("timestamp,gx,gy,gz\n0,1,2,3\n", "names of columns"),
        ("0,0,0,0,0,0,9.8\n", "a reading of gyroscope"),
        (
            "0,0,0,0,0,0,9.8\n0.01,0,0,x,0,0,9.8\n",
            "a time and six numbers",
        ),
        (
            "0,0,0,0,0,0,9.8\n0.3,0,0,0,0,0,9.8\n0.6,0,0,0,0,0,9.8\n",
            "0.5 to 200 ms",
        ),
        // gravity was taken off
        (
            "0,0,0,0,0,0,0.01\n0.01,0,0,0,0,0,0.02\n",
            "with gravity in it",
        ),
    ];
    for (text, expected) in cases {
        let path = file(folder.path(), text);
        let error = ImuFile::read(&path).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn readings_that_lie_in_a_source_are_found() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let image = monogrid_image::GrayImage::filled(4, 4, 9.0);
    fs::create_dir_all(root.join("images")).unwrap();
    for k in 0..3 {
        let bytes = monogrid_datasets::encode_png(&image.map(|v| v as u8));
        fs::write(root.join(format!("images/{k}.png")), bytes).unwrap();
    }
    let open = || {
        Dataset::open(root, SourceOptions::default())
            .unwrap()
            .imu_path
    };
    assert_eq!(open(), None);
    fs::write(root.join("imu.csv"), "").unwrap();
    assert_eq!(open(), Some(root.join("imu.csv")));
    fs::create_dir_all(root.join("mav0/imu0")).unwrap();
    fs::write(root.join("mav0/imu0/data.csv"), "").unwrap();
    assert_eq!(open(), Some(root.join("mav0/imu0/data.csv")));
}

#[test]
fn a_transform_is_seven_numbers_or_a_matrix() {
    let folder = tempfile::tempdir().unwrap();
    let path = file(
        folder.path(),
        "# imu_from_camera\n0.1 0.2 0.3 0 0 0.7071067811865476 0.7071067811865476\n",
    );
    let pose = read_transform(&path).unwrap();
    let path = file(folder.path(), "0 -1 0 0.1\n1 0 0 0.2\n0 0 1 0.3\n0 0 0 1\n");
    assert!(
        (read_transform(&path).unwrap() * pose.inverse())
            .log()
            .norm()
            < 1e-9
    );
    let path = file(folder.path(), "1 2 3\n");
    assert!(
        read_transform(&path)
            .unwrap_err()
            .to_string()
            .contains("3 numbers")
    );
    let path = file(folder.path(), "2 0 0 0 0 2 0 0 0 0 2 0\n");
    assert!(read_transform(&path).is_err(), "no rotation");
}

/// A log of one sensor: times of 10 ms, and a constant reading in columns of these names.
fn log(folder: &Path, name: &str, columns: &str, first_ns: i64, [x, y, z]: [f64; 3]) {
    let mut text = format!("{columns}\n").trim_start().to_owned();
    for k in 0..20 {
        let ns = first_ns + k * 10_000_000;
        let value = |column: &str| match column {
            "x" => x.to_string(),
            "y" => y.to_string(),
            "z" => z.to_string(),
            "seconds_elapsed" => format!("{:.3}", 0.01 * k as f64),
            _ => ns.to_string(),
        };
        let columns = if columns.is_empty() {
            "x,y,z,time"
        } else {
            columns
        };
        let row: Vec<String> = columns.split(',').map(value).collect();
        text += &(row.join(",") + "\n");
    }
    fs::write(folder.join(name), text).expect("a file");
}

/// When the gyroscope begins, and what it reads.
const START: i64 = 1_770_510_090_666_860_288;
const RATE: [f64; 3] = [0.25, -0.5, 1.0];

fn check_log(path: &Path, force: [f64; 3], said: &str) {
    let found = ImuFile::read(path).expect("a log");
    let text = &found.interpretation;
    assert!(
        text.contains(said) && text.contains("nanoseconds"),
        "{text}"
    );
    // the accelerometer begins 5 ms later and ends as much later
    assert_eq!(found.samples.len(), 19, "{text}");
    assert_eq!(found.samples[0].timestamp_ns, START + 10_000_000);
    for sample in &found.samples {
        assert_eq!(sample.angular_velocity, Vec3::from(RATE));
        assert!(
            (sample.specific_force - Vec3::from(force)).norm() < 1e-9,
            "{text}"
        );
    }
}

#[test]
fn logs_of_phones_have_a_file_for_each_sensor() {
    const COLUMNS: &str = "time,seconds_elapsed,z,y,x";
    let (start, rate, later) = (START, RATE, START + 5_000_000);
    let device = "version,device name,platform,standardisation";
    let new = || tempfile::tempdir().unwrap();

    // Sensor Logger on Android
    let folder = new();
    let at = folder.path();
    log(at, "Gyroscope.csv", COLUMNS, start, rate);
    log(at, "GyroscopeUncalibrated.csv", COLUMNS, start, [9.0; 3]);
    log(at, "Accelerometer.csv", COLUMNS, later, [0.0, 0.0, 0.25]);
    log(at, "Gravity.csv", COLUMNS, later, [0.0, 0.0, 9.75]);
    log(
        at,
        "TotalAcceleration.csv",
        COLUMNS,
        later,
        [0.0, 0.5, 10.0],
    );
    check_log(at, [0.0, 0.5, 10.0], "TotalAcceleration.csv");
    check_log(&at.join("Gyroscope.csv"), [0.0, 0.5, 10.0], "Gyroscope.csv");

    // iOS has gravity in a file of its own, downwards unless the application was set otherwise
    fs::remove_file(at.join("TotalAcceleration.csv")).unwrap();
    let error = ImuFile::read(at).unwrap_err().to_string();
    assert!(error.contains("Metadata.csv"), "{error}");
    for (standard, sign) in [("false", -1.0), ("true", 1.0)] {
        let text = format!("{device}\n1,a phone,ios,{standard}\n");
        fs::write(at.join("Metadata.csv"), text).unwrap();
        check_log(
            at,
            [0.0, 0.0, 10.0 * sign],
            "Accelerometer.csv + Gravity.csv",
        );
    }
}

#[test]
fn logs_beside_a_video_have_no_names_of_columns() {
    let (start, rate, later) = (START, RATE, START + 5_000_000);
    let new = || tempfile::tempdir().unwrap();
    // OpenCamera Sensors
    let folder = new();
    let at = folder.path();
    log(at, "VID_1gyro.csv", "", start, rate);
    log(at, "VID_1accel.csv", "", later, [0.0, 9.5, 0.0]);
    check_log(at, [0.0, 9.5, 0.0], "VID_1accel.csv");
    log(at, "VID_2gyro.csv", "", start, [0.0; 3]);
    log(at, "VID_2accel.csv", "", later, [9.5, 0.0, 0.0]);
    check_log(&at.join("VID_1gyro.csv"), [0.0, 9.5, 0.0], "VID_1accel.csv");
    check_log(&at.join("VID_1accel.csv"), [0.0, 9.5, 0.0], "VID_1gyro.csv");
    let error = ImuFile::read(at).unwrap_err().to_string();
    assert!(error.contains("several recordings"), "{error}");
    let error = ImuFile::read(new().path()).unwrap_err().to_string();
    assert!(error.contains("TotalAcceleration.csv"), "{error}");
}
