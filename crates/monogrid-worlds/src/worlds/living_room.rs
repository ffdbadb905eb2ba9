//! A furnished living room of 6 x 5 x 2.6 m.

use super::furniture as f;
use crate::patterns;
use crate::scene::{Material, MaterialId, Scene, place, place_tilted};
use crate::shapes::{BoxFaces, p};
use std::f32::consts::{FRAC_PI_2, PI};

/// Inner size, m.
pub(super) const SIZE_M: [f32; 3] = [6.0, 5.0, 2.6];

/// Materials that several pieces share.
struct Palette {
    white: MaterialId,
    oak: MaterialId,
    walnut: MaterialId,
    linen: MaterialId,
    dark: MaterialId,
    metal: MaterialId,
    leaf: MaterialId,
    clay: MaterialId,
    shade: MaterialId,
}

impl Palette {
    fn new(s: &mut Scene) -> Self {
        let palette = Self {
            white: s.plain(0.74),
            oak: s.tiled(patterns::wood(0.40, 0.55, 21), 1.4, 0.7),
            walnut: s.tiled(patterns::wood(0.17, 0.75, 22), 1.2, 0.6),
            linen: s.tiled(patterns::fabric(0.42, 0.55, 60, 23), 0.6, 0.6),
            dark: s.plain(0.05),
            metal: s.plain(0.33),
            leaf: s.tiled(patterns::rough(0.17, 0.9, 5, 0.6, 24), 0.15, 0.15),
            clay: s.plain(0.30),
            shade: s.material(Material::plain(0.75).glowing(0.85)),
        };
        for (id, colour) in [
            (palette.oak, f::WOOD),
            (palette.walnut, f::WALNUT),
            (palette.linen, f::CREAM),
            (palette.leaf, f::GREEN),
            (palette.clay, f::CLAY),
            (palette.shade, f::CREAM),
        ] {
            s.tinted(id, colour);
        }
        palette
    }
}

/// How the surfaces are covered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Covering {
    /// Wallpaper, boards, printed cloth.
    Patterned,
    /// Everything large in one tone: only pictures, books and small things have texture.
    Blank,
}

/// Builds the room.
pub(super) fn scene(covering: Covering) -> Scene {
    let mut scene = Scene::default();
    let s = &mut scene;
    shell(s);
    let palette = Palette::new(s);
    north_side(s, &palette);
    cupboard(s, &palette);
    west_side(s, &palette);
    south_side(s, &palette);
    east_side(s, &palette);
    middle(s, &palette);
    pictures(s, &palette);
    leaning_picture(s, &palette);
    if covering == Covering::Blank {
        blank_large_surfaces(s);
    }
    scene
}

/// Takes the texture from the materials that cover most area, until 70 % of the surface has none.
fn blank_large_surfaces(s: &mut Scene) {
    let mut areas = vec![0.0f32; s.materials.len()];
    for patch in &s.patches {
        areas[patch.material] += patch.area_m2();
    }
    let total: f32 = areas.iter().sum();
    let is_plain = |s: &Scene, id: MaterialId| s.materials[id].texture.is_none();
    let plain = (0..areas.len()).filter(|&id| is_plain(s, id));
    let mut plain: f32 = plain.map(|id| areas[id]).sum();
    let mut order: Vec<MaterialId> = (0..areas.len()).filter(|&id| !is_plain(s, id)).collect();
    order.sort_by(|&a, &b| areas[b].total_cmp(&areas[a]).then(a.cmp(&b)));
    for id in order {
        if plain >= 0.70 * total {
            break;
        }
        s.materials[id].texture = None;
        plain += areas[id];
    }
}

/// Walls, floor, ceiling, skirting.
fn shell(s: &mut Scene) {
    s.object("room");
    let [x, y, _] = SIZE_M;
    let floor = s.tiled(patterns::planks(0.33, 0.6, 12, 1), 2.4, 1.8);
    let plaster = s.plain(0.68);
    let ceiling = s.plain(0.80);
    let paper = s.tiled(patterns::foliage(0.46, 0.36, 2), 0.9, 0.9);
    for (id, colour) in [(floor, f::WOOD), (plaster, f::CREAM), (paper, f::SAGE)] {
        s.tinted(id, colour);
    }
    s.room(SIZE_M, [floor, ceiling], [plaster, plaster, plaster, paper]);
    let trim = s.plain(0.72);
    s.cuboid([0.0, 0.0, 0.0], [x, 0.018, 0.08], trim);
    s.cuboid([0.0, y - 0.018, 0.0], [x, y, 0.08], trim);
    s.cuboid([0.0, 0.018, 0.0], [0.018, y - 0.018, 0.08], trim);
    s.cuboid([x - 0.018, 0.018, 0.0], [x, y - 0.018, 0.08], trim);
}

/// Sofa, side table, floor lamp.
fn north_side(s: &mut Scene, m: &Palette) {
    s.object_at("sofa", place(2.3, 4.50, 0.0, 0.0));
    f::sofa(s, 2.1, 3, m.linen, m.dark);
    let print = s.fitted(patterns::foliage(0.62, 0.12, 31));
    let stripes = s.fitted(patterns::painting(32));
    let plain = s.plain(0.16);
    for (x, cover, colour, turn) in [
        (1.60, print, f::OCHRE, 0.3),
        (2.05, plain, f::BLUE, -0.2),
        (2.95, stripes, f::RED, -0.4),
    ] {
        s.tinted(cover, colour);
        s.object_at("cushion", place(x, 4.42, 0.50, turn));
        f::cushion(s, 0.42, cover);
    }
    s.object_at("floor lamp", place(0.75, 4.55, 0.0, 0.0));
    f::floor_lamp(s, 1.62, m.metal, m.shade);
    s.object_at("side table", place(3.75, 4.60, 0.0, 0.0));
    f::round_table(s, 0.25, 0.55, m.walnut, m.walnut);
    s.object_at("vase", place(3.70, 4.58, 0.55, 0.0));
    f::vase(s, 0.30, m.clay);
}

/// Cupboard and what stands on it.
fn cupboard(s: &mut Scene, m: &Palette) {
    let glaze = s.tiled(patterns::marble(0.5, 33), 0.4, 0.4);
    s.object_at("cupboard", place(5.0, 4.74, 0.0, 0.0));
    f::cupboard(s, [1.5, 0.45, 0.85], 3, 1, m.oak, m.dark);
    s.object_at("table lamp", place(4.5, 4.74, 0.85, 0.0));
    f::table_lamp(s, glaze, m.shade);
    s.object_at("bowl", place(5.1, 4.72, 0.85, 0.0));
    f::bowl(s, 0.17, glaze);
    s.tinted(glaze, f::BLUE);
    for (x, h, tone) in [(5.42, 0.24, 0.1), (5.55, 0.17, 0.6), (5.65, 0.21, 0.35)] {
        let paint = s.plain(tone);
        s.tinted(paint, f::GREEN);
        s.object_at("bottle", place(x, 4.74, 0.85, 0.0));
        let heights = [h, 0.75 * h, 0.55 * h, 0.0, 0.0];
        s.lathe(&[0.012, 0.014, 0.04, 0.042, 0.0], &heights, 20, paint);
    }
}

/// Window with curtains, radiator, armchair, plant.
fn west_side(s: &mut Scene, m: &Palette) {
    let view = s.material(Material::fitted(patterns::outdoors(41)).glowing(0.95));
    s.tinted(view, f::BLUE);
    s.object_at("window", place(0.0, 2.3, 0.95, FRAC_PI_2));
    f::window(s, 1.7, 1.3, view, m.white, 9.0);
    let cloth = s.tiled(patterns::foliage(0.55, 0.28, 42), 0.7, 0.7);
    s.tinted(cloth, f::OCHRE);
    for y in [1.10, 3.50] {
        s.object_at("curtain", place(0.14, y, 2.42, FRAC_PI_2));
        s.curtain(0.62, 2.36, 5.0, 0.045, cloth);
    }
    s.object("curtain rod");
    s.bar(p(0.14, 0.7, 2.44), p(0.14, 3.9, 2.44), 0.014, m.dark);
    s.object_at("radiator", place(0.02, 2.3, 0.0, FRAC_PI_2));
    f::radiator(s, 1.3, 0.58, m.white);
    let tweed = s.tiled(patterns::fabric(0.20, 0.8, 40, 43), 0.5, 0.5);
    s.tinted(tweed, f::BLUE);
    s.object_at("armchair", place(0.85, 3.55, 0.0, FRAC_PI_2 - 0.45));
    f::sofa(s, 0.95, 1, tweed, m.dark);
    s.object_at("tall plant", place(0.50, 0.50, 0.0, 0.0));
    f::plant(s, 1.65, 34, m.clay, m.leaf, 44);
    s.object_at("small plant", place(0.10, 2.75, 0.92, 0.0));
    s.at(place(0.03, 0.0, 0.0, 0.0), |s| {
        f::plant(s, 0.50, 14, m.white, m.leaf, 45);
    });
}

/// Television on its board, speakers, tall shelf, door.
fn south_side(s: &mut Scene, m: &Palette) {
    s.object_at("television board", place(2.0, 0.26, 0.0, PI));
    let body = BoxFaces {
        sides: m.white,
        ..m.oak.into()
    };
    f::cupboard(s, [1.9, 0.42, 0.45], 4, 1, body, m.metal);
    let show = s.material(Material::fitted(patterns::landscape(51)).glowing(0.55));
    s.tinted(show, f::GREEN);
    s.object_at("television", place(2.0, 0.24, 0.45, PI));
    f::television(s, 1.15, show, m.dark);
    for x in [0.95 - 0.12, 3.05 + 0.12] {
        s.object_at("speaker", place(x, 0.24, 0.0, PI));
        f::speaker(s, 0.85, m.walnut, m.dark);
    }
    s.object_at("bookshelf", place(3.90, 0.16, 0.0, PI));
    f::bookshelf(s, 0.95, 2.05, 6, m.oak, 52);
    s.object_at("door", place(5.2, 0.0, 0.0, PI));
    f::door(s, 0.86, 2.02, m.white, m.metal);
}

/// Dining table with chairs, second shelf, low shelf with a clock above.
fn east_side(s: &mut Scene, m: &Palette) {
    s.object_at("dining table", place(4.95, 2.35, 0.0, 0.1));
    f::table(s, [0.9, 1.5, 0.75], m.walnut, m.walnut);
    let chairs = [
        (4.27, 2.0, -FRAC_PI_2),
        (4.33, 2.75, -FRAC_PI_2 - 0.25),
        (5.62, 2.6, FRAC_PI_2 + 0.1),
        (4.95, 1.38, 0.2),
    ];
    for (x, y, heading) in chairs {
        // a chair's back is at +y of its own frame, away from the table
        s.object_at("chair", place(x, y, 0.0, heading + PI));
        f::chair(s, m.oak, m.clay);
    }
    let runner = s.fitted(patterns::rug(61));
    s.tinted(runner, f::RED);
    s.object_at("table runner", place(4.95, 2.35, 0.751, 0.1));
    s.cuboid([-0.2, -0.7, 0.0], [0.2, 0.7, 0.004], runner);
    let pottery = s.tiled(patterns::rough(0.35, 0.7, 4, 0.55, 62), 0.3, 0.3);
    s.tinted(pottery, f::OCHRE);
    s.object_at("jug", place(4.9, 2.6, 0.755, 0.0));
    f::vase(s, 0.26, pottery);
    s.object_at("mug", place(4.75, 2.15, 0.751, 0.6));
    f::mug(s, m.white);
    s.object_at("mug", place(5.2, 2.3, 0.751, 2.6));
    f::mug(s, m.dark);
    s.object_at("fruit bowl", place(5.0, 2.0, 0.755, 0.0));
    f::bowl(s, 0.14, m.clay);
    for (x, y, z) in [
        (0.05, 0.0, 0.06),
        (-0.05, 0.03, 0.06),
        (0.0, -0.05, 0.065),
        (0.0, 0.01, 0.11),
    ] {
        s.sphere([x, y, z], 0.042, pottery);
    }
    s.object_at("wall shelf", place(5.82, 3.95, 0.0, -FRAC_PI_2));
    f::bookshelf(s, 1.1, 1.45, 4, m.walnut, 63);
    s.object_at("globe", place(5.80, 3.75, 1.44, 0.0));
    let land = s.fitted(patterns::landscape(64));
    s.tinted(land, f::BLUE);
    s.cylinder(0.07, 0.02, m.dark);
    s.at(place(0.0, 0.0, 0.16, 0.4), |s| {
        s.sphere([0.0; 3], 0.13, land);
    });
    s.object_at("clock", place(6.0, 1.0, 1.85, -FRAC_PI_2));
    f::clock(s, 0.17, m.white, m.dark);
    s.object_at("bin", place(5.7, 0.9, 0.0, 0.0));
    f::basket(s, 0.15, 0.32, m.metal);
}

/// Rug, coffee table and what lies around.
fn middle(s: &mut Scene, m: &Palette) {
    let rug = s.fitted(patterns::rug(71));
    s.tinted(rug, f::RED);
    s.object_at("rug", place(2.3, 3.05, 0.0, 0.04));
    s.cuboid([-1.25, -0.85, 0.0], [1.25, 0.85, 0.012], rug);
    s.object_at("coffee table", place(2.35, 3.20, 0.0, 0.08));
    f::table(s, [1.10, 0.60, 0.42], m.oak, m.dark);
    let covers: Vec<MaterialId> = (0..3).map(|k| s.fitted(patterns::poster(72 + k))).collect();
    for (cover, colour) in covers.iter().zip(f::PRINTS) {
        s.tinted(*cover, colour);
    }
    s.object_at("magazines", place(2.15, 3.17, 0.42, 0.3));
    f::magazines(s, &covers, 75);
    s.object_at("mug", place(2.68, 3.30, 0.42, 0.9));
    f::mug(s, m.clay);
    s.object_at("candle", place(2.55, 3.08, 0.42, 0.0));
    s.cylinder(0.035, 0.14, m.white);
    let knit = s.tiled(patterns::fabric(0.30, 0.9, 24, 76), 0.35, 0.35);
    s.tinted(knit, f::GREEN);
    s.object_at("pouf", place(3.55, 2.95, 0.21, 0.0));
    s.cushion([0.27, 0.27, 0.21], 0.6, knit);
    let weave = s.tiled(patterns::fabric(0.36, 1.0, 16, 77), 0.3, 0.3);
    s.tinted(weave, f::WOOD);
    s.object_at("basket", place(1.05, 2.45, 0.0, 0.0));
    f::basket(s, 0.2, 0.30, weave);
    let ball = s.fitted(patterns::tiles(0.6, 1.2, 6, 78));
    s.tinted(ball, f::BLUE);
    s.object_at("ball", place(3.55, 3.85, 0.11, 0.0));
    s.sphere([0.0; 3], 0.11, ball);
    s.object_at("toy box", place(1.1, 1.35, 0.0, 0.5));
    let crate_wood = s.tiled(patterns::planks(0.45, 0.7, 5, 79), 0.6, 0.4);
    s.tinted(crate_wood, f::WOOD);
    s.cuboid([-0.22, -0.16, 0.0], [0.22, 0.16, 0.26], crate_wood);
    s.object_at("ceiling lamp", place(3.0, 2.5, 2.6, 0.0));
    s.bar(p(0.0, 0.0, 0.0), p(0.0, 0.0, -0.35), 0.008, m.dark);
    s.at(place(0.0, 0.0, -0.62, 0.0), |s| {
        s.lathe(&[0.08, 0.24, 0.26], &[0.28, 0.10, 0.0], 32, m.shade);
    });
    s.light_below([-0.2, -0.2, -0.64], [0.4, 0.4], 28.0);
}

/// Pictures on the walls.
fn pictures(s: &mut Scene, m: &Palette) {
    use patterns::{landscape, painting, poster};
    let north = |x, z| place(x, 5.0, z, 0.0);
    let east = |y, z| place(6.0, y, z, -FRAC_PI_2);
    let pictures = [
        (north(1.75, 1.25), [0.9, 0.7], painting(81), m.dark),
        (north(2.95, 1.35), [0.6, 0.45], landscape(82), m.walnut),
        (north(5.0, 1.45), [0.8, 0.6], painting(83), m.dark),
        (east(2.45, 1.10), [0.75, 1.05], poster(84), m.dark),
        (east(1.65, 1.35), [0.4, 0.5], landscape(85), m.white),
        (
            place(2.0, 0.0, 1.45, PI),
            [1.1, 0.6],
            painting(86),
            m.walnut,
        ),
    ];
    for ((pose, size, image, frame), colour) in pictures.into_iter().zip(f::PRINTS) {
        let image = s.fitted(image);
        s.tinted(image, colour);
        s.object_at("picture", pose);
        f::picture(s, size, image, frame);
    }
}

fn leaning_picture(s: &mut Scene, m: &Palette) {
    let pose = place_tilted(5.75, 4.93, 0.855, [-0.12, 0.0, 0.0]);
    s.object_at("leaning picture", pose);
    let image = s.fitted(patterns::landscape(87));
    s.tinted(image, f::SAGE);
    f::picture(s, [0.25, 0.35], image, m.white);
}
