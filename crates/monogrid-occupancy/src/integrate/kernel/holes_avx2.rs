//! Octants of cells before all measurements, which get the update of free space where a pixel has a
//! measurement: nothing but that is looked up, in bits.
//!
//! An octant sees few rows of pixels, a lane of a vector for each: a lookup is a permutation and a
//! shift, where one in memory takes as long as ten of them.
#![allow(
    unsafe_code,
    reason = "gathers from rows of bits that hold what is read behind their ends"
)]

use std::arch::x86_64::*;

use crate::integrate::kernel::block_avx2::{Block, VECTORS};
use crate::integrate::kernel::kernel_avx2::{Lanes, moved};
use crate::integrate::kernel::kernel_image::Bits;
use crate::integrate::kernel::scalar::{
    EIGHT_SAMPLES, FOUR_SAMPLES, FOUR_SAMPLES_PX, evidence, sum,
};

/// Columns of a window: as many bits as are left of 32 that begin at a byte.
const COLUMNS: i32 = 25;

impl<const ONE_TABLE: bool> Lanes<'_, ONE_TABLE> {
    /// Evidence of the cells of an octant that take a single sample; `None` if they may be too far
    /// or see too many pixels.
    #[target_feature(enable = "avx2")]
    #[inline]
    pub(super) fn single_through_holes(&self, block: &Block) -> Option<[__m256i; VECTORS]> {
        let mut usable = [_mm256_setzero_ps(); VECTORS];
        let mut columns = [_mm256_setzero_si256(); VECTORS];
        let mut rows = columns;
        let mut window = Extent::new();
        for vector in 0..VECTORS {
            let center = block.centers(vector);
            let [u, v] = self.slopes(center).0;
            usable[vector] = self.is_deep(center[2]);
            (columns[vector], rows[vector]) = (self.column(u), self.row(v));
            window.widen(columns[vector], rows[vector]);
        }
        let window = Window::<8>::new(&self.kernel.image.measured, &window)?;
        let free = _mm256_set1_epi32(i32::from(self.kernel.free(self.weights)));
        let mut found = columns;
        for vector in 0..VECTORS {
            let is_hit =
                _mm256_srai_epi32::<31>(window.bit(window.row(rows[vector]), columns[vector]));
            let is_hit = _mm256_and_si256(is_hit, _mm256_castps_si256(usable[vector]));
            found[vector] = _mm256_and_si256(is_hit, free);
        }
        Some(found)
    }

    /// Evidence of the cells of an octant that take four samples; `None` likewise.
    #[target_feature(enable = "avx2")]
    #[inline]
    pub(super) fn mean_of_four_through_holes(&self, block: &Block) -> Option<[__m256i; VECTORS]> {
        let mut usable = [_mm256_setzero_ps(); VECTORS];
        let mut columns = [[_mm256_setzero_si256(); 2]; VECTORS];
        let mut rows = columns;
        let mut window = Extent::new();
        let [[left, upper], .., [right, lower]] = FOUR_SAMPLES;
        for vector in 0..VECTORS {
            let center = block.centers(vector);
            let ([u, v], inverse) = self.slopes(center);
            let width = self.width(inverse);
            usable[vector] = self.is_deep(center[2]);
            columns[vector] = [left, right].map(|d| self.column(moved(u, d, width)));
            rows[vector] = [upper, lower].map(|d| self.row(moved(v, d, width)));
            for i in 0..2 {
                window.widen(columns[vector][i], rows[vector][i]);
            }
        }
        let window = Window::<16>::new(&self.kernel.image.measured, &window)?;
        let by_hits = self.free_by_hits_of_four();
        let mut found = [_mm256_setzero_si256(); VECTORS];
        for vector in 0..VECTORS {
            let mut hits = _mm256_setzero_si256();
            for row in rows[vector] {
                let row = window.row(row);
                for column in columns[vector] {
                    let hit = _mm256_srli_epi32::<31>(window.bit(row, column));
                    hits = _mm256_add_epi32(hits, hit);
                }
            }
            let mean = _mm256_permutevar8x32_epi32(by_hits, hits);
            found[vector] = _mm256_and_si256(mean, _mm256_castps_si256(usable[vector]));
        }
        Some(found)
    }

    /// Evidence of cells that take eight samples; `None` likewise, and for others.
    #[target_feature(enable = "avx2")]
    #[inline]
    pub(super) fn mean_of_eight_through_holes(&self, center: [__m256; 3]) -> Option<__m256i> {
        let ([u, v], inverse) = self.slopes(center);
        let width = self.width(inverse);
        let is_large = _mm256_cmp_ps::<_CMP_GT_OQ>(width, _mm256_set1_ps(FOUR_SAMPLES_PX));
        if _mm256_movemask_ps(_mm256_and_ps(is_large, self.is_deep(center[2]))) != 0xff {
            return None;
        }
        let mut pixels = [[_mm256_setzero_si256(); 2]; EIGHT_SAMPLES.len()];
        let mut window = Extent::new();
        for ([column, row], [du, dv]) in pixels.iter_mut().zip(EIGHT_SAMPLES) {
            *column = self.column(moved(u, du, width));
            *row = self.row(moved(v, dv, width));
            window.widen(*column, *row);
        }
        let window = Window::<16>::new(&self.kernel.image.measured, &window)?;
        let mut hits = _mm256_setzero_si256();
        for [column, row] in pixels {
            let hit = _mm256_srli_epi32::<31>(window.bit(window.row(row), column));
            hits = _mm256_add_epi32(hits, hit);
        }
        let [up_to_seven, eight] = self.free_by_hits_of_eight();
        let found = _mm256_permutevar8x32_epi32(up_to_seven, hits);
        let is_eight = _mm256_cmpeq_epi32(hits, _mm256_set1_epi32(8));
        Some(_mm256_blendv_epi8(found, eight, is_eight))
    }

    /// Evidence of a cell whose eight samples are free, by the number of those that hit; that of
    /// all apart.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn free_by_hits_of_eight(&self) -> [__m256i; 2] {
        let (free, _) = sum::parts(self.kernel.tables.gains[0]);
        let of = |hits: usize| -> i32 {
            let factor = self.weights.by_hits[hits.saturating_sub(1)];
            evidence(free * hits as i32, factor).into()
        };
        [
            _mm256_setr_epi32(of(0), of(1), of(2), of(3), of(4), of(5), of(6), of(7)),
            _mm256_set1_epi32(of(8)),
        ]
    }

    /// Evidence of a cell whose four samples are free, by the number of those that hit.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn free_by_hits_of_four(&self) -> __m256i {
        let (free, _) = sum::parts(self.kernel.tables.gains[0]);
        let of = |hits: usize| -> i32 {
            let factor = self.weights.by_hits[(2 * hits).saturating_sub(1)];
            evidence(2 * free * hits as i32, factor).into()
        };
        _mm256_setr_epi32(of(0), of(1), of(2), of(3), of(4), 0, 0, 0)
    }
}

/// Least and greatest column and row, lane by lane.
struct Extent {
    least: [__m256i; 2],
    greatest: [__m256i; 2],
}

impl Extent {
    #[target_feature(enable = "avx2")]
    #[inline]
    fn new() -> Self {
        Self {
            least: [_mm256_set1_epi32(i32::MAX); 2],
            greatest: [_mm256_setzero_si256(); 2],
        }
    }

    #[target_feature(enable = "avx2")]
    #[inline]
    fn widen(&mut self, column: __m256i, row: __m256i) {
        for (axis, pixel) in [column, row].into_iter().enumerate() {
            self.least[axis] = _mm256_min_epi32(self.least[axis], pixel);
            self.greatest[axis] = _mm256_max_epi32(self.greatest[axis], pixel);
        }
    }
}

/// Some rows of bits from some column on, in the order of the rows' numbers modulo `ROWS`, 8 or 16.
struct Window<const ROWS: usize> {
    rows: [__m256i; 2],
    /// 31 more than the first column.
    column_31: __m256i,
}

impl<const ROWS: usize> Window<ROWS> {
    /// Those that hold an extent, if they do; all of it lies in the image.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn new(bits: &Bits, extent: &Extent) -> Option<Self> {
        let [column, row] = extent.least.map(|lanes| least(lanes));
        let [last_column, last_row] = extent.greatest.map(|lanes| greatest(lanes));
        if last_row - row >= ROWS as i32 || last_column - column >= COLUMNS {
            return None;
        }
        let mut rows = [_mm256_setzero_si256(); 2];
        for (half, rows) in rows.iter_mut().enumerate().take(ROWS / 8) {
            let lane = _mm256_add_epi32(
                _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7),
                _mm256_set1_epi32(8 * half as i32 - row),
            );
            let below = _mm256_and_si256(lane, _mm256_set1_epi32(ROWS as i32 - 1));
            let index = _mm256_mullo_epi32(
                _mm256_add_epi32(below, _mm256_set1_epi32(row)),
                _mm256_set1_epi32(bits.stride as i32),
            );
            let index = _mm256_add_epi32(index, _mm256_set1_epi32(column >> 3));
            // SAFETY: the first row and column lie in the image, `ROWS - 1` more rows and three
            // more bytes in what is spare.
            let found = unsafe { _mm256_i32gather_epi32::<1>(bits.bytes.as_ptr().cast(), index) };
            *rows = _mm256_srl_epi32(found, _mm_cvtsi32_si128(column & 7));
        }
        Some(Self {
            rows,
            column_31: _mm256_set1_epi32(column + 31),
        })
    }

    /// The bits of rows.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn row(&self, row: __m256i) -> __m256i {
        // A permutation takes the lowest three bits of a row's number.
        let low = _mm256_permutevar8x32_epi32(self.rows[0], row);
        if ROWS == 8 {
            return low;
        }
        let high = _mm256_permutevar8x32_epi32(self.rows[1], row);
        let is_high = _mm256_castsi256_ps(_mm256_slli_epi32::<28>(row));
        let [low, high] = [low, high].map(|bits| _mm256_castsi256_ps(bits));
        _mm256_castps_si256(_mm256_blendv_ps(low, high, is_high))
    }

    /// The bit of a column of such a row as the highest of its lane.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn bit(&self, row: __m256i, column: __m256i) -> __m256i {
        _mm256_sllv_epi32(row, _mm256_sub_epi32(self.column_31, column))
    }
}

#[target_feature(enable = "avx2")]
#[inline]
fn least(lanes: __m256i) -> i32 {
    let four = _mm_min_epi32(
        _mm256_castsi256_si128(lanes),
        _mm256_extracti128_si256::<1>(lanes),
    );
    let two = _mm_min_epi32(four, _mm_shuffle_epi32::<0b00_00_11_10>(four));
    _mm_cvtsi128_si32(_mm_min_epi32(two, _mm_shuffle_epi32::<0b01>(two)))
}

#[target_feature(enable = "avx2")]
#[inline]
fn greatest(lanes: __m256i) -> i32 {
    let four = _mm_max_epi32(
        _mm256_castsi256_si128(lanes),
        _mm256_extracti128_si256::<1>(lanes),
    );
    let two = _mm_max_epi32(four, _mm_shuffle_epi32::<0b00_00_11_10>(four));
    _mm_cvtsi128_si32(_mm_max_epi32(two, _mm_shuffle_epi32::<0b01>(two)))
}

const _: () = assert!(Bits::SPARE_ROWS >= 15 && Bits::SPARE_BYTES >= 3);
