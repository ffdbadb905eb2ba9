//! The cells of an octant of a brick as eight vectors, and their evidence in that of the brick.
#![allow(unsafe_code, reason = "vectors and arrays of the same bits")]

use std::arch::x86_64::*;

use crate::integrate::kernel::scalar::{
    FOUR_SAMPLES_PX, OCTANT_EDGE, Placed, SINGLE_SAMPLE_PX, cell_in_brick, index_of,
};
use crate::key::{BRICK_CELLS, BRICK_EDGE};

/// Vectors of an octant: of each layer two, each of two rows.
pub(super) const VECTORS: usize = 2 * OCTANT_EDGE;

/// Puts the evidence of the cells of an octant, as i32, into that of its brick.
#[target_feature(enable = "avx2")]
#[inline]
pub(super) fn put_octant(cells: &mut [i16; BRICK_CELLS], octant: u8, found: &[__m256i; VECTORS]) {
    for (vector, &found) in found.iter().enumerate() {
        // Saturating to i16 changes nothing: the lanes are within its range.
        let packed = _mm_packs_epi32(
            _mm256_castsi256_si128(found),
            _mm256_extracti128_si256::<1>(found),
        );
        // SAFETY: both are 16 bytes, of which any value is one.
        let packed: [i16; 2 * OCTANT_EDGE] = unsafe { std::mem::transmute(packed) };
        let first = index_of(cell_in_brick(octant, [0, vector % 2 * 2, vector / 2]));
        for (row, packed) in packed.chunks_exact(OCTANT_EDGE).enumerate() {
            let first = first + row * BRICK_EDGE as usize;
            cells[first..first + OCTANT_EDGE].copy_from_slice(packed);
        }
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

/// The cells of an octant.
pub(super) struct Block {
    layers: [[f32; 3]; OCTANT_EDGE],
    /// Ways from the first cell of a layer to its two vectors.
    rows: [[__m256; 3]; 2],
    /// Least and greatest depth of their centres, but for rounding.
    depths: [f32; 2],
}

impl Block {
    #[target_feature(enable = "avx2")]
    #[inline]
    pub(super) fn new(brick: &Placed, octant: u8) -> Self {
        let [x, y, z] = cell_in_brick(octant, [0; 3]).map(|c| c as f32);
        let layers: [_; OCTANT_EDGE] = std::array::from_fn(|layer| brick.layer(z + layer as f32));
        let first = layers[0][2] + x * brick.steps[0][2] + y * brick.steps[1][2];
        let [mut least, mut greatest] = [first; 2];
        for step in brick.steps {
            let way = (OCTANT_EDGE - 1) as f32 * step[2];
            least += way.min(0.0);
            greatest += way.max(0.0);
        }
        Self {
            layers,
            rows: [lanes_of_rows(brick, x, y), lanes_of_rows(brick, x, y + 2.0)],
            depths: [least, greatest],
        }
    }

    /// The centres of eight cells.
    #[target_feature(enable = "avx2")]
    #[inline]
    pub(super) fn centers(&self, vector: usize) -> [__m256; 3] {
        let (layer, rows) = (&self.layers[vector / 2], &self.rows[vector % 2]);
        let along = |i: usize| _mm256_add_ps(_mm256_set1_ps(layer[i]), rows[i]);
        [along(0), along(1), along(2)]
    }
}

/// How many samples the cells of an octant take.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Samples {
    One,
    Four,
    /// Eight, or not all the same.
    Other,
}

/// Slack against rounding of depths, relative.
const SLACK_DEPTH: f32 = 1e-3;

/// How many samples the cells of an octant take, whose footprints are `cell_focal` wide at depth 1.
pub(super) fn samples(cell_focal: f32, block: &Block) -> Samples {
    let [near, far] = block.depths;
    let narrowest = cell_focal / far * (1.0 - SLACK_DEPTH);
    let widest = cell_focal / near * (1.0 + SLACK_DEPTH);
    if near <= 0.0 {
        Samples::Other
    } else if widest <= SINGLE_SAMPLE_PX {
        Samples::One
    } else if narrowest > SINGLE_SAMPLE_PX && widest <= FOUR_SAMPLES_PX {
        Samples::Four
    } else {
        Samples::Other
    }
}
