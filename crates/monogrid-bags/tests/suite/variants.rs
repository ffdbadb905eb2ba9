//! Recordings as other programs write them: late images, messages and files that are compressed,
//! Foxglove's messages, stamps from 0, damage that only a checksum shows. Each test writes its own.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use base64::Engine as _;
use monogrid_bags::{Bag, McapWriter, TopicKind, is_bag};
use monogrid_datasets::{encode_png, encode_png_16};
use monogrid_geometry::{Distortion, Pinhole};
use monogrid_image::Image;
use monogrid_messages::builtin_interfaces::Time;
use monogrid_messages::geometry_msgs::TransformStamped;
use monogrid_messages::nav_msgs;
use monogrid_messages::sensor_msgs::{CameraInfo, CompressedImage, Image as Pixels, Imu};
use monogrid_messages::std_msgs::Header;
use monogrid_messages::tf2_msgs::TFMessage;
use monogrid_messages::{RosMessage, cdr};
use ruzstd::encoding::{CompressionLevel, compress_to_vec};
use std::fs;
use std::path::{Path, PathBuf};

const MAGIC: &[u8] = b"\x89MCAP0\r\n";

fn data(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    folder.join("tests/data").join(name)
}

fn zstd(bytes: &[u8]) -> Vec<u8> {
    compress_to_vec(bytes, CompressionLevel::Fastest)
}

/// A text behind its length.
fn text(text: &str) -> Vec<u8> {
    [&(text.len() as u32).to_le_bytes(), text.as_bytes()].concat()
}

/// An MCAP file without chunks and summary, record by record (<https://mcap.dev/spec>).
struct Mcap(Vec<u8>);

impl Mcap {
    fn new() -> Self {
        let mut file = Self(MAGIC.to_vec());
        file.record(1, &[text(""), text("a test")].concat());
        file
    }

    fn record(&mut self, opcode: u8, body: &[u8]) {
        self.0.push(opcode);
        self.0.extend((body.len() as u64).to_le_bytes());
        self.0.extend(body);
    }

    fn channel(&mut self, id: u16, topic: &str, type_name: &str, encoding: &str) {
        let id = id.to_le_bytes().to_vec();
        let schema = [id.clone(), text(type_name), text(""), text("")].concat();
        self.record(3, &schema);
        let channel = [id.clone(), id, text(topic), text(encoding), text("")].concat();
        self.record(4, &channel);
    }

    fn message(&mut self, id: u16, log_ns: u64, data: &[u8]) {
        let mut body = id.to_le_bytes().to_vec();
        body.extend([0; 4]);
        body.extend(log_ns.to_le_bytes());
        body.extend(log_ns.to_le_bytes());
        body.extend(data);
        self.record(5, &body);
    }

    fn write(mut self, path: &Path) {
        self.record(2, &[0; 20]);
        self.0.extend(MAGIC);
        fs::write(path, self.0).unwrap();
    }
}

/// As ROS 2 writes it.
fn encoded<M: RosMessage>(message: &M) -> Vec<u8> {
    [&[0, 1, 0, 0], cdr::to_vec(message).unwrap().as_slice()].concat()
}

fn pixels(stamp_ns: i64, level: u8) -> Pixels {
    Pixels {
        header: Header {
            stamp: Time::from_nanoseconds(stamp_ns),
            frame_id: "camera".to_owned(),
        },
        height: 2,
        width: 3,
        encoding: "mono8".to_owned(),
        is_bigendian: 0,
        step: 3,
        data: vec![level; 6],
    }
}

/// Time and first pixel of all images.
fn shown(path: &Path, topic: Option<&str>) -> Vec<(i64, f32)> {
    let bag = Bag::open(path).unwrap();
    let images = bag.images(bag.image_topic(topic).unwrap());
    let images = images.map(|image| {
        let (time_ns, image) = image.unwrap();
        (time_ns, image.at(0, 0))
    });
    images.collect()
}

const IMAGE: &str = "sensor_msgs/msg/Image";

/// More messages than anyone looks at for topics, and then images and their camera.
fn write_late(path: &Path) {
    let mut writer = McapWriter::new(fs::File::create(path).unwrap(), "a test").unwrap();
    let other = nav_msgs::Path::default();
    for k in 0..6000 {
        writer.write("/other", k, &other).unwrap();
    }
    let png = encode_png(&Image::from_fn(3, 2, |_, _| 7_u8));
    for k in 0..3 {
        let message = CompressedImage {
            header: pixels(9000 + k, 0).header,
            format: "png".to_owned(),
            data: png.clone(),
        };
        writer.write("/cam/image", 6000 + k, &message).unwrap();
        let info = CameraInfo {
            width: 3,
            height: 2,
            k: [5.0, 0.0, 1.0, 0.0, 5.0, 0.5, 0.0, 0.0, 1.0],
            ..CameraInfo::default()
        };
        writer.write("/cam/camera_info", 6000 + k, &info).unwrap();
    }
    writer.finish().unwrap();
}

#[test]
fn images_that_start_late_are_found() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("late.mcap");
    write_late(&path);
    for topic in [None, Some("/cam/image")] {
        assert_eq!(shown(&path, topic), [(9000, 7.0), (9001, 7.0), (9002, 7.0)]);
    }
    let bag = Bag::open(&path).unwrap();
    let camera = bag.camera_of(bag.image_topic(None).unwrap()).unwrap();
    assert_eq!(camera.unwrap().pinhole, Pinhole::new(5.0, 5.0, 1.0, 0.5));
    // without the summary they are looked for
    let whole = fs::read(&path).unwrap();
    fs::write(&path, &whole[..whole.len() - 60]).unwrap();
    let bag = Bag::open(&path).unwrap();
    let images = bag.images(bag.image_topic(None).unwrap());
    assert_eq!(images.filter(Result::is_ok).count(), 3);
}

#[test]
fn indexes_of_all_formats_name_all_topics() {
    for name in ["plain.mcap", "plain.db3", "bz2.bag"] {
        let bag = Bag::open(&data(name)).unwrap();
        let names: Vec<&str> = bag.topics().iter().map(|t| t.name.as_str()).collect();
        assert_eq!(
            names,
            ["/camera/camera_info", "/camera/image_raw", "/chatter"],
            "{name}"
        );
    }
}

#[test]
fn a_bit_that_is_flipped_in_a_chunk_is_found_by_its_checksum() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("flipped.mcap");
    write_late(&path);
    let mut bytes = fs::read(&path).unwrap();
    // a pixel, or what compresses it: nothing else would notice
    let magic: &[u8] = b"IDAT";
    let at = bytes.windows(4).position(|w| w == magic).unwrap();
    bytes[at + 20] ^= 1;
    fs::write(&path, &bytes).unwrap();
    let bag = Bag::open(&path).unwrap();
    let mut images = bag.images(bag.image_topic(None).unwrap());
    let error = images.find_map(Result::err).unwrap().to_string();
    assert!(
        error.contains("flipped.mcap") && error.contains("checksum"),
        "{error}"
    );
}

#[test]
fn messages_that_were_compressed_one_by_one() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("message.mcap");
    let mut file = Mcap::new();
    file.channel(1, "/cam/image", IMAGE, "cdr");
    for k in 0..3 {
        let message = encoded(&pixels(100 + i64::from(k), k));
        file.message(1, 1, &zstd(&message));
    }
    file.write(&path);
    assert_eq!(shown(&path, None), [(100, 0.0), (101, 1.0), (102, 2.0)]);
}

#[test]
fn files_that_were_compressed_as_a_whole() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["plain.db3", "plain.mcap", "plain.bag"] {
        let path = folder.path().join(format!("{name}.zstd"));
        fs::write(&path, zstd(&fs::read(data(name)).unwrap())).unwrap();
        assert!(is_bag(&path), "{name}");
        assert_eq!(shown(&path, None), shown(&data(name), None), "{name}");
    }
    // what is compressed is no recording, or is cut
    let other = folder.path().join("text.zstd");
    fs::write(&other, zstd(b"no recording at all")).unwrap();
    assert!(!is_bag(&other));
    let whole = fs::read(folder.path().join("plain.db3.zstd")).unwrap();
    let cut = folder.path().join("cut.db3.zstd");
    fs::write(&cut, &whole[..whole.len() / 2]).unwrap();
    let error = Bag::open(&cut).unwrap_err().to_string();
    assert!(
        error.contains("cut.db3.zstd") && error.contains("decompress"),
        "{error}"
    );
}

#[test]
fn a_folder_of_parts_needs_no_description() {
    let folder = tempfile::tempdir().unwrap();
    let add = |name: &str| fs::copy(data("plain.db3"), folder.path().join(name)).unwrap();
    add("drive_0.db3");
    assert!(is_bag(folder.path()));
    add("drive_1.db3");
    fs::write(folder.path().join("notes.txt"), "sunny").unwrap();
    assert_eq!(shown(folder.path(), None).len(), 16);
    // something else lies there too
    let picture = folder.path().join("0001.png");
    fs::write(&picture, "pixels").unwrap();
    assert!(!is_bag(folder.path()));
    fs::remove_file(&picture).unwrap();
    // several recordings
    add("walk_0.db3");
    assert!(!is_bag(folder.path()));
}

#[test]
fn stamps_may_begin_at_zero_and_are_not_taken_where_nobody_sets_them() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("stamps.mcap");
    let write = |stamps: &[i64]| {
        let mut file = Mcap::new();
        file.channel(1, "/cam/image", IMAGE, "cdr");
        for (k, stamp_ns) in stamps.iter().enumerate() {
            file.message(1, 5000 + k as u64, &encoded(&pixels(*stamp_ns, 9)));
        }
        file.write(&path);
        let times = shown(&path, None).into_iter().map(|(time_ns, _)| time_ns);
        times.collect::<Vec<_>>()
    };
    assert_eq!(write(&[0, 33, 66]), [0, 33, 66]);
    assert_eq!(write(&[0, 0, 0]), [5000, 5001, 5002]);
    assert_eq!(write(&[7, 0, 3]), [7, 0, 3]);
    assert_eq!(write(&[0]), [5000]);
}

/// A field of Protocol Buffers with bytes.
fn field(number: u8, bytes: &[u8]) -> Vec<u8> {
    let mut length = bytes.len();
    let mut out = vec![number << 3 | 2];
    while length >= 0x80 {
        out.push(length as u8 | 0x80);
        length >>= 7;
    }
    out.push(length as u8);
    out.extend(bytes);
    out
}

fn fixed32(number: u8, value: u32) -> Vec<u8> {
    [&[number << 3 | 5], value.to_le_bytes().as_slice()].concat()
}

/// 3 s and 5 ns.
fn timestamp() -> Vec<u8> {
    field(1, &[1 << 3, 3, 2 << 3, 5])
}

const TIME_NS: i64 = 3_000_000_005;

fn numbers(values: &[f64]) -> Vec<u8> {
    values
        .iter()
        .flat_map(|value| value.to_le_bytes())
        .collect()
}

#[test]
fn images_and_cameras_of_foxglove_in_protocol_buffers() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("foxglove.mcap");
    let png = encode_png(&Image::from_fn(3, 2, |_, _| 77_u8));
    let compressed = [
        timestamp(),
        field(4, b"cam"),
        field(3, b"png"),
        field(2, &png),
    ]
    .concat();
    let raw = [
        timestamp(),
        fixed32(2, 3),
        fixed32(3, 2),
        field(4, b"rgb8"),
        fixed32(5, 9),
        field(6, &[50; 18]),
    ];
    let matrix = [5.0, 0.0, 1.0, 0.0, 6.0, 0.5, 0.0, 0.0, 1.0];
    let camera = [
        fixed32(2, 3),
        fixed32(3, 2),
        field(4, b"plumb_bob"),
        field(5, &numbers(&[0.1, 0.2, 0.0, 0.0, 0.0])),
        field(6, &numbers(&matrix)),
    ];
    let mut file = Mcap::new();
    file.channel(1, "/cam/compressed", "foxglove.CompressedImage", "protobuf");
    file.channel(2, "/cam/raw", "foxglove.RawImage", "protobuf");
    file.channel(
        3,
        "/cam/calibration",
        "foxglove.CameraCalibration",
        "protobuf",
    );
    file.message(1, 1, &compressed);
    file.message(2, 1, &raw.concat());
    file.message(3, 1, &camera.concat());
    file.write(&path);
    assert_eq!(shown(&path, Some("/cam/compressed")), [(TIME_NS, 77.0)]);
    assert_eq!(shown(&path, Some("/cam/raw")), [(TIME_NS, 50.0)]);
    let bag = Bag::open(&path).unwrap();
    let topic = bag.image_topic(Some("/cam/raw")).unwrap();
    let camera = bag.camera_of(topic).unwrap().unwrap();
    assert_eq!(camera.pinhole, Pinhole::new(5.0, 6.0, 1.0, 0.5));
    let Distortion::RadialTangential { k1, k2, .. } = camera.distortion else {
        panic!("{:?}", camera.distortion);
    };
    assert_eq!((k1, k2), (0.1, 0.2));
    // wherever it is cut: no panic, and no image that is none
    for end in 0..compressed.len() {
        let mut file = Mcap::new();
        file.channel(1, "/cam/compressed", "foxglove.CompressedImage", "protobuf");
        file.message(1, 1, &compressed[..end]);
        file.write(&path);
        let bag = Bag::open(&path).unwrap();
        let images = bag.images(bag.image_topic(None).unwrap());
        assert_eq!(images.filter(Result::is_ok).count(), 0, "{end}");
    }
}

#[test]
fn images_and_cameras_of_foxglove_in_json_and_from_ros() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("foxglove.mcap");
    let png = encode_png(&Image::from_fn(3, 2, |_, _| 77_u8));
    let base64 = |bytes: &[u8]| base64::engine::general_purpose::STANDARD.encode(bytes);
    let time = r#""timestamp": {"sec": 3, "nsec": 5}, "frame_id": "cam""#;
    let compressed = format!(r#"{{{time}, "format": "png", "data": "{}"}}"#, base64(&png));
    let raw = format!(
        r#"{{{time}, "width": 3, "height": 2, "encoding": "mono8", "step": 3, "data": "{}"}}"#,
        base64(&[50; 6])
    );
    let camera = format!(
        r#"{{{time}, "width": 3, "height": 2, "distortion_model": "", "D": [],
            "K": [5, 0, 1, 0, 6, 0.5, 0, 0, 1]}}"#
    );
    // as foxglove_msgs has it: a time, the frame, the file and its format
    let from_ros = cdr::to_vec(&(Time { sec: 3, nanosec: 5 }, "cam", png.clone(), "png")).unwrap();
    let mut file = Mcap::new();
    file.channel(1, "/cam/compressed", "foxglove.CompressedImage", "json");
    file.channel(2, "/cam/raw", "foxglove.RawImage", "json");
    file.channel(3, "/cam/camera_info", "foxglove.CameraCalibration", "json");
    file.channel(4, "/cam/ros", "foxglove_msgs/msg/CompressedImage", "cdr");
    file.message(1, 1, compressed.as_bytes());
    file.message(2, 1, raw.as_bytes());
    file.message(3, 1, camera.as_bytes());
    file.message(4, 1, &[&[0, 1, 0, 0], from_ros.as_slice()].concat());
    file.write(&path);
    for (topic, level) in [
        ("/cam/compressed", 77.0),
        ("/cam/raw", 50.0),
        ("/cam/ros", 77.0),
    ] {
        assert_eq!(shown(&path, Some(topic)), [(TIME_NS, level)], "{topic}");
    }
    let bag = Bag::open(&path).unwrap();
    let topic = bag.image_topic(Some("/cam/raw")).unwrap();
    let camera = bag.camera_of(topic).unwrap().unwrap();
    assert_eq!(camera.pinhole, Pinhole::new(5.0, 6.0, 1.0, 0.5));
}

#[test]
fn packets_of_a_video_are_given_as_they_are() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("video.mcap");
    let packet = [timestamp(), field(3, b"\0\0\0\x01\x67"), field(4, b"h264")].concat();
    let mut file = Mcap::new();
    file.channel(1, "/cam/video", "foxglove.CompressedVideo", "protobuf");
    file.message(1, 1, &packet);
    file.write(&path);
    let bag = Bag::open(&path).unwrap();
    let topic = bag.image_topic(None).unwrap();
    assert_eq!(topic.kind, TopicKind::CompressedVideo);
    let packet = bag.packets(topic).next().unwrap().unwrap();
    assert_eq!((packet.time_ns, packet.format.as_str()), (TIME_NS, "h264"));
    assert_eq!(packet.data, b"\0\0\0\x01\x67");
}

#[test]
fn what_is_there_is_said_with_its_types() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("other.mcap");
    let mut file = Mcap::new();
    file.channel(1, "/points", "foxglove.PointCloud", "protobuf");
    file.channel(2, "/chatter", "std_msgs/msg/String", "cdr");
    file.message(1, 1, &[]);
    file.message(2, 1, &[]);
    file.write(&path);
    let error = Bag::open(&path)
        .unwrap()
        .image_topic(None)
        .unwrap_err()
        .to_string();
    for said in [
        "/points (foxglove.PointCloud)",
        "/chatter (std_msgs/msg/String)",
    ] {
        assert!(error.contains(said), "{error}");
    }
}

/// A transform whose child lies one metre along an axis of its parent.
fn transform(parent: &str, child: &str, axis: usize) -> TransformStamped {
    let mut stamped = TransformStamped {
        child_frame_id: child.to_owned(),
        ..TransformStamped::default()
    };
    stamped.header.frame_id = parent.to_owned();
    let moved = &mut stamped.transform.translation;
    *[&mut moved.x, &mut moved.y, &mut moved.z][axis] = 1.0;
    stamped
}

fn reading(frame: &str, stamp_ns: i64, rate: f64, force: f64) -> Vec<u8> {
    let mut message = Imu::default();
    message.header.stamp = Time::from_nanoseconds(stamp_ns);
    message.header.frame_id = frame.to_owned();
    message.angular_velocity.x = rate;
    message.linear_acceleration.z = force;
    encoded(&message)
}

#[test]
fn inertial_readings_come_with_the_place_of_the_camera() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("inertial.mcap");
    let write = |with_transforms: bool| {
        let mut file = Mcap::new();
        file.channel(1, "/left/image", IMAGE, "cdr");
        let imu = "sensor_msgs/msg/Imu";
        file.channel(2, "/left/imu", imu, "cdr");
        file.channel(3, "/right/imu", imu, "cdr");
        file.channel(4, "/left/accel", imu, "cdr");
        file.channel(5, "/tf_static", "tf2_msgs/msg/TFMessage", "cdr");
        for k in 0..4 {
            file.message(1, 1, &encoded(&pixels(100 * k, 9)));
            file.message(2, 1, &reading("imu", 50 * k, 0.1, 9.8));
            file.message(3, 1, &reading("other", 50 * k, 0.2, 9.8));
            // a sensor of a sensor: it has no gyroscope
            file.message(4, 1, &reading("imu", 50 * k, 0.0, 9.8));
        }
        let transforms = vec![transform("base", "imu", 0), transform("base", "/camera", 1)];
        if with_transforms {
            file.message(5, 1, &encoded(&TFMessage { transforms }));
        }
        file.write(&path);
        Bag::open(&path).unwrap()
    };
    let bag = write(true);
    let images = bag.image_topic(None).unwrap();
    let readings = bag.readings(images, None).unwrap().unwrap();
    assert_eq!(readings.topic, "/left/imu");
    let times: Vec<i64> = readings.samples.iter().map(|s| s.timestamp_ns).collect();
    assert_eq!(times, [0, 50, 100, 150]);
    assert_eq!(readings.samples[0].angular_velocity.x, 0.1);
    let place: [f64; 3] = readings.imu_from_camera.unwrap().translation.into();
    assert_eq!(place, [-1.0, 1.0, 0.0]);
    let named = bag.readings(images, Some("/right/imu")).unwrap().unwrap();
    assert_eq!(named.samples[0].angular_velocity.x, 0.2);
    assert!(named.imu_from_camera.is_none());
    let error = bag.readings(images, Some("/imu")).unwrap_err().to_string();
    assert!(error.contains("/left/imu"), "{error}");
    let bag = write(false);
    let images = bag.image_topic(None).unwrap();
    let readings = bag.readings(images, None).unwrap().unwrap();
    assert!(readings.imu_from_camera.is_none());
    assert_eq!(readings.frames, ["imu", "camera"]);
}

#[test]
fn depth_beside_images_is_not_meant() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("depth.mcap");
    let mut file = Mcap::new();
    file.channel(1, "/cam/image", IMAGE, "cdr");
    let depth = "/cam/depth/compressedDepth";
    file.channel(2, depth, "sensor_msgs/msg/CompressedImage", "cdr");
    file.message(1, 1, &encoded(&pixels(4, 9)));
    let message = CompressedImage {
        header: Header::default(),
        format: "16UC1; compressedDepth png".to_owned(),
        data: vec![0; 20],
    };
    file.message(2, 1, &encoded(&message));
    file.write(&path);
    assert_eq!(shown(&path, None), [(4, 9.0)]);
    let bag = Bag::open(&path).unwrap();
    let mut images = bag.images(bag.image_topic(Some(depth)).unwrap());
    let error = images.next().unwrap().unwrap_err();
    assert!(
        error.is_single_frame() && error.to_string().contains("depth"),
        "{error}"
    );
}

#[test]
fn sixteen_bits_of_which_a_part_is_used_are_shown_by_the_first_images() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("deep.mcap");
    let mut file = Mcap::new();
    file.channel(1, "/plain", IMAGE, "cdr");
    file.channel(
        2,
        "/packed/compressed",
        "sensor_msgs/msg/CompressedImage",
        "cdr",
    );
    // a sensor of 12 bits; the tenth image is brighter than the first eight
    let word = |x: usize, k: i64| (if k < 10 { 400 * x } else { 60_000 }) as u16;
    for k in 0..11 {
        let words = (0..20).map(|at| word(at % 10, k));
        let image = Pixels {
            width: 10,
            height: 2,
            encoding: "mono16".to_owned(),
            step: 20,
            data: words.flat_map(u16::to_le_bytes).collect(),
            ..pixels(k, 0)
        };
        file.message(1, k as u64, &encoded(&image));
        let packed = CompressedImage {
            header: pixels(k, 0).header,
            format: "mono16; png compressed mono16".to_owned(),
            data: encode_png_16(&Image::from_fn(10, 2, |x, _| word(x, k))),
        };
        file.message(2, k as u64, &encoded(&packed));
    }
    file.write(&path);
    let bag = Bag::open(&path).unwrap();
    for name in ["/plain", "/packed/compressed"] {
        let topic = bag.image_topic(Some(name)).unwrap();
        assert_eq!(
            (bag.levels(topic).black, bag.levels(topic).white),
            (0.0, 4095.0)
        );
        let images: Vec<_> = bag.images(topic).map(|image| image.unwrap().1).collect();
        let expected = 255.0 * 1200.0 / 4095.0;
        assert!((images[9].at(3, 1) - expected).abs() < 0.01, "{name}");
        assert_eq!(images[10].at(3, 1), 255.0);
    }
}
