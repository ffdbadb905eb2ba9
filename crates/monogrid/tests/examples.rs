//! The example programs of the first page: short, and they make the maps that they promise.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use monogrid::datasets::{Dataset, SourceOptions, read_gray};
use monogrid::occupancy::read_map;
use monogrid_worlds::{SynthSequence, WriteConfig, write_tum_layout};
use std::fs;
use std::io::{BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::OnceLock;

/// Most lines of an example.
const MAX_LINES: usize = 25;

/// An example program, which `cargo test` builds beside the tests.
fn example(name: &str) -> Command {
    let test = std::env::current_exe().unwrap();
    let folder = test.parent().and_then(Path::parent).unwrap();
    let program = folder
        .join("examples")
        .join(format!("{name}{}", std::env::consts::EXE_SUFFIX));
    assert!(
        program.exists(),
        "{} is missing: cargo build -p monogrid --examples",
        program.display()
    );
    Command::new(program)
}

fn assert_mapped(output: &Output, map: &Path) {
    let error = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{error}");
    let file = BufReader::new(fs::File::open(map).unwrap());
    let (map, _) = read_map(file, u64::MAX).unwrap();
    assert!(map.cell_counts().occupied > 800, "{:?}", map.cell_counts());
}

/// A short video of the built-in room at 320x240 with exact truth, written once.
fn small_sequence() -> &'static Path {
    static FOLDER: OnceLock<tempfile::TempDir> = OnceLock::new();
    let folder = FOLDER.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let sequence = SynthSequence::small_demo().unwrap().shortened(150);
        let config = WriteConfig {
            depth_every: 5,
            with_mesh: false,
            ..WriteConfig::default()
        };
        write_tum_layout(&sequence, folder.path(), &config, |_| {}).unwrap();
        folder
    });
    folder.path()
}

/// A scan file with a wall of points two metres ahead of a sensor one metre above the origin.
fn write_scans(path: &Path) {
    let mut out = Vec::new();
    out.extend(0x4f47_4d31_u32.to_le_bytes());
    out.extend(1_u32.to_le_bytes());
    // world_from_sensor: sensor z is world x, sensor x is world -y, sensor y is world -z
    let pose: [f64; 12] = [0.0, 0.0, 1.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0];
    for value in pose {
        out.extend(value.to_le_bytes());
    }
    let points: Vec<[f32; 4]> = (-40..=40)
        .flat_map(|x| (-40..=40).map(move |y| (x, y)))
        .map(|(x, y)| [x as f32 * 0.02, y as f32 * 0.02, 2.02, 0.02])
        .collect();
    out.extend((points.len() as u32).to_le_bytes());
    for value in points.into_iter().flatten() {
        out.extend(value.to_le_bytes());
    }
    fs::write(path, out).unwrap();
}

/// Images of the small sequence one after the other, as they are piped by others.
fn raw_rgb(sequence: &Path) -> Vec<u8> {
    let dataset = Dataset::open(sequence, SourceOptions::default()).unwrap();
    let images = dataset
        .frames
        .iter()
        .map(|frame| read_gray(&frame.path).unwrap());
    images
        .flat_map(|image| {
            image
                .as_slice()
                .iter()
                .flat_map(|v| [*v as u8; 3])
                .collect::<Vec<_>>()
        })
        .collect()
}

#[test]
fn examples_fit_on_a_page() {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("examples");
    let mut names: Vec<_> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    names.sort();
    assert_eq!(names.len(), 4);
    for path in names {
        let lines = fs::read_to_string(&path).unwrap().lines().count();
        assert!(lines <= MAX_LINES, "{} has {lines} lines", path.display());
    }
}

#[test]
fn a_camera_and_own_images_become_maps() {
    let dir = tempfile::tempdir().unwrap();
    let sequence = small_sequence();
    let calibration = sequence.join("calibration.txt");
    let (video, map) = (dir.path().join("a.y4m"), dir.path().join("a.ot"));
    let rgb = raw_rgb(sequence);
    let mut file = fs::File::create(&video).unwrap();
    file.write_all(b"YUV4MPEG2 W320 H240 F30:1 Cmono\n")
        .unwrap();
    for frame in rgb.chunks(3 * 320 * 240) {
        file.write_all(b"FRAME\n").unwrap();
        file.write_all(&frame.iter().copied().step_by(3).collect::<Vec<_>>())
            .unwrap();
    }
    drop(file);
    let output = example("camera")
        .arg(&video)
        .arg(&calibration)
        .arg(&map)
        .output()
        .unwrap();
    assert_mapped(&output, &map);
    assert!(
        String::from_utf8_lossy(&output.stdout).contains("Good Some("),
        "poses"
    );

    let map = dir.path().join("b.bt");
    let mut child = example("own_images");
    child.arg(&calibration).arg("30").arg(&map);
    let mut child = child
        .stdin(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    child.stdin.take().unwrap().write_all(&rgb).unwrap();
    assert_mapped(&child.wait_with_output().unwrap(), &map);
}

#[test]
fn scans_and_depth_images_become_maps() {
    let dir = tempfile::tempdir().unwrap();
    let (scans, map) = (dir.path().join("wall.scans"), dir.path().join("wall.ot"));
    write_scans(&scans);
    let output = example("lidar_scans")
        .arg(&scans)
        .arg(&map)
        .output()
        .unwrap();
    assert_mapped(&output, &map);

    let (folder, map) = (small_sequence(), dir.path().join("depth.ot"));
    let mut command = example("depth_and_poses");
    command.arg(folder).arg(folder.join("calibration.txt"));
    let output = command
        .arg(folder.join("groundtruth.txt"))
        .arg(&map)
        .output()
        .unwrap();
    assert_mapped(&output, &map);
}
