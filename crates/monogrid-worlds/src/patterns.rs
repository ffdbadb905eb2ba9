//! Procedural textures of the things in a room: wood, fabric, carpet, stone, pictures, print.
//!
//! Every pattern is a sum of octaves (amplitude about 1/f, as in natural pictures) plus the
//! structure of the material, and repeats at the borders of its tile.

use super::noise::{Octaves, gradient_noise};
use super::random::{Random, mix2, unit};
use super::texture::Texture;

/// Side of most tiles, as a power of two.
const TILE_LOG2: u32 = 9;

fn smooth_step(low: f32, high: f32, x: f32) -> f32 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Wood with the grain along u: stretched noise, year rings and pores.
#[must_use]
pub fn wood(base: f32, contrast: f32, seed: u64) -> Texture {
    let noise = [
        Octaves::new([2, 3], 3, 0.5, seed),
        Octaves::new([6, 60], 4, 0.6, seed + 1),
        Octaves::single([40, 240], seed + 2),
    ];
    Texture::from_noise(
        TILE_LOG2 + 1,
        TILE_LOG2,
        noise,
        move |_, v, [bend, fibre, pores]| {
            let rings = (std::f32::consts::TAU * (4.0 * v + 1.1 * bend)).sin();
            let pore = smooth_step(0.22, 0.45, pores);
            base * (1.0 + contrast * (0.30 * rings + 0.75 * fibre + 0.5 * bend - 0.45 * pore))
        },
    )
}

/// Wooden boards side by side along u: `rows` boards per tile, cut at different places.
#[must_use]
pub fn planks(base: f32, contrast: f32, rows: usize, seed: u64) -> Texture {
    let [bends, fibres] = [
        Octaves::new([4, 10], 3, 0.5, seed + 3),
        Octaves::new([24, 200], 3, 0.75, seed + 4),
    ];
    Texture::from_fn(TILE_LOG2 + 1, TILE_LOG2 + 1, move |u, v| {
        let row = ((v * rows as f32) as usize).min(rows - 1);
        let across = v * rows as f32 - row as f32;
        let shift = unit(mix2(seed, row as u64));
        let along = (u + shift).fract() * 2.0;
        let half = along as u64;
        let board = mix2(seed ^ 77, row as u64 * 4 + half);
        let tone = 0.30 * (unit(board) - 0.5);
        let offset = unit(mix2(board, 1));
        let (bu, bv) = ((u + offset).fract(), (v + 0.37 * offset).fract());
        let bend = bends.at(bu, bv);
        let rings = (std::f32::consts::TAU * (18.0 * bv + 1.2 * bend)).sin();
        let fibre = fibres.at(bu, bv);
        let pores = gradient_noise(bu * 60.0, bv * 400.0, [60, 400], seed + 5);
        let pore = smooth_step(0.18, 0.40, pores);
        let gap_v = smooth_step(0.0, 0.02, across) * smooth_step(1.0, 0.98, across);
        let end = along.fract();
        let gap_u = smooth_step(0.0, 0.003, end) * smooth_step(1.0, 0.997, end);
        let surface = base
            * (1.0 + tone + contrast * (0.16 * rings + 0.55 * fibre + 0.25 * bend - 0.45 * pore));
        surface * (0.35 + 0.65 * gap_u * gap_v)
    })
}

/// Woven cloth: threads in two directions over soft stains of all sizes.
#[must_use]
pub fn fabric(base: f32, contrast: f32, threads: i32, seed: u64) -> Texture {
    let noise = [
        Octaves::single([4, 96], seed),
        Octaves::single([96, 4], seed + 1),
        Octaves::new([3, 3], 7, 0.62, seed + 2),
    ];
    Texture::from_noise(
        TILE_LOG2,
        TILE_LOG2,
        noise,
        move |u, v, [along, across, mottle]| {
            let tau = std::f32::consts::TAU;
            let warp = (tau * threads as f32 * u).sin();
            let weft = (tau * threads as f32 * v).sin();
            let slub = along + across;
            base * (1.0 + contrast * (0.14 * warp * weft + 0.45 * slub + 0.95 * mottle))
        },
    )
}

/// Carpet with an ornamental border-to-border pattern, for fitting over a whole rug.
#[must_use]
pub fn rug(seed: u64) -> Texture {
    let side = TILE_LOG2 + 1;
    let noise = [
        Octaves::new([5, 5], 3, 0.5, seed),
        Octaves::new([32, 32], 5, 0.85, seed + 1),
        Octaves::new([2, 2], 4, 0.5, seed + 2),
    ];
    Texture::from_noise(side, side, noise, move |u, v, [wobble, pile, wear]| {
        let (x, y) = (2.0 * u - 1.0, 2.0 * v - 1.0);
        let edge = x.abs().max(y.abs());
        let wobble = 0.04 * wobble;
        let field = {
            let angle = y.atan2(x);
            let radius = (x * x + y * y).sqrt() + wobble;
            let petals = (radius * 17.0 + 1.3 * (6.0 * angle).sin()).sin();
            let lattice = (x.abs() * 13.0).sin() * (y.abs() * 13.0).sin();
            0.32 + 0.13 * petals + 0.10 * lattice
        };
        let band = (edge + wobble - 0.80) * 40.0;
        let border =
            0.40 + 0.18 * ((x + y) * 46.0).sin().signum() * smooth_step(-1.0, 1.0, band.sin());
        let inside = smooth_step(0.80, 0.79, edge + 0.2 * wobble);
        let design = inside * field + (1.0 - inside) * border;
        design * (1.0 + 0.40 * pile + 0.25 * wear)
    })
}

/// Fur, grass, terrazzo or any other isotropic roughness.
#[must_use]
pub fn rough(base: f32, contrast: f32, cells: i32, gain: f32, seed: u64) -> Texture {
    let noise = [Octaves::new([cells, cells], 7, gain, seed)];
    Texture::from_noise(TILE_LOG2, TILE_LOG2, noise, move |_, _, [noise]| {
        base * (1.0 + contrast * noise)
    })
}

/// Veined stone.
#[must_use]
pub fn marble(base: f32, seed: u64) -> Texture {
    let noise = [
        Octaves::new([2, 2], 6, 0.55, seed),
        Octaves::new([16, 16], 5, 0.6, seed + 2),
    ];
    Texture::from_noise(TILE_LOG2, TILE_LOG2, noise, move |u, v, [warp, speckle]| {
        let vein = 1.0
            - (gradient_noise(u * 3.0 + 2.0 * warp, v * 3.0 - warp, [3, 3], seed + 1).abs() * 9.0)
                .min(1.0);
        base * (1.0 + 0.25 * warp + 0.12 * speckle - 0.45 * vein * vein)
    })
}

/// Tiles with joints; `rows` x `rows` per texture, every tile of a slightly different tone.
#[must_use]
pub fn tiles(base: f32, spread: f32, rows: usize, seed: u64) -> Texture {
    let side = TILE_LOG2 + 1;
    let noise = [Octaves::new([6, 6], 7, 0.6, seed + 5)];
    Texture::from_noise(side, side, noise, move |u, v, [cloud]| {
        let (x, y) = (u * rows as f32, v * rows as f32);
        let (ix, iy) = (x as usize, y as usize);
        let (fx, fy) = (x - ix as f32, y - iy as f32);
        let joint = 0.012f32;
        let inside = |t: f32| smooth_step(0.0, joint, t) * smooth_step(1.0, 1.0 - joint, t);
        let tone = spread * (unit(mix2(seed, (iy * rows + ix) as u64)) - 0.5);
        let face = base * (1.0 + tone + 0.25 * cloud);
        let cover = inside(fx) * inside(fy);
        0.45 * base * (1.0 - cover) + face * cover
    })
}

/// Bricks in running bond.
#[must_use]
pub fn bricks(base: f32, rows: usize, seed: u64) -> Texture {
    let side = TILE_LOG2 + 1;
    let noise = [
        Octaves::new([24, 24], 3, 0.5, seed),
        Octaves::new([12, 12], 7, 0.65, seed + 1),
    ];
    Texture::from_noise(side, side, noise, move |u, v, [ragged, grain]| {
        let columns = rows / 3;
        let y = v * rows as f32;
        let iy = y as usize;
        let x = u * columns as f32 + 0.5 * (iy % 2) as f32;
        let ix = x as usize % columns;
        let (fx, fy) = (x.fract(), y.fract());
        let ragged = 0.02 * ragged;
        let cover = smooth_step(0.0, 0.06, fy.min(1.0 - fy) + ragged)
            * smooth_step(0.0, 0.025, fx.min(1.0 - fx) + 0.5 * ragged);
        let tone = 0.45 * (unit(mix2(seed, (iy * columns + ix) as u64)) - 0.5);
        let face = base * (1.0 + tone + 0.4 * grain);
        let mortar = 1.45 * base * (1.0 + 0.2 * grain);
        mortar + cover * (face - mortar)
    })
}

/// An abstract painting: overlapping blots and strokes of all sizes (dead leaves, whose spectrum is
/// that of natural scenes; Ruderman 1997), over a cloudy ground.
#[must_use]
pub fn painting(seed: u64) -> Texture {
    let mut random = Random::new(seed);
    let blots: Vec<Blot> = (0..110).map(|_| Blot::random(&mut random)).collect();
    let ground = random.range(0.15, 0.6);
    let blots = blots_of_rows(&blots, |_, v| v);
    let noise = [Octaves::new([2, 2], 7, 0.55, seed)];
    Texture::from_noise(TILE_LOG2, TILE_LOG2, noise, move |u, v, [cloud]| {
        let mut value = ground * (1.0 + 0.7 * cloud);
        for blot in &blots[(v * blots.len() as f32) as usize] {
            let cover = blot.cover(u, v);
            if cover > 0.0 {
                value += cover * (blot.tone * (1.0 + 0.35 * cloud) - value);
            }
        }
        value
    })
}

/// One stroke of a painting.
#[derive(Clone, Copy)]
struct Blot {
    centre: [f32; 2],
    axis: [f32; 2],
    half_size: [f32; 2],
    tone: f32,
}

impl Blot {
    fn random(random: &mut Random) -> Self {
        // sizes with density 1/r^3: the law that makes the picture scale-invariant
        let inverse = random.range(2.5, 28.0);
        let size = 1.0 / inverse;
        let angle = random.range(0.0, std::f32::consts::TAU);
        Self {
            centre: [random.unit(), random.unit()],
            axis: [angle.cos(), angle.sin()],
            half_size: [size * random.range(0.6, 1.8), size * random.range(0.3, 0.9)],
            tone: random.range(0.04, 0.85),
        }
    }

    /// How far it covers anything on each side of its centre.
    fn reach(&self) -> f32 {
        1.05 * (self.half_size[0] + self.half_size[1])
    }

    fn cover(&self, u: f32, v: f32) -> f32 {
        let (dx, dy) = (u - self.centre[0], v - self.centre[1]);
        let reach = self.reach();
        if dx.abs() > reach || dy.abs() > reach {
            return 0.0;
        }
        let a = (self.axis[0] * dx + self.axis[1] * dy) / self.half_size[0];
        let b = (self.axis[0] * dy - self.axis[1] * dx) / self.half_size[1];
        let radius = a * a * a * a + b * b;
        smooth_step(1.04, 0.96, radius)
    }
}

/// The blots that reach each row of a tile, in their order; `near(centre, v)` is where a blot sees
/// the row.
fn blots_of_rows(blots: &[Blot], near: impl Fn(f32, f32) -> f32) -> Vec<Vec<Blot>> {
    let side = 1usize << TILE_LOG2;
    let of_row = |y: usize| {
        let v = (y as f32 + 0.5) / side as f32;
        let reaches =
            |blot: &&Blot| (near(blot.centre[1], v) - blot.centre[1]).abs() <= blot.reach();
        blots.iter().filter(reaches).copied().collect()
    };
    (0..side).map(of_row).collect()
}

/// A landscape photograph: sky, two mountain ranges, a lake or meadow with trees.
#[must_use]
pub fn landscape(seed: u64) -> Texture {
    let ridge = |cells: i32, s: u64| Octaves::new([cells, 3], 6, 0.5, s).along(0.3);
    let noise = [
        Octaves::new([2, 4], 6, 0.55, seed),
        Octaves::new([10, 10], 6, 0.62, seed + 1),
        ridge(3, seed + 2),
        ridge(4, seed + 3),
        Octaves::new([3, 3], 4, 0.5, seed + 4).along(0.7),
        Octaves::new([4, 28], 5, 0.6, seed + 5),
        ridge(16, seed + 6),
        Octaves::new([3, 2], 2, 0.5, seed + 7),
    ];
    Texture::from_noise(TILE_LOG2, TILE_LOG2, noise, move |u, v, noise| {
        let [cloud, grain, far, near, shore, ripple, tree, grove] = noise;
        let mut value = 0.72 + 0.30 * cloud - 0.2 * v;
        if v > 0.42 + 0.22 * far {
            value = 0.45 + 0.16 * grain + 0.15 * cloud;
        }
        if v > 0.55 + 0.16 * near {
            value = 0.26 + 0.16 * grain;
        }
        let shore = 0.68 + 0.03 * shore;
        if v > shore {
            value = 0.42 + 0.22 * ripple + 0.25 * (v - shore);
        }
        if v > 0.80 + 0.32 * tree && u > 0.12 && grove > -0.12 {
            value = 0.08 + 0.10 * (grain + 0.4).max(0.0);
        }
        value
    })
}

/// A printed poster: a title, paragraphs of small print and a picture.
#[must_use]
pub fn poster(seed: u64) -> Texture {
    let mut random = Random::new(seed ^ 0x51);
    let mut boxes: Vec<[f32; 4]> = Vec::new();
    let mut letter_line = |y: f32, height: f32, x0: f32, x1: f32, random: &mut Random| {
        let mut x = x0;
        while x < x1 {
            let letters = 2 + random.below(7);
            for _ in 0..letters {
                let width = height * random.range(0.35, 0.7);
                if x + width > x1 {
                    break;
                }
                // a letter: one or two strokes
                boxes.push([x, y, x + 0.3 * width, y + height]);
                let bar = y + height * random.range(0.0, 0.7);
                boxes.push([x, bar, x + width, bar + 0.3 * height]);
                x += width * 1.35;
            }
            x += 0.5 * height;
        }
    };
    letter_line(0.05, 0.075, 0.08, 0.92, &mut random);
    letter_line(0.145, 0.035, 0.08, 0.75, &mut random);
    for line in 0..8 {
        letter_line(0.72 + 0.032 * line as f32, 0.017, 0.08, 0.92, &mut random);
    }
    let side = 1usize << TILE_LOG2;
    let mut ink = vec![false; side * side];
    for [x0, y0, x1, y1] in &boxes {
        let texel = |t: f32| ((t * side as f32).round() as usize).min(side);
        for row in texel(*y0)..texel(*y1).max(texel(*y0) + 1).min(side) {
            ink[row * side + texel(*x0)..row * side + texel(*x1)].fill(true);
        }
    }
    let picture = painting(seed + 3);
    let noise = [Octaves::new([4, 4], 5, 0.6, seed)];
    Texture::from_noise(TILE_LOG2, TILE_LOG2, noise, move |u, v, [paper]| {
        if (0.08..0.92).contains(&u) && (0.21..0.68).contains(&v) {
            let (w, h) = picture.size();
            let (x, y) = ((u - 0.08) / 0.84, (v - 0.21) / 0.47);
            return picture.sample(x * w as f32, y * h as f32, 1.0);
        }
        let (x, y) = ((u * side as f32) as usize, (v * side as f32) as usize);
        if ink[y * side + x] {
            return 0.07;
        }
        0.78 * (1.0 + 0.05 * paper)
    })
}

/// The spine of a book with lettering, or the cover of a magazine when wide.
#[must_use]
pub fn spine(base: f32, seed: u64) -> Texture {
    let mut random = Random::new(seed);
    let title: Vec<(f32, f32)> = {
        let mut x = 0.12;
        let mut list = Vec::new();
        while x < random.range(0.6, 0.8) {
            let width = random.range(0.012, 0.035);
            list.push((x, x + width));
            x += width + random.range(0.008, 0.03);
        }
        list
    };
    let bands = [random.range(0.02, 0.08), random.range(0.84, 0.95)];
    let ink = if base > 0.35 { 0.06 } else { 0.75 };
    let noise = [Octaves::new([2, 4], 5, 0.6, seed)];
    Texture::from_noise(TILE_LOG2 - 2, TILE_LOG2 - 1, noise, move |u, v, [wear]| {
        let mut value = base * (1.0 + 0.30 * wear);
        if (0.3..0.7).contains(&u) && title.iter().any(|t| v >= t.0 && v < t.1) {
            value = ink;
        }
        if bands.iter().any(|b| (v - b).abs() < 0.012) {
            value = 0.5 * (value + ink);
        }
        value
    })
}

/// Leaves or a flower pattern, for curtains and cushions.
#[must_use]
pub fn foliage(base: f32, ink: f32, seed: u64) -> Texture {
    let mut random = Random::new(seed ^ 0xF0);
    let leaves: Vec<Blot> = (0..70)
        .map(|_| {
            let angle = random.range(0.0, std::f32::consts::TAU);
            let size = random.range(0.03, 0.09);
            Blot {
                centre: [random.unit(), random.unit()],
                axis: [angle.cos(), angle.sin()],
                half_size: [size, 0.35 * size],
                tone: ink * random.range(0.7, 1.3),
            }
        })
        .collect();
    // a leaf that crosses the border comes in again at the other side
    let near = |c: f32, x: f32| x + (c - x).round();
    let leaves = blots_of_rows(&leaves, near);
    let noise = [Octaves::new([8, 8], 6, 0.65, seed)];
    Texture::from_noise(TILE_LOG2, TILE_LOG2, noise, move |u, v, [cloth]| {
        let mut value = base;
        for leaf in &leaves[(v * leaves.len() as f32) as usize] {
            let cover = leaf.cover(near(leaf.centre[0], u), near(leaf.centre[1], v));
            value += cover * (leaf.tone - value);
        }
        value * (1.0 + 0.25 * cloth)
    })
}

/// The view through a window: bright sky, houses and trees.
#[must_use]
pub fn outdoors(seed: u64) -> Texture {
    let noise = [
        Octaves::new([2, 3], 6, 0.55, seed),
        Octaves::new([8, 8], 6, 0.6, seed + 1),
        Octaves::new([6, 2], 5, 0.55, seed + 2).along(0.1),
    ];
    Texture::from_noise(
        TILE_LOG2,
        TILE_LOG2,
        noise,
        move |u, v, [cloud, grain, hedge]| {
            let mut value = 0.88 + 0.18 * cloud;
            let roof = 0.52
                + 0.05 * ((u * 5.0).fract() - 0.5).abs()
                + 0.04 * unit(mix2(seed, (u * 5.0) as u64));
            if v > roof {
                let window = ((u * 30.0).fract() - 0.5).abs() < 0.22
                    && ((v * 24.0).fract() - 0.5).abs() < 0.28;
                value = if window { 0.35 } else { 0.62 } * (1.0 + 0.25 * grain);
            }
            if v > 0.70 + 0.14 * hedge {
                value = 0.34 * (1.0 + 0.8 * grain);
            }
            value
        },
    )
}
