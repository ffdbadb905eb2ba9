//! A machine hall of 30 x 30 x 12 m.

use super::furniture::window;
use super::workplace as w;
use crate::patterns;
use crate::scene::{Material, MaterialId, Scene, place};
use crate::shapes::p;
use std::f32::consts::{FRAC_PI_2, PI};

/// Inner size, m.
const SIZE_M: [f32; 3] = [30.0, 30.0, 12.0];

struct Palette {
    steel: MaterialId,
    paint: MaterialId,
    rust: MaterialId,
    wood: MaterialId,
    dials: MaterialId,
    dark: MaterialId,
}

/// Builds the hall.
pub(super) fn scene() -> Scene {
    let mut scene = Scene::default();
    let s = &mut scene;
    shell(s);
    let m = Palette {
        steel: s.plain(0.42),
        paint: s.tiled(patterns::rough(0.24, 0.55, 4, 0.6, 301), 1.5, 1.5),
        rust: s.tiled(patterns::rough(0.16, 1.0, 3, 0.65, 302), 2.0, 2.0),
        wood: s.tiled(patterns::planks(0.40, 0.8, 6, 303), 1.6, 1.2),
        dials: s.fitted(patterns::poster(304)),
        dark: s.plain(0.08),
    };
    machines(s, &m);
    stock(s, &m);
    roof(s, &m);
    galleries(s, &m);
    scene
}

fn shell(s: &mut Scene) {
    s.object("hall");
    let [x, y, z] = SIZE_M;
    let concrete = s.tiled(patterns::marble(0.34, 305), 5.0, 5.0);
    let bricks = s.tiled(patterns::bricks(0.34, 24, 306), 4.2, 3.2);
    let plaster = s.plain(0.58);
    let ceiling = s.plain(0.45);
    let (dx, dy) = (p(x, 0.0, 0.0), p(0.0, y, 0.0));
    let (low, high) = (p(0.0, 0.0, 4.5), p(0.0, 0.0, z - 4.5));
    s.floor([0.0; 3], [x, y], concrete);
    s.ceiling([0.0, 0.0, z], [x, y], ceiling);
    // bricks below, plaster above
    for (lift, height, material) in [(0.0, low, bricks), (4.5, high, plaster)] {
        s.quad(p(0.0, 0.0, lift), dy, height, material);
        s.quad(p(x, 0.0, lift), height, dy, material);
        s.quad(p(0.0, 0.0, lift), height, dx, material);
        s.quad(p(0.0, y, lift), dx, height, material);
    }
    let sky = s.material(Material::fitted(patterns::outdoors(307)).glowing(1.0));
    let frame = s.plain(0.15);
    for k in 0..4 {
        let along = 4.5 + 7.0 * k as f32;
        for (pose, name) in [
            (place(0.0, along, 6.0, FRAC_PI_2), "west window"),
            (place(x, along, 6.0, -FRAC_PI_2), "east window"),
        ] {
            s.object_at(name, pose);
            window(s, 4.5, 3.6, sky, frame, 14.0);
        }
    }
}

fn machines(s: &mut Scene, m: &Palette) {
    let spots = [
        (7.0, 8.0, 0.2),
        (14.5, 7.0, -0.1),
        (22.5, 8.5, 0.15),
        (8.0, 21.5, PI),
        (22.0, 20.5, PI + 0.2),
    ];
    for (k, (x, y, heading)) in spots.into_iter().enumerate() {
        s.object_at("machine", place(x, y, 0.0, heading));
        w::machine(s, m.steel, m.paint, m.dials, 310 + k as u64);
    }
    let spots = [
        (3.5, 26.0, 1.5, 6.5),
        (7.5, 27.0, 1.2, 5.0),
        (26.0, 26.5, 1.8, 7.5),
        (26.5, 3.5, 1.4, 5.5),
        (15.0, 27.0, 1.0, 4.0),
    ];
    for (k, (x, y, r, h)) in spots.into_iter().enumerate() {
        let skin = if k % 2 == 0 { m.rust } else { m.steel };
        s.object_at("tank", place(x, y, 0.0, k as f32));
        w::tank(s, r, h, skin, m.dark);
    }
}

/// Racks along the walls, crates on the floor.
fn stock(s: &mut Scene, m: &Palette) {
    for (seed, x, y, heading) in [
        (330, 10.0, 0.8, PI),
        (331, 18.0, 0.8, PI),
        (332, 0.9, 12.0, FRAC_PI_2),
        (333, 29.1, 14.0, -FRAC_PI_2),
    ] {
        s.object_at("rack", place(x, y, 0.0, heading));
        w::storage_rack(s, 6.0, 4.2, m.dark, m.wood, m.rust, seed);
    }
    let crates = [
        (11.5, 13.5, 1.2),
        (12.6, 13.2, 0.9),
        (11.8, 14.7, 0.8),
        (19.0, 14.5, 1.1),
        (19.9, 15.6, 1.3),
        (4.0, 4.5, 1.0),
        (25.0, 14.0, 1.0),
    ];
    for (k, (x, y, size)) in crates.into_iter().enumerate() {
        s.object_at("crate", place(x, y, 0.0, 0.7 * k as f32));
        w::crate_box(s, size, m.wood);
    }
}

/// Girders, crane and lamps.
fn roof(s: &mut Scene, m: &Palette) {
    for k in 0..6 {
        let y = 2.5 + 5.0 * k as f32;
        s.object("girder");
        s.bar(p(0.0, y, 10.2), p(30.0, y, 10.2), 0.12, m.rust);
        s.bar(p(0.0, y, 11.6), p(30.0, y, 11.6), 0.12, m.rust);
        for i in 0..10 {
            let x = 3.0 * i as f32;
            s.bar(p(x, y, 10.2), p(x + 1.5, y, 11.6), 0.07, m.rust);
            s.bar(p(x + 1.5, y, 11.6), p(x + 3.0, y, 10.2), 0.07, m.rust);
        }
    }
    s.object("crane");
    s.cuboid([0.0, 12.0, 8.6], [30.0, 12.5, 9.3], m.paint);
    s.cuboid([13.0, 11.8, 8.2], [14.4, 12.7, 9.5], m.steel);
    s.bar(p(13.7, 12.25, 8.2), p(13.7, 12.25, 5.5), 0.03, m.dark);
    s.sphere([13.7, 12.25, 5.3], 0.25, m.dark);
    let glow = s.material(Material::plain(0.9).glowing(1.1));
    for i in 0..3 {
        for j in 0..3 {
            let pose = place(5.0 + 10.0 * i as f32, 5.0 + 10.0 * j as f32, 9.9, 0.0);
            s.object_at("hall lamp", pose);
            w::ceiling_panel(s, [1.4, 1.4], glow, 90.0);
        }
    }
}

/// A gallery along the north wall with stairs, columns, pipes along the walls.
fn galleries(s: &mut Scene, m: &Palette) {
    s.object("gallery");
    s.cuboid([9.5, 27.2, 3.4], [23.5, 30.0, 3.6], m.paint);
    for k in 0..8 {
        let x = 9.7 + 1.95 * k as f32;
        s.bar(p(x, 27.3, 3.6), p(x, 27.3, 4.7), 0.03, m.dark);
        if k % 2 == 0 {
            s.cuboid([x - 0.1, 27.3, 0.0], [x + 0.1, 27.5, 3.4], m.steel);
        }
    }
    s.bar(p(9.5, 27.3, 4.7), p(23.5, 27.3, 4.7), 0.035, m.dark);
    s.object("stairs");
    for k in 0..17 {
        let (x, z) = (18.4 + 0.28 * k as f32, 0.2 * k as f32);
        s.cuboid([x, 26.0, z + 0.16], [x + 0.3, 27.1, z + 0.2], m.steel);
    }
    s.bar(p(18.4, 26.0, 1.1), p(23.2, 26.0, 4.5), 0.03, m.dark);
    s.object("pipes");
    for (k, z) in [2.2f32, 2.7, 5.2].into_iter().enumerate() {
        let r = 0.12 + 0.05 * k as f32;
        s.bar(p(0.3, 0.5, z), p(0.3, 29.5, z), r, m.rust);
        s.bar(p(29.7, 0.5, z), p(29.7, 29.5, z), r, m.steel);
        s.bar(p(0.5, 29.7, z + 2.2), p(29.5, 29.7, z + 2.2), r, m.rust);
    }
    s.object("columns");
    for at in [[10.0, 10.5], [20.0, 10.5], [10.0, 18.5], [20.0, 18.5]] {
        s.post(at, 0.25, [0.0, 10.2], m.steel);
        s.post(at, 0.5, [0.0, 0.4], m.paint);
    }
}
