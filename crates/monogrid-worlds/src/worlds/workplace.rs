//! Pieces of offices and halls, each around its own origin on the floor with its front towards -y.

use super::furniture as f;
use crate::patterns;
use crate::random::Random;
use crate::scene::{Material, MaterialId, Scene, place, place_tilted};
use crate::shapes::{BoxFaces, p};
use std::f32::consts::{FRAC_PI_2, TAU};

/// Materials of an office.
pub(super) struct Office {
    pub white: MaterialId,
    pub grey: MaterialId,
    pub dark: MaterialId,
    pub beech: MaterialId,
    pub cloth: MaterialId,
    pub screens: [MaterialId; 3],
    pub papers: [MaterialId; 4],
    pub leaf: MaterialId,
}

impl Office {
    /// Creates them, with pictures that depend on the seed.
    pub fn new(s: &mut Scene, seed: u64) -> Self {
        let shown = [
            patterns::landscape(seed + 3),
            patterns::poster(seed + 5),
            patterns::poster(seed + 6),
        ];
        Self {
            white: s.plain(0.72),
            grey: s.plain(0.36),
            dark: s.plain(0.06),
            beech: s.tiled(patterns::wood(0.44, 0.5, seed + 1), 1.6, 0.8),
            cloth: s.tiled(patterns::fabric(0.17, 0.7, 48, seed + 2), 0.4, 0.4),
            screens: shown.map(|shown| s.material(Material::fitted(shown).glowing(0.7))),
            papers: [10, 11, 12, 13].map(|k| s.fitted(patterns::poster(seed + k))),
            leaf: s.tiled(patterns::rough(0.16, 0.9, 5, 0.6, seed + 20), 0.15, 0.15),
        }
    }
}

/// Desk with screen, keyboard, papers, mug and a pedestal of drawers.
pub(super) fn desk(s: &mut Scene, m: &Office, width: f32, seed: u64) {
    let mut random = Random::new(seed);
    let half = 0.5 * width;
    s.cuboid([-half, -0.4, 0.71], [half, 0.4, 0.74], m.beech);
    for x in [-half + 0.04, half - 0.04] {
        s.cuboid([x - 0.03, -0.36, 0.0], [x + 0.03, 0.36, 0.03], m.grey);
        s.cuboid([x - 0.025, -0.04, 0.03], [x + 0.025, 0.04, 0.71], m.grey);
    }
    s.cuboid([-half + 0.1, 0.34, 0.35], [half - 0.1, 0.36, 0.71], m.grey);
    s.at(place(half - 0.32, 0.02, 0.0, 0.0), |s| {
        file_cabinet(s, m, [0.42, 0.58, 0.60], 3);
    });
    let screen = m.screens[random.below(m.screens.len())];
    let (x, turn) = (random.range(-0.3, 0.0), random.range(-0.25, 0.25));
    s.at(place(x, 0.18, 0.74, turn), |s| {
        f::television(s, 0.48 + 0.12 * (seed % 3) as f32, screen, m.dark);
    });
    let (x, turn) = (random.range(-0.3, -0.05), random.range(-0.1, 0.1));
    s.at(place(x, -0.18, 0.74, turn), |s| {
        s.cuboid([-0.22, -0.07, 0.0], [0.22, 0.07, 0.018], m.dark);
        for row in 0..4 {
            let y = -0.05 + 0.03 * row as f32;
            s.cuboid([-0.2, y, 0.018], [0.2, y + 0.022, 0.026], m.grey);
        }
    });
    let sheets: [_; 3] = std::array::from_fn(|_| m.papers[random.below(m.papers.len())]);
    s.at(place(0.25 * width, -0.12, 0.74, 0.4), |s| {
        f::magazines(s, &sheets, seed);
    });
    let mug = [m.white, m.dark][(seed % 2) as usize];
    s.at(place(-half + 0.15, 0.1, 0.74, 1.0), |s| f::mug(s, mug));
    s.at(place(half - 0.12, 0.25, 0.74, 0.0), |s| {
        f::basket(s, 0.045, 0.11, m.dark);
    });
}

/// Steel cabinet of drawers.
pub(super) fn file_cabinet(s: &mut Scene, m: &Office, size: [f32; 3], drawers: usize) {
    f::cupboard(s, size, 1, drawers, m.grey, m.dark);
}

/// Swivel chair on five castors.
pub(super) fn office_chair(s: &mut Scene, m: &Office) {
    for k in 0..5 {
        let a = TAU * k as f32 / 5.0;
        let (x, y) = (0.28 * a.cos(), 0.28 * a.sin());
        s.bar(p(0.0, 0.0, 0.10), p(x, y, 0.07), 0.018, m.dark);
        s.sphere([x, y, 0.03], 0.03, m.dark);
    }
    s.bar(p(0.0, 0.0, 0.08), p(0.0, 0.0, 0.44), 0.025, m.grey);
    s.rounded_box([0.0, 0.0, 0.48], [0.48, 0.47, 0.09], 0.04, m.cloth);
    s.bar(p(0.0, 0.22, 0.46), p(0.0, 0.27, 0.75), 0.02, m.dark);
    s.at(place_tilted(0.0, 0.26, 0.82, [-0.12, 0.0, 0.0]), |s| {
        s.rounded_box([0.0; 3], [0.44, 0.07, 0.5], 0.035, m.cloth);
    });
    for x in [-0.26, 0.26] {
        s.rounded_box([x, 0.02, 0.68], [0.05, 0.26, 0.03], 0.012, m.dark);
        s.bar(p(x, 0.02, 0.68), p(x, 0.04, 0.48), 0.012, m.dark);
    }
}

/// Screen of cloth between two places.
pub(super) fn partition(s: &mut Scene, m: &Office, width: f32, height: f32) {
    let (half, top) = (0.5 * width, height + 0.02);
    s.cuboid([-half, -0.02, 0.08], [half, 0.02, height], m.cloth);
    for x in [-half, half] {
        s.cuboid([x - 0.02, -0.03, 0.0], [x + 0.02, 0.03, top], m.grey);
    }
}

/// Board on a wall at y = 0 with notes and writing.
pub(super) fn whiteboard(s: &mut Scene, m: &Office, width: f32, height: f32, seed: u64) {
    f::picture(s, [width, height], m.white, m.grey);
    let mut random = Random::new(seed);
    for k in 0..9 {
        let (w, h) = (random.range(0.10, 0.24), random.range(0.10, 0.30));
        let x = random.range(-0.5 * width + w, 0.5 * width - w);
        let z = random.range(0.05, height - h - 0.05);
        let (paper, turn) = (m.papers[k % m.papers.len()], random.range(-0.08, 0.08));
        let pose = place_tilted(x, -0.012 - 0.001 * k as f32, z, [0.0, turn, 0.0]);
        s.at(pose, |s| s.panel([0.0; 3], w, h, paper));
    }
}

/// Printer or copier.
pub(super) fn copier(s: &mut Scene, m: &Office) {
    s.rounded_box([0.0, 0.0, 0.35], [0.6, 0.6, 0.7], 0.03, m.white);
    s.rounded_box([0.0, 0.0, 0.84], [0.62, 0.62, 0.26], 0.04, m.grey);
    s.cuboid([-0.25, -0.33, 0.72], [0.25, -0.29, 0.74], m.dark);
    for k in 0..3 {
        let z = 0.10 + 0.2 * k as f32;
        s.cuboid([-0.26, -0.315, z], [0.26, -0.299, z + 0.17], m.grey);
        s.cuboid([-0.08, -0.325, z + 0.12], [0.08, -0.31, z + 0.14], m.dark);
    }
    s.at(place_tilted(0.18, -0.25, 0.98, [0.5, 0.0, 0.0]), |s| {
        s.cuboid([-0.1, -0.06, 0.0], [0.1, 0.06, 0.01], m.dark);
    });
}

/// Lamp of a grid ceiling: a glowing panel that sheds light downwards.
pub(super) fn ceiling_panel(s: &mut Scene, size: [f32; 2], glow: MaterialId, light: f32) {
    let [x, y] = size.map(|side| -0.5 * side);
    s.ceiling([x, y, -0.012], size, glow);
    s.light_below([x, y, -0.02], size, light);
}

/// Wooden crate with battens.
pub(super) fn crate_box(s: &mut Scene, size: f32, wood: MaterialId) {
    let h = 0.5 * size;
    let b = 0.08 * size;
    s.cuboid([-h, -h, 0.0], [h, h, size], wood);
    for side in 0..4 {
        s.at(place(0.0, 0.0, 0.0, FRAC_PI_2 * side as f32), |s| {
            for (a, c) in [(-h, -h + b), (h - b, h)] {
                s.cuboid([a, -h - 0.02, 0.0], [c, -h, size], wood);
            }
            let (low, high) = (0.45 * size, 0.45 * size + b);
            s.cuboid([-h + b, -h - 0.02, low], [h - b, -h, high], wood);
        });
    }
}

/// Standing vessel with domed ends, bands, legs and a pipe.
pub(super) fn tank(s: &mut Scene, radius: f32, height: f32, steel: MaterialId, band: MaterialId) {
    let dome: [f32; 7] = std::array::from_fn(|k| FRAC_PI_2 * k as f32 / 6.0);
    let mut radii = dome.map(|a| radius * a.sin()).to_vec();
    radii.extend([radius, 0.6 * radius, 0.0]);
    let mut heights = dome
        .map(|a| height - 0.4 * radius * (1.0 - a.cos()))
        .to_vec();
    heights.extend([0.6, 0.35, 0.3]);
    s.lathe(&radii, &heights, 40, steel);
    for z in [0.3, 0.55, 0.8] {
        s.torus(z * height, radius + 0.01, 0.05, band);
    }
    for k in 0..4 {
        let a = TAU * (k as f32 + 0.5) / 4.0;
        let (x, y) = (0.8 * radius * a.cos(), 0.8 * radius * a.sin());
        s.bar(p(x, y, 0.0), p(x, y, 0.7), 0.09, band);
    }
    let (wall, x) = (radius * 0.98, radius + 0.8);
    s.bar(p(wall, 0.0, 1.2), p(x, 0.0, 1.2), 0.12, band);
    s.bar(p(x, 0.0, 1.2), p(x, 0.0, 0.0), 0.12, band);
}

/// Machine: a base with housings, a shaft, a wheel, a cabinet with dials.
pub(super) fn machine(
    s: &mut Scene,
    steel: MaterialId,
    paint: MaterialId,
    dials: MaterialId,
    seed: u64,
) {
    let mut random = Random::new(seed);
    s.cuboid([-2.0, -0.9, 0.0], [2.0, 0.9, 0.35], paint);
    for x in [-1.4, 0.0, 1.2] {
        let (w, h) = (random.range(0.4, 0.8), random.range(0.7, 1.5));
        s.rounded_box([x, 0.0, 0.35 + 0.5 * h], [w, 1.2, h], 0.08, steel);
    }
    s.bar(p(-1.9, 0.0, 0.95), p(1.9, 0.0, 0.95), 0.11, steel);
    s.at(place_tilted(1.75, 0.0, 1.0, [0.0, FRAC_PI_2, 0.0]), |s| {
        s.torus(0.0, 0.75, 0.09, paint);
        for k in 0..6 {
            let a = TAU * k as f32 / 6.0;
            let rim = p(0.75 * a.cos(), 0.75 * a.sin(), 0.0);
            s.bar(p(0.0, 0.0, 0.0), rim, 0.035, paint);
        }
    });
    let faces = BoxFaces {
        front: dials,
        ..paint.into()
    };
    s.cuboid([-1.9, -0.85, 0.35], [-1.3, -0.45, 1.9], faces);
    for k in 0..3 {
        let x = -0.6 + 0.4 * k as f32;
        s.bar(p(x, 0.5, 0.9), p(x, 0.5, 2.4), 0.06, steel);
        s.bar(p(x, 0.5, 2.4), p(x + 0.7, 0.7, 2.4), 0.06, steel);
    }
}

/// Rack of four posts and boards with crates and drums on them.
pub(super) fn storage_rack(
    s: &mut Scene,
    width: f32,
    height: f32,
    frame: MaterialId,
    wood: MaterialId,
    drum: MaterialId,
    seed: u64,
) {
    let mut random = Random::new(seed);
    let half = 0.5 * width;
    for place in [[-half, -0.5], [half, -0.5], [-half, 0.5], [half, 0.5]] {
        s.post(place, 0.05, [0.0, height], frame);
    }
    let levels = (height / 1.5) as usize;
    for level in 0..=levels {
        let z = 0.15 + 1.45 * level as f32;
        s.cuboid([-half, -0.5, z - 0.08], [half, 0.5, z], frame);
        let mut x = -half + 0.5;
        while x < half - 0.4 {
            let kind = random.unit();
            if kind < 0.5 {
                let size = random.range(0.5, 0.85);
                let (y, turn) = (random.range(-0.1, 0.1), random.range(-0.2, 0.2));
                s.at(place(x, y, z, turn), |s| crate_box(s, size, wood));
            } else if kind < 0.8 {
                s.at(place(x, 0.0, z, 0.0), |s| {
                    s.cylinder(0.29, 0.88, drum);
                    s.torus(0.3, 0.29, 0.02, drum);
                    s.torus(0.6, 0.29, 0.02, drum);
                });
            }
            x += random.range(0.75, 1.1);
        }
    }
}
