//! Packed maps are the same maps in less memory.
#![allow(clippy::unwrap_used, reason = "a test fails where it unwraps")]

use crate::common::{Random, room_scan};
use monogrid_occupancy::*;

fn configs() -> [IntegrationConfig; 2] {
    [IntegrationRule::Rays, IntegrationRule::Fused].map(|rule| IntegrationConfig {
        rule,
        ..IntegrationConfig::default()
    })
}

#[test]
fn a_map_packed_between_scans_grows_into_the_same_map() {
    for config in configs() {
        let mut random = Random(11);
        let mut plain = OccupancyMap::new(MapConfig::with_resolution(0.06)).unwrap();
        let mut packed = plain.clone();
        for id in 0..6 {
            let scan = room_scan(&mut random, id, 1500, 2.0);
            integrate(&mut plain, &scan.borrow(), &config, 1).unwrap();
            integrate(&mut packed, &scan.borrow(), &config, 2).unwrap();
            if id % 2 == 0 {
                packed.pack(1 + id as usize);
                assert_eq!(packed.brick_counts(), plain.brick_counts());
                assert!(packed.bytes_in_memory() < plain.bytes_in_memory() * 7 / 10);
            }
            assert!(packed == plain, "scan {id}");
        }
        packed.pack(1);

        // Single cells, merged maps and everything that is asked.
        for _ in 0..300 {
            let key = VoxelKey::from_array([0; 3].map(|_| random.between(-30.0, 30.0) as i32));
            let change = random.between(-1.0, 1.0) as f32;
            plain.add_log_odds(key, change).unwrap();
            packed.add_log_odds(key, change).unwrap();
        }
        packed.pack(1);
        let snapshots = [Snapshot::new(&plain), Snapshot::new(&packed)];
        for _ in 0..3000 {
            let point = [0; 3].map(|_| random.between(-2.2, 2.2));
            let direction = [0; 3].map(|_| random.between(-1.0, 1.0));
            let unknown = UnknownCells::PassThrough;
            assert_eq!(plain.log_odds(point), packed.log_odds(point));
            assert_eq!(snapshots[0].state(point), snapshots[1].state(point));
            assert_eq!(
                plain.cast_ray(point, direction, 5.0, unknown),
                packed.cast_ray(point, direction, 5.0, unknown)
            );
            assert_eq!(
                plain.sphere_collides(point, 0.2, unknown),
                packed.sphere_collides(point, 0.2, unknown)
            );
        }
        assert_eq!(plain.cell_counts(), packed.cell_counts());
        assert_eq!(plain.key_bounds(), packed.key_bounds());
        assert!(plain.cells().eq(packed.cells()));
        let crop = |map: &OccupancyMap| map.cropped([-1.0; 3], [0.7; 3]).unwrap();
        assert!(crop(&plain) == crop(&packed));
        let part = crop(&plain);
        plain.merge(&part).unwrap();
        packed.merge(&part).unwrap();
        assert!(plain == packed);
    }
}

#[test]
fn a_map_that_reaches_its_budget_packs_itself_and_goes_on() {
    for config in configs() {
        let grown = |memory_budget_bytes: usize| {
            let mut random = Random(5);
            let mut map = OccupancyMap::new(MapConfig {
                resolution: 0.06,
                memory_budget_bytes,
                ..MapConfig::default()
            })
            .unwrap();
            for id in 0..24 {
                // Rooms far from each other: each scan has bricks of its own.
                let mut scan = room_scan(&mut random, id, 1500, 2.0);
                scan.pose.translation[0] += 20.0 * f64::from(id);
                integrate(&mut map, &scan.borrow(), &config, 2)?;
            }
            Ok(map)
        };
        let plain: OccupancyMap = grown(1 << 30).unwrap();
        let budget = plain.bytes_in_memory() * 3 / 4;
        let packed = grown(budget).unwrap();
        assert!(packed.bytes_in_memory() <= budget);
        assert!(plain == packed);
        let error: MapError = grown(budget / 3).unwrap_err();
        assert!(matches!(error, MapError::MemoryBudget { .. }), "{error}");
    }
}

#[test]
fn writing_single_cells_stops_at_the_memory_budget() {
    let memory_budget_bytes = 4_000_000;
    let mut map = OccupancyMap::new(MapConfig {
        memory_budget_bytes,
        ..MapConfig::with_resolution(0.1)
    })
    .unwrap();
    // one cell per brick
    let refused = (0..100_000).find_map(|brick| {
        let key = VoxelKey::new(8 * brick, 0, 0);
        let result = match brick % 2 {
            0 => map.set_log_odds(key, Some(1.0)),
            _ => map.add_log_odds(key, 1.0),
        };
        result.err().map(|error| (key, error))
    });
    let (key, error) = refused.unwrap();
    assert!(matches!(error, MapError::MemoryBudget { .. }), "{error}");
    // the last write may have enlarged one of the 64 parts of the map more than one brick needs
    let bytes = map.bytes_in_memory();
    assert!(
        bytes <= memory_budget_bytes + memory_budget_bytes / 16,
        "{bytes}"
    );
    assert!(key.x > 8 * 1000 && map.log_odds_of(key).is_none());
    assert!(map.add_log_odds(key, 1.0).is_err());
    assert!(map.set_log_odds(key, Some(1.0)).is_err());
}
