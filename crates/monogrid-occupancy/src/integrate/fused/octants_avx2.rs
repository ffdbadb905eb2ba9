//! [`View::judge`] with a lane of an AVX2 vector for each octant.
//!
//! Every operation is the IEEE operation of the scalar search in the same order, so the results are
//! the same bits; the test compares them.
#![allow(
    unsafe_code,
    reason = "gathers from slices at indices that lie inside the image"
)]

use std::arch::x86_64::*;

use crate::integrate::fused::octants::{
    Cube, SLACK_CELLS, SLACK_PX, SLACK_RANGE, View, WIDEST_SAMPLE,
};
use crate::integrate::kernel::scalar::SINGLE_SAMPLE_PX;
use crate::integrate::octants::Octants;

/// Judges the eight halves of a cube, or `None` if this processor has no AVX2.
#[inline]
pub(crate) fn judge(view: &View, cube: Cube) -> Option<Octants> {
    if !is_x86_feature_detected!("avx2") {
        return None;
    }
    // SAFETY: the processor has AVX2.
    Some(unsafe { judge_avx2(view, cube) })
}

#[target_feature(enable = "avx2")]
fn judge_avx2(view: &View, cube: Cube) -> Octants {
    let all = |value: f32| _mm256_set1_ps(value);
    let zero = _mm256_setzero_ps();
    let half = 0.5 * cube.half;
    let hull = half - 0.5 * view.cell + SLACK_CELLS * view.cell;
    let sides = [
        _mm256_setr_ps(-1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0),
        _mm256_setr_ps(-1.0, -1.0, 1.0, 1.0, -1.0, -1.0, 1.0, 1.0),
        _mm256_setr_ps(-1.0, -1.0, -1.0, -1.0, 1.0, 1.0, 1.0, 1.0),
    ];
    let mut centers = [zero; 3];
    let (mut nearest, mut farthest) = (zero, zero);
    for axis in 0..3 {
        let center = _mm256_add_ps(
            all(cube.center[axis]),
            _mm256_mul_ps(sides[axis], all(half)),
        );
        let distance = _mm256_andnot_ps(all(-0.0), center);
        let near = _mm256_max_ps(_mm256_sub_ps(distance, all(hull)), zero);
        let far = _mm256_add_ps(distance, all(hull));
        nearest = _mm256_add_ps(nearest, _mm256_mul_ps(near, near));
        farthest = _mm256_add_ps(farthest, _mm256_mul_ps(far, far));
        centers[axis] = center;
    }
    let nearest = _mm256_mul_ps(_mm256_sqrt_ps(nearest), all(1.0 - SLACK_RANGE));
    let farthest = _mm256_mul_ps(_mm256_sqrt_ps(farthest), all(1.0 + SLACK_RANGE));
    let (axes, extent) = view.axes_and_extent(hull);
    let in_image = axes.map(|axis| {
        let [x, y, z] = std::array::from_fn(|i| _mm256_mul_ps(all(axis[i]), centers[i]));
        _mm256_add_ps(_mm256_add_ps(x, y), z)
    });
    let near = _mm256_sub_ps(in_image[2], all(extent[2]));
    let far = _mm256_add_ps(in_image[2], all(extent[2]));
    let inverse = |z| _mm256_div_ps(all(1.0), _mm256_max_ps(z, all(view.nearest)));
    let (inv_near, inv_far) = (inverse(near), inverse(far));

    let boxes = pixel_boxes(view, &in_image, extent, [inv_near, inv_far]);
    let [free_until, clear_until, changes_until] = look_up(view, &boxes);

    let bits = |lanes| _mm256_movemask_ps(lanes) as u8;
    let is_deep = bits(_mm256_cmp_ps::<_CMP_GT_OQ>(near, all(view.nearest)));
    let reaches_deep = bits(_mm256_cmp_ps::<_CMP_GT_OQ>(far, all(view.nearest)));
    let is_reached = bits(_mm256_cmp_ps::<_CMP_LE_OQ>(nearest, changes_until));
    let is_clear = bits(_mm256_cmp_ps::<_CMP_LT_OQ>(farthest, clear_until));
    let is_free = bits(_mm256_cmp_ps::<_CMP_LT_OQ>(farthest, free_until));
    let touched = reaches_deep & bits(boxes.is_seen) & is_reached;
    Octants {
        touched,
        clear: touched & is_clear,
        free: touched & is_clear & is_free & bits(boxes.is_inside) & is_deep,
    }
}

/// The pixels that the samples of the octants' cells can fall into.
struct PixelBoxes {
    /// First pixel, along u and v.
    first: [__m256i; 2],
    /// Pixels along the longer edge, less one.
    edges: __m256i,
    /// Whether any of it lies in the image, and whether all of it does.
    is_seen: __m256,
    is_inside: __m256,
}

#[target_feature(enable = "avx2")]
#[inline]
fn pixel_boxes(
    view: &View,
    in_image: &[__m256; 3],
    extent: [f32; 3],
    [inv_near, inv_far]: [__m256; 2],
) -> PixelBoxes {
    let all = |value: f32| _mm256_set1_ps(value);
    let zero = _mm256_setzero_ps();
    let footprint = all(view.cell * view.image.focal[0]);
    let width = _mm256_mul_ps(_mm256_mul_ps(footprint, inv_near), all(1.0 + SLACK_RANGE));
    let is_wide = _mm256_cmp_ps::<_CMP_NLE_UQ>(width, all(SINGLE_SAMPLE_PX));
    let spread = _mm256_and_ps(all(WIDEST_SAMPLE * view.cell), is_wide);
    let size = view.windows.size().map(|edge| edge as f32);
    let mut is_seen = all(f32::from_bits(u32::MAX));
    let mut is_inside = is_seen;
    let mut first = [_mm256_setzero_si256(); 2];
    let mut edges = _mm256_setzero_si256();
    for axis in 0..2 {
        let (focal, center) = (view.image.focal[axis], view.image.center[axis] + 0.5);
        let spread = _mm256_mul_ps(spread, all(view.image.focal[0] / focal));
        let extent = _mm256_add_ps(all(extent[axis]), spread);
        let low = _mm256_sub_ps(in_image[axis], extent);
        let high = _mm256_add_ps(in_image[axis], extent);
        let is_left = _mm256_cmp_ps::<_CMP_LT_OQ>(low, zero);
        let is_right = _mm256_cmp_ps::<_CMP_GT_OQ>(high, zero);
        let low = _mm256_mul_ps(low, _mm256_blendv_ps(inv_far, inv_near, is_left));
        let high = _mm256_mul_ps(high, _mm256_blendv_ps(inv_far, inv_near, is_right));
        let pixel = |slope| _mm256_add_ps(_mm256_mul_ps(slope, all(focal)), all(center));
        let low = _mm256_sub_ps(pixel(low), all(SLACK_PX));
        let high = _mm256_add_ps(pixel(high), all(SLACK_PX));
        let ends_inside = _mm256_cmp_ps::<_CMP_LT_OQ>(high, all(size[axis]));
        let begins_inside = _mm256_cmp_ps::<_CMP_GE_OQ>(low, zero);
        let ends_right = _mm256_cmp_ps::<_CMP_GE_OQ>(high, zero);
        let begins_left = _mm256_cmp_ps::<_CMP_LT_OQ>(low, all(size[axis]));
        is_seen = _mm256_and_ps(is_seen, _mm256_and_ps(ends_right, begins_left));
        is_inside = _mm256_and_ps(is_inside, _mm256_and_ps(begins_inside, ends_inside));
        let last = all(size[axis] - 1.0);
        let clamped = |c| _mm256_cvttps_epi32(_mm256_min_ps(_mm256_max_ps(c, zero), last));
        first[axis] = clamped(low);
        edges = _mm256_max_epi32(edges, _mm256_sub_epi32(clamped(high), first[axis]));
    }
    PixelBoxes {
        first,
        edges,
        is_seen,
        is_inside,
    }
}

/// The bounds over each box; of a box outside of the image, those of some pixels in it.
#[target_feature(enable = "avx2")]
#[inline]
fn look_up(view: &View, boxes: &PixelBoxes) -> [__m256; 3] {
    let level = view.windows.level_for(highest(boxes.edges) as usize + 1);
    let shift = _mm_cvtsi32_si128(level.shift as i32);
    let [column, row] = boxes.first.map(|c| _mm256_srl_epi32(c, shift));
    let row_start = _mm256_add_epi32(
        _mm256_set1_epi32(level.first as i32),
        _mm256_mullo_epi32(row, _mm256_set1_epi32(level.width as i32)),
    );
    let index = _mm256_add_epi32(row_start, column);
    // SAFETY: columns and rows are those of pixels of the image (also of lanes that do not see it),
    // so the indices are those of windows of the level, of which all three slices hold all.
    let look_up = |bounds: &[f32]| unsafe { _mm256_i32gather_ps::<4>(bounds.as_ptr(), index) };
    view.windows.bounds().map(look_up)
}

/// The highest lane.
#[target_feature(enable = "avx2")]
#[inline]
fn highest(lanes: __m256i) -> i32 {
    let four = _mm_max_epi32(
        _mm256_castsi256_si128(lanes),
        _mm256_extracti128_si256::<1>(lanes),
    );
    let two = _mm_max_epi32(four, _mm_shuffle_epi32::<0b00_00_11_10>(four));
    _mm_cvtsi128_si32(_mm_max_epi32(two, _mm_shuffle_epi32::<0b01>(two)))
}
