//! The innermost loop of the rule `fused`: evidence for 4 x 4 x 4 cells from one range image.
//!
//! The scalar kernel here defines the result; `kernel_avx2` computes the same bits eight cells at
//! a time.

/// Samples in a wide footprint, as offsets in units of its width: a Latin square, so that each
/// row and column of an 8 x 8 raster has one.
pub(crate) const EIGHT_SAMPLES: [[f32; 2]; 8] = [
    [-0.4375, -0.1875],
    [-0.3125, 0.3125],
    [-0.1875, -0.4375],
    [-0.0625, 0.0625],
    [0.0625, 0.4375],
    [0.1875, -0.0625],
    [0.3125, -0.3125],
    [0.4375, 0.1875],
];
/// Samples in a footprint of two to ten pixels.
pub(crate) const FOUR_SAMPLES: [[f32; 2]; 4] =
    [[-0.25, -0.25], [0.25, -0.25], [-0.25, 0.25], [0.25, 0.25]];
/// Footprints up to this wide take the nearest pixel alone.
pub(crate) const SINGLE_SAMPLE_PX: f32 = 1.5;
/// Footprints up to this wide take four samples.
pub(crate) const FOUR_SAMPLES_PX: f32 = 3.2;
/// Cells of a block.
pub(crate) const BLOCK_CELLS: usize = 64;

/// The cell of a block at position `index`: octants of 2 x 2 x 2 cells one after the other, x
/// fastest among octants and inside each.
#[inline]
pub(crate) fn cell_of(index: usize) -> [usize; 3] {
    std::array::from_fn(|axis| (index >> (3 + axis) & 1) * 2 + (index >> axis & 1))
}

/// A measurement as the kernel needs it: where its table begins in space and in memory.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub(crate) struct KernelPixel {
    /// Range at which the table begins, in map units; infinite for a pixel without measurement.
    pub near: f32,
    /// Entries per map unit.
    pub inv_step: f32,
    /// Position of the last, zero entry of the table.
    pub last: f32,
    /// Index of the first entry of the table: the update in free space.
    pub base: i32,
}

/// An image as the kernel needs it.
#[derive(Clone, Debug)]
pub(crate) struct KernelImage {
    pub width: usize,
    pub height: usize,
    /// Pixels per unit of slope, along u and v.
    pub focal: [f32; 2],
    /// Pixel of slope 0, plus one half: truncation then finds the nearest pixel.
    pub center: [f32; 2],
    pub pixels: Vec<KernelPixel>,
}

/// All tables one after the other, each as: free update, entries, 0.
///
/// The first table is that of pixels without measurement: it gives 0 everywhere. One more entry
/// follows the last, so that reading 32 bits at any entry stays inside.
#[derive(Clone, Debug)]
pub(crate) struct FlatTables {
    pub entries: Vec<i16>,
}

/// Factors on the sum of the samples' evidence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Weights {
    /// For the one sample of a small footprint.
    pub single: f32,
    /// By the number of samples that hit, less one.
    pub by_hits: [f32; 8],
    /// How often a sample for an obstacle counts in addition, in a footprint of several.
    pub obstacle: i32,
}

/// Where a block lies, in the axes of an image, and how far it counts.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Block {
    /// Centre of the first cell.
    pub first: [f32; 3],
    /// Steps to the next cell along the map's x, y and z.
    pub steps: [[f32; 3]; 3],
    /// Edge of a cell.
    pub cell: f32,
    /// Cells that are not deeper than this get nothing.
    pub min_depth: f32,
    /// Cells beyond this range get nothing.
    pub max_range: f32,
}

impl Block {
    /// Centre of the cell `(x, y, z)`; the order of the operations is part of the result.
    #[inline]
    fn center(&self, [x, y, z]: [usize; 3]) -> [f32; 3] {
        let [sx, sy, sz] = self.steps;
        std::array::from_fn(|i| {
            (self.first[i] + z as f32 * sz[i]) + (x as f32 * sx[i] + y as f32 * sy[i])
        })
    }
}

/// Everything that stays the same for all blocks of an image.
#[derive(Clone, Copy)]
pub(crate) struct Kernel<'a> {
    pub image: &'a KernelImage,
    pub tables: &'a FlatTables,
}

impl Kernel<'_> {
    /// Evidence for the cells of the `wanted` octants of a block; 0 where the scan says nothing.
    /// Other cells are left alone. Cells as [`cell_of`] orders them.
    #[inline]
    pub(crate) fn block(
        &self,
        block: &Block,
        weights: &Weights,
        wanted: u8,
        evidence: &mut [i16; BLOCK_CELLS],
    ) {
        #[cfg(target_arch = "x86_64")]
        if super::kernel_avx2::block(self, block, weights, wanted, evidence) {
            return;
        }
        self.block_scalar(block, weights, wanted, evidence);
    }

    /// [`Kernel::block`] without vectors.
    pub(crate) fn block_scalar(
        &self,
        block: &Block,
        weights: &Weights,
        wanted: u8,
        evidence: &mut [i16; BLOCK_CELLS],
    ) {
        for (index, value) in evidence.iter_mut().enumerate() {
            if wanted >> (index >> 3) & 1 != 0 {
                *value = self.cell(block, cell_of(index), weights);
            }
        }
    }

    /// Evidence for one cell of a block.
    pub(crate) fn cell(&self, block: &Block, at: [usize; 3], weights: &Weights) -> i16 {
        let [x, y, z] = block.center(at);
        let range = (x * x + y * y + z * z).sqrt();
        // Written so that NaN gives nothing.
        if !(z > block.min_depth && range <= block.max_range) {
            return 0;
        }
        let inverse = 1.0 / z;
        let u = x * inverse * self.image.focal[0] + self.image.center[0];
        let v = y * inverse * self.image.focal[1] + self.image.center[1];
        let width = block.cell * self.image.focal[0] * inverse;
        if width <= SINGLE_SAMPLE_PX {
            return evidence(i32::from(self.sample(u, v, range)), weights.single);
        }
        if width <= FOUR_SAMPLES_PX {
            let (sum, hits) = self.sum(&FOUR_SAMPLES, [u, v], width, range, weights.obstacle);
            // Four samples that hit stand for as much as eight.
            return evidence(2 * sum, weights.by_hits[(2 * hits).saturating_sub(1)]);
        }
        let (sum, hits) = self.sum(&EIGHT_SAMPLES, [u, v], width, range, weights.obstacle);
        evidence(sum, weights.by_hits[hits.saturating_sub(1)])
    }

    /// Sum of the samples' evidence, and how many said anything.
    #[inline]
    fn sum(
        &self,
        samples: &[[f32; 2]],
        [u, v]: [f32; 2],
        width: f32,
        range: f32,
        obstacle: i32,
    ) -> (i32, usize) {
        samples.iter().fold((0, 0), |(sum, hits), [du, dv]| {
            let sample = i32::from(self.sample(u + du * width, v + dv * width, range));
            let gained = sample + sample.max(0) * obstacle;
            (sum + gained, hits + usize::from(sample != 0))
        })
    }

    /// Evidence of the pixel that holds `(u, v)`; 0 if it says nothing.
    #[inline]
    fn sample(&self, u: f32, v: f32, range: f32) -> i16 {
        let inside =
            u >= 0.0 && v >= 0.0 && u < self.image.width as f32 && v < self.image.height as f32;
        if !inside {
            return 0;
        }
        let pixel = self.image.pixels[v as usize * self.image.width + u as usize];
        let offset = (range - pixel.near) * pixel.inv_step + 1.0;
        let position = offset.max(0.0).min(pixel.last) as i32;
        self.tables.entries[(pixel.base + position) as usize]
    }
}

/// `sum * factor`, rounded towards zero but never to it.
#[inline]
pub(crate) fn evidence(sum: i32, factor: f32) -> i16 {
    let limit = f32::from(i16::MAX);
    let value = (sum as f32 * factor).max(-limit).min(limit) as i32;
    if value == 0 {
        sum.signum() as i16
    } else {
        value as i16
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A small image with holes and three tables, and blocks around it.
    #[allow(clippy::too_many_lines, reason = "one random case, described once")]
    pub(crate) fn random_case(seed: u32) -> (KernelImage, FlatTables, Vec<(Block, Weights)>) {
        let mut state = seed;
        let mut unit = move || {
            state = state.wrapping_mul(1664525).wrapping_add(1013904223);
            (state >> 8) as f32 / (1 << 24) as f32
        };
        let mut entries = vec![0, 0];
        let mut tables = vec![(0.0, 0)];
        for length in [7_i32, 300, 40] {
            tables.push((length as f32 + 1.0, entries.len() as i32));
            entries.push(-2458);
            entries.extend((0..length).map(|i| (i * 37 % 9000 - 2000) as i16));
            entries.push(0);
        }
        entries.push(0);
        let (width, height) = (40, 30);
        let pixels = (0..width * height)
            .map(|_| {
                let table = (unit() * 4.0) as usize;
                let (last, base) = tables[table];
                KernelPixel {
                    near: if table == 0 {
                        f32::INFINITY
                    } else {
                        1.0 + unit()
                    },
                    inv_step: 100.0,
                    last,
                    base,
                }
            })
            .collect();
        let image = KernelImage {
            width,
            height,
            focal: [30.0, 31.0],
            center: [20.2, 14.8],
            pixels,
        };
        let blocks = (0..200)
            .map(|i| {
                let cell = if i % 2 == 0 { 0.01 } else { 0.13 };
                let (sin, cos) = (unit() * 6.0).sin_cos();
                let block = Block {
                    first: [unit() * 3.0 - 1.5, unit() * 3.0 - 1.5, unit() * 3.0 - 0.3],
                    steps: [
                        [cell * cos, cell * sin, 0.0],
                        [-cell * sin, cell * cos, 0.0],
                        [0.0, 0.0, cell],
                    ],
                    cell,
                    min_depth: 0.25 * cell,
                    max_range: 1.0 + 2.0 * unit(),
                };
                let weights = Weights {
                    single: 1.0 + unit(),
                    by_hits: std::array::from_fn(|h| (1.0 + unit()) / (h + 1) as f32),
                    obstacle: i % 3,
                };
                (block, weights)
            })
            .collect();
        (image, FlatTables { entries }, blocks)
    }

    #[test]
    fn evidence_is_scaled_towards_zero_and_never_vanishes() {
        assert_eq!(evidence(-10, 1.25), -12);
        assert_eq!(evidence(-1, 0.1), -1);
        assert_eq!(evidence(0, 5.0), 0);
        assert_eq!(evidence(-262_136, 2.0), -32767);
        // A footprint that is free all over gets what a free block gets.
        assert_eq!(evidence(8 * -2458, 1.37 / 8.0), evidence(-2458, 1.37));
    }

    #[test]
    fn blocks_see_measurements_holes_and_the_borders() {
        let (image, tables, blocks) = random_case(1);
        let kernel = Kernel {
            image: &image,
            tables: &tables,
        };
        let (mut zero, mut free, mut other) = (0, 0, 0);
        for (block, weights) in &blocks {
            let mut evidence = [0; BLOCK_CELLS];
            kernel.block_scalar(block, weights, 0xff, &mut evidence);
            for value in evidence {
                match value {
                    0 => zero += 1,
                    ..0 => free += 1,
                    _ => other += 1,
                }
            }
        }
        assert!(
            zero > 1000 && free > 300 && other > 100,
            "{zero} {free} {other}"
        );
    }
}
