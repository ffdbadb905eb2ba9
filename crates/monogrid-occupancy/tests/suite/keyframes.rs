//! Maps that follow their keyframes equal maps built from scratch, byte for byte.
#![allow(clippy::unwrap_used, reason = "a test fails where it unwraps")]

use std::collections::BTreeMap;

use crate::common::{OwnedScan, Random, room_scan};
use monogrid_occupancy::*;

fn rules() -> [IntegrationConfig; 3] {
    let with = |rule, model| IntegrationConfig {
        rule,
        model,
        ..IntegrationConfig::default()
    };
    [
        with(IntegrationRule::Fused, SensorModel::THRUN),
        with(IntegrationRule::Rays, SensorModel::THRUN),
        with(IntegrationRule::Fused, SensorModel::None),
    ]
}

const CELL: f64 = 0.09;

fn bytes(map: &OccupancyMap) -> Vec<u8> {
    let mut bytes = Vec::new();
    write_ot(map, &mut bytes).unwrap();
    bytes
}

fn from_scratch(scans: &BTreeMap<u32, OwnedScan>, config: &IntegrationConfig) -> Vec<u8> {
    let mut map = OccupancyMap::new(MapConfig::with_resolution(CELL)).unwrap();
    for scan in scans.values() {
        integrate(&mut map, &scan.borrow(), config, 1).unwrap();
    }
    bytes(&map)
}

#[test]
fn any_history_of_changes_ends_with_the_map_built_from_scratch() {
    for (case, config) in rules().into_iter().enumerate() {
        let mut random = Random(case as u64 + 20);
        let mut scans = BTreeMap::new();
        let new = |threads| {
            KeyframeMap::new(MapConfig::with_resolution(CELL), config.clone(), threads).unwrap()
        };
        let (mut one, mut three) = (new(1), new(3));
        for step in 0..14_u32 {
            let id = (random.between(0.0, 6.0)) as u32;
            let scan = room_scan(&mut random, id, 900, 2.0);
            let changes = match step % 4 {
                0 | 1 => {
                    scans.insert(id, scan.clone());
                    vec![KeyframeChange::Set(scan.borrow())]
                }
                2 => {
                    let other = id + 1;
                    let poses = [random.pose(0.7), random.pose(0.7)];
                    for (id, pose) in [id, other].into_iter().zip(poses) {
                        if let Some(scan) = scans.get_mut(&id) {
                            scan.pose = pose;
                        }
                    }
                    [id, other]
                        .into_iter()
                        .zip(poses)
                        .map(|(id, world_from_sensor)| KeyframeChange::Move {
                            id,
                            world_from_sensor,
                        })
                        .collect()
                }
                _ => {
                    scans.remove(&id);
                    vec![KeyframeChange::Remove { id }]
                }
            };
            one.apply(&changes).unwrap();
            three.apply(&changes).unwrap();
            let expected = from_scratch(&scans, &config);
            assert!(bytes(one.map()) == expected, "case {case} step {step}");
            assert!(
                bytes(three.map()) == expected,
                "case {case} step {step}, 3 threads"
            );
        }
        assert!(one.ids().eq(scans.keys().copied()));
        assert!(bytes(one.map()).len() > 1000);
    }
}

#[test]
fn the_order_of_arrival_does_not_matter_and_a_removed_keyframe_can_be_put_back() {
    for (case, config) in rules().into_iter().enumerate() {
        let mut random = Random(case as u64 + 40);
        let scans: Vec<_> = (0..5)
            .map(|id| room_scan(&mut random, id, 700, 2.0))
            .collect();
        let mut maps = [[0, 1, 2, 3, 4], [4, 2, 0, 3, 1]].map(|order| {
            let mut map =
                KeyframeMap::new(MapConfig::with_resolution(CELL), config.clone(), 2).unwrap();
            for id in order {
                map.set(&scans[id].borrow()).unwrap();
            }
            map
        });
        let all = bytes(maps[0].map());
        assert!(all == bytes(maps[1].map()), "case {case}");
        let map = &mut maps[0];
        map.apply(&[KeyframeChange::Remove { id: 1 }]).unwrap();
        assert!(all != bytes(map.map()));
        map.set(&scans[1].borrow()).unwrap();
        assert!(all == bytes(map.map()), "case {case}");
    }
}

#[test]
fn the_work_follows_what_changed() {
    let mut random = Random(3);
    let config = IntegrationConfig::default();
    let mut map = KeyframeMap::new(MapConfig::with_resolution(0.05), config, 1).unwrap();
    for id in 0..4 {
        let mut scan = room_scan(&mut random, id, 900, 1.0);
        // Rooms far from each other.
        scan.pose.translation[0] += 50.0 * f64::from(id);
        map.set(&scan.borrow()).unwrap();
    }
    let revision = map.map().revision();
    let rebuilt = map.apply(&[KeyframeChange::Remove { id: 1 }]).unwrap();
    let changed = map.map().bricks_changed_since(revision);
    assert!(rebuilt > 0 && !changed.is_empty());
    let edge = 8.0 * 0.05;
    for brick in changed {
        assert!(
            (45.0..55.0).contains(&(f64::from(brick.x) * edge)),
            "{brick:?}"
        );
    }
    let same = map.apply(&[KeyframeChange::Remove { id: 77 }]).unwrap();
    assert_eq!(same, 0);
}

#[test]
fn a_change_that_does_not_fit_into_memory_leaves_everything_as_it_was() {
    let mut random = Random(8);
    let small = room_scan(&mut random, 5, 200, 0.4);
    let large = room_scan(&mut random, 2, 4000, 9.0);
    for config in &rules()[..2] {
        let budget = MapConfig {
            resolution: 0.03,
            memory_budget_bytes: 3 << 20,
            ..MapConfig::default()
        };
        let mut map = KeyframeMap::new(budget, config.clone(), 2).unwrap();
        map.set(&small.borrow()).unwrap();
        let before = bytes(map.map());
        let error = map.set(&large.borrow()).unwrap_err();
        let is_memory = matches!(
            error,
            MapError::MemoryBudget { .. } | MapError::TooFine { .. }
        );
        assert!(is_memory, "{error}");
        assert!(before == bytes(map.map()));
        assert!(map.ids().eq([5]));
    }
}

#[test]
fn an_update_in_steps_leaves_the_map_complete_until_it_is_done_and_takes_new_scans_along() {
    for (case, config) in rules().into_iter().enumerate() {
        for num_moved in [1, 5] {
            let mut random = Random(case as u64 * 7 + num_moved);
            let mut scans = BTreeMap::new();
            let mut map =
                KeyframeMap::new(MapConfig::with_resolution(CELL), config.clone(), 2).unwrap();
            for id in 0..5 {
                let scan = room_scan(&mut random, id, 700, 2.0);
                map.set(&scan.borrow()).unwrap();
                scans.insert(id, scan);
            }
            let mut follower = Snapshot::new(map.map());
            let mut front = scans.clone();
            let moves: Vec<_> = (0..num_moved as u32)
                .map(|id| {
                    let world_from_sensor = random.pose(0.7);
                    scans.get_mut(&id).unwrap().pose = world_from_sensor;
                    KeyframeChange::Move {
                        id,
                        world_from_sensor,
                    }
                })
                .collect();
            map.begin_update(&moves).unwrap();
            let mut steps = 0;
            while map.step_update().unwrap().is_none() {
                steps += 1;
                // The map of before, with what is added while the update is under way.
                if steps % 2 == 1 && steps < 8 {
                    let scan = room_scan(&mut random, 10 + steps, 300, 2.0);
                    map.set(&scan.borrow()).unwrap();
                    front.insert(scan.id, scan.clone());
                    scans.insert(scan.id, scan);
                }
                assert!(map.is_updating());
                assert!(bytes(map.map()) == from_scratch(&front, &config));
                follower.update(map.map());
            }
            assert!(!map.is_updating() && steps > 4);
            let expected = from_scratch(&scans, &config);
            assert!(
                bytes(map.map()) == expected,
                "case {case}, {num_moved} moved"
            );
            // Those who follow the map brick by brick see the change, and lost bricks vanish.
            follower.update(map.map());
            let cells = (-40..40).flat_map(|x| (-40..40).map(move |y| (x, y)));
            for (x, y) in cells {
                for z in -40..40 {
                    let key = VoxelKey::new(x, y, z);
                    assert_eq!(follower.state_of(key), map.map().state_of(key));
                }
            }
            // Later changes know where the moved keyframes are.
            map.apply(&[KeyframeChange::Remove { id: 0 }]).unwrap();
            scans.remove(&0);
            assert!(bytes(map.map()) == from_scratch(&scans, &config));
        }
    }
}

#[test]
fn a_shared_map_stays_as_it_is() {
    let mut random = Random(5);
    let mut map = KeyframeMap::new(
        MapConfig::with_resolution(CELL),
        IntegrationConfig::default(),
        1,
    )
    .unwrap();
    map.set(&room_scan(&mut random, 0, 500, 2.0).borrow())
        .unwrap();
    let shared = map.share();
    let before = bytes(&shared);
    map.set(&room_scan(&mut random, 1, 500, 2.0).borrow())
        .unwrap();
    assert!(bytes(&shared) == before && bytes(map.map()) != before);
    let counts: Vec<_> = map.points().collect();
    assert!(counts.iter().map(|c| c.0).eq([0, 1]) && counts.iter().all(|c| c.1 > 300));
}
