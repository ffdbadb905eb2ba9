//! The kernel one cell after the other, which defines the result.

use crate::integrate::kernel::kernel_image::KernelImage;
use crate::integrate::octants::Octants;
use crate::key::{BRICK_CELLS, BRICK_EDGE};

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
/// Edge of an octant of a brick in cells; octant `x | y << 1 | z << 2` lies at those ends of its
/// brick.
pub(crate) const OCTANT_EDGE: usize = 4;

/// The cell `[x, y, z]` of an octant in its brick.
#[inline(always)]
pub(crate) fn cell_in_brick(octant: u8, cell: [usize; 3]) -> [usize; 3] {
    std::array::from_fn(|axis| usize::from(octant >> axis & 1) * OCTANT_EDGE + cell[axis])
}

/// All tables one after the other, each as: free update, entries, 0.
#[derive(Clone, Debug, Default)]
pub(crate) struct FlatTables {
    pub entries: Vec<i32>,
    /// What the entries add to the sum of a footprint.
    pub gains: Vec<i32>,
    /// At least one.
    pub rows: Vec<TableRow>,
    /// Whether all say the same of free space.
    pub one_free: bool,
}

impl FlatTables {
    /// Adds a table; in a footprint of several samples one for an obstacle counts `obstacle` times
    /// in addition.
    pub(crate) fn push(&mut self, inv_step: f32, free: i16, entries: &[i16], obstacle: i32) {
        self.rows.push(TableRow {
            inv_step,
            last: (entries.len() + 1) as f32,
            base: self.entries.len() as f32,
        });
        let entries = [free].into_iter().chain(entries.iter().copied()).chain([0]);
        for entry in entries.map(i32::from) {
            self.entries.push(entry);
            self.gains.push(sum::gain(entry, obstacle));
        }
        self.one_free = self
            .rows
            .iter()
            .all(|row| self.entries[row.base as usize] == self.entries[0]);
    }
}

/// Samples of a footprint in one number: the sum of their evidence, and in the lowest bits how many
/// said anything.
pub(crate) mod sum {
    /// Bits for the number of samples, at most eight.
    pub(crate) const HIT_BITS: u32 = 4;

    /// What a sample adds, of which one for an obstacle counts `obstacle` times in addition.
    pub(crate) fn gain(sample: i32, obstacle: i32) -> i32 {
        (sample + sample.max(0) * obstacle) << HIT_BITS | i32::from(sample != 0)
    }

    /// The sum, and how many said anything.
    #[inline]
    pub(crate) fn parts(sum: i32) -> (i32, usize) {
        (sum >> HIT_BITS, (sum & ((1 << HIT_BITS) - 1)) as usize)
    }
}

/// Where a table is in the flat tables; whole numbers are below 2^24, those that `f32` has.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TableRow {
    /// Entries per map unit.
    pub inv_step: f32,
    /// Position of the last, zero entry.
    pub last: f32,
    /// Index of the first entry: the update in free space.
    pub base: f32,
}

/// Factors on the sum of the samples' evidence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Weights {
    /// For the one sample of a small footprint.
    pub single: f32,
    /// By the number of samples that hit, less one.
    pub by_hits: [f32; 8],
}

/// Where a brick lies, in the axes of an image, and how far it counts.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Placed {
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

impl Placed {
    /// Centre of a cell: the way along z, and then that along x and y; the order of the operations
    /// is part of the result.
    #[inline]
    pub(super) fn center(&self, cell: [usize; 3]) -> [f32; 3] {
        let [x, y, z] = cell.map(|c| c as f32);
        let ([sx, sy, _], layer) = (self.steps, self.layer(z));
        std::array::from_fn(|i| layer[i] + (x * sx[i] + y * sy[i]))
    }

    /// Whether all cells certainly count.
    #[inline]
    pub(super) fn is_within_range(&self) -> bool {
        let first = self.first.iter().map(|c| c * c).sum::<f32>().sqrt();
        // A diagonal of eight cells is less than fourteen.
        first + 14.0 * self.cell < self.max_range
    }

    /// Centre of the first cell of a layer.
    #[inline]
    pub(super) fn layer(&self, z: f32) -> [f32; 3] {
        std::array::from_fn(|i| self.first[i] + z * self.steps[2][i])
    }
}

/// Everything that stays the same for all bricks of an image.
#[derive(Clone, Copy)]
pub(crate) struct Kernel<'a> {
    pub image: &'a KernelImage,
    pub tables: &'a FlatTables,
}

impl Kernel<'_> {
    /// Writes the evidence for the cells of the octants of a brick that are touched; 0 where the
    /// scan says nothing.
    pub(crate) fn brick_scalar(
        &self,
        brick: &Placed,
        weights: &Weights,
        octants: Octants,
        cells: &mut [i16; BRICK_CELLS],
    ) {
        let free = self.free(weights);
        for octant in bits_of(octants.touched) {
            let is_free = octants.free >> octant & 1 != 0;
            for cell in cells_of(octant) {
                cells[index_of(cell)] = match is_free {
                    true => free,
                    false => self.cell(brick, cell, weights),
                };
            }
        }
    }

    /// The update of a cell whose whole footprint is free.
    #[inline]
    pub(super) fn free(&self, weights: &Weights) -> i16 {
        evidence(self.tables.entries[0], weights.single)
    }

    /// Evidence for a cell of a brick.
    pub(crate) fn cell(&self, brick: &Placed, cell: [usize; 3], weights: &Weights) -> i16 {
        let [x, y, z] = brick.center(cell);
        let range = (x * x + y * y + z * z).sqrt();
        // Written so that NaN gives nothing.
        if !(z > brick.min_depth && range <= brick.max_range) {
            return 0;
        }
        let inverse = 1.0 / z;
        let u = x * inverse * self.image.focal[0] + self.image.center[0];
        let v = y * inverse * self.image.focal[1] + self.image.center[1];
        let width = brick.cell * self.image.focal[0] * inverse;
        if width <= SINGLE_SAMPLE_PX {
            return evidence(self.tables.entries[self.entry(u, v, range)], weights.single);
        }
        if width <= FOUR_SAMPLES_PX {
            let (sum, hits) = self.sum(&FOUR_SAMPLES, [u, v], width, range);
            // Four samples that hit stand for as much as eight.
            return evidence(2 * sum, weights.by_hits[(2 * hits).saturating_sub(1)]);
        }
        let (sum, hits) = self.sum(&EIGHT_SAMPLES, [u, v], width, range);
        evidence(sum, weights.by_hits[hits.saturating_sub(1)])
    }

    /// Sum of the samples' evidence, and how many said anything.
    #[inline]
    fn sum(&self, samples: &[[f32; 2]], [u, v]: [f32; 2], width: f32, range: f32) -> (i32, usize) {
        let gain = |[du, dv]: &[f32; 2]| {
            self.tables.gains[self.entry(u + du * width, v + dv * width, range)]
        };
        sum::parts(samples.iter().map(gain).sum())
    }

    /// The entry of the tables for the pixel that holds `(u, v)`.
    #[inline]
    fn entry(&self, u: f32, v: f32, range: f32) -> usize {
        let [column, row] = [u, v].map(|c| c.max(0.0));
        let [last_column, last_row] = self.image.last;
        let row = row.min(last_row) as usize;
        let pixel = row * self.image.stride + column.min(last_column) as usize;
        let table = self.image.tables.get(pixel).map_or(0, |&t| usize::from(t));
        let row = &self.tables.rows[table];
        let offset = (range - self.image.near[pixel]) * row.inv_step + 1.0;
        let position = offset.max(0.0).min(row.last) as u32;
        (row.base as u32 + position) as usize
    }
}

/// The bits that are set.
#[inline]
pub(crate) fn bits_of(bits: u8) -> impl Iterator<Item = u8> {
    (0..8).filter(move |bit| bits >> bit & 1 != 0)
}

/// The cells of an octant of a brick, x fastest.
pub(crate) fn cells_of(octant: u8) -> impl Iterator<Item = [usize; 3]> {
    const E: usize = OCTANT_EDGE;
    (0..E * E * E).map(move |i| cell_in_brick(octant, [i % E, i / E % E, i / (E * E)]))
}

/// The index of a cell in its brick.
#[inline(always)]
pub(crate) fn index_of([x, y, z]: [usize; 3]) -> usize {
    x + BRICK_EDGE as usize * (y + BRICK_EDGE as usize * z)
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

    /// A small image with holes and three tables, and bricks around it.
    #[allow(clippy::too_many_lines, reason = "one random case, described once")]
    pub(crate) fn random_case(seed: u32) -> (KernelImage, FlatTables, Vec<(Placed, Weights)>) {
        let mut state = seed;
        let mut unit = move || {
            state = state.wrapping_mul(1664525).wrapping_add(1013904223);
            (state >> 8) as f32 / (1 << 24) as f32
        };
        let mut tables = FlatTables::default();
        for length in [7_i16, 300, 40] {
            let entries: Vec<i16> = (0..length).map(|i| i * 37 % 9000 - 2000).collect();
            tables.push(
                100.0 + f32::from(length),
                -2458,
                &entries,
                (seed % 3) as i32,
            );
        }
        let (width, height) = (40, 30);
        let near = (0..width * height).map(|_| match unit() {
            0.75.. => f32::NEG_INFINITY,
            _ => 1.0 + unit(),
        });
        let near: Vec<f32> = near.collect();
        let of_pixels: Vec<u16> = (0..near.len()).map(|_| (unit() * 3.0) as u16).collect();
        let view = [[30.0, 31.0], [18.7, 13.3]];
        let image = KernelImage::new([width, height], view, &near, &of_pixels);
        let bricks = (0..200)
            .map(|i| {
                let cell = [0.01, 0.06, 0.13][i % 3];
                let (sin, cos) = (unit() * 6.0).sin_cos();
                let brick = Placed {
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
                };
                (brick, weights)
            })
            .collect();
        (image, tables, bricks)
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
    fn bricks_see_measurements_holes_and_the_borders() {
        let (image, tables, bricks) = random_case(1);
        let kernel = Kernel {
            image: &image,
            tables: &tables,
        };
        let (mut zero, mut free, mut other) = (0, 0, 0);
        for (brick, weights) in &bricks {
            let mut cells = [0; BRICK_CELLS];
            let touched = Octants {
                touched: 0b1010_0111,
                ..Octants::default()
            };
            kernel.brick_scalar(brick, weights, touched, &mut cells);
            for value in cells {
                match value {
                    0 => zero += 1,
                    ..0 => free += 1,
                    _ => other += 1,
                }
            }
        }
        assert!(
            zero > 1000 && free > 300 && other > 50,
            "{zero} {free} {other}"
        );
    }
}
