//! Surfaces against shapes whose surface is known.
#![allow(clippy::unwrap_used, reason = "a test fails where it unwraps")]

use monogrid_occupancy::*;
use std::collections::BTreeMap;

const RESOLUTION: f64 = 0.1;
/// Enough for the balls, but not for a surface with a face for nearly every cell.
const BUDGET: usize = 2_000_000;

/// A map of these log-odds by distance from the origin; NaN: unknown.
fn ball(log_odds: impl Fn(f64) -> f32) -> OccupancyMap {
    let mut map = OccupancyMap::new(MapConfig {
        memory_budget_bytes: BUDGET,
        ..MapConfig::with_resolution(RESOLUTION)
    })
    .unwrap();
    let (low, high) = (VoxelKey::new(-16, -16, -16), VoxelKey::new(15, 15, 15));
    let keys: Vec<VoxelKey> = map
        .states_in_key_box(low, high)
        .map(|(key, _)| key)
        .collect();
    for key in keys {
        let value = log_odds(norm(key.center(RESOLUTION)));
        map.set_log_odds(key, (!value.is_nan()).then_some(value))
            .unwrap();
    }
    map
}

fn norm(v: [f64; 3]) -> f64 {
    v.iter().map(|c| c * c).sum::<f64>().sqrt()
}

#[test]
fn the_surface_of_a_ball_is_closed_where_it_should_be_and_looks_outwards() {
    let map = ball(|distance| (10.0 * (1.0 - distance)).clamp(-2.0, 2.0) as f32);
    let mesh = map.surface_mesh(0).unwrap();
    assert!(mesh.vertices.len() > 800, "{}", mesh.vertices.len());
    assert_eq!(mesh.vertices.len(), mesh.normals.len());
    for (vertex, normal) in mesh.vertices.iter().zip(&mesh.normals) {
        let (vertex, normal) = (vertex.map(f64::from), normal.map(f64::from));
        let distance = norm(vertex);
        assert!((distance - 1.0).abs() < 0.15 * RESOLUTION, "{distance}");
        let outwards: f64 = (0..3).map(|k| vertex[k] * normal[k] / distance).sum();
        assert!(outwards > 0.9, "{outwards}");
    }
    // every edge belongs to two triangles that go along it in opposite directions, and V - E + F =
    // 2
    let mut edges: BTreeMap<(u32, u32), i32> = BTreeMap::new();
    for [a, b, c] in &mesh.triangles {
        for (from, to) in [(*a, *b), (*b, *c), (*c, *a)] {
            *edges.entry((from.min(to), from.max(to))).or_default() +=
                if from < to { 1 } else { -1 };
        }
    }
    assert!(edges.values().all(|balance| *balance == 0));
    let euler = mesh.vertices.len() as i64 - edges.len() as i64 + mesh.triangles.len() as i64;
    assert_eq!(euler, 2);
}

#[test]
fn what_is_unknown_bounds_nothing_and_small_pieces_go() {
    // a shell that was seen from outside only
    let seen = |distance: f64| match distance {
        d if d < 0.8 => f32::NAN,
        d if d < 1.0 => 2.0,
        _ => -2.0,
    };
    let mut map = ball(seen);
    let shell = map.surface_mesh(0).unwrap();
    let inside = |v: &&[f32; 3]| norm(v.map(f64::from)) < 0.9;
    assert_eq!(shell.vertices.iter().filter(inside).count(), 0);
    map.set_log_odds(VoxelKey::new(14, 14, 14), Some(1.0))
        .unwrap();
    assert_eq!(
        map.surface_mesh(6).unwrap().triangles.len(),
        shell.triangles.len() + 12
    );
    assert_eq!(map.surface_mesh(7).unwrap(), shell);
}

#[test]
fn a_surface_beyond_the_budget_is_refused() {
    let mut map = ball(|_| -1.0);
    let keys: Vec<VoxelKey> = map.cells().map(|cell| cell.key).collect();
    for key in keys {
        if (key.x + key.y + key.z) % 2 == 0 {
            map.set_log_odds(key, Some(1.0)).unwrap();
        }
    }
    let refused = map.surface_mesh(0);
    assert!(
        matches!(refused, Err(MapError::MemoryBudget { .. })),
        "{refused:?}"
    );
}
