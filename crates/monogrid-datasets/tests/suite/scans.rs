//! Scan files.

use monogrid_datasets::{Scan, ScanPoint, ScansReader};
use proptest::prelude::*;
use std::path::Path;

fn scan(i: usize, count: usize) -> Scan {
    let mut world_from_sensor = [0.0; 12];
    for (k, v) in world_from_sensor.iter_mut().enumerate() {
        *v = (i * 12 + k) as f64 * 0.25;
    }
    Scan {
        world_from_sensor,
        points: (0..count)
            .map(|k| ScanPoint {
                point_in_sensor: [k as f32, -(k as f32), 1.0 + i as f32],
                range_sigma: 0.02,
            })
            .collect(),
    }
}

fn encode(scans: &[Scan]) -> Vec<u8> {
    let mut bytes = 0x4f47_4d31u32.to_le_bytes().to_vec();
    bytes.extend_from_slice(&(scans.len() as u32).to_le_bytes());
    for scan in scans {
        bytes.extend(scan.world_from_sensor.iter().flat_map(|v| v.to_le_bytes()));
        bytes.extend_from_slice(&(scan.points.len() as u32).to_le_bytes());
        for p in &scan.points {
            bytes.extend(p.point_in_sensor.iter().flat_map(|v| v.to_le_bytes()));
            bytes.extend_from_slice(&p.range_sigma.to_le_bytes());
        }
    }
    bytes
}

fn read(bytes: &[u8]) -> Result<Vec<Scan>, String> {
    let path = Path::new("room.scans");
    ScansReader::new(bytes, bytes.len() as u64, path)
        .and_then(|reader| reader.collect::<Result<Vec<_>, _>>())
        .map_err(|e| e.to_string())
}

#[test]
fn scans_are_read_as_written() {
    let scans = [scan(0, 5), scan(1, 0), scan(2, 70)];
    let bytes = encode(&scans);
    assert_eq!(read(&bytes).expect("whole"), scans);
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("room.scans");
    std::fs::write(&path, &bytes).expect("writable");
    let reader = ScansReader::open(&path).expect("opens");
    assert_eq!(reader.map(|s| s.expect("whole")).collect::<Vec<_>>(), scans);
}

#[test]
fn truncated_anywhere_it_is_an_error_after_the_whole_scans() {
    let scans = [scan(0, 3), scan(1, 4)];
    let bytes = encode(&scans);
    for length in 0..bytes.len() {
        let error = read(&bytes[..length]).expect_err("truncated");
        assert!(error.contains("room.scans"), "{error}");
    }
    let length = bytes.len() - 1;
    let reader =
        ScansReader::new(&bytes[..length], length as u64, Path::new("x")).expect("header is whole");
    let outcomes: Vec<bool> = reader.map(|s| s.is_ok()).collect();
    assert_eq!(outcomes, [true, false]);
}

#[test]
fn announced_sizes_are_not_believed() {
    let mut many_scans = encode(&[scan(0, 1)]);
    many_scans[4..8].copy_from_slice(&u32::MAX.to_le_bytes());
    let mut many_points = encode(&[scan(0, 1)]);
    many_points[8 + 96..8 + 100].copy_from_slice(&u32::MAX.to_le_bytes());
    let mut not_finite = encode(&[scan(0, 1)]);
    not_finite[8..16].copy_from_slice(&f64::NAN.to_le_bytes());
    for bytes in [
        many_scans,
        many_points,
        not_finite,
        b"PLY".to_vec(),
        b"01234567".to_vec(),
    ] {
        assert!(read(&bytes).is_err());
    }
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 200,
        failure_persistence: None,
        ..Default::default()
    })]

    #[test]
    fn corruption_never_panics(
        index in any::<prop::sample::Index>(),
        value in any::<u8>(),
    ) {
        let mut bytes = encode(&[scan(0, 3), scan(1, 4)]);
        let i = index.index(bytes.len());
        bytes[i] = value;
        let _ = read(&bytes);
    }
}
