//! Bilinear look-ups, several at once.

use super::{F32x8, I32x8, Lanes};
use crate::Image;

/// Grey values of which four corners are looked up at eight places.
pub trait Grey: Copy {
    /// The corners of one place.
    type Cell: Copy + Default;

    /// Makes a cell of upper left, upper right, lower left and lower right.
    fn cell(corners: [Self; 4]) -> Self::Cell;

    /// Corners by place as places by corner.
    fn by_corner<L: Lanes>(lanes: L, cells: [Self::Cell; 8]) -> [L::F32; 4];
}

impl Grey for f32 {
    type Cell = [f32; 4];

    #[inline(always)]
    fn cell(corners: [f32; 4]) -> [f32; 4] {
        corners
    }

    #[inline(always)]
    fn by_corner<L: Lanes>(lanes: L, cells: [[f32; 4]; 8]) -> [L::F32; 4] {
        let [a, b, c, d, e, f, g, h] = cells;
        let corner = |k: usize| lanes.f32s(&[a[k], b[k], c[k], d[k], e[k], f[k], g[k], h[k]]);
        [corner(0), corner(1), corner(2), corner(3)]
    }
}

impl Grey for u16 {
    /// Upper and lower pair, each as one number.
    type Cell = [i32; 2];

    #[inline(always)]
    fn cell([a, b, c, d]: [u16; 4]) -> [i32; 2] {
        [[a, b], [c, d]].map(|[left, right]| (u32::from(right) << 16 | u32::from(left)) as i32)
    }

    #[inline(always)]
    fn by_corner<L: Lanes>(lanes: L, cells: [[i32; 2]; 8]) -> [L::F32; 4] {
        corners_of_pairs::<16, L>(lanes, cells)
    }
}

impl Grey for u8 {
    /// Upper and lower pair, each as one number: to convert each byte alone costs more than all the
    /// rest.
    type Cell = [i32; 2];

    #[inline(always)]
    fn cell([a, b, c, d]: [u8; 4]) -> [i32; 2] {
        [[a, b], [c, d]].map(|pair| i32::from(u16::from_le_bytes(pair)))
    }

    #[inline(always)]
    fn by_corner<L: Lanes>(lanes: L, cells: [[i32; 2]; 8]) -> [L::F32; 4] {
        corners_of_pairs::<8, L>(lanes, cells)
    }
}

/// Of pairs of numbers of so many bits, the left one in the lower bits.
#[inline(always)]
fn corners_of_pairs<const BITS: i32, L: Lanes>(lanes: L, cells: [[i32; 2]; 8]) -> [L::F32; 4] {
    let [a, b, c, d, e, f, g, h] = cells;
    let row = |k: usize| lanes.i32s(&[a[k], b[k], c[k], d[k], e[k], f[k], g[k], h[k]]);
    let (above, below) = (row(0), row(1));
    let lower = lanes.i32s(&[(1 << BITS) - 1; 8]);
    [
        (above & lower).to_f32(),
        (above.shr::<BITS>() & lower).to_f32(),
        (below & lower).to_f32(),
        (below.shr::<BITS>() & lower).to_f32(),
    ]
}

/// The image at the first `N` of eight places `(x, y)`, px, bilinear.
///
/// The caller keeps them inside: each has a pixel to its right and one below. Others panic, or give
/// values of other pixels.
#[inline(always)]
pub fn bilinear<const N: usize, T: Grey, L: Lanes>(
    lanes: L,
    image: &Image<T>,
    x: L::F32,
    y: L::F32,
) -> [f32; N] {
    const { assert!(N <= 8) };
    let (column, row) = (x.truncated(), y.truncated());
    let (fx, fy) = (x - column.to_f32(), y - row.to_f32());
    let (column, row) = (column.to_array(), row.to_array());
    // two slices of equal length, so that one check holds for both
    let (data, width) = (image.as_slice(), image.width());
    let below = &data[width..];
    let above = &data[..below.len()];
    let mut cells = [T::Cell::default(); 8];
    for k in 0..N {
        let left = row[k].wrapping_mul(width as i32).wrapping_add(column[k]) as usize;
        let (above, below) = (&above[left..], &below[left..]);
        cells[k] = T::cell([above[0], above[1], below[0], below[1]]);
    }
    let [a, b, c, d] = T::by_corner(lanes, cells);
    let (top, bottom) = (a + fx * (b - a), c + fx * (d - c));
    let (values, mut first) = ((top + fy * (bottom - top)).to_array(), [0.0; N]);
    first.copy_from_slice(&values[..N]);
    first
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::for_lanes;
    use crate::lanes::Baseline;

    #[inline(always)]
    fn eight<T: Grey, L: Lanes>(lanes: L, image: &Image<T>, [x, y]: &[[f32; 8]; 2]) -> [f32; 8] {
        bilinear(lanes, image, lanes.f32s(x), lanes.f32s(y))
    }

    for_lanes! {
        fn of_bytes = eight, (image: &Image<u8>, places: &[[f32; 8]; 2]) -> [f32; 8];
        fn of_numbers = eight, (image: &Image<f32>, places: &[[f32; 8]; 2]) -> [f32; 8];
    }

    #[test]
    fn lanes_equal_the_plain_formula_for_bytes_and_for_numbers() {
        let bytes = Image::from_fn(31, 17, |x, y| (37 * x + 101 * y + x * y) as u8);
        let numbers = bytes.map(f32::from);
        let x = [0.0, 29.0, 3.25, 7.5, 28.99, 12.125, 0.5, 15.75];
        let y = [0.0, 15.0, 14.5, 0.25, 15.99, 8.0, 3.625, 7.75];
        let plain = |k: usize| {
            let (column, row) = (x[k] as usize, y[k] as usize);
            let (fx, fy) = (x[k] - column as f32, y[k] - row as f32);
            let along = |row: usize| {
                let (a, b) = (numbers.at(column, row), numbers.at(column + 1, row));
                a + fx * (b - a)
            };
            along(row) + fy * (along(row + 1) - along(row))
        };
        let expected: [f32; 8] = std::array::from_fn(plain);
        let places = [x, y];
        let (x, y) = (Baseline.f32s(&x), Baseline.f32s(&y));
        assert_eq!(bilinear(Baseline, &bytes, x, y), expected);
        assert_eq!(of_bytes(&bytes, &places), expected);
        assert_eq!(of_numbers(&numbers, &places), expected);
        let words = bytes.map(|byte| u16::from(byte) << 8);
        let of_words: [f32; 8] = bilinear(Baseline, &words, x, y);
        assert_eq!(of_words.map(|value| value / 256.0), expected);
        assert_eq!(bilinear(Baseline, &numbers, x, y), expected);
        let first: [f32; 3] = bilinear(Baseline, &bytes, x, y);
        assert_eq!(first, expected[..3]);
    }
}
