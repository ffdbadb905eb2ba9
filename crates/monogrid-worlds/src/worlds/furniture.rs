//! Pieces of furniture, each around its own origin on the floor with its front towards -y.

use crate::patterns;
use crate::random::Random;
use crate::scene::{MaterialId, Scene, place, place_tilted};
use crate::shapes::{BoxFaces, p};
use std::f32::consts::TAU;

/// Colours of things, red, green and blue.
pub(super) const WOOD: [f32; 3] = [0.78, 0.56, 0.34];
pub(super) const WALNUT: [f32; 3] = [0.60, 0.38, 0.25];
pub(super) const CREAM: [f32; 3] = [1.0, 0.95, 0.84];
pub(super) const GREEN: [f32; 3] = [0.34, 0.60, 0.24];
pub(super) const SAGE: [f32; 3] = [0.62, 0.74, 0.60];
pub(super) const BLUE: [f32; 3] = [0.32, 0.48, 0.78];
pub(super) const RED: [f32; 3] = [0.78, 0.30, 0.24];
pub(super) const CLAY: [f32; 3] = [0.80, 0.45, 0.30];
pub(super) const OCHRE: [f32; 3] = [0.86, 0.66, 0.28];

/// Colours of printed things, one after the other.
pub(super) const PRINTS: [[f32; 3]; 6] = [BLUE, OCHRE, RED, SAGE, CLAY, GREEN];

/// Upholstered seat for one or more: base, back, arms, seat cushions, feet.
pub(super) fn sofa(s: &mut Scene, width: f32, seats: usize, cover: MaterialId, feet: MaterialId) {
    let depth = 0.88;
    let inner = width - 0.40;
    let base = [width - 0.1, depth - 0.06, 0.26];
    s.rounded_box([0.0, 0.0, 0.24], base, 0.05, cover);
    s.at(place_tilted(0.0, 0.33, 0.56, [-0.16, 0.0, 0.0]), |s| {
        s.rounded_box([0.0; 3], [width - 0.12, 0.22, 0.62], 0.09, cover);
    });
    for side in [-1.0, 1.0] {
        let arm = [side * (0.5 * width - 0.10), 0.0, 0.36];
        s.rounded_box(arm, [0.21, depth, 0.50], 0.08, cover);
        for y in [-0.36, 0.36] {
            s.at(place(side * (0.5 * width - 0.14), y, 0.0, 0.0), |s| {
                s.cylinder(0.025, 0.12, feet);
            });
        }
    }
    let seat = inner / seats as f32;
    for k in 0..seats {
        let x = -0.5 * inner + (k as f32 + 0.5) * seat;
        s.rounded_box([x, -0.09, 0.43], [seat - 0.015, 0.66, 0.16], 0.06, cover);
        s.at(place_tilted(x, 0.20, 0.68, [-0.22, 0.0, 0.0]), |s| {
            s.rounded_box([0.0; 3], [seat - 0.03, 0.16, 0.42], 0.07, cover);
        });
    }
}

/// Loose cushion leaning back.
pub(super) fn cushion(s: &mut Scene, size: f32, cover: MaterialId) {
    let half = 0.5 * size;
    s.at(place_tilted(0.0, 0.0, half, [-0.35, 0.12, 0.0]), |s| {
        s.cushion([half, 0.085, half], 0.55, cover);
    });
}

/// Table with a top and four legs.
pub(super) fn table(s: &mut Scene, size: [f32; 3], top: MaterialId, legs: MaterialId) {
    let [w, d, h] = [0.5 * size[0], 0.5 * size[1], size[2]];
    let (low, high) = (h - 0.11, h - 0.035);
    s.cuboid([-w, -d, high], [w, d, h], top);
    for (front, back) in [(-d + 0.05, -d + 0.07), (d - 0.07, d - 0.05)] {
        s.cuboid([-w + 0.06, front, low], [w - 0.06, back, high], legs);
    }
    for (x, y) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        let leg = [x * (w - 0.06), y * (d - 0.06)];
        s.post(leg, 0.03, [0.0, high], legs);
    }
}

/// Round table on one turned leg.
pub(super) fn round_table(
    s: &mut Scene,
    radius: f32,
    height: f32,
    top: MaterialId,
    leg: MaterialId,
) {
    s.at(place(0.0, 0.0, height - 0.03, 0.0), |s| {
        s.cylinder(radius, 0.03, top);
    });
    let foot = 0.6 * radius;
    let radii = [0.035, 0.03, 0.05, 0.025, 0.03, foot, foot];
    let turns = [0.6, 0.45, 0.3].map(|share| share * height);
    let heights = [&[height - 0.03], &turns[..], &[0.06, 0.025, 0.0]].concat();
    s.lathe(&radii, &heights, 24, leg);
}

/// Chair with a slatted back.
pub(super) fn chair(s: &mut Scene, wood: MaterialId, seat: MaterialId) {
    s.rounded_box([0.0, 0.0, 0.455], [0.44, 0.43, 0.05], 0.02, seat);
    for x in [-0.19, 0.19] {
        s.bar(p(x, -0.19, 0.0), p(x, -0.18, 0.44), 0.018, wood);
        s.bar(p(x, 0.23, 0.0), p(x, 0.19, 0.46), 0.018, wood);
        s.bar(p(x, 0.19, 0.46), p(x, 0.27, 0.95), 0.016, wood);
    }
    for k in 0..4 {
        let z = 0.58 + 0.11 * k as f32;
        let y = 0.19 + (z - 0.46) * 0.163;
        let (min, max) = ([-0.19, y - 0.008, z - 0.025], [0.19, y + 0.008, z + 0.025]);
        s.cuboid(min, max, wood);
    }
}

/// Shelf with boards of the given number, filled with books and small things.
pub(super) fn bookshelf(
    s: &mut Scene,
    width: f32,
    height: f32,
    boards: usize,
    wood: MaterialId,
    seed: u64,
) {
    let (half, back) = (0.5 * width, 0.5 * 0.28);
    s.cuboid([-half, -back, 0.0], [-half + 0.025, back, height], wood);
    s.cuboid([half - 0.025, -back, 0.0], [half, back, height], wood);
    s.cuboid([-half, back - 0.012, 0.0], [half, back, height], wood);
    let mut random = Random::new(seed);
    let books = book_covers(s, seed);
    let pitch = (height - 0.06) / boards as f32;
    for k in 0..=boards {
        let z = 0.04 + k as f32 * pitch;
        let min = [-half + 0.02, -back, z - 0.02];
        s.cuboid(min, [half - 0.02, back, z], wood);
        if k < boards {
            let inside = [-half + 0.03, half - 0.03];
            book_row(s, &mut random, &books, inside, [z, pitch]);
        }
    }
}

/// Covers to choose from: half printed, half plain.
fn book_covers(s: &mut Scene, seed: u64) -> Vec<MaterialId> {
    let mut random = Random::new(seed ^ 0xB00C);
    let cover = |k| {
        let tone = random.range(0.06, 0.75);
        let cover = match k % 3 {
            0 => s.plain(tone),
            _ => s.fitted(patterns::spine(tone, seed + k)),
        };
        s.tinted(cover, PRINTS[k as usize % PRINTS.len()]);
        cover
    };
    (0..14).map(cover).collect()
}

/// One board of books: standing, some leaning, gaps, a lying pile or a pot now and then.
fn book_row(s: &mut Scene, random: &mut Random, covers: &[MaterialId], x: [f32; 2], z: [f32; 2]) {
    let [mut at, end] = x;
    let [z, pitch] = z;
    while at < end - 0.06 {
        let kind = random.unit();
        if kind < 0.06 {
            at += random.range(0.05, 0.16);
        } else if kind < 0.10 && end - at > 0.3 {
            let width = random.range(0.18, 0.25);
            let half = 0.5 * width;
            let mut level = z;
            for _ in 0..3 + random.below(3) {
                let thick = random.range(0.015, 0.04);
                let cover = covers[random.below(covers.len())];
                let turn = random.range(-0.08, 0.08);
                s.at(place(at + half, 0.0, level, turn), |s| {
                    s.cuboid([-half, -0.09, 0.0], [half, 0.09, thick], cover);
                });
                level += thick;
            }
            at += width + 0.02;
        } else {
            let thick = random.range(0.014, 0.050).min(end - at);
            let tall = random.range(0.55, 0.92) * (pitch - 0.03);
            let front = random.range(-0.12, -0.05);
            let cover = covers[random.below(covers.len())];
            let lean = if random.unit() < 0.07 { 0.14 } else { 0.0 };
            at += lean * tall;
            s.at(place_tilted(at, 0.0, z, [0.0, -lean, 0.0]), |s| {
                s.cuboid([0.0, front, 0.0], [thick, 0.10, tall], cover);
            });
            at += thick + 0.001;
        }
    }
}

/// Closed cupboard with doors or drawers and knobs.
pub(super) fn cupboard(
    s: &mut Scene,
    size: [f32; 3],
    doors: usize,
    rows: usize,
    body: impl Into<BoxFaces>,
    knob: MaterialId,
) {
    let body = body.into();
    let door = BoxFaces {
        top: body.sides,
        ..body
    };
    let [w, d, h] = [0.5 * size[0], 0.5 * size[1], size[2]];
    s.cuboid([-w, -d, 0.06], [w, d, h], body);
    let (min, max) = ([-w + 0.03, -d + 0.04, 0.0], [w - 0.03, d - 0.04, 0.06]);
    s.cuboid(min, max, body.sides);
    let (cw, ch) = ((size[0] - 0.03) / doors as f32, (h - 0.10) / rows as f32);
    for i in 0..doors {
        for j in 0..rows {
            let x = -w + 0.015 + i as f32 * cw;
            let z = 0.08 + j as f32 * ch;
            let min = [x + 0.008, -d - 0.018, z + 0.008];
            s.cuboid(min, [x + cw - 0.008, -d, z + ch - 0.008], door);
            s.sphere([x + 0.5 * cw, -d - 0.03, z + 0.7 * ch], 0.016, knob);
        }
    }
}

/// Framed picture hanging on a wall at y = 0, lower edge on z = 0.
pub(super) fn picture(s: &mut Scene, size: [f32; 2], image: MaterialId, frame: MaterialId) {
    let (b, t) = (0.035, 0.025);
    let (hw, h) = (0.5 * size[0], size[1]);
    s.panel([0.0, -0.010, 0.0], size[0], h, image);
    s.cuboid([-hw - b, -t, -b], [hw + b, -0.001, 0.0], frame);
    s.cuboid([-hw - b, -t, h], [hw + b, -0.001, h + b], frame);
    s.cuboid([-hw - b, -t, 0.0], [-hw, -0.001, h], frame);
    s.cuboid([hw, -t, 0.0], [hw + b, -0.001, h], frame);
}

/// Lamp on a stand with a conical shade.
pub(super) fn floor_lamp(s: &mut Scene, height: f32, metal: MaterialId, shade: MaterialId) {
    s.cylinder(0.15, 0.025, metal);
    s.bar(p(0.0, 0.0, 0.02), p(0.0, 0.0, height - 0.15), 0.013, metal);
    s.lathe(&[0.12, 0.23], &[height, height - 0.30], 32, shade);
}

/// Lamp for a sideboard: belly and shade.
pub(super) fn table_lamp(s: &mut Scene, base: MaterialId, shade: MaterialId) {
    let radii = [0.015, 0.02, 0.06, 0.085, 0.075, 0.05, 0.06];
    let heights = [0.30, 0.24, 0.19, 0.13, 0.06, 0.015, 0.0];
    s.lathe(&radii, &heights, 28, base);
    s.lathe(&[0.09, 0.15], &[0.47, 0.28], 28, shade);
}

/// Pot with a plant of bent leaves.
pub(super) fn plant(
    s: &mut Scene,
    height: f32,
    leaves: usize,
    pot: MaterialId,
    leaf: MaterialId,
    seed: u64,
) {
    let (radii, heights) = ([0.14, 0.17, 0.17, 0.12, 0.0], [0.27, 0.30, 0.26, 0.0, 0.0]);
    s.lathe(&radii, &heights, 28, pot);
    s.disc(0.15, 0.26, leaf);
    let mut random = Random::new(seed);
    for k in 0..leaves {
        let heading = TAU * (k as f32 * 0.618).fract();
        let rise = random.range(0.45, 1.0) * (height - 0.3);
        let reach = random.range(0.15, 0.45) * height.min(1.2);
        let width = random.range(0.03, 0.07);
        s.at(place(0.0, 0.0, 0.26, heading), |s| {
            s.patch(7, 2, leaf, |u, v| {
                // a stalk that rises and bends over, with a blade around it
                let x = reach * (0.15 * u + 0.85 * u * u);
                let z = rise * (1.45 * u - 0.55 * u * u * u);
                let blade = width * (3.0 * u * (1.05 - u)).max(0.05);
                let across = 2.0 * v - 1.0;
                p(x, across * blade, z + 0.3 * blade * across.abs())
            });
        });
    }
}

/// Turned vase.
pub(super) fn vase(s: &mut Scene, height: f32, material: MaterialId) {
    let down: [f32; 17] = std::array::from_fn(|k| k as f32 / 16.0);
    let radius = |t: f32| 0.26 + 0.20 * (3.9 * t - 0.9).sin() - 0.05 * t;
    let radii = down.map(|t| 0.6 * height * radius(t).max(0.05));
    s.lathe(&radii, &down.map(|t| height * (1.0 - t)), 28, material);
}

/// Bowl, open at the top.
pub(super) fn bowl(s: &mut Scene, radius: f32, material: MaterialId) {
    let down: [f32; 9] = std::array::from_fn(|k| k as f32 / 8.0 * 1.45);
    let radii = down.map(|t| radius * t.cos().max(0.12));
    let heights = down.map(|t| 0.55 * radius * (1.0 - t.sin()));
    s.lathe(&radii, &heights, 28, material);
}

/// Mug with a handle.
pub(super) fn mug(s: &mut Scene, material: MaterialId) {
    let radii = [0.036, 0.038, 0.041, 0.041, 0.0];
    s.lathe(&radii, &[0.01, 0.095, 0.095, 0.0, 0.0], 20, material);
    s.at(place_tilted(0.048, 0.0, 0.05, [TAU / 4.0, 0.0, 0.0]), |s| {
        s.torus(0.0, 0.026, 0.006, material);
    });
}

/// Flat screen on a foot.
pub(super) fn television(s: &mut Scene, width: f32, screen: MaterialId, case: MaterialId) {
    let (half, height) = (0.5 * width, 0.58 * width);
    s.cuboid([-0.25, -0.12, 0.0], [0.25, 0.12, 0.015], case);
    s.cuboid([-0.04, -0.01, 0.0], [0.04, 0.03, 0.10], case);
    s.cuboid([-half, -0.02, 0.07], [half, 0.03, 0.07 + height], case);
    s.panel([0.0, -0.022, 0.085], width - 0.03, height - 0.03, screen);
}

/// Loudspeaker with two cones.
pub(super) fn speaker(s: &mut Scene, height: f32, body: MaterialId, cone: MaterialId) {
    s.cuboid([-0.11, -0.13, 0.0], [0.11, 0.13, height], body);
    for (z, r) in [(0.32 * height, 0.085), (0.72 * height, 0.055)] {
        s.at(place_tilted(0.0, -0.131, z, [TAU / 4.0, 0.0, 0.0]), |s| {
            let radii = [r, r * 0.9, 0.3 * r, 0.0];
            s.lathe(&radii, &[0.012, 0.0, -0.02, 0.0], 24, cone);
        });
    }
}

/// Ribbed radiator against a wall at y = 0.
pub(super) fn radiator(s: &mut Scene, width: f32, height: f32, metal: MaterialId) {
    let ribs = (width / 0.06) as usize;
    let half = 0.5 * width;
    for k in 0..ribs {
        let rib = [-half + (k as f32 + 0.5) * 0.06, -0.09, 0.12 + 0.5 * height];
        s.rounded_box(rib, [0.045, 0.09, height], 0.02, metal);
    }
    for z in [0.17, 0.07 + height] {
        s.bar(p(-half, -0.09, z), p(half, -0.09, z), 0.015, metal);
    }
}

/// Clock on a wall at y = 0, centred on the origin.
pub(super) fn clock(s: &mut Scene, radius: f32, face: MaterialId, dark: MaterialId) {
    s.at(place_tilted(0.0, 0.0, 0.0, [TAU / 4.0, 0.0, 0.0]), |s| {
        s.cylinder(radius, 0.03, face);
        s.torus(0.03, radius, 0.012, dark);
        for k in 0..12 {
            let a = TAU * k as f32 / 12.0;
            let (x, y) = (0.85 * radius * a.cos(), 0.85 * radius * a.sin());
            s.at(place(x, y, 0.0301, a), |s| {
                s.cuboid([-0.012, -0.004, 0.0], [0.012, 0.004, 0.002], dark);
            });
        }
        for (angle, length) in [(0.6, 0.5), (2.2, 0.75)] {
            s.at(place(0.0, 0.0, 0.033, angle), |s| {
                s.cuboid([-0.01, -0.005, 0.0], [length * radius, 0.005, 0.002], dark);
            });
        }
    });
}

/// Basket or bin, slightly conical and open.
pub(super) fn basket(s: &mut Scene, radius: f32, height: f32, weave: MaterialId) {
    let radii = [0.75 * radius, 0.95 * radius, radius, 0.8 * radius, 0.0];
    s.lathe(&radii, &[0.02, height, height, 0.0, 0.0], 32, weave);
}

/// Door in a wall at y = 0: leaf with two panels, frame and handle.
pub(super) fn door(s: &mut Scene, width: f32, height: f32, leaf: MaterialId, metal: MaterialId) {
    let hw = 0.5 * width;
    s.cuboid([-hw, -0.02, 0.005], [hw, -0.001, height], leaf);
    for (z0, z1) in [(0.15, 0.85), (1.05, height - 0.15)] {
        for (a, b) in [(-hw + 0.12, -hw + 0.15), (hw - 0.15, hw - 0.12)] {
            s.cuboid([a, -0.03, z0], [b, -0.02, z1], leaf);
        }
        s.cuboid([-hw + 0.12, -0.03, z0], [hw - 0.12, -0.02, z0 + 0.03], leaf);
        s.cuboid([-hw + 0.12, -0.03, z1 - 0.03], [hw - 0.12, -0.02, z1], leaf);
    }
    for x in [-hw - 0.08, hw] {
        s.cuboid([x, -0.045, 0.0], [x + 0.08, -0.001, height + 0.08], leaf);
    }
    s.cuboid([-hw, -0.045, height], [hw, -0.001, height + 0.08], leaf);
    let (x, y, z) = (hw - 0.08, -0.07, 1.02);
    s.bar(p(x, -0.02, z), p(x, y, z), 0.01, metal);
    s.bar(p(x, y, z), p(hw - 0.20, y, z), 0.01, metal);
}

/// Window in a wall at y = 0 with its lower edge on z = 0: view, frame, bars, sill; sheds light.
pub(super) fn window(
    s: &mut Scene,
    width: f32,
    height: f32,
    view: MaterialId,
    frame: MaterialId,
    light: f32,
) {
    let (hw, h, b) = (0.5 * width, height, 0.06);
    s.panel([0.0, -0.002, 0.0], width, height, view);
    for x in [-hw - b, hw, -0.5 * b] {
        s.cuboid([x, -0.05, -b], [x + b, -0.003, h + b], frame);
    }
    for z in [-b, h, 0.68 * h] {
        s.cuboid([-hw, -0.05, z], [hw, -0.003, z + b], frame);
    }
    s.cuboid([-hw - 0.12, -0.16, -b - 0.03], [hw + 0.12, 0.0, -b], frame);
    let (down, along) = (p(0.0, 0.0, -h), p(width, 0.0, 0.0));
    s.light(p(-hw, -0.055, h), down, along, light);
}

/// A few magazines lying askew.
pub(super) fn magazines(s: &mut Scene, covers: &[MaterialId], seed: u64) {
    let mut random = Random::new(seed);
    for (k, cover) in covers.iter().enumerate() {
        let (x, y) = (random.range(-0.03, 0.03), random.range(-0.03, 0.03));
        let turn = random.range(-0.5, 0.5);
        s.at(place(x, y, 0.008 * k as f32, turn), |s| {
            s.cuboid([-0.105, -0.148, 0.0], [0.105, 0.148, 0.007], *cover);
        });
    }
}
