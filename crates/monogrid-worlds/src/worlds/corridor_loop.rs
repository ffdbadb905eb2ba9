//! A corridor that closes a loop of 64 m around a block and passes two rooms that look alike.

use super::furniture as f;
use super::workplace::{self as w, Office};
use crate::patterns;
use crate::random::Random;
use crate::scene::{Material, MaterialId, Pose, Scene, place};
use crate::shapes::p;
use std::f32::consts::{FRAC_PI_2, PI};

/// Outer size of the corridor; its middle line is 18 x 14 m.
const OUTER_M: [f32; 2] = [20.0, 16.0];
/// Width of the corridor, m.
const WIDTH_M: f32 = 2.0;
const HEIGHT_M: f32 = 2.7;
/// Width of the openings of the two rooms, m.
const OPENING_M: f32 = 3.2;
/// Middle of the opening of the room in the south and of that in the north (x, m).
const ROOMS_X: [f32; 2] = [8.0, 12.0];

/// Builds the floor of the building.
pub(super) fn scene() -> Scene {
    let mut scene = Scene::default();
    let s = &mut scene;
    let plaster = s.plain(0.64);
    let floor = s.tiled(patterns::marble(0.36, 401), 2.4, 2.4);
    let ceiling = s.tiled(patterns::tiles(0.70, 0.08, 4, 402), 2.5, 2.5);
    let m = Office::new(s, 410);
    shell(s, [plaster, floor, ceiling]);
    // the same room twice, turned by half a circle
    let carpet = s.tiled(patterns::tiles(0.22, 0.5, 6, 403), 3.0, 3.0);
    for (x, y, heading, name) in [
        (ROOMS_X[0], 0.0, 0.0, "south room"),
        (ROOMS_X[1], OUTER_M[1], PI, "north room"),
    ] {
        s.object_at(name, place(x, y, 0.0, heading));
        room(s, &m, plaster, carpet);
    }
    decoration(s, &m);
    lamps(s);
    scene
}

/// Walls with the two openings, floor and ceiling.
fn shell(s: &mut Scene, [plaster, floor, ceiling]: [MaterialId; 3]) {
    s.object("corridor");
    let [x, y] = OUTER_M;
    let up = p(0.0, 0.0, HEIGHT_M);
    s.floor([0.0; 3], OUTER_M, floor);
    s.ceiling([0.0, 0.0, HEIGHT_M], OUTER_M, ceiling);
    // outer walls, leaving the openings free
    s.quad(p(0.0, 0.0, 0.0), p(0.0, y, 0.0), up, plaster);
    s.quad(p(x, 0.0, 0.0), up, p(0.0, y, 0.0), plaster);
    for (wall_y, middle) in [(0.0, ROOMS_X[0]), (y, ROOMS_X[1])] {
        let (a, b) = (middle - 0.5 * OPENING_M, middle + 0.5 * OPENING_M);
        for (from, to) in [(0.0, a), (b, x)] {
            let along = p(to - from, 0.0, 0.0);
            if wall_y == 0.0 {
                s.quad(p(from, wall_y, 0.0), up, along, plaster);
            } else {
                s.quad(p(from, wall_y, 0.0), along, up, plaster);
            }
        }
    }
    // the block inside
    s.object("block");
    let (min, max) = (
        [WIDTH_M, WIDTH_M, 0.0],
        [x - WIDTH_M, y - WIDTH_M, HEIGHT_M],
    );
    s.cuboid(min, max, plaster);
}

/// Room of 6 x 4 m beyond the line y = 0, towards -y, open to the corridor.
fn room(s: &mut Scene, m: &Office, plaster: MaterialId, carpet: MaterialId) {
    let (half, depth, up) = (3.0, 4.0, p(0.0, 0.0, HEIGHT_M));
    let (dx, dy) = (p(2.0 * half, 0.0, 0.0), p(0.0, depth, 0.0));
    s.floor([-half, -depth, 0.0], [2.0 * half, depth], carpet);
    s.ceiling([-half, -depth, HEIGHT_M], [2.0 * half, depth], plaster);
    s.quad(p(-half, -depth, 0.0), up, dx, plaster);
    s.quad(p(-half, -depth, 0.0), dy, up, plaster);
    s.quad(p(half, -depth, 0.0), up, dy, plaster);
    for (from, to) in [(-half, -0.5 * OPENING_M), (0.5 * OPENING_M, half)] {
        s.cuboid([from, -0.12, 0.0], [to, 0.0, HEIGHT_M], plaster);
    }
    s.at(place(-1.3, -3.4, 0.0, PI), |s| w::desk(s, m, 1.6, 420));
    s.at(place(-1.3, -2.6, 0.0, 0.3), |s| w::office_chair(s, m));
    s.at(place(1.6, -3.82, 0.0, PI), |s| {
        f::bookshelf(s, 1.2, 2.0, 6, m.beech, 421);
    });
    s.at(place(0.2, -1.9, 0.0, 0.2), |s| {
        f::round_table(s, 0.5, 0.73, m.beech, m.grey);
    });
    for (x, y, a) in [(0.9, -1.7, -1.2), (-0.4, -1.5, 1.0)] {
        s.at(place(x, y, 0.0, a), |s| f::chair(s, m.grey, m.cloth));
    }
    s.at(place(2.6, -0.6, 0.0, 0.0), |s| {
        f::plant(s, 1.5, 26, m.grey, m.leaf, 422);
    });
    s.at(place(-2.75, -1.6, 0.0, FRAC_PI_2), |s| {
        w::file_cabinet(s, m, [0.46, 0.5, 1.3], 4);
    });
    s.at(place(0.0, -4.0, 1.3, PI), |s| {
        f::picture(s, [0.9, 0.7], m.papers[0], m.dark);
    });
    s.at(place(-2.2, -4.0, 1.4, PI), |s| {
        f::picture(s, [0.6, 0.8], m.papers[1], m.dark);
    });
    s.at(place(0.2, -1.9, 0.73, 0.3), |s| {
        f::magazines(s, &m.papers[..3], 423);
    });
    let glow = s.material(Material::plain(0.9).glowing(1.1));
    s.at(place(0.0, -2.0, HEIGHT_M, 0.0), |s| {
        w::ceiling_panel(s, [1.2, 0.6], glow, 9.0);
    });
}

/// Doors, pictures, notice boards, cabinets, plants and extinguishers along the walls.
fn decoration(s: &mut Scene, m: &Office) {
    let mut random = Random::new(430);
    let [x, y] = OUTER_M;
    let (w_, inner_x, inner_y) = (WIDTH_M, x - WIDTH_M, y - WIDTH_M);
    // walls as (start, direction along it, length, heading of things that hang on it)
    let walls = [
        ([0.0, 0.0], [1.0, 0.0], x, PI),
        ([x, 0.0], [0.0, 1.0], y, -FRAC_PI_2),
        ([x, y], [-1.0, 0.0], x, 0.0),
        ([0.0, y], [0.0, -1.0], y, FRAC_PI_2),
        ([w_, w_], [1.0, 0.0], inner_x - w_, 0.0),
        ([inner_x, w_], [0.0, 1.0], inner_y - w_, FRAC_PI_2),
        ([inner_x, inner_y], [-1.0, 0.0], inner_x - w_, PI),
        ([w_, inner_y], [0.0, -1.0], inner_y - w_, -FRAC_PI_2),
    ];
    let kinds = [patterns::painting, patterns::landscape, patterns::poster];
    let images: [MaterialId; 9] = std::array::from_fn(|k| s.fitted(kinds[k % 3](440 + k as u64)));
    for (k, (start, along, length, heading)) in walls.into_iter().enumerate() {
        let mut at = random.range(0.7, 1.2);
        while at < length - 0.7 {
            let (px, py) = (start[0] + along[0] * at, start[1] + along[1] * at);
            let outside_room = match k {
                0 => (px - ROOMS_X[0]).abs() > 0.5 * OPENING_M + 0.6,
                2 => (px - ROOMS_X[1]).abs() > 0.5 * OPENING_M + 0.6,
                _ => true,
            };
            if outside_room {
                wall_piece(s, m, &images, place(px, py, 0.0, heading), &mut random);
            }
            at += random.range(1.0, 1.9);
        }
    }
}

/// One thing at a wall, chosen at random.
fn wall_piece(s: &mut Scene, m: &Office, images: &[MaterialId], pose: Pose, random: &mut Random) {
    let kind = random.unit();
    let image = images[random.below(images.len())];
    let size = [random.range(0.45, 0.9), random.range(0.5, 0.95)];
    let seed = random.word();
    if kind < 0.25 {
        s.object_at("door", pose);
        f::door(s, 0.86, 2.05, m.beech, m.dark);
    } else if kind < 0.62 {
        s.object_at("picture", pose * place(0.0, 0.0, 1.2, 0.0));
        f::picture(s, size, image, m.dark);
    } else if kind < 0.72 {
        s.object_at("notice board", pose * place(0.0, 0.0, 1.0, 0.0));
        w::whiteboard(s, m, 1.0, 0.9, seed);
    } else if kind < 0.82 {
        s.object_at("cabinet", pose * place(0.0, -0.23, 0.0, 0.0));
        w::file_cabinet(s, m, [0.5, 0.4, 1.1], 3);
    } else if kind < 0.92 {
        s.object_at("plant", pose * place(0.0, -0.25, 0.0, 0.0));
        f::plant(s, 1.2, 18, m.grey, m.leaf, seed);
    } else {
        s.object_at("extinguisher", pose * place(0.0, -0.1, 0.6, 0.0));
        let radii = [0.0, 0.03, 0.03, 0.075, 0.075, 0.0];
        s.lathe(&radii, &[0.52, 0.5, 0.45, 0.38, 0.0, 0.0], 24, m.grey);
    }
}

fn lamps(s: &mut Scene) {
    let glow = s.material(Material::plain(0.9).glowing(1.1));
    let [x, y] = OUTER_M;
    let middle = 0.5 * WIDTH_M;
    let mut spots = Vec::new();
    for k in 0..5 {
        let along = 2.0 + 4.0 * k as f32;
        spots.extend([(along, middle), (along, y - middle)]);
    }
    for k in 0..3 {
        let along = 4.0 + 4.0 * k as f32;
        spots.extend([(middle, along), (x - middle, along)]);
    }
    for (px, py) in spots {
        s.object_at("corridor lamp", place(px, py, HEIGHT_M, 0.0));
        w::ceiling_panel(s, [0.6, 0.6], glow, 9.0);
    }
}
