//! Recordings that another program wrote: `data/write.py` made them with the package `rosbags`.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use monogrid_bags::convert::info_of;
use monogrid_bags::{Bag, McapWriter, TopicKind, is_bag};
use monogrid_datasets::encode_png;
use monogrid_geometry::{Distortion, Pinhole};
use monogrid_image::Image;
use monogrid_messages::builtin_interfaces::Time;
use monogrid_messages::diagnostic_msgs::DiagnosticArray;
use monogrid_messages::sensor_msgs::CompressedImage;
use monogrid_messages::std_msgs::Header;
use std::fs;
use std::path::{Path, PathBuf};

const RECORDINGS: [&str; 6] = [
    "plain.mcap",
    "zstd.mcap",
    "plain.db3",
    "plain.bag",
    "bz2.bag",
    "lz4.bag",
];

const FRAMES: usize = 8;

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/data")
        .join(name)
}

fn assert_whole(path: &Path, rounds: usize) {
    assert!(is_bag(path));
    let bag = Bag::open(path).unwrap();
    let kinds: Vec<_> = bag
        .topics()
        .iter()
        .map(|topic| (topic.name.as_str(), topic.kind))
        .collect();
    let expected = [
        ("/camera/camera_info", TopicKind::CameraInfo),
        ("/camera/image_raw", TopicKind::Image),
        ("/chatter", TopicKind::Other),
    ];
    assert_eq!(kinds, expected, "{}", path.display());
    let topic = bag.image_topic(None).unwrap();
    assert_eq!(bag.image_topic(Some("/camera/image_raw")).unwrap(), topic);
    let camera = bag.camera_of(topic).unwrap().unwrap();
    assert_eq!((camera.width, camera.height), (80, 60));
    assert_eq!(camera.pinhole, Pinhole::new(60.0, 61.0, 39.5, 29.5));
    let distortion = Distortion::RadialTangential {
        k1: 0.1,
        k2: -0.2,
        p1: 0.001,
        p2: 0.002,
        k3: 0.0,
    };
    assert_eq!(camera.distortion, distortion);

    let images: Vec<_> = bag.images(topic).collect::<Result<_, _>>().unwrap();
    assert_eq!(images.len(), FRAMES * rounds);
    for (k, (time_ns, image)) in images.iter().enumerate() {
        let k = k % FRAMES;
        // when it was taken, not when it was recorded
        assert_eq!(*time_ns, 1_700_000_000_000_000_000 + 100_000_000 * k as i64);
        assert_eq!((image.width(), image.height()), (80, 60));
        for (x, y) in [(0, 0), (79, 0), (11, 37), (79, 59)] {
            assert_eq!(image.at(x, y), ((x * 7 + y * 13 + 3 * k) % 251) as f32);
        }
    }
}

#[test]
fn every_format_gives_images_times_and_camera() {
    for name in RECORDINGS {
        assert_whole(&data(name), 1);
    }
}

#[test]
fn a_folder_is_read_part_by_part() {
    let folder = tempfile::tempdir().unwrap();
    assert!(!is_bag(folder.path()));
    for part in ["drive_2.mcap", "drive_10.mcap", "walk.mcap"] {
        fs::copy(data("zstd.mcap"), folder.path().join(part)).unwrap();
    }
    assert!(!is_bag(folder.path()), "a folder of files is no recording");
    fs::remove_file(folder.path().join("walk.mcap")).unwrap();
    fs::write(
        folder.path().join("metadata.yaml"),
        "rosbag2_bagfile_information:\n",
    )
    .unwrap();
    assert_whole(folder.path(), 2);
}

#[test]
fn what_is_asked_for_and_not_there_is_said_with_what_there_is() {
    let bag = Bag::open(&data("plain.mcap")).unwrap();
    let error = bag
        .image_topic(Some("/left/image"))
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("/left/image") && error.contains("/camera/image_raw"),
        "{error}"
    );
    let error = Bag::open(&data("write.py")).unwrap_err().to_string();
    assert!(
        error.contains("write.py") && error.contains(".mcap"),
        "{error}"
    );
    assert!(!is_bag(&data("write.py")) && !is_bag(&data("not there")));
    let folder = tempfile::tempdir().unwrap();
    let open = folder.path().join("open.db3");
    fs::copy(data("plain.db3"), &open).unwrap();
    fs::write(folder.path().join("open.db3-wal"), "pages").unwrap();
    let error = Bag::open(&open).unwrap_err().to_string();
    assert!(error.contains("-wal"), "{error}");
}

/// Reads everything; how many images there were before the first error.
fn images_of(path: &Path) -> usize {
    let Ok(bag) = Bag::open(path) else {
        return 0;
    };
    let Ok(topic) = bag.image_topic(None) else {
        return 0;
    };
    let images = bag.images(topic);
    images.take(1000).take_while(Result::is_ok).count()
}

#[test]
fn damage_is_an_error_and_what_comes_before_it_is_read() {
    let folder = tempfile::tempdir().unwrap();
    for name in RECORDINGS {
        let whole = fs::read(data(name)).unwrap();
        let path = folder.path().join(name);
        let mut most = 0;
        for part in 0..40 {
            fs::write(&path, &whole[..whole.len() * part / 40]).unwrap();
            most = most.max(images_of(&path));
        }
        assert!(most <= FRAMES, "{name}");
        assert!(
            most > 0 || name.starts_with("zstd") || name.starts_with("bz2"),
            "{name}"
        );
        let mut seed = 1_u32;
        for _ in 0..100 {
            let mut damaged = whole.clone();
            for _ in 0..4 {
                seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                let at = seed as usize % damaged.len();
                damaged[at] = (seed >> 24) as u8;
            }
            fs::write(&path, &damaged).unwrap();
            assert!(images_of(&path) <= 2 * FRAMES, "{name}");
        }
    }
}

#[test]
fn what_is_written_is_read_again() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("written.mcap");
    let mut writer = McapWriter::new(fs::File::create(&path).unwrap(), "a test").unwrap();
    let pinhole = Pinhole::new(60.0, 61.0, 3.5, 2.5);
    for k in 0..3u8 {
        let time_ns = 1_000_000_000 + i64::from(k);
        let header = Header {
            stamp: Time::from_nanoseconds(time_ns),
            frame_id: "camera".to_owned(),
        };
        let info = info_of(header.clone(), &pinhole, (8, 6));
        writer.write("/camera/camera_info", time_ns, &info).unwrap();
        let image = Image::from_fn(8, 6, |x, y| (x + 10 * y) as u8 + k);
        let message = CompressedImage {
            header,
            format: "png".to_owned(),
            data: encode_png(&image),
        };
        writer.write("/camera/image", time_ns, &message).unwrap();
    }
    // readers would not know what it is
    let unknown = writer.write("/other", 0, &DiagnosticArray::default());
    assert!(unknown.unwrap_err().to_string().contains("definition"));
    writer.finish().unwrap();

    let bag = Bag::open(&path).unwrap();
    let topic = bag.image_topic(None).unwrap();
    let camera = bag.camera_of(topic).unwrap().unwrap();
    assert_eq!((camera.pinhole, camera.width), (pinhole, 8));
    let images = bag.images(topic).map(Result::unwrap);
    for (k, (time_ns, image)) in images.enumerate() {
        assert_eq!(time_ns, 1_000_000_000 + k as i64);
        assert_eq!(image.at(3, 2), (23 + k) as f32);
    }
}
