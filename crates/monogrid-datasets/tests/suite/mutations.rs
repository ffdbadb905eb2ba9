//! Valid files of every kind, damaged in the same thousands of ways at every run: readers return
//! an error or a usable value, never a panic, and never much more memory than the file has bytes.

use super::images::{bmp, colour, tiff_and_webp, wide_tiff};
use super::recording::recording_bytes;
use monogrid_datasets::{
    Calibration, DepthCalibration, ReadOptions, RecordingReader, ScansReader, decode_gray,
    parse_kitti, parse_seconds, parse_trajectory, read_response, read_sim3,
};
use std::io::Cursor;
use std::path::{Path, PathBuf};

/// Damaged copies of a file: changed bits and bytes, extreme numbers, cuts, repeated and removed
/// stretches; in text also words that are numbers and should not be.
pub fn mutations(file: &[u8], count: usize) -> Vec<Vec<u8>> {
    let words: [&[u8]; 8] = [
        b"nan",
        b"-inf",
        b"1e999",
        b"4294967295",
        b"-1",
        b"\n",
        b" ",
        b"99999999999999999999",
    ];
    let mut state = file.len() as u64 + 17;
    let mut below = move |limit: usize| {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (state >> 33) as usize % limit.max(1)
    };
    let mut damaged = vec![Vec::new(), file.to_vec()];
    for _ in 0..count {
        let mut bytes = file.to_vec();
        for _ in 0..=below(3) {
            let at = below(bytes.len());
            let end = (at + 1 + below(24)).min(bytes.len());
            match below(8) {
                _ if bytes.is_empty() => {}
                0 => bytes[at] ^= 1 << below(8),
                1 => bytes[at] = below(256) as u8,
                2 => bytes[at..end.min(at + 4)].fill(255),
                3 => bytes[at..end.min(at + 8)].fill(0),
                4 => drop(bytes.drain(at..end)),
                5 => bytes.truncate(at),
                6 => drop(bytes.splice(at..end, words[below(words.len())].iter().copied())),
                _ => {
                    let stretch = bytes[at..end].to_vec();
                    bytes.splice(at..at, stretch);
                }
            }
        }
        damaged.push(bytes);
    }
    damaged
}

/// Counts what was accepted and refused, so that a test cannot pass by trying nothing.
#[derive(Debug, Default)]
pub struct Tried {
    accepted: usize,
    refused: usize,
}

impl Tried {
    pub fn count<T, E: ToString>(&mut self, result: Result<T, E>) -> Option<T> {
        match result {
            Ok(value) => {
                self.accepted += 1;
                Some(value)
            }
            Err(error) => {
                assert!(!error.to_string().is_empty());
                self.refused += 1;
                None
            }
        }
    }

    pub fn assert_both(&self) {
        assert!(self.accepted > 0 && self.refused > 0, "{self:?}");
    }
}

fn path() -> &'static Path {
    Path::new("damaged")
}

#[test]
fn damaged_recordings_give_their_whole_records() {
    let file = recording_bytes();
    let mut tried = Tried::default();
    for bytes in mutations(&file, 1500) {
        for with_images in [false, true] {
            let input = Cursor::new(&bytes[..]);
            let reader = RecordingReader::new(input, path(), ReadOptions { with_images });
            if let Some(reader) = tried.count(reader) {
                // Every record takes bytes of the file, so that this ends.
                assert!(reader.count() <= bytes.len());
            }
        }
    }
    tried.assert_both();
}

#[test]
fn damaged_scans_are_errors_after_the_whole_ones() {
    let mut file = Vec::new();
    file.extend(0x4f47_4d31_u32.to_le_bytes());
    file.extend(2_u32.to_le_bytes());
    for scan in 0..2 {
        for value in [
            1.0,
            0.0,
            0.0,
            5.0,
            0.0,
            1.0,
            0.0,
            6.0,
            0.0,
            0.0,
            1.0,
            f64::from(scan),
        ] {
            file.extend(value.to_le_bytes());
        }
        file.extend(3_u32.to_le_bytes());
        for value in 0..12 {
            file.extend((value as f32).to_le_bytes());
        }
    }
    let mut tried = Tried::default();
    for bytes in mutations(&file, 2000) {
        let reader = ScansReader::new(&bytes[..], bytes.len() as u64, path());
        if let Some(reader) = tried.count(reader) {
            for scan in reader {
                if let Some(scan) = tried.count(scan) {
                    assert!(scan.points.len() * 16 <= bytes.len());
                }
            }
        }
    }
    tried.assert_both();
}

/// Calibrations of all kinds.
const CALIBRATIONS: &[(&str, &str)] = &[
    ("c.txt", "519.5 514.1 319.5 239.5 640 480\n"),
    (
        "c.txt",
        "519.5 514.1 319.5 239.5 -0.01 -0.03 0.0004 -0.001 640 480\n",
    ),
    ("c.txt", "0.5 0.6 0.49 0.51 0.9\n640 480\ncrop\n640 480\n"),
    (
        "c.txt",
        "Pinhole 0.5 0.6 0.49 0.51 0\n640 480\ncrop\n640 480\n",
    ),
    (
        "c.toml",
        "width = 640\nheight = 480\nfx = 519.5\nfy = 514.1\ncx = 319.5\ncy = 239.5\n\
                    model = \"equidistant\"\ndistortion = [0.1, 0.01, 0.0, 0.0]\n",
    ),
    (
        "c.yaml",
        "sensor_type: camera\nresolution: [752, 480]\ncamera_model: pinhole\n\
                    intrinsics: [458.654, 457.296, 367.215, 248.375]\n\
                    distortion_model: radial-tangential\n\
                    distortion_coefficients: [-0.28, 0.07, 0.0002, 0.00002]\n",
    ),
    (
        "c.yaml",
        "image_width: 640\nimage_height: 480\ndistortion_model: plumb_bob\ncamera_matrix:\n  rows: \
         3\n  cols: 3\n  data: [500, 0, 320, 0, 500, 240, 0, 0, 1]\ndistortion_coefficients:\n  \
         rows: 1\n  cols: 5\n  data: [0.1, 0, 0, 0, 0]\n",
    ),
    (
        "c.xml",
        "<?xml version=\"1.0\"?>\n<opencv_storage>\n<image_width>640</image_width>\n\
         <image_height>480</image_height>\n<fisheye_model>1</fisheye_model>\n<camera_matrix \
         type_id=\"opencv-matrix\">\n<rows>3</rows><cols>3</cols>\n<data>500. 0. 320. 0. 500. 240. \
         0. 0. 1.</data></camera_matrix>\n<distortion_coefficients>\n<data>0.1 0. 0. \
         0.</data></distortion_coefficients>\n</opencv_storage>\n",
    ),
    (
        "ost.txt",
        "# oST\n[image]\nwidth\n640\nheight\n480\n[camera]\ncamera matrix\n500 0 320\n0 500 240\n0 \
         0 1\ndistortion\n0.1 0.2 0.001 0.002 0.3 0.4 0.5 0.6\n",
    ),
    (
        "c.yaml",
        "model_type: MEI\nimage_width: 640\nimage_height: 480\nmirror_parameters:\n   xi: 1.8\n\
         distortion_parameters:\n   k1: -0.1\n   k2: 0.4\n   p1: 0.0003\n   p2: 0.0004\n\
         projection_parameters:\n   gamma1: 900\n   gamma2: 901\n   u0: 320\n   v0: 240\n",
    ),
    (
        "c.yaml",
        "cam0: {camera_model: ds, intrinsics: [-0.2, 0.6, 300, 300, 320, 240],\
         \n  resolution: [640, 480]}\n\
         cam1:\n  intrinsics:\n  - 1\n  - 2\n",
    ),
    (
        "c.json",
        r#"{"value0": {"intrinsics": [{"camera_type": "eucm", "intrinsics": {"fx": 300, "fy": 300,
            "cx": 320, "cy": 240, "alpha": 0.6, "beta": 1.1}}], "resolution": [[640, 480]]}}"#,
    ),
    (
        "cameras.txt",
        "1 PINHOLE 1280 720 900 900 640 360\n2 RADIAL_FISHEYE 640 480 300 320 240 0.01 0.002\n",
    ),
    (
        "calib_cam_to_cam.txt",
        "calib_time: 09-Jan-2012 13:57:47\nS_00: 640 480\nK_00: 500 0 320 0 500 240 0 0 1\nD_00: \
         0.1 0.2 0.001 0.002 0.3\nS_rect_00: 620 460\nP_rect_00: 500 0 310 0 0 500 230 0 0 0 1 0\n",
    ),
    (
        "calib.txt",
        "P0: 700 0 600 0 0 700 180 0 0 0 1 0\nP1: 700 0 600 -300 0 700 180 0 0 0 1 0\n",
    ),
];

#[test]
fn damaged_calibrations_are_those_of_a_real_camera_or_errors() {
    for (name, text) in CALIBRATIONS {
        let mut tried = Tried::default();
        for bytes in mutations(text.as_bytes(), 600) {
            let text = String::from_utf8_lossy(&bytes);
            let read = Calibration::parse(&text, Path::new(name), Some((640, 480)));
            if let Some(calibration) = tried.count(read) {
                let camera = calibration.camera;
                assert!(
                    camera.pinhole.fx.is_finite() && camera.pinhole.fx > 0.0,
                    "{text}"
                );
                assert!(camera.width > 0 && camera.height > 0);
            }
        }
        tried.assert_both();
    }
}

#[test]
fn damaged_images_of_other_formats_are_images_or_errors() {
    let wide: Vec<u16> = (0..24 * 17).map(|k| 160 * k).collect();
    let [tiff, webp] = tiff_and_webp(&colour(24, 17));
    let bmps = [8, 24, 32].map(|bits| bmp(&colour(24, 17), bits, false));
    for file in [wide_tiff(24, 17, &wide), tiff, webp]
        .into_iter()
        .chain(bmps)
    {
        let mut tried = Tried::default();
        for bytes in mutations(&file, 1500) {
            if let Some(image) = tried.count(decode_gray(&bytes, path())) {
                let is_grey = |value: &f32| (0.0..=255.0).contains(value);
                assert!(image.as_slice().iter().all(is_grey));
            }
        }
        tried.assert_both();
    }
}

#[test]
fn damaged_poses_are_finite_or_errors() {
    let trajectories = [
        "# time\n0.1 0 0 0 0 0 0 1\n0.2 1 2 3 0.5 0.5 0.5 0.5\n0.3 1 2 3 0 0 0.7071 0.7071\n",
        "#timestamp [ns],p_x,p_y,p_z,q_w,q_x,q_y,q_z\n1403715273262142976,1,2,3,1,0,0,0\n\
         1403715273312143104,1,2,3,0.7,0.7,0.1,0\n",
    ];
    for text in trajectories {
        let mut tried = Tried::default();
        for bytes in mutations(text.as_bytes(), 1000) {
            let text = String::from_utf8_lossy(&bytes);
            if let Some(poses) = tried.count(parse_trajectory(&text, path())) {
                assert!(
                    poses.iter().all(|p| p.world_from_camera.is_finite()),
                    "{text}"
                );
            }
            for word in text.split_whitespace() {
                let _ = parse_seconds(word);
            }
        }
        tried.assert_both();
    }
    let kitti = "1 0 0 1 0 1 0 2 0 0 1 3\n0 -1 0 1 1 0 0 2 0 0 1 3\n";
    let mut tried = Tried::default();
    for bytes in mutations(kitti.as_bytes(), 1000) {
        let text = String::from_utf8_lossy(&bytes);
        if let Some(poses) = tried.count(parse_kitti(&text, &[0, 1], path())) {
            assert!(
                poses.iter().all(|p| p.world_from_camera.is_finite()),
                "{text}"
            );
        }
    }
    tried.assert_both();
}

/// Reads damaged copies through a file, for readers that take no bytes.
fn through_files<T, E: ToString>(
    name: &str,
    content: &[u8],
    count: usize,
    read: impl Fn(&Path) -> Result<T, E>,
    check: impl Fn(T, usize),
) {
    let folder = tempfile::tempdir().expect("folder");
    let path: PathBuf = folder.path().join(name);
    let mut tried = Tried::default();
    for bytes in mutations(content, count) {
        std::fs::write(&path, &bytes).expect("writable");
        if let Some(value) = tried.count(read(&path)) {
            check(value, bytes.len());
        }
    }
    tried.assert_both();
}

#[test]
fn other_damaged_text_files_are_usable_or_errors() {
    let camera = b"585 585 320 240 640 480\n1000\n0.025 0 0 0 0 0 1\n";
    through_files(
        "d.txt",
        camera,
        800,
        DepthCalibration::read,
        |calibration, _| {
            assert!(calibration.units_per_metre > 0.0 && calibration.colour_from_depth.is_finite());
        },
    );
    let sim3 = b"1.5 1 2 3 0 0 0.6 0.8\n";
    through_files("s.txt", sim3, 800, read_sim3, |sim3, _| {
        assert!(sim3.scale > 0.0 && sim3.scale.is_finite());
        assert!(sim3.translation.iter().all(|t| t.is_finite()));
    });
    let response: String = (0..256).map(|i| format!("{i} ")).collect();
    through_files(
        "pcalib.txt",
        response.as_bytes(),
        400,
        read_response,
        |values, _| {
            assert!(values.len() == 256 && values.iter().all(|v| v.is_finite()));
        },
    );
}
