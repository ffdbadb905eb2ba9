//! The kernel of the rule `fused`, eight cells at a time with AVX2.
//!
//! Lane `i` of a vector is a cell of an octant: `x + (i & 1)`, `y + (i >> 1 & 1)`, `z + (i >> 2)`.
//! Every operation is the IEEE operation of the scalar kernel in the same order (no fused
//! multiply-add), so the results are the same bits; the tests compare them.
#![allow(
    unsafe_code,
    reason = "gathers from slices whose bounds the code checks by lanes"
)]

use std::arch::x86_64::*;

use super::kernel::{
    BLOCK_CELLS, Block, EIGHT_SAMPLES, FOUR_SAMPLES, FOUR_SAMPLES_PX, Kernel, SINGLE_SAMPLE_PX,
    Weights,
};

/// Evidence for the `wanted` octants of a block; `false`, and nothing done, if this processor has
/// no AVX2.
#[inline]
pub(crate) fn block(
    kernel: &Kernel,
    block: &Block,
    weights: &Weights,
    wanted: u8,
    evidence: &mut [i16; BLOCK_CELLS],
) -> bool {
    if !is_x86_feature_detected!("avx2") {
        return false;
    }
    // SAFETY: the processor has AVX2.
    unsafe { block_avx2(kernel, block, weights, wanted, evidence) };
    true
}

#[target_feature(enable = "avx2")]
fn block_avx2(
    kernel: &Kernel,
    block: &Block,
    weights: &Weights,
    wanted: u8,
    out: &mut [i16; BLOCK_CELLS],
) {
    let lane_x = _mm256_setr_ps(0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0);
    let lane_y = _mm256_setr_ps(0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 1.0);
    let lane_z = _mm256_setr_ps(0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0);
    let lanes = Lanes::new(kernel, block, weights);
    for (octant, cells) in out.chunks_exact_mut(8).enumerate() {
        if wanted >> octant & 1 == 0 {
            continue;
        }
        let side = |axis: usize| _mm256_set1_ps((octant >> axis & 1) as f32 * 2.0);
        let x = _mm256_add_ps(lane_x, side(0));
        let y = _mm256_add_ps(lane_y, side(1));
        let z = _mm256_add_ps(lane_z, side(2));
        let along = |i: usize| {
            let [sx, sy, sz] = block.steps.map(|step| _mm256_set1_ps(step[i]));
            let layer = _mm256_add_ps(_mm256_set1_ps(block.first[i]), _mm256_mul_ps(z, sz));
            let row = _mm256_add_ps(_mm256_mul_ps(x, sx), _mm256_mul_ps(y, sy));
            _mm256_add_ps(layer, row)
        };
        let evidence = lanes.cells([along(0), along(1), along(2)]);
        // Saturating to i16 changes nothing: the lanes are within its range.
        let packed = _mm_packs_epi32(
            _mm256_castsi256_si128(evidence),
            _mm256_extracti128_si256::<1>(evidence),
        );
        let mut lanes_out = [0_i16; 8];
        // SAFETY: eight i16 are 16 bytes; the store is unaligned.
        unsafe { _mm_storeu_si128(lanes_out.as_mut_ptr().cast(), packed) };
        cells.copy_from_slice(&lanes_out);
    }
}

/// Constants of a block in all lanes.
struct Lanes<'a> {
    kernel: &'a Kernel<'a>,
    focal: [__m256; 2],
    center: [__m256; 2],
    size: [__m256; 2],
    row_stride: __m256i,
    cell_focal: __m256,
    min_depth: __m256,
    max_range: __m256,
    single: __m256,
    by_hits: __m256,
    obstacle: __m256i,
}

impl<'a> Lanes<'a> {
    #[target_feature(enable = "avx2")]
    #[inline]
    fn new(kernel: &'a Kernel<'a>, block: &Block, weights: &Weights) -> Self {
        let image = kernel.image;
        let w = weights.by_hits;
        Self {
            kernel,
            focal: [
                _mm256_set1_ps(image.focal[0]),
                _mm256_set1_ps(image.focal[1]),
            ],
            center: [
                _mm256_set1_ps(image.center[0]),
                _mm256_set1_ps(image.center[1]),
            ],
            size: [
                _mm256_set1_ps(image.width as f32),
                _mm256_set1_ps(image.height as f32),
            ],
            row_stride: _mm256_set1_epi32(image.width as i32),
            cell_focal: _mm256_set1_ps(block.cell * image.focal[0]),
            min_depth: _mm256_set1_ps(block.min_depth),
            max_range: _mm256_set1_ps(block.max_range),
            single: _mm256_set1_ps(weights.single),
            obstacle: _mm256_set1_epi32(weights.obstacle),
            by_hits: _mm256_setr_ps(w[0], w[1], w[2], w[3], w[4], w[5], w[6], w[7]),
        }
    }

    /// Evidence of eight cells with centres `(x, y, z)`, as i32.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn cells(&self, [x, y, z]: [__m256; 3]) -> __m256i {
        let squares = _mm256_add_ps(_mm256_mul_ps(x, x), _mm256_mul_ps(y, y));
        let range = _mm256_sqrt_ps(_mm256_add_ps(squares, _mm256_mul_ps(z, z)));
        let usable = _mm256_and_ps(
            _mm256_cmp_ps::<_CMP_GT_OQ>(z, self.min_depth),
            _mm256_cmp_ps::<_CMP_LE_OQ>(range, self.max_range),
        );
        if _mm256_movemask_ps(usable) == 0 {
            return _mm256_setzero_si256();
        }
        let inverse = _mm256_div_ps(_mm256_set1_ps(1.0), z);
        let pixel = |c: __m256, i: usize| {
            _mm256_add_ps(
                _mm256_mul_ps(_mm256_mul_ps(c, inverse), self.focal[i]),
                self.center[i],
            )
        };
        let (u, v) = (pixel(x, 0), pixel(y, 1));
        let width = _mm256_mul_ps(self.cell_focal, inverse);
        let up_to = |limit: f32| _mm256_cmp_ps::<_CMP_LE_OQ>(width, _mm256_set1_ps(limit));
        let (is_single, is_four) = (up_to(SINGLE_SAMPLE_PX), up_to(FOUR_SAMPLES_PX));
        let any = |lanes: __m256| _mm256_movemask_ps(_mm256_and_ps(lanes, usable)) != 0;
        let select = |otherwise: __m256i, chosen: __m256i, lanes: __m256| {
            _mm256_blendv_epi8(otherwise, chosen, _mm256_castps_si256(lanes))
        };
        let mut evidence = _mm256_setzero_si256();
        if _mm256_movemask_ps(_mm256_andnot_ps(is_four, usable)) != 0 {
            let (sum, hits) = self.sum(&EIGHT_SAMPLES, [u, v], width, range);
            evidence = self.weighted(sum, hits);
        }
        if any(_mm256_andnot_ps(is_single, is_four)) {
            let (sum, hits) = self.sum(&FOUR_SAMPLES, [u, v], width, range);
            // Four samples that hit stand for as much as eight.
            let four = self.weighted(_mm256_add_epi32(sum, sum), _mm256_add_epi32(hits, hits));
            evidence = select(evidence, four, is_four);
        }
        if any(is_single) {
            let single = scaled(self.sample(u, v, range), self.single);
            evidence = select(evidence, single, is_single);
        }
        _mm256_and_si256(evidence, _mm256_castps_si256(usable))
    }

    /// Sum of the samples' evidence, and how many said anything.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn sum(
        &self,
        samples: &[[f32; 2]],
        [u, v]: [__m256; 2],
        width: __m256,
        range: __m256,
    ) -> (__m256i, __m256i) {
        let mut sum = _mm256_setzero_si256();
        let mut hits = _mm256_setzero_si256();
        for [du, dv] in samples {
            let offset = |d: f32| _mm256_mul_ps(_mm256_set1_ps(d), width);
            let sample = self.sample(
                _mm256_add_ps(u, offset(*du)),
                _mm256_add_ps(v, offset(*dv)),
                range,
            );
            let positive = _mm256_max_epi32(sample, _mm256_setzero_si256());
            let gained = _mm256_add_epi32(sample, _mm256_mullo_epi32(positive, self.obstacle));
            sum = _mm256_add_epi32(sum, gained);
            // Unequal lanes: 1 + (-1 where equal).
            let missed = _mm256_cmpeq_epi32(sample, _mm256_setzero_si256());
            hits = _mm256_add_epi32(hits, _mm256_add_epi32(missed, _mm256_set1_epi32(1)));
        }
        (sum, hits)
    }

    /// The sum times the factor for as many hits; without any hit the factor does not matter.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn weighted(&self, sum: __m256i, hits: __m256i) -> __m256i {
        let index = _mm256_sub_epi32(hits, _mm256_set1_epi32(1));
        scaled(sum, _mm256_permutevar8x32_ps(self.by_hits, index))
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
        let inside = _mm256_and_ps(inside(u, 0), inside(v, 1));
        let column = _mm256_cvttps_epi32(u);
        let row = _mm256_cvttps_epi32(v);
        let index = _mm256_add_epi32(_mm256_mullo_epi32(row, self.row_stride), column);
        // Lanes outside read pixel 0, which exists, and are zeroed at the end.
        let index = _mm256_and_si256(index, _mm256_castps_si256(inside));
        let [near, inv_step, last, base] = self.load_pixels(index);
        let base = _mm256_castps_si256(base);
        let offset = _mm256_add_ps(
            _mm256_mul_ps(_mm256_sub_ps(range, near), inv_step),
            _mm256_set1_ps(1.0),
        );
        // `max` returns its second operand for NaN, as the scalar kernel's does.
        let position = _mm256_min_ps(_mm256_max_ps(offset, zero), last);
        let entry = _mm256_add_epi32(base, _mm256_cvttps_epi32(position));
        let entries = self.kernel.tables.entries.as_ptr().cast::<i32>();
        // SAFETY: `0 <= position <= last` stays within the pixel's table, and one entry follows
        // the last table: 32 bits can be read at each of its 16-bit entries.
        let words = unsafe { _mm256_i32gather_epi32::<2>(entries, entry) };
        let value = _mm256_srai_epi32::<16>(_mm256_slli_epi32::<16>(words));
        _mm256_and_si256(value, _mm256_castps_si256(inside))
    }

    /// The four words of the pixels at eight indices, transposed.
    ///
    /// Eight loads of a whole pixel and shuffles: less than half the time of four gathers.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn load_pixels(&self, index: __m256i) -> [__m256; 4] {
        let mut at = [0_i32; 8];
        // SAFETY: eight i32 are 32 bytes; the store is unaligned.
        unsafe { _mm256_storeu_si256(at.as_mut_ptr().cast(), index) };
        let pixels = self.kernel.image.pixels.as_ptr();
        let pair = |low: usize, high: usize| {
            // SAFETY: `0 <= column < width` and `0 <= row < height`, or index 0: each lane's
            // pixel is one of the `width * height >= 1` pixels, four 32-bit words (`repr(C)`).
            unsafe {
                let low = _mm_loadu_ps(pixels.add(at[low] as usize).cast());
                let high = _mm_loadu_ps(pixels.add(at[high] as usize).cast());
                _mm256_insertf128_ps::<1>(_mm256_castps128_ps256(low), high)
            }
        };
        let (a, b, c, d) = (pair(0, 4), pair(1, 5), pair(2, 6), pair(3, 7));
        let (ab_low, ab_high) = (_mm256_unpacklo_ps(a, b), _mm256_unpackhi_ps(a, b));
        let (cd_low, cd_high) = (_mm256_unpacklo_ps(c, d), _mm256_unpackhi_ps(c, d));
        [
            _mm256_shuffle_ps::<0x44>(ab_low, cd_low),
            _mm256_shuffle_ps::<0xee>(ab_low, cd_low),
            _mm256_shuffle_ps::<0x44>(ab_high, cd_high),
            _mm256_shuffle_ps::<0xee>(ab_high, cd_high),
        ]
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
    fn eight_lanes_give_the_bits_of_the_scalar_kernel() {
        for seed in 0..20 {
            let (image, tables, blocks) = random_case(seed);
            let kernel = Kernel {
                image: &image,
                tables: &tables,
            };
            for (at, weights) in &blocks {
                for wanted in [0xff, 0x5a] {
                    let (mut found, mut expected) = ([7; BLOCK_CELLS], [7; BLOCK_CELLS]);
                    if !block(&kernel, at, weights, wanted, &mut found) {
                        eprintln!("SKIPPED: this processor has no AVX2");
                        return;
                    }
                    kernel.block_scalar(at, weights, wanted, &mut expected);
                    assert_eq!(found, expected, "{at:?}");
                }
            }
        }
    }
}
