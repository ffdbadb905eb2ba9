//! The kernel of the rule `fused`, eight cells at a time with AVX2.
//!
//! Lane `i` of a vector is a cell of an octant: `x + (i & 1)`, `y + (i >> 1 & 1)`, `z + (i >> 2)`.
//! Every operation is the IEEE operation of the scalar kernel in the same order (no fused
//! multiply-add), so the results are the same bits; the tests compare them.
#![allow(
    unsafe_code,
    reason = "instructions that not every processor has; vectors and arrays of the same bits"
)]

use std::arch::x86_64::*;

use super::kernel::{
    EIGHT_SAMPLES, FOUR_SAMPLES, FOUR_SAMPLES_PX, Kernel, Placed, SINGLE_SAMPLE_PX, TableRow,
    Weights, put_octant,
};
use crate::key::BRICK_CELLS;

/// Evidence for some octants of a brick; `false`, and nothing done, if this processor has no AVX2.
#[inline]
pub(crate) fn octants(
    kernel: &Kernel,
    brick: &Placed,
    weights: &Weights,
    octants: &[u8],
    cells: &mut [i16; BRICK_CELLS],
) -> bool {
    if !is_x86_feature_detected!("avx2") {
        return false;
    }
    // SAFETY: the processor has AVX2.
    unsafe { octants_avx2(kernel, brick, weights, octants, cells) };
    true
}

#[target_feature(enable = "avx2")]
fn octants_avx2(
    kernel: &Kernel,
    brick: &Placed,
    weights: &Weights,
    octants: &[u8],
    cells: &mut [i16; BRICK_CELLS],
) {
    let lanes = Lanes::new(kernel, brick, weights);
    let ways = |i: usize| vector(|lane| brick.way([0, 1, 2].map(|axis| lane >> axis & 1))[i]);
    let ways = [ways(0), ways(1), ways(2)];
    for &octant in octants {
        let first = brick.first_of(octant);
        let along = |i: usize| _mm256_add_ps(_mm256_set1_ps(first[i]), ways[i]);
        let evidence = lanes.cells([along(0), along(1), along(2)]);
        // Saturating to i16 changes nothing: the lanes are within its range.
        let packed = _mm_packs_epi32(
            _mm256_castsi256_si128(evidence),
            _mm256_extracti128_si256::<1>(evidence),
        );
        let mut found = [0_i16; 8];
        // SAFETY: eight i16 are 16 bytes; the store is unaligned.
        unsafe { _mm_storeu_si128(found.as_mut_ptr().cast(), packed) };
        put_octant(cells, octant, found);
    }
}

/// How wide footprints are sampled, in all lanes.
struct Sampling {
    offsets: &'static [[f32; 2]],
    /// Footprints from beyond this width on, up to the next one's.
    wider_than: f32,
    up_to: f32,
    obstacle: __m256i,
    /// By the number of samples that hit, less one; for four of each two.
    by_hits: __m256,
}

/// Constants of a brick in all lanes.
struct Lanes<'a> {
    kernel: &'a Kernel<'a>,
    focal: [__m256; 2],
    center: [__m256; 2],
    size: [__m256; 2],
    row_stride: __m256i,
    outside: __m256i,
    cell_focal: __m256,
    min_depth: __m256,
    max_range: __m256,
    samplings: [Sampling; 3],
}

impl<'a> Lanes<'a> {
    #[target_feature(enable = "avx2")]
    #[inline]
    fn new(kernel: &'a Kernel<'a>, brick: &Placed, weights: &Weights) -> Self {
        let image = kernel.image;
        let all = |value: f32| _mm256_set1_ps(value);
        let w = weights.by_hits;
        let obstacle = _mm256_set1_epi32(weights.obstacle);
        let sampling = |offsets, [wider_than, up_to]: [f32; 2], obstacle, by_hits| Sampling {
            offsets,
            wider_than,
            up_to,
            obstacle,
            by_hits,
        };
        let single = all(weights.single);
        // The sum of four samples counts twice, and so does each of them.
        let four = _mm256_setr_ps(w[1], w[3], w[5], w[7], 0.0, 0.0, 0.0, 0.0);
        let four = _mm256_mul_ps(four, all(2.0));
        let eight = _mm256_setr_ps(w[0], w[1], w[2], w[3], w[4], w[5], w[6], w[7]);
        Self {
            kernel,
            focal: image.focal.map(|focal| _mm256_set1_ps(focal)),
            center: image.center.map(|center| _mm256_set1_ps(center)),
            size: [image.width, image.height].map(|edge| _mm256_set1_ps(edge as f32)),
            row_stride: _mm256_set1_epi32(image.width as i32),
            outside: _mm256_set1_epi32(image.near.len() as i32 - 1),
            cell_focal: all(brick.cell * image.focal[0]),
            min_depth: all(brick.min_depth),
            max_range: all(brick.max_range),
            samplings: [
                sampling(
                    &[[0.0; 2]],
                    [0.0, SINGLE_SAMPLE_PX],
                    _mm256_setzero_si256(),
                    single,
                ),
                sampling(
                    &FOUR_SAMPLES,
                    [SINGLE_SAMPLE_PX, FOUR_SAMPLES_PX],
                    obstacle,
                    four,
                ),
                sampling(
                    &EIGHT_SAMPLES,
                    [FOUR_SAMPLES_PX, f32::INFINITY],
                    obstacle,
                    eight,
                ),
            ],
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
        let mut evidence = _mm256_setzero_si256();
        for sampling in &self.samplings {
            let is_wider = _mm256_cmp_ps::<_CMP_GT_OQ>(width, _mm256_set1_ps(sampling.wider_than));
            let is_up_to = _mm256_cmp_ps::<_CMP_LE_OQ>(width, _mm256_set1_ps(sampling.up_to));
            let is_chosen = _mm256_and_ps(is_wider, is_up_to);
            if _mm256_movemask_ps(is_chosen) != 0 {
                let found = self.mean_of(sampling, [u, v], width, range);
                let found = _mm256_and_si256(found, _mm256_castps_si256(is_chosen));
                evidence = _mm256_or_si256(evidence, found);
            }
        }
        evidence
    }

    /// The weighted mean of the samples' evidence.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn mean_of(
        &self,
        sampling: &Sampling,
        [u, v]: [__m256; 2],
        width: __m256,
        range: __m256,
    ) -> __m256i {
        let mut sum = _mm256_setzero_si256();
        let mut hits = _mm256_set1_epi32(-1);
        for [du, dv] in sampling.offsets {
            let offset = |d: f32| _mm256_mul_ps(_mm256_set1_ps(d), width);
            let sample = self.sample(
                _mm256_add_ps(u, offset(*du)),
                _mm256_add_ps(v, offset(*dv)),
                range,
            );
            let positive = _mm256_max_epi32(sample, _mm256_setzero_si256());
            let gained = _mm256_add_epi32(sample, _mm256_mullo_epi32(positive, sampling.obstacle));
            sum = _mm256_add_epi32(sum, gained);
            // Unequal lanes: 1 + (-1 where equal).
            let missed = _mm256_cmpeq_epi32(sample, _mm256_setzero_si256());
            hits = _mm256_add_epi32(hits, _mm256_add_epi32(missed, _mm256_set1_epi32(1)));
        }
        // Without any hit the factor does not matter.
        scaled(sum, _mm256_permutevar8x32_ps(sampling.by_hits, hits))
    }

    /// Evidence of the pixels that hold `(u, v)`, as i32; 0 where they say nothing.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn sample(&self, u: __m256, v: __m256, range: __m256) -> __m256i {
        let zero = _mm256_setzero_ps();
        let inside = |c: __m256, i: usize| {
            _mm256_and_ps(
                _mm256_cmp_ps::<_CMP_GE_OQ>(c, zero),
                _mm256_cmp_ps::<_CMP_LT_OQ>(c, self.size[i]),
            )
        };
        let is_inside = _mm256_castps_si256(_mm256_and_ps(inside(u, 0), inside(v, 1)));
        let column = _mm256_cvttps_epi32(u);
        let row = _mm256_cvttps_epi32(v);
        let index = _mm256_add_epi32(_mm256_mullo_epi32(row, self.row_stride), column);
        let index = _mm256_blendv_epi8(self.outside, index, is_inside);
        let pixels = array(index);
        let near = &self.kernel.image.near[..];
        let near = vector(|lane| near[pixels[lane] as usize]);
        let [inv_step, last, base] = self.tables(&pixels);
        let offset = _mm256_add_ps(
            _mm256_mul_ps(_mm256_sub_ps(range, near), inv_step),
            _mm256_set1_ps(1.0),
        );
        // `max` returns its second operand for NaN, as the scalar kernel's does.
        let position = _mm256_min_ps(_mm256_max_ps(offset, zero), last);
        // Whole numbers below 2^24.
        let entry = _mm256_cvttps_epi32(_mm256_add_ps(base, _mm256_floor_ps(position)));
        let entries = &self.kernel.tables.entries[..];
        let places = array(entry);
        vector_of_integers(|lane| i32::from(entries[places[lane] as usize]))
    }

    /// Step, last position and first index of the tables of those pixels.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn tables(&self, pixels: &[u32; 8]) -> [__m256; 3] {
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

/// The lanes as an array. Values are looked up one by one: less than half the time of a gather.
#[target_feature(enable = "avx2")]
#[inline]
fn array(lanes: __m256i) -> [u32; 8] {
    // SAFETY: both are 32 bytes, of which any value is one.
    unsafe { std::mem::transmute(lanes) }
}

#[target_feature(enable = "avx2")]
#[inline]
fn vector(at: impl Fn(usize) -> f32) -> __m256 {
    _mm256_setr_ps(at(0), at(1), at(2), at(3), at(4), at(5), at(6), at(7))
}

#[target_feature(enable = "avx2")]
#[inline]
fn vector_of_integers(at: impl Fn(usize) -> i32) -> __m256i {
    _mm256_setr_epi32(at(0), at(1), at(2), at(3), at(4), at(5), at(6), at(7))
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
                    let some = [0, 21, 1, 63, 42, 42, 16, 7];
                    let [mut found, mut expected] = [[7; BRICK_CELLS]; 2];
                    if !octants(&kernel, brick, weights, &some, &mut found) {
                        eprintln!("SKIPPED: this processor has no AVX2");
                        return;
                    }
                    kernel.octants_scalar(brick, weights, &some, &mut expected);
                    assert_eq!(found, expected, "{brick:?}");
                }
            }
        }
    }
}
