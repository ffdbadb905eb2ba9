//! `.mgo` files: exact, checked, and safe against any bytes.
#![allow(clippy::unwrap_used, reason = "a test fails where it unwraps")]

use crate::common::{Random, mutations};
use monogrid_occupancy::*;

const BUDGET: usize = 64 << 20;

fn file_of(map: &OccupancyMap) -> Vec<u8> {
    let mut bytes = Vec::new();
    write_mgo(map, &mut bytes).unwrap();
    bytes
}

/// Values of every kind, bricks on both sides of the origin and at the ends of the address range.
fn map_of_everything(seed: u64, cells: usize) -> OccupancyMap {
    let mut random = Random(seed);
    let mut map = OccupancyMap::new(MapConfig {
        resolution: 0.1 + 1e-17,
        clamp_min: -1.7,
        clamp_max: 4.3,
        occupancy_threshold: 0.6,
        memory_budget_bytes: BUDGET,
    })
    .unwrap();
    for z in -8..16 {
        for y in -8..8 {
            for x in 0..8 {
                map.set_log_odds(VoxelKey::new(x, y, z), Some(-1.7))
                    .unwrap();
            }
        }
    }
    for i in 0..cells {
        let key = VoxelKey::from_array([0; 3].map(|_| random.between(-60.0, 60.0) as i32));
        let value = match i % 5 {
            0 => None,
            1 => Some(4.3),
            // Beyond the clamps, and the ends of what is storable.
            2 => Some(random.between(-9.0, 9.0) as f32),
            _ => Some(random.between(-1.7, 4.3) as f32),
        };
        map.set_log_odds(key, value).unwrap();
    }
    let end = (1 << 23) - 1;
    for key in [[-end - 1, end, 0], [end, -end - 1, end], [0, 0, end]] {
        map.set_log_odds(VoxelKey::from_array(key), Some(0.25))
            .unwrap();
    }
    map
}

#[test]
fn every_bit_of_a_map_comes_back() {
    for (seed, cells) in [(1, 0), (2, 50), (3, 30_000)] {
        let map = map_of_everything(seed, cells);
        let bytes = file_of(&map);
        let again = read_mgo(&bytes[..], BUDGET).unwrap();
        assert!(again == map, "cells of map {seed}");
        assert_eq!(again.config(), map.config());
        assert_eq!(file_of(&again), bytes, "and the same file again");
        assert_eq!(again.bricks_changed_since(0), again.bricks());
    }
}

#[test]
fn noise_is_stored_in_little_more_than_its_own_size() {
    let mut random = Random(4);
    let mut map = OccupancyMap::new(MapConfig::default()).unwrap();
    for brick in 0..8 {
        for index in 0..512 {
            let key = BrickKey::new(brick % 2, brick / 2 % 2, brick / 4).cell(index);
            map.set_log_odds(key, Some(random.between(-7.9, 7.9) as f32))
                .unwrap();
        }
    }
    let bytes = file_of(&map);
    assert!(read_mgo(&bytes[..], BUDGET).unwrap() == map);
    assert!(bytes.len() < 8 * 512 * 2 * 115 / 100, "{}", bytes.len());
}

#[test]
fn empty_maps_keep_their_settings() {
    let map = OccupancyMap::new(MapConfig::with_resolution(0.02)).unwrap();
    let again = read_mgo(&file_of(&map)[..], BUDGET).unwrap();
    assert!(again.is_empty());
    assert_eq!(again.resolution(), 0.02);
}

#[test]
fn every_truncation_and_every_changed_bit_is_found() {
    let bytes = file_of(&map_of_everything(5, 300));
    for end in (0..bytes.len())
        .step_by(7)
        .chain(bytes.len() - 1..bytes.len())
    {
        assert!(read_mgo(&bytes[..end], BUDGET).is_err(), "cut at {end}");
    }
    for at in (0..bytes.len()).step_by(3).chain(0..200) {
        let mut damaged = bytes.clone();
        damaged[at] ^= 1 << (at % 8);
        assert!(read_mgo(&damaged[..], BUDGET).is_err(), "changed at {at}");
    }
}

/// Makes the checksums right again, so that what lies behind them is tried too.
fn with_valid_checksums(mut bytes: Vec<u8>) -> Vec<u8> {
    let word = |bytes: &[u8], at: usize| {
        bytes
            .get(at..at + 4)
            .map(|b| u32::from_le_bytes(b.try_into().unwrap()))
    };
    let put = |bytes: &mut [u8], at: usize, value: u32| {
        bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
    };
    if bytes.len() >= 56 {
        let crc = crc32fast::hash(&bytes[..52]);
        put(&mut bytes, 52, crc);
    }
    let mut at = 56;
    while let Some(size) = word(&bytes, at + 4) {
        let start = at + 16;
        if start > bytes.len() {
            break;
        }
        let end = (start + size as usize).min(bytes.len());
        let crc = crc32fast::hash(&bytes[start..end]);
        put(&mut bytes, at + 8, crc);
        let crc = crc32fast::hash(&bytes[at..at + 12]);
        put(&mut bytes, at + 12, crc);
        at = end.max(at + 16);
    }
    bytes
}

#[test]
fn mutations_with_valid_checksums_give_errors_or_maps_within_the_budget() {
    let file = file_of(&map_of_everything(6, 200));
    let (mut errors, mut maps) = (0, 0);
    for bytes in mutations(&file, 400) {
        match read_mgo(&with_valid_checksums(bytes)[..], BUDGET) {
            Ok(map) => {
                assert!(map.bytes_in_memory() <= BUDGET);
                maps += 1;
            }
            Err(error) => {
                assert!(!error.to_string().is_empty());
                errors += 1;
            }
        }
    }
    assert!(
        errors > 20 && maps > 20,
        "{errors} errors, {maps} maps: both sides are tried"
    );
}

#[test]
fn a_map_that_does_not_fit_the_budget_is_refused() {
    let bytes = file_of(&map_of_everything(7, 2000));
    assert!(matches!(
        read_mgo(&bytes[..], 200_000),
        Err(MapError::MemoryBudget { .. })
    ));
}

#[test]
fn errors_say_what_was_found() {
    let file = file_of(&map_of_everything(8, 10));
    let mut newer = file.clone();
    newer[8] = 2;
    for (bytes, wanted) in [
        (
            b"# Octomap OcTree file\nid OcTree\n0123456789012345678901234567890".to_vec(),
            "# Octoma",
        ),
        (newer, "version 2"),
        (file[..60].to_vec(), "ends before"),
    ] {
        let message = read_mgo(&bytes[..], BUDGET).unwrap_err().to_string();
        assert!(
            message.contains(wanted),
            "{message:?} should say {wanted:?}"
        );
    }
}
