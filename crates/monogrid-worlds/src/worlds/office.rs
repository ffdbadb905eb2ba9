//! An office of 7 x 8 x 3.5 m for six people.

use super::furniture as f;
use super::workplace::{self as w, Office};
use crate::patterns;
use crate::scene::{Material, Scene, place};
use crate::shapes::p;
use std::f32::consts::{FRAC_PI_2, PI};

/// Inner size, m.
const SIZE_M: [f32; 3] = [7.0, 8.0, 3.5];

/// Builds the office.
pub(super) fn scene() -> Scene {
    let mut scene = Scene::default();
    let s = &mut scene;
    shell(s);
    let m = Office::new(s, 200);
    places(s, &m);
    walls(s, &m);
    windows_and_pictures(s, &m);
    lamps(s);
    scene
}

fn shell(s: &mut Scene) {
    s.object("room");
    let [x, _, z] = SIZE_M;
    let carpet = s.tiled(patterns::tiles(0.20, 0.5, 6, 201), 3.0, 3.0);
    let plaster = s.plain(0.66);
    let ceiling = s.tiled(patterns::tiles(0.72, 0.06, 4, 202), 2.5, 2.5);
    let brick = s.tiled(patterns::bricks(0.42, 12, 203), 2.1, 1.6);
    let walls = [plaster, plaster, plaster, brick];
    s.room(SIZE_M, [carpet, ceiling], walls);
    s.object("column");
    s.cuboid([4.55, 5.35, 0.0], [4.95, 5.75, z], plaster);
    s.object("beam");
    s.cuboid([0.0, 5.35, z - 0.35], [x, 5.75, z], plaster);
}

fn places(s: &mut Scene, m: &Office) {
    let desks = [
        (0.85, 2.2, FRAC_PI_2),
        (0.85, 4.4, FRAC_PI_2),
        (6.1, 2.0, -FRAC_PI_2),
        (6.1, 4.2, -FRAC_PI_2),
        (2.2, 7.2, 0.0),
        (4.6, 7.2, 0.0),
    ];
    for (k, (x, y, heading)) in desks.into_iter().enumerate() {
        // who sits there looks at the wall: the desk's back is its +y
        s.object_at("desk", place(x, y, 0.0, heading));
        w::desk(s, m, 1.6, 210 + k as u64);
        let turn = 0.5 * (k as f32 * 2.1).sin();
        let (dx, dy) = (heading.sin() * 0.75, -heading.cos() * 0.75);
        s.object_at("chair", place(x + dx, y + dy, 0.0, heading + PI + turn));
        w::office_chair(s, m);
    }
    for (x, y) in [(0.8, 3.3), (6.2, 3.1)] {
        s.object_at("partition", place(x, y, 0.0, 0.0));
        w::partition(s, m, 1.5, 1.35);
    }
    s.object_at("meeting table", place(3.4, 3.5, 0.0, 0.15));
    f::round_table(s, 0.6, 0.73, m.beech, m.grey);
    for a in [0.4f32, 2.4, 4.4] {
        let (x, y) = (3.4 + 0.85 * a.cos(), 3.5 + 0.85 * a.sin());
        s.object_at("visitor's chair", place(x, y, 0.0, a - FRAC_PI_2));
        f::chair(s, m.grey, m.cloth);
    }
    s.object_at("papers", place(3.4, 3.5, 0.73, 0.7));
    f::magazines(s, &m.papers, 230);
    s.object_at("coffee mug", place(3.65, 3.7, 0.73, 0.0));
    f::mug(s, m.dark);
}

fn walls(s: &mut Scene, m: &Office) {
    s.object_at("bookshelf", place(2.2, 0.17, 0.0, PI));
    f::bookshelf(s, 1.2, 2.1, 6, m.beech, 240);
    s.object_at("second bookshelf", place(3.45, 0.17, 0.0, PI));
    f::bookshelf(s, 1.2, 2.1, 6, m.beech, 241);
    s.object_at("door", place(5.3, 0.0, 0.0, PI));
    f::door(s, 0.9, 2.1, m.beech, m.dark);
    s.object_at("copier", place(6.55, 0.6, 0.0, -FRAC_PI_2));
    w::copier(s, m);
    for k in 0..3 {
        let x = 0.35 + 0.47 * k as f32;
        s.object_at("file cabinet", place(x, 0.33, 0.0, PI));
        w::file_cabinet(s, m, [0.46, 0.6, 1.32], 4);
    }
    s.object_at("plant", place(6.55, 7.4, 0.0, 0.0));
    f::plant(s, 1.9, 30, m.grey, m.leaf, 242);
    s.object_at("small plant", place(0.8, 0.32, 1.32, 0.0));
    f::plant(s, 0.6, 16, m.white, m.leaf, 243);
    s.object_at("water cooler", place(0.3, 7.6, 0.0, 0.0));
    s.rounded_box([0.0, 0.0, 0.48], [0.32, 0.32, 0.96], 0.03, m.white);
    let (radii, heights) = ([0.0, 0.13, 0.135, 0.05], [1.38, 1.36, 1.05, 0.97]);
    s.lathe(&radii, &heights, 28, m.grey);
    s.object_at("coat stand", place(6.7, 6.3, 0.0, 0.0));
    s.bar(p(0.0, 0.0, 0.0), p(0.0, 0.0, 1.75), 0.02, m.dark);
    s.cylinder(0.2, 0.03, m.dark);
    s.at(place(0.05, 0.0, 1.15, 0.0), |s| {
        s.cushion([0.12, 0.2, 0.45], 0.7, m.cloth);
    });
    s.object_at("whiteboard", place(7.0, 5.6, 1.0, -FRAC_PI_2));
    w::whiteboard(s, m, 1.6, 1.1, 244);
    s.object_at("clock", place(4.2, 0.0, 2.55, PI));
    f::clock(s, 0.2, m.white, m.dark);
}

fn windows_and_pictures(s: &mut Scene, m: &Office) {
    let view = s.material(Material::fitted(patterns::outdoors(245)).glowing(0.95));
    for y in [2.0, 4.6] {
        s.object_at("window", place(0.0, y, 1.15, FRAC_PI_2));
        f::window(s, 1.9, 1.6, view, m.white, 7.0);
    }
    let east = |y, z| place(7.0, y, z, -FRAC_PI_2);
    let north = |x, z| place(x, 8.0, z, 0.0);
    let pictures = [
        (east(1.6, 1.35), patterns::poster(246), [0.7, 1.0]),
        (east(3.6, 1.45), patterns::landscape(247), [1.0, 0.7]),
        (north(1.6, 1.45), patterns::painting(248), [0.9, 0.9]),
        (north(3.4, 1.40), patterns::poster(249), [0.75, 1.05]),
        (north(5.2, 1.50), patterns::painting(250), [1.1, 0.7]),
        (
            place(0.0, 6.7, 1.40, FRAC_PI_2),
            patterns::poster(251),
            [0.7, 1.0],
        ),
    ];
    for (pose, image, size) in pictures {
        let image = s.fitted(image);
        s.object_at("picture", pose);
        f::picture(s, size, image, m.dark);
    }
}

fn lamps(s: &mut Scene) {
    let glow = s.material(Material::plain(0.9).glowing(1.1));
    for i in 0..2 {
        for j in 0..3 {
            let pose = place(1.9 + 3.2 * i as f32, 1.4 + 2.5 * j as f32, SIZE_M[2], 0.0);
            s.object_at("ceiling lamp", pose);
            w::ceiling_panel(s, [1.2, 0.3], glow, 9.0);
        }
    }
}
