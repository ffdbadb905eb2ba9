//! Queries of maps and of their snapshots against a dense grid that is asked cell by cell.
#![allow(clippy::unwrap_used, reason = "a test fails where it unwraps")]

use crate::common::Random;
use monogrid_occupancy::*;

const RESOLUTION: f64 = 0.1;
/// Cells along an edge of the box that scenes fill, from `-HALF` to `HALF - 1`.
const HALF: i32 = 20;

/// A map with uniform free and occupied bricks, single cells, holes, and a far brick.
fn scene(seed: u64) -> OccupancyMap {
    let mut random = Random(seed);
    let mut map = OccupancyMap::new(MapConfig::with_resolution(RESOLUTION)).unwrap();
    let between = |random: &mut Random| random.between(f64::from(-HALF), f64::from(HALF)) as i32;
    for x in -16..8 {
        for y in -8..16 {
            for z in -16..16 {
                map.set_log_odds(VoxelKey::new(x, y, z), Some(-1.5))
                    .unwrap();
            }
        }
    }
    for _ in 0..300 {
        let key = VoxelKey::from_array([0; 3].map(|_| between(&mut random)));
        let value = match random.unit() {
            u if u < 0.3 => None,
            u if u < 0.6 => Some(1.0),
            _ => Some(-0.3),
        };
        map.set_log_odds(key, value).unwrap();
    }
    for x in 8..16 {
        for y in 0..8 {
            for z in -8..0 {
                map.set_log_odds(VoxelKey::new(x, y, z), Some(2.0)).unwrap();
            }
        }
    }
    map.set_log_odds(VoxelKey::new(4_000_000, -4_000_000, 7), Some(1.0))
        .unwrap();
    map
}

fn all_cells() -> impl Iterator<Item = VoxelKey> {
    let range = -HALF - 9..HALF + 9;
    range.clone().flat_map(move |z| {
        let range = range.clone();
        range.clone().flat_map(move |y| {
            let range = range.clone();
            range.map(move |x| VoxelKey::new(x, y, z))
        })
    })
}

#[test]
fn a_snapshot_answers_as_its_map_and_follows_it() {
    let mut map = scene(3);
    let mut snapshot = Snapshot::new(&map);
    let old = snapshot.clone();
    let same = |map: &OccupancyMap, snapshot: &Snapshot| {
        all_cells().all(|key| map.state_of(key) == snapshot.state_of(key))
    };
    assert!(same(&map, &snapshot));
    let before = map.clone();
    let mut random = Random(8);
    for round in 0..20 {
        for _ in 0..30 {
            let key = VoxelKey::from_array([0; 3].map(|_| random.between(-29.0, 29.0) as i32));
            let value = (random.unit() < 0.7).then(|| random.between(-2.0, 3.0) as f32);
            map.set_log_odds(key, value).unwrap();
        }
        let read = snapshot.update(&map);
        assert!(
            (1..=30).contains(&read),
            "only what changed is read: {read}"
        );
        assert!(same(&map, &snapshot), "round {round}");
    }
    assert!(same(&before, &old), "a copy stays as it was");
    assert_eq!(snapshot.update(&map), 0);
    let far = VoxelKey::new(4_000_000, -4_000_000, 7);
    assert_eq!(snapshot.state_of(far), Occupancy::Occupied);
}

#[test]
fn batches_answer_as_single_points_for_any_point() {
    let map = scene(4);
    let snapshot = Snapshot::new(&map);
    let mut random = Random(9);
    let mut points: Vec<[f64; 3]> = (0..1003)
        .map(|_| [0; 3].map(|_| random.between(-3.5, 3.5)))
        .collect();
    points.push([f64::NAN, 0.0, 0.0]);
    points.push([1e300, 0.0, f64::NEG_INFINITY]);
    points.push([-0.0, -1e-300, 0.1]);
    let mut batch = vec![Occupancy::Occupied; points.len()];
    map.states(&points, &mut batch);
    let mut snapshot_batch = vec![Occupancy::Occupied; points.len()];
    snapshot.states(&points, &mut snapshot_batch);
    for ((point, a), b) in points.iter().zip(batch).zip(snapshot_batch) {
        assert_eq!(map.state(*point), a, "{point:?}");
        assert_eq!(snapshot.state(*point), a);
        assert_eq!(b, a);
    }
}

#[test]
fn points_are_in_the_cell_that_the_floor_of_their_coordinates_names() {
    let mut random = Random(12);
    for _ in 0..20_000 {
        let cell = random.between(-1e5, 1e5).round();
        let offset = [0.0, 1e-9, -1e-9, 0.5, 0.999][(random.unit() * 5.0) as usize];
        let x = cell + offset;
        let key = VoxelKey::from_point([x, -x, 0.0], 1.0).unwrap();
        assert_eq!(f64::from(key.x), x.floor());
        assert_eq!(f64::from(key.y), (-x).floor());
    }
    let limit = f64::from(1 << 23);
    assert_eq!(VoxelKey::from_point([limit, 0.0, 0.0], 1.0), None);
    assert_eq!(VoxelKey::from_point([-limit - 1e-6, 0.0, 0.0], 1.0), None);
    assert!(VoxelKey::from_point([-limit, 0.0, limit - 1e-6], 1.0).is_some());
}

/// The first stopping cell by tiny steps along the ray.
fn brute_force_cast(
    map: &OccupancyMap,
    origin: [f64; 3],
    direction: [f64; 3],
    range: f64,
    unknown: UnknownCells,
) -> Option<(VoxelKey, Occupancy)> {
    (0..=(range / 2e-4) as usize).find_map(|i| {
        let t = i as f64 * 2e-4;
        let point: [f64; 3] = std::array::from_fn(|a| origin[a] + t * direction[a]);
        let state = map.state(point);
        let stops = state == Occupancy::Occupied
            || state == Occupancy::Unknown && unknown == UnknownCells::Stop;
        stops.then(|| (map.key(point).unwrap(), state))
    })
}

#[test]
fn rays_stop_at_the_first_cell_that_small_steps_meet() {
    let map = scene(5);
    let snapshot = Snapshot::new(&map);
    let mut random = Random(10);
    let (mut hits, mut nothing, mut clipped) = (0, 0, 0);
    for i in 0..400 {
        let origin = [0; 3].map(|_| random.between(-2.2, 2.2));
        let direction = random.rotation()[0];
        let range = random.between(0.0, 5.0);
        let unknown = [UnknownCells::PassThrough, UnknownCells::Stop][i % 2];
        let hit = map.cast_ray(origin, direction.map(|c| 3.0 * c), range, unknown);
        assert_eq!(snapshot.cast_ray(origin, direction, range, unknown), {
            // A direction of another length may round differently in the last bit.
            map.cast_ray(origin, direction, range, unknown)
        });
        let expected = brute_force_cast(&map, origin, direction, range, unknown);
        let (key, state) = match hit {
            RayHit::Occupied { key, .. } => (key, Occupancy::Occupied),
            RayHit::Unknown { key, .. } => (key, Occupancy::Unknown),
            RayHit::Nothing => {
                nothing += 1;
                // Small steps cannot meet more than the ray does.
                assert_eq!(expected, None);
                continue;
            }
            RayHit::Invalid => panic!("a usable ray"),
        };
        hits += 1;
        assert_eq!(map.state_of(key), state);
        // A cell whose corner the ray only clips can be missed by steps, never the other way.
        if expected != Some((key, state)) {
            clipped += 1;
        }
    }
    assert!(hits > 150 && nothing > 20, "{hits} {nothing}");
    assert!(clipped <= 4, "{clipped} differ");
}

#[test]
fn unusable_rays_are_said_to_be_unusable() {
    let map = scene(6);
    let snapshot = Snapshot::new(&map);
    for (origin, direction, range) in [
        ([0.0; 3], [0.0; 3], 1.0),
        ([f64::NAN, 0.0, 0.0], [1.0, 0.0, 0.0], 1.0),
        ([0.0; 3], [f64::INFINITY, 0.0, 0.0], 1.0),
        ([0.0; 3], [1.0, 0.0, 0.0], -1.0),
        ([1e300, 0.0, 0.0], [1.0, 0.0, 0.0], 1.0),
    ] {
        let unknown = UnknownCells::Stop;
        assert_eq!(
            map.cast_ray(origin, direction, range, unknown),
            RayHit::Invalid
        );
        assert_eq!(
            snapshot.cast_ray(origin, direction, range, unknown),
            RayHit::Invalid
        );
    }
}

#[test]
fn spheres_and_boxes_collide_as_a_search_over_all_cells_says() {
    let map = scene(7);
    let snapshot = Snapshot::new(&map);
    let mut random = Random(11);
    let mut collisions = 0;
    for i in 0..200 {
        let center = [0; 3].map(|_| random.between(-2.0, 2.0));
        let radius = random.between(0.0, 0.6);
        let half = [0; 3].map(|_| random.between(0.0, 0.4));
        let unknown = [UnknownCells::PassThrough, UnknownCells::Stop][i % 2];
        let stops = |key| match map.state_of(key) {
            Occupancy::Occupied => true,
            Occupancy::Unknown => unknown == UnknownCells::Stop,
            Occupancy::Free => false,
        };
        let near = |key: VoxelKey| -> [f64; 3] {
            std::array::from_fn(|a| {
                let low = f64::from(key.to_array()[a]) * RESOLUTION;
                let high = f64::from(key.to_array()[a] + 1) * RESOLUTION;
                center[a].clamp(low, high)
            })
        };
        let distance = |key| -> f64 {
            let p = near(key);
            (0..3)
                .map(|a| (p[a] - center[a]).powi(2))
                .sum::<f64>()
                .sqrt()
        };
        let expected = all_cells().any(|key| stops(key) && distance(key) <= radius);
        assert_eq!(map.sphere_collides(center, radius, unknown), expected);
        assert_eq!(snapshot.sphere_collides(center, radius, unknown), expected);
        collisions += usize::from(expected);
        let low: [f64; 3] = std::array::from_fn(|a| center[a] - half[a]);
        let high: [f64; 3] = std::array::from_fn(|a| center[a] + half[a]);
        let (first, last) = (map.key(low).unwrap(), map.key(high).unwrap());
        let expected = map
            .states_in_key_box(first, last)
            .any(|(key, _)| stops(key));
        assert_eq!(map.box_collides(low, high, unknown), expected);
        assert_eq!(snapshot.box_collides(low, high, unknown), expected);
    }
    assert!((40..160).contains(&collisions), "{collisions}");
    // Far larger than the map: answered from the bricks that there are.
    for far in [1e3, 1e9] {
        let unknown = UnknownCells::PassThrough;
        assert!(map.box_collides([-far; 3], [far; 3], unknown));
        assert!(snapshot.sphere_collides([0.0; 3], far, unknown));
        assert!(!map.box_collides([far, far, far], [2.0 * far; 3], unknown));
        assert!(map.sphere_collides([0.0; 3], f64::NAN, UnknownCells::Stop));
    }
}

#[test]
fn cells_of_a_state_in_a_box_are_those_that_a_search_finds() {
    let map = scene(13);
    let (first, last) = (VoxelKey::new(-18, -3, -17), VoxelKey::new(12, 19, 9));
    let mut total = 0;
    for state in [Occupancy::Unknown, Occupancy::Free, Occupancy::Occupied] {
        let mut found: Vec<VoxelKey> = map.keys_in_key_box(first, last, state).collect();
        let mut expected: Vec<VoxelKey> = map
            .states_in_key_box(first, last)
            .filter(|(_, s)| *s == state)
            .map(|(key, _)| key)
            .collect();
        found.sort_unstable();
        expected.sort_unstable();
        assert_eq!(found, expected);
        total += found.len();
    }
    assert_eq!(total, 31 * 23 * 27);
    let known = map.cells_in_key_box(first, last).count();
    let unknown = map.keys_in_key_box(first, last, Occupancy::Unknown).count();
    assert_eq!(known + unknown, total);
}

#[test]
fn a_coarser_level_is_occupied_where_any_of_its_cells_is() {
    let map = scene(14);
    let mut random = Random(15);
    for _ in 0..300 {
        let point = [0; 3].map(|_| random.between(-2.5, 2.5));
        let level = (random.unit() * 6.0) as u32;
        let key = map
            .key(point)
            .unwrap()
            .to_array()
            .map(|c| c >> level << level);
        let last = key.map(|c| c + (1 << level) - 1);
        let mut states =
            map.states_in_key_box(VoxelKey::from_array(key), VoxelKey::from_array(last));
        let expected = states
            .by_ref()
            .fold(Occupancy::Unknown, |most, (_, s)| match (most, s) {
                (Occupancy::Occupied, _) | (_, Occupancy::Occupied) => Occupancy::Occupied,
                (Occupancy::Free, _) | (_, Occupancy::Free) => Occupancy::Free,
                _ => Occupancy::Unknown,
            });
        assert_eq!(
            map.state_at_level(point, level),
            expected,
            "{point:?} {level}"
        );
    }
}
