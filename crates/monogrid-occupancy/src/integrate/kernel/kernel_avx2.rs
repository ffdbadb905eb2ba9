//! The kernel of the rule `fused`, eight cells at a time with AVX2.
//!
//! Lane `i` of a vector is a cell of an octant: `x + (i & 3)`, `y + (i >> 2)`; eight vectors are an
//! octant. Every operation is the IEEE operation of the scalar kernel in the same order (no fused
//! multiply-add), so the results are the same bits; the tests compare them.
//!
//! What a vector waits for follows from one another: a root and a division, the lookup of a pixel
//! and that of its evidence. Octants whose cells all take a single sample go through these steps
//! one after the other, all vectors of a step side by side. Where all measurements see free space,
//! only whether a pixel has one is looked up, in bits (`holes_avx2`).
#![allow(
    unsafe_code,
    reason = "instructions that not every processor has; vectors and arrays of the same bits"
)]

use std::arch::x86_64::*;

use crate::integrate::kernel::block_avx2::{Block, Samples, VECTORS, put_octant, samples};
use crate::integrate::kernel::scalar::{
    EIGHT_SAMPLES, FOUR_SAMPLES, FOUR_SAMPLES_PX, Kernel, Placed, SINGLE_SAMPLE_PX, TableRow,
    Weights, bits_of, sum,
};
use crate::integrate::octants::Octants;
use crate::key::BRICK_CELLS;

/// Evidence for the touched octants of a brick; `false`, and nothing done, if this processor has no
/// AVX2, or the image has too many rows or columns for a product of 16 bits.
#[inline]
pub(crate) fn brick(
    kernel: &Kernel,
    brick: &Placed,
    weights: &Weights,
    octants: Octants,
    cells: &mut [i16; BRICK_CELLS],
) -> bool {
    let is_small = kernel
        .image
        .last
        .iter()
        .all(|&last| last < f32::from(i16::MAX));
    if !(is_small && is_x86_feature_detected!("avx2")) {
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
    let free = _mm256_set1_epi32(i32::from(kernel.free(weights)));
    for octant in bits_of(octants.free) {
        put_octant(cells, octant, &[free; VECTORS]);
    }
    if kernel.image.tables.is_empty() {
        Lanes::<true>::new(kernel, brick, weights).octants(brick, octants, cells);
    } else {
        Lanes::<false>::new(kernel, brick, weights).octants(brick, octants, cells);
    }
}

/// Constants of a brick in all lanes; `ONE_TABLE` if all pixels have the first.
pub(super) struct Lanes<'a, const ONE_TABLE: bool> {
    pub kernel: &'a Kernel<'a>,
    pub weights: &'a Weights,
    focal: [__m256; 2],
    center: [__m256; 2],
    last: [__m256; 2],
    stride: __m256i,
    cell_focal: __m256,
    min_depth: __m256,
    max_range: __m256,
    /// The last entry of the first table, and what its first adds to a sum.
    last_entry: __m256i,
    free_gain: __m256i,
    /// Factors on the sum of one sample, of four and of eight by the number of those that hit, less
    /// one.
    single: __m256,
    by_hits_of_four: __m256,
    by_hits: __m256,
}

impl<'a, const ONE_TABLE: bool> Lanes<'a, ONE_TABLE> {
    #[target_feature(enable = "avx2")]
    #[inline]
    fn new(kernel: &'a Kernel<'a>, brick: &Placed, weights: &'a Weights) -> Self {
        let image = kernel.image;
        let all = |value: f32| _mm256_set1_ps(value);
        let w = weights.by_hits;
        // The sum of four samples counts twice, and so does each of them.
        let four = _mm256_setr_ps(w[1], w[3], w[5], w[7], 0.0, 0.0, 0.0, 0.0);
        let four = _mm256_mul_ps(four, all(2.0));
        Self {
            kernel,
            weights,
            focal: image.focal.map(|focal| _mm256_set1_ps(focal)),
            center: image.center.map(|center| _mm256_set1_ps(center)),
            last: image.last.map(|last| _mm256_set1_ps(last)),
            stride: _mm256_set1_epi32(image.stride as i32),
            cell_focal: all(brick.cell * image.focal[0]),
            min_depth: all(brick.min_depth),
            max_range: all(brick.max_range),
            last_entry: _mm256_set1_epi32(kernel.tables.rows[0].last as i32),
            free_gain: _mm256_set1_epi32(kernel.tables.gains[0]),
            single: all(weights.single),
            by_hits_of_four: four,
            by_hits: _mm256_setr_ps(w[0], w[1], w[2], w[3], w[4], w[5], w[6], w[7]),
        }
    }

    /// Evidence for the touched octants that are not free all over.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn octants(&self, brick: &Placed, octants: Octants, cells: &mut [i16; BRICK_CELLS]) {
        let clear = match self.kernel.tables.one_free && brick.is_within_range() {
            true => octants.clear,
            false => 0,
        };
        for octant in bits_of(octants.touched & !octants.free) {
            let block = Block::new(brick, octant);
            let is_clear = clear >> octant & 1 != 0;
            let found = match samples(brick.cell * self.kernel.image.focal[0], &block) {
                Samples::One if is_clear => self.single_through_holes(&block),
                Samples::Four if is_clear => self.mean_of_four_through_holes(&block),
                Samples::One => Some(self.singles(&block)),
                _ => None,
            };
            let found = found.unwrap_or_else(|| self.any(&block, is_clear));
            put_octant(cells, octant, &found);
        }
    }

    /// Evidence of the cells of an octant that take a single sample.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn singles(&self, block: &Block) -> [__m256i; VECTORS] {
        let mut usable = [_mm256_setzero_ps(); VECTORS];
        let mut ranges = usable;
        let mut pixels = [_mm256_setzero_si256(); VECTORS];
        for vector in 0..VECTORS {
            let center = block.centers(vector);
            let (range, is_usable) = self.range(center);
            let [u, v] = self.slopes(center).0;
            (ranges[vector], usable[vector]) = (range, is_usable);
            pixels[vector] = _mm256_add_epi32(self.row_start(v), self.column(u));
        }
        let mut entries = pixels;
        for vector in 0..VECTORS {
            entries[vector] = self.entry(pixels[vector], ranges[vector]);
        }
        let mut found = entries;
        for vector in 0..VECTORS {
            let evidence = scaled(self.look_up(entries[vector]), self.single);
            found[vector] = _mm256_and_si256(evidence, _mm256_castps_si256(usable[vector]));
        }
        found
    }

    /// Evidence of the cells of an octant.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn any(&self, block: &Block, is_clear: bool) -> [__m256i; VECTORS] {
        let mut found = [_mm256_setzero_si256(); VECTORS];
        for (vector, found) in found.iter_mut().enumerate() {
            let center = block.centers(vector);
            let through_holes = match is_clear {
                true => self.mean_of_eight_through_holes(center),
                false => None,
            };
            *found = through_holes.unwrap_or_else(|| self.cells(center));
        }
        found
    }

    /// Ranges of cells, and whether they get anything.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn range(&self, [x, y, z]: [__m256; 3]) -> (__m256, __m256) {
        let squares = _mm256_add_ps(_mm256_mul_ps(x, x), _mm256_mul_ps(y, y));
        let range = _mm256_sqrt_ps(_mm256_add_ps(squares, _mm256_mul_ps(z, z)));
        let is_near = _mm256_cmp_ps::<_CMP_LE_OQ>(range, self.max_range);
        (range, _mm256_and_ps(self.is_deep(z), is_near))
    }

    #[target_feature(enable = "avx2")]
    #[inline]
    pub(super) fn is_deep(&self, z: __m256) -> __m256 {
        _mm256_cmp_ps::<_CMP_GT_OQ>(z, self.min_depth)
    }

    /// Places of cells in the image, and the inverse of their depth.
    #[target_feature(enable = "avx2")]
    #[inline]
    pub(super) fn slopes(&self, [x, y, z]: [__m256; 3]) -> ([__m256; 2], __m256) {
        let inverse = _mm256_div_ps(_mm256_set1_ps(1.0), z);
        let pixel = |c: __m256, i: usize| {
            _mm256_add_ps(
                _mm256_mul_ps(_mm256_mul_ps(c, inverse), self.focal[i]),
                self.center[i],
            )
        };
        ([pixel(x, 0), pixel(y, 1)], inverse)
    }

    /// Widths of footprints at the inverse of a depth.
    #[target_feature(enable = "avx2")]
    #[inline]
    pub(super) fn width(&self, inverse: __m256) -> __m256 {
        _mm256_mul_ps(self.cell_focal, inverse)
    }

    /// Evidence of eight cells, as i32.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn cells(&self, center: [__m256; 3]) -> __m256i {
        let (range, is_usable) = self.range(center);
        let ([u, v], inverse) = self.slopes(center);
        let width = _mm256_and_ps(is_usable, self.width(inverse));
        let up_to = |px: f32| _mm256_cmp_ps::<_CMP_LE_OQ>(width, _mm256_set1_ps(px));
        let (is_small, is_at_most_medium) = (up_to(SINGLE_SAMPLE_PX), up_to(FOUR_SAMPLES_PX));
        let mut evidence = _mm256_setzero_si256();
        let mut choose = |chosen: __m256, found: __m256i| {
            let found = _mm256_and_si256(found, _mm256_castps_si256(chosen));
            evidence = _mm256_or_si256(evidence, found);
        };
        if _mm256_movemask_ps(is_small) != 0 {
            let index = _mm256_add_epi32(self.row_start(v), self.column(u));
            choose(
                is_small,
                scaled(self.look_up(self.entry(index, range)), self.single),
            );
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
        let [[left, upper], .., [right, lower]] = FOUR_SAMPLES;
        let columns = [left, right].map(|d| self.column(moved(u, d, width)));
        let rows = [upper, lower].map(|d| self.row_start(moved(v, d, width)));
        let mut sum = _mm256_setzero_si256();
        for row in rows {
            for column in columns {
                let index = _mm256_add_epi32(row, column);
                sum = _mm256_add_epi32(sum, self.gain(index, range));
            }
        }
        mean(sum, self.by_hits_of_four)
    }

    /// The weighted mean of the evidence of the samples of a wide footprint.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn mean_of_eight(&self, [u, v]: [__m256; 2], width: __m256, range: __m256) -> __m256i {
        let mut sum = _mm256_setzero_si256();
        for [du, dv] in EIGHT_SAMPLES {
            let (row, column) = (moved(v, dv, width), moved(u, du, width));
            let index = _mm256_add_epi32(self.row_start(row), self.column(column));
            sum = _mm256_add_epi32(sum, self.gain(index, range));
        }
        mean(sum, self.by_hits)
    }

    /// The columns of pixels that hold `u`.
    #[target_feature(enable = "avx2")]
    #[inline]
    pub(super) fn column(&self, u: __m256) -> __m256i {
        // `max` returns its second operand for NaN, as the scalar kernel's does.
        let clamped = _mm256_min_ps(_mm256_max_ps(u, _mm256_setzero_ps()), self.last[0]);
        _mm256_cvttps_epi32(clamped)
    }

    /// The rows of pixels that hold `v`.
    #[target_feature(enable = "avx2")]
    #[inline]
    pub(super) fn row(&self, v: __m256) -> __m256i {
        let clamped = _mm256_min_ps(_mm256_max_ps(v, _mm256_setzero_ps()), self.last[1]);
        _mm256_cvttps_epi32(clamped)
    }

    /// Where those rows begin.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn row_start(&self, v: __m256) -> __m256i {
        // Both factors are below 2^15; `mullo_epi32` takes twice as long.
        _mm256_madd_epi16(self.row(v), self.stride)
    }

    /// What the pixels `index` add to the sum of a footprint.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn gain(&self, index: __m256i, range: __m256) -> __m256i {
        let entry = self.entry(index, range);
        let gains = self.kernel.tables.gains.as_ptr();
        if ONE_TABLE {
            let is_free = _mm256_cmpeq_epi32(entry, _mm256_setzero_si256());
            let is_behind = _mm256_cmpeq_epi32(entry, self.last_entry);
            // In free space and behind obstacles, and where nothing is measured, the table is not
            // needed.
            if _mm256_movemask_epi8(_mm256_or_si256(is_free, is_behind)) == -1 {
                return _mm256_and_si256(self.free_gain, is_free);
            }
        }
        // SAFETY: from the first to the last entry of a table, of which each has a gain.
        unsafe { _mm256_castps_si256(gather(gains.cast(), entry)) }
    }

    /// The entries of the tables for the pixels `index`.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn entry(&self, index: __m256i, range: __m256) -> __m256i {
        let image = self.kernel.image;
        // SAFETY: column and row are those of a pixel of the image or its border, which `near`
        // holds all.
        let near = unsafe { gather(image.near.as_ptr(), index) };
        let [inv_step, last, base] = self.tables(index);
        let offset = _mm256_add_ps(
            _mm256_mul_ps(_mm256_sub_ps(range, near), inv_step),
            _mm256_set1_ps(1.0),
        );
        let position = _mm256_min_ps(_mm256_max_ps(offset, _mm256_setzero_ps()), last);
        let position = _mm256_cvttps_epi32(position);
        if ONE_TABLE {
            // The first table begins at 0.
            return position;
        }
        _mm256_add_epi32(_mm256_cvttps_epi32(base), position)
    }

    /// Evidence of entries.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn look_up(&self, entry: __m256i) -> __m256i {
        let entries = self.kernel.tables.entries.as_ptr();
        // SAFETY: from the first to the last entry of a table that is in `entries`.
        unsafe { _mm256_castps_si256(gather(entries.cast(), entry)) }
    }

    /// Step, last position and first index of the tables of those pixels.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn tables(&self, pixels: __m256i) -> [__m256; 3] {
        let rows = &self.kernel.tables.rows[..];
        let tables = &self.kernel.image.tables[..];
        if ONE_TABLE {
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

/// Eight values of a list, loaded one by one: in less time than by the instruction that does it.
#[target_feature(enable = "avx2")]
#[inline]
unsafe fn gather(list: *const f32, index: __m256i) -> __m256 {
    // SAFETY: both are 32 bytes, of which any value is one.
    let pairs: [u64; 4] = unsafe { std::mem::transmute(index) };
    // SAFETY: the caller knows that the list holds all of them.
    let at = |index: u64| unsafe { *list.add(index as usize) };
    let [a, b, c, d] = pairs.map(|pair| [at(pair & 0xffff_ffff), at(pair >> 32)]);
    _mm256_setr_ps(a[0], a[1], b[0], b[1], c[0], c[1], d[0], d[1])
}

/// A place of a sample: a share of the footprint's width from its centre.
#[target_feature(enable = "avx2")]
#[inline]
pub(super) fn moved(center: __m256, share: f32, width: __m256) -> __m256 {
    _mm256_add_ps(center, _mm256_mul_ps(_mm256_set1_ps(share), width))
}

/// The weighted mean of a sum of gains.
#[target_feature(enable = "avx2")]
#[inline]
fn mean(sum: __m256i, by_hits: __m256) -> __m256i {
    let evidence = _mm256_srai_epi32::<{ sum::HIT_BITS as i32 }>(sum);
    // Of the number of hits less one the lowest three bits count; without any hit the factor does
    // not matter.
    let hits = _mm256_add_epi32(sum, _mm256_set1_epi32(-1));
    scaled(evidence, _mm256_permutevar8x32_ps(by_hits, hits))
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
    use super::*;
    use crate::integrate::kernel::scalar::cells_of;
    use crate::integrate::kernel::scalar::tests::random_case;

    /// The octants of a brick of which no cell is as far as anything measured.
    fn clear_octants(brick: &Placed) -> u8 {
        let is_clear = |octant: &u8| {
            cells_of(*octant).all(|cell| {
                let [x, y, z] = brick.center(cell);
                (x * x + y * y + z * z).sqrt() < 1.0
            })
        };
        (0..8).filter(is_clear).fold(0, |bits, o| bits | 1 << o)
    }

    #[test]
    fn eight_lanes_give_the_bits_of_the_scalar_kernel_with_one_table_and_with_many() {
        let mut num_clear = 0;
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
                        clear: 0b10 | clear_octants(brick),
                    };
                    num_clear += (some.clear & some.touched).count_ones() - 1;
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
        assert!(num_clear > 1000, "{num_clear}");
    }
}
