//! The staircase of a house of flats: four flights around a narrow well, landings, railings, plain
//! walls.
//!
//! Each storey has a landing with two doors in the south (small y) and a half landing with a window
//! in the north. Flights that lead north are in the west (small x).

use super::furniture as f;
use super::workplace::{self as w, Office};
use crate::path::Waypoint;
use crate::patterns;
use crate::scene::{Material, MaterialId, Scene, place};
use crate::shapes::p;
use std::f32::consts::{FRAC_PI_2, PI};

/// Inner size of the staircase, m.
pub(super) const SIZE_M: [f32; 3] = [3.4, 6.6, 9.2];
/// Storeys above the ground floor.
pub(super) const STOREYS: usize = 2;
/// From floor to floor, m.
pub(super) const STOREY_M: f32 = 3.2;
/// Steps of a flight; two flights make a storey.
pub(super) const STEPS: usize = 10;
/// Depth of a step, m.
pub(super) const TREAD_M: f32 = 0.28;
/// Where flights begin and end (y, m).
pub(super) const FLIGHT_Y: [f32; 2] = [2.0, 4.8];
/// Width of a flight; the well between two of them is what is left.
pub(super) const FLIGHT_M: f32 = 1.6;
/// Thickness of landings, and of flights below the inner edges of their steps, m.
const SLAB_M: f32 = 0.18;
/// Height of a flight, m.
const RISE_M: f32 = 0.5 * STOREY_M;
/// Height of the railing above the noses of the steps, m.
const RAIL_M: f32 = 0.95;
/// Height of the eye above the steps, m.
pub(super) const EYE_M: f64 = 1.5;

/// What the staircase is made of.
struct Materials {
    plaster: MaterialId,
    dado: MaterialId,
    terrazzo: MaterialId,
    riser: MaterialId,
    steel: MaterialId,
    wood: MaterialId,
    office: Office,
}

impl Materials {
    fn new(s: &mut Scene) -> Self {
        Self {
            plaster: s.plain(0.68),
            dado: s.plain(0.42),
            terrazzo: s.tiled(patterns::rough(0.38, 0.8, 40, 0.8, 501), 1.2, 1.2),
            riser: s.plain(0.30),
            steel: s.plain(0.12),
            wood: s.tiled(patterns::wood(0.30, 0.8, 502), 1.2, 0.15),
            office: Office::new(s, 510),
        }
    }
}

/// Builds the staircase.
pub(super) fn scene() -> Scene {
    let mut scene = Scene::default();
    let s = &mut scene;
    let m = Materials::new(s);
    s.object("staircase");
    s.room(SIZE_M, [m.terrazzo, m.plaster], [m.plaster; 4]);
    for storey in 0..=STOREYS {
        let z = STOREY_M * storey as f32;
        s.at(place(0.0, 0.0, z, 0.0), |s| landing(s, &m, storey));
        if storey < STOREYS {
            s.at(place(0.0, 0.0, z, 0.0), |s| flights(s, &m));
            s.at(place(0.0, 0.0, z + RISE_M, 0.0), |s| {
                half_landing(s, &m, storey);
            });
        }
    }
    scene
}

/// What is at the floor of a storey: the slab, doors, a lamp, and things that people leave there.
fn landing(s: &mut Scene, m: &Materials, storey: usize) {
    s.object("landing");
    if storey > 0 {
        let y = FLIGHT_Y[0];
        s.cuboid([0.0, 0.0, -SLAB_M], [SIZE_M[0], y, 0.0], m.terrazzo);
        well_railing(s, m, y - 0.03);
    }
    if storey == STOREYS {
        // no flight goes on in the west
        let balusters: [f32; 13] = std::array::from_fn(|k| 0.06 + 0.12 * k as f32);
        level_railing(s, m, FLIGHT_Y[0] - 0.03, [0.0, FLIGHT_M], &balusters);
    }
    let seed = 520 + 20 * storey as u64;
    for x in [0.85, 2.55] {
        s.object_at("door", place(x, 0.0, 0.0, PI));
        f::door(s, 0.9, 2.05, m.office.beech, m.office.dark);
        let mat = s.fitted(patterns::rug(seed + x as u64));
        s.object_at("door mat", place(x, 0.42, 0.0, 0.0));
        s.cuboid([-0.32, -0.2, 0.0], [0.32, 0.2, 0.015], mat);
    }
    // a print that is another one on each floor
    let print = s.fitted(patterns::poster(seed + 3));
    s.object_at("storey plate", place(1.7, 0.0, 1.45, PI));
    f::picture(s, [0.34, 0.42], print, m.office.dark);
    belongings(s, m, storey, seed);
    let height = match storey {
        STOREYS => SIZE_M[2] - STOREY_M * STOREYS as f32,
        _ => STOREY_M - SLAB_M,
    };
    let glow = s.material(Material::plain(0.9).glowing(1.1));
    s.object_at("lamp", place(0.5 * SIZE_M[0], 1.0, height, 0.0));
    w::ceiling_panel(s, [0.6, 0.6], glow, 9.0);
}

/// Letter boxes and a notice board below, a plant or a cupboard above.
fn belongings(s: &mut Scene, m: &Materials, storey: usize, seed: u64) {
    let east = -FRAC_PI_2;
    match storey {
        0 => {
            s.object_at("letter boxes", place(SIZE_M[0], 1.1, 0.9, east));
            s.at(place(0.0, -0.13, 0.0, 0.0), |s| {
                w::file_cabinet(s, &m.office, [1.2, 0.26, 0.9], 3);
            });
            s.object_at("notice board", place(0.0, 1.0, 1.1, FRAC_PI_2));
            w::whiteboard(s, &m.office, 1.0, 0.8, seed);
        }
        1 => {
            s.object_at("plant", place(3.1, 1.55, 0.0, 0.0));
            f::plant(s, 1.1, 20, m.office.grey, m.office.leaf, seed);
        }
        _ => {
            s.object_at("shoe cupboard", place(SIZE_M[0] - 0.17, 1.0, 0.0, east));
            w::file_cabinet(s, &m.office, [0.8, 0.32, 0.9], 2);
        }
    }
}

/// The half landing: slab, window with its view and radiator, a picture on either side wall.
fn half_landing(s: &mut Scene, m: &Materials, storey: usize) {
    s.object("half landing");
    let [x, y, _] = SIZE_M;
    s.cuboid([0.0, FLIGHT_Y[1], -SLAB_M], [x, y, 0.0], m.terrazzo);
    well_railing(s, m, FLIGHT_Y[1] + 0.03);
    let seed = 600 + 20 * storey as u64;
    let view = s.material(Material::fitted(patterns::outdoors(seed)).glowing(0.95));
    s.object_at("window", place(0.5 * x, y, 0.95, 0.0));
    f::window(s, 1.3, 1.2, view, m.office.white, 6.0);
    s.object_at("radiator", place(0.5 * x, y, 0.0, 0.0));
    f::radiator(s, 1.0, 0.5, m.office.white);
    let images = [patterns::landscape(seed + 1), patterns::painting(seed + 2)];
    let walls = [(0.0, FRAC_PI_2), (x, -FRAC_PI_2)];
    for (image, (wall_x, heading)) in images.into_iter().zip(walls) {
        let image = s.fitted(image);
        s.object_at("picture", place(wall_x, 5.8, 1.15, heading));
        f::picture(s, [0.7, 0.55], image, m.office.dark);
    }
}

/// Both flights of a storey: up in the west to the north, up in the east to the south.
fn flights(s: &mut Scene, m: &Materials) {
    s.object_at("flight north", place(0.0, FLIGHT_Y[0], 0.0, 0.0));
    flight(s, m);
    // half a turn puts the outer side to the other wall
    let pose = place(SIZE_M[0], FLIGHT_Y[1], RISE_M, PI);
    s.object_at("flight south", pose);
    flight(s, m);
}

/// A flight up along +y from the origin, the wall at x = 0 and the well at x = [`FLIGHT_M`].
fn flight(s: &mut Scene, m: &Materials) {
    let rise = RISE_M / STEPS as f32;
    for k in 0..STEPS {
        let (y, z) = (TREAD_M * k as f32, rise * k as f32);
        let across = p(FLIGHT_M, 0.0, 0.0);
        s.quad(p(0.0, y, z), across, p(0.0, 0.0, rise), m.riser);
        s.floor([0.0, y, z + rise], [FLIGHT_M, TREAD_M], m.terrazzo);
        let nose = [FLIGHT_M, y + 0.03, z + rise + 0.002];
        s.cuboid([0.0, y - 0.004, z + rise - 0.02], nose, m.steel);
    }
    // the slab that carries the steps, closed towards the well by a cheek
    slanting(s, [0.0, FLIGHT_M], [-SLAB_M, 0.0], m.plaster);
    slanting(s, [FLIGHT_M - 0.03, FLIGHT_M], [-SLAB_M, 0.20], m.dado);
    // a painted strip along the wall and the handrail on it
    slanting(s, [0.0, 0.004], [0.1, 1.15], m.dado);
    let along = p(0.0, FLIGHT_Y[1] - FLIGHT_Y[0], RISE_M);
    let from = p(0.07, 0.0, RAIL_M + 0.1);
    s.bar(from, from + along, 0.022, m.wood);
    // balusters on the cheek with a handrail
    let x = FLIGHT_M - 0.015;
    for k in 0..2 * STEPS {
        let foot = p(x, 0.0, 0.20) + along * ((k as f32 + 0.5) / (2 * STEPS) as f32);
        s.bar(foot, foot + p(0.0, 0.0, RAIL_M - 0.1), 0.008, m.steel);
    }
    let from = p(x, 0.0, RAIL_M + 0.1);
    s.bar(from, from + along, 0.025, m.wood);
}

/// A slanting box between x = `from` and x = `to`, along a flight, from `low` to `high` above the
/// lower edge of its first riser.
fn slanting(s: &mut Scene, [from, to]: [f32; 2], [low, high]: [f32; 2], material: MaterialId) {
    let along = p(0.0, FLIGHT_Y[1] - FLIGHT_Y[0], RISE_M);
    let (across, up) = (p(to - from, 0.0, 0.0), p(0.0, 0.0, high - low));
    let corner = p(from, 0.0, low);
    s.quad(corner, up, along, material);
    s.quad(corner + across, along, up, material);
    s.quad(corner, along, across, material);
    s.quad(corner + up, across, along, material);
    s.quad(corner, across, up, material);
    s.quad(corner + along, up, across, material);
}

/// The railing of a landing across the well at a y.
fn well_railing(s: &mut Scene, m: &Materials, y: f32) {
    let (a, b) = (FLIGHT_M - 0.015, SIZE_M[0] - FLIGHT_M + 0.015);
    let balusters = [0.0, 1.0, 2.0].map(|k| a + (b - a) * k / 2.0);
    level_railing(s, m, y, [a, b], &balusters);
}

/// A level railing at a y between two x, with balusters.
fn level_railing(s: &mut Scene, m: &Materials, y: f32, [a, b]: [f32; 2], balusters: &[f32]) {
    s.bar(p(a, y, RAIL_M), p(b, y, RAIL_M), 0.025, m.wood);
    for x in balusters {
        s.bar(p(*x, y, 0.0), p(*x, y, RAIL_M), 0.008, m.steel);
    }
}

/// Lengths of the way up a storey as seen from above, m: out of the landing and up, across the half
/// landing, up and onto the landing, across it.
const LEGS_M: [f64; 4] = [LEG_M, ACROSS_M, LEG_M, ACROSS_M];
const LEG_M: f64 = 4.5;
const ACROSS_M: f64 = 1.8;
const STOREY_WAY_M: f64 = 2.0 * (LEG_M + ACROSS_M);

/// A point of the middle line of the way up, on the steps, a distance (seen from above) after the
/// ground floor.
fn on_way(distance_m: f64) -> [f64; 3] {
    let storey = (distance_m / STOREY_WAY_M).floor();
    let mut rest = distance_m - storey * STOREY_WAY_M;
    let mut leg = 0;
    while leg < 3 && rest > LEGS_M[leg] {
        rest -= LEGS_M[leg];
        leg += 1;
    }
    let (west, south, north) = (0.8, 1.15, 1.15 + LEG_M);
    let flights = FLIGHT_Y.map(f64::from);
    let rise = f64::from(RISE_M);
    let climbed = |y: f64| rise * ((y - flights[0]) / (flights[1] - flights[0])).clamp(0.0, 1.0);
    let [x, y, z] = match leg {
        0 => [west, south + rest, climbed(south + rest)],
        1 => [west + rest, north, rise],
        2 => {
            let y = north - rest;
            [west + ACROSS_M, y, 2.0 * rise - climbed(y)]
        }
        _ => [west + ACROSS_M - rest, south, 2.0 * rise],
    };
    [x, y, z + f64::from(STOREY_M) * storey]
}

/// Where somebody is who walks up and down all flights on the side of the well: feet on the steps,
/// heading (rad).
pub(super) fn walker(secs: f64) -> ([f64; 3], f64) {
    const SPEED: f64 = 0.6;
    let whole_m = STOREY_WAY_M * STOREYS as f64 - ACROSS_M;
    let turn = (1.5 * whole_m + SPEED * secs).rem_euclid(2.0 * whole_m);
    let at = |turn_m: f64| {
        let [x, y, z] = on_way(whole_m - (turn_m - whole_m).abs());
        let middle = 0.5 * f64::from(SIZE_M[0]);
        let [south, north] = FLIGHT_Y.map(f64::from);
        // on landings further away from the well than one who keeps to the middle
        let aside = ((y - north).clamp(0.0, 0.5) - (south - y).clamp(0.0, 0.5)) * 0.7;
        [middle + 0.45 * (x - middle), y + aside, z]
    };
    let (here, next) = (at(turn), at(turn + 0.2));
    (here, (next[1] - here[1]).atan2(next[0] - here[0]))
}

/// Up to the last storey, about turn, and a storey down again, looking ahead along the steps.
pub(super) fn way() -> Vec<Waypoint> {
    const STEP_M: f64 = 0.35;
    const AHEAD_M: f64 = 1.7;
    let top_m = STOREY_WAY_M * STOREYS as f64 - ACROSS_M;
    let up = (top_m / STEP_M) as usize;
    let down = (STOREY_WAY_M / STEP_M) as usize;
    let looking = |at_m: f64, to_m: f64, lower_m: f64| {
        let ([x, y, z], [a, b, c]) = (on_way(at_m), on_way(to_m));
        ([x, y, z + EYE_M], [a, b, c + EYE_M - lower_m])
    };
    let mut ways: Vec<Waypoint> = (0..=up)
        .map(|k| STEP_M * k as f64)
        .map(|at_m| looking(at_m, (at_m + AHEAD_M).min(top_m + ACROSS_M), 0.15))
        .collect();
    ways.extend((0..=down).map(|k| {
        let at_m = top_m - STEP_M * k as f64;
        looking(at_m, at_m - AHEAD_M, 0.30)
    }));
    ways
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use super::*;
    use crate::{LightingConfig, World};
    use std::sync::OnceLock;

    fn world() -> &'static World {
        static WORLD: OnceLock<World> = OnceLock::new();
        WORLD.get_or_init(|| World::by_name_with("stairs", &LightingConfig::quick()).unwrap())
    }

    /// Height of what is below a point.
    fn below(world: &World, [x, y, z]: [f64; 3]) -> f64 {
        z - world.cast([x, y, z], [0.0, 0.0, -1.0]).unwrap()
    }

    #[test]
    fn every_step_is_as_high_above_the_last_as_all_others() {
        let world = world();
        let rise = f64::from(RISE_M) / STEPS as f64;
        for (level, x) in [(0, 0.9), (1, 2.5), (2, 0.9), (3, 2.5)] {
            for k in 0..STEPS {
                let along = f64::from(TREAD_M) * (k as f64 + 0.5);
                let y = if level % 2 == 0 {
                    2.0 + along
                } else {
                    4.8 - along
                };
                let expected = f64::from(RISE_M) * f64::from(level) + rise * (k as f64 + 1.0);
                let found = below(world, [x, y, expected + 1.0]);
                assert!(
                    (found - expected).abs() < 1e-5,
                    "{level} {k}: {found} {expected}"
                );
            }
        }
    }

    #[test]
    fn the_way_goes_up_all_storeys_and_down_again_at_the_height_of_an_eye() {
        let world = world();
        let eyes: Vec<[f64; 3]> = way().into_iter().map(|(eye, _)| eye).collect();
        for eye in &eyes {
            let height_m = eye[2] - below(world, *eye);
            assert!((1.3..1.6).contains(&height_m), "{eye:?}: {height_m}");
        }
        let heights: Vec<f64> = eyes.iter().map(|eye| eye[2] - EYE_M).collect();
        let top = heights.iter().copied().fold(0.0, f64::max);
        let storey = f64::from(STOREY_M);
        assert!((top - storey * STOREYS as f64).abs() < 1e-5, "{top}");
        assert!(heights[0].abs() < 1e-9 && (heights.last().unwrap() - top + storey).abs() < 0.3);
    }

    #[test]
    fn whoever_walks_there_keeps_to_the_steps_and_out_of_the_way() {
        let world = world();
        let mut highest = 0.0f64;
        for k in 0..400 {
            let ([x, y, z], _) = walker(0.25 * f64::from(k));
            let ground = below(world, [x, y, z + 0.5]);
            assert!((z - ground).abs() < 0.17, "{k}: {z} above {ground}");
            let ahead = walker(0.25 * f64::from(k) + 0.25).0;
            let moved = [x - ahead[0], y - ahead[1], z - ahead[2]];
            assert!(moved.iter().all(|d| d.abs() < 0.4), "{k}: {moved:?}");
            highest = highest.max(z);
        }
        assert!(highest > 6.3, "{highest}");
    }
}
