//! The kernel of the rule `fused`, eight cells at a time with AVX2.
//!
//! Lane `i` of a vector is a cell of an octant: `x + (i & 3)`, `y + (i >> 2)`.
//! Every operation is the IEEE operation of the scalar kernel in the same order (no fused
//! multiply-add), so the results are the same bits; the tests compare them.
#![allow(
    unsafe_code,
    reason = "instructions that not every processor has; vectors and arrays of the same bits"
)]

use std::arch::x86_64::*;

use super::kernel::{
    EIGHT_SAMPLES, FOUR_SAMPLES, FOUR_SAMPLES_PX, Kernel, OCTANT_EDGE, Placed, SINGLE_SAMPLE_PX,
    TableRow, Weights, bits_of, cell_in_brick, index_of,
};
use super::octants::Octants;
use crate::key::{BRICK_CELLS, BRICK_EDGE};

/// Evidence for the touched octants of a brick; `false`, and nothing done, if this processor has no AVX2.
#[inline]
pub(crate) fn brick(
    kernel: &Kernel,
    brick: &Placed,
    weights: &Weights,
    octants: Octants,
    cells: &mut [i16; BRICK_CELLS],
) -> bool {
    if !is_x86_feature_detected!("avx2") {
        return false;
    }
    // SAFETY: the processor has AVX2.
    unsafe { brick_avx2(kernel, brick, weights, octants, cells) };
    true
}

#[target_feature(enable = "avx2")]
fn brick_avx2(
    kernel: &Kernel,
    brick: &Placed,
    weights: &Weights,
    octants: Octants,
    cells: &mut [i16; BRICK_CELLS],
) {
    let free = _mm_set1_epi16(kernel.free(weights));
    for octant in bits_of(octants.free) {
        for pair in 0..PAIRS {
            put_pair(cells, octant, pair, free);
        }
    }
    let lanes = Lanes::new(kernel, brick, weights);
    for octant in bits_of(octants.touched & !octants.free) {
        let rows = [0, 2].map(|y| {
            let [x, y, _] = cell_in_brick(octant, [0, y, 0]);
            lanes_of_rows(brick, x as f32, y as f32)
        });
        for pair in 0..PAIRS {
            let [_, _, z] = cell_in_brick(octant, [0, 0, pair / 2]);
            let (layer, rows) = (brick.layer(z as f32), &rows[pair % 2]);
            let along = |i: usize| _mm256_add_ps(_mm256_set1_ps(layer[i]), rows[i]);
            let evidence = lanes.cells([along(0), along(1), along(2)]);
            // Saturating to i16 changes nothing: the lanes are within its range.
            let packed = _mm_packs_epi32(
                _mm256_castsi256_si128(evidence),
                _mm256_extracti128_si256::<1>(evidence),
            );
            put_pair(cells, octant, pair, packed);
        }
    }
}

/// Pairs of rows in an octant: of each layer two.
const PAIRS: usize = 2 * OCTANT_EDGE;

/// Puts the evidence of a pair of rows into that of their brick.
#[target_feature(enable = "avx2")]
#[inline]
fn put_pair(cells: &mut [i16; BRICK_CELLS], octant: u8, pair: usize, found: __m128i) {
    // SAFETY: both are 16 bytes, of which any value is one.
    let found: [i16; 2 * OCTANT_EDGE] = unsafe { std::mem::transmute(found) };
    let first = index_of(cell_in_brick(octant, [0, pair % 2 * 2, pair / 2]));
    for (row, found) in found.chunks_exact(OCTANT_EDGE).enumerate() {
        let first = first + row * BRICK_EDGE as usize;
        cells[first..first + OCTANT_EDGE].copy_from_slice(found);
    }
}

/// The way from the first cell of a layer to those of two rows of four that begin at `(x, y)`.
#[target_feature(enable = "avx2")]
#[inline]
fn lanes_of_rows(brick: &Placed, x: f32, y: f32) -> [__m256; 3] {
    let x = _mm256_add_ps(
        _mm256_set1_ps(x),
        _mm256_setr_ps(0.0, 1.0, 2.0, 3.0, 0.0, 1.0, 2.0, 3.0),
    );
    let y = _mm256_add_ps(
        _mm256_set1_ps(y),
        _mm256_setr_ps(0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0),
    );
    let way = |i: usize| {
        _mm256_add_ps(
            _mm256_mul_ps(x, _mm256_set1_ps(brick.steps[0][i])),
            _mm256_mul_ps(y, _mm256_set1_ps(brick.steps[1][i])),
        )
    };
    [way(0), way(1), way(2)]
}

/// Constants of a brick in all lanes.
struct Lanes<'a> {
    kernel: &'a Kernel<'a>,
    focal: [__m256; 2],
    center: [__m256; 2],
    last: [__m256; 2],
    stride: __m256i,
    /// The first table's evidence of free space.
    free: __m256i,
    cell_focal: __m256,
    min_depth: __m256,
    max_range: __m256,
    /// Factors on the sum of one sample, of four and of eight by the number of those that hit, less one.
    single: __m256,
    by_hits_of_four: __m256,
    by_hits: __m256,
    obstacle: __m256i,
}

impl<'a> Lanes<'a> {
    #[target_feature(enable = "avx2")]
    #[inline]
    fn new(kernel: &'a Kernel<'a>, brick: &Placed, weights: &Weights) -> Self {
        let image = kernel.image;
        let all = |value: f32| _mm256_set1_ps(value);
        let w = weights.by_hits;
        // The sum of four samples counts twice, and so does each of them.
        let four = _mm256_setr_ps(w[1], w[3], w[5], w[7], 0.0, 0.0, 0.0, 0.0);
        let four = _mm256_mul_ps(four, all(2.0));
        Self {
            kernel,
            focal: image.focal.map(|focal| _mm256_set1_ps(focal)),
            center: image.center.map(|center| _mm256_set1_ps(center)),
            last: image.last.map(|last| _mm256_set1_ps(last)),
            free: _mm256_set1_epi32(kernel.tables.entries[0]),
            stride: _mm256_set1_epi32(image.stride as i32),
            cell_focal: all(brick.cell * image.focal[0]),
            min_depth: all(brick.min_depth),
            max_range: all(brick.max_range),
            single: all(weights.single),
            by_hits_of_four: four,
            by_hits: _mm256_setr_ps(w[0], w[1], w[2], w[3], w[4], w[5], w[6], w[7]),
            obstacle: _mm256_set1_epi32(weights.obstacle),
        }
    }

    /// Evidence of eight cells with centres `(x, y, z)`, as i32.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn cells(&self, [x, y, z]: [__m256; 3]) -> __m256i {
        let squares = _mm256_add_ps(_mm256_mul_ps(x, x), _mm256_mul_ps(y, y));
        let range = _mm256_sqrt_ps(_mm256_add_ps(squares, _mm256_mul_ps(z, z)));
        let is_usable = _mm256_and_ps(
            _mm256_cmp_ps::<_CMP_GT_OQ>(z, self.min_depth),
            _mm256_cmp_ps::<_CMP_LE_OQ>(range, self.max_range),
        );
        let inverse = _mm256_div_ps(_mm256_set1_ps(1.0), z);
        let pixel = |c: __m256, i: usize| {
            _mm256_add_ps(
                _mm256_mul_ps(_mm256_mul_ps(c, inverse), self.focal[i]),
                self.center[i],
            )
        };
        let (u, v) = (pixel(x, 0), pixel(y, 1));
        let width = _mm256_and_ps(is_usable, _mm256_mul_ps(self.cell_focal, inverse));
        let up_to = |px: f32| _mm256_cmp_ps::<_CMP_LE_OQ>(width, _mm256_set1_ps(px));
        let (is_small, is_at_most_medium) = (up_to(SINGLE_SAMPLE_PX), up_to(FOUR_SAMPLES_PX));
        let mut evidence = _mm256_setzero_si256();
        let mut choose = |chosen: __m256, found: __m256i| {
            let found = _mm256_and_si256(found, _mm256_castps_si256(chosen));
            evidence = _mm256_or_si256(evidence, found);
        };
        if _mm256_movemask_ps(is_small) != 0 {
            let index = _mm256_add_epi32(self.row_start(v), self.column(u));
            choose(is_small, scaled(self.sample(index, range), self.single));
        }
        let is_medium = _mm256_andnot_ps(is_small, is_at_most_medium);
        if _mm256_movemask_ps(is_medium) != 0 {
            choose(is_medium, self.mean_of_four([u, v], width, range));
        }
        if _mm256_movemask_ps(is_at_most_medium) != 0xff {
            let is_large = _mm256_cmp_ps::<_CMP_GT_OQ>(width, _mm256_set1_ps(FOUR_SAMPLES_PX));
            choose(is_large, self.mean_of_eight([u, v], width, range));
        }
        _mm256_and_si256(evidence, _mm256_castps_si256(is_usable))
    }

    /// The weighted mean of the evidence of a small square of samples: two columns and two rows.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn mean_of_four(&self, [u, v]: [__m256; 2], width: __m256, range: __m256) -> __m256i {
        let moved = |c: __m256, d: f32| _mm256_add_ps(c, _mm256_mul_ps(_mm256_set1_ps(d), width));
        let [[left, upper], .., [right, lower]] = FOUR_SAMPLES;
        let columns = [left, right].map(|d| self.column(moved(u, d)));
        let rows = [upper, lower].map(|d| self.row_start(moved(v, d)));
        let mut samples = Sum::new();
        for row in rows {
            for column in columns {
                let index = _mm256_add_epi32(row, column);
                samples.add(self.sample(index, range), self.obstacle);
            }
        }
        samples.mean(self.by_hits_of_four)
    }

    /// The weighted mean of the evidence of the samples of a wide footprint.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn mean_of_eight(&self, [u, v]: [__m256; 2], width: __m256, range: __m256) -> __m256i {
        let moved = |c: __m256, d: f32| _mm256_add_ps(c, _mm256_mul_ps(_mm256_set1_ps(d), width));
        let mut samples = Sum::new();
        for [du, dv] in EIGHT_SAMPLES {
            let index = _mm256_add_epi32(self.row_start(moved(v, dv)), self.column(moved(u, du)));
            samples.add(self.sample(index, range), self.obstacle);
        }
        samples.mean(self.by_hits)
    }

    /// The columns of pixels that hold `u`.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn column(&self, u: __m256) -> __m256i {
        // `max` returns its second operand for NaN, as the scalar kernel's does.
        let clamped = _mm256_min_ps(_mm256_max_ps(u, _mm256_setzero_ps()), self.last[0]);
        _mm256_cvttps_epi32(clamped)
    }

    /// Where the rows of pixels that hold `v` begin.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn row_start(&self, v: __m256) -> __m256i {
        let clamped = _mm256_min_ps(_mm256_max_ps(v, _mm256_setzero_ps()), self.last[1]);
        _mm256_mullo_epi32(_mm256_cvttps_epi32(clamped), self.stride)
    }

    /// Evidence of the pixels `index`, as i32; 0 where they say nothing.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn sample(&self, index: __m256i, range: __m256) -> __m256i {
        let image = self.kernel.image;
        // SAFETY: column and row are those of a pixel of the image or its border, which `near` holds all.
        let near = unsafe { _mm256_i32gather_ps::<4>(image.near.as_ptr(), index) };
        let [inv_step, last, base] = self.tables(index);
        let offset = _mm256_add_ps(
            _mm256_mul_ps(_mm256_sub_ps(range, near), inv_step),
            _mm256_set1_ps(1.0),
        );
        let position = _mm256_min_ps(_mm256_max_ps(offset, _mm256_setzero_ps()), last);
        if self.kernel.image.tables.is_empty() {
            let is_free = _mm256_cmp_ps::<_CMP_LT_OQ>(position, _mm256_set1_ps(1.0));
            let is_behind = _mm256_cmp_ps::<_CMP_EQ_OQ>(position, last);
            // In free space and behind obstacles, and where nothing is measured, the table is not needed.
            if _mm256_movemask_ps(_mm256_or_ps(is_free, is_behind)) == 0xff {
                return _mm256_and_si256(self.free, _mm256_castps_si256(is_free));
            }
        }
        // Whole numbers below 2^24.
        let entry = _mm256_cvttps_epi32(_mm256_add_ps(base, _mm256_floor_ps(position)));
        let entries = self.kernel.tables.entries.as_ptr();
        // SAFETY: from the first to the last entry of a table that is in `entries`.
        unsafe { _mm256_i32gather_epi32::<4>(entries, entry) }
    }

    /// Step, last position and first index of the tables of those pixels.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn tables(&self, pixels: __m256i) -> [__m256; 3] {
        let rows = &self.kernel.tables.rows[..];
        let tables = &self.kernel.image.tables[..];
        if tables.is_empty() {
            let TableRow {
                inv_step,
                last,
                base,
            } = rows[0];
            return [inv_step, last, base].map(|value| _mm256_set1_ps(value));
        }
        // SAFETY: both are 32 bytes, of which any value is one.
        let pixels: [u32; 8] = unsafe { std::mem::transmute(pixels) };
        let row = |lane: usize| {
            let row = &rows[usize::from(tables[pixels[lane] as usize])];
            _mm_setr_ps(row.inv_step, row.last, row.base, 0.0)
        };
        let pair = |lane: usize| {
            _mm256_insertf128_ps::<1>(_mm256_castps128_ps256(row(lane)), row(lane + 4))
        };
        let (a, b, c, d) = (pair(0), pair(1), pair(2), pair(3));
        let (ab_low, ab_high) = (_mm256_unpacklo_ps(a, b), _mm256_unpackhi_ps(a, b));
        let (cd_low, cd_high) = (_mm256_unpacklo_ps(c, d), _mm256_unpackhi_ps(c, d));
        [
            _mm256_shuffle_ps::<0x44>(ab_low, cd_low),
            _mm256_shuffle_ps::<0xee>(ab_low, cd_low),
            _mm256_shuffle_ps::<0x44>(ab_high, cd_high),
        ]
    }
}

/// Samples in all lanes.
struct Sum {
    evidence: __m256i,
    /// Those that hit, less one.
    hits: __m256i,
}

impl Sum {
    #[target_feature(enable = "avx2")]
    #[inline]
    fn new() -> Self {
        Self {
            evidence: _mm256_setzero_si256(),
            hits: _mm256_set1_epi32(-1),
        }
    }

    /// Obstacles count as often as `obstacle` says in addition.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn add(&mut self, sample: __m256i, obstacle: __m256i) {
        let positive = _mm256_max_epi32(sample, _mm256_setzero_si256());
        let gained = _mm256_add_epi32(sample, _mm256_mullo_epi32(positive, obstacle));
        self.evidence = _mm256_add_epi32(self.evidence, gained);
        // Unequal lanes: 1 + (-1 where equal).
        let missed = _mm256_cmpeq_epi32(sample, _mm256_setzero_si256());
        let hit = _mm256_add_epi32(missed, _mm256_set1_epi32(1));
        self.hits = _mm256_add_epi32(self.hits, hit);
    }

    #[target_feature(enable = "avx2")]
    #[inline]
    fn mean(&self, by_hits: __m256) -> __m256i {
        // Without any hit the factor does not matter.
        scaled(self.evidence, _mm256_permutevar8x32_ps(by_hits, self.hits))
    }
}

/// `sum * factor`, rounded towards zero but never to it.
#[target_feature(enable = "avx2")]
#[inline]
fn scaled(sum: __m256i, factor: __m256) -> __m256i {
    let limit = f32::from(i16::MAX);
    let product = _mm256_mul_ps(_mm256_cvtepi32_ps(sum), factor);
    let limited = _mm256_min_ps(
        _mm256_max_ps(product, _mm256_set1_ps(-limit)),
        _mm256_set1_ps(limit),
    );
    let value = _mm256_cvttps_epi32(limited);
    let vanished = _mm256_cmpeq_epi32(value, _mm256_setzero_si256());
    let sign = _mm256_sign_epi32(_mm256_set1_epi32(1), sum);
    _mm256_or_si256(value, _mm256_and_si256(vanished, sign))
}

#[cfg(test)]
mod tests {
    use super::super::kernel::tests::random_case;
    use super::*;

    #[test]
    fn eight_lanes_give_the_bits_of_the_scalar_kernel_with_one_table_and_with_many() {
        for seed in 0..20 {
            let (mut image, tables, bricks) = random_case(seed);
            for has_one_table in [false, true] {
                if has_one_table {
                    image.tables.clear();
                }
                let kernel = Kernel {
                    image: &image,
                    tables: &tables,
                };
                for (brick, weights) in &bricks {
                    let some = Octants {
                        touched: 0b1010_0111,
                        free: 0b10,
                        clear: 0b10,
                    };
                    let [mut found, mut expected] = [[7; BRICK_CELLS]; 2];
                    if !super::brick(&kernel, brick, weights, some, &mut found) {
                        eprintln!("SKIPPED: this processor has no AVX2");
                        return;
                    }
                    kernel.brick_scalar(brick, weights, some, &mut expected);
                    assert_eq!(found, expected, "{brick:?}");
                }
            }
        }
    }
}
